"""Output folders that appear whole or not at all."""

from __future__ import annotations

import errno
import os
import secrets
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from dashpot.errors import InputError

MARKER = ".dashpot"
"""File that marks a folder as written by dashpot, which may be replaced."""

ATTEMPTS = 100  # at taking the place of a folder that other runs replace at the same time


@contextmanager
def whole_folder(target: Path) -> Iterator[Path]:
    """A folder to write into; it takes the place of ``target`` only when the block ends without an error.

    Raises:
        InputError: ``target`` exists and is not a folder dashpot wrote, holds the current folder, or cannot
            be created.
    """

    def refuse(rule: str) -> InputError:
        return InputError(rule, quantity="--out", value=str(target))

    try:
        place = target.resolve()  # a link keeps pointing to what is replaced
        _check(place, refuse)
        token = secrets.token_hex(4)
        work, old = (place.with_name(f".{place.name}.{token}.{end}") for end in ("part", "old"))
        created = [parent for parent in place.parents if not parent.exists()]
    except InputError:
        raise
    except (OSError, RuntimeError, ValueError) as error:  # RuntimeError: links in a circle
        raise refuse(f"cannot be created: {getattr(error, 'strerror', None) or error}") from None
    try:
        try:  # in here, so that a signal that comes right after it finds it removed
            work.mkdir(parents=True)
        except OSError as error:
            raise refuse(f"cannot be created: {error.strerror or error}") from None
        yield work
        (work / MARKER).touch()
        for _ in range(ATTEMPTS):
            _check(place, refuse)
            with suppress(FileNotFoundError):
                place.rename(old)
            try:
                work.rename(place)
                shutil.rmtree(old, ignore_errors=True)
                break
            except OSError as error:
                if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
                    raise
                shutil.rmtree(old, ignore_errors=True)  # another run was faster; replace its folder
        else:
            raise refuse("other runs keep replacing it; choose another folder")
    finally:
        if old.exists() and not place.exists():
            with suppress(OSError):  # another run was faster
                old.rename(place)
        shutil.rmtree(old, ignore_errors=True)
        shutil.rmtree(work, ignore_errors=True)
        if not place.exists():
            with suppress(OSError):  # another run uses it
                for parent in created:
                    parent.rmdir()


def _check(place: Path, refuse: Callable[[str], InputError]) -> None:
    # Looked at twice: while another run replaces the folder, its marker may be gone before the rest is.
    if _foreign(place) and _foreign(place):
        raise refuse("exists and was not written by dashpot; choose another folder")
    if Path.cwd().is_relative_to(place):
        raise refuse("is or holds the current folder, which cannot be replaced; choose another folder")


def _foreign(place: Path) -> bool:
    try:
        names = os.listdir(place)
    except FileNotFoundError:
        return False
    except NotADirectoryError:
        return place.exists()  # or a file stands in the way, which mkdir will say
    return bool(names) and MARKER not in names
