"""Passivity index of a sampled joint: how much damping it shows at its port, at the worst frequency."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dashpot.arm.drive import Drive
from dashpot.certify.exact import Rest, at_rest, crossings, positive, quadratic_form, unfit
from dashpot.certify.joint import SampledJoint, Scales, holds_torque, sampled_joint
from dashpot.certify.port import Port, lift, without_equilibria
from dashpot.certify.threads import one_thread
from dashpot.control.sampled import empty_block
from dashpot.support.arrays import Floats

COARSE_INTERVALS, FIRST_INTERVALS, MOST_INTERVALS = 4, 8, 64
SETTLED = 0.01  # relative difference between N intervals and the limit at which N is enough
RESOLUTION = 1e-3  # of the index, relative
ROUNDS = 60
SPEED_IN_SAMPLE = (
    "point samples without a sensor filter also contain the link's velocity, which no finite index covers "
    "(the value leaves it out): average the torque over the period, or filter it"
)
GRID = np.concatenate(
    [np.geomspace(1e-7, 1e-4, 5)[:-1], np.geomspace(1e-4, 0.08, 20), np.linspace(0.1, np.pi, 28)]
)
BOTTOM = 1e6  # how far below the grid's value the exact test is followed, relative
AROUND = np.array([-3.0, -1.0, -0.3, 0.0, 0.3, 1.0, 3.0])  # a pole, in its distance from the circle
NO_DAMPING = (
    "without transmission damping nothing is left at high frequency: give `damping` in the robot file; a low "
    "guess is the safe one"
)
CONSTANT_TORQUE = (
    "it holds a constant torque, which drives whatever yields (a free load up to torque over friction); by "
    "itself it makes nothing oscillate"
)
BEYOND = "its numbers are too large, too small or too far apart to be judged"


@dataclass(frozen=True)
class Index:
    """Passivity index: the joint's surplus of damping at its port.

    Attributes:
        value: Largest level with ``Re G >= level`` at all frequencies, from below to twice `RESOLUTION`
            [N m s/rad]; -inf: the joint itself is unstable.
        frequency: Where it is attained [Hz], folded into 0 to half the sample rate; half the sample rate
            where it is the transmission's damping, approached at ever higher frequencies.
        intervals: Sub-intervals N at which the lifted port agrees.
        remainder: What the index at N lies above the limit [N m s/rad].
        decided: Whether the tests agree: where ``value`` is positive a storage function was found that proves
            the port passive, and no lifted port lies below it.
        reason: In words, where ``value`` is not a finite, decided number.
    """

    value: float
    frequency: float
    intervals: int
    remainder: float
    decided: bool
    reason: str = ""

    @property
    def passive(self) -> bool:
        """Whether the port is certainly passive."""
        return self.decided and self.value > 0


@one_thread
def passivity_index(
    drive: Drive,
    block: NDArray[np.void],
    sampling: str,
    period: float,
    scales: Scales = Scales(),  # noqa: B008 - frozen
) -> Index:
    """Index of a sampled joint.

    A grid of lifted ports gives an upper bound; the exact test (`dashpot.certify.exact`) then closes in on
    the largest level for which a storage function exists. N is doubled until the lifted port confirms it.

    Args:
        drive: The joint's drive.
        block: Its controller, a record of `dashpot.control.sampled.BLOCK_DTYPE`.
        sampling: "average" or "point".
        period: [s].
        scales: Departures of the signal path from nominal.

    Raises:
        InputError: A coefficient is not finite, or the sensor's latency is not a whole number of samples.
    """
    if holds_torque(block):
        bare = passivity_index(drive, empty_block(), sampling, period)
        return replace(bare, decided=False, reason=CONSTANT_TORQUE)
    joint = sampled_joint(drive, block, sampling, period, scales)
    with np.errstate(all="ignore"):
        try:
            return _index(joint, drive)
        except (np.linalg.LinAlgError, ValueError):  # not finite somewhere
            return Index(-np.inf, 0.0, 0, np.inf, False, BEYOND)


def _index(joint: SampledJoint, drive: Drive) -> Index:
    rest = at_rest(joint)
    reason = unfit(rest)
    if reason:
        return Index(-np.inf, 0.0, 0, 0.0, True, reason)
    ports = {N: settled(joint, rest, N) for N in (FIRST_INTERVALS, 2 * FIRST_INTERVALS)}
    upper, angle = _least(settled(joint, rest, COARSE_INTERVALS), rest)
    lowest, found = _closest_level(joint, rest, upper, angle, ports)
    if np.isnan(lowest):
        return Index(-np.inf, 0.0, 0, np.inf, False, BEYOND)
    total, proven, reason = lowest + drive.link_friction, True, ""
    if total > 0:  # the level that counts; below it rounding matters less than next to the limit
        form = quadratic_form(joint, min(lowest, 0.0), rest)
        proven = form is not None and positive(form)
        reason = "" if proven else "no storage function was found; the value is an upper bound"
    angle, intervals, remainder = _confirm(joint, rest, lowest, angle, found, ports)
    tolerance = 10 * RESOLUTION * max(abs(lowest), 1e-3 * drive.damping) + 1e-12 * joint.units[-1]
    above = min(upper - lowest, remainder)
    if above < -tolerance:
        proven, reason = False, f"grid and exact test disagree by {-above:.3g} N m s/rad"
        total += above  # the grid's value, an upper bound
    if lowest >= (1 - 3 * RESOLUTION) * drive.damping:
        angle = np.pi
    if drive.damping == 0 and not reason:
        reason = NO_DAMPING if total <= 0 else ""
    if joint.speed_in_sample:
        proven, reason = False, SPEED_IN_SAMPLE
    return Index(total, angle / (2 * np.pi * joint.period), intervals, remainder, proven, reason)


def _least(port: Port, rest: Rest) -> tuple[float, float]:
    """Least damping of a lifted port, and its angle: on a grid and around the held joint's poles."""
    angles = np.concatenate([GRID, *(abs(np.angle(z)) + (1 - abs(z)) * AROUND for z in rest.poles)])
    angles = np.unique(angles[(angles >= GRID[0]) & (angles <= np.pi)])
    at = int(port.least_damping(angles).argmin())
    near = np.linspace(angles[max(at - 1, 0)], angles[min(at + 1, len(angles) - 1)], 19)
    around = port.least_damping(near)
    return float(around.min()), float(near[around.argmin()])


def settled(joint: SampledJoint, rest: Rest, intervals: int) -> Port:
    """The lifted port without its equilibria."""
    port = lift(joint, intervals)
    if rest.shape is None or rest.momentum is None:
        return port
    return without_equilibria(port, rest.shape, rest.momentum)


def _closest_level(
    joint: SampledJoint, rest: Rest, upper: float, angle: float, ports: dict[int, Port]
) -> tuple[float, Floats]:
    """Largest level without crossings, from below; and the crossings just above it."""
    ceiling = -joint.torque_w * (1 - RESOLUTION)
    scale = abs(joint.torque_w) + 1e-9 * float(joint.units[len(joint.flow) - 1])

    def crossed(level: float) -> Floats | None:
        form = quadratic_form(joint, level, rest)
        if form is None:
            return np.zeros(0)
        found = crossings(form)
        return found if len(found) else None

    guess = min(float(_limit(ports, np.array([angle]))[0]), upper, ceiling)
    finest = RESOLUTION * max(abs(guess), 1e-3 * scale)
    if guess >= ceiling:
        above = crossed(ceiling)
        if above is None:
            return ceiling, np.zeros(0)
        low, high, step = ceiling - finest, ceiling, finest
    else:
        low, high, step, above = guess - finest, np.inf, finest, np.zeros(0)
    for _ in range(ROUNDS):  # down to a level without crossings
        found = crossed(low)
        if found is None:
            break
        high, above = low, found
        step *= 4
        low -= step
        if low < upper - BOTTOM * max(abs(upper), scale):  # a pole of the controller all but on the circle
            return upper, np.zeros(0)
    trial = low + 2 * finest
    for _ in range(ROUNDS):  # and up again
        if high - low <= 2 * RESOLUTION * max(abs(low), 1e-3 * scale) or trial >= ceiling:
            break
        found = crossed(trial)
        if found is None:
            low = trial
        else:
            high, above = trial, found
        finest *= 2
        trial = (low + high) / 2 if np.isfinite(high) else low + 2 * finest
    return low, above


def _confirm(
    joint: SampledJoint, rest: Rest, level: float, angle: float, found: Floats, ports: dict[int, Port]
) -> tuple[float, int, float]:
    """Angle of the minimum, N at which a lifted port confirms the level, and what it is above it."""
    edges = np.concatenate([[0.0], found, [np.pi]])
    tried = np.clip(np.concatenate([[angle], (edges[1:] + edges[:-1]) / 2]), 1e-6, np.pi)
    tried = tried[[int(_limit(ports, tried).argmin())]]
    intervals = FIRST_INTERVALS
    while True:
        port = ports.get(intervals) or settled(joint, rest, intervals)
        remainder = float(port.least_damping(tried)[0]) - level
        if remainder <= SETTLED * abs(level) or 2 * intervals > MOST_INTERVALS:
            return float(tried[0]), intervals, remainder
        intervals *= 2


def _limit(ports: dict[int, Port], angles: Floats) -> Floats:
    """Least damping at some angles for N to infinity, estimated: the error of N intervals falls as 1/N^2."""
    first, second = (ports[N].least_damping(angles) for N in (FIRST_INTERVALS, 2 * FIRST_INTERVALS))
    return np.asarray(second - np.maximum(first - second, 0.0) / 3)
