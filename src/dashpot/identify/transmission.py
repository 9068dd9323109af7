"""The transmission: stiffness and damping from torque and deflection, with hysteresis as a nuisance.

    tau = (1 + s) (k e + c e' + g S_r[e]) + offset,    e = q - q_link

S_r is the stop operator, the elastic - perfectly plastic element: the slope of a hysteresis loop is steeper
after each reversal and its width does not vanish with speed, so that a fit without it takes hysteresis for
damping. Threshold r and weight g are estimated along and not reported.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dashpot.identify.regression import Regression, two_stage
from dashpot.identify.windows import Windows
from dashpot.support.arrays import Floats

THRESHOLDS = 12  # tried, between the noise of the deflection and `WIDEST` of its range
WIDEST = 0.25  # of the range: a wider loop never shows that it saturates
CERTAIN = 4.0  # standard errors of a hysteresis whose threshold is refined
ROUNDS = 12  # of Gauss-Newton on the threshold
NUDGE = 1e-3  # relative, of the threshold, for its derivative
DENSE = 1e-3  # [s] between points of the deflection whose hysteresis is taken
NARROWEST = 2e-3  # of the range
HIDDEN = 0.15  # stiffness of a hysteresis that may hide under the noise, over the transmission's
SHAPE = 0.005  # share of the hysteresis that a stop operator may leave unexplained: an assumption


def stop(deflection: Floats, threshold: float) -> Floats:
    """Stop operator: deflection (t,) of an elastic - perfectly plastic element that slips at +-threshold.

    The input minus its play, ``p_i = clip(p_{i-1}, x_i - r, x_i + r)`` from ``p_0 = x_0``. Clips compose to
    clips, so that the recursion is a prefix scan.
    """
    low, high = deflection - threshold, deflection + threshold
    low[0] = high[0] = deflection[0]
    reach = 1
    while reach < len(low) and (low[reach:] < high[reach:]).any():
        before_low, before_high = low[:-reach].copy(), high[:-reach].copy()
        after_low, after_high = low[reach:].copy(), high[reach:].copy()
        low[reach:] = np.clip(before_low, after_low, after_high)
        high[reach:] = np.clip(before_high, after_low, after_high)
        reach *= 2
    return np.asarray(deflection - low)


@dataclass(frozen=True)
class TransmissionFit:
    """The equation solved.

    Attributes:
        windows: Where.
        used: (w,) which windows.
        regression: Columns k, c, offset, g and, where refined, r: times 1 + s.
        plain: Without hysteresis: columns k, c, offset.
        threshold: r [rad], 0 where no hysteresis was tried.
        blunt: Noise of the deflection over r: the share of the loop whose corners noise hides.
        shown: Whether the hysteresis is certain.
        travel: Range of the deflection [rad].
        torque: Range of the torque [N m].
        hidden: Damping that a hysteresis too narrow to be seen can feign, a standard error [N m s/rad].
    """

    windows: Windows
    used: NDArray[np.bool_]
    regression: Regression
    plain: Regression
    threshold: float
    blunt: float
    shown: bool
    travel: float
    torque: float

    hidden: float = 0.0

    def shape_error(self, column: int) -> float:
        """Standard error of a coefficient from what the stop operator gets wrong about the hysteresis."""
        change = abs(float(self.plain.theta[column] - self.regression.theta[column]))
        return math.hypot(
            math.hypot(SHAPE, min(self.blunt, 1.0)) * change, self.hidden if column == 1 else 0.0
        )


def fit_transmission(windows: Windows) -> TransmissionFit | None:
    """Solves the equation on all windows, or None where the deflection never changes."""
    tau = windows.torque()
    if len(tau) == 0:
        return None
    spring = np.stack(
        [windows.get("deflection"), windows.get("deflection", derivative=1), np.ones(len(tau))], 1
    )
    travel = float(np.ptp(spring[:, 0]))
    if travel <= 0:
        return None
    used = ~windows.limited
    base = windows.instruments(deflection=True)
    independent = float(used.sum()) * windows.stride * windows.period
    independent /= 2 * math.sqrt(math.pi) * windows.kernel
    noise = windows.deflection_noise()
    factor = max(1, round(windows.period / DENSE))
    # Not smoothed: a kernel takes the small vibration that moves the loop for noise, and c pays for it.
    dense = windows.deflection(0.0, factor)

    def solve(columns: Floats, extra: Floats | None = None) -> Regression:
        Z = base if extra is None else np.column_stack([base, extra])
        return two_stage(tau[used], columns[used], Z[used], independent)

    def column(r: float) -> Floats:
        return windows.of_deflection(lambda e: stop(e, r), dense, factor)

    plain = solve(spring)
    # Its torque times its travel, against damping at the speeds there are.
    rate = float(np.std(spring[used, 1]))
    hidden = HIDDEN * abs(float(plain.theta[0])) * 3 * noise / rate if rate > 0 else 0.0
    size = float(np.ptp(tau))
    lowest = max(3 * noise, NARROWEST * travel)
    best: tuple[float, float, Regression] | None = None
    for r in np.geomspace(lowest, WIDEST * travel, THRESHOLDS) if lowest < WIDEST * travel else ():
        s = column(float(r))
        fit = solve(np.column_stack([spring, s]), s)
        left = float(np.sum(fit.residual**2))
        if best is None or left < best[0]:
            best = left, float(r), fit
    if best is None:
        return TransmissionFit(windows, used, plain, plain, 0.0, 0.0, False, travel, size, hidden)
    _, r, fit = best
    shown = bool(fit.theta[3] > CERTAIN * math.sqrt(max(fit.cov[3, 3], 0.0)))
    if not shown:
        return TransmissionFit(windows, used, fit, plain, r, noise / r, False, travel, size, hidden)
    for _ in range(ROUNDS):
        s = column(r)
        slope = fit.theta[3] * (column(r * (1 + NUDGE)) - column(r * (1 - NUDGE))) / (2 * NUDGE * r)
        extra = np.column_stack([s, slope])
        fit = solve(np.column_stack([spring, extra]), extra)
        change = float(np.clip(fit.theta[4] / r, -0.3, 0.4))
        if abs(change) < 1e-3:
            break
        r = float(np.clip(r * (1 + change), lowest, 2 * WIDEST * travel))
    return TransmissionFit(windows, used, fit, plain, r, noise / r, True, travel, size)
