"""Random drives with their duties for `dashpot.studies.designs`, each from (seed, number) alone."""

from __future__ import annotations

import math

import numpy as np

from dashpot.design.candidates import Duty
from dashpot.drive import Drive


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
