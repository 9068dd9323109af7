"""The tables of docs/choosing.md: one gain, or one means, changed at a time, and what it does.

``python -m dashpot.studies.choices`` prints the first two. The joint is joint 2 of the bundled fr3 with its
bundled gains and 1 kg at 0.1 m, its own weight carried by the robot, in its worst pose; every figure but the
last column is what `dashpot design` predicts. ``python -m dashpot.studies.choices designs`` designs the joint
with other means, for docs/evidence/choices.json, of which `design_rows` makes the third table.
"""

from __future__ import annotations

import json
import math
import sys
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from dashpot.arm.robot import Robot
from dashpot.certify.certificate import certify_joint
from dashpot.control.controller import JointGains, load_controller
from dashpot.design import candidates as quantity
from dashpot.design.candidates import Duty, Gains
from dashpot.design.design import design_arm, duties
from dashpot.design.quantities import GAINS as NUMBERS
from dashpot.design.quantities import binding_text, predicted_text
from dashpot.design.spec import Spec
from dashpot.design.words import conflict_lines
from dashpot.errors import InputWarning
from dashpot.support.numbers import significant

JOINT = "joint2"
PAYLOAD, OFFSET = 1.0, (0.0, 0.0, 0.1)  # [kg], [m]
GAINS: tuple[tuple[str, dict[str, float]], ...] = (
    ("as bundled", {}),
    ("R x 0.3", {"R": 0.3}),
    ("R x 3", {"R": 3.0}),
    ("D x 0.3", {"D": 0.3}),
    ("D x 3", {"D": 3.0}),
    ("D x 10", {"D": 10.0}),
    ("kp x 0.3", {"kp": 0.3}),
    ("kp x 3", {"kp": 3.0}),
    ("kp x 30", {"kp": 30.0}),
    ("kd x 0.3", {"kd": 0.3}),
    ("kd x 3", {"kd": 3.0}),
    ("kp x 3, kd x 3", {"kp": 3.0, "kd": 3.0}),
    ("R x 3, D x 3", {"R": 3.0, "D": 3.0}),
    ("R x 3, D x 3, kd x 3", {"R": 3.0, "D": 3.0, "kd": 3.0}),
)
SPRINGS = (4.0, 20.0, 100.0)  # [N m/rad], K
MEANS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("as bundled: 1 ms, filtered point samples, implicit", {}),
    ("explicit form", {"form": "explicit"}),
    ("mean over the period", {"sampling": "average"}),
    ("point samples without filter", {"bandwidth": None}),
    ("sensor filter at 50 Hz", {"bandwidth": 50.0}),
    ("2 samples of latency", {"latency": 2, "latency_max": 2}),
    ("5 ms, mean over the period", {"period": 0.005, "sampling": "average"}),
    ("5 ms, mean over the period, explicit", {"period": 0.005, "sampling": "average", "form": "explicit"}),
    ("5 ms, filtered point samples", {"period": 0.005}),
    ("5 ms, sensor filter at 50 Hz", {"period": 0.005, "bandwidth": 50.0}),
)
FLAGS: tuple[dict[str, Any], ...] = (
    {},
    {"sampling": "average"},
    {"latency": 2},
    {"period": 0.002, "sampling": "average"},
    {"period": 0.005, "sampling": "average"},
    {"period": 0.005, "sampling": "average", "form": "explicit"},
    {"period": 0.005, "sampling": "point"},
)
HEAD = (
    "| | stop time [ms] | travel [deg] | holds [N m] | creep [deg/s] | error ratio | load error [deg] "
    "| noise [%] | worst index [N m s/rad] | certified | as brake |"
)


def wishes() -> Spec:
    """A tracker with the payload."""
    return Spec.load("track").changed(payload=PAYLOAD, offset=OFFSET, joints=(JOINT,))


def duty() -> tuple[Duty, JointGains]:
    """What the joint has to do, and its bundled gains."""
    gains = next(g for g in load_controller("fr3").gains if g.name == JOINT)
    return duties(Robot.load("fr3"), wishes())[0], gains


def row(label: str, given: Duty, gains: JointGains) -> str:
    """One row of Markdown: what the design predicts, and what the certificate says."""
    one = Gains.from_joint(gains)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        found = certify_joint(given.drive, gains, given.config((gains,)))
    stop = float(quantity.stop_time(given, one)[0])
    index = found.box.worst.value
    cells = (
        label,
        f"{1e3 * stop:.0f}" if math.isfinite(stop) else "never",
        _plain(np.degrees(quantity.travel(given, one)[0])),
        _plain(quantity.hold(given, one)[0]),
        _plain(np.degrees(quantity.creep(given, one)[0])),
        _plain(quantity.error_ratio(given, one)[0]),
        _plain(np.degrees(quantity.load_error(given, one)[0])),
        _plain(100 * quantity.noise(given, one)[0]),
        "unstable" if math.isinf(index) else _plain(index),
        "yes" if found.certified else "no",
        "yes" if found.brake is None or found.brake.proven else "no",
    )
    return f"| {' | '.join(cells)} |"


def _plain(value: float) -> str:
    """Two digits, but no power of ten."""
    return f"{value:.0f}" if abs(value) >= 10 else f"{value:.2g}"


def with_means(given: Duty, changes: dict[str, Any]) -> Duty:
    """The same joint with other sampling, form, latency, period or sensor filter (`bandwidth` [Hz])."""
    changes = dict(changes)
    if "bandwidth" in changes:
        given = replace(given, drive=replace(given.drive, sensor_bandwidth=changes.pop("bandwidth")))
    return replace(given, **changes)


def rows() -> Iterator[str]:
    """Both tables, a line of Markdown at a time."""
    given, gains = duty()
    yield f"{gains.text}; link {given.loaded:.2g} kg m^2, load {given.load:.3g} N m, {given.speed:g} rad/s"
    rule = "|" + "---|" * (HEAD.count("|") - 1)
    yield from ("", HEAD, rule)
    for label, factors in GAINS:
        changed = {name: factor * getattr(gains, name) for name, factor in factors.items()}
        yield row(label, given, replace(gains, **changed))
    for spring in SPRINGS:
        yield row(f"K = {spring:g} N m/rad", given, replace(gains, K=spring))
    yield from ("", HEAD, rule)
    for label, changes in MEANS:
        yield row(label, with_means(given, changes), gains)


def designed(flags: Mapping[str, Any]) -> dict[str, Any]:
    """What `dashpot design` makes of the joint with other means; for JSON."""
    (joint,) = design_arm(Robot.load("fr3"), wishes().changed(**flags)).joints
    if joint.found is None:
        return {"flags": dict(flags), "refused": conflict_lines(joint)}
    gains = joint.found.gains.joint(joint.name)
    limits, margin = joint.wishes.limits, joint.wishes.margin
    binding = [binding_text(name, limits, margin).removesuffix(" of limit") for name in joint.found.binding]
    return {
        "flags": dict(flags),
        "gains": {name: getattr(gains, name) for name in NUMBERS},
        "error_deg": significant(math.degrees(joint.predicted["load_error"])),
        "stop_ms": predicted_text(joint, "stop_time"),
        "limited_by": binding,
    }


def design_rows(made: Mapping[str, Any]) -> Iterator[str]:
    """The table of designs, a row of Markdown at a time."""
    for design in made["designs"]:
        flags = " ".join(f"--{name} {value}" for name, value in design["flags"].items())
        if "refused" in design:
            cells = ["-"] * 7 + [f"refused: {'; '.join(design['refused'][1:])}"]
        else:
            cells = [f"{value:g}" for value in design["gains"].values()]
            cells += [design["error_deg"], design["stop_ms"], ", ".join(design["limited_by"])]
        yield f"| {f'`{flags}`' if flags else 'none: 1 ms, filtered points'} | {' | '.join(cells)} |"


if __name__ == "__main__":
    if sys.argv[1:] == ["designs"]:
        found = [designed(flags) for flags in FLAGS]
        print(
            json.dumps({"command": "python -m dashpot.studies.choices designs", "designs": found}, indent=1)
        )
    else:
        for line in rows():
            print(line)
