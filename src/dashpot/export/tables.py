"""Numbers and records as C99 text that reads back to the same bits."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

WIDTH = 110  # of a line
UNLIMITED = "UNLIMITED"
"""Macro of the exported file for infinity."""


def c_double(value: float) -> str:
    """A finite or infinite number as a C99 constant: short where that is exact, hexadecimal elsewhere.

    >>> c_double(0.5), c_double(0.1), c_double(math.inf)
    ('0.5', '0x1.999999999999ap-4', 'UNLIMITED')

    Raises:
        ValueError: Not a number.
    """
    value = float(value)
    if math.isnan(value):
        raise ValueError("NaN has no C constant")
    if math.isinf(value):
        return UNLIMITED if value > 0 else f"-{UNLIMITED}"
    if abs(value) < 1e6 and (value * 1024).is_integer() and len(repr(value)) <= 8:
        return repr(value)
    return value.hex()


def c_record(record: NDArray[np.void], notes: dict[str, str] | None = None, indent: str = "    ") -> str:
    """A record as the lines of a designated initialiser; fields that are all zero are left out.

    Args:
        record: 0-d record array.
        notes: Field -> comment behind it.
        indent: Of the lines.
    """
    lines: list[str] = []
    for name in record.dtype.names or ():
        value = np.asarray(record[name])
        if _blank(value):
            continue
        note = f" /* {notes[name]} */" if notes and name in notes else ""
        lines += _wrapped(f"{indent}.{name} = {_value(value, indent)},{note}")
    return "\n".join(lines)


def _wrapped(text: str) -> Iterator[str]:
    """Lines of at most `WIDTH` letters, continued under the innermost brace."""
    for given in text.split("\n"):
        line, column = given, given.rfind("{") + 1
        while len(line) > WIDTH and ", " in line[column:WIDTH]:
            end = line.rindex(", ", 0, WIDTH) + 1
            yield line[:end]
            line = " " * column + line[end + 1 :]
        yield line


def _blank(value: NDArray[np.generic]) -> bool:
    """Whether C sets it so by itself: zeros, none of them negative."""
    return not value.any() and not np.signbit(value).any()


def _value(value: NDArray[np.generic], indent: str) -> str:
    if value.ndim == 2:
        rows = _trimmed(["{0}" if _blank(row) else _value(row, indent) for row in value], "{0}")
        gap = f",\n{indent}    "
        return f"{{{gap[1:]}{gap.join(rows)},\n{indent}}}" if len(rows) > 1 else f"{{{rows[0]}}}"
    if value.ndim == 1:
        return f"{{{', '.join(_trimmed([_scalar(x) for x in value], '0.0'))}}}"
    return _scalar(value[()])


def _scalar(value: object) -> str:
    return str(int(value)) if isinstance(value, np.integer) else c_double(float(value))  # type: ignore[arg-type]


def _trimmed(parts: Iterable[str], zero: str) -> list[str]:
    """Without zeros at the end, at least one part."""
    kept = list(parts)
    while len(kept) > 1 and kept[-1] == zero:
        kept.pop()
    return kept
