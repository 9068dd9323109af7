"""What a process asks of the operating system so that its cycles come on time, and what it was granted."""

from __future__ import annotations

import ctypes
import gc
import os
import re
import resource
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

_MCL_CURRENT, _MCL_FUTURE, _PR_SET_TIMERSLACK = 1, 2, 29
_PERMIT = "permit it: `sudo setcap cap_sys_nice,cap_ipc_lock+ep $(readlink -f .venv/bin/python)`"


@dataclass(frozen=True)
class Measure:
    """One thing asked for.

    Attributes:
        name: Of the measure.
        granted: Whether it is in force.
        said: What that means; where it is not in force what it costs and how to permit it.
    """

    name: str
    granted: bool
    said: str


def _lock_memory() -> Measure:
    libc = ctypes.CDLL(None, use_errno=True)
    # With a limit, memory to come must not be locked: it would not be given out beyond it.
    free = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY or os.geteuid() == 0
    if hasattr(libc, "mlockall") and libc.mlockall(_MCL_CURRENT | (_MCL_FUTURE if free else 0)) == 0:
        return Measure("memory", True, "locked: no page is fetched from disk within a cycle")
    why = os.strerror(ctypes.get_errno())
    return Measure(
        "memory", False, f"not locked ({why}): a page fault may cost a cycle milliseconds; {_PERMIT}"
    )


def _priority(priority: int) -> Measure:
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError as error:
        return Measure(
            "priority",
            False,
            f"normal ({error.strerror}): any other program may delay a cycle by milliseconds; {_PERMIT}",
        )
    return Measure("priority", True, f"real-time, SCHED_FIFO {priority}")


def _affinity(cpu: int | None) -> Measure:
    isolated = Path("/sys/devices/system/cpu/isolated")
    if cpu is None:
        listed = isolated.read_text().strip() if isolated.exists() else ""
        if listed:
            return Measure(
                "processor",
                False,
                f"any: {listed} is isolated from other work; use --cpu {re.split('[-,]', listed)[0]}",
            )
        return Measure(
            "processor",
            False,
            "any: moving between them costs microseconds; boot with isolcpus=N, use --cpu N",
        )
    try:
        os.sched_setaffinity(0, {cpu})
    except OSError as error:
        return Measure(
            "processor", False, f"any: {cpu} is refused ({error.strerror}); --cpu takes one that exists"
        )
    return Measure("processor", True, f"{cpu} only")


def _kernel() -> Measure:
    realtime = Path("/sys/kernel/realtime")
    if realtime.exists() and realtime.read_text().strip() == "1":
        return Measure("kernel", True, "PREEMPT_RT")
    return Measure(
        "kernel",
        False,
        "not a real-time one: it may hold a cycle up by milliseconds; install a PREEMPT_RT kernel",
    )


@contextmanager
def undisturbed(priority: int, cpu: int | None = None) -> Iterator[list[Measure]]:
    """Keeps Python's garbage collector out, and where permitted paging and other programs; undone at the end.

    Args:
        priority: Of SCHED_FIFO, 1 to 99; 0: only the garbage collector is kept out.
        cpu: Processor to stay on, or None.
    """
    measures: list[Measure] = []
    was_enabled = gc.isenabled()
    gc.collect()
    gc.freeze()
    gc.disable()
    policy, parameters, allowed = os.sched_getscheduler(0), os.sched_getparam(0), os.sched_getaffinity(0)
    libc = ctypes.CDLL(None)
    try:
        if priority > 0:
            measures += [_lock_memory(), _priority(priority), _affinity(cpu), _kernel()]
            libc.prctl(
                _PR_SET_TIMERSLACK, ctypes.c_ulong(1)
            )  # [ns]; a sleep is late by up to 50 us by default
        yield measures
    finally:
        if priority > 0:
            with suppress(OSError):
                os.sched_setscheduler(0, policy, parameters)
                os.sched_setaffinity(0, allowed)
            libc.munlockall()
            libc.prctl(_PR_SET_TIMERSLACK, ctypes.c_ulong(0))
        gc.unfreeze()
        if was_enabled:
            gc.enable()


__all__ = ["Measure", "undisturbed"]
