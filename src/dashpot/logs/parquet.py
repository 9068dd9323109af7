"""Logs as Parquet: the columns of a CSV log."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from dashpot.errors import DashpotError, InputError
from dashpot.logs.channels import Raw, Source, Topics, columns, seconds, table
from dashpot.logs.log import Log
from dashpot.support.installing import install

SAMPLING = b"dashpot.sampling"  # key in the file's metadata


def arrow() -> tuple[Any, Any]:
    """pyarrow and pyarrow.parquet.

    Raises:
        DashpotError: They are not installed.
    """
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise DashpotError(f"Parquet logs need pyarrow: {install('logs')}") from None
    return pyarrow, pyarrow.parquet


def read_parquet(path: Path, topics: Topics) -> Raw:
    """Reads a Parquet log; null is a missing sample, and the time may be of a timestamp type.

    Raises:
        InputError: Naming file, column and rule.
    """
    pa, parquet = arrow()
    try:
        schema = parquet.read_schema(path)
        time, found = columns(list(schema.names), topics, path)
        content = parquet.read_table(path, columns=[time, *found])
    except InputError:
        raise
    except (pa.ArrowException, OSError, ValueError, KeyError) as error:
        reason = str(error).strip().splitlines()
        raise InputError(f"not a whole Parquet file: {reason[0] if reason else error!r}", file=path) from None
    if content.num_rows == 0:
        raise InputError("has columns but no rows", file=path)
    arrays = {}
    for name in (time, *found):
        column = content.column(name)
        if name == time and pa.types.is_timestamp(column.type):
            column = column.cast(pa.timestamp("ns")).cast(pa.int64())
        if not (pa.types.is_integer(column.type) or pa.types.is_floating(column.type)):
            raise InputError(f"must hold numbers, not {column.type}", file=path, quantity=name)
        if name == time and column.null_count:
            raise InputError("every row needs a time", file=path, quantity=name)
        arrays[name] = column.to_numpy()  # null becomes NaN
    stamps = arrays.pop(time)
    if not np.isfinite(stamps).all():
        row = int(np.argmin(np.isfinite(stamps)))
        raise InputError(f"row {row + 1}: every row needs a time", file=path, quantity=time)
    said = (schema.metadata or {}).get(SAMPLING)
    rows = np.arange(1, len(stamps) + 1)
    values = {key: np.array(arrays[name], float) for name, key in found.items()}
    source = Source("row", rows, seconds(stamps, time, path), values)
    return Raw([source], None if said is None else said.decode())


def write_parquet(log: Log, path: Path) -> None:
    """Writes a log, and in the metadata how its torque was sampled."""
    pa, parquet = arrow()
    names, values = table(log)
    content = pa.table([np.ascontiguousarray(column) for column in values.T], names=names)
    parquet.write_table(content.replace_schema_metadata({SAMPLING: log.sampling}), path)
