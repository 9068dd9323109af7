"""The ring between the loop and whoever looks on: shared memory without locks (native/dashpot_cycle.h)."""

from __future__ import annotations

import mmap
import os
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import dashpot._native as _native
from dashpot.control.sampled import NX

ROWS = 8192  # 8 s at 1 kHz: how long the reader may be away
COLUMNS = (
    "torque",
    "position",
    "velocity",
    "in_effect",
    "command",
    "reference",
    "energy_motor",
    "energy_port",
)
"""Columns of a row, one number per joint; block states x0 to x3 follow. Units of `Sample`, energies [J]."""
ROW_DTYPE = np.dtype(
    [
        ("tick", "i8"),
        ("clock", "i8"),
        ("time", "f8"),
        ("jitter", "f8"),
        ("state", "i4"),
        ("phase", "i4"),
        ("status", "i4"),
        ("lost", "i4"),
        *((name, "f8", (_native.MAX_JOINTS,)) for name in COLUMNS),
        *((f"x{i}", "f8", (_native.MAX_JOINTS,)) for i in range(NX)),
        *((name, "i4", (_native.MAX_JOINTS,)) for name in ("mode", "joint_status")),
    ]
)
"""Layout of ``dp_row``."""


@dataclass(frozen=True)
class Progress:
    """What the head of the ring says.

    Attributes:
        closed: The loop has ended.
        decisions: Raw, of the supervisor, oldest first; the latest 64.
        count: Of all there have been.
        statistics: As `Outcome.statistics`.
    """

    closed: bool
    decisions: list[tuple[int, int, int, int, int, float, float]]
    count: int
    statistics: dict[str, Any]


class Ring:
    """Memory for rows, to be written by one loop and read by one reader, perhaps in another process.

    Attributes:
        memory: Of the ring, as bytes.
        file: Descriptor of the shared memory, to be handed to the reader's process.
        missed: Rows that were overwritten before they were read.
    """

    def __init__(self, file: int | None = None, rows: int = ROWS) -> None:
        """Makes a ring, or opens that behind a descriptor."""
        if ROW_DTYPE.itemsize != _native.ROW_SIZE:
            raise RuntimeError("the native library was built from another version; reinstall dashpot")
        size = _native.RING_SIZE + rows * _native.ROW_SIZE
        if file is None:
            file = os.memfd_create("dashpot ring")
            os.ftruncate(file, size)
        self.file, self.missed, self._next = file, 0, 0
        self._map = mmap.mmap(file, os.fstat(file).st_size)
        self.memory: NDArray[np.uint8] = np.frombuffer(self._map, np.uint8)
        self._rows = np.zeros(min(rows, 1024), ROW_DTYPE)

    def drain(self) -> NDArray[np.void]:
        """Rows that have come since the last call, oldest first; at most 1024, in memory used again."""
        count, self._next, missed = _native.ring_drain(self.memory, self._rows.view(np.uint8), self._next)
        self.missed += missed
        return self._rows[:count]

    def progress(self) -> Progress:
        """What the loop says about itself."""
        closed, count, decisions, statistics = _native.ring_state(self.memory)
        return Progress(closed, decisions, count, statistics)
