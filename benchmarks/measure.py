"""Measuring in turns, memory in use, and the table of results."""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable
from itertools import repeat
from typing import Any

import numpy as np
from rich.table import Table

from dashpot.support.arrays import Floats

SETS = 5
Timed = Callable[[], float]


class Rows:
    """Collects and prints the results."""

    def __init__(self) -> None:
        self.table = Table(title="dashpot benchmarks", title_justify="left")
        for name in ("what", "measured", "spread", "target", ""):
            self.table.add_column(name, justify="left" if name in ("what", "") else "right")
        self.more: list[Table | str] = []  # printed below the table
        self.results: dict[str, Any] = {}
        self.missed: list[str] = []

    def section(self, title: str, about: str) -> None:
        self.table.add_section()
        self.table.add_row(f"[bold]{title}[/bold]", "", "", "", f"[italic]{about}[/italic]")

    def add(
        self,
        key: str,
        what: str,
        sets: Floats,
        unit: str = "x",
        *,
        least: float | None = None,
        most: float | None = None,
        note: str = "",
    ) -> None:
        """One row: `sets` are the five measurements."""
        value, low, high = float(np.median(sets)), float(sets.min()), float(sets.max())
        digits = "{:.0f}" if unit == "B" else "{:#.3g}"
        target, verdict = "", note
        if least is not None or most is not None:
            target = f">= {least:g} {unit}" if least is not None else f"<= {most:g} {unit}"
            miss = high < least if least is not None else low > most
            short = value < least if least is not None else value > most
            word = (
                "[red]missed[/red]"
                if miss
                else "[yellow]short, in the spread[/yellow]"
                if short
                else "[green]met[/green]"
            )
            verdict = f"{word} {note}"
            if miss:
                self.missed.append(key)
        shown = [digits.format(v) for v in (value, low, high)]
        self.table.add_row(what, f"{shown[0]} {unit}", f"{shown[1]}..{shown[2]}", target, verdict)
        self.results[key] = {
            "value": value,
            "low": low,
            "high": high,
            "unit": unit,
            "least": least,
            "most": most,
        }


def interleave(functions: dict[str, Timed], rounds: int) -> dict[str, Floats]:
    """Best-of of each function's returned seconds in `SETS` sets of rounds: name -> (SETS,)."""
    for function in functions.values():
        function()  # warm up
    taken = {name: np.zeros((rounds, SETS)) for name in functions}
    for i in range(rounds):
        for j in range(SETS):
            for name, function in functions.items():
                taken[name][i, j] = function()
    return {name: seconds.min(0) for name, seconds in taken.items()}


def calls(function: Callable[..., object], count: int, *args: object) -> Timed:
    """CPU seconds per call of `function(*args)` from a Python loop."""

    def timed() -> float:
        begin = time.thread_time()
        for _ in repeat(None, count):
            function(*args)
        return (time.thread_time() - begin) / count

    return timed


class Mallinfo2(ctypes.Structure):
    """``struct mallinfo2`` of glibc."""

    _names = ("arena", "ordblks", "smblks", "hblks", "hblkhd")
    _names += ("usmblks", "fsmblks", "uordblks", "fordblks", "keepcost")
    _fields_ = tuple((name, ctypes.c_size_t) for name in _names)


LIBC = ctypes.CDLL(None)
if hasattr(LIBC, "mallinfo2"):
    LIBC.mallinfo2.restype = Mallinfo2


def bytes_in_use() -> int | None:
    """What glibc's malloc has given out and not got back, mapped blocks included; None without glibc."""
    if not hasattr(LIBC, "mallinfo2"):
        return None
    info = LIBC.mallinfo2()
    return int(info.uordblks + info.hblkhd)
