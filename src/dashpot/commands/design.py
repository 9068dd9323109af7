"""``dashpot design``."""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import dashpot
from dashpot.arm.robot import Robot
from dashpot.commands.shared import check_joints, check_place, file_names, progress
from dashpot.design.conflicts import Conflict
from dashpot.design.design import Design, JointDesign, design_joint, duties
from dashpot.design.spec import WISHES, Spec
from dashpot.design.wishes import Wishes
from dashpot.errors import InputError, InputWarning
from dashpot.support.limits import check_workers
from dashpot.support.output import whole_folder
from dashpot.support.workers import cores, each

if TYPE_CHECKING:
    from dashpot.cli.design import Design as Options
    from dashpot.design.candidates import Duty

Task = tuple["Duty", Wishes, bool, Path]
MEANS = tuple(f.name for f in fields(Spec) if f.name not in ("preset", "wishes", "joints", "own", "file"))
"""What a specification says besides wishes; all of it has a flag."""


def design(options: Options) -> int:
    """``dashpot design``; returns the exit status: 1 where wishes of a joint conflict."""
    robot, spec = Robot.load(options.robot), specification(options)
    check_workers(options.workers)
    workers = cores() if options.workers is None else options.workers
    check_joints(options.joint or (), robot, "--joint")
    check_place(options.out, (robot.file, robot.model, spec.file))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)  # gains are no input, and what is has been warned of
        return _design(options, robot, spec, workers)


def _design(options: Options, robot: Robot, spec: Spec, workers: int) -> int:
    needed = duties(robot, spec)
    files = file_names([duty.drive.name for duty in needed])
    with progress("designing", len(needed)) as advance, whole_folder(options.out) as folder:
        tasks = [
            (duty, spec.of(duty.drive.name), spec.loop, folder / files[duty.drive.name]) for duty in needed
        ]
        result = Design(robot.name, spec, tuple(each(_design_and_draw, tasks, workers, advance)))
        table = _table(result, needed)
        text = json.dumps(table, indent=2, allow_nan=False)
        _write(folder, result, needed, options, text, files)
    if options.json:
        print(text)
    else:
        from dashpot.commands.design_view import show

        show(result, needed, robot, options)
    return 0 if result.feasible else 1


def specification(options: Options) -> Spec:
    """The specification with the flags in it.

    Raises:
        InputError: Naming the file, or the flag.
    """
    flags = {name: getattr(options, name) for name in (*WISHES, *MEANS) if hasattr(options, name)}
    if options.gravity_compensated is not None:
        flags["gravity_compensated"] = options.gravity_compensated == "yes"
    if options.offset is not None:
        if len(options.offset) not in (1, 3):
            raise InputError("must be one number or three", quantity="--offset [m]", value=options.offset)
        flags["offset"] = (*options.offset, 0.0, 0.0)[:3]
    if options.joint is not None:
        flags["joints"] = tuple(dict.fromkeys(options.joint))
    given = {name: value for name, value in flags.items() if value is not None}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", InputWarning)
        base = Spec.load(options.spec)
        if given:
            caught.clear()  # the flags may replace what was unusual; the rest is said again
            base = _changed(base, given)
    for message in dict.fromkeys(str(warning.message) for warning in caught):
        warnings.warn(message, InputWarning, stacklevel=2)
    return base


def _changed(base: Spec, given: Mapping[str, Any]) -> Spec:
    """The specification with flags in it; what is wrong with a flag is not blamed on the file."""
    try:
        return base.changed(**given)
    except InputError as error:
        name, _, unit = (error.quantity or "").partition(" ")
        if name not in given:
            raise
        flag = "--joint" if name == "joints" else "--" + name.replace("_", "-")
        raise InputError(error.rule, quantity=f"{flag} {unit}".rstrip(), value=error.value) from None


def _design_and_draw(task: Task) -> JointDesign:
    """One joint, with its picture."""
    duty, wishes, loop, place = task
    result = design_joint(duty, wishes, loop)
    if result.found is not None:
        from dashpot.commands.design_plots import draw
        from dashpot.support.plots import save

        save(draw(result), place, pdf=False)
    return result


def _write(
    folder: Path, result: Design, needed: list[Duty], options: Options, text: str, files: dict[str, str]
) -> None:
    from dashpot.commands.design_files import controller_toml, spec_toml
    from dashpot.commands.design_report import report

    (folder / "design.json").write_text(text + "\n", encoding="utf-8")
    (folder / "spec.toml").write_text(spec_toml(result, needed), encoding="utf-8")
    (folder / "report.html").write_text(report(result, needed, options, folder, files), encoding="utf-8")
    if result.feasible:  # nothing that could be run by mistake where a joint has no gains
        (folder / "controller.toml").write_text(controller_toml(result, options), encoding="utf-8")


def _table(result: Design, needed: list[Duty]) -> dict[str, Any]:
    """The design as JSON, in SI units; null is what is not finite or does not apply."""
    spec, first = result.spec, needed[0]
    table: dict[str, Any] = {
        "dashpot": dashpot.__version__,
        "robot": result.robot,
        "feasible": result.feasible,
        "preset": spec.preset,
        "means": {name: getattr(spec, name) for name in MEANS}
        | {
            "period": first.period,
            "latency": first.latency,
            "latency_max": first.latency_max,
            "sampling": first.sampling,
        },
        "joints": [_joint_table(joint) for joint in result.joints],
    }
    finite: dict[str, Any] = _finite(table)
    return finite


def _joint_table(joint: JointDesign) -> dict[str, Any]:
    found, duty = joint.found, joint.duty
    row: dict[str, Any] = {
        "name": joint.name,
        "gains": None,
        "wishes": asdict(joint.wishes),
        "carries": {"inertia": duty.inertia, "inertia_with_payload": duty.loaded, "load": duty.load},
        "predicted": dict(joint.predicted),
        "assured": dict(joint.assured),
        "stop_time_with_larger_swings": joint.stop_late,
        "certificate": None,
        "binding": [],
        "trade_off": None,
        "conflict": None if joint.conflict is None else _conflict_table(joint.conflict),
        "candidates": joint.candidates,
        "exact_tests": joint.asked,
    }
    if found is not None:
        gains = found.gains.joint(joint.name)
        row["gains"] = {name: getattr(gains, name) for name in ("R", "D", "K", "kp", "kd")}
        row["binding"] = list(found.binding)
        row["certificate"] = {
            "margin": found.margin,
            "index_of_the_drive_alone": found.bare,
            "worst_index": found.certificate.worst.value,
            "worst_point": dict(found.certificate.point),
            "brake_worst_index": None if found.brake is None else found.brake.worst.value,
        }
    if joint.trade_off is not None:
        curve = joint.trade_off
        row["trade_off"] = {
            "quantities": [joint.wishes.minimise, curve.against],
            "front": [[float(a), float(b)] for a, b in zip(curve.wish, curve.other, strict=True)],
            "certified": [[float(a), float(b)] for a, b in curve.all],
        }
    return row


def _conflict_table(conflict: Conflict) -> dict[str, Any]:
    return {
        "wishes": list(conflict.wishes),
        "shortfalls": [asdict(shortfall) for shortfall in conflict.shortfalls],
        "change": conflict.change or None,
        "tried_in_vain": list(conflict.tried),
        "reason": conflict.reason or None,
    }


def _finite(value: Any) -> Any:
    """The same with null for numbers that JSON does not know."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
