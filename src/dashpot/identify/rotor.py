"""The rotor's equation: inertia, friction, sensor bias and scale, and latency.

    u(t - L) = alpha (tau - b) + m q'' + v q' + (tau_c + (tau_b - tau_c) e^{-(q'/w_b)^2}) sgn q'

with tau the torque sample, ``tau = (1 + s) tau_s + b``, ``alpha = 1/(1 + s)``; linear but for L and w_b,
which Gauss-Newton steps find.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from dashpot.identify.regression import Regression, two_stage
from dashpot.identify.windows import LONGEST_LATENCY, Windows
from dashpot.support.arrays import Floats

STEPS = 20  # of Gauss-Newton, at most
LAG = 0.5  # [periods], delay of a logged velocity: a difference quotient's; 0 to 1 is allowed for
STRIBECK_T = 5.0  # standard errors: a friction curve below that is not reported
STRIBECK_SHARE = 0.5  # relative half-width up to which its parts are reported
STRIBECK_SPEEDS = 8  # speeds tried


@dataclass
class Unknowns:
    """What enters the equation nonlinearly.

    Attributes:
        latency: L [s].
        stribeck: (w_b [rad/s], tau_b - tau_c [N m]), or None.
    """

    latency: float = 0.0
    stribeck: tuple[float, float] | None = None


@dataclass(frozen=True)
class RotorFit:
    """The equation solved.

    Attributes:
        windows: Where.
        names: Of the p columns.
        columns: (w, p), windows used only.
        regression: Of ``u - X theta``, windows used.
        unknowns: At the solution.
        converged: Whether the steps came to rest.
        all_columns: (w, p), of all windows.
        all_command: (w,) what they explain: the command, less the sensed torque where the scale is known.
        scale: Scale error taken as known, or None.
    """

    windows: Windows
    names: tuple[str, ...]
    columns: Floats
    regression: Regression
    unknowns: Unknowns
    converged: bool
    all_columns: Floats
    all_command: Floats
    scale: float | None

    def column(self, name: str) -> int:
        """Index of a column."""
        return self.names.index(name)

    def value(self, name: str) -> float:
        """Coefficient of a column."""
        return float(self.regression.theta[self.column(name)])


def _stribeck(speed: Floats, at: float) -> Floats:
    return np.asarray(np.sign(speed) * np.exp(-((speed / at) ** 2)))


def _curve_slope(speed: Floats, at: float) -> Floats:
    """Derivative of `_stribeck` by its velocity."""
    return np.asarray(_stribeck(speed, at) * 2 * speed**2 / at**3)


class Rotor:
    """The equation on given windows.

    Args:
        windows: Where it is solved.
        scale: Scale error of the sensor where it is known [-].
        rate: Whether the log has the velocity only.
    """

    def __init__(self, windows: Windows, scale: float | None, rate: bool) -> None:
        self.windows, self.scale, self.rate = windows, scale, rate
        self._torque = windows.torque()
        self._instruments = windows.instruments()
        self._stribeck_columns: dict[float, Floats] = {}

    def _linear(self) -> dict[str, Floats]:
        w = self.windows
        lag = LAG * w.period if self.rate else 0.0
        columns: dict[str, Floats] = {} if self.scale is not None else {"alpha": self._torque}
        columns["rotor_inertia"] = w.motion(2, delay=-lag)
        columns["viscous_friction"] = w.motion(1, delay=-lag)
        columns["coulomb_friction"] = w.sign
        columns["offset"] = np.ones(len(w.time))
        return columns

    def _command(self, latency: float) -> Floats:
        command = self.windows.command(latency)
        return command if self.scale is None else command - self._torque / (1 + self.scale)

    def latency_guess(self) -> float:
        """The latency whose least-squares residual is smallest, to a quarter of a period [s]."""
        w = self.windows
        X = np.stack(list(self._linear().values()), 1)[w.used]
        Q, _ = np.linalg.qr(X / np.maximum(np.sqrt((X * X).mean(0)), 1e-300))
        step = w.period / 2
        tried = np.arange(0.0, max(LONGEST_LATENCY, 4 * w.period) + step / 2, step)
        left = []
        for latency in tried:
            y = self._command(float(latency))[w.used]
            left.append(float(np.sum((y - Q @ (Q.T @ y)) ** 2)))
        return float(tried[int(np.argmin(left))])

    def solve(self, start: Unknowns) -> RotorFit:
        """Gauss-Newton from a start."""
        w, at = self.windows, start
        for _ in range(STEPS):
            linear = self._linear()
            columns = dict(linear)
            columns["latency"] = w.command(at.latency, derivative=1)
            if at.stribeck is not None:
                speed, extra = at.stribeck
                columns["extra"] = self._curve(speed)
                columns["stribeck_velocity"] = extra * w.of_speed(partial(_curve_slope, at=speed))
            fit = self._regress(columns, at.latency)
            if self.rate:
                fit = self._with_lag(fit, columns, at.latency)
            found = dict(zip(columns, fit.theta, strict=True))
            limit = 2 * w.period
            step = float(np.clip(found["latency"], -limit, limit))
            stribeck, moved = at.stribeck, 0.0
            if stribeck is not None:
                change = float(np.clip(found["stribeck_velocity"] / stribeck[0], -0.4, 0.6))
                stribeck, moved = (stribeck[0] * (1 + change), float(found["extra"])), abs(change)
            small = abs(step) < 1e-3 * w.period and moved < 1e-3
            stacked = np.stack(list(columns.values()), 1)
            command = self._command(at.latency)
            names = tuple(columns)
            fitted = RotorFit(w, names, stacked[w.used], fit, at, small, stacked, command, self.scale)
            if small:
                break
            latency = float(np.clip(at.latency + step, -2 * w.period, 2 * LONGEST_LATENCY + 8 * w.period))
            if latency == at.latency and moved < 1e-3:  # at the end of the range
                break
            at = Unknowns(latency, stribeck)
        return fitted

    def _curve(self, speed: float) -> Floats:
        if speed not in self._stribeck_columns:
            self._stribeck_columns[speed] = self.windows.of_speed(partial(_stribeck, at=speed))
        return self._stribeck_columns[speed]

    def _regress(self, columns: dict[str, Floats], latency: float) -> Regression:
        w = self.windows
        X = np.stack(list(columns.values()), 1)[w.used]
        Z = np.column_stack([self._instruments, w.sign])[w.used]
        if (
            "extra" in columns
        ):  # functions of the speed, whose own noise is far below the speeds they vary over
            Z = np.column_stack([Z, columns["extra"][w.used], columns["stribeck_velocity"][w.used]])
        return two_stage(self._command(latency)[w.used], X, Z, w.independent)

    def _with_lag(self, fit: Regression, columns: dict[str, Floats], latency: float) -> Regression:
        """Adds what an unknown delay of the logged velocity, evenly between 0 and a period, does."""
        w, names = self.windows, list(columns)
        inertia, viscous = (float(fit.theta[names.index(n)]) for n in ("rotor_inertia", "viscous_friction"))
        lag = LAG * w.period
        moved = inertia * w.motion(3, delay=-lag) + viscous * w.motion(2, delay=-lag)
        X = np.stack(list(columns.values()), 1)[w.used]
        Z = np.column_stack([self._instruments, w.sign])[w.used]
        shift = two_stage(moved[w.used], X, Z, w.independent).theta
        return replace(fit, cov=fit.cov + np.outer(shift, shift) * w.period**2 / 12)

    def with_stribeck(self, plain: RotorFit) -> RotorFit:
        """The equation with a Stribeck curve where the data show one beyond doubt; else as it was."""
        w = self.windows
        y = self._command(plain.unknowns.latency)[w.used]
        best: tuple[float, float, float] | None = None
        for speed in np.geomspace(1.5 * w.slowest, max(0.4 * w.fastest, 3 * w.slowest), STRIBECK_SPEEDS):
            X = np.column_stack([plain.columns, self._curve(float(speed))[w.used]])
            Z = np.column_stack([self._instruments, w.sign, self._curve(float(speed))])[w.used]
            fit = two_stage(y, X, Z, w.independent)
            error = math.sqrt(max(float(fit.cov[-1, -1]), 1e-300))
            left = float(np.sum(fit.residual**2))
            if fit.theta[-1] > STRIBECK_T * error and (best is None or left < best[0]):
                best = left, float(speed), float(fit.theta[-1])
        if best is None:
            return plain
        curved = self.solve(Unknowns(plain.unknowns.latency, best[1:]))
        good = curved.unknowns.stribeck is not None and np.isfinite(curved.regression.theta).all()
        rests = curved.converged and good
        return curved if rests and curved.value("extra") > 0 else plain
