"""The library that the mujoco package has loaded: addresses for native code, no side effects in commands."""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path

import mujoco

from dashpot.errors import DashpotError


@cache
def _libraries() -> tuple[ctypes.CDLL, ...]:
    folder = Path(mujoco.__file__).parent
    return tuple(
        ctypes.CDLL(str(p)) for p in sorted([*folder.glob("libmujoco*"), *folder.glob("mujoco.dll")])
    )


@cache
def engine(function: str) -> int:
    """Address of a function in the library the mujoco package loaded.

    Raises:
        DashpotError: It has none.
    """
    for library in _libraries():
        if hasattr(library, function):
            return ctypes.cast(getattr(library, function), ctypes.c_void_p).value or 0
    raise DashpotError(f"{mujoco.__file__}: no MuJoCo library with {function}; reinstall mujoco")


def quiet_engine() -> None:
    """For processes that are dashpot's own: no MUJOCO_LOG.TXT in the current folder, and no profiler.

    A divergence is reported anyway. The Python package has MuJoCo read the clock many times a step, for
    ``data.timer``: a seventh of the step of a seven-joint arm. ``mujoco.set_mjcb_time(None)`` brings that
    clock back, so the pointer itself is cleared; nobody may be stepping while it is.
    """
    mujoco.set_mju_user_warning(lambda _: None)
    for library in _libraries():
        if hasattr(library, "mjcb_time"):
            ctypes.c_void_p.in_dll(library, "mjcb_time").value = None
