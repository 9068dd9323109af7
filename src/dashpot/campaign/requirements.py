"""Requirements on measures: a bound that a share of the scenarios must keep."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from dashpot.campaign.measures import MEASURES
from dashpot.errors import InputError
from dashpot.support.tables import as_float, check_keys

DEGREES = "_deg"
KEYS = {"min", "max", "in", "quantile", "joint", "where"}


@dataclass(frozen=True)
class Requirement:
    """One line of ``[requirements]``.

    Attributes:
        measure: Name in `MEASURES`.
        low: Least value [SI].
        high: Largest value [SI].
        among: The only values allowed, of a measure that counts; empty: any within the bounds.
        quantile: Share of the judged scenarios that must keep the bounds [-]; 1: every one.
        joint: The joint judged; None: every joint, each by itself.
        where: Axes and values (grid labels, or tuples of them) that select the judged scenarios.
        degrees: Whether it was written in degrees.
    """

    measure: str
    low: float = -math.inf
    high: float = math.inf
    quantile: float = 1.0
    joint: str | None = None
    where: tuple[tuple[str, Any], ...] = ()
    degrees: bool = False
    among: tuple[float, ...] = ()

    @property
    def name(self) -> str:
        """The key it was written under."""
        return self.measure + (DEGREES if self.degrees else "")

    @property
    def factor(self) -> float:
        """From SI to the unit it was written in."""
        return math.degrees(1.0) if self.degrees else 1.0

    @property
    def unit(self) -> str:
        """The unit it was written in."""
        unit = MEASURES[self.measure].unit
        return unit.replace("rad", "deg") if self.degrees else unit

    def allows(self, value: float) -> bool:
        """Whether a value of the measure [SI] keeps the bounds; NaN, of a scenario that is lost, does not."""
        return self.low <= value <= self.high and (not self.among or value in self.among)

    @property
    def words(self) -> str:
        """The requirement in words."""
        unit = "" if self.unit == "-" else f" {self.unit}"
        parts = [
            f"{word} {bound * self.factor:g}{unit}"
            for word, bound in (("at least", self.low), ("at most", self.high))
            if math.isfinite(bound)
        ]
        if self.among:
            parts.append(f"in {', '.join(f'{value * self.factor:g}' for value in self.among)}{unit}")
        share = "" if self.quantile == 1 else f" in {100 * self.quantile:g} %"
        where = "".join(
            f", {axis} = {' | '.join(map(str, value)) if isinstance(value, tuple) else value}"
            for axis, value in self.where
        )
        of = "" if self.joint is None else f" of {self.joint}"
        return f"{self.measure}{of} {' and '.join(parts)}{share}{where}"


def parse_requirements(table: Mapping[str, Any], file: object) -> tuple[Requirement, ...]:
    """Reads ``[requirements]``: a table per measure, or a list of them.

    Raises:
        InputError: Naming the measure, its value and the rule.
    """
    found = []
    for key, entry in table.items():
        degrees = key.endswith(DEGREES)
        name = key.removesuffix(DEGREES)
        known = set(MEASURES) | {m + DEGREES for m, kind in MEASURES.items() if kind.unit.startswith("rad")}
        check_keys({key: entry}, known, set(), file=file, under="requirements")
        for item in entry if isinstance(entry, list) else [entry]:
            found.append(_requirement(name, key, degrees, item, file))
    return tuple(found)


def where_of(chosen: Mapping[str, Any]) -> tuple[tuple[str, Any], ...]:
    """``where`` as it is kept: lists as tuples."""
    return tuple((axis, tuple(v) if isinstance(v, list) else v) for axis, v in chosen.items())


def _requirement(name: str, key: str, degrees: bool, item: Any, file: object) -> Requirement:
    where = f"requirements.{key}"
    if not isinstance(item, Mapping):
        raise InputError("must be a table, e.g. { max = 0.1 }", file=file, quantity=where, value=item)
    check_keys(item, KEYS, set(), file=file, under=where)
    if not item.keys() & {"min", "max", "in"}:
        raise InputError("needs a max, a min or an in", file=file, quantity=where, value=dict(item))
    among = item.get("in", [])
    if not isinstance(among, list) or not all(type(value) in (int, float) for value in among):
        raise InputError("must be a list of numbers", file=file, quantity=f"{where}.in", value=among)
    if "in" in item and (not among or item.keys() & {"min", "max"}):
        raise InputError(
            "must not be empty, nor stand beside max or min", file=file, quantity=f"{where}.in", value=among
        )
    for bound in ("min", "max", "quantile"):
        value = item.get(bound, 0.5)
        if type(value) not in (int, float) or not math.isfinite(as_float(value)):
            raise InputError("must be a finite number", file=file, quantity=f"{where}.{bound}", value=value)
    quantile = as_float(item.get("quantile", 1))
    if not 0 < quantile <= 1:
        raise InputError(
            "must be above 0 and at most 1", file=file, quantity=f"{where}.quantile", value=quantile
        )
    scale = math.pi / 180 if degrees else 1.0
    low, high = (
        scale * as_float(item[k]) if k in item else d for k, d in (("min", -math.inf), ("max", math.inf))
    )
    if low > high:
        raise InputError("min exceeds max", file=file, quantity=where, value=dict(item))
    joint, chosen = item.get("joint"), item.get("where", {})
    if joint is not None and (not isinstance(joint, str) or not MEASURES[name].per_joint):
        raise InputError(
            "must be a joint's name, of a measure per joint",
            file=file,
            quantity=f"{where}.joint",
            value=joint,
        )
    if not isinstance(chosen, Mapping) or not all(
        isinstance(v, str | int | float)
        or (isinstance(v, list) and v and all(isinstance(one, str | int | float) for one in v))
        for v in chosen.values()
    ):
        raise InputError(
            'must be a table of axes and values or lists of them, e.g. { fault = "none" }',
            file=file,
            quantity=f"{where}.where",
            value=chosen,
        )
    allowed = tuple(scale * as_float(value) for value in among)
    return Requirement(name, low, high, quantile, joint, where_of(chosen), degrees, allowed)
