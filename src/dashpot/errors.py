"""Errors a user can act on: one line that names file, joint, quantity, value and rule."""

from __future__ import annotations


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
        text = repr(value)
    except ValueError:  # an integer of thousands of digits
        text = f"a {type(value).__name__} too long to print"
    return text if len(text) <= 100 else f"{text[:97]}..."


def _one_line(text: str) -> str:
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


class ModelError(DashpotError, ValueError):
    """A robot model file cannot be used: it is missing, does not compile, or lacks a named joint or site."""


class InputWarning(UserWarning):
    """An input is legal but probably not meant, e.g. off by orders of magnitude."""
