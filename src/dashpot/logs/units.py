"""Units that look wrong: degrees, milli-units, motor-side values, a flipped sign."""

from __future__ import annotations

import math
import warnings

import numpy as np

from dashpot.arm.robot import MAX_ANGLE
from dashpot.errors import InputWarning
from dashpot.logs.log import Log
from dashpot.support.arrays import Floats

FASTEST = 30.0  # [rad/s] of a joint; degrees per second are more
STILL = 0.02  # [rad/s] RMS below which a rate says nothing about its unit
AGREES = 0.2  # by which the slope of position against velocity may differ from 1
WINDOW = 9  # samples over which positions are smoothed before differences are taken


def warn_of_units(log: Log) -> None:
    """Warns of joints whose numbers do not look like rad, rad/s and N m on the link side.

    Warns:
        InputWarning: One line per joint.
    """
    for j, joint in enumerate(log.joints):
        said = _suspicion(log, j)
        if said:
            warnings.warn(f"{log.file}: joint {joint!r}: {said}", InputWarning, stacklevel=4)


def _column(log: Log, name: str, j: int) -> list[Floats]:
    arrays = [getattr(segment, name) for segment in log.segments]
    return [] if arrays[0] is None or np.isnan(arrays[0][:, j]).all() else [a[:, j] for a in arrays]


def _suspicion(log: Log, j: int) -> str:
    position, velocity = _column(log, "position", j), _column(log, "velocity", j)
    if position and velocity:
        slope = _slope(position, velocity, log.period)
        said = "" if slope is None else _read_slope(slope)
        if said:
            return said
    if position and max(float(np.abs(part).max()) for part in position) > MAX_ANGLE:
        return "position exceeds two turns; check the unit: rad, link side of the gear"
    if velocity and max(float(np.abs(part).max()) for part in velocity) > FASTEST:
        return f"velocity exceeds {FASTEST:g} rad/s; check the unit: rad/s, link side of the gear"
    command, torque = (
        math.sqrt(sum(float(part @ part) for part in _column(log, name, j))) for name in ("command", "torque")
    )
    if min(command, torque) > 0 and not 1 / 300 < command / torque < 300:
        return f"command and effort differ {command / torque:.3g} times; both are in N m, link side"
    return ""


def _slope(position: list[Floats], velocity: list[Floats], period: float) -> float | None:
    """Rate of position over velocity, least squares, both smoothed; None where there is little motion."""
    kernel = np.ones(WINDOW) / WINDOW
    both = square = count = 0.0
    for q, w in zip(position, velocity, strict=True):
        if len(q) > 2 * WINDOW:
            rate = np.convolve(np.gradient(q, period), kernel, "valid")
            speed = np.convolve(w, kernel, "valid")
            both += float(rate @ speed)
            square += float(speed @ speed)
            count += len(speed)
    if count == 0 or math.sqrt(square / count) < STILL:
        return None
    return float(both / square)


def _read_slope(slope: float) -> str:
    """What a slope other than 1 means."""
    per_degree = 180 / math.pi
    for factor, meaning in (
        (1.0, ""),
        (-1.0, "velocity and position have opposite signs"),
        (per_degree, "position looks like degrees beside velocity in rad/s; it must be in rad"),
        (1 / per_degree, "velocity looks like degrees per second beside position in rad; give rad/s"),
        (1e3, "positions change 1000 times as fast as velocity says; check the unit of time and of both"),
        (1e-3, "positions change 1000 times slower than velocity says; check the unit of time and of both"),
    ):
        if abs(slope / factor - 1) < AGREES:
            return meaning
    return f"the rate of position is {slope:.3g} times velocity; check units and gear side of both"
