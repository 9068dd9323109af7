"""What an identification gives: values with intervals, refusals, and the fit behind them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dashpot.support.arrays import Floats

UNITS: Mapping[str, str] = {
    "rotor_inertia": "kg m^2",
    "viscous_friction": "N m s/rad",
    "coulomb_friction": "N m",
    "stribeck_friction": "N m",
    "stribeck_velocity": "rad/s",
    "torque_bias": "N m",
    "torque_scale_error": "-",
    "latency": "s",
    "stiffness": "N m/rad",
    "damping": "N m s/rad",
}
"""What can be identified, with its unit; names and definitions are those of `dashpot.arm.drive.Drive`."""


@dataclass(frozen=True)
class Estimate:
    """One identified quantity.

    Attributes:
        value: In `unit`.
        low: Lower end of the 95 % interval.
        high: Upper end.
        unit: SI.
    """

    value: float
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class Refusal:
    """Quantities the log cannot tell.

    Attributes:
        quantities: Keys of `UNITS`: these cannot be separated from each other, or not be seen at all.
        reason: One line: what is the matter with the log.
        motion: One line: which motion, or which argument, would do.
    """

    quantities: tuple[str, ...]
    reason: str
    motion: str


@dataclass(frozen=True)
class Fit:
    """Motor torque as commanded and as the identified rotor explains it, both smoothed by the same kernel.

    Attributes:
        time: (w,) centres of the windows [s].
        measured: (w,) commanded torque, delayed by the latency found [N m].
        predicted: (w,) ``alpha (tau_s - b) + m q'' + v q' + friction`` [N m].
        residual: (w,) measured minus predicted [N m].
        used: (w,) whether the window was used; windows near standstill or reversal are not.
        residual_std: Of the residual of the windows used [N m].
        samples: Number of samples of the log in them.
        kernel: Standard deviation of the Gaussian kernel [s].
    """

    time: Floats
    measured: Floats
    predicted: Floats
    residual: Floats
    used: NDArray[np.bool_]
    residual_std: float
    samples: int
    kernel: float


@dataclass(frozen=True)
class DriveEstimate:
    """What a log tells about one joint's drive.

    Attributes:
        joint: Its name.
        values: Identified quantities, keys of `UNITS`.
        refused: What was asked for and cannot be told; empty: everything was identified.
        fit: The rotor's equation at the estimate, or None where the log was refused as a whole.
    """

    joint: str
    values: Mapping[str, Estimate]
    refused: tuple[Refusal, ...]
    fit: Fit | None
