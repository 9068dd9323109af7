"""Work in processes: stopping, and what is lost on the way."""

from __future__ import annotations

import os
import signal
import sys

import pytest

from dashpot.support.workers import remembered_interrupts


def test_an_interrupt_that_a_finaliser_swallows_is_not_lost(monkeypatch):
    """Ctrl-C while an object is finalised: the interpreter ignores it, the loop stops all the same."""

    class Finalised:
        def __del__(self):
            os.kill(os.getpid(), signal.SIGINT)
            for _ in range(1000):
                pass

    monkeypatch.setattr(sys, "unraisablehook", lambda _: None)
    with remembered_interrupts() as stop_if_told:
        thing = Finalised()
        del thing
        with pytest.raises(KeyboardInterrupt):
            stop_if_told()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
