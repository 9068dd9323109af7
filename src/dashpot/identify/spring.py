"""Stiffness and damping without the sensor's scale, or their refusal."""

from __future__ import annotations

import math

import numpy as np

from dashpot.identify import refusals as rules
from dashpot.identify.estimate import UNITS, Estimate, Refusal
from dashpot.identify.quantities import estimate
from dashpot.identify.regression import long_run
from dashpot.identify.rotor import RotorFit
from dashpot.identify.transmission import WIDEST, TransmissionFit, fit_transmission

TRANSMISSION = ("stiffness", "damping")


def add_transmission(
    values: dict[str, Estimate], refused: list[Refusal], fit: RotorFit, scale: float | None
) -> None:
    """Adds stiffness and damping, or their refusal."""
    if scale is None and "torque_scale_error" not in values:
        refused.append(
            Refusal(
                TRANSMISSION,
                "needs the sensor's scale, which is refused",
                "see torque_scale_error; or give --scale",
            )
        )
        return
    found = fit_transmission(fit.windows)
    if found is None:
        refused.append(
            Refusal(TRANSMISSION, "the deflection never changes", "load the joint with changing torque")
        )
        return
    if found.shown and found.threshold > 1.5 * WIDEST * found.travel:
        refused.append(
            Refusal(
                TRANSMISSION,
                f"hysteresis as wide as the deflection, {found.travel:.2g} rad: a stiffness cannot be told "
                "from it",
                f"load the joint with more than {2 * found.torque:.2g} N m from one side to the other",
            )
        )
        return
    for i, name in enumerate(TRANSMISSION):
        value, width = _in_torque(found, fit, i, scale)
        if not width <= rules.RELATIVE[name] * abs(value):
            why = (
                "hysteresis, encoder steps or noise hide it"
                if name == "damping"
                else "the deflection hardly shows"
            )
            do = (
                "move faster and with larger torque; finer encoders on both sides; the rest does not need it"
                if name == "damping"
                else "load the joint with larger, changing torque, or use finer encoders"
            )
            refused.append(Refusal((name,), f"{why}: {value:.3g} +- {width:.2g} {UNITS[name]}", do))
        else:
            values[name] = estimate(name, value, width)


def _in_torque(
    found: TransmissionFit, fit: RotorFit, column: int, scale: float | None
) -> tuple[float, float]:
    """A coefficient of the transmission without the sensor's scale: value and half-width.

    Coefficient and scale are estimated from the same torque: what each window adds to their errors is added
    before it is squared.
    """
    regression = found.regression
    raw = float(regression.theta[column])
    alpha = fit.value("alpha") if scale is None else 1 / (1 + scale)
    both = np.zeros(len(found.used))
    both[found.used] = alpha * regression.influence[:, column]
    if scale is None:
        both[fit.windows.used] += raw * fit.regression.influence[:, fit.column("alpha")]
    variance = float(long_run(both[:, None], regression.dof)[0, 0])
    error = math.hypot(math.sqrt(max(variance, 0.0)), alpha * found.shape_error(column))
    return raw * alpha, regression.quantile * error
