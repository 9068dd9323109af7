"""Logs built to be uninformative: what each hides, and the simulated motion that hides it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from dashpot.control.controller import Controller
from dashpot.control.sampled import VELOCITY_REF, empty_block, pd_block
from dashpot.logs.log import Log, Segment
from dashpot.simulation.recording import Recording
from dashpot.simulation.simulate import Scenario, run
from dashpot.simulation.trajectory import Trajectory
from dashpot.studies.identification_cases import Bench, random_bench, to_log
from dashpot.support.arrays import Floats

SECONDS = 20.0
RIGID = 20.0
EVERYTHING = ("rotor_inertia", "viscous_friction", "coulomb_friction", "torque_bias", "torque_scale_error")
FRICTIONS = ("viscous_friction", "coulomb_friction")


@dataclass(frozen=True)
class Blind:
    """A kind of uninformative log.

    Attributes:
        hidden: Quantities of which every one must be refused.
        make: Log from a bench and a random generator.
        weight: Gravity torque over the bench's own.
        rigid: Whether the transmission is too stiff, and friction too small, to shake the link: vibration of
            the transmission tells what the motion itself hides.
    """

    hidden: tuple[str, ...]
    make: Callable[[Bench, np.random.Generator], Log]
    weight: float = 1.0
    rigid: bool = False

    def bench(self, seed: int, number: int) -> Bench:
        """A random drive with smooth friction."""
        bench = random_bench(seed, number)
        drive = replace(bench.drive, stribeck_friction=0.0, stribeck_velocity=0.0)
        if self.rigid:
            drive = replace(
                drive,
                stiffness=RIGID**2 * drive.stiffness,
                damping=RIGID * drive.damping,
                coulomb_friction=drive.coulomb_friction / RIGID,
                hysteresis=0.0,
            )
        return replace(bench, drive=drive, weight=bench.weight * self.weight)


def _path(bench: Bench, position: Callable[[Floats], Floats], seconds: float = SECONDS) -> Trajectory:
    time = bench.period * np.arange(round(seconds / bench.period), dtype=np.float64)
    q = position(time)[:, None]
    speed = np.gradient(q[:, 0], bench.period)[:, None]
    return Trajectory(bench.period, q, speed, np.gradient(speed[:, 0], bench.period)[:, None])


def _follow(bench: Bench, path: Trajectory, rng: np.random.Generator, stiff: float = 1.0) -> Recording:
    drive = bench.drive
    m, total = drive.rotor_inertia, drive.rotor_inertia + bench.inertia
    omega = 2 * math.pi * 2.0
    kd = stiff * min(1.6 * total * omega, 0.3 * m / ((bench.latency + 1) * bench.period + 2e-3))
    block = pd_block(min(total * omega**2, 0.5 * kd * omega), kd)
    block["torque_limit"], block["latency"] = drive.torque_limit, bench.latency
    controller = Controller(np.array([block]), (drive.name,), bench.period, bench.sampling)
    return run(Scenario(bench.plant(), controller, path, seed=int(rng.integers(2**31))))


def _push(bench: Bench, torque: Callable[[Floats], Floats], rng: np.random.Generator) -> Recording:
    time = bench.period * np.arange(round(SECONDS / bench.period), dtype=np.float64)
    rest = np.zeros((len(time), 1))
    block = empty_block()
    block["D"][VELOCITY_REF] = 1.0
    controller = Controller(np.array([block]), (bench.drive.name,), bench.period, bench.sampling)
    path = Trajectory(bench.period, rest, torque(time)[:, None], rest)
    return run(Scenario(bench.plant(), controller, path, seed=int(rng.integers(2**31))))


def _cut(log: Log, *spans: tuple[float, float]) -> Log:
    """The log inside some spans of time [s]."""
    segment, parts = log.segments[0], []
    for low, high in spans:
        keep = (segment.time >= low) & (segment.time < high)
        parts.append(
            Segment(
                segment.time[keep],
                segment.command[keep],
                segment.torque[keep],
                None if segment.position is None else segment.position[keep],
                None,
                None if segment.link_position is None else segment.link_position[keep],
            )
        )
    return replace(log, segments=tuple(parts))


def _sines(
    rng: np.random.Generator, amplitude: float, band: tuple[float, float]
) -> Callable[[Floats], Floats]:
    tones = [(f, rng.uniform(0, 2 * math.pi)) for f in rng.uniform(*band, 4)]
    return lambda t: np.asarray(sum(amplitude / 4 * np.sin(2 * math.pi * f * t + p) for f, p in tones))


def _standstill(b: Bench, rng: np.random.Generator) -> Log:
    at = rng.uniform(-0.5, 0.5)
    return to_log(b, _follow(b, _path(b, lambda t: at + 0 * t), rng))


def _one_speed(b: Bench, rng: np.random.Generator) -> Log:
    w = rng.uniform(0.3, 1.0)
    return _cut(to_log(b, _follow(b, _path(b, lambda t: w * t), rng)), (8, 20))


def _one_speed_both_ways(b: Bench, rng: np.random.Generator) -> Log:
    w = rng.uniform(0.3, 1.0)
    back = _path(b, lambda t: w * np.where(t < 12, t, 24 - t), 24)
    return _cut(to_log(b, _follow(b, back, rng)), (6, 11.8), (18, 23.8))


def _one_way(b: Bench, rng: np.random.Generator) -> Log:
    wave = _sines(rng, 0.15, (0.2, 0.6))
    w = 2 * math.pi * 0.6 * 0.15 + 0.7
    return _cut(to_log(b, _follow(b, _path(b, lambda t: w * t + wave(t)), rng)), (2, 20))


def _no_load(b: Bench, rng: np.random.Generator) -> Log:
    return to_log(b, _follow(b, _path(b, _sines(rng, 0.8, (0.2, 1.5))), rng))


def _one_tone(b: Bench, rng: np.random.Generator) -> Log:
    f = rng.uniform(0.8, 1.2)
    return _cut(
        to_log(b, _follow(b, _path(b, lambda t: 0.12 * np.sin(2 * math.pi * f * t)), rng, 2.0)), (4, 20)
    )


def _short(b: Bench, rng: np.random.Generator) -> Log:
    return _cut(_no_load(b, rng), (5, 5 + rng.uniform(0.3, 1.5)))


def _saturated(b: Bench, rng: np.random.Generator) -> Log:
    log = _no_load(b, rng)
    over = 30 * b.drive.torque_limit
    segment = log.segments[0]
    asked = np.where(segment.command > np.median(segment.command), over, -over)
    return replace(log, segments=(replace(segment, command=asked),))


def _noisy(b: Bench, rng: np.random.Generator) -> Log:
    loud = replace(b, drive=replace(b.drive, torque_noise=min(20 * (b.weight + b.inertia), 900.0)))
    return to_log(loud, _follow(loud, _path(b, _sines(rng, 0.4, (0.2, 1.0))), rng))


def _coarse(b: Bench, rng: np.random.Generator) -> Log:
    rough = replace(b, drive=replace(b.drive, position_resolution=0.02))
    return to_log(rough, _follow(rough, _path(b, _sines(rng, 0.15, (0.2, 0.6))), rng, 0.3))


def _constant_torque(b: Bench, rng: np.random.Generator) -> Log:
    return to_log(b, _push(b, lambda t: 0 * t + 1.5 * b.drive.coulomb_friction, rng))


def _dead_sensor(b: Bench, rng: np.random.Generator) -> Log:
    log = _no_load(b, rng)
    segment = log.segments[0]
    return replace(log, segments=(replace(segment, torque=0 * segment.torque + rng.normal()),))


def _creep(b: Bench, rng: np.random.Generator) -> Log:
    w, f = rng.uniform(0.02, 0.05), rng.uniform(0.03, 0.06)
    return to_log(b, _follow(b, _path(b, lambda t: w / (2 * math.pi * f) * np.sin(2 * math.pi * f * t)), rng))


def _stuck(b: Bench, rng: np.random.Generator) -> Log:
    f = rng.uniform(0.3, 1.0)
    size = 0.7 * b.drive.coulomb_friction
    return to_log(b, _push(b, lambda t: size * np.sin(2 * math.pi * f * t), rng))


KINDS = {
    "standstill": Blind(EVERYTHING, _standstill),
    "one speed, one way": Blind(EVERYTHING[:3], _one_speed, 0.02),
    "one speed, both ways": Blind(EVERYTHING[:3], _one_speed_both_ways, 0.02),
    "one way": Blind(("coulomb_friction", "torque_bias"), _one_way, 0.1),
    "no load but inertia": Blind(("rotor_inertia", "torque_scale_error"), _no_load, 0.0, True),
    "one small sine wave": Blind(("rotor_inertia", "torque_scale_error"), _one_tone, 1.0, True),
    "too short": Blind(EVERYTHING, _short),
    "command beyond the limit": Blind(EVERYTHING, _saturated),
    "noise": Blind(("rotor_inertia", *FRICTIONS), _noisy),
    "coarse encoder": Blind(("rotor_inertia",), _coarse),
    "constant torque": Blind(EVERYTHING, _constant_torque),
    "dead torque sensor": Blind(EVERYTHING, _dead_sensor),
    "creeping": Blind(("rotor_inertia",), _creep, 1.0, True),
    "stuck in friction": Blind(EVERYTHING, _stuck),
}
"""Name -> kind."""
