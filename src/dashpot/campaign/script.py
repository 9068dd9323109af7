"""What an entry of the fault axis does: faults of joints, and changes of payload."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from dashpot.arm.payload import Payload
from dashpot.control.controller import ControllerConfig
from dashpot.errors import InputError
from dashpot.simulation.faults import Fault
from dashpot.simulation.simulate import PayloadChange
from dashpot.support.tables import as_float, check_keys

PLACES = ("first", "middle", "last")
"""Names that mean a joint of whatever the controller controls, from base to tip."""


@dataclass(frozen=True)
class Script:
    """What happens in a scenario.

    Attributes:
        faults: Their joints may be among `PLACES`.
        loads: Tables of time [s], mass [kg] and, where not the scenario's, offset and length [m].
    """

    faults: tuple[Fault, ...] = ()
    loads: tuple[Mapping[str, Any], ...] = ()

    @classmethod
    def from_value(cls, value: Mapping[str, Any], file: object) -> Script:
        """From a value of the fault axis.

        Raises:
            InputError: A fault or a change of payload is not valid.
        """
        loads = [_load(row, file) for row in value["payload_at"]]
        script = cls(tuple(_fault(part, file) for part in value["faults"]), tuple(loads))
        script.changes(Payload(0.0), file)
        return script

    @property
    def times(self) -> list[float]:
        """When something happens [s]."""
        return [float(fault.start) for fault in self.faults] + [float(row["time"]) for row in self.loads]

    def faults_of(self, config: ControllerConfig) -> tuple[Fault, ...]:
        """The faults, with the joints of a controller in place of `PLACES`."""
        names = [law.name for law in config.joints]
        at = {"first": names[0], "middle": names[len(names) // 2], "last": names[-1]}
        return tuple(
            fault if fault.joint in names else replace(fault, joint=at.get(fault.joint, fault.joint))
            for fault in self.faults
        )

    def changes(self, like: Payload, file: object) -> tuple[PayloadChange, ...]:
        """The changes of payload; what is picked up hangs where the scenario's payload does, unless said.

        Raises:
            InputError: A mass, an offset or a length is not valid.
        """
        try:
            return tuple(
                PayloadChange(
                    row["time"],
                    Payload(
                        row["mass"], row.get("offset", like.offset), length=row.get("length", like.length)
                    )
                    if row["mass"] > 0
                    else None,
                )
                for row in self.loads
            )
        except InputError as error:
            raise InputError(
                error.rule, file=file, quantity=f"axes.fault.payload_at.{error.quantity}", value=error.value
            ) from None


def _fault(part: Mapping[str, Any], file: object) -> Fault:
    """A fault; what is wrong with it is named by its key."""
    try:
        return Fault.from_table(part)
    except InputError as error:
        key = (error.quantity or "").removeprefix("fault ").removeprefix(f"{part.get('kind')} ")
        named = ".".join(filter(None, ("axes.fault", key)))
        raise InputError(
            error.rule, file=file, joint=error.joint, quantity=named, value=error.value
        ) from None


def _load(row: Mapping[str, Any], file: object) -> Mapping[str, Any]:
    where = "axes.fault.payload_at"
    check_keys(row, {"time", "mass", "offset", "length"}, {"time", "mass"}, file=file, under=where)
    found: dict[str, Any] = {}
    for key, value in row.items():
        vector = key == "offset" and isinstance(value, list) and len(value) == 3
        parts = value if vector else [value]
        if not all(type(part) in (int, float) for part in parts):
            kind = "a number or [x, y, z]" if key == "offset" else "a number"
            raise InputError(f"must be {kind}", file=file, quantity=f"{where}.{key}", value=value)
        numbers = tuple(as_float(part) for part in parts)
        found[key] = numbers if vector else numbers[0]
    if not found["mass"] >= 0:
        raise InputError("must not be negative", file=file, quantity=f"{where}.mass [kg]", value=row["mass"])
    return found
