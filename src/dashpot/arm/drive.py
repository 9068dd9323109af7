"""One joint's drive, Eqs. (1)-(9): rotor, friction, transmission, torque sensor, limits."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from dashpot.errors import InputError
from dashpot.support.tables import check_keys, check_numbers, from_table, number

UNCERTAIN = ("rotor_inertia", "viscous_friction", "coulomb_friction", "stiffness", "damping")
"""Quantities for which `Drive.uncertainty` may give a relative half-width."""
SLOWEST_STRIBECK = 1e-6  # [rad/s]; below it the law is a step, and its rate overflows

# Presliding stiffness of Coulomb friction over the transmission's; assumed: some 1e-4 rad at the motor before
# it slips are 1e-6 rad behind a gear of 100. A soft one makes a torque law hunt (docs/decisions.md).
PRESLIDING = 30.0


@dataclass(frozen=True)
class InnerLoop:
    """The robot's own torque loop inside the drive, ``u_motor = u + gain (u - tau_s)``.

    It makes rotor inertia and friction look ``1 + gain`` times smaller, imperfectly: it has its own
    period and sees the torque through a first-order filter. The drive's values are the apparent ones.

    Attributes:
        gain: Torque feedback gain [-].
        period: Period of the loop [s].
        bandwidth: Corner of its first-order torque filter [Hz].
    """

    gain: float = number("-", 0, 1e3)
    period: float = number("s", 0, 0.1, open_low=True)
    bandwidth: float = number("Hz", 0, 1e6, open_low=True, default=math.inf)

    def __post_init__(self) -> None:
        check_numbers(self)


@dataclass(frozen=True)
class Servo:
    """The robot's own position loop, used for joints that dashpot does not control.

    ``u = kp (q_d - q) + kd (q_d' - q') + ki integral(q_d - q)``, at the physics step.

    Attributes:
        kp: Position gain [N m/rad].
        kd: Velocity gain [N m s/rad].
        ki: Integral gain [N m/(rad s)].
    """

    kp: float = number("N m/rad", 0, 1e7)
    kd: float = number("N m s/rad", 0, 1e6)
    ki: float = number("N m/(rad s)", 0, 1e8, default=0.0)

    def __post_init__(self) -> None:
        check_numbers(self)


@dataclass(frozen=True)
class Drive:
    """Drive of one joint. SI units, link side (after the gear).

    With an `inner_loop`, inertia and friction are the apparent values, with that loop closed.

    Attributes:
        name: Name of the joint in the robot model.
        rotor_inertia: m, Eq. (3) [kg m^2].
        viscous_friction: v, Eq. (1) [N m s/rad].
        coulomb_friction: tau_c, level of the sliding friction [N m].
        stribeck_friction: tau_b, the level at which a resting rotor breaks away [N m]; 0: the Coulomb level.
        stribeck_velocity: w_b [rad/s]: the level is ``tau_c + (tau_b - tau_c) exp(-(w/w_b)^2)``.
        stiffness: Transmission stiffness k [N m/rad].
        damping: Transmission damping c [N m s/rad].
        torque_limit: Largest torque of the drive [N m].
        torque_rate_limit: Largest rate of the torque command [N m/s].
        gear_ratio: N; the rotor turns N times as fast as the joint [-].
        torque_gain_error: Bound on the relative error of sensor times actuator gain [-].
        torque_scale_error: Actual relative error of the sensor's scale, simulated [-].
        torque_bias: Sensor bias, simulated [N m].
        torque_noise: Standard deviation of one torque sample, simulated [N m].
        torque_resolution: Quantisation step of a torque sample, simulated [N m].
        torque_latency: Delay inside the sensor, simulated [s].
        sensor_bandwidth: Natural frequency of the sensor's low-pass filter [Hz]; None: no filter.
        sensor_order: 1 or 2.
        sensor_damping: Damping ratio of a second-order one [-].
        link_inertia: Least inertia of the link itself that the user vouches for [kg m^2].
        link_friction: Least viscous friction at the link that the user vouches for [N m s/rad].
        position_resolution: Quantisation step of the encoder, simulated [rad].
        backlash: Total play of the transmission [rad].
        hysteresis: Largest hysteresis torque of the transmission [N m].
        inner_loop: The robot's own torque loop, or None.
        servo: The robot's own position loop, or None.
        command_latency: Longest delay from sending a torque to its taking effect, as identified [s]; None:
            not known. `dashpot design` uses it.
        uncertainty: Relative half-widths of quantities in `UNCERTAIN` [-].
        identified: Where identified values come from: log, digest, date and so on (`dashpot identify`).
    """

    name: str
    rotor_inertia: float = number("kg m^2", 1e-9, 1e3, typical=(1e-4, 20))
    viscous_friction: float = number("N m s/rad", 0, 1e4, typical=(1e-3, 500))
    coulomb_friction: float = number("N m", 0, 1e3, typical=(1e-3, 100), default=0.0)
    stribeck_friction: float = number("N m", 0, 1e3, default=0.0)
    stribeck_velocity: float = number("rad/s", 0, 1e3, default=0.0)
    stiffness: float = number("N m/rad", 0, 1e8, open_low=True, typical=(50, 1e6))
    damping: float = number("N m s/rad", 0, 1e5, typical=(1e-4, 1e3), default=0.0)
    torque_limit: float = number("N m", 0, 1e5, open_low=True, typical=(0.05, 5e3))
    torque_rate_limit: float = number("N m/s", 0, open_low=True, default=math.inf)
    gear_ratio: float = number("-", -1e4, 1e4, default=1.0)
    torque_gain_error: float = number("-", 0, 0.5, default=0.0)
    torque_scale_error: float = number("-", -0.5, 0.5, default=0.0)
    torque_bias: float = number("N m", -1e3, 1e3, default=0.0)
    torque_noise: float = number("N m", 0, 1e3, typical=(1e-6, 10), default=0.0)
    torque_resolution: float = number("N m", 0, 1e3, default=0.0)
    torque_latency: float = number("s", 0, 0.1, default=0.0)
    sensor_bandwidth: float | None = number("Hz", 0, 1e6, open_low=True, typical=(1, 1e5), default=None)
    sensor_order: int = 2
    sensor_damping: float = number("-", 0, 10, open_low=True, default=0.8)
    link_inertia: float = number("kg m^2", 0, 1e4, default=0.0)
    link_friction: float = number("N m s/rad", 0, 1e4, default=0.0)
    position_resolution: float = number("rad", 0, 0.1, default=0.0)
    backlash: float = number("rad", 0, 0.2, default=0.0)
    hysteresis: float = number("N m", 0, 1e3, default=0.0)
    inner_loop: InnerLoop | None = None
    servo: Servo | None = None
    command_latency: float | None = number("s", 0, 1, typical=(1e-5, 0.1), default=None)
    uncertainty: Mapping[str, float] = field(default_factory=dict)
    identified: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_numbers(self, joint=self.name)
        if self.gear_ratio == 0:
            raise InputError(
                "must not be zero", joint=self.name, quantity="gear_ratio [-]", value=self.gear_ratio
            )
        if type(self.sensor_order) is not int or self.sensor_order not in (1, 2):
            raise InputError(
                "must be 1 or 2", joint=self.name, quantity="sensor_order", value=self.sensor_order
            )
        if self.stribeck_friction > 0:
            if self.stribeck_friction < self.coulomb_friction:
                raise InputError(
                    f"must be 0 (none) or at least coulomb_friction, {self.coulomb_friction:g} N m",
                    joint=self.name,
                    quantity="stribeck_friction [N m]",
                    value=self.stribeck_friction,
                )
            if self.stribeck_velocity < SLOWEST_STRIBECK:
                raise InputError(
                    f"must be at least {SLOWEST_STRIBECK:g} rad/s where there is a stribeck_friction",
                    joint=self.name,
                    quantity="stribeck_velocity [rad/s]",
                    value=self.stribeck_velocity,
                )
        check_uncertainty(self.uncertainty, joint=self.name)

    @classmethod
    def from_table(cls, table: Mapping[str, Any], *, file: object = None) -> Drive:
        """Builds a drive from one ``[[joint]]`` table of a robot file.

        Raises:
            InputError: Naming file, joint, key, value and rule.
        """
        name = table.get("name")
        if not isinstance(name, str) or not name:
            raise InputError(
                "every [[joint]] needs a name, that of a hinge in the model", file=file, quantity="name"
            )
        values = dict(table)
        for key, kind in (("inner_loop", InnerLoop), ("servo", Servo)):
            if key in values:
                if not isinstance(values[key], dict):
                    raise InputError(
                        "must be a table", file=file, joint=name, quantity=key, value=values[key]
                    )
                values[key] = from_table(kind, values[key], file=file, joint=f"{name}.{key}")
        for key, like in (
            ("uncertainty", "e.g. { rotor_inertia = 0.15 }"),
            ("identified", "as dashpot identify writes it"),
        ):
            if not isinstance(values.get(key, {}), dict):
                raise InputError(
                    f"must be a table, {like}", file=file, joint=name, quantity=key, value=values[key]
                )
        return from_table(cls, values, file=file, joint=name)


def check_uncertainty(
    uncertainty: Mapping[str, float], *, file: object = None, joint: str | None = None
) -> None:
    """Checks relative half-widths: known quantities, at least 0 and below 1.

    Raises:
        InputError: Otherwise.
    """
    check_keys(uncertainty, set(UNCERTAIN), set(), file=file, joint=joint)
    for key, value in uncertainty.items():
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < 1:
            raise InputError(
                "must be a relative half-width, at least 0 and below 1 (0.15 means 15 %)",
                file=file,
                joint=joint,
                quantity=f"uncertainty.{key}",
                value=value,
            )
