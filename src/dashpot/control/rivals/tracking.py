"""Position controllers that the virtual passive law is compared with."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from dashpot.arm.drive import Drive
from dashpot.control.jointlaw import Law
from dashpot.control.rivals.blocks import (
    disturbance_observer_block,
    inertia_shaping_block,
    pid_block,
    scaled_pd_block,
    torque_feedback_block,
)
from dashpot.control.sampled import pd_block
from dashpot.support.tables import number

if TYPE_CHECKING:
    from dashpot.control.controller import ControllerConfig


@dataclass(frozen=True)
class Tracker(Law):
    """A law around a position loop; the loop alone is its bypass.

    Attributes:
        kp: [N m/rad].
        kd: [N m s/rad].
    """

    kp: float = number("N m/rad", 0, 1e7)
    kd: float = number("N m s/rad", 0, 1e6, default=0.0)


@dataclass(frozen=True)
class PD(Tracker):
    """``u = kp (q_d - q) + kd (q_d' - q') + torque_ref``."""

    law: ClassVar[str] = "pd"
    label: ClassVar[str] = "PD"

    def coefficients(
        self, drive: Drive, config: ControllerConfig, *, file: object = None
    ) -> NDArray[np.void]:
        """See `dashpot.control.sampled.pd_block`."""
        return pd_block(self.kp, self.kd)

    def trouble(self, drive: Drive) -> str:
        """See `Law.trouble`."""
        return _late_pd(self.kp, self.kd)


@dataclass(frozen=True)
class PDScaled(Tracker):
    """PD with gains times R: the static load error of the virtual passive law, `scaled_pd_block`.

    Attributes:
        R: Factor [-].
    """

    law: ClassVar[str] = "pd_scaled"
    label: ClassVar[str] = "PD x R"
    R: float = number("-", 1e-6, 1e4)

    def coefficients(
        self, drive: Drive, config: ControllerConfig, *, file: object = None
    ) -> NDArray[np.void]:
        """See `scaled_pd_block`."""
        return scaled_pd_block(self.R, self.kp, self.kd)

    def trouble(self, drive: Drive) -> str:
        """See `Law.trouble`."""
        return _late_pd(self.R * self.kp, self.R * self.kd)


@dataclass(frozen=True)
class PDGravity(PD):
    """PD with the weight of arm and assumed payload as torque reference, `dashpot.simulation.feedforward`.

    The block is that of `PD`; the torque reference comes with the trajectory.

    Attributes:
        payload: Mass assumed on the flange [kg].
        offset: Of its centre along the flange's x axis [m].
    """

    law: ClassVar[str] = "pd_gravity"
    label: ClassVar[str] = "PD + model"
    payload: float = number("kg", 0, 1e4, default=0.0)
    offset: float = number("m", -10, 10, default=0.0)


@dataclass(frozen=True)
class PID(Tracker):
    """PD with an integral and anti-windup, `pid_block`.

    Attributes:
        ki: [N m/(rad s)].
    """

    law: ClassVar[str] = "pid"
    label: ClassVar[str] = "PID"
    position_gains: ClassVar[tuple[str, ...]] = ("kp", "ki", "kd")
    ki: float = number("N m/(rad s)", 0, 1e8)

    def coefficients(
        self, drive: Drive, config: ControllerConfig, *, file: object = None
    ) -> NDArray[np.void]:
        """See `pid_block`."""
        return pid_block(self.kp, self.ki, self.kd, config.period)

    def trouble(self, drive: Drive) -> str:
        """See `Law.trouble`."""
        if self.ki == 0:
            return _late_pd(self.kp, self.kd)
        heavy = _heaviest(drive, self.kp, self.ki, self.kd)
        return f"the integral of the position error, at low frequency; {heavy}"


@dataclass(frozen=True)
class DisturbanceObserver(Tracker):
    """PD that cancels an estimated disturbance, `disturbance_observer_block`.

    Attributes:
        cutoff: Of the estimate's low-pass [Hz].
        rotor_inertia: m assumed by the law [kg m^2]; None: the drive's.
        viscous_friction: v assumed by the law [N m s/rad]; None: the drive's.
    """

    law: ClassVar[str] = "disturbance_observer"
    label: ClassVar[str] = "DOB"
    warm: ClassVar[bool] = True
    position_gains: ClassVar[tuple[str, ...]] = ("kp", "kd", "rotor_inertia", "viscous_friction")
    cutoff: float = number("Hz", 0, 1e5, open_low=True)
    rotor_inertia: float | None = number("kg m^2", 1e-9, 1e3, default=None)
    viscous_friction: float | None = number("N m s/rad", 0, 1e4, default=None)

    def coefficients(
        self, drive: Drive, config: ControllerConfig, *, file: object = None
    ) -> NDArray[np.void]:
        """See `disturbance_observer_block`."""
        return disturbance_observer_block(*self.model(drive), self.cutoff, self.kp, self.kd, config.period)

    def trouble(self, drive: Drive) -> str:
        """See `Law.trouble`: that of the PID controller it is, see `disturbance_observer_block`."""
        inertia, friction = self.model(drive)
        corner = 2 * math.pi * self.cutoff
        heavy = _heaviest(
            drive, self.kp + (self.kd + friction) * corner, self.kp * corner, self.kd + inertia * corner
        )
        return f"cancelling the disturbance integrates the position error, at low frequency; {heavy}"


@dataclass(frozen=True)
class TorqueFeedback(Tracker):
    """Joint torque feedback, `torque_feedback_block`.

    Attributes:
        gain: Of the sensed torque; 1 cancels the load [-].
        rotor_inertia: m assumed by the law [kg m^2]; None: the drive's.
        viscous_friction: v assumed by the law [N m s/rad]; None: the drive's.
    """

    law: ClassVar[str] = "torque_feedback"
    label: ClassVar[str] = "torque fb."
    position_gains: ClassVar[tuple[str, ...]] = ("kp", "kd", "viscous_friction")
    gain: float = number("-", 0, 1, default=1.0)
    rotor_inertia: float | None = number("kg m^2", 1e-9, 1e3, default=None)
    viscous_friction: float | None = number("N m s/rad", 0, 1e4, default=None)

    def coefficients(
        self, drive: Drive, config: ControllerConfig, *, file: object = None
    ) -> NDArray[np.void]:
        """See `torque_feedback_block`."""
        return torque_feedback_block(*self.model(drive), self.kp, self.kd, self.gain)

    def friction_factor(self, drive: Drive) -> float:
        """See `Law.friction_factor`: ``1/(1 - K)``."""
        return 1 / (1 - self.gain) if self.gain < 1 else math.inf

    def trouble(self, drive: Drive) -> str:
        """See `Law.trouble`."""
        if self.gain < 1:
            return "the torque fed back comes late"
        return (
            "with the load cancelled only the delay of the torque is left of the rotor, and the position "
            "loop gives out energy through it"
        )


@dataclass(frozen=True)
class InertiaShaping(Tracker):
    """Inertia shaping around a PD controller, `inertia_shaping_block`.

    Attributes:
        ratio: B/B_d: how many times lighter the rotor looks [-].
    """

    law: ClassVar[str] = "inertia_shaping"
    label: ClassVar[str] = "shaping"
    ratio: float = number("-", 1e-3, 1e3)

    def coefficients(
        self, drive: Drive, config: ControllerConfig, *, file: object = None
    ) -> NDArray[np.void]:
        """See `inertia_shaping_block`."""
        return inertia_shaping_block(self.ratio, self.kp, self.kd)

    def friction_factor(self, drive: Drive) -> float:
        """See `Law.friction_factor`: ``B_d/B``."""
        return 1 / self.ratio

    def trouble(self, drive: Drive) -> str:
        """See `Law.trouble`."""
        if self.ratio == 1:
            return _late_pd(self.kp, self.kd)
        how = "against the sensed torque" if self.ratio > 1 else "along with the sensed torque"
        return f"its torque {how} comes late by sampling and hold"


def _late_pd(kp: float, kd: float) -> str:
    if kd == 0 and kp > 0:
        return "without kd the position loop, late by the hold, acts as a negative damper"
    return "sampled and held, the position loop's torque comes late"


def _heaviest(drive: Drive, kp: float, ki: float, kd: float) -> str:
    """Where Routh's criterion ends for a rigid load: ``ki (J + m) < (v + kd) kp``."""
    inertia = (drive.viscous_friction + kd) * kp / ki - drive.rotor_inertia
    if inertia <= 0:
        return "any load may oscillate"
    return f"loads above {inertia:.3g} kg m^2 oscillate (Routh, rigid, without delay)"
