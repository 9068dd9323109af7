"""What a supervisor may assume and how long it may wait: ``[supervisor]`` of a controller file."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import dashpot._native as _native
from dashpot.errors import InputError
from dashpot.support.tables import as_float, check_keys, check_numbers, number


@dataclass(frozen=True)
class SupervisorSettings:
    """What the supervisor may assume and how long it may wait. SI units, link side.

    Thresholds of the rotor balance follow from the drives (docs/supervisor.md). None: from the drives too.

    Attributes:
        debounce: Ticks of bad samples in a row until a signal is lost.
        torque_age: Oldest torque sample that is used [ticks].
        encoder_age: Oldest encoder sample that is used [ticks].
        speed_limit: No joint moves faster [rad/s].
        stand: By which the reference may move while the encoder repeats itself [rad]; None: what it takes the
            position loop to turn the largest friction round (`dashpot.control.thresholds.stand_of`).
        torque_range: Range of the torque sensor, as a multiple of the drive's torque limit [-].
        friction_margin: Relative half-width of friction, where the drive states none [-].
        model_margin: The same of rotor inertia and viscous friction [-]; both are lower bounds where it does.
        bias_limit: Sensor bias that is tolerated, as a part of the drive's torque limit [-].
        false_alarms: Tolerated probability that noise alone trips a check at one tick [-].
        residual_time: Time constant of the rotor balance [s]; at least 8 ticks.
        bias_time: Time constant of the bias estimate [s].
        oscillation_floor: Smallest amplitude that counts, as a part of the drive's torque limit [-].
        oscillation_corner: Below it nothing counts as oscillation [Hz].
        oscillation_cycles: Cycles without decay until it does [-].
        stop_time: A brake must have stopped the arm after it [s].
        still_speed: Slower counts as at rest [rad/s].
        still_time: For so long [s].
        brake_time: After it a braked joint may move on by `drift` [s].
        drift: Distance that closes the mechanical brake: from where the arm came to rest, and before it has,
            from where the joint was `brake_time` after the brake began [rad].
        release_time: Over which the last fallback takes the torque away, the mechanical brake closing [s].
        keep_load: Whether the encoder brake goes on holding the motor torque there was before the fault,
            the mean of a tenth of a second.
    """

    debounce: int = 3
    torque_age: int = 2
    encoder_age: int = 2
    speed_limit: float = number("rad/s", 0, 1e3, open_low=True, typical=(0.1, 30), default=2 * math.pi)
    stand: float | None = number("rad", 0, 10, open_low=True, default=None)
    torque_range: float = number("-", 0, 100, open_low=True, default=2.0)
    friction_margin: float = number("-", 0, 10, default=0.5)
    model_margin: float = number("-", 0, 1, default=0.1)
    bias_limit: float = number("-", 0, 1, default=0.01)
    false_alarms: float = number("-", 1e-15, 1e-3, default=1e-10)
    residual_time: float = number("s", 0, 1, open_low=True, default=0.02)
    bias_time: float = number("s", 0, 1e3, open_low=True, default=2.0)
    oscillation_floor: float = number("-", 0, 1, open_low=True, default=0.02)
    oscillation_corner: float = number("Hz", 0, 1e3, open_low=True, default=2.0)
    oscillation_cycles: int = 4
    stop_time: float = number("s", 0, 60, open_low=True, default=2.0)
    still_speed: float = number("rad/s", 0, 10, open_low=True, default=0.02)
    still_time: float = number("s", 0, 10, open_low=True, default=0.1)
    brake_time: float = number("s", 0, 60, open_low=True, default=0.3)
    drift: float = number("rad", 0, 10, open_low=True, default=0.1)
    release_time: float = number("s", 0, 10, open_low=True, default=0.1)
    keep_load: bool = True

    def __post_init__(self) -> None:
        check_numbers(self)
        for key, low, high in (
            ("debounce", 1, _native.HISTORY // 2),
            ("torque_age", 0, 1000),
            ("encoder_age", 0, 1000),
            ("oscillation_cycles", 2, 1000),
        ):
            value = getattr(self, key)
            if type(value) is not int or not low <= value <= high:
                raise InputError(f"must be a whole number, {low} to {high}", quantity=key, value=value)
        if type(self.keep_load) is not bool:
            raise InputError("must be true or false", quantity="keep_load", value=self.keep_load)

    @classmethod
    def from_table(
        cls, table: Any, *, file: object = None, base: SupervisorSettings | None = None
    ) -> SupervisorSettings:
        """Reads ``[supervisor]`` of a controller or a campaign: any of the settings, the others as in `base`.

        Raises:
            InputError: Naming file, key, value and rule.
        """
        if not isinstance(table, Mapping):
            raise InputError("must be a table of settings", file=file, quantity="supervisor", value=table)
        known = {f.name: f for f in fields(cls)}
        check_keys(table, set(known), set(), file=file, under="supervisor")
        values: dict[str, Any] = {
            key: as_float(value) if "range" in known[key].metadata and type(value) is int else value
            for key, value in table.items()
        }
        try:
            return replace(cls() if base is None else base, **values)
        except InputError as error:
            quantity = f"supervisor.{error.quantity}"
            raise InputError(error.rule, file=file, quantity=quantity, value=error.value) from None
