"""What one ``[[joint]]`` of a controller file says: a law with its numbers, and the block it becomes.

`Law` is what every command asks of a law; `JointGains` is the virtual passive one. The others are in
`dashpot.control.rivals`, the list of all of them in `dashpot.control.laws`.
"""

from __future__ import annotations

import math
import warnings
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from dashpot.arm.drive import Drive
from dashpot.control.sampled import VirtualPassive, add_position_loop, virtual_passive_block
from dashpot.errors import InputError, InputWarning
from dashpot.support.tables import check_numbers, number

if TYPE_CHECKING:
    from dashpot.control.controller import ControllerConfig


@dataclass(frozen=True)
class Law(ABC):
    """A law with its numbers, SI units, link side.

    Attributes:
        name: Joint of the robot.
        law: What the controller file calls it.
        label: What tables call it.
        brake: Whether it brakes, and leaves tracking to the position loop of its bypass until the encoder is
            lost.
        warm: Whether a warm start from the joint's velocity means something to it.
        keeps_encoder: Whether it reads the encoder even after its loss: an upper bound, not a rival.
        position_gains: Numbers by which the block reads position and velocity, all linearly.
    """

    name: str
    law: ClassVar[str]
    label: ClassVar[str]
    brake: ClassVar[bool] = False
    warm: ClassVar[bool] = False
    keeps_encoder: ClassVar[bool] = False
    position_gains: ClassVar[tuple[str, ...]] = ("kp", "kd")

    def __post_init__(self) -> None:
        check_numbers(self, joint=self.name)

    @abstractmethod
    def coefficients(
        self, drive: Drive, config: ControllerConfig, *, file: object = None
    ) -> NDArray[np.void]:
        """The law without limits, a record of `dashpot.control.sampled.BLOCK_DTYPE`.

        Args:
            drive: Its drive, on which the law's model rests where the file gives none.
            config: Its controller: period, latency, form and blend.
            file: For messages.
        """

    def block(self, drive: Drive, config: ControllerConfig, *, file: object = None) -> NDArray[np.void]:
        """What runs and what is certified: the law with the drive's limits, a record of `BLOCK_DTYPE`.

        Raises:
            InputError: The law cannot run at this latency or blend.

        Warns:
            InputWarning: Of numbers that are known not to go together.
        """
        block = self.coefficients(drive, config, file=file)
        block["torque_limit"] = drive.torque_limit
        block["rate_limit"] = drive.torque_rate_limit * config.period
        block["blend"] = math.exp(-config.period / config.blend) if config.blend > 0 else 0.0
        block["latency"] = config.latency
        return block

    def model(self, drive: Drive) -> tuple[float, float]:
        """Rotor inertia [kg m^2] and viscous friction [N m s/rad] that the law assumes."""
        inertia, friction = (getattr(self, key, None) for key in ("rotor_inertia", "viscous_friction"))
        return (
            drive.rotor_inertia if inertia is None else inertia,
            drive.viscous_friction if friction is None else friction,
        )

    def stated(self, drive: Drive) -> Self:
        """The same law with the model it takes from a drive written out, to run on another drive."""
        if not hasattr(self, "rotor_inertia"):
            return self
        inertia, friction = self.model(drive)
        changes: dict[str, Any] = {"rotor_inertia": inertia, "viscous_friction": friction}
        return replace(self, **changes)

    def scaled_position(self, factor: float) -> Self:
        """The law with its torque from position and velocity scaled [-]."""
        changes: dict[str, Any] = {key: factor * getattr(self, key) for key in self.position_gains}
        return replace(self, **changes)

    def friction_factor(self, drive: Drive) -> float:
        """How many times the rotor's own friction the load meets at low frequency [-]; may be infinite."""
        return 1.0

    def trouble(self, drive: Drive) -> str:
        """In words, how this law is known to give out energy; empty where nothing general can be said."""
        return ""

    @property
    def text(self) -> str:
        """The law and its numbers, for titles."""
        shown = [
            f"{key} = {value:g}"
            for key, value in vars(self).items()
            if isinstance(value, float) and (value != 0 or key in ("kp", "kd"))
        ]
        return self.law.replace("_", " ") + (f": {', '.join(shown)}" if shown else "")


@dataclass(frozen=True)
class JointGains(Law):
    """The virtual passive law of Eqs. (20)-(21) under a position loop. SI units, link side.

    Attributes:
        name: Joint of the robot.
        R: R_tau of Eq. (20): how many times heavier the virtual rotor is [-].
        D: D_c, virtual damping [N m s/rad].
        K: K_c, virtual stiffness [N m/rad].
        kp: Position gain of Fig. 2 [N m/rad].
        kd: Velocity gain of Fig. 2 [N m s/rad].
        rotor_inertia: m assumed by the law [kg m^2]; None: the drive's.
        viscous_friction: v assumed by the law [N m s/rad]; None: the drive's.
    """

    law: ClassVar[str] = "virtual_passive"
    label: ClassVar[str] = "VPC"
    warm: ClassVar[bool] = True
    R: float = number("-", 1e-6, 1e4, typical=(0.01, 200))
    D: float = number("N m s/rad", 1e-9, 1e6, typical=(1e-3, 1e4))
    K: float = number("N m/rad", 0, 1e7, default=0.0)
    kp: float = number("N m/rad", 0, 1e7, default=0.0)
    kd: float = number("N m s/rad", 0, 1e6, default=0.0)
    rotor_inertia: float | None = number("kg m^2", 1e-9, 1e3, default=None)
    viscous_friction: float | None = number("N m s/rad", 0, 1e4, default=None)

    def coefficients(
        self, drive: Drive, config: ControllerConfig, *, file: object = None
    ) -> NDArray[np.void]:
        """See `Law.coefficients`.

        Warns:
            InputWarning: The drive's torque-channel error exceeds ``D/(R a)``, the most this law tolerates.
        """
        law = VirtualPassive(self.R, self.D, self.K, *self.model(drive))
        tolerated = law.D / (law.R * law.a)
        if drive.torque_gain_error > tolerated:
            message = InputError(
                f"exceeds D/(R (R v + D)) = {tolerated:.3g}, the torque-channel error these gains tolerate; "
                "lower R or raise D",
                file=file,
                joint=self.name,
                quantity="torque_gain_error",
                value=drive.torque_gain_error,
            )
            warnings.warn(str(message), InputWarning, stacklevel=4)
        return add_position_loop(virtual_passive_block(law, config.period, config.form), self.kp, self.kd)

    def friction_factor(self, drive: Drive) -> float:
        """See `Law.friction_factor`: ``1 + R``."""
        return 1 + self.R

    @property
    def text(self) -> str:
        """Brake or tracking, and what is not on the axes of a map."""
        if self.kp == self.kd == 0:
            return f"Brake, K = {self.K:g}"
        return f"Tracking, kp = {self.kp:g}, kd = {self.kd:g}, K = {self.K:g}"
