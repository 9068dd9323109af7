"""``dashpot studio``."""

from __future__ import annotations

import gc
import math
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console

from dashpot.commands.payload import payload_of
from dashpot.errors import DashpotError, InputError
from dashpot.simulation.engine import quiet_engine
from dashpot.support.installing import install
from dashpot.support.limits import check_seed
from dashpot.support.waiting import waiting

if TYPE_CHECKING:
    from dashpot.cli.simulate import Studio

EVERY = 10.0  # [s] between two lines of the soak, and two collections


def studio(options: Studio) -> int:
    """``dashpot studio``; runs until Ctrl-C, or for the time that was asked for."""
    _check(options)
    payload = payload_of(options.payload, options.offset)
    try:
        import viser  # noqa: F401
    except ImportError:
        raise DashpotError(f"the studio needs viser: {install('studio')}") from None
    with waiting("starting"):
        from dashpot.studio.choices import controller_of
        from dashpot.studio.page import open_page

    controller = options.controller or controller_of(options.robot)
    quiet_engine()
    page, console = None, Console()
    try:
        with waiting("opening the page"):
            page = open_page(
                options.robot,
                controller,
                payload,
                host=options.host,
                port=options.port,
                supervise=options.supervise,
                seed=options.seed,
            )
        _forget_the_start()
        console.print(f"studio of {options.robot} under {controller}: open {page.url}", highlight=False)
        if options.host not in ("127.0.0.1", "localhost", "::1"):
            console.print(
                f"[yellow]{options.host}: whoever reaches this address can use it[/]", highlight=False
            )
        console.print("time stands still while no page is open; Ctrl-C ends", style="dim")
        if options.run_for is None:
            while not threading.Event().wait(EVERY):
                gc.collect()
        else:
            _watch(page, options.run_for, console)
    finally:
        with _undisturbed():
            if page is not None:
                page.close()
                page.session.close()
    return 0


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Closes to the end where a second Ctrl-C or SIGTERM comes, as ``timeout`` sends: no process is left."""
    before = {}
    if threading.current_thread() is threading.main_thread():
        before = {number: signal.signal(number, signal.SIG_IGN) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _check(options: Studio) -> None:
    check_seed(options.seed)
    if not 0 <= options.port <= 65535:
        raise InputError("must be 0 to 65535", quantity="--port", value=options.port)
    if options.run_for is not None and not (math.isfinite(options.run_for) and options.run_for > 0):
        raise InputError("must be positive", quantity="--run-for [s]", value=options.run_for)


def _forget_the_start() -> None:
    """Leaves what is there now out of collections, which take milliseconds from then on.

    viser's messages leave cycles, by which memory grows for an hour before Python collects by itself.
    """
    gc.collect()
    gc.freeze()


def _watch(page: object, seconds: float, console: Console) -> None:
    """Says every few seconds what it costs."""
    from dashpot.studio.page import Page
    from dashpot.studio.usage import Usage

    assert isinstance(page, Page)
    usage, end = Usage(), time.monotonic() + seconds
    while (left := end - time.monotonic()) > 0:
        time.sleep(min(EVERY, left))
        gc.collect()
        now = page.session.snapshot()
        console.print(
            f"{now.time:8.1f} s simulated, {usage.line()}, real time x {now.factor:.2f}", highlight=False
        )
