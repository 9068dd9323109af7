"""Errors of a campaign's scenarios, named by the file, the key and the value that a person wrote."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from dashpot.campaign.axes import Axis, value_label
from dashpot.errors import InputError, written

MULTIPLIED = ("gains", "drive")


@contextmanager
def of_axis(file: Path | None, axis: Axis, value: Any) -> Iterator[None]:
    """Blames an error on the value of an axis."""
    try:
        yield
    except InputError as error:
        shown = value_label(value) if isinstance(value, dict | tuple) else plain(value)
        kind, at, rule = axis.name.partition(".")[0], error.quantity, error.rule
        if at is not None and kind in MULTIPLIED and error.value is not None:
            whose = "" if error.joint is None else f" of joint {error.joint!r}"
            rule = f"{at}{whose} would be {written(error.value)}: {rule}"
        elif error.file == file and at is not None and at.startswith("axes."):
            raise
        else:
            about = None if error.file == file else error.file
            rule = str(InputError(rule, file=about, joint=error.joint, quantity=at, value=plain(error.value)))
        key = axis.name if axis.name == "controller" else f"axes.{axis.name}"
        raise InputError(rule, file=file, quantity=key, value=shown) from None


@contextmanager
def of_name(file: Path | None, key: str, name: str) -> Iterator[None]:
    """Blames the key that names a robot or a controller where there is none of that name."""
    try:
        yield
    except InputError as error:
        if error.file is None or not Path(str(error.file)).exists():
            raise InputError(error.rule, file=file, quantity=key, value=name) from None
        raise


def plain(value: Any) -> Any:
    """A number without a fraction that nobody wrote."""
    return int(value) if isinstance(value, float) and value.is_integer() else value
