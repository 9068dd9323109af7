"""Brakes: laws for a joint whose encoder is lost. Until then the position loop of their bypass tracks."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from dashpot.arm.drive import Drive
from dashpot.control.jointlaw import Law
from dashpot.control.rivals.blocks import (
    encoder_damping_block,
    latched_torque_block,
    rotor_observer_block,
    static_feedback_block,
)
from dashpot.control.sampled import empty_block, pd_block
from dashpot.errors import InputError
from dashpot.support.tables import number

if TYPE_CHECKING:
    from dashpot.control.controller import ControllerConfig


@dataclass(frozen=True)
class Brake(Law):
    """A brake; kp and kd are of the position loop that tracks before it (mode "bypass").

    Attributes:
        kp: [N m/rad].
        kd: [N m s/rad].
    """

    brake: ClassVar[bool] = True
    position_gains: ClassVar[tuple[str, ...]] = ()
    kp: float = number("N m/rad", 0, 1e7, default=0.0)
    kd: float = number("N m s/rad", 0, 1e6, default=0.0)

    def coefficients(
        self, drive: Drive, config: ControllerConfig, *, file: object = None
    ) -> NDArray[np.void]:
        """See `Law.coefficients`."""
        try:
            block = self.braking(drive, config)
        except InputError as error:
            raise InputError(
                error.rule, file=file, joint=self.name, quantity=error.quantity, value=error.value
            ) from None
        block["bypass"] = pd_block(self.kp, self.kd)["bypass"]
        return block

    @abstractmethod
    def braking(self, drive: Drive, config: ControllerConfig) -> NDArray[np.void]:
        """The brake's own block."""


@dataclass(frozen=True)
class Off(Brake):
    """The motor without current: zero torque. Also the law under shorted windings or a mechanical brake."""

    law: ClassVar[str] = "off"
    label: ClassVar[str] = "off"

    def braking(self, drive: Drive, config: ControllerConfig) -> NDArray[np.void]:
        """Zeros."""
        return empty_block()


@dataclass(frozen=True)
class StaticFeedback(Brake):
    """Static positive torque feedback, `static_feedback_block`.

    Attributes:
        gain: K_tau [-].
    """

    law: ClassVar[str] = "static_feedback"
    label: ClassVar[str] = "static fb."
    gain: float = number("-", 0, 0.9999)

    def braking(self, drive: Drive, config: ControllerConfig) -> NDArray[np.void]:
        """See `static_feedback_block`."""
        return static_feedback_block(self.gain)

    def friction_factor(self, drive: Drive) -> float:
        """See `Law.friction_factor`: ``1/(1 - K_tau)``."""
        return 1 / (1 - self.gain)

    def trouble(self, drive: Drive) -> str:
        """See `Law.trouble`."""
        return "sampled and held, the torque fed back comes late" if self.gain else ""


@dataclass(frozen=True)
class RotorObserver(Brake):
    """Damping on a rotor speed that is only predicted, `rotor_observer_block`.

    Attributes:
        damping: b [N m s/rad].
        rotor_inertia: m assumed by the law [kg m^2]; None: the drive's.
        viscous_friction: v assumed by the law [N m s/rad]; None: the drive's.
    """

    law: ClassVar[str] = "rotor_observer"
    label: ClassVar[str] = "observer"
    warm: ClassVar[bool] = True
    damping: float = number("N m s/rad", 0, 1e6)
    rotor_inertia: float | None = number("kg m^2", 1e-9, 1e3, default=None)
    viscous_friction: float | None = number("N m s/rad", 0, 1e4, default=None)

    def braking(self, drive: Drive, config: ControllerConfig) -> NDArray[np.void]:
        """See `rotor_observer_block`."""
        return rotor_observer_block(*self.model(drive), self.damping, config.period)

    def friction_factor(self, drive: Drive) -> float:
        """See `Law.friction_factor`: ``1 + b/v``."""
        friction = self.model(drive)[1]
        return 1 + self.damping / friction if friction > 0 else float("inf")

    def trouble(self, drive: Drive) -> str:
        """See `Law.trouble`."""
        return "the predicted speed is late by the hold, and wrong where the drive is not the model's"


@dataclass(frozen=True)
class LatchedTorque(Brake):
    """The last torque stays, `latched_torque_block`."""

    law: ClassVar[str] = "latched_torque"
    label: ClassVar[str] = "latched"

    def braking(self, drive: Drive, config: ControllerConfig) -> NDArray[np.void]:
        """See `latched_torque_block`."""
        blend = np.exp(-config.period / config.blend) if config.blend > 0 else 0.0
        return latched_torque_block(config.latency, float(blend))


@dataclass(frozen=True)
class EncoderDamping(Brake):
    """Damping by the encoder, `encoder_damping_block`: what the others are measured against.

    Attributes:
        damping: b [N m s/rad].
    """

    law: ClassVar[str] = "encoder_damping"
    label: ClassVar[str] = "encoder"
    keeps_encoder: ClassVar[bool] = True
    position_gains: ClassVar[tuple[str, ...]] = ("damping",)
    damping: float = number("N m s/rad", 0, 1e6)

    def braking(self, drive: Drive, config: ControllerConfig) -> NDArray[np.void]:
        """See `encoder_damping_block`."""
        return encoder_damping_block(self.damping)

    def trouble(self, drive: Drive) -> str:
        """See `Law.trouble`."""
        return "sampled and held, the damping torque comes half a period late and more: lower `damping`"
