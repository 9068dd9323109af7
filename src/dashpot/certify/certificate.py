"""The certificate of an arm: every joint over its whole box, and what follows for all of them together."""

from __future__ import annotations

import math
import sys
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dashpot.arm.drive import Drive
from dashpot.arm.robot import Robot
from dashpot.certify.box import POINTS, BoxCertificate, at, certify_box
from dashpot.certify.counterexample import Counterexample, counterexample
from dashpot.certify.index import Index, passivity_index
from dashpot.certify.joint import holds_torque, sampled_joint, uses
from dashpot.certify.threads import one_thread
from dashpot.control.controller import SLIGHT, ControllerConfig, Law, joint_block
from dashpot.control.sampled import POSITION, VELOCITY, empty_block, without_encoder
from dashpot.errors import InputError, InputWarning

DOCUMENT = "docs/certificate.md"
ASSUMED = "Assumed: constant references, torques below their limits, linear drives within the stated box."
STATEMENT = (
    "A certified joint gives out no more energy than was put in, whatever passive load hangs on it; no "
    "passive mechanism, payload, pose or contact can make an arm of certified joints oscillate. "
    f"{ASSUMED} Backlash, presliding friction and a moving reference are outside; see {DOCUMENT}."
)


@dataclass(frozen=True)
class JointCertificate:
    """Verdict on one joint.

    Attributes:
        name: Its name.
        nominal: Index with the drive's nominal values.
        bare: Index of the drive without a controller [N m s/rad].
        box: Over the box of the drive's uncertainty.
        brake: The same without position loop, as when the encoder is lost; None where that changes nothing.
        counterexample: A load that oscillates where the verdict is no, or None.
        point: Drive values at which it does: nominal, or the worst point of the box.
        trouble: How such a law is known to give out energy, in words, or empty.
    """

    name: str
    nominal: Index
    bare: float
    box: BoxCertificate
    brake: BoxCertificate | None
    counterexample: Counterexample | None
    point: Mapping[str, float]
    trouble: str = ""

    @property
    def certified(self) -> bool:
        """Whether no passive load can make the joint oscillate, anywhere in the box."""
        return self.nominal.passive and self.box.proven

    @property
    def margin(self) -> float:
        """Worst index relative to that of the drive alone [-]."""
        return self.box.worst.value / self.bare if self.bare > 0 else -float("inf")

    @property
    def reason(self) -> str:
        """Why the verdict is no, in words; empty where it is yes."""
        if self.certified:
            return ""
        if self.nominal.reason:
            return self.nominal.reason
        if self.box.worst.reason:
            return f"at the worst point: {self.box.worst.reason}"
        if self.box.worst.value > 0:
            return self.box.reason
        return "the joint gives out energy at its worst frequency" + (self.trouble and f": {self.trouble}")


@dataclass(frozen=True)
class Certificate:
    """Verdict on an arm.

    Attributes:
        robot: Name of the arm.
        joints: One per controlled joint, base to tip.
        others: Joints the controller leaves to the robot, taken to be passive.
    """

    robot: str
    joints: tuple[JointCertificate, ...]
    others: tuple[str, ...]

    @property
    def certified(self) -> bool:
        """Whether every joint is."""
        return all(joint.certified for joint in self.joints)

    def table(self) -> dict[str, Any]:
        """For JSON; an index of minus infinity is written as the lowest number there is."""
        return {"certified": self.certified, "joints": [_row(joint) for joint in self.joints]}


def certify_arm(
    robot: Robot, config: ControllerConfig, done: Callable[[], None] | None = None
) -> Certificate:
    """Certifies a controller on an arm, joint by joint; no model of the arm is needed.

    Args:
        robot: The arm's drives.
        config: Laws of some or all joints.
        done: Called after every joint.

    Raises:
        InputError: A joint of the controller is not one of the robot.
    """
    joints = []
    for drive, gains in paired(robot, config):
        joints.append(certify_joint(drive, gains, config))
        if done is not None:
            done()
    controlled = {joint.name for joint in joints}
    others = tuple(name for name in robot.joints if name not in controlled)
    return Certificate(robot.name, tuple(joints), others)


def paired(robot: Robot, config: ControllerConfig) -> list[tuple[Drive, Law]]:
    """Drive and law of every controlled joint, base to tip.

    Raises:
        InputError: A joint of the controller is not one of the robot.

    Warns:
        InputWarning: A drive was identified to be later than the controller counts on.
    """
    gains = {joint.name: joint for joint in config.joints}
    for name in gains:
        if name not in robot.joints:
            raise InputError(
                f"the robot has no such joint; it has {', '.join(robot.joints)}", file=config.file, joint=name
            )
    pairs = [(drive, gains[drive.name]) for drive in robot.drives if drive.name in gains]
    longest = config.latency if config.latency_max is None else config.latency_max
    for drive, _ in pairs:
        if (longest + SLIGHT) * config.period < (drive.command_latency or 0.0):
            message = InputError(
                f"is more than the {longest} samples of {config.period:g} s that the controller counts on; "
                "raise its latency_max",
                file=robot.file,
                joint=drive.name,
                quantity="command_latency [s]",
                value=drive.command_latency,
            )
            warnings.warn(str(message), InputWarning, stacklevel=2)
    return pairs


@one_thread
def certify_joint(drive: Drive, gains: Law, config: ControllerConfig) -> JointCertificate:
    """Certifies one joint of a controller file."""
    block = block_of(drive, gains, config)
    sampling, period = config.sampling, config.period
    nominal = passivity_index(drive, block, sampling, period)
    box = certify_box(drive, block, sampling, period, config.latency_max)
    brake = None
    if not gains.keeps_encoder and (uses(block, POSITION) or uses(block, VELOCITY)):
        brake = certify_box(drive, without_encoder(block), sampling, period, config.latency_max)
    point = {name: _nominal(name, drive, config) for name in POINTS}
    load = None
    if holds_torque(block):
        pass  # nothing oscillates
    elif not nominal.passive:
        load = counterexample(sampled_joint(drive, block, sampling, period), drive)
    elif not box.proven:
        point = dict(box.point)
        there, scales = at(drive, point)
        load = counterexample(sampled_joint(there, block, sampling, period, scales), there)
    bare = passivity_index(drive, empty_block(), sampling, period).value
    return JointCertificate(drive.name, nominal, bare, box, brake, load, point, gains.trouble(drive))


def block_of(drive: Drive, gains: Law, config: ControllerConfig) -> NDArray[np.void]:
    """`joint_block` without its warning of a torque-channel error, which the certificate covers."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        return joint_block(gains, drive, config, file=config.file)


def _nominal(name: str, drive: Drive, config: ControllerConfig) -> float:
    if name == "latency":
        return float(config.latency)
    return 1.0 if name in ("torque_gain", "position_gain") else float(getattr(drive, name))


def _finite(value: float) -> float:
    return max(value, -sys.float_info.max)


def _row(joint: JointCertificate) -> dict[str, Any]:
    worst, load = joint.box.worst, joint.counterexample
    row: dict[str, Any] = {
        "name": joint.name,
        "index": _finite(joint.nominal.value),
        "worst_index": _finite(worst.value),
        "frequency_hz": worst.frequency if joint.nominal.passive else joint.nominal.frequency,
        "certified": joint.certified,
        "counterexample": None,
        "margin": joint.margin if math.isfinite(joint.margin) else None,
        "worst_point": dict(joint.box.point),
        "intervals": joint.nominal.intervals,
        "remainder": joint.nominal.remainder,
        "reason": joint.reason,
        "brake": None if joint.brake is None else {"worst_index": _finite(joint.brake.worst.value)},
    }
    if joint.brake is not None:
        row["brake"]["certified"] = joint.brake.proven
    if load is not None:
        row["counterexample"] = {
            "load": load.load.kind,
            "inertia": load.load.inertia,
            "stiffness": load.load.stiffness,
            "frequency_hz": load.frequency,
            "growth_per_s": load.growth,
            "at": dict(joint.point),
            "text": str(load),
        }
    return row
