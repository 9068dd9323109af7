"""``dashpot identify``."""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dashpot.arm.robot import Robot
from dashpot.certify.threads import one_thread
from dashpot.commands.shared import check_place, file_names, progress
from dashpot.errors import InputError, InputWarning
from dashpot.identify import DriveEstimate, identify_joint
from dashpot.identify.weight import weight_aligned, without_transmission
from dashpot.identify.writeback import CONFIDENCE, bundled, too_wide, write_back
from dashpot.logs import Topics, read_log
from dashpot.logs.log import Log
from dashpot.support.output import whole_folder
from dashpot.support.waiting import waiting

if TYPE_CHECKING:
    from dashpot.cli.identify import Identify

ESSENTIAL = ("rotor_inertia", "viscous_friction", "coulomb_friction")
"""What a log must tell; without it the exit status is 1."""
MOST_SCALE = 0.5  # [-] relative error of a torque sensor


def identify(options: Identify) -> int:
    """``dashpot identify``; returns the exit status: 1 where something essential is refused."""
    robot = Robot.load(options.robot)
    _check(options, robot)
    topics = Topics(options.states, options.commands, options.links)
    with waiting("reading the log"):
        log = read_log(options.log, sampling=options.sampling, topics=topics)
    joints = _joints(options, log, robot)
    aligned = _without_weight(log, robot) if robot.gravity_compensation else None
    estimate = one_thread(identify_joint)
    with progress("identifying", 2 * len(joints)) as advance, whole_folder(options.out) as folder:
        estimates = []
        for joint in joints:
            drive = robot.drives[robot.index(joint)]
            found = estimate((aligned or log).only(joint), joint, drive, scale=options.scale)
            estimates.append(without_transmission(found) if aligned else found)
            advance()
        _draw(folder, estimates, robot, log, advance)
        written = _write(folder, options, robot, estimates, log)
        results = _table(options, robot, log, estimates, written)
        text = json.dumps(results, indent=2, allow_nan=False)
        (folder / "identify.json").write_text(text + "\n", encoding="utf-8")
    if options.in_place and written is not None:
        assert robot.file is not None
        write_back(robot, estimates, log, robot.file)
    if options.json:
        print(text)
    else:
        from dashpot.commands.identify_view import show

        show(estimates, robot, log, options, written)
    return 1 if lacking(estimates) else 0


def _without_weight(log: Log, robot: Robot) -> Log | None:
    """The log of a robot that carries its own weight, made ready; a warning where that cannot be."""
    aligned = weight_aligned(log, robot)
    if aligned is None:
        message = InputError(
            "needs the robot's model and the angles of all its joints in the log; without, viscous friction "
            "comes out wrong by the slope of the weight times the sensor's delay, and so does stiffness",
            file=robot.file,
            quantity="gravity_compensation",
        )
        warnings.warn(str(message), InputWarning, stacklevel=2)
    return aligned


def lacking(estimates: Sequence[DriveEstimate]) -> dict[str, tuple[str, ...]]:
    """Joints of which something essential is not known, and what."""
    missing = {
        estimate.joint: tuple(key for key in ESSENTIAL if key not in estimate.values)
        for estimate in estimates
    }
    return {joint: keys for joint, keys in missing.items() if keys}


def _check(options: Identify, robot: Robot) -> None:
    if options.scale is not None and not abs(options.scale) <= MOST_SCALE:  # also catches NaN
        raise InputError(
            f"must be -{MOST_SCALE:g} to {MOST_SCALE:g}; 0.01 reads 1 % too much",
            quantity="--scale [-]",
            value=options.scale,
        )
    if options.in_place and bundled(robot):
        raise InputError(
            "a bundled robot is not changed; without --in-place a new file is written",
            quantity="--in-place",
            value=options.robot,
        )
    check_place(options.out, (robot.file, robot.model, options.log))


def _joints(options: Identify, log: Log, robot: Robot) -> list[str]:
    """Joints of the log that the robot has, or those asked for."""
    both = [name for name in robot.joints if name in log.joints]
    wanted = list(dict.fromkeys(options.joint)) or both
    for name in wanted:
        if name not in both:
            where = "the robot" if name in log.joints else "the log"
            raise InputError(f"not in {where}; {_names(log, robot)}", quantity="--joint", value=name)
    if not wanted:
        raise InputError(f"log and robot share no joint; {_names(log, robot)}", file=log.file)
    return wanted


def _names(log: Log, robot: Robot) -> str:
    return f"log: {', '.join(log.joints)}; robot: {', '.join(robot.joints)}"


def _draw(
    folder: Path,
    estimates: Sequence[DriveEstimate],
    robot: Robot,
    log: Log,
    advance: Callable[[], None],
) -> None:
    from dashpot.commands.identify_plots import draw
    from dashpot.support.plots import save

    names = file_names([estimate.joint for estimate in estimates])
    for estimate in estimates:
        if estimate.fit is not None:
            save(
                draw(estimate, robot.drives[robot.index(estimate.joint)], log), folder / names[estimate.joint]
            )
        advance()


def _write(
    folder: Path, options: Identify, robot: Robot, estimates: Sequence[DriveEstimate], log: Log
) -> Path | None:
    """The new robot file, at its place in the end; None where there is nothing to write."""
    assert robot.file is not None
    if not any(estimate.values and not too_wide(estimate) for estimate in estimates):
        return None
    name = f"{robot.file.stem}.toml"
    write_back(robot, estimates, log, folder / name, place=options.out)
    return options.out / name


def _table(
    options: Identify, robot: Robot, log: Log, estimates: Sequence[DriveEstimate], written: Path | None
) -> dict[str, Any]:
    """The results as JSON."""
    return {
        "log": str(options.log),
        "sha256": log.digest,
        "robot": robot.name,
        "period": log.period,
        "seconds": log.duration,
        "sampling": log.sampling,
        "confidence": CONFIDENCE,
        "robot_file": None if written is None else str(written),
        "identified": not lacking(estimates),
        "joints": [_joint_table(estimate) for estimate in estimates],
    }


def _joint_table(estimate: DriveEstimate) -> dict[str, Any]:
    return {
        "name": estimate.joint,
        "values": {
            key: {
                "value": _finite(found.value),
                "low": _finite(found.low),
                "high": _finite(found.high),
                "unit": found.unit,
            }
            for key, found in estimate.values.items()
        },
        "refused": [
            {"quantities": list(refusal.quantities), "reason": refusal.reason, "motion": refusal.motion}
            for refusal in estimate.refused
        ],
        "samples": estimate.fit.samples if estimate.fit else 0,
        "residual_std": _finite(estimate.fit.residual_std) if estimate.fit else None,
    }


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
