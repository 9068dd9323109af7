"""A shorter time step for an arm that is running."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dashpot.arm.plant import Plant, with_timestep


def refined(plant: Plant, drives: NDArray[np.void], timestep: float, period: float, tick: int) -> Plant:
    """The same plant with a shorter time step [s]; its drives go on from where they are.

    Args:
        plant: With the longer step.
        drives: As they run; changed in place.
        timestep: The new one [s]; the control period is a multiple of both.
        period: Of the controller [s].
        tick: The coming one.
    """
    fine = with_timestep(plant, timestep)
    before, after = round(period / plant.timestep), round(period / timestep)
    # Of the drives only constants know of the step; their states are torques, but for two.
    for name in fine.drives.dtype.names or ():
        if (fine.drives[name] != plant.drives[name]).any():
            drives[name] = fine.drives[name]
    drives["sum"] *= after / before  # of the torque over the steps of this period
    for drive, was in zip(drives, plant.drives["sensor_delay"], strict=True):
        if was > 0:  # torques under way to the sensor, in places that the number of the step gives
            oldest_first = drive["delay"][(tick * before + np.arange(was)) % was]
            now = int(drive["sensor_delay"])
            seen = np.interp(np.linspace(0, was - 1, now), np.arange(was), oldest_first)
            drive["delay"][(tick * after + np.arange(now)) % now] = seen
    return fine
