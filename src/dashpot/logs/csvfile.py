"""Logs and motions as CSV: a header, then numbers."""

from __future__ import annotations

import csv
import warnings
from collections.abc import Callable, Collection, Iterable
from pathlib import Path

import numpy as np

from dashpot.errors import InputError
from dashpot.logs.channels import Ints, Key, Raw, Source, Topics, columns, seconds, table
from dashpot.logs.log import Log
from dashpot.support.arrays import Floats

SEPARATORS = ",;\t"
LONGEST = 1 << 20  # [characters] of a header


def read_csv(path: Path, topics: Topics) -> Raw:
    """Reads a CSV log: columns separated by comma, semicolon or tab; an empty cell is a missing sample.

    Raises:
        InputError: Naming file, line, column and rule.
    """
    names, rows, lines = numbers(path, lambda names: _needed(columns(names, topics, path)))
    time, found = columns(names, topics, path)
    stamps = rows[:, names.index(time)]
    bad = np.flatnonzero(~np.isfinite(stamps))
    if len(bad):
        raise InputError(
            f"line {lines[bad[0]]}: every row needs a time", file=path, quantity=time, value=stamps[bad[0]]
        )
    values = {key: np.ascontiguousarray(rows[:, names.index(name)]) for name, key in found.items()}
    return Raw([Source("line", lines, seconds(stamps, time, path), values)])


def _needed(found: tuple[str, dict[str, Key]]) -> set[str]:
    return {found[0], *found[1]}


def numbers(
    path: Path, needed: Callable[[list[str]], Collection[str]] = lambda names: names
) -> tuple[list[str], Floats, Ints]:
    """Header, (rows, columns) values, and the line each row stands on; empty cells are NaN.

    Args:
        path: The file.
        needed: Of the header, the columns that must hold numbers; text elsewhere is NaN.

    Raises:
        InputError: Not a table of numbers, or without rows.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as stream:
            head = stream.readline(LONGEST)
            if not head.strip():
                raise InputError("line 1: must be a header, e.g. time,joint1/command,...", file=path)
            separator = max(SEPARATORS, key=head.count)
            names = [name.strip() for name in next(csv.reader([head], delimiter=separator))]
            if any(_is_number(name) for name in names):
                raise InputError(
                    "line 1: must be a header, e.g. time,joint1/command,..., not numbers", file=path
                )
            wanted = needed(names)
            rows = _fast(stream, separator, len(names))
            if rows is not None:
                return names, rows, np.arange(2, len(rows) + 2)
        with path.open(encoding="utf-8-sig", newline="") as stream:
            return names, *_careful(path, stream, separator, names, wanted)
    except UnicodeDecodeError:
        raise InputError("is not text (UTF-8)", file=path) from None
    except csv.Error as error:
        raise InputError(f"not valid CSV: {error}", file=path) from None


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _fast(stream: Iterable[str], separator: str, width: int) -> Floats | None:
    """All rows at once, if every cell is a number; blank lines would shift the count of lines."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # an empty table
            text = _CountedLines(stream)
            rows = np.loadtxt(text, delimiter=separator, comments=None, ndmin=2)
    except (ValueError, UserWarning):
        return None
    return rows if len(rows) == text.lines and rows.shape[1] == width else None


class _CountedLines:
    """An iterator over lines that knows how many there were."""

    def __init__(self, stream: Iterable[str]) -> None:
        self.stream, self.lines = iter(stream), 0

    def __iter__(self) -> _CountedLines:
        return self

    def __next__(self) -> str:
        line: str = next(self.stream)
        self.lines += 1
        return line


def _careful(
    path: Path, stream: Iterable[str], separator: str, names: list[str], wanted: Collection[str]
) -> tuple[Floats, Ints]:
    """Cell by cell: empty ones become NaN, and what is wrong is said."""
    reader = csv.reader(stream, delimiter=separator)
    next(reader)
    rows: list[list[float]] = []
    lines: list[int] = []
    for cells in reader:
        if not any(cell.strip() for cell in cells):
            continue
        if len(cells) != len(names):
            raise InputError(
                f"line {reader.line_num}: has {len(cells)} cells, the header {len(names)}", file=path
            )
        row = []
        for name, cell in zip(names, cells, strict=True):
            try:
                row.append(float(cell) if cell.strip() else np.nan)
            except ValueError:
                if name not in wanted:
                    row.append(np.nan)
                    continue
                comma = "; decimals take a point, not a comma" if "," in cell else ""
                raise InputError(
                    f"line {reader.line_num}: must be a number{comma}", file=path, quantity=name, value=cell
                ) from None
        rows.append(row)
        lines.append(reader.line_num)
    if not rows:
        raise InputError("has a header but no rows", file=path)
    return np.array(rows), np.array(lines)


def write_csv(log: Log, path: Path) -> None:
    """Writes a log; every number reads back as the same double."""
    write_table(path, *table(log))


def write_table(path: Path, names: list[str], values: Floats) -> None:
    """Writes a header and (rows, columns) numbers."""
    with path.open("w", encoding="utf-8", newline="") as stream:
        csv.writer(stream, lineterminator="\n").writerow(names)
        for row in values.tolist():
            stream.write(",".join(map(repr, row)) + "\n")
