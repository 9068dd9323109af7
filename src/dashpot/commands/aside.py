"""A simulation beside the main thread, so that Ctrl-C need not wait for the native loop."""

from __future__ import annotations

import threading

from dashpot.commands import NATIVE_LOOP
from dashpot.recording import Recording
from dashpot.simulate import Scenario, run


def run_aside(scenario: Scenario) -> Recording:
    """`run` on a thread of its own: Ctrl-C need not wait for the native loop."""
    done: list[Recording] = []
    failed: list[BaseException] = []

    def work() -> None:
        try:
            done.append(run(scenario))
        except BaseException as error:
            failed.append(error)

    thread = threading.Thread(target=work, name=NATIVE_LOOP, daemon=True)
    thread.start()
    thread.join()
    if failed:
        raise failed[0]
    return done[0]
