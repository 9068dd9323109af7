"""Vibration in a recorded signal: its part above `CORNER`, where commanded motions have none."""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from dashpot.support.arrays import Floats

CORNER = 3.0  # [Hz] of the high-pass
WINDOW = 1.0  # [s] at the end of the signal that is judged
SETTLE = 0.5  # [s] a signal needs for a verdict


def vibration(signal: Floats, period: float) -> tuple[Floats, Floats] | None:
    """RMS and strongest frequency [Hz] of each column above `CORNER`, over the last `WINDOW`.

    Args:
        signal: (ticks, n), finite.
        period: Of the ticks [s].

    Returns:
        Two arrays (n,), or None where the signal is too short or sampled too slowly to tell.
    """
    from scipy.signal import sosfilt, sosfilt_zi  # a second to import

    found = highpass(CORNER, period)
    if found is None or len(signal) * period < SETTLE:
        return None
    sections = np.insert(found, 3, 1.0, axis=1)  # a0
    start = sosfilt_zi(sections)[:, :, None] * signal[0]
    high = sosfilt(sections, signal, axis=0, zi=start)[0][-round(WINDOW / period) :]
    taper = np.hanning(len(high) + 2)[1:-1, None]
    spectrum = np.abs(np.fft.rfft(high * taper, axis=0))
    strongest = np.fft.rfftfreq(len(high), period)[spectrum.argmax(0)]
    return np.sqrt((high**2).mean(0)), strongest


@cache
def highpass(corner: float, period: float) -> Floats | None:
    """A Butterworth high-pass of fourth order at a corner [Hz], two sections of b0 b1 b2 a1 a2: (2, 5).

    Bilinear, with the corner where it is asked for. None: sampled too slowly to tell.
    """
    if 0.5 / period <= 1.5 * corner:
        return None
    k = math.tan(math.pi * corner * period)
    sections = []
    for angle in (math.pi / 8, 3 * math.pi / 8):
        damping = 2 * k * math.cos(angle)
        scale = 1 / (1 + damping + k * k)
        sections.append([scale, -2 * scale, scale, 2 * (k * k - 1) * scale, (1 - damping + k * k) * scale])
    return np.array(sections)
