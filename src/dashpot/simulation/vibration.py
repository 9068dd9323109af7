"""Vibration in a recorded signal: its part above `CORNER`, where commanded motions have none."""

from __future__ import annotations

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
    from scipy.signal import butter, sosfilt, sosfilt_zi  # a second to import

    if len(signal) * period < SETTLE or 0.5 / period <= 2 * CORNER:
        return None
    sections = butter(4, CORNER, "highpass", fs=1 / period, output="sos")
    start = sosfilt_zi(sections)[:, :, None] * signal[0]
    high = sosfilt(sections, signal, axis=0, zi=start)[0][-round(WINDOW / period) :]
    taper = np.hanning(len(high) + 2)[1:-1, None]
    spectrum = np.abs(np.fft.rfft(high * taper, axis=0))
    strongest = np.fft.rfftfreq(len(high), period)[spectrum.argmax(0)]
    return np.sqrt((high**2).mean(0)), strongest
