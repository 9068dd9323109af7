"""The joint on which `dashpot.studies.rivals_tuning` tunes: a drive, its period, the links it may carry."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

from dashpot.arm.drive import Drive
from dashpot.arm.plant import Plant, build
from dashpot.arm.robot import Robot
from dashpot.certify.loads import Load
from dashpot.certify.testbench import write
from dashpot.control.controller import ControllerConfig, JointGains, Law, Sampling

SCALES: Mapping[str, int] = {"D": 1, "kd": 1, "damping": 1, "kp": 2, "ki": 3}
"""Numbers of a law that scale with the drive, and with which power of 1/period (`Bench.scale`)."""


@dataclass(frozen=True)
class Bench:
    """One joint and its loads.

    Attributes:
        robot: Bundled robot.
        joint: Whose drive it is.
        period: Sample period [s].
        sampling: How the torque is sampled.
        inertia: Of the link without a payload [kg m^2].
        heaviest: What the largest payload adds to it [kg m^2].
        load: The largest payload's load [N m].
    """

    robot: str
    joint: str
    period: float
    sampling: Sampling
    inertia: float
    heaviest: float
    load: float

    @property
    def drive(self) -> Drive:
        """The drive, under the name "joint"."""
        return _drive(self.robot, self.joint)

    def config(self, law: Law) -> ControllerConfig:
        """The controller of that joint alone."""
        return ControllerConfig((law,), period=self.period, sampling=self.sampling)

    def plant(self, share: float) -> Plant:
        """The joint with a share of the largest payload's inertia on its link."""
        return _plant(self, share)

    def scale(self, power: int) -> float:
        """Rotor inertia over ``period**power``, relative to `BENCH` [-]: how large gains can be.

        A sampled damper is stable up to about m/h, a sampled spring up to about m/h^2; power 0: 1.
        """
        if power == 0:
            return 1.0
        return self.drive.rotor_inertia / BENCH.drive.rotor_inertia * (BENCH.period / self.period) ** power


BENCH = Bench("fr3", "joint2", period=1e-3, sampling="average", inertia=0.6, heaviest=1.4, load=25.0)
"""Joint 2 of the bundled fr3."""


@cache
def _drive(robot: str, joint: str) -> Drive:
    arm = Robot.load(robot)
    return replace(arm.drives[arm.index(joint)], name="joint")


@cache
def _plant(bench: Bench, share: float) -> Plant:
    with tempfile.TemporaryDirectory() as folder:
        law = JointGains("joint", R=1.0, D=1.0)
        load = Load("inertia", bench.inertia + share * bench.heaviest)
        robot, _ = write(Path(folder), load, bench.drive, law, bench.config(law))
        return build(Robot.load(robot), bench.period)
