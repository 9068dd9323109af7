"""The paper's experiment on the k807 arm: what is fixed for all figures, and what of it is assumed."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass, replace
from functools import cache

from dashpot.arm.payload import Payload
from dashpot.arm.plant import Plant, build
from dashpot.arm.robot import Robot
from dashpot.control.controller import Controller, ControllerConfig, JointGains, load_controller
from dashpot.control.sampled import Form
from dashpot.errors import InputWarning

POUND = 0.45359237  # [kg]
PAYLOADS = (0, 5, 10)  # [lb], section VII
OFFSET = 0.23  # [m], weight to the centre of the end-effector, section VII
PERIOD = 0.005  # [s], 200 Hz, section VII
RELEASE = 3.0  # [s], when the position offset is removed, section VII
WRIST = ("joint5", "joint6", "joint7")  # roll, pitch, toolplate roll, section VII

BEAM_MASS = 1.2  # [kg], assumed: the beam and its clamp, on the hand at every payload
MOUNT_ANGLE = math.radians(35)  # assumed: the beam's angle from straight up at q7 = 0
AMPLITUDE = 0.35  # [rad], assumed: how far each joint swings about the home pose

ASSUMED = {
    "arm": "K-807i class: published geometry scaled to 0.8 m reach; masses and stops assumed (k807.xml)",
    "drives": "apparent values of the wrist, assumed: the paper could not identify them",
    "beam": f"{BEAM_MASS} kg, from the axis to 0.23 m, {math.degrees(MOUNT_ANGLE):.0f} degrees from straight "
    "up at home, on the hand at every payload",
    "trajectories": f"random multisines of all seven joints, 0.1-0.4 Hz, +-{AMPLITUDE} rad about home",
    "joints 1-4": "PD servo of the robot at the physics step",
}


def on_beam(distance: float) -> tuple[float, float, float]:
    """Point on the beam at a distance [m] from the toolplate's axis, in the flange frame [m]."""
    return (distance * math.cos(MOUNT_ANGLE), distance * math.sin(MOUNT_ANGLE), 0.0)


@dataclass(frozen=True)
class Setup:
    """Arm, plants and controller of the experiment.

    Attributes:
        robot: The arm.
        config: The wrist controller.
        plants: Payload [lb] -> plant.
    """

    robot: Robot
    config: ControllerConfig
    plants: dict[int, Plant]

    def controller(self, gains: tuple[JointGains, ...] | None = None, form: Form | None = None) -> Controller:
        """The wrist controller, with other gains and form if given (those of Fig. 6 are meant to fail)."""
        if gains is None:
            return Controller.from_config(self.config, self.robot.drives)
        config = replace(self.config, joints=gains, form=form or self.config.form)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", InputWarning)
            return Controller.from_config(config, self.robot.drives)


@cache
def setup() -> Setup:
    """Loads the arm and builds it with each payload."""
    robot = Robot.load("k807")
    plants = {lb: loaded(robot, lb) for lb in PAYLOADS}
    return Setup(robot, load_controller("k807-wrist"), plants)


def loaded(robot: Robot, pounds: float) -> Plant:
    """The arm with the beam and a weight [lb] at its end."""
    beam = Payload(BEAM_MASS, on_beam(OFFSET / 2), length=OFFSET)
    return build(robot, PERIOD, [beam, Payload(pounds * POUND, on_beam(OFFSET))])
