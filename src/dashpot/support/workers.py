"""Work shared among processes that stop at once with this one."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_context
from typing import TypeVar

from dashpot.errors import DashpotError, InputWarning

NATIVE_LOOP = "dashpot native loop"
"""Name of a thread that may still be in native code when the command is stopped."""
PATIENCE = 2.0  # [s] with a pool whose processes have been killed
Task = TypeVar("Task")
Result = TypeVar("Result")


def cores() -> int:
    """Processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def each(
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
    workers: int,
    advance: Callable[[], None] = lambda: None,
) -> list[Result]:
    """Calls a function with every task, in processes of their own or here if one is enough.

    Args:
        function: Of a module that can be imported.
        tasks: What to call it with.
        workers: Processes; more than one needs a main module that may be imported again.
        advance: Called after every task.

    Returns:
        Results in the order of the tasks.
    """
    workers = min(workers, len(tasks))
    if workers <= 1:
        done = []
        for task in tasks:
            done.append(function(task))
            advance()
        return done
    with pool_of(workers) as pool:
        with deaf_to_interrupts():
            futures: list[Future[Result]] = [pool.submit(function, task) for task in tasks]
        try:
            for future in as_completed(futures):
                future.result()
                advance()
        except BrokenProcessPool:
            raise DashpotError(
                "a worker process was ended from outside, perhaps for want of memory; try --workers 1"
            ) from None
        return [future.result() for future in futures]


def is_manager(thread: threading.Thread) -> bool:
    """Whether a thread looks after a pool of processes; the interpreter waits for it before it ends."""
    return type(thread).__name__ == "_ExecutorManagerThread"


@contextmanager
def pool_of(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Processes that end at once when this one is stopped, whatever they are at."""
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(workers, get_context("spawn"), warnings.simplefilter, ("ignore", InputWarning))
    try:
        yield pool
    except BaseException:
        for process in set(multiprocessing.active_children()) - others:
            process.kill()
        # Not waited for long: a process may have died with a lock of the pool's queues in its hands.
        pool.shutdown(wait=False, cancel_futures=True)
        for thread in threading.enumerate():
            if is_manager(thread):
                thread.join(PATIENCE)
        raise
    pool.shutdown()


@contextmanager
def remembered_interrupts() -> Iterator[Callable[[], None]]:
    """Gives a function that stops again what has been told to stop by Ctrl-C.

    A KeyboardInterrupt that comes up in a finaliser is lost; a long loop asks once per round.
    """
    seen = False

    def note(*_: object) -> None:
        nonlocal seen
        seen = True
        raise KeyboardInterrupt

    def ask() -> None:
        if seen:
            raise KeyboardInterrupt

    main = threading.current_thread() is threading.main_thread()
    if not main or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield ask
        return
    signal.signal(signal.SIGINT, note)
    try:
        yield ask
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@contextmanager
def deaf_to_interrupts() -> Iterator[None]:
    """Processes started here leave Ctrl-C to this one, which ends them."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
