"""From the coefficients of the rotor's equation to quantities, and the widths that are allowed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dashpot.identify import refusals as rules
from dashpot.identify.estimate import UNITS, Estimate
from dashpot.identify.rotor import STRIBECK_SHARE, RotorFit
from dashpot.support.arrays import Floats

CROSSED = 0.25  # of the Stribeck velocity: the speed may change by it within a kernel
NOT_NEGATIVE = ("viscous_friction", "coulomb_friction", "damping")


@dataclass
class Quantities:
    """Quantities as functions of the coefficients, with the derivatives."""

    names: tuple[str, ...]
    value: Floats
    jacobian: Floats


def quantities(fit: RotorFit) -> Quantities:
    """Delta method: scale error, bias and the rest from the coefficients."""
    p = len(fit.names)
    alpha = fit.value("alpha") if fit.scale is None else 1 / (1 + fit.scale)
    rows: list[tuple[str, float, Floats]] = []

    def unit(name: str) -> Floats:
        row = np.zeros(p)
        row[fit.column(name)] = 1.0
        return row

    for name in ("rotor_inertia", "viscous_friction", "coulomb_friction"):
        rows.append((name, fit.value(name), unit(name)))
    safe = max(alpha, 0.5)  # a scale error of 100 %: refused in any case
    bias = -fit.value("offset") / safe
    row = -unit("offset") / safe
    if fit.scale is None:
        row -= unit("alpha") * bias / safe
        rows.append(("torque_scale_error", 1 / safe - 1, -unit("alpha") / safe**2))
    rows.append(("torque_bias", bias, row))
    rows.append(("latency", fit.unknowns.latency + fit.value("latency"), unit("latency")))
    if fit.unknowns.stribeck is not None:
        level = fit.value("coulomb_friction") + fit.value("extra")
        rows.append(("stribeck_friction", level, unit("coulomb_friction") + unit("extra")))
        rows.append(("stribeck_velocity", fit.unknowns.stribeck[0], unit("stribeck_velocity")))
    names, values, jacobian = zip(*rows, strict=True)
    return Quantities(names, np.array(values), np.stack(jacobian))


def widths(q: Quantities, fit: RotorFit, size: float) -> dict[str, float]:
    """Largest allowed half-widths."""
    value = dict(zip(q.names, np.abs(q.value), strict=True))
    speed = float(np.sqrt(np.mean(fit.columns[:, fit.column("viscous_friction")] ** 2)))
    return {
        "rotor_inertia": rules.RELATIVE["rotor_inertia"] * value["rotor_inertia"],
        "viscous_friction": max(
            rules.RELATIVE["viscous_friction"] * value["viscous_friction"],
            rules.NEGLIGIBLE * size / max(speed, 1e-12),
        ),
        "coulomb_friction": max(
            rules.RELATIVE["coulomb_friction"] * value["coulomb_friction"], rules.NEGLIGIBLE * size
        ),
        "torque_bias": rules.BIAS * size,
        "torque_scale_error": rules.SCALE,
        "latency": rules.LATENCY * fit.windows.period,
    }


def curve_shown(q: Quantities, cov: Floats, fit: RotorFit) -> bool:
    """Whether breakaway level and speed are certain enough, and crossed slowly enough, to be reported."""
    at, level, coulomb = (
        q.names.index(n) for n in ("stribeck_velocity", "stribeck_friction", "coulomb_friction")
    )
    extra = np.zeros(len(q.names))
    extra[level], extra[coulomb] = 1.0, -1.0
    acceleration = float(np.std(fit.columns[:, fit.column("rotor_inertia")]))
    if acceleration * fit.windows.kernel > CROSSED * q.value[at]:
        return False
    widths = fit.regression.quantile * np.sqrt([max(cov[at, at], 0.0), max(float(extra @ cov @ extra), 0.0)])
    return bool(
        widths[0] < STRIBECK_SHARE * q.value[at] and widths[1] < STRIBECK_SHARE * abs(float(extra @ q.value))
    )


def estimate(name: str, value: float, width: float) -> Estimate:
    """An interval about a value, cut off at zero where the quantity cannot be negative."""
    low, high = value - width, value + width
    if name in NOT_NEGATIVE:
        value, low = max(value, 0.0), max(low, 0.0)
    return Estimate(value, low, high, UNITS[name])
