"""Sums of sine waves about a mean pose, at rest at home at both ends."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dashpot.arm.robot import Robot
from dashpot.support.arrays import Floats

RAMP = 1.5  # [s], of each end


@dataclass(frozen=True)
class Tones:
    """One joint's mean pose and sine waves, before the ramp."""

    frequency: Floats  # (k,) [Hz]
    amplitude: Floats  # (k,) [rad]
    phase: Floats  # (k,) [rad]
    centre: float = 0.0  # [rad], from home

    def scaled(self, factor: float) -> Tones:
        """The same motion, larger or smaller."""
        return Tones(self.frequency, factor * self.amplitude, self.phase, factor * self.centre)

    def about(self, centre: float) -> Tones:
        """The same sine waves about another pose."""
        return Tones(self.frequency, self.amplitude, self.phase, centre)


def ramp(t: Floats, duration: float) -> tuple[Floats, Floats, Floats]:
    """Quintic from 0 to 1 at the start and back at the end, with its first two derivatives."""
    length = min(RAMP, duration / 4)
    early = t < duration / 2
    s = np.clip(np.where(early, t, duration - t) / length, 0, 1)
    sign = np.where(early, 1.0, -1.0)
    r0 = s**3 * (10 - 15 * s + 6 * s**2)
    r1 = sign * 30 * s**2 * (1 - s) ** 2 / length
    r2 = 60 * s * (1 - s) * (1 - 2 * s) / length**2
    return r0, r1, r2


def motion(tones: Tones, t: Floats, duration: float) -> tuple[Floats, Floats, Floats]:
    """Angle from home, speed and acceleration, each (t,)."""
    omega = 2 * math.pi * tones.frequency
    angle = t[:, None] * omega + tones.phase
    w0 = tones.centre + np.sin(angle) @ tones.amplitude
    w1 = np.cos(angle) @ (omega * tones.amplitude)
    w2 = -np.sin(angle) @ (omega**2 * tones.amplitude)
    r0, r1, r2 = ramp(t, duration)
    return r0 * w0, r0 * w1 + r1 * w0, r0 * w2 + 2 * r1 * w1 + r2 * w0


def arm(robot: Robot, pick: dict[int, Tones], t: Floats, duration: float) -> tuple[Floats, Floats, Floats]:
    """Angles, speeds and accelerations of all joints, each (t, n)."""
    q, w, a = (np.zeros((len(t), len(robot.drives))) for _ in range(3))
    q += np.array(robot.home)
    for j, tones in pick.items():
        away, w[:, j], a[:, j] = motion(tones, t, duration)
        q[:, j] += away
    return q, w, a
