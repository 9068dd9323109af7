"""What a motion for identification must keep to."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dashpot.arm.plant import Plant
from dashpot.errors import InputError
from dashpot.support.arrays import Floats

STOP_MARGIN = 0.1  # [rad] kept from the model's stops
LEAST_AMPLITUDE = 0.01  # [rad] below which friction and play hide everything


@dataclass(frozen=True)
class Limits:
    """What a motion must keep to.

    Attributes:
        amplitude: Farthest from home [rad].
        speed: Fastest [rad/s].
        torque_share: Largest motor torque, as a share of each drive's ``torque_limit`` [-].
    """

    amplitude: float = 0.4
    speed: float = 0.5
    torque_share: float = 0.6

    def __post_init__(self) -> None:
        for key, unit, high in (
            ("amplitude", "rad", math.pi),
            ("speed", "rad/s", 10.0),
            ("torque_share", "-", 1.0),
        ):
            value = getattr(self, key)
            if not 0 < value <= high:  # also catches NaN
                said = "" if unit == "-" else unit
                raise InputError(
                    f"must be above 0 and at most {high:.4g} {said}".rstrip(),
                    quantity=f"--{key.replace('_', '-')}" + (f" [{said}]" if said else ""),
                    value=value,
                )


def ranges(plant: Plant, limits: Limits, moving: Sequence[int]) -> Floats:
    """Where each joint may go, (n, 2) [rad], symmetric about home.

    Raises:
        InputError: A moving joint has no room.
    """
    home = np.array(plant.robot.home)
    lower = plant.drives["stop_lower"] + STOP_MARGIN
    upper = plant.drives["stop_upper"] - STOP_MARGIN
    reach = np.minimum(np.minimum(home - lower, upper - home), limits.amplitude)
    for j in moving:
        if reach[j] < LEAST_AMPLITUDE:
            raise InputError(
                f"home is {max(reach[j] + STOP_MARGIN, 0):.3g} rad from a stop of the model, and a margin of "
                f"{STOP_MARGIN:g} rad is kept: choose another home, or leave the joint out with --joints",
                file=plant.robot.file,
                joint=plant.robot.joints[j],
                quantity="home [rad]",
                value=float(home[j]),
            )
    return np.stack([home - reach, home + reach], 1)


def check_weight(plants: Sequence[Plant], limits: Limits) -> None:
    """Refuses arms whose joints cannot hold still at home within their share of torque."""
    for plant in plants:
        weight = np.abs(plant.load_torque(np.array(plant.robot.home)))
        for drive, torque in zip(plant.robot.drives, weight, strict=True):
            if torque > limits.torque_share * drive.torque_limit:
                raise InputError(
                    f"holding still at home takes {torque:.3g} of {drive.torque_limit:g} N m: no motion "
                    "stays within the share; use a lighter payload, another home or a larger --torque-share",
                    file=plant.robot.file,
                    joint=drive.name,
                    quantity="--torque-share",
                    value=limits.torque_share,
                )
