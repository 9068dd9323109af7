"""What a motion promises: a quick measure for the search, and the estimator's own word on the result."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from dashpot.arm.drive import Drive
from dashpot.arm.plant import Plant
from dashpot.excite.dynamics import link_torque, motor_torque
from dashpot.identify import Refusal, identify_joint
from dashpot.identify.refusals import CORE, MODEL_ERROR
from dashpot.logs.log import Log, Segment
from dashpot.simulation.trajectory import Trajectory
from dashpot.support.arrays import Floats

NOISE_FLOOR = 5e-4  # least noise of a torque channel, of its limit
NORMAL_95 = 1.96
SCALE_WEIGHT = 2.0  # of the scale in `merit`: where the motion is not followed exactly it is lost first
IMPERFECT = 2.0  # times the sensor's noise: no controller follows a motion exactly
CERTAIN_SCALE = 0.003  # half-width up to which a motion followed imperfectly tells enough: the bundled arms
TOLD = (*CORE, "torque_scale_error")
"""What a motion is made for."""


@dataclass(frozen=True)
class Promise:
    """What the estimator makes of the motion as planned.

    Attributes:
        half_widths: Half-widths of 95 % intervals, of the scale error absolute, else relative to the robot
            file's value [-]; what is refused or zero there is missing.
        refused: As `dashpot.identify.identify_joint` will say it.
        scale_needed: Whether inertia and friction are told only with the sensor's scale given; the widths
            are those with it given.
    """

    half_widths: Mapping[str, float]
    refused: tuple[Refusal, ...]
    scale_needed: bool

    @property
    def certain(self) -> bool:
        """Whether this holds too where friction and vibration disturb the motion."""
        return self.kept and self.half_widths.get("torque_scale_error", math.inf) <= CERTAIN_SCALE

    @property
    def kept(self) -> bool:
        """Whether inertia and friction are told, without anything else to be known."""
        return not self.scale_needed and not any(set(r.quantities) & set(CORE) for r in self.refused)


def noise_of(drive: Drive) -> float:
    """Standard deviation of the torque sensor's noise [N m]."""
    return max(drive.torque_noise, drive.torque_resolution / math.sqrt(12), NOISE_FLOOR * drive.torque_limit)


def merit(drive: Drive, w: Floats, a: Floats, load: Floats) -> float:
    """How uncertain a motion of one joint leaves it; smaller is better.

    The weighted sum of the logarithms of the half-widths of m, v, tau_c and the sensor's scale in
    ``u = m q'' + v q' + tau_c sgn q' + b + alpha tau_s``, from noise and from a model error at its worst, as
    `identify` counts it: collinear torque and acceleration, the usual fault, make all of them wide.

    Args:
        drive: Its values so far.
        w: (t,) [rad/s].
        a: (t,) [rad/s^2].
        load: (t,) what the sensor shows [N m], or anything that varies like it.
    """
    still = 1e-3 * max(float(np.abs(w).max()), 1e-12)
    sign = np.where(np.abs(w) > still, np.sign(w), 0.0)
    X = np.stack([a, w, sign, load, np.ones_like(w)], 1)
    size = np.sqrt((X**2).mean(0))
    X = X / np.where(size > 0, size, 1.0)
    gram = X.T @ X / len(X)
    if np.linalg.cond(gram) > 1e12:
        return math.inf
    u = drive.rotor_inertia * a + drive.viscous_friction * w + drive.coulomb_friction * sign + load
    variance = (NORMAL_95 * IMPERFECT * noise_of(drive)) ** 2 / len(X) + (MODEL_ERROR * float(np.std(u))) ** 2
    half = np.sqrt(variance * np.diag(np.linalg.inv(gram)))[:4] / np.maximum(size[:4], 1e-12)
    return float(np.log(np.maximum(half, 1e-12)) @ [1.0, 1.0, 1.0, SCALE_WEIGHT])


def predicted_log(plant: Plant, trajectory: Trajectory, seed: int = 0) -> Log:
    """The log of a motion followed exactly by a rigid arm whose torque sensors are as noisy as stated.

    Args:
        plant: The arm with its payload.
        trajectory: The motion.
        seed: Of the noise.
    """
    drives = plant.robot.drives
    q, w, a = trajectory.position, trajectory.velocity, trajectory.acceleration
    tau = link_torque(plant, q, w, a)
    u = motor_torque(drives, w, a, tau)
    u[:-1] = (u[1:] + u[:-1]) / 2  # a command is held until the next
    noise = IMPERFECT * np.array([noise_of(drive) for drive in drives])
    tau += noise * np.random.default_rng(seed).normal(size=tau.shape)
    q = q.copy()
    for j, drive in enumerate(drives):
        if drive.position_resolution > 0:
            q[:, j] = drive.position_resolution * np.rint(q[:, j] / drive.position_resolution)
    segment = Segment(trajectory.time, u, tau, q, None, None)
    return Log(plant.robot.joints, trajectory.period, (segment,), "point")


def promise(log: Log, drive: Drive) -> Promise:
    """Identifies a joint from a predicted log."""
    ideal = replace(drive, sensor_bandwidth=None, torque_latency=0.0)
    found = identify_joint(log.only(drive.name), drive.name, ideal)
    scale_needed = False
    if not all(key in found.values for key in CORE):
        given = identify_joint(log.only(drive.name), drive.name, ideal, scale=0.0)
        scale_needed = all(key in given.values for key in CORE)
        if scale_needed:
            found = replace(given, refused=found.refused)
    widths = {}
    for key in TOLD:
        estimate = found.values.get(key)
        true = 1.0 if key == "torque_scale_error" else float(getattr(drive, key))
        if estimate is not None and true > 0:
            widths[key] = max(estimate.high - estimate.value, estimate.value - estimate.low) / true
    return Promise(widths, found.refused, scale_needed)
