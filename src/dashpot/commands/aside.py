"""A simulation beside the main thread, so that Ctrl-C need not wait for the native loop."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TypeVar

from dashpot.support.workers import NATIVE_LOOP

Result = TypeVar("Result")


def run_aside(run: Callable[[], Result]) -> Result:
    """Calls ``run`` on a thread of its own: Ctrl-C need not wait for the native loop."""
    done: list[Result] = []
    failed: list[BaseException] = []

    def work() -> None:
        try:
            done.append(run())
        except BaseException as error:
            failed.append(error)

    thread = threading.Thread(target=work, name=NATIVE_LOOP, daemon=True)
    thread.start()
    thread.join()
    if failed:
        raise failed[0]
    return done[0]
