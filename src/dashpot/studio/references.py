"""References that go on for as long as they are asked for, smoothly from one motion into the next."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dashpot.simulation.trajectory import Trajectory
from dashpot.support.arrays import Floats

SPEED = 0.8  # [rad/s] that a move reaches at most, unless it begins faster
SHORTEST = 0.8  # [s] of a move
PEAK = 1.875  # largest speed of the quintic from rest to rest, over the mean one
LOOP = 20.0  # [s] after which a wander repeats
TONES = 3
BAND = (2, 8)  # of its tones, in turns per loop
RAMP = 2.0  # [s] over which it begins


class Reference(Protocol):
    """Where the arm is to be."""

    def at(self, ticks: NDArray[np.int64]) -> Floats:
        """Position, velocity, acceleration and torque reference, (4, k, n), at ticks since it began."""


@dataclass(frozen=True)
class Hold:
    """Rest at a pose (n,) [rad]."""

    pose: Floats

    def at(self, ticks: NDArray[np.int64]) -> Floats:
        """See `Reference`."""
        rows = np.zeros((4, len(ticks), len(self.pose)))
        rows[0] = self.pose
        return rows


@dataclass(frozen=True)
class Play:
    """A trajectory, then rest at its end."""

    trajectory: Trajectory

    def at(self, ticks: NDArray[np.int64]) -> Floats:
        """See `Reference`."""
        path = self.trajectory
        last = len(path.position) - 1
        now = np.minimum(ticks, last)
        torque = np.zeros_like(path.position[now]) if path.torque is None else path.torque[now]
        rows = np.stack([path.position[now], path.velocity[now], path.acceleration[now], torque])
        rows[1:3, ticks > last] = 0.0
        return rows


@dataclass(frozen=True)
class Move:
    """The quintic from a state of motion to rest at a target, then rest.

    Attributes:
        target: (n,) [rad].
        period: [s].
        duration: [s].
        terms: Its coefficients in powers of time, (6, n).
    """

    target: Floats
    period: float
    duration: float
    terms: Floats

    @classmethod
    def of(cls, start: Floats, target: Floats, period: float) -> Move:
        """From position, velocity and acceleration (3, n) to a target (n,), as fast as `SPEED` allows."""
        position, velocity, acceleration = start
        way = np.abs(target - position) + 0.5 * np.abs(velocity)
        T = max(SHORTEST, PEAK * float(way.max(initial=0.0)) / SPEED)
        ends = np.array(
            [
                target - position - velocity * T - acceleration * T**2 / 2,
                -velocity - acceleration * T,
                -acceleration,
            ]
        )
        powers = np.array(
            [
                [T**3, T**4, T**5],
                [3 * T**2, 4 * T**3, 5 * T**4],
                [6 * T, 12 * T**2, 20 * T**3],
            ]
        )
        rest = np.linalg.solve(powers, ends)
        terms = np.vstack([position, velocity, acceleration / 2, rest])
        return cls(np.array(target, float), period, T, terms)

    def at(self, ticks: NDArray[np.int64]) -> Floats:
        """See `Reference`."""
        t = ticks * self.period
        rows = np.zeros((4, len(t), len(self.target)))
        factor = np.ones(6)
        for row in range(3):  # the derivatives of sum terms[i] t^i
            for i in range(row, 6):
                rows[row] += np.multiply.outer(factor[i] * t ** (i - row), self.terms[i])
            factor = factor * (np.arange(6) - row)
        rows[0, t >= self.duration] = self.target
        rows[1:3, t >= self.duration] = 0.0
        return rows


@dataclass(frozen=True)
class Wander:
    """A smooth motion about a pose for ever: a few sine waves per joint, repeating after `LOOP` seconds.

    Attributes:
        pose: (n,) [rad].
        period: [s].
        size: Amplitudes, (TONES, n) [rad].
        omega: (TONES, n) [rad/s].
        phase: (TONES, n) [rad].
    """

    pose: Floats
    period: float
    size: Floats
    omega: Floats
    phase: Floats

    @classmethod
    def of(cls, pose: Floats, amplitude: Floats, period: float, seed: int) -> Wander:
        """Of a seed; amplitude (n,) [rad] is the most that any joint leaves the pose by."""
        rng, n = np.random.default_rng(seed), len(pose)
        turns = rng.integers(BAND[0], BAND[1] + 1, (TONES, n))
        phase = rng.uniform(0, 2 * math.pi, (TONES, n))
        share: Floats = np.array(rng.dirichlet(np.ones(TONES), n).T * amplitude, np.float64)
        return cls(
            np.array(pose, float),
            period,
            share,
            np.float64(2 * math.pi / LOOP) * turns.astype(np.float64),
            phase,
        )

    def at(self, ticks: NDArray[np.int64]) -> Floats:
        """See `Reference`."""
        t = ticks * self.period
        angle = self.omega[:, None] * np.mod(t, LOOP)[:, None] + self.phase[:, None]
        omega = self.omega[:, None]
        wave = [
            (self.size[:, None] * part).sum(0)
            for part in (np.sin(angle), omega * np.cos(angle), -(omega**2) * np.sin(angle))
        ]
        s = np.clip(t / RAMP, 0, 1)[:, None]
        r = s**3 * (10 - 15 * s + 6 * s**2)
        r1 = 30 * s**2 * (1 - s) ** 2 / RAMP
        r2 = 60 * s * (1 - s) * (1 - 2 * s) / RAMP**2
        return np.stack(
            [
                self.pose + r * wave[0],
                r * wave[1] + r1 * wave[0],
                r * wave[2] + 2 * r1 * wave[1] + r2 * wave[0],
                np.zeros_like(wave[0]),
            ]
        )


@dataclass(frozen=True)
class Then:
    """One reference for some ticks, then another, which must go on where the first is by then."""

    first: Reference
    ticks: int
    second: Reference

    def at(self, ticks: NDArray[np.int64]) -> Floats:
        """See `Reference`."""
        early = ticks < self.ticks
        if early.all():
            return self.first.at(ticks)
        if not early.any():
            return self.second.at(ticks - self.ticks)
        parts = self.first.at(ticks[early]), self.second.at(ticks[~early] - self.ticks)
        return np.concatenate(parts, axis=1)


def go_to(start: Floats, target: Floats, period: float) -> Reference:
    """A move from a state of motion (3, n) to a pose (n,) [rad], and rest there."""
    return Move.of(start, target, period)


def wander(start: Floats, pose: Floats, amplitude: Floats, period: float, seed: int) -> Reference:
    """A move to a pose (n,) [rad], and a `Wander` about it."""
    move = Move.of(start, pose, period)
    return Then(move, math.ceil(move.duration / period), Wander.of(pose, amplitude, period, seed))
