"""The weak form: every signal of a log through one smooth kernel, derivatives taken of the kernel.

For a kernel phi, ``integral phi(t - s) q''(s) ds = integral phi''(t - s) q(s) ds``: nothing measured is
differentiated. The kernel is Gaussian; sums over samples are spectrally accurate, because a Gaussian of
standard deviation `SHORTEST_KERNEL` periods is below 1e-8 at the Nyquist frequency. What the torque sensor
does to the torque (delay, low-pass, mean over a period) is done to all other signals, so that the equation of
motion holds between the filtered signals exactly, at every frequency.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft

from dashpot.arm.drive import Drive
from dashpot.control.controller import Sampling
from dashpot.support.arrays import Floats

SHORTEST_KERNEL = 2.0  # [periods], standard deviation
REACH = 4.0  # [standard deviations]: weights beyond it sum up to 6e-5, and cannot see a friction reversal
EDGE = 6.5  # [standard deviations]: what is cut off at the ends of a segment is below 1e-9
TAIL = 16.0  # [time constants] of the sensor's low-pass, e^-16 = 1e-7


def sensor_response(
    frequency: Floats, drive: Drive, sampling: Sampling, period: float
) -> NDArray[np.complex128]:
    """Frequency response of the sensor model, true torque to torque sample; frequency in rad/s."""
    s = 1j * frequency
    response = np.exp(-s * drive.torque_latency)
    if drive.sensor_bandwidth is not None:
        x = s / (2 * math.pi * drive.sensor_bandwidth)
        response = response / (1 + x if drive.sensor_order == 1 else 1 + 2 * drive.sensor_damping * x + x * x)
    return np.asarray(response * held(frequency, period) if sampling == "average" else response)


def held(frequency: Floats, period: float) -> NDArray[np.complex128]:
    """``(1 - e^{-s h}) / (s h)``: a mean over the last period, and also a zero-order hold."""
    half = 0.5 * frequency * period
    return np.asarray(np.sinc(half / math.pi) * np.exp(-1j * half))


def sensor_memory(drive: Drive, sampling: Sampling, period: float) -> float:
    """Time after which the sensor has forgotten a torque, to 1e-7 [s]."""
    memory = drive.torque_latency + (period if sampling == "average" else 0.0)
    if drive.sensor_bandwidth is not None:
        omega = 2 * math.pi * drive.sensor_bandwidth
        zeta = drive.sensor_damping if drive.sensor_order == 2 else 1.0
        # Slowest pole of s^2 + 2 zeta w s + w^2.
        decay = zeta - math.sqrt(zeta * zeta - 1) if zeta > 1 else zeta
        memory += TAIL / (omega * decay)
    return memory


class WeakForm:
    """The filter for one segment of a log.

    Attributes:
        samples: Number of samples of the segment.
        period: [s].
        kernel: Standard deviation of the Gaussian [s].
    """

    def __init__(self, samples: int, period: float, kernel: float, drive: Drive, sampling: Sampling) -> None:
        self.samples, self.period, self.kernel = samples, period, kernel
        room = math.ceil((2 * EDGE * kernel + sensor_memory(drive, sampling, period)) / period) + 1
        self._length = next_fast_len(samples + room, real=True)
        self.frequency: Floats = 2 * math.pi * np.fft.rfftfreq(self._length, period).astype(np.float64)
        self._gauss = np.exp(-0.5 * (kernel * self.frequency) ** 2)
        self._sensor = sensor_response(self.frequency, drive, sampling, period)
        self._hold = held(self.frequency, period)

    def spectrum(self, signal: Floats) -> NDArray[np.complex128]:
        """Transform of a signal (t,), to be given to `filtered`."""
        return np.asarray(rfft(signal, self._length))

    def filtered(
        self,
        spectrum: NDArray[np.complex128],
        *,
        derivative: int = 0,
        sensor: bool = True,
        hold: bool = False,
        delay: float = 0.0,
    ) -> Floats:
        """A signal through kernel and sensor, (t,): unit of the signal per s^derivative.

        Args:
            spectrum: Of the signal.
            derivative: How many times to differentiate the kernel.
            sensor: Whether to pass it through the sensor model; the torque sample itself has been.
            hold: Whether each sample is held for a period, as a command is.
            delay: Extra delay [s].
        """
        response = self._gauss * (1j * self.frequency) ** derivative
        if sensor:
            response = response * self._sensor
        if hold:
            response = response * self._hold
        if delay:
            response = response * np.exp(-1j * self.frequency * delay)
        return np.asarray(irfft(spectrum * response, self._length)[: self.samples])

    def dense(
        self, spectrum: NDArray[np.complex128], kernel: float, factor: int, derivative: int = 0
    ) -> Floats:
        """A signal through another Gaussian, (factor t,), interpolated without loss of band."""
        length = self._length * factor
        wide = np.zeros(length // 2 + 1, complex)
        shape = np.exp(-0.5 * (kernel * self.frequency) ** 2) * (1j * self.frequency) ** derivative
        wide[: len(spectrum)] = spectrum * shape
        return np.asarray(irfft(wide * factor, length)[: self.samples * factor])
