"""One joint's channels, filtered, on the grid of windows where the rotor keeps moving one way."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from dashpot.arm.drive import Drive
from dashpot.control.controller import Sampling
from dashpot.identify.weak import EDGE, REACH, WeakForm, sensor_memory
from dashpot.support.arrays import Floats

DELAYS = 3  # instruments are the filtered signals this many times further in the past
INDEPENDENT = 7.0  # [standard deviations] apart, the noise of two windows is uncorrelated to 1e-3
STRIDE = 1.0  # [standard deviations] between windows: closer ones add nothing, e^(-pi^2) of the power
SLOW = 0.02  # of the fastest speed: slower windows are presliding or standstill
NOISY = 5.0  # standard deviations of the speed's noise that make a speed certain
LONGEST_LATENCY = 0.05  # [s] that is looked for
SHARP = 0.5  # of the kernel: smoothing of the speed that a friction curve is a function of
STEPS = 4.0  # encoder steps per kernel: slower motion shows the steps, not the motion


@dataclass(frozen=True)
class Channels:
    """One segment of one joint, each (t,); SI units as in `dashpot.logs.log.Segment`.

    `motion` is the rotor angle, or its rate where the log has no angle (`rate`).
    """

    time: Floats
    command: Floats
    torque: Floats
    motion: Floats
    rate: bool
    link: Floats | None


def resolution(signal: Floats) -> float:
    """Quantisation step of a signal (t,), 0 where it has none that shows."""
    values = np.unique(signal)
    if len(values) < 3:
        return 0.0
    step = np.diff(values)
    smallest = float(np.quantile(step, 0.05))
    # On a grid every difference is a multiple of the step.
    share = np.abs(step / smallest - np.round(step / smallest)).max() if smallest > 0 else 1.0
    return smallest if len(values) < 0.9 * len(signal) or share < 1e-3 else 0.0


def white_noise(signal: Floats) -> float:
    """Standard deviation of what is left of a signal (t,) after four differences; white noise passes."""
    return float(np.sqrt(np.mean(np.diff(signal, 4) ** 2) / 70)) if len(signal) > 8 else math.inf


class Windows:
    """Filters of every segment, and the windows that can be used.

    Attributes:
        used: (w,) which of the windows have the rotor moving one way throughout.
        time: (w,) [s].
        sign: (w,) direction of motion.
        speed: (w,) [rad/s].
        slowest: Speed below which windows are left out [rad/s].
        noise: Standard deviation of a speed [rad/s].
        stride: Samples between windows.
    """

    def __init__(
        self, segments: Sequence[Channels], period: float, kernel: float, drive: Drive, sampling: Sampling
    ) -> None:
        self.kernel, self.period = kernel, period
        self._segments = segments
        self.stride = max(1, round(STRIDE * kernel / period))
        memory = sensor_memory(drive, sampling, period)
        first, last = math.ceil((EDGE * kernel + memory) / period), math.ceil(EDGE * kernel / period)
        self._lag = math.ceil(INDEPENDENT * kernel / period)
        start = first + DELAYS * self._lag
        self._usable = [s for s in segments if len(s.time) > start + last + 10 * self.stride]
        self._weak = [WeakForm(len(s.time), period, kernel, drive, sampling) for s in self._usable]
        self._grids = [np.arange(start, len(s.time) - last, self.stride) for s in self._usable]
        self._spectra: dict[tuple[int, str], NDArray[np.complex128]] = {}
        self._order = 1 if segments[0].rate else 0
        behind = REACH * kernel + 0.6 * memory
        before, after = math.ceil(behind / period), math.ceil(REACH * kernel / period)
        self._speeds = [
            w.filtered(self._spectrum(i, "motion"), derivative=1 - self._order, sensor=False)
            for i, w in enumerate(self._weak)
        ]
        top = [float(np.quantile(np.abs(v[first : len(v) - last]), 0.99)) for v in self._speeds]
        self.fastest = max(top, default=0.0)
        if segments[0].rate:
            gain = math.sqrt(period / (2 * math.sqrt(math.pi) * kernel))
            coarse = 0.0
        else:
            gain = math.sqrt(period / (4 * math.sqrt(math.pi) * kernel**3))
            coarse = (
                STEPS
                * max((resolution(s.motion) for s in self._usable), default=0.0)
                / (2 * math.pi * kernel)
            )
        self.noise = gain * float(np.median([white_noise(s.motion) for s in self._usable] or [math.inf]))
        self.slowest = max(SLOW * self.fastest, NOISY * self.noise, coarse)
        self.time = self._at(lambda i: self._usable[i].time)
        self.speed = self._at(lambda i: self._speeds[i])
        self.sign = np.sign(self.speed)
        size = before + after + 1
        shift = (before - after) // 2
        limit = drive.torque_limit * (1 + 1e-9)
        delay = math.ceil(LONGEST_LATENCY / period)

        def one_way(i: int) -> Floats:
            v = self._speeds[i]
            low = minimum_filter1d(v, size, origin=shift, mode="nearest")
            high = maximum_filter1d(v, size, origin=shift, mode="nearest")
            return np.asarray((low > self.slowest) | (high < -self.slowest), float)

        def beyond(i: int) -> Floats:
            over = (np.abs(self._usable[i].command) > limit).astype(float)
            wide = maximum_filter1d(over, 2 * (before + delay) + 1, mode="nearest")
            return np.asarray(wide, float)

        self.limited = self._at(beyond) > 0
        self.used = (self._at(one_way) > 0) & ~self.limited

    @property
    def count(self) -> int:
        """Number of windows used."""
        return int(self.used.sum())

    @property
    def independent(self) -> float:
        """Number of independent windows among those used."""
        # The autocorrelation of noise through a Gaussian integrates to 2 sqrt(pi) standard deviations.
        return self.count * self.stride * self.period / (2 * math.sqrt(math.pi) * self.kernel)

    def _at(self, channel: Callable[[int], Floats], back: int = 0) -> Floats:
        parts = [channel(i)[grid - back * self._lag] for i, grid in enumerate(self._grids)]
        return np.concatenate(parts) if parts else np.zeros(0)

    def _raw(self, segment: int, name: str) -> Floats:
        s = self._usable[segment]
        if name == "deflection":
            assert s.link is not None
            signal = s.motion - s.link
            return np.asarray(signal - signal.mean())
        signal = np.asarray(getattr(s, name))
        return signal - signal.mean() if name == "motion" and not s.rate else signal

    def _spectrum(self, segment: int, name: str) -> NDArray[np.complex128]:
        key = segment, name
        if key not in self._spectra:
            self._spectra[key] = self._weak[segment].spectrum(self._raw(segment, name))
        return self._spectra[key]

    def get(
        self,
        name: str,
        *,
        derivative: int = 0,
        sensor: bool = True,
        hold: bool = False,
        delay: float = 0.0,
        back: int = 0,
    ) -> Floats:
        """A filtered channel on the grid, (w,): see `WeakForm.filtered`; `back`: so many lags in the past."""
        return self._at(
            lambda i: self._weak[i].filtered(
                self._spectrum(i, name), derivative=derivative, sensor=sensor, hold=hold, delay=delay
            ),
            back,
        )

    def motion(self, derivative: int, *, delay: float = 0.0, back: int = 0) -> Floats:
        """Derivative of the rotor angle on the grid, (w,) [rad/s^derivative]."""
        return self.get("motion", derivative=max(derivative - self._order, 0), delay=delay, back=back)

    def torque(self, *, back: int = 0) -> Floats:
        """Sensed torque on the grid, (w,) [N m]."""
        return self.get("torque", sensor=False, back=back)

    def command(self, latency: float, *, derivative: int = 0, back: int = 0) -> Floats:
        """Commanded torque in effect on the grid, or its derivative, (w,) [N m/s^derivative]."""
        return self.get("command", derivative=derivative, hold=True, delay=latency, back=back)

    def of_speed(self, law: Callable[[Floats], Floats]) -> Floats:
        """A function of the rotor's speed through kernel and sensor, (w,)."""

        def one(i: int) -> Floats:
            weak, order = self._weak[i], 1 - self._order
            return weak.filtered(
                weak.spectrum(law(weak.dense(self._spectrum(i, "motion"), SHARP * self.kernel, 1, order)))
            )

        return self._at(one)

    def of_deflection(self, law: Callable[[Floats], Floats], fine: Sequence[Floats], factor: int) -> Floats:
        """A functional of the deflection, given `factor` times as densely by `deflection`, filtered, (w,)."""
        return self._at(lambda i: self._weak[i].filtered(self._weak[i].spectrum(law(fine[i])[::factor])))

    def deflection(self, kernel: float, factor: int) -> list[Floats]:
        """The deflection of each segment through a kernel of its own, `factor` times as densely sampled."""
        return [
            self._weak[i].dense(self._spectrum(i, "deflection"), kernel, factor)
            for i in range(len(self._weak))
        ]

    def deflection_noise(self) -> float:
        """Standard deviation of the white noise of the deflection's samples [rad]."""
        return max(white_noise(self._raw(i, "deflection")) for i in range(len(self._usable)))

    def instruments(self, *, deflection: bool = False) -> Floats:
        """Signals of the past, (w, k): correlated with the motion, not with the noise of the window.

        Their noise and that of the window do not overlap, and what feedback has made of the window's noise
        lies in the window's future: they are exogenous under any feedback.
        """
        columns = [np.ones(len(self.time))]
        for back in range(1, DELAYS + 1):
            columns += [self.torque(back=back), self.command(0.0, back=back)]
            columns += [self.motion(order, back=back) for order in (0, 1, 2)[self._order :]]
            columns.append(np.sign(self._at(lambda i: self._speeds[i], back)))
            if deflection:
                columns += [self.get("deflection", derivative=order, back=back) for order in (0, 1)]
        return np.stack(columns, 1)
