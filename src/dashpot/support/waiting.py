"""One line on a terminal that says what is taking its time; nothing anywhere else.

Made of the standard library alone, because most of what a command waits for at first is imports.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import cycle

AFTER = 0.5  # [s] before which nobody wonders
EVERY = 0.1  # [s]
FRAMES = {True: "⠋⠙⠹⠸⠼⠴⠦⠧⠇⠏", False: "|/-\\"}
CLEAR = "\r\x1b[2K"

_lock = threading.Lock()
_shown = False


@contextmanager
def waiting(label: str, *, still: bool = False) -> Iterator[None]:
    """Says what takes time while the block runs, on standard error where that is a terminal.

    Args:
        label: What it is.
        still: Do not turn: a block that keeps time must not share its interpreter with another thread.
    """
    if not sys.stderr.isatty() or os.environ.get("TERM") == "dumb":
        yield
        return
    over = threading.Event()
    thread = threading.Thread(target=_turn, args=(label, over), name="dashpot waiting", daemon=True)
    if still:
        _draw(label)
    else:
        thread.start()
    try:
        yield
    finally:
        over.set()
        if not still:
            thread.join()
        with above():
            pass


@contextmanager
def above() -> Iterator[None]:
    """Room for lines of one's own on the terminal; the line, if there is one, comes again below them."""
    global _shown
    with _lock:
        if _shown:
            sys.stderr.write(CLEAR)
            sys.stderr.flush()
            _shown = False
        yield


def _turn(label: str, over: threading.Event) -> None:
    if over.wait(AFTER):
        return
    for frame in cycle(FRAMES["utf" in (sys.stderr.encoding or "").lower()]):
        _draw(f"{frame} {label}")
        if over.wait(EVERY):
            return


def _draw(text: str) -> None:
    global _shown
    with _lock:
        sys.stderr.write(CLEAR + text)
        sys.stderr.flush()
        _shown = True
