"""What ``dashpot run`` knows before there is a link: files, motion, and whether the flags make sense."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dashpot.arm.drive import Drive
from dashpot.arm.robot import Robot
from dashpot.commands.payload import payload_of
from dashpot.commands.shared import check_file_place
from dashpot.control.controller import Controller, ControllerConfig, load_controller
from dashpot.control.supervisor import Supervisor
from dashpot.errors import InputError
from dashpot.logs import check_log_path
from dashpot.logs.motionfile import read_motion
from dashpot.simulation.feedforward import with_feedforward
from dashpot.simulation.release import tracking_events
from dashpot.simulation.trajectory import Trajectory, hold
from dashpot.support.limits import check_seed

if TYPE_CHECKING:
    from dashpot.arm.plant import Plant
    from dashpot.cli.deploy import Run

SIMULATED = 10.0  # [s] that a simulated arm is held where nobody says
LONGEST = 600.0  # [s] of a simulated run: its whole motion is in memory
MOST_SAMPLES = 100_000
LEAD_IN = 1.0  # [s] at rest before a motion


@dataclass(frozen=True)
class Job:
    """All that is known before there is a link.

    Attributes:
        robot: The arm.
        config: Of the controller.
        supervisor: With the controller that will run.
        drives: Of its joints, in its order.
        plant: Model with payload; None: the robot has none.
        path: Motion of all joints of the robot, or None: the arm is held where it is.
        ranges: Joint -> range [rad].
    """

    robot: Robot
    config: ControllerConfig
    supervisor: Supervisor
    drives: tuple[Drive, ...]
    plant: Plant | None
    path: Trajectory | None
    ranges: dict[str, tuple[float, float]]

    @property
    def controller(self) -> Controller:
        """What will run."""
        return self.supervisor.controller

    @property
    def columns(self) -> list[int]:
        """Of the controller's joints among the robot's."""
        return [self.robot.index(name) for name in self.controller.joints]

    @property
    def motion(self) -> Trajectory | None:
        """The motion of the controller's joints."""
        if self.path is None:
            return None
        parts: dict[str, Any] = {
            key: getattr(self.path, key)[:, self.columns] for key in ("position", "velocity", "acceleration")
        }
        torque = None if self.path.torque is None else self.path.torque[:, self.columns]
        return replace(self.path, **parts, torque=torque)


def check_options(options: Run) -> None:
    """Refuses flags that do not go together, and values that nothing can be done with."""
    simulated = options.via == "sim"
    for key, given in (
        ("--fault", options.fault),
        ("--payload-at", options.payload_at),
        ("--lock-step", options.lock_step),
        ("--record", options.record),
    ):
        if given and not simulated:
            raise InputError("is for --via sim: a robot is as it is", quantity=key)
    if options.host and simulated:
        raise InputError("is for a robot; --via says which", quantity="--host", value=options.host)
    if options.duration is not None and not (math.isfinite(options.duration) and options.duration > 0):
        raise InputError("must be positive", quantity="--duration [s]", value=options.duration)
    if options.certificate is not None and options.uncertified:
        raise InputError("is not looked at with --uncertified; leave one out", quantity="--certificate")
    if not 10 <= options.samples <= MOST_SAMPLES:
        raise InputError(f"must be 10 to {MOST_SAMPLES}", quantity="--samples", value=options.samples)
    own = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else range(os.cpu_count() or 1)
    if options.cpu is not None and options.cpu not in own:
        rule = f"not a processor that this process may use: {', '.join(map(str, sorted(own)))}"
        raise InputError(rule, quantity="--cpu", value=options.cpu)
    check_seed(options.seed)
    if not 0 <= options.priority <= 99:
        raise InputError("must be 0 (none) to 99", quantity="--priority", value=options.priority)
    for key, file, suffix in (("--log", options.log, ".mcap"), ("--record", options.record, ".npz")):
        if file is None:
            continue
        if file.suffix.lower() != suffix:
            raise InputError(f"must end in {suffix}", quantity=key, value=str(file))
        check_file_place(file, key)
    if options.log is not None:
        check_log_path(options.log, "--log")


def prepare(options: Run) -> Job:
    """Reads the files and puts together what will run; there is no link yet."""
    robot, config = Robot.load(options.robot), load_controller(options.controller)
    controller = Controller.from_config(config, robot.drives)
    drives = tuple(robot.drives[robot.index(name)] for name in controller.joints)
    plant, ranges = None, {}
    if robot.model is not None or options.via == "sim":
        from dashpot.arm.plant import build
        from dashpot.simulation.prepare import encoder_ranges

        load = payload_of(options.payload, options.offset)
        plant = build(robot, config.period, [load] if load.mass > 0 else [])
        ranges = encoder_ranges(plant)
    supervisor = Supervisor(controller, robot.drives, config.supervisor, limits=ranges)
    path = _path(options, robot, config)
    for event in tracking_events(config, 0.0):
        controller.set_mode(event.joint, "bypass")
    return Job(robot, config, supervisor, drives, plant, path, ranges)


def _path(options: Run, robot: Robot, config: ControllerConfig) -> Trajectory | None:
    duration = options.duration
    if options.via == "sim":
        duration = duration or (SIMULATED if options.motion == "hold" else None)
        if duration is not None and duration > LONGEST:
            raise InputError(
                f"must be at most {LONGEST:g} s where the arm is simulated",
                quantity="--duration [s]",
                value=duration,
            )
    if options.motion == "hold":
        if options.via != "sim":
            return None
        path = hold(robot.home, duration or SIMULATED, config.period)
    elif not Path(options.motion).exists():
        raise InputError(
            'must be "hold" or a CSV file, and there is no such file',
            quantity="--motion",
            value=options.motion,
        )
    else:
        most = round(LONGEST / config.period)
        path = read_motion(
            Path(options.motion), robot, config.period, lead_in=LEAD_IN, duration=duration, most=most
        )
    return with_feedforward(robot, config, path, carried=robot.gravity_compensation)
