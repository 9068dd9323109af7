"""What a log cannot tell: which quantities, why, and the motion that would do.

Two things make a quantity unusable: its interval is too wide, or a model error too small to be noticed would
move it too far. Both are ellipsoids about the estimate. Scaled by the widths that are allowed, the long axes
of their sum are the combinations of quantities that the motion does not separate.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dashpot.identify.estimate import Refusal
from dashpot.support.arrays import Floats

# Largest half-widths. `certify` takes relative ones into its box: beyond these nothing is left to certify.
RELATIVE: Mapping[str, float] = {
    "rotor_inertia": 0.2,
    "viscous_friction": 0.5,
    "coulomb_friction": 0.5,
    "stiffness": 0.2,
    "damping": 0.5,
}
NEGLIGIBLE = 0.02  # of the torque's standard deviation: friction this uncertain does not matter to the motion
BIAS = 0.05  # of the torque's standard deviation
SCALE = 0.1  # [-]; a torque channel with more is not worth closing a loop on
LATENCY = 1.0  # [periods]; certify counts whole ones
MODEL_ERROR = 5e-4  # of the torque's standard deviation: what no residual would show
TRUST = 5e-5  # of the torque's standard deviation: standard error of what happens between the samples
MISFIT = 0.25  # residual over the torque's standard deviation: more is not this equation
FEWEST = 25.0  # independent windows; fewer leave the interval's width to chance
SHORTEST = 2.0  # [s] of log
SATURATED = 0.5  # share of windows with a command beyond the drive's limit
PARTNER = 0.2  # of the largest part in a direction: quantities above it are mixed in it

ALL = (
    "rotor_inertia",
    "viscous_friction",
    "coulomb_friction",
    "torque_bias",
    "torque_scale_error",
    "latency",
)
"""Quantities of the rotor's equation."""
CORE = ALL[:3]
"""Where two of these cannot be told, the rest is not trusted either: weak instruments bend what they show."""
GENERAL = "a sum of sine waves at several speeds, both ways, in gravity: dashpot excite"


@dataclass(frozen=True)
class Seen:
    """What the motion was like, to say what is missing.

    Attributes:
        speed: Standard deviation over the windows used [rad/s].
        slow: Slowest of |speed|, 5 % quantile [rad/s].
        fast: Fastest, 95 % quantile [rad/s].
        acceleration: Standard deviation [rad/s^2].
        acceleration_noise: Of one window [rad/s^2].
        forwards: Share of windows moving forwards.
        torque: Standard deviation of the sensed torque [N m].
        duration: Of the windows used [s].
    """

    speed: float
    slow: float
    fast: float
    acceleration: float
    acceleration_noise: float
    forwards: float
    torque: float
    duration: float


def directions(
    names: Sequence[str], widths: Mapping[str, float], half: Floats
) -> list[tuple[tuple[str, ...], tuple[str, ...], float]]:
    """Directions in which quantities are too uncertain: (refused, mixed with, how much too wide).

    Args:
        names: Quantities, n.
        widths: Largest allowed half-width of each.
        half: (n, n) matrix whose diagonal holds the squared half-widths.
    """
    allowed = np.array([max(widths[name], 1e-300) for name in names])
    scaled = half / np.outer(allowed, allowed)
    over = {name for name, value in zip(names, np.diag(scaled), strict=True) if not value <= 1}
    if not np.isfinite(scaled).all():
        return [(tuple(names), tuple(names), np.inf)]
    size, axes = np.linalg.eigh(scaled)
    parts = np.sqrt(np.maximum(size, 0.0)) * np.abs(axes)  # (quantity, direction), in allowed widths
    found: list[tuple[tuple[str, ...], tuple[str, ...], float]] = []
    main = {name: int(np.argmax(parts[i])) for i, name in enumerate(names) if name in over}
    for direction in sorted(set(main.values()), reverse=True):
        share = parts[:, direction]
        mixed = tuple(n for n, part in zip(names, share, strict=True) if part >= PARTNER * share.max())
        refused = tuple(n for n in names if main.get(n) == direction)
        found.append((refused, tuple(dict.fromkeys((*refused, *mixed))), float(share.max())))
    return found


def misaligned(refused: tuple[str, ...], seen: Seen) -> Refusal:
    """Why torque and motion cannot even be aligned in time."""
    if seen.fast < 1.5 * seen.slow:
        way = "" if 0 < seen.forwards < 1 else ", one way"
        return Refusal(
            refused,
            f"all speeds lie between {seen.slow:.2g} and {seen.fast:.2g} rad/s{way}: inertia cannot be "
            "seen, and the "
            "frictions look alike",
            f"accelerate, both ways and between {0.2 * seen.fast:.2g} and {seen.fast:.2g} rad/s: dashpot "
            "excite",
        )
    if seen.acceleration < 3 * seen.acceleration_noise:
        return Refusal(
            refused,
            f"the acceleration, {seen.acceleration:.2g} rad/s^2, is hidden by its noise",
            f"accelerate at {10 * seen.acceleration_noise:.2g} rad/s^2 or more, or use a finer encoder",
        )
    return Refusal(refused, "torque and motion cannot be aligned in time", f"move more, faster; {GENERAL}")


def explain(refused: tuple[str, ...], mixed: tuple[str, ...], excess: float, seen: Seen) -> Refusal:
    """The refusal of a direction."""
    sets = set(mixed)
    if seen.forwards in (0.0, 1.0) and sets & {"coulomb_friction", "torque_bias"}:
        way = "forwards" if seen.forwards else "backwards"
        return Refusal(
            refused,
            f"the rotor only turns {way}: Coulomb friction and sensor bias look alike",
            "move both ways through the same speeds",
        )
    if "rotor_inertia" in sets and seen.acceleration < 3 * seen.acceleration_noise:
        return Refusal(
            refused,
            f"the acceleration, {seen.acceleration:.2g} rad/s^2, is hidden by its noise, "
            f"{seen.acceleration_noise:.2g} rad/s^2: inertia cannot be seen",
            f"accelerate at 10 x {seen.acceleration_noise:.2g} rad/s^2 or more, or use a finer encoder",
        )
    if {"rotor_inertia", "torque_scale_error"} <= sets:
        return Refusal(
            refused,
            "the sensed torque hardly differs from the link's inertia times its acceleration: rotor inertia "
            "and "
            "sensor scale look alike",
            "hang a weight or move in gravity; or give the sensor's scale error: --scale",
        )
    if {"viscous_friction", "coulomb_friction"} <= sets and seen.fast < 1.5 * seen.slow:
        return Refusal(
            refused,
            f"all speeds lie between {seen.slow:.2g} and {seen.fast:.2g} rad/s: viscous and Coulomb "
            "friction look alike",
            f"move at {0.3 * seen.fast:.2g} rad/s as well as at {seen.fast:.2g} rad/s",
        )
    if {"torque_scale_error", "torque_bias"} <= sets:
        return Refusal(
            refused,
            f"the sensed torque hardly changes, by {seen.torque:.2g} N m: scale and bias of the sensor look "
            "alike",
            "load the joint with a torque that changes: hang a weight or move in gravity; or give --scale",
        )
    if refused == ("latency",):
        return Refusal(
            refused, "the torque changes too slowly to time it", "move faster, or with steeper accelerations"
        )
    if refused == ("rotor_inertia",):
        return Refusal(
            refused,
            f"accelerations of {seen.acceleration:.2g} rad/s^2 hardly show in the torque",
            f"accelerate at {seen.acceleration * min(2 * excess, 100):.2g} rad/s^2 or more",
        )
    listed = ", ".join(mixed)
    if len(mixed) == 1:
        reason = f"its interval is {min(excess, 1e6):.2g} times as wide as is useful"
        return Refusal(refused, f"{listed}: {reason}", f"a longer, livelier motion; {GENERAL}")
    return Refusal(refused, f"this motion does not separate {listed}", GENERAL)
