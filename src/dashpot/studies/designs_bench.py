"""One designed joint in the simulator: how it stops, creeps and errs, to hold predictions against."""

from __future__ import annotations

import math
import tempfile
import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dashpot.arm.plant import Plant, build
from dashpot.arm.robot import Robot
from dashpot.certify.loads import Load
from dashpot.certify.testbench import write
from dashpot.control.controller import Controller, JointGains
from dashpot.design.candidates import Duty, stopped
from dashpot.errors import InputWarning
from dashpot.simulation.recording import Recording
from dashpot.simulation.simulate import Event, Scenario, run
from dashpot.simulation.trajectory import Trajectory, hold
from dashpot.support.arrays import Floats

STEP = 5e-5  # [s], longest physics step; at 2e-4 a swing that just stops may last 40 % longer
RUN_UP, EVEN, WATCH = 0.4, 0.8, 4.0  # [s] of speeding up, of moving on evenly, and of watching
MOVER = 12.0  # [rad/s], of the position loop that moves a joint until its encoder is taken away
SETTLING, MEAN = 6.0, 1.0  # [s] of creep before its speed is taken, and of its average
PERIODS, SWING, PERIOD = 3, 0.3, 4.0  # of the slow motion under load: number, amplitude [rad], duration [s]


@dataclass(frozen=True)
class Bench:
    """A joint with a rigid link about a vertical axis, in the simulator.

    Attributes:
        plant: The joint with the loaded link's inertia.
        controller: Its controller.
        name: The joint.
        duty: What it was designed for.
    """

    plant: Plant
    controller: Controller
    name: str
    duty: Duty


def bench(duty: Duty, gains: JointGains, inertia: float | None = None) -> Bench:
    """Builds the bench, sensor noise, limits and friction included.

    Args:
        duty: What the joint was designed for.
        gains: Its gains.
        inertia: Of the link [kg m^2]; None: the largest it was designed for.
    """
    config = duty.config((gains,))
    load = Load("inertia", duty.loaded if inertia is None else inertia)
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        robot, _ = write(Path(folder), load, duty.drive, gains, config)
        arm = Robot.load(robot)
        return Bench(
            build(arm, duty.period / math.ceil(duty.period / STEP)),
            Controller.from_config(config, arm.drives),
            duty.drive.name,
            duty,
        )


def _run(on: Bench, path: Trajectory, external: Floats, events: list[Event], seed: int) -> Recording:
    return run(Scenario(on.plant, on.controller, path, events, external[:, None], seed))


def stop(duty: Duty, gains: JointGains, seed: int, inertia: float | None = None) -> tuple[float, float]:
    """Takes the encoder away in even motion: (speed at that moment [rad/s], time to stop [s]).

    A stiff position loop moves the joint until then; the brake that takes over is the design's.
    """
    J = duty.loaded if inertia is None else inertia
    total = J + duty.drive.rotor_inertia
    on = bench(duty, replace(gains, kp=total * MOVER**2, kd=2 * total * MOVER), J)
    t = duty.period * np.arange(round((RUN_UP + EVEN + WATCH) / duty.period))
    share = np.clip(t / RUN_UP, 0, 1)
    speed = duty.speed * share**2 * (3 - 2 * share)
    rate = duty.speed * 6 * share * (1 - share) / RUN_UP
    angle = np.cumsum(speed) * duty.period
    path = Trajectory(duty.period, angle[:, None], speed[:, None], rate[:, None])
    free = RUN_UP + EVEN
    events = [
        Event(0.0, on.name, "mode", "bypass"),
        Event(free, on.name, "mode", "active"),
        Event(free, on.name, "position_loop", False),
        Event(free, on.name, "warm_start"),
    ]
    recording = _run(on, path, np.zeros(len(t)), events, seed)
    first = round(free / duty.period)
    before = float(recording.link_velocity[first - round(0.05 / duty.period) : first, 0].mean())
    after = recording.link_velocity[first:, :1]
    return before, float(
        stopped(duty.period * np.arange(len(after), dtype=float), after, duty.residual * before)[0]
    )


def creep(on: Bench, load: float, seed: int, *, settling: float = SETTLING) -> float:
    """Speed at which a constant load moves the brake in the end [rad/s]."""
    path = hold([0.0], settling + MEAN, on.duty.period)
    events = [Event(0.0, on.name, "position_loop", False)]
    recording = _run(on, path, np.full(len(path.position), load), events, seed)
    link = recording.link_position[:, 0]
    last = round(MEAN / on.duty.period)
    return float((link[-1] - link[-1 - last]) / (last * on.duty.period))


def load_error(on: Bench, load: float, seed: int, *, bypass: bool = False) -> float:
    """Mean position error of the rotor under a constant load, in slow motion to and fro [rad]."""
    duty = on.duty
    t = duty.period * np.arange(round((PERIODS + 1) * PERIOD / duty.period))
    omega = 2 * math.pi / PERIOD
    swing = SWING * np.sin(omega * t)[:, None]
    rate = SWING * omega * np.cos(omega * t)[:, None]
    path = Trajectory(duty.period, swing, rate, -(omega**2) * swing)
    events = [Event(0.0, on.name, "mode", "bypass")] if bypass else []
    recording = _run(on, path, np.full(len(t), load), events, seed)
    last = round(PERIODS * PERIOD / duty.period)
    error = (recording.position - recording.reference)[-last:, 0]
    return float(error.mean())
