"""Output folders that appear whole or not at all."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from dashpot.errors import InputError

MARKER = ".dashpot"
"""File that marks a folder as written by dashpot, which may be replaced."""


@contextmanager
def whole_folder(target: Path) -> Iterator[Path]:
    """A folder to write into; it takes the place of ``target`` only when the block ends without an error.

    Raises:
        InputError: ``target`` exists and is not a folder dashpot wrote, or cannot be created.
    """
    if target.exists() and not (
        target.is_dir() and ((target / MARKER).exists() or not any(target.iterdir()))
    ):
        raise InputError(
            "exists and was not written by dashpot; choose another folder",
            quantity="--out",
            value=str(target),
        )
    work = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        work.mkdir(parents=True)
    except OSError as error:
        raise InputError(
            f"cannot be created: {error.strerror}", quantity="--out", value=str(target)
        ) from None
    try:
        yield work
        (work / MARKER).touch()
        old = target.with_name(f".{target.name}.{os.getpid()}.old")
        if target.exists():
            target.rename(old)
        work.rename(target)
        shutil.rmtree(old, ignore_errors=True)
    finally:
        shutil.rmtree(work, ignore_errors=True)
