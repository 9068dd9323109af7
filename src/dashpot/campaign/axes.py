"""Axes of a campaign: what varies from scenario to scenario, as lists (grid) or ranges (sampled)."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dashpot.errors import InputError
from dashpot.support.limits import MOST_SEED
from dashpot.support.tables import as_float, check_keys

GAINS = ("R", "D", "K", "kp", "kd")
"""Gains that can be multiplied."""
MULTIPLIED = (
    *("rotor_inertia", "viscous_friction", "coulomb_friction", "stribeck_friction", "stiffness", "damping"),
    *("torque_limit", "torque_noise", "hysteresis", "backlash"),
)
"""Drive values of the plant that can be multiplied."""
ADDED = {"torque_bias": "N m", "torque_scale_error": "-", "torque_latency": "s"}
"""Drive values of the plant to which an amount is added."""
ORDER = (
    "drive",
    "payload",
    "offset",
    "controller",
    "gains",
    "pose",
    "amplitude",
    "trajectory",
    "fault",
    "seed",
)
"""Slowest to fastest index: neighbours share what is expensive to build."""
LIMITS = {
    "payload": ("kg", 0.0, 1e4),
    "offset": ("m", -10.0, 10.0),
    "amplitude": ("rad", 0.0, 4 * math.pi),
    "trajectory": ("-", 0.0, MOST_SEED),
    "seed": ("-", 0.0, MOST_SEED),
}
WHOLE = ("trajectory", "seed")
MOST_VALUES = 100_000
DISTRIBUTIONS = ("uniform", "log-uniform")
NO_FAULT = "none"


@dataclass(frozen=True)
class Axis:
    """One thing that varies.

    Attributes:
        name: "payload", "gains.R", "drive.joint6.stiffness" and so on.
        unit: SI unit of its numbers; "" where it has names.
        values: Of a grid axis; empty where it is sampled.
        low: Lower end of a sampled range.
        high: Upper end.
        log: Whether the logarithm is uniform.
        each_joint: Whether every joint gets a value of its own.
    """

    name: str
    unit: str = ""
    values: tuple[Any, ...] = ()
    low: float = 0.0
    high: float = 0.0
    log: bool = False
    each_joint: bool = False

    @property
    def sampled(self) -> bool:
        """Whether a sample gives its values."""
        return not self.values

    @property
    def label(self) -> str:
        """Its name in the dataset: without what file systems refuse."""
        return re.sub(r"\W", "_", self.name)

    @property
    def named(self) -> bool:
        """Whether its values are names or vectors, not numbers."""
        return any(not isinstance(value, int | float) for value in self.values)

    @property
    def labels(self) -> tuple[Any, ...]:
        """Grid values as the dataset shows them: numbers or strings."""
        return tuple(value_label(value) for value in self.values) if self.named else self.values

    def at(self, share: float) -> float | int:
        """The value at a share in [0, 1) of the range (or at 1: its upper end)."""
        if self.name in WHOLE:
            return min(int(self.low + math.floor(share * (self.high - self.low + 1))), int(self.high))
        if self.log:
            return min(self.low * math.exp(share * math.log(self.high / self.low)), self.high)
        return min(self.low + share * (self.high - self.low), self.high)  # may round beyond it

    def ends(self) -> tuple[Any, ...]:
        """Values at which a check of the axis suffices: the ends of numbers, or every name."""
        if self.sampled:
            return self.at(0.0), self.at(1.0)
        return self.values if self.named else (min(self.values), max(self.values))


def value_label(value: Any) -> str:
    """One value as text."""
    match value:
        case str():
            return value
        case tuple():
            return " ".join(f"{part:g}" for part in value)
        case Mapping():
            return str(value["name"])
    return f"{value:g}"


def parse_axes(table: Mapping[str, Any], file: object) -> tuple[Axis, ...]:
    """Reads ``[axes]``, slowest first.

    Raises:
        InputError: Naming the axis, its value and the rule.
    """
    check_keys(table, set(ORDER), set(), file=file, under="axes")
    axes: list[Axis] = []
    for name in ORDER:
        if name not in table:
            continue
        if name in ("drive", "gains"):
            axes += _nested(name, table[name], file)
        elif name == "fault":
            axes.append(Axis(name, values=_faults(table[name], file)))
        elif name in ("controller", "pose"):
            axes.append(Axis(name, values=_names(name, table[name], file)))
        else:
            axes.append(_numbers(name, *LIMITS[name], table[name], file))
    labels = [axis.label for axis in axes]
    for axis in axes:
        if labels.count(axis.label) > 1:
            raise InputError(
                f"two axes would be called {axis.label!r} in the dataset", file=file, quantity=axis.name
            )
    return tuple(axes)


def _nested(kind: str, table: Any, file: object) -> list[Axis]:
    """Axes of ``gains`` or ``drive``: of a quantity, or of a joint's quantity."""
    known = GAINS if kind == "gains" else (*MULTIPLIED, *ADDED)
    where = f"axes.{kind}"
    if not isinstance(table, Mapping) or not table:
        raise InputError(
            f"must be a table of {', '.join(known)}, or of joints with these",
            file=file,
            quantity=where,
            value=table,
        )
    axes = []
    for key, entry in table.items():
        if key in known:
            axes.append(_quantity(kind, key, None, entry, file))
            continue
        if not isinstance(entry, Mapping) or entry.keys() & {"low", "high"}:
            check_keys({key: entry}, set(known), set(), file=file, under=where)
        check_keys(entry, set(known), set(), file=file, under=f"{where}.{key}")
        axes += [_quantity(kind, name, key, item, file) for name, item in entry.items()]
    return axes


def _quantity(kind: str, quantity: str, joint: str | None, entry: Any, file: object) -> Axis:
    name = ".".join(part for part in (kind, joint, quantity) if part)
    unit, low, high = (ADDED[quantity], -1e3, 1e3) if quantity in ADDED else ("-", 0.0, 1e4)
    return _numbers(name, unit, low, high, entry, file, spread=joint is None and kind == "drive")


def _numbers(
    name: str, unit: str, low: float, high: float, entry: Any, file: object, *, spread: bool = False
) -> Axis:
    """An axis of numbers (or offsets): one, a list, or a range."""

    def refuse(rule: str, value: object) -> InputError:
        said = "" if unit == "-" else f" [{unit}]"
        return InputError(rule, file=file, quantity=f"axes.{name}{said}", value=value)

    def checked(value: Any) -> Any:
        if name == "offset" and isinstance(value, list) and len(value) == 3:
            return tuple(checked(part) for part in value)
        if isinstance(value, bool) or not isinstance(value, int | float):
            kind = "a number or [x, y, z]" if name == "offset" else "a number"
            raise refuse(f"must be {kind}", value)
        number = as_float(value)
        if not low <= number <= high:
            top = str(high) if name in WHOLE else f"{high:g}"
            raise refuse(f"must be {low:g} to {top}" + ("" if unit == "-" else f" {unit}"), value)
        if name in WHOLE:
            if number != int(number):
                raise refuse("must be a whole number", value)
            return int(number)
        return number

    if not isinstance(entry, Mapping):
        values = tuple(checked(value) for value in (entry if isinstance(entry, list) else [entry]))
        if any(isinstance(value, tuple) for value in values):  # one kind of label for all
            values = tuple(value if isinstance(value, tuple) else (value, 0.0, 0.0) for value in values)
        return Axis(name, unit, distinct(values, f"axes.{name}", file))
    known = {"low", "high", "distribution", "points"} | ({"each_joint"} if spread else set())
    check_keys(entry, known, {"low", "high"}, file=file, under=f"axes.{name}")
    first, last = checked(entry["low"]), checked(entry["high"])
    if isinstance(first, tuple) or isinstance(last, tuple):
        raise refuse("the ends of a range must be numbers; list vectors instead", dict(entry))
    if not first < last:
        raise refuse("low must be below high", dict(entry))
    kind, each = entry.get("distribution", "uniform"), entry.get("each_joint", False)
    if kind not in DISTRIBUTIONS:
        raise refuse(f"distribution must be one of {', '.join(DISTRIBUTIONS)}", kind)
    if kind == "log-uniform" and (first <= 0 or name in WHOLE):
        raise refuse("log-uniform needs a low above 0, and no seeds", dict(entry))
    if type(each) is not bool:
        raise refuse("each_joint must be true or false", each)
    axis = Axis(name, unit, (), first, last, kind == "log-uniform", each)
    points = entry.get("points")
    if points is None:
        return axis
    if type(points) is not int or not 2 <= points <= MOST_VALUES or each:
        raise refuse(f"points must be 2 to {MOST_VALUES}, without each_joint", points)
    values = tuple(axis.at(share) for share in np.linspace(0, 1, points).tolist())
    return Axis(name, unit, distinct(values, f"axes.{name}", file))


def _names(name: str, entry: Any, file: object) -> tuple[Any, ...]:
    values = entry if isinstance(entry, list) else [entry]
    if name == "pose" and isinstance(entry, Mapping):
        check_keys(entry, {"random", "margin"}, {"random"}, file=file, under="axes.pose")
        count = entry["random"]
        if type(count) is not int or not 1 <= count <= MOST_VALUES:
            raise InputError(
                f"must be 1 to {MOST_VALUES} poses", file=file, quantity="axes.pose.random", value=count
            )
        return tuple(f"random{i}" for i in range(count))
    for value in values:
        if not isinstance(value, str) or not value:
            raise InputError("must be a list of names", file=file, quantity=f"axes.{name}", value=value)
    return distinct(tuple(values), f"axes.{name}", file)


def _faults(entry: Any, file: object) -> tuple[Any, ...]:
    """Faults: "none", a fault's table, or a table with a name, a list of faults and changes of payload."""
    values: list[Any] = []
    for item in entry if isinstance(entry, list) else [entry]:
        if item == NO_FAULT:
            values.append(NO_FAULT)
            continue
        if not isinstance(item, Mapping):
            raise InputError(
                f'must be "{NO_FAULT}" or a table with a kind and a start, or with payload_at',
                file=file,
                quantity="axes.fault",
                value=item,
            )
        table = dict(item)
        name = table.pop("name", None)
        loads = table.pop("payload_at", [])
        parts = table.pop("faults", [table] if table else [])
        if "faults" in item:
            check_keys(table, set(), set(), file=file, under="axes.fault")
        for key, rows in (("faults", parts), ("payload_at", loads)):
            if not isinstance(rows, list) or not all(isinstance(row, Mapping) for row in rows):
                raise InputError(
                    "must be a list of tables", file=file, quantity=f"axes.fault.{key}", value=rows
                )
        if not parts and not loads:
            raise InputError("needs faults or payload_at", file=file, quantity="axes.fault", value=dict(item))
        if name is None:
            loaded = (f"payload {row.get('mass', '?')} kg" for row in loads)
            name = " + ".join([*map(_fault_name, parts), *loaded])
        if not isinstance(name, str) or not name:
            raise InputError("must be a text", file=file, quantity="axes.fault.name", value=name)
        values.append(
            {
                "name": name,
                "faults": tuple(dict(part) for part in parts),
                "payload_at": tuple(dict(row) for row in loads),
            }
        )
    distinct(tuple(map(value_label, values)), "axes.fault", file)
    return tuple(values)


def _fault_name(part: Mapping[str, Any]) -> str:
    joint = part.get("joint", "all")
    return str(part.get("kind", "?")) + ("" if joint == "all" else f" {joint}")


def distinct(values: Sequence[Any], what: str, file: object) -> tuple[Any, ...]:
    """The values, none of them twice and at least one.

    Raises:
        InputError: Otherwise.
    """
    if not values:
        raise InputError("must not be empty", file=file, quantity=what)
    seen: set[Any] = set()
    for value in values:
        if value in seen:
            raise InputError("is listed twice", file=file, quantity=what, value=value)
        seen.add(value)
    return tuple(values)
