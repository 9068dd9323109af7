"""``dashpot simulate``."""

from __future__ import annotations

import math
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dashpot.arm.payload import Payload
from dashpot.arm.plant import Plant, build, with_payload
from dashpot.arm.robot import MAX_ANGLE, Robot
from dashpot.certify.testbench import tap
from dashpot.control.controller import Controller, load_controller
from dashpot.errors import InputError, InputWarning
from dashpot.logs import check_log_path, write_log
from dashpot.logs.log import from_recording
from dashpot.logs.motionfile import read_motion
from dashpot.logs.runlog import write_run
from dashpot.simulation.feedforward import with_feedforward
from dashpot.simulation.release import release_events, tracking_events
from dashpot.simulation.simulate import Event, Scenario, run
from dashpot.simulation.trace import run_traced
from dashpot.simulation.trajectory import Trajectory, hold, multisine
from dashpot.support.limits import check_seed
from dashpot.support.output import whole_folder
from dashpot.support.plots import save
from dashpot.support.waiting import waiting

if TYPE_CHECKING:
    from dashpot.cli.simulate import Simulate

from dashpot.commands.aside import run_aside
from dashpot.commands.payload import payload_of, payload_offset
from dashpot.commands.shared import check_file_place, clock
from dashpot.commands.simulate_faults import marks, of_faults, read_changes, read_faults
from dashpot.commands.simulate_view import draw, show
from dashpot.simulation.engine import quiet_engine

LOGGED = 1e-4  # [s], longest step of the engine for a log
LEAD_IN = 1.0  # [s] at rest before a motion
DURATION = 6.0  # [s] of a motion that does not say
MAX_TAP = 1e5  # [N m], as of campaigns
MAX_TICKS = 1_000_000  # of one recording: about 1 GB of memory for seven joints


def simulate(options: Simulate) -> int:
    """``dashpot simulate``; returns the exit status: 1 if the simulation diverged."""
    _check(options)
    if options.log is not None:
        check_log_path(options.log, "--log")
        check_file_place(options.log, "--log", made=options.out)
    quiet_engine()
    robot, config = Robot.load(options.robot), load_controller(options.controller)
    carried = options.gravity_compensation and robot.gravity_compensation
    controller = Controller.from_config(config, robot.drives)
    payload = payload_of(options.payload, options.offset)
    # A log stands for the real thing, whose friction and damping do not depend on a time step.
    step = config.period if options.log is None else config.period / math.ceil(config.period / LOGGED)
    plant = build(robot, step, [payload] if payload.mass > 0 else [])
    path = _path(options, robot, config.period)
    path = with_feedforward(robot, config, path, carried=carried)
    _warn_of_range(plant, path, options)
    _warn_of_saturation(plant, path, payload, carried)
    faults, changes = read_faults(options.fault, robot), read_changes(options.payload_at, payload)
    for change in changes:
        if change.payload is not None:
            loaded = with_payload(plant, change.payload, config.period)
            _warn_of_saturation(loaded, path, change.payload, carried)
    for name in options.bypass:
        if name not in (*controller.joints, "all"):
            rule = f"not controlled here; controlled: {', '.join(controller.joints)}; or all"
            raise InputError(rule, quantity="--bypass", value=name)
    bypassed = controller.joints if "all" in options.bypass else options.bypass
    events = [Event(path.start, joint, "mode", "bypass") for joint in bypassed]
    events += tracking_events(config, path.start, bypassed)
    if options.release is not None:
        if not 0 <= options.release < path.time[-1]:  # also catches NaN
            raise InputError(
                f"must be within the motion, 0 to {path.time[-1]:g} s",
                quantity="--release [s]",
                value=options.release,
            )
        events += release_events(config, options.release, bypassed)
    with whole_folder(options.out) as folder, of_faults():
        external = tap(path, len(robot.drives), options.tap) if options.tap else None
        scenario = Scenario(
            plant,
            controller,
            path,
            events,
            external,
            options.seed,
            faults=faults,
            payload_changes=changes,
            supervisor=config.supervisor if options.supervise else None,
            gravity_compensation=carried,
        )
        traced = options.log is not None and options.log.suffix.lower() == ".mcap"
        with clock("simulating", path.time[-1] - path.time[0]) as advance:
            recording, trace = run_aside(
                lambda: run_traced(scenario, advance) if traced else (run(scenario, advance), None)
            )
        recording.settings |= {
            "controller": str(options.controller),
            "payload_kg": options.payload,
            "offset_m": payload.position.tolist(),
            "tap_nm": options.tap,
        }
        if options.release is not None:
            recording.settings["release"] = options.release
        marked = marks(robot, faults, changes, recording)
        with waiting("writing and drawing"):
            recording.save(folder / "recording.npz")
            save(draw(recording, controller, options, marked), folder / "simulate")
    if options.log is not None:
        log = from_recording(
            recording,
            controller.sampling,
            drives=robot.drives,
            trajectory=path,
            controlled=controller.joints,
        )
        # Last: it may be in the folder that has just been replaced.
        with waiting("writing the log"):
            if trace is None:
                write_log(log, options.log)
            else:
                write_run(options.log, log, recording, trace, robot, config, path)
    show(recording, robot, controller, plant, options, marked)
    return 1 if recording.diverged_at is not None else 0


def _check(options: Simulate) -> None:
    offset = payload_offset(options.offset)
    if not np.isfinite(offset).all():
        raise InputError("must be finite", quantity="--offset [m]", value=offset)
    if not abs(options.tap) <= MAX_TAP:  # also catches NaN
        rule = f"must be {-MAX_TAP:g} to {MAX_TAP:g} N m"
        raise InputError(rule, quantity="--tap [N m]", value=options.tap)
    check_seed(options.seed)
    for key, unit, low, high in (
        ("payload", "kg", 0.0, math.inf),
        ("amplitude", "rad", 0.0, MAX_ANGLE),
        ("duration", "s", 0.0, math.inf),
    ):
        value = getattr(options, key)
        if value is None:
            continue
        rule = ""
        if isinstance(value, float) and not math.isfinite(value):
            rule = "must be finite"
        elif value < low or (key == "duration" and value == 0):
            rule = "must be positive" if key == "duration" else "must not be negative"
        elif value > high:
            rule = f"must be at most {high:.4g} {unit}; check the unit"
        if rule:
            raise InputError(rule, quantity=f"--{key} [{unit}]", value=value)


def _path(options: Simulate, robot: Robot, period: float) -> Trajectory:
    if options.motion not in ("multisine", "hold"):
        return _from_file(options, robot, period)
    duration = DURATION if options.duration is None else options.duration
    if duration > MAX_TICKS * period:
        raise InputError(
            f"must be at most {MAX_TICKS * period:g} s, {MAX_TICKS} ticks of {period:g} s",
            quantity="--duration [s]",
            value=duration,
        )
    if options.motion == "hold":
        return hold(robot.home, duration, period)
    return multisine(robot.home, duration, period, options.seed, amplitude=options.amplitude, lead_in=LEAD_IN)


def _from_file(options: Simulate, robot: Robot, period: float) -> Trajectory:
    path = Path(options.motion)
    if not path.exists():
        raise InputError(
            'must be "multisine", "hold" or a CSV file, and there is no such file',
            quantity="--motion",
            value=options.motion,
        )
    return read_motion(path, robot, period, lead_in=LEAD_IN, duration=options.duration, most=MAX_TICKS)


def _warn_of_range(plant: Plant, path: Trajectory, options: Simulate) -> None:
    """Warns of joints whose reference leaves the range in the model."""
    for drive, record, q in zip(plant.robot.drives, plant.drives, path.position.T, strict=True):
        lower, upper = float(record["stop_lower"]), float(record["stop_upper"])
        if q.min() < lower or q.max() > upper:
            named = options.motion in ("multisine", "hold")
            message = InputError(
                f"runs into a stop: the motion covers {q.min():.3g} to {q.max():.3g} rad, the joint may "
                f"move from {lower:.4g} to {upper:.4g} rad; "
                + ("lower it or change home" if named else "change the motion"),
                file=plant.robot.file,
                joint=drive.name,
                quantity="--amplitude [rad]" if named else "--motion",
                value=options.amplitude if named else options.motion,
            )
            warnings.warn(str(message), InputWarning, stacklevel=2)


def _warn_of_saturation(plant: Plant, path: Trajectory, payload: Payload, carried: bool) -> None:
    """Warns of joints whose motor cannot hold the load somewhere along the path."""
    some = path.position[:: max(1, len(path.position) // 50)]
    torque = np.array([plant.load_torque(q) for q in some])
    if carried:  # the limit is that of the command
        bare = with_payload(plant, None, path.period)
        torque -= [bare.load_torque(q) for q in some]
    load = np.abs(torque).max(0)
    for drive, torque in zip(plant.robot.drives, load, strict=True):
        if torque > drive.torque_limit:
            if payload.mass > 0:
                rule, quantity, value = "saturates the motor: holding it", "payload [kg]", payload.mass
                advice = f", torque_limit is {drive.torque_limit:g} N m; use a lighter payload"
            else:
                rule, quantity, value = (
                    "too low: the arm's own weight",
                    "torque_limit [N m]",
                    drive.torque_limit,
                )
                advice = "; check the masses in the model"
            message = InputError(
                f"{rule} takes up to {torque:.3g} N m{advice} or a pose that carries less",
                file=plant.robot.file,
                joint=drive.name,
                quantity=quantity,
                value=value,
            )
            warnings.warn(str(message), InputWarning, stacklevel=2)
