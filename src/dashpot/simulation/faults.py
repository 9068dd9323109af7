"""Scripted faults: what fails, where, when and how much. The native loop plays them (docs/faults.md)."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args

import dashpot._native as _native
from dashpot.arm.drive import Drive
from dashpot.arm.robot import MAX_ANGLE
from dashpot.errors import InputError
from dashpot.support.tables import as_float, check_keys

FaultKind = Literal[
    "encoder_frozen",
    "encoder_jump",
    "encoder_lost",
    "torque_bias",
    "torque_drift",
    "torque_scale",
    "torque_stuck",
    "torque_noise",
    "torque_nan",
    "samples_dropped",
    "samples_late",
    "saturation",
    "brownout",
    "contact",
    "shorted_windings",
    "mechanical_brake",
]
NAMES: tuple[FaultKind, ...] = get_args(FaultKind)

BRAKE_DELAY = 0.05
"""From the order to a closed mechanical brake [s]: half of it nothing, then its friction rises linearly."""
BRAKE_TORQUE = 2.0
"""Friction of a mechanical brake where nobody says, over the drive's torque limit [-]."""
SHORT_TIME = 5e-3
"""Mechanical time constant J R/k_t^2 of a motor with shorted windings [s]: b = inertia / SHORT_TIME."""
SHORT_ELECTRICAL, POLE_PAIRS = 1e-3, 10
"""L/R [s] and pole pairs of the motor: the short brakes most at w_c = R/(L p N) at the joint."""
STIFFEST_WALL = 4.0  # over the transmission's stiffness; a stiffer one needs a shorter physics step


def short_damping(drive: Drive) -> float:
    """Damping of shorted windings at low speed, b = J R/k_t^2 from the bare rotor [N m s/rad].

    With an inner torque loop the bare rotor is (1 + gain) times as heavy as the apparent one.
    """
    return drive.rotor_inertia * (1 + (drive.inner_loop.gain if drive.inner_loop else 0.0)) / SHORT_TIME


def short_corner(drive: Drive) -> float:
    """Joint speed w_c of the largest torque of shorted windings, ``b w/(1 + (w/w_c)^2)`` [rad/s]."""
    return 1 / (SHORT_ELECTRICAL * POLE_PAIRS * abs(drive.gear_ratio))


def brake_torque(drive: Drive) -> float:
    """Friction of the mechanical brake where nobody says [N m]."""
    return BRAKE_TORQUE * drive.torque_limit


@dataclass(frozen=True)
class Kind:
    """What a kind of fault does.

    Attributes:
        meaning: In words.
        acts_on: "signal": what the controller is told about a joint; "drive": the joint itself; "arm":
            everything at once.
        quantity: What the value is; "": the kind takes no value.
        unit: Of the value.
        low: Smallest value.
        high: Largest value.
        default: Value where none is given, from the joint's drive; None: the kind takes no value.
        default_said: The same in words.
    """

    meaning: str
    acts_on: Literal["signal", "drive", "arm"]
    quantity: str = ""
    unit: str = "-"
    low: float = 0.0
    high: float = 0.0
    default: Callable[[Drive], float] | None = None
    default_said: str = ""


KINDS: dict[FaultKind, Kind] = {
    "encoder_frozen": Kind("encoder repeats its last position; velocity zero", "signal"),
    "encoder_jump": Kind(
        "encoder is off by a step; velocity has a spike of one tick, as a difference quotient has",
        "signal", "offset", "rad", -MAX_ANGLE, MAX_ANGLE, lambda _: 0.1, "0.1",
    ),
    "encoder_lost": Kind("position and velocity are not a number, and their age grows", "signal"),
    "torque_bias": Kind(
        "torque sensor reads too much",
        "signal", "bias", "N m", -1e4, 1e4, lambda d: 0.1 * d.torque_limit, "0.1 torque_limit",
    ),
    "torque_drift": Kind(
        "bias of the torque sensor grows from zero",
        "signal", "rate", "N m/s", -1e4, 1e4, lambda d: 0.02 * d.torque_limit, "0.02 torque_limit / s",
    ),
    "torque_scale": Kind(
        "torque sensor's gain is multiplied",
        "signal", "factor", "-", -10, 10, lambda _: 1.5, "1.5",
    ),
    "torque_stuck": Kind("torque sensor repeats its last sample", "signal"),
    "torque_noise": Kind(
        "torque samples get more noise",
        "signal", "std. deviation", "N m", 0, 1e4, lambda d: 0.02 * d.torque_limit, "0.02 torque_limit",
    ),
    "torque_nan": Kind("torque samples are not a number", "signal"),
    "samples_dropped": Kind(
        "some samples of torque and encoder never arrive: the last one is repeated, its age grows",
        "signal", "probability per tick", "-", 0, 1, lambda _: 0.1, "0.1",
    ),
    "samples_late": Kind(
        "samples of torque and encoder arrive late",
        "signal", "delay", "ticks", 0, _native.MAX_LATE, lambda _: 2.0, "2",
    ),
    "saturation": Kind(
        "motor gives only a share of its torque limit; the controller does not know",
        "drive", "share", "-", 0, 1, lambda _: 0.5, "0.5",
    ),
    "brownout": Kind("controller stands still and all motors are off; then it goes on where it was", "arm"),
    "contact": Kind(
        "a wall, damped as the joint's stops are, stands where the link is, in front of it as it moves",
        "drive", "stiffness", "N m/rad", 0, 1e8, lambda d: 0.5 * d.stiffness, "0.5 stiffness",
    ),
    "shorted_windings": Kind(
        "motor off, its windings brake with b w/(1 + (w/w_c)^2)",
        "drive", "damping b", "N m s/rad", 0, 1e6, short_damping, "rotor inertia / 5 ms",
    ),
    "mechanical_brake": Kind(
        f"brake on the rotor closes within {BRAKE_DELAY * 1e3:g} ms; then the motor is off",
        "drive", "friction", "N m", 0, 1e5, brake_torque, f"{BRAKE_TORQUE:g} torque_limit",
    ),
}  # fmt: skip
"""Every kind: what it does, and what its value is, from where to where, and by default."""

_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_TEXT = re.compile(
    rf"(?P<kind>[^:@]+)(?::(?P<joint>.+))?@(?P<start>{_NUMBER})(?:-(?P<end>{_NUMBER}))?(?:=(?P<value>{_NUMBER}))?"
)
TEXT = "KIND[:JOINT]@START[-END][=VALUE]"


@dataclass(frozen=True)
class Fault:
    """One thing that fails for a while.

    It acts at the control ticks from the one nearest to `start` until just before the one nearest to `end`.

    Attributes:
        kind: See `KINDS`.
        start: [s], on the trajectory's clock.
        end: [s]; infinite: to the end of the motion.
        joint: Joint name, or "all": every joint that it can reach. A brownout is always of the whole arm.
        value: Meaning, unit and range by kind; None: the kind's default for that joint.
    """

    kind: FaultKind
    start: float
    end: float = math.inf
    joint: str = "all"
    value: float | None = None

    def __post_init__(self) -> None:
        kind = KINDS.get(self.kind) if isinstance(self.kind, str) else None
        if kind is None:
            near = difflib.get_close_matches(str(self.kind), NAMES, n=1)
            hint = f"; did you mean {near[0]!r}?" if near else f"; known: {', '.join(NAMES)}"
            raise InputError(f"no such kind of fault{hint}", quantity="fault kind", value=self.kind)
        if not isinstance(self.joint, str) or not self.joint:
            raise InputError(
                'must be the name of a joint, or "all"', quantity="fault joint", value=self.joint
            )
        for name in ("start", "end"):
            if _bad(getattr(self, name)):
                self._refuse("must be a number", name, "s")
        if not math.isfinite(self.start):
            self._refuse("must be finite", "start", "s")
        if not self.end > self.start:
            self._refuse(f"must be after the start, {self.start:g} s", "end", "s")
        if kind.acts_on == "arm" and self.joint != "all":
            self._refuse("is of the whole arm; leave the joint out", "joint")
        if self.value is None:
            return
        if not kind.quantity:
            self._refuse("takes no value; leave it out", "value")
        if _bad(self.value) or not kind.low <= self.value <= kind.high:
            self._refuse(
                f"{kind.quantity}, must be {kind.low:g} to {kind.high:g}"
                + ("" if kind.unit == "-" else f" {kind.unit}"),
                "value",
                kind.unit,
            )
        if kind.unit == "ticks" and self.value != int(self.value):
            self._refuse("must be a whole number of ticks", "value", kind.unit)

    def _refuse(self, rule: str, name: str, unit: str = "") -> None:
        raise InputError(
            rule,
            joint=None if self.joint == "all" or name == "joint" else self.joint,
            quantity=f"{self.kind} {name}" + (f" [{unit}]" if unit else ""),
            value=getattr(self, name),
        )

    def __str__(self) -> str:
        """As `from_text` reads it."""
        joint = "" if self.joint == "all" else f":{self.joint}"
        end = "" if math.isinf(self.end) else f"-{_exact(self.end)}"
        value = "" if self.value is None else f"={_exact(self.value)}"
        return f"{self.kind}{joint}@{_exact(self.start)}{end}{value}"

    def size(self, drive: Drive) -> float:
        """The value for one joint, its default where none was given; 0 for a kind without one."""
        default = KINDS[self.kind].default
        if self.value is not None:
            return float(self.value)
        return default(drive) if default else 0.0

    def table(self) -> dict[str, Any]:
        """As `from_table` reads it; JSON can hold it."""
        table: dict[str, Any] = {"kind": self.kind, "joint": self.joint, "start": self.start}
        if not math.isinf(self.end):
            table["end"] = self.end
        if self.value is not None:
            table["value"] = self.value
        return table

    @classmethod
    def from_table(cls, table: Mapping[str, Any], *, file: object = None) -> Fault:
        """Builds a fault from one ``[[fault]]`` table, e.g. ``kind = "encoder_lost"``, ``start = 2.0``.

        Raises:
            InputError: Naming file, joint, key, value and rule.
        """
        check_keys(table, {"kind", "start", "end", "joint", "value"}, {"kind", "start"}, file=file)
        values: dict[str, Any] = {k: as_float(v) if type(v) is int else v for k, v in table.items()}
        try:
            return cls(**values)
        except InputError as error:
            raise InputError(
                error.rule, file=file, joint=error.joint, quantity=error.quantity, value=error.value
            ) from None

    @classmethod
    def from_text(cls, text: str) -> Fault:
        """Reads ``KIND[:JOINT]@START[-END][=VALUE]``, e.g. ``torque_bias:joint5@2-3.5=4``.

        Raises:
            InputError: It does not look like that, or a part of it is not valid.
        """
        found = _TEXT.fullmatch(text.strip())
        if not found:
            raise InputError(
                f"must be {TEXT}, times in s, e.g. encoder_lost:joint5@2 or torque_bias@2-3=4",
                quantity="--fault",
                value=text,
            )
        part: dict[str, Any] = found.groupdict()
        numbers: dict[str, Any] = {
            name: float(part[name]) for name in ("start", "end", "value") if part[name] is not None
        }
        return cls(part["kind"], joint=part["joint"] or "all", **numbers)


def _bad(value: object) -> bool:
    return isinstance(value, bool) or not isinstance(value, int | float) or math.isnan(value)


def _exact(value: float) -> str:
    """All digits of a number, without an empty fraction."""
    return repr(float(value)).removesuffix(".0")
