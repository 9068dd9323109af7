"""What `dashpot.studies.designs` looks at: random drives, and points over the whole range."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from scipy.stats import qmc

from dashpot.arm.drive import Drive
from dashpot.design.candidates import Duty
from dashpot.design.search import RANGES, ZETA, JointSearch
from dashpot.support.arrays import Floats

SPRUNG = (0.7, 8.0)  # zeta of the points that have a virtual spring


def scattered(
    search: JointSearch,
    points: int,
    ranges: Mapping[int, tuple[float, float]] = {},
    sprung: tuple[float, float] = SPRUNG,
) -> Floats:
    """Points of a low-discrepancy sequence over the range of a search, half of them with a spring, (k, 5).

    Args:
        search: Whose range it is.
        points: How many.
        ranges: Ends of coordinates that have another range.
        sprung: Ends of zeta.
    """
    axes = [axis for axis in RANGES if search.loop or axis in (0, 1)]
    spread = qmc.Halton(len(axes) + 1, scramble=False).random(points)
    at = np.zeros((points, 5))
    for i, axis in enumerate(axes):
        low, high = np.log(ranges[axis]) if axis in ranges else search.range(axis)
        at[:, axis] = low + spread[:, i] * (high - low)
    share = spread[:, -1]
    zeta = np.exp(np.interp(share, [0.5, 1.0], np.log(sprung)))
    at[:, ZETA] = np.where(share < 0.5, np.inf, zeta)
    return at


def random_duty(seed: int, number: int) -> Duty:
    """A torque-sensed joint of the usual kind and what it has to carry.

    Rotor inertia 0.03-3 kg m^2, a transmission that resonates at 100-400 rad/s with the link held, 2-6 % of
    critical damping, friction of 1-4 % of the torque limit, a link 0.3-5 times as heavy as the rotor;
    at 1 kHz behind a filter or averaged over 1-5 ms; up to one sample late.
    """
    rng = np.random.default_rng([seed, number])

    def log(low: float, high: float) -> float:
        return float(math.exp(rng.uniform(math.log(low), math.log(high))))

    m = log(0.03, 3)
    inertia = m * log(0.3, 2.5)
    loaded = inertia + m * log(0.1, 2.5)
    limit = (m + loaded) * log(15, 60)
    k = m * log(100, 400) ** 2
    average = bool(rng.random() < 0.5)
    period = float(rng.choice([0.001, 0.002, 0.004])) if average else 0.001
    late = int(rng.integers(0, 2))
    drive = Drive(
        f"drive{number}",
        rotor_inertia=m,
        viscous_friction=m * log(1, 10),
        coulomb_friction=limit * log(0.01, 0.04),
        stiffness=k,
        damping=2 * log(0.02, 0.06) * math.sqrt(k * m),
        torque_limit=limit,
        torque_noise=5e-4 * limit,
        torque_gain_error=float(rng.choice([0.005, 0.01, 0.02])),
        position_resolution=1e-5,
        sensor_bandwidth=None if average else log(100, 300),
        uncertainty={"rotor_inertia": 0.1, "viscous_friction": 0.2, "stiffness": 0.1, "damping": 0.3},
    )
    return Duty(
        drive,
        period=period,
        latency=late,
        latency_max=late,
        sampling="average" if average else "point",
        form="implicit",
        inertia=inertia,
        loaded=loaded,
        load=limit * float(rng.uniform(0.05, 0.25)),
        speed=0.5,
        residual=0.05,
        jump=0.02,
    )
