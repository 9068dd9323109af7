"""Reference motions, sampled at the control period."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dashpot.errors import InputError
from dashpot.support.arrays import Floats


@dataclass(frozen=True)
class Trajectory:
    """References at the control ticks.

    Attributes:
        period: Control period [s].
        position: (ticks, n) [rad].
        velocity: (ticks, n) [rad/s].
        acceleration: (ticks, n) [rad/s^2].
        start: Time of the first tick [s]; negative times are a lead-in at rest.
        torque: Torque reference, added to the position loop's torque, (ticks, n) [N m]; None: zero.
    """

    period: float
    position: Floats
    velocity: Floats
    acceleration: Floats
    start: float = 0.0
    torque: Floats | None = None

    @property
    def ticks(self) -> int:
        """How many control ticks it has."""
        return len(self.position)

    @property
    def time(self) -> Floats:
        """(ticks,) [s]."""
        return self.start + self.period * np.arange(len(self.position), dtype=np.float64)

    def until(self, time: float) -> Trajectory:
        """The part before a time [s]."""
        keep = int(np.searchsorted(self.time, time - 1e-9))
        return replace(
            self,
            position=self.position[:keep],
            velocity=self.velocity[:keep],
            acceleration=self.acceleration[:keep],
            torque=None if self.torque is None else self.torque[:keep],
        )


def hold(pose: Sequence[float], duration: float, period: float) -> Trajectory:
    """Rest at a pose (n,) [rad] for a duration [s]."""
    position = np.tile(np.asarray(pose, float), (_ticks(duration, period), 1))
    return Trajectory(period, position, np.zeros_like(position), np.zeros_like(position))


def multisine(
    pose: Sequence[float],
    duration: float,
    period: float,
    seed: int,
    *,
    amplitude: float | Sequence[float] = 0.4,
    tones: int = 3,
    band: tuple[float, float] = (0.1, 0.4),
    ramp: float = 1.0,
    lead_in: float = 1.0,
    peak_speed_at: dict[int, float] | None = None,
) -> Trajectory:
    """A random smooth motion of all joints around a pose, starting and staying twice differentiable.

    ``q(t) = pose + r(t) sum_k A_k sin(2 pi f_k t + phi_k)``, with r a quintic ramp from 0 to 1.

    Args:
        pose: (n,) [rad].
        duration: Of the motion, after the lead-in [s].
        period: Control period [s].
        seed: Seed of frequencies, phases and shares of amplitude.
        amplitude: Sum of the amplitudes of the tones per joint, (n,) or a number [rad].
        tones: Sine waves per joint.
        band: Lowest and highest frequency [Hz].
        ramp: Duration of the ramp [s].
        lead_in: Time at rest before t = 0 [s].
        peak_speed_at: Joint index -> time [s] at which all its tones pass zero upwards, so that after
            the ramp no moment sees it move faster.
    """
    rng = np.random.default_rng(seed)
    n = len(pose)
    frequency = rng.uniform(*band, (tones, n))
    phase = rng.uniform(0, 2 * math.pi, (tones, n))
    share = rng.dirichlet(np.ones(tones), n).T * np.broadcast_to(np.asarray(amplitude, float), (n,))
    for joint, instant in (peak_speed_at or {}).items():
        phase[:, joint] = -2 * math.pi * frequency[:, joint] * instant
    t = period * np.arange(_ticks(lead_in + duration, period)) - lead_in
    angle = 2 * math.pi * frequency[:, None] * t[:, None] + phase[:, None]
    omega = 2 * math.pi * frequency[:, None]
    wave = np.stack(
        [
            (share[:, None] * part).sum(0)
            for part in (np.sin(angle), omega * np.cos(angle), -(omega**2) * np.sin(angle))
        ]
    )
    s = np.clip(t / ramp, 0, 1)[:, None]
    r0 = s**3 * (10 - 15 * s + 6 * s**2)
    r1 = 30 * s**2 * (1 - s) ** 2 / ramp
    r2 = 60 * s * (1 - s) * (1 - 2 * s) / ramp**2
    position = np.asarray(pose, float) + r0 * wave[0]
    velocity = r0 * wave[1] + r1 * wave[0]
    acceleration = r0 * wave[2] + 2 * r1 * wave[1] + r2 * wave[0]
    return Trajectory(period, position, velocity, acceleration, -lead_in)


def _ticks(duration: float, period: float) -> int:
    if not (math.isfinite(duration) and 0 < duration <= 1e5):
        raise InputError("must be positive and at most 1e5 s", quantity="duration [s]", value=duration)
    if not 0 < period <= duration * (1 + 1e-9):
        raise InputError(
            f"must be positive and at most the duration, {duration:g} s", quantity="period [s]", value=period
        )
    return round(duration / period)
