"""The last minute of an arm, at every tick, in memory that does not grow."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dashpot.simulation.recording import CHANNELS
from dashpot.studio.window import Window
from dashpot.support.arrays import Floats


class Past(NamedTuple):
    """What a ring holds, oldest first.

    Attributes:
        time: (k,) [s].
        record: `dashpot.simulation.recording.CHANNELS` x k x n.
        reference: (k, n) [rad].
        external: Torque on the links, (k, n) [N m].
        status: (k,).
    """

    time: Floats
    record: Floats
    reference: Floats
    external: Floats
    status: NDArray[np.int32]

    def channel(self, name: str) -> Floats:
        """One channel of the record, (k, n)."""
        return np.asarray(self.record[CHANNELS.index(name)])


class Ring:
    """The last ticks of a run.

    Attributes:
        period: [s].
        size: Ticks it holds.
        written: Ticks written since the start.
    """

    def __init__(self, joints: int, period: float, seconds: float) -> None:
        self.period, self.size, self.written = period, max(1, round(seconds / period)), 0
        self._time = np.zeros(self.size)
        self._record = np.zeros((len(CHANNELS), self.size, joints))
        self._reference, self._external = np.zeros((2, self.size, joints))
        self._status = np.zeros(self.size, np.int32)

    def write(self, window: Window, start: float) -> None:
        """Adds a window whose first tick is at a time [s]."""
        count = len(window.status)
        places = (self.written + np.arange(count)) % self.size
        self._time[places] = start + self.period * np.arange(count)
        self._record[:, places] = window.record
        self._reference[places], self._external[places] = window.reference, window.external
        self._status[places] = window.status
        self.written += count

    def past(self, seconds: float | None = None) -> Past:
        """The last seconds [s], or all there is; copies."""
        held = min(self.written, self.size)
        count = held if seconds is None else min(held, round(seconds / self.period))
        places = (self.written - count + np.arange(count)) % self.size
        return Past(
            self._time[places],
            self._record[:, places],
            self._reference[places],
            self._external[places],
            self._status[places],
        )

    def clear(self) -> None:
        """Forgets everything."""
        self.written = 0


def envelope(values: Floats, bins: int) -> tuple[NDArray[np.int64], Floats]:
    """Rows and values (k, n) -> (2 bins, n) that show every oscillation: least and largest of each bin.

    Returns:
        Indices of the rows, (2 bins,) or fewer, and the values; where there are fewer than 2 bins rows, all.
    """
    count = len(values)
    if count <= 2 * bins:
        return np.arange(count), values
    edges = np.linspace(0, count, bins + 1).astype(np.int64)
    low = np.fmin.reduceat(values, edges[:-1], axis=0)
    high = np.fmax.reduceat(values, edges[:-1], axis=0)
    rows = np.stack([edges[:-1], (edges[:-1] + edges[1:]) // 2], axis=1).ravel()
    return rows, np.stack([low, high], axis=1).reshape(2 * bins, *values.shape[1:])
