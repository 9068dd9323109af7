"""Random joints, controllers and loads for `dashpot.studies.soundness`, each from (seed, number) alone."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dashpot.arm.drive import Drive
from dashpot.certify.box import POINTS, Box
from dashpot.certify.index import Index, passivity_index
from dashpot.certify.joint import SampledJoint, sampled_joint
from dashpot.certify.loads import Load
from dashpot.control.controller import ControllerConfig, JointGains, joint_block
from dashpot.control.sampled import Form
from dashpot.errors import InputWarning
from dashpot.support.arrays import Floats

CENTRES = {  # parameters are log-uniform over a decade on each side, SI units
    "rotor_inertia": 0.1,
    "viscous_friction": 1.0,
    "stiffness": 8e3,
    "damping": 2.0,
    "R": 3.0,
    "D": 5.0,
    "K": 1.0,
    "kp": 60.0,
    "kd": 3.0,
}
BANDWIDTH = 0.1  # of the sensor's filter, centre, times the sample period
FORMS: tuple[Form, ...] = ("explicit", "implicit")
POINT = 0.2  # share of joints with point samples behind a sensor filter; the others average
INERTIAS = np.geomspace(1e-3, 1e4, 200)  # of the rotor's
SPRINGS = np.append(0.0, np.geomspace(1e-3, 10, 6))  # of the transmission's stiffness
MASSES, LENGTHS = np.geomspace(0.05, 50, 12), np.geomspace(0.03, 1.5, 8)  # [kg], [m]


@dataclass(frozen=True)
class Case:
    """A random joint with its controller.

    Attributes:
        number: With the seed, what it was made from.
        drive: Its drive.
        gains: Its gains.
        config: The controller they belong to.
    """

    number: int
    drive: Drive
    gains: JointGains
    config: ControllerConfig

    @property
    def block(self) -> NDArray[np.void]:
        """Its controller block, without the warning that random gains do not tolerate the gain error."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", InputWarning)
            return joint_block(self.gains, self.drive, self.config)

    def joint(self) -> SampledJoint:
        """Its exact description."""
        return sampled_joint(self.drive, self.block, self.config.sampling, self.config.period)

    def index(self) -> Index:
        """Its index."""
        return passivity_index(self.drive, self.block, self.config.sampling, self.config.period)


def case(seed: int, number: int) -> Case:
    """Draws a joint; friction and limits, which the law does not see, are for the simulator."""
    rng = np.random.default_rng([seed, number])
    value = {key: float(centre * 10 ** rng.uniform(-1, 1)) for key, centre in CENTRES.items()}
    if rng.random() < 1 / 3:
        value["K"] = 0.0
    if rng.random() < 0.5:
        value["kp"] = value["kd"] = 0.0
    period = float(rng.choice([0.005, 0.001]))
    form, latency = FORMS[int(rng.integers(0, 2))], int(rng.integers(0, 4))
    point, order = bool(rng.random() < POINT), int(rng.integers(1, 3))
    bandwidth = float(BANDWIDTH / period * 10 ** rng.uniform(-1, 1))
    drive = Drive(
        "joint",
        rotor_inertia=value["rotor_inertia"],
        viscous_friction=value["viscous_friction"],
        stiffness=value["stiffness"],
        damping=value["damping"],
        coulomb_friction=0.05,
        torque_limit=100.0,
        sensor_bandwidth=bandwidth if point else None,
        sensor_order=order,
    )
    gains = JointGains("joint", **{key: value[key] for key in ("R", "D", "K", "kp", "kd")})
    config = ControllerConfig(
        (gains,), period=period, latency=latency, sampling="point" if point else "average", form=form
    )
    return Case(number, drive, gains, config)


def loads(drive: Drive) -> tuple[Floats, Floats]:
    """Inertia [kg m^2] and stiffness [N m/rad] of every load tried on a joint, (k,) each."""
    inertia, stiffness = np.meshgrid(INERTIAS * drive.rotor_inertia, SPRINGS * drive.stiffness)
    pendulums = [Load.pendulum(mass, length) for mass in MASSES for length in LENGTHS]
    return (
        np.append(inertia, [load.inertia for load in pendulums]),
        np.append(stiffness, [load.stiffness for load in pendulums]),
    )


def random_point(box: Box, rng: np.random.Generator, *, corner: bool) -> dict[str, float]:
    """A point of a box: one of its corners, or anywhere inside."""
    point = {}
    for name in POINTS:
        low, high = box.ranges[name]
        share = float(rng.integers(0, 2)) if corner else rng.uniform()
        point[name] = float(low + share * (high - low))
    low, high = box.ranges["latency"]
    point["latency"] = float(rng.integers(int(low), int(high), endpoint=True))
    return point
