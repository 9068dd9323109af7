"""The laws a ``[[joint]]`` of a controller file may name, and how it is read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from dashpot.control.jointlaw import JointGains, Law
from dashpot.control.rivals.brakes import EncoderDamping, LatchedTorque, Off, RotorObserver, StaticFeedback
from dashpot.control.rivals.tracking import (
    PD,
    PID,
    DisturbanceObserver,
    InertiaShaping,
    PDGravity,
    PDScaled,
    TorqueFeedback,
)
from dashpot.errors import InputError
from dashpot.support.tables import from_table

LAWS: Mapping[str, type[Law]] = {
    kind.law: kind
    for kind in (
        JointGains,
        Off,
        StaticFeedback,
        RotorObserver,
        LatchedTorque,
        EncoderDamping,
        PD,
        PDScaled,
        PID,
        PDGravity,
        DisturbanceObserver,
        TorqueFeedback,
        InertiaShaping,
    )
}
"""By the name a file gives: `law = "..."`; without, "virtual_passive"."""


def law_from_table(table: Mapping[str, Any], *, file: object = None) -> Law:
    """Builds the law of one ``[[joint]]`` table.

    Raises:
        InputError: Naming file, joint, key, value and rule: no name, no such law, an unknown key (with those
            the law has), a missing one, or a number out of range.
    """
    values = dict(table)
    name = values.get("name")
    if not isinstance(name, str):
        raise InputError("every [[joint]] needs a name", file=file, quantity="name", value=name)
    named = values.pop("law", JointGains.law)
    if not isinstance(named, str) or named not in LAWS:
        raise InputError(
            f"must be one of {', '.join(LAWS)}", file=file, joint=name, quantity="law", value=named
        )
    kind = LAWS[named]
    try:
        return from_table(kind, values, file=file, joint=name)
    except InputError as error:
        if not error.rule.startswith("unknown key"):
            raise
        known = ", ".join(f.name for f in fields(kind) if f.name != "name")
        rule = f'{error.rule.partition("; known:")[0]}; law "{named}" has {known}'
        raise InputError(rule, file=file, joint=name, quantity=error.quantity) from None


def to_table(law: Law) -> dict[str, Any]:
    """The ``[[joint]]`` table of a law, values that are defaults left out: `law_from_table` reads it back."""
    table: dict[str, Any] = {"name": law.name}
    if law.law != JointGains.law:
        table["law"] = law.law
    for f in fields(law):
        value = getattr(law, f.name)
        if f.name != "name" and value is not None and value != f.default:
            table[f.name] = value
    return table
