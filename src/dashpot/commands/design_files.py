"""The TOML files that ``dashpot design`` writes: the controller, and the specification in full."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import dashpot
from dashpot.design.design import Design, JointDesign
from dashpot.design.quantities import GAINS, QUANTITIES, binding_text
from dashpot.design.wishes import LIMITS, UNITS
from dashpot.support.numbers import significant
from dashpot.support.tables import toml_value

if TYPE_CHECKING:
    from dashpot.cli.design import Design as Options
    from dashpot.design.candidates import Duty

UNIT_OF = {
    "payload": "kg",
    "offset": "m, in the flange frame",
    "period": "s",
    "latency": "whole samples from computing a torque to its taking effect",
    "latency_max": "the longest it may be",
    "speed": "rad/s",
    "residual_speed": "share of the speed",
    "jump": "rad",
    **UNITS,
}


def controller_toml(result: Design, options: Options) -> str:
    """The controller, with what it is for and what it will do."""
    config, spec = result.config, result.spec
    head = [
        f"Gains for {result.robot} by dashpot {dashpot.__version__} from {_words(spec.preset, spec.file)},",
        "certified for every passive load over the whole uncertainty that the robot file states.",
        f"Payload up to {spec.payload:g} kg. In full: spec.toml, design.json, report.html beside this file.",
        f"Check: dashpot certify {options.robot} {options.out / 'controller.toml'}",
    ]
    lines = [*(_comment(line) for line in head), ""]
    lines += [
        f"period = {toml_value(config.period)}  # s",
        f"latency = {config.latency}  # whole samples",
    ]
    if config.latency_max is not None:
        lines.append(f"latency_max = {config.latency_max}")
    lines += [f"sampling = {toml_value(config.sampling)}", f"form = {toml_value(config.form)}"]
    for joint in result.joints:
        lines += ["", *_joint_comments(joint), *_gains(joint)]
    return "\n".join(lines) + "\n"


def _gains(joint: JointDesign) -> list[str]:
    assert joint.found is not None
    gains = joint.found.gains.joint(joint.name)
    lines = ["[[joint]]", f"name = {toml_value(joint.name)}"]
    return lines + [f"{name} = {toml_value(getattr(gains, name))}  # {unit}" for name, unit in GAINS.items()]


def _joint_comments(joint: JointDesign) -> list[str]:
    found, duty = joint.found, joint.duty
    assert found is not None
    parts = [
        f"{QUANTITIES[name].label} {QUANTITIES[name].text(number)}"
        for name, number in joint.predicted.items()
        if significant(number) != "-"
    ]
    lines = [
        _comment(f"carries {_carries(duty)}"),
        *_wrapped("predicted: ", parts),
        _comment(f"margin {significant(found.margin)} of the drive's own damping, at worst"),
    ]
    if found.binding:
        names = [binding_text(name, joint.wishes.limits, joint.wishes.margin) for name in found.binding]
        lines += _wrapped("limited by: ", names)
    return lines


def _wrapped(label: str, parts: Sequence[str], width: int = 108) -> list[str]:
    lines, line = [], label
    for i, part in enumerate(parts):
        piece = part + (", " if i < len(parts) - 1 else "")
        if len(line) + len(piece) > width and line.strip():
            lines.append(line)
            line = "  "
        line += piece
    return [_comment(text) for text in [*lines, line]]


def _carries(duty: Duty) -> str:
    return (
        f"{significant(duty.inertia)} kg m^2 alone, up to {significant(duty.loaded)} kg m^2 and "
        f"{significant(duty.load)} N m with payload"
    )


def _words(preset: str, file: Path | None) -> str:
    return f'preset "{preset}"' if file is None else f'{file.name} (preset "{preset}")'


def spec_toml(result: Design, needed: Sequence[Duty]) -> str:
    """The specification as it was used, every value in full; it designs the same gains again."""
    spec, first = result.spec, needed[0]
    every = spec.of(None)
    lines = [
        _comment(f"What was asked of {result.robot}, every value in full (dashpot {dashpot.__version__})."),
        "",
        f"preset = {toml_value(spec.preset)}",
        f"joints = {toml_value([duty.drive.name for duty in needed])}",
        f"minimise = {toml_value(every.minimise)}",
        f"beside = {toml_value(dict(every.beside))}  # weights of what else counts",
    ]
    lines += [_setting(name, getattr(every, name)) for name in (*LIMITS, "margin")]
    lines.append("")
    means: dict[str, Any] = {
        name: getattr(spec, name) for name in ("payload", "offset", "pose", "gravity_compensated")
    }
    means |= {name: getattr(first, name) for name in ("period", "latency", "latency_max", "sampling", "form")}
    means |= {name: getattr(spec, name) for name in ("speed", "residual_speed", "jump")}
    lines += [_setting(name, item) for name, item in means.items()]
    for duty in needed:
        own = spec.own.get(duty.drive.name, {})
        lines += ["", _comment(f"{duty.drive.name} carries {_carries(duty)}")]
        if own:
            lines += ["[[joint]]", f"name = {toml_value(duty.drive.name)}"]
            lines += [_setting(name, item) for name, item in own.items()]
    return "\n".join(lines) + "\n"


def _setting(name: str, item: Any) -> str:
    unit = UNIT_OF.get(name, "")
    if item is None:
        return _comment(f"{name}: no limit [{unit}]")
    note = f"  # {unit}" if unit and unit != "-" else ""
    return f"{name} = {toml_value(item)}{note}"


def _comment(text: str) -> str:
    """One line of comment, whatever names stand in it."""
    return "# " + "".join(c if c.isprintable() else "?" for c in text).rstrip()
