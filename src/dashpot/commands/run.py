"""``dashpot run``: the controller on a robot, or on a simulated one behind the same interface."""

from __future__ import annotations

import importlib
import math
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dashpot.arm.drive import Drive
from dashpot.arm.payload import Payload
from dashpot.arm.robot import Robot
from dashpot.certify.certificate import Certificate, certify_joint, paired
from dashpot.commands.run_view import show_checks, show_measures, show_outcome
from dashpot.commands.shared import payload_offset, progress
from dashpot.control.controller import Controller, ControllerConfig, load_controller
from dashpot.control.rivals.tracking import PDGravity
from dashpot.control.supervisor import Supervisor
from dashpot.errors import DashpotError, InputError
from dashpot.hardware.checks import Verdicts, at_rest, before_link, listen
from dashpot.hardware.interface import Hardware, carries_weight
from dashpot.hardware.realtime import undisturbed
from dashpot.hardware.ring import Ring
from dashpot.hardware.runtime import LoopSettings, Outcome, Start, control, joint_order, said
from dashpot.hardware.scribe import Notes, scribe
from dashpot.logs.motionfile import read_motion
from dashpot.simulation.engine import quiet_engine
from dashpot.simulation.feedforward import with_feedforward
from dashpot.simulation.release import tracking_events
from dashpot.simulation.simulate import Scenario
from dashpot.simulation.trajectory import Trajectory, hold
from dashpot.support.arrays import Floats

if TYPE_CHECKING:
    from dashpot.arm.plant import Plant
    from dashpot.cli.deploy import Run

SIMULATED = 10.0  # [s] that a simulated arm is held where nobody says
LONGEST = 600.0  # [s] of a simulated run: its whole motion is in memory
MOST_SAMPLES = 100_000
LEAD_IN = 1.0  # [s] at rest before a motion
SPARE = 1.0  # [s] that a simulated arm can go on for, besides a stop


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


def run(options: Run) -> int:
    """``dashpot run``; returns the exit status."""
    _check(options)
    quiet_engine()
    job = _prepare(options)
    verdicts = None if options.uncertified else _verdicts(options, job)
    settings = job.supervisor.settings
    checks = before_link(
        job.drives, job.config, job.controller, verdicts, settings, path=job.motion, ranges=job.ranges
    )
    failed = any(check.passed is False for check in checks)
    if failed and not options.check:
        show_checks(checks, options)
        return 1
    with _connected(options, job) as (hardware, start):
        joint_order(hardware, job.controller)
        _refuse_gravity_twice(hardware, job)
        # Without a clock a sample more is another run: what the sensors say is looked at with --check only.
        if options.check or not options.lock_step:
            with undisturbed(0 if options.lock_step else options.priority, options.cpu):
                heard = listen(hardware, job.controller, options.samples)
            load = None
            if job.plant is not None:
                where = np.array(job.robot.home)
                where[job.columns] = heard.position.mean(0)
                load = _load(job, job.plant, hardware, where) if np.isfinite(where).all() else None
            # A simulated arm rests where its motion begins, sag included.
            path = None if options.via == "sim" else job.motion
            about: dict[str, Any] = {"path": path, "ranges": job.ranges, "load": load}
            about["realtime"] = not options.lock_step
            checks += at_rest(heard, job.drives, job.controller, settings, **about)
        show_checks(checks, options)
        failed = any(check.passed is False for check in checks)
        if options.check or failed:
            return 1 if failed else 0
        outcome = _run(options, job, hardware, start)
    show_outcome(outcome, job.controller, options)
    if outcome.end == "stopped":
        return 128 + (outcome.signal or signal.SIGINT)
    return 0 if outcome.end == "done" and not outcome.problems else 1


def _load(job: Job, plant: Plant, hardware: Hardware, where: Floats) -> Floats:
    """Torque of gravity that the sensors show at a pose (n,) [rad], per controlled joint [N m]."""
    from dashpot.arm.plant import build

    load = plant.load_torque(where)
    if carries_weight(hardware):
        load -= build(job.robot, job.config.period).load_torque(where)
    return np.asarray(load[job.columns])


def _refuse_gravity_twice(hardware: Hardware, job: Job) -> None:
    """Checks that no law adds the weight of an arm that carries it itself."""
    if not carries_weight(hardware) or job.robot.gravity_compensation:  # known: the law leaves it out
        return
    for law in job.config.joints:
        if isinstance(law, PDGravity):
            raise InputError(
                f"adds gravity, which this robot does itself; say gravity_compensation = true in "
                f"{job.robot.file}",
                file=job.config.file,
                joint=law.name,
                quantity="law",
            )


def _run(options: Run, job: Job, hardware: Hardware, start: Start | None) -> Outcome:
    terminal = sys.stderr.isatty()
    limits = tuple(float(drive.torque_limit) for drive in job.drives)
    about = (
        ("robot", job.robot.name),
        ("controller", str(options.controller)),
        ("sampling", job.controller.sampling),
    )
    log = "" if options.log is None else str(options.log.resolve())
    names = job.controller.joints
    notes = Notes(
        names,
        job.controller.period,
        limits,
        log,
        terminal and not options.lock_step,
        not options.lock_step,
        about,
    )
    ring = Ring() if log or notes.live else None
    settings = LoopSettings(
        priority=0 if options.lock_step else options.priority, cpu=options.cpu, flow=options.lock_step
    )
    duration = options.duration
    if duration is not None and job.path is not None:
        duration = None  # the path has been cut to it
    motion = job.motion
    means: dict[str, Any] = {"duration": duration, "start": start, "settings": settings}
    if ring is None:
        return control(hardware, job.supervisor, motion, **means)
    outcome: Outcome | None = None
    try:
        with scribe(ring, notes):
            outcome = control(hardware, job.supervisor, motion, **means, ring=ring.memory)
    except DashpotError as error:  # of the log; how the run ended is worth more
        if outcome is None:
            raise
        outcome = replace(outcome, problems=(*outcome.problems, str(error)))
    return outcome


def _check(options: Run) -> None:
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
    if options.cpu is not None and options.cpu < 0:
        raise InputError("must not be negative", quantity="--cpu", value=options.cpu)
    if options.seed < 0:
        raise InputError("must not be negative", quantity="--seed", value=options.seed)
    if not 0 <= options.priority <= 99:
        raise InputError("must be 0 (none) to 99", quantity="--priority", value=options.priority)
    for key, file, suffix in (("--log", options.log, ".mcap"), ("--record", options.record, ".npz")):
        if file is None:
            continue
        if file.suffix.lower() != suffix:
            raise InputError(f"must end in {suffix}", quantity=key, value=str(file))
        if file.is_dir():
            raise InputError("is a folder", quantity=key, value=str(file))
        if not os.access(file.parent, os.W_OK):
            raise InputError("is in no folder that can be written", quantity=key, value=str(file))


def _prepare(options: Run) -> Job:
    robot, config = Robot.load(options.robot), load_controller(options.controller)
    controller = Controller.from_config(config, robot.drives)
    drives = tuple(robot.drives[robot.index(name)] for name in controller.joints)
    plant, ranges = None, {}
    if robot.model is not None or options.via == "sim":
        from dashpot.arm.plant import build
        from dashpot.simulation.prepare import encoder_ranges

        load = Payload(options.payload, payload_offset(options.offset))
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


def _verdicts(options: Run, job: Job) -> Verdicts:
    if options.certificate is not None:
        return Verdicts.load(options.certificate)
    pairs = paired(job.robot, job.config)
    with progress("certifying", len(pairs)) as advance:
        joints = []
        for drive, law in pairs:
            joints.append(certify_joint(drive, law, job.config))
            advance()
    return Verdicts.of(Certificate(job.robot.name, tuple(joints), ()).table())


@contextmanager
def _connected(options: Run, job: Job) -> Iterator[tuple[Hardware, Start | None]]:
    """The robot, and where the controller starts if that is known without asking it."""
    if options.via == "sim":
        hardware, start = _simulated(options, job)
    else:
        hardware, start = _robot(options, job), None
    try:
        yield hardware, start
    finally:
        hardware.stop()


def _simulated(options: Run, job: Job) -> tuple[Hardware, Start | None]:
    from dashpot.commands.simulate_faults import read_changes, read_faults
    from dashpot.hardware.sim import LinkSettings, SimHardware

    path, plant = job.path, job.plant
    assert path is not None
    assert plant is not None
    stop = job.supervisor.settings
    after = stop.stop_time + stop.release_time + SPARE
    link = LinkSettings(realtime=not options.lock_step, record=options.record)
    scenario = Scenario(
        plant,
        Controller.from_config(job.config, job.robot.drives),
        standing(path, after + link.after),
        tracking_events(job.config, path.start),
        seed=options.seed,
        faults=read_faults(options.fault),
        payload_changes=read_changes(
            options.payload_at, Payload(options.payload, payload_offset(options.offset))
        ),
        gravity_compensation=True,
    )
    from dashpot.simulation.prepare import check

    check(scenario)
    hardware = SimHardware(scenario, link, supervisor=job.supervisor)
    return hardware, hardware.equilibrium()


def standing(path: Trajectory, time: float) -> Trajectory:
    """A motion that stands at its end for some more time [s]."""
    ticks = math.ceil(time / path.period)

    def longer(array: Any, still: bool) -> Any:
        last = np.zeros_like(array[-1:]) if still else array[-1:]
        return np.vstack([array, last.repeat(ticks, 0)])

    return replace(
        path,
        position=longer(path.position, False),
        velocity=longer(path.velocity, True),
        acceleration=longer(path.acceleration, True),
        torque=None if path.torque is None else longer(path.torque, False),
    )


def _robot(options: Run, job: Job) -> Hardware:
    """The adapter of ``--via``: pylibfranka's, or ``module:Class`` called with host and robot."""
    if options.via == "franka":
        if not options.host:
            raise InputError("is needed: the robot's address, e.g. --host 172.16.0.2", quantity="--host")
        module, name = "dashpot.hardware.franka", "FrankaHardware"
    else:
        module, _, name = options.via.partition(":")
    if not module or not name:
        raise InputError(
            "must be sim, franka, or module:Class, the adapter of your robot",
            quantity="--via",
            value=options.via,
        )
    sys.path.insert(0, "")  # a module in the current folder, as `python -m` finds it
    try:
        made = getattr(importlib.import_module(module), name)(options.host, job.robot)
    except DashpotError:
        raise
    except ModuleNotFoundError as error:
        raise InputError(
            f"cannot be imported: {error}"
            + ("; pip install 'dashpot[franka]'" if options.via == "franka" else ""),
            quantity="--via",
            value=options.via,
        ) from None
    except Exception as error:
        raise InputError(f"cannot be made: {said(error)}", quantity="--via", value=options.via) from None
    finally:
        sys.path.remove("")
    if not isinstance(made, Hardware):
        wanted = "joints, period, paced, reason, start, read, write, apply_brake and stop"
        raise InputError(f"lacks something; an adapter has {wanted}", quantity="--via", value=options.via)
    return made


__all__ = ["run", "show_measures", "standing"]
