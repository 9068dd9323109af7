"""What the studio costs: processor time and memory of this process."""

from __future__ import annotations

import os
import time
from pathlib import Path


class Usage:
    """Since the last look."""

    def __init__(self) -> None:
        self._wall, self._cpu = time.perf_counter(), self._spent()

    def line(self) -> str:
        """Share of one core since the last call, and memory now."""
        wall, cpu = time.perf_counter(), self._spent()
        share = (cpu - self._cpu) / (wall - self._wall)
        self._wall, self._cpu = wall, cpu
        return f"{100 * share:.0f} % of one core, {memory() / 1e6:.0f} MB"

    @staticmethod
    def _spent() -> float:
        spent = os.times()
        return spent.user + spent.system


def memory() -> float:
    """Resident memory of this process [bytes]; NaN where the system does not say."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except (OSError, IndexError, ValueError):
        return float("nan")
    return float(pages * os.sysconf("SC_PAGE_SIZE"))
