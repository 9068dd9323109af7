"""Checked TOML tables: dataclass fields that carry their unit and their valid range."""

from __future__ import annotations

import dataclasses
import difflib
import json
import math
import numbers
import tomllib
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from dashpot.errors import InputError, InputWarning

T = TypeVar("T")


@dataclasses.dataclass(frozen=True)
class Range:
    """Unit and limits of a number.

    Attributes:
        unit: SI unit, as printed in messages.
        low: Smallest valid value.
        high: Largest valid value; beyond it the unit must be wrong.
        open_low: Whether ``low`` itself is invalid.
        typical: Range outside which a warning asks whether the unit is right; zero never warns.
    """

    unit: str
    low: float
    high: float
    open_low: bool = False
    typical: tuple[float, float] | None = None

    @property
    def behind(self) -> str:
        """The unit as it stands behind a number; "" where there is none."""
        return "" if self.unit == "-" else f" {self.unit}"

    @property
    def rule(self) -> str:
        """The rule in words."""
        if self.low == 0 and math.isinf(self.high):
            return "must be positive" if self.open_low else "must not be negative"
        return f"must be {'above' if self.open_low else 'at least'} {self.low:g} and at most {self.high:g}"


def number(
    unit: str,
    low: float = 0.0,
    high: float = math.inf,
    *,
    open_low: bool = False,
    typical: tuple[float, float] | None = None,
    default: Any = dataclasses.MISSING,
    kw_only: bool = True,
) -> Any:
    """A dataclass field holding a number with a unit and a valid range (see `Range`)."""
    return dataclasses.field(
        default=default, metadata={"range": Range(unit, low, high, open_low, typical)}, kw_only=kw_only
    )


def unusual(record: Any, *, file: object = None, joint: str | None = None) -> list[str]:
    """In words, which `number` fields of a valid record lie far outside what is seen on real robots."""
    found = []
    for f in dataclasses.fields(record):
        limits: Range | None = f.metadata.get("range")
        value: Any = getattr(record, f.name)
        if limits is None or limits.typical is None or value is None or value == 0 or math.isinf(value):
            continue
        low, high = limits.typical
        if not low <= abs(value) <= high:
            side = ", on the link side of the gear" if joint is not None else ""
            message = InputError(
                f"is unusual (typical: {low:g} to {high:g}{limits.behind}); check the unit: SI{side}",
                file=file,
                joint=joint,
                quantity=f"{f.name} [{limits.unit}]",
                value=value,
            )
            found.append(str(message))
    return found


def check_numbers(record: Any, *, file: object = None, joint: str | None = None) -> None:
    """Checks every `number` field of a dataclass instance.

    Raises:
        InputError: A value is not a finite number (an infinite limit is allowed where the range is open
            upwards and the default is infinite) or lies outside its range.

    Warns:
        InputWarning: A value lies far outside what such quantities are on real robots.
    """
    for f in dataclasses.fields(record):
        limits: Range | None = f.metadata.get("range")
        value: Any = getattr(record, f.name)
        if limits is None or (value is None and f.default is None):
            continue
        where: dict[str, Any] = {
            "file": file,
            "joint": joint,
            "quantity": f"{f.name} [{limits.unit}]",
            "value": value,
        }
        if isinstance(value, bool) or not isinstance(value, numbers.Real):
            raise InputError("must be a number", **where)
        value = as_float(value)
        unlimited = math.isinf(value) and value > 0 and f.default == math.inf
        if not math.isfinite(value) and not unlimited:
            raise InputError("must be finite", **where)
        too_low = value <= limits.low if limits.open_low else value < limits.low
        if too_low or (value > limits.high and not unlimited):
            raise InputError(f"{limits.rule}{limits.behind}", **where)
    for message in unusual(record, file=file, joint=joint):
        warnings.warn(message, InputWarning, stacklevel=3)


def read_toml(path: Path) -> dict[str, Any]:
    """Reads a TOML file.

    Raises:
        InputError: The file is missing, unreadable or not TOML.
    """
    try:
        with path.open("rb") as stream:
            return tomllib.load(stream)
    except FileNotFoundError:
        raise InputError("no such file", file=path) from None
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", file=path) from None
    except (ValueError, RecursionError) as error:  # bad syntax, bad UTF-8, an absurdly long number or nesting
        raise InputError(f"not valid TOML: {error}", file=path) from None


def as_float(value: Any) -> float:
    """The number as a float; an integer beyond the range of floats becomes infinite."""
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf


def check_keys(
    table: Mapping[str, Any],
    allowed: set[str],
    required: set[str],
    *,
    file: object = None,
    joint: str | None = None,
    under: str = "",
) -> None:
    """Checks that a table has every required key and no unknown one.

    Args:
        table: What was read.
        allowed: Keys that may be there.
        required: Those that must.
        file: Named in the error.
        joint: Likewise.
        under: The table's own key, "axes.gains" say, which stands before the keys in it.

    Raises:
        InputError: Naming the key, with the nearest valid spelling where there is one.
    """
    for key in table:
        if key not in allowed:
            near = [name for name in sorted(allowed) if name.lower() == key.lower()]
            near = near or difflib.get_close_matches(key, allowed, n=1)
            hint = f"; did you mean {near[0]!r}?" if near else f"; known: {', '.join(sorted(allowed))}"
            named = f"{under}.{key}" if under else key
            raise InputError(f"unknown key{hint}", file=file, joint=joint, quantity=named)
    missing = sorted(required - table.keys())
    if missing:
        rule = f"missing key{'s' if len(missing) > 1 else ''}: {', '.join(missing)}"
        raise InputError(rule, file=file, joint=joint, quantity=under or None)


def from_table(cls: type[T], table: Mapping[str, Any], *, file: object = None, joint: str | None = None) -> T:
    """Builds a dataclass of numbers and strings from a TOML table, checking keys and ranges.

    Raises:
        InputError: See `check_keys` and `check_numbers`.
    """
    fields = dataclasses.fields(cls)  # type: ignore[arg-type]
    required = {
        f.name
        for f in fields
        if f.default is dataclasses.MISSING and f.default_factory is dataclasses.MISSING
    }
    check_keys(table, {f.name for f in fields}, required, file=file, joint=joint)
    values = {
        f.name: as_float(v) if "range" in f.metadata and type(v) is int else v
        for f in fields
        if (v := table.get(f.name)) is not None
    }
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", InputWarning)  # given below, with the name of the file
            record = cls(**values)
    except InputError as error:
        raise InputError(
            error.rule, file=file, joint=joint or error.joint, quantity=error.quantity, value=error.value
        ) from None
    check_numbers(record, file=file, joint=joint)
    return record


def toml_value(item: Any) -> str:
    """A value as TOML writes it."""
    if isinstance(item, bool):
        return str(item).lower()
    if isinstance(item, str):
        return json.dumps(item, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(item, Mapping):
        inner = ", ".join(f"{key} = {toml_value(number)}" for key, number in item.items())
        return f"{{ {inner} }}" if inner else "{}"
    if isinstance(item, list | tuple):
        return f"[{', '.join(toml_value(part) for part in item)}]"
    return repr(item) if isinstance(item, int) else repr(float(item))
