"""What the user wants of a joint: one quantity to make as small as possible, and limits on the others."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, Literal, get_args

from dashpot.errors import InputError
from dashpot.support.tables import Range, check_keys, check_numbers, number

Wish = Literal[
    "travel", "stop_time", "creep", "load_error", "error_ratio", "noise", "authority", "damping_ratio"
]
AT_LEAST = ("damping_ratio", "margin")
"""Limits that a value must reach; it must not exceed the others."""


@dataclass(frozen=True)
class Wishes:
    """Wish and limits for one joint. None: no limit.

    Attributes:
        minimise: The quantity to make as small as possible.
        stop_time: Longest time to stop once the encoder is lost [s].
        travel: How far it may get in 5 s after losing the encoder, the payload pulling on [rad].
        creep: Fastest sag of the brake under the payload [rad/s].
        load_error: Largest position error at rest under the payload, with position loop [rad].
        error_ratio: How far the payload moves the joint, over the same without torque feedback [-].
        noise: RMS of the torque command from sensor noise, share of the torque limit [-].
        authority: Share of the torque limit that may be asked for (see `candidates.authority`) [-].
        damping_ratio: Least of the position loop [-].
        margin: Least passivity index over the whole box, relative to that of the bare drive [-].
        beside: What else counts, {quantity: weight}: the wish times each quantity to the power of its weight
            is what is made small.
    """

    minimise: Wish
    stop_time: float | None = number("s", 0, 60, open_low=True, default=None)
    travel: float | None = number("rad", 0, 100, open_low=True, default=None)
    creep: float | None = number("rad/s", 0, 100, default=None)
    load_error: float | None = number("rad", 0, 3, open_low=True, default=None)
    error_ratio: float | None = number("-", 0, 1e3, open_low=True, default=None)
    noise: float | None = number("-", 0, 1, open_low=True, default=None)
    authority: float | None = number("-", 0, 1, open_low=True, default=None)
    damping_ratio: float | None = number("-", 0, 5, default=None)
    margin: float = number("-", 0, 1, default=0.1)
    beside: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_numbers(self)
        if self.minimise not in get_args(Wish):
            raise InputError(
                f"must be one of {', '.join(get_args(Wish))}", quantity="minimise", value=self.minimise
            )
        if not isinstance(self.beside, Mapping):
            raise InputError("must be a table, e.g. { travel = 0.25 }", quantity="beside", value=self.beside)
        check_keys(self.beside, set(get_args(Wish)), set())
        for name, weight in self.beside.items():
            if isinstance(weight, bool) or not isinstance(weight, int | float) or not 0 <= weight <= 10:
                raise InputError(
                    "must be at least 0 and at most 10", quantity=f"beside.{name} [-]", value=weight
                )

    @property
    def limits(self) -> dict[str, float]:
        """The limits that are set, but for the margin."""
        values = {name: getattr(self, name) for name in LIMITS}
        return {name: value for name, value in values.items() if value is not None}

    def without(self, *names: str) -> Wishes:
        """A copy without some limits."""
        return self.changed(dict.fromkeys(names))

    def changed(self, values: Mapping[str, Any]) -> Wishes:
        """A copy with some values replaced; 0 < value is checked."""
        return replace(self, **values)


LIMITS = tuple(f.name for f in fields(Wishes) if f.name not in ("minimise", "margin", "beside"))
"""Names of the limits, but for the margin."""
UNITS = {
    f.name: f.metadata["range"].unit for f in fields(Wishes) if isinstance(f.metadata.get("range"), Range)
}
NEED_LOOP = ("load_error", "damping_ratio")
"""Quantities of the position loop."""

PRESETS: dict[str, Wishes] = {
    "brake": Wishes("travel", beside={"stop_time": 0.5}, authority=0.9, noise=0.01, margin=0.1),
    "track": Wishes(
        "load_error",
        creep=0.1,
        error_ratio=0.2,
        authority=0.9,
        noise=0.01,
        damping_ratio=0.5,
        margin=0.1,
        beside={"travel": 0.25},
    ),
    "gentle": Wishes(
        "load_error",
        creep=0.1,
        error_ratio=0.5,
        authority=0.3,
        noise=0.003,
        damping_ratio=0.9,
        margin=0.3,
        beside={"travel": 0.25},
    ),
}
"""brake: stop as short as possible, no position loop; track: the least error under load, with a brake
that holds it; gentle: the same with a third of the torque, more damping and more margin."""
