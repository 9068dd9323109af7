"""Errors a user can act on: one line that names file, joint, quantity, value and rule."""

from __future__ import annotations

import numbers
from collections.abc import Mapping
from pathlib import PurePath


class DashpotError(Exception):
    """Base class of every error dashpot raises on purpose; the command line prints it as one line."""


class InputError(DashpotError, ValueError):
    """A value given by the user breaks a rule.

    The message reads ``file: joint 'j5': quantity = value: rule``; parts that do not apply are left out.

    Args:
        rule: The rule that is broken and what would be valid, e.g. ``"must be positive"``.
        file: File the value came from.
        joint: Name of the joint concerned.
        quantity: Name of the key or argument, with its unit where it has one, e.g. ``"stiffness [N m/rad]"``.
        value: The offending value.
    """

    def __init__(
        self,
        rule: str,
        *,
        file: object = None,
        joint: str | None = None,
        quantity: str | None = None,
        value: object = None,
    ) -> None:
        self.rule, self.file, self.joint, self.quantity, self.value = rule, file, joint, quantity, value
        where = [str(file)] if file is not None else []
        if joint is not None:
            where.append(f"joint {joint!r}")
        if quantity is not None:
            where.append(quantity if value is None else f"{quantity} = {_short(value)}")
        super().__init__(_one_line(": ".join([*where, rule])))


def _short(value: object) -> str:
    try:
        text = written(value)
    except ValueError:  # an integer of thousands of digits
        text = f"a {type(value).__name__} too long to print"
    return text if len(text) <= 100 else f"{text[:97]}..."


def written(value: object) -> str:
    """A value as a person writes it in a file or behind a flag, not as Python shows it."""
    match value:
        case bool():
            return str(value).lower()
        case numbers.Real() if not isinstance(value, numbers.Integral):
            full, short = repr(float(value)), f"{float(value):g}"
            return short if len(short) < len(full) - 2 and float(short) == value else full
        case PurePath():
            return repr(str(value))
        case list():
            return f"[{', '.join(map(written, value))}]"
        case Mapping():
            inner = ", ".join(f"{key} = {written(one)}" for key, one in value.items())
            return f"{{ {inner} }}" if inner else "{}"
    return repr(value)


def _one_line(text: str) -> str:
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


class ModelError(DashpotError, ValueError):
    """A robot model file cannot be used: it is missing, does not compile, or lacks a named joint or site."""


class InputWarning(UserWarning):
    """An input is legal but probably not meant, e.g. off by orders of magnitude."""
