"""What can be chosen by name: rivals of a controller, poses, and the faults of the panel."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from dashpot.arm.drive import Drive
from dashpot.arm.payload import Payload
from dashpot.arm.plant import Plant
from dashpot.arm.robot import Robot
from dashpot.control.controller import ControllerConfig, JointGains, Law
from dashpot.control.law import static_R
from dashpot.control.rivals.brakes import Off, RotorObserver, StaticFeedback
from dashpot.control.rivals.tracking import PD, PID, InertiaShaping, PDScaled
from dashpot.errors import InputError
from dashpot.simulation.faults import FaultKind
from dashpot.support.arrays import Floats

INTEGRATION = 1.0  # [s], kp/ki of the PID rival


def _pd(law: JointGains, _: Drive) -> Law:
    return PD(law.name, kp=law.kp, kd=law.kd)


def _pd_scaled(law: JointGains, drive: Drive) -> Law:
    return PDScaled(law.name, R=_static(law, drive), kp=law.kp, kd=law.kd)


def _pid(law: JointGains, _: Drive) -> Law:
    return PID(law.name, kp=law.kp, kd=law.kd, ki=law.kp / INTEGRATION)


def _shaping(law: JointGains, drive: Drive) -> Law:
    return InertiaShaping(law.name, ratio=1 / (1 + _static(law, drive)), kp=law.kp, kd=law.kd)


def _static_feedback(law: JointGains, drive: Drive) -> Law:
    R = _static(law, drive)
    return StaticFeedback(law.name, gain=min(R / (1 + R), 0.99), kp=law.kp, kd=law.kd)


def _observer(law: JointGains, drive: Drive) -> Law:
    return RotorObserver(law.name, damping=law.D, kp=law.kp, kd=law.kd)


def _off(law: JointGains, _: Drive) -> Law:
    return Off(law.name, kp=law.kp, kd=law.kd)


RIVALS: Mapping[str, Callable[[JointGains, Drive], Law]] = {
    "PD, same kp and kd": _pd,
    "PD, R times as stiff": _pd_scaled,
    "PID, same kp and kd": _pid,
    "inertia shaping": _shaping,
    "PD; static torque feedback brakes": _static_feedback,
    "PD; rotor observer brakes": _observer,
    "PD; motor off when cut": _off,
}
"""Rivals made from the numbers of the virtual passive law beside them."""


def _static(law: JointGains, drive: Drive) -> float:
    return static_R(law.R, law.D, law.K, law.model(drive)[1])


def rival_of(name: str, config: ControllerConfig, robot: Robot) -> ControllerConfig:
    """The controller with every virtual passive joint under a rival, by its name in `RIVALS`."""
    drives = {drive.name: drive for drive in robot.drives}
    laws = [
        RIVALS[name](law, drives[law.name]) if isinstance(law, JointGains) else law for law in config.joints
    ]
    return replace(config, joints=tuple(laws), file=None)


CONTROLLER_OF = {"k807": "k807-wrist", "fr3": "fr3", "iiwa14": "iiwa14"}
"""Bundled robot -> its bundled controller."""


HEAVIEST, FARTHEST = 20.0, 2.0  # [kg] on the flange, [m] along each axis from it
POUND = 0.45359237  # [kg]


def carriable(mass: float, offset: float | tuple[float, float, float]) -> Payload:
    """A load [kg] at an offset [m] that may hang on an arm of the studio.

    Raises:
        InputError: It is too heavy, or too far out.
    """
    if not 0 <= mass <= HEAVIEST:
        raise InputError(f"must be 0 to {HEAVIEST:g} kg", quantity="payload [kg]", value=mass)
    if not np.abs(np.asarray(offset, float)).max() <= FARTHEST:
        raise InputError(
            f"must be {-FARTHEST:g} to {FARTHEST:g} m along each axis", quantity="offset [m]", value=offset
        )
    return Payload(mass, offset)


def controller_of(robot: str) -> str:
    """The controller that a bundled robot comes with.

    Raises:
        InputError: It is none of them.
    """
    if robot not in CONTROLLER_OF:
        raise InputError(
            f"is missing; only {', '.join(CONTROLLER_OF)} come with one. Name its TOML after {robot}; "
            "dashpot design makes one",
            quantity="CONTROLLER",
        )
    return CONTROLLER_OF[robot]


def poses(robot: Robot, plant: Plant) -> dict[str, Floats]:
    """Poses (n,) [rad] inside the joints' ranges, by name."""
    home = np.array(robot.home)
    lower, upper = plant.drives["stop_lower"], plant.drives["stop_upper"]
    room = 0.15  # [rad] to the stops
    swing = np.where(np.arange(len(home)) % 2 == 0, 0.5, -0.35)
    wrist = np.where(np.arange(len(home)) >= len(home) - 3, 0.6, 0.0)
    found = {"home": home, "aside": home + swing, "other side": home - swing, "wrist turned": home + wrist}
    return {name: np.clip(pose, lower + room, upper - room) for name, pose in found.items()}


@dataclass(frozen=True)
class PanelFault:
    """A fault of the panel.

    Attributes:
        label: On its switch.
        kind: See `dashpot.simulation.faults.KINDS`.
        per_joint: Whether it is of the chosen joint; else of the whole arm.
        size: What its value is, with the unit in brackets, or "": it takes none.
        value: To begin with.
    """

    label: str
    kind: FaultKind
    per_joint: bool = True
    size: str = ""
    value: float = 0.0


FAULTS = (
    PanelFault("encoder lost", "encoder_lost"),
    PanelFault("encoder frozen", "encoder_frozen"),
    PanelFault("torque bias", "torque_bias", size="bias [N m]", value=4.0),
    PanelFault("torque lost", "torque_nan"),
    PanelFault("samples dropped", "samples_dropped", size="share [-]", value=0.3),
    PanelFault("motor weak", "saturation", size="limit left [-]", value=0.3),
    PanelFault("brakes closed", "mechanical_brake", per_joint=False),
)
