"""Log files: CSV, Parquet and MCAP, read and written. Conventions: docs/logs.md."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, cast, get_args

from dashpot.control.controller import Sampling
from dashpot.errors import InputError, InputWarning
from dashpot.logs.atomic import replaced
from dashpot.logs.channels import Topics
from dashpot.logs.grid import make_log
from dashpot.logs.log import Log

if TYPE_CHECKING:
    from dashpot.logs.channels import Raw

SUFFIXES = (".csv", ".parquet", ".mcap")
CHUNK = 1 << 20  # [bytes] hashed at a time


def read_log(path: str | Path, *, sampling: Sampling | None = None, topics: Topics | None = None) -> Log:
    """Reads a log and puts it on a uniform grid of time.

    Args:
        path: ``.csv``, ``.parquet`` or ``.mcap``.
        sampling: ``"average"``: each torque sample is the mean over the last period; ``"point"``: the latest
            value. None: what the file says (dashpot's own Parquet and MCAP do), else ``"point"``.
        topics: Names of topics; None: the usual ones.

    Raises:
        InputError: Naming file, line or row, time and rule.

    Warns:
        InputWarning: Gaps, jitter, repeated rows, incomplete joints, and units that look wrong.
    """
    path = Path(path)
    raw = read_raw(path, topics or Topics())
    stated = sampling or raw.sampling
    if stated is None:
        warnings.warn(
            f"{path}: does not say how torque is sampled; taken as point samples (else: --sampling average, "
            "means over the last period)",
            InputWarning,
            stacklevel=2,
        )
        stated = "point"
    if stated not in get_args(Sampling):
        raise InputError('must be "average" or "point"', file=path, quantity="sampling", value=stated)
    return make_log(raw, cast("Sampling", stated), path, _digest(path))


def read_raw(path: Path, topics: Topics) -> Raw:
    """Reads a log's samples as they are.

    Raises:
        InputError: Naming file, line or message and rule.
    """
    return _reader(path)(path, topics)


def check_log_path(path: Path, quantity: str) -> None:
    """Checks that a log can be written: the kind of file, and the packages it takes.

    Raises:
        InputError: Otherwise.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"must end in {', '.join(SUFFIXES)}", quantity=quantity, value=str(path))
    if path.is_dir():
        raise InputError("is a folder", quantity=quantity, value=str(path))
    if path.suffix.lower() == ".parquet":
        from dashpot.logs.parquet import arrow

        arrow()
    elif path.suffix.lower() == ".mcap":
        from dashpot.logs.ros import ros

        ros()


def write_log(log: Log, path: str | Path) -> Path:
    """Writes a log as ``.csv``, ``.parquet`` or ``.mcap``; an interrupted write leaves no file.

    Raises:
        InputError: Another ending, or a package is missing.
    """
    path = Path(path)
    check_log_path(path, "log file")
    with replaced(path) as temporary:
        match path.suffix.lower():
            case ".csv":
                from dashpot.logs.csvfile import write_csv

                write_csv(log, temporary)
            case ".parquet":
                from dashpot.logs.parquet import write_parquet

                write_parquet(log, temporary)
            case _:
                from dashpot.logs.ros import write_mcap

                write_mcap(log, temporary)
    return path


def _reader(path: Path) -> Callable[[Path, Topics], Raw]:
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"a log ends in {', '.join(SUFFIXES)}", file=path)
    if not path.exists():
        raise InputError("no such file", file=path)
    if path.is_dir():
        raise InputError("is a folder; name the log file in it", file=path)
    if path.stat().st_size == 0:
        raise InputError("is empty", file=path)
    match path.suffix.lower():
        case ".csv":
            from dashpot.logs.csvfile import read_csv

            return read_csv
        case ".parquet":
            from dashpot.logs.parquet import read_parquet

            return read_parquet
    from dashpot.logs.ros import read_mcap

    return read_mcap


def _digest(path: Path) -> str:
    digest = hashlib.sha256()
    with path.open("rb") as stream:
        while chunk := stream.read(CHUNK):
            digest.update(chunk)
    return digest.hexdigest()


__all__ = ["SUFFIXES", "Topics", "check_log_path", "read_log", "read_raw", "write_log"]
