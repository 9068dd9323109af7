"""The C compiler of this machine, for the binary of an FMU."""

from __future__ import annotations

import os
import platform
import shlex
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

from dashpot.errors import InputError

FLAGS = ("-std=c99", "-O2", "-fPIC", "-shared", "-fvisibility=hidden", "-ffp-contract=off", "-s")


def compiler() -> list[str] | None:
    """The compiler's command: what CC says, or cc, gcc or clang; None where there is none."""
    asked = os.environ.get("CC")
    if asked:
        return shlex.split(asked)
    found = next((path for name in ("cc", "gcc", "clang") if (path := shutil.which(name))), None)
    return None if found is None else [found]


def platform_tuple() -> tuple[str, str | None, str] | None:
    """This machine as FMI 3.0 and 2.0 name it, and the ending of its libraries; None: no name there."""
    machine = {"x86_64": "x86_64", "AMD64": "x86_64", "aarch64": "aarch64", "arm64": "aarch64"}.get(
        platform.machine()
    )
    if machine is None or platform.system() not in ("Linux", "Darwin"):
        return None
    system, ending = ("linux", "so") if platform.system() == "Linux" else ("darwin", "dylib")
    return f"{machine}-{system}", f"{system}64" if machine == "x86_64" else None, ending


def build_library(sources: Sequence[Path], library: Path) -> None:
    """Compiles C99 sources into a shared library.

    Raises:
        InputError: There is no compiler, or it refuses.
    """
    command = compiler()
    if command is None:
        raise InputError("there is no C compiler; install one, or name it", quantity="CC")
    arguments = [*command, *FLAGS, *map(str, sources), "-o", str(library)]
    try:
        done = subprocess.run(arguments, capture_output=True, text=True, check=False)
    except OSError as error:
        raise InputError(
            f"cannot be run: {error.strerror}", quantity="CC", value=shlex.join(command)
        ) from None
    if done.returncode:
        said = (done.stderr.strip().splitlines() or ["no message"])[0]
        raise InputError(f"the C compiler failed: {said}", quantity="CC", value=shlex.join(command))
