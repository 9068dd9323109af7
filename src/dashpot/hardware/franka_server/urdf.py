"""The arm as URDF text: what the server gives a client that asks for the robot's model."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any
from xml.sax.saxutils import quoteattr

import mujoco
import numpy as np

from dashpot.arm.robot import Robot
from dashpot.errors import ModelError
from dashpot.hardware.franka_server.limits import Limits
from dashpot.support.arrays import Floats


def urdf(robot: Robot, rigid: Any, limits: Limits) -> str:
    """URDF of a serial arm, its joints and inertias as in the model; nothing to look at.

    libfranka reads joints ``joint1`` ... ``joint7`` and the links ``link0`` ... ``link8``, the flange.

    Args:
        robot: Names the joints and the flange.
        rigid: The arm's MjModel without elastic joints.
        limits: Of the robot.

    Raises:
        ModelError: The joints are not a chain of hinges that turn about their body's origin.
    """
    parts = [f"<robot name={quoteattr(robot.name)}>", '<link name="link0"/>']
    parent = None
    for i, drive in enumerate(robot.drives, start=1):
        joint = rigid.joint(drive.name)
        body = rigid.body(rigid.jnt_bodyid[joint.id])
        if parent is not None and rigid.body_parentid[body.id] != parent:
            raise ModelError(f"{robot.model}: joint {drive.name!r}: the robot's joints must form a chain")
        if np.abs(joint.pos).max() > 0:
            raise ModelError(f"{robot.model}: joint {drive.name!r}: must turn about its body's origin")
        parent = body.id
        bound = {
            key: f'"{float(getattr(limits, key)[i - 1])!r}"'
            for key in ("lower", "upper", "torque", "speed", "offset", "deceleration")
        }
        mass, ixx, iyy, izz = map(float, (body.mass[0], *body.inertia))
        parts += [
            f'<link name="link{i}"><inertial>{_origin(body.ipos, body.iquat)}<mass value="{mass!r}"/>'
            f'<inertia ixx="{ixx!r}" ixy="0" ixz="0" iyy="{iyy!r}" iyz="0" izz="{izz!r}"/></inertial></link>',
            f'<joint name="joint{i}" type="revolute"><parent link="link{i - 1}"/><child link="link{i}"/>'
            f'{_origin(body.pos, body.quat)}<axis xyz="{_numbers(joint.axis)}"/>'
            f"<limit lower={bound['lower']} upper={bound['upper']}"
            f" effort={bound['torque']} velocity={bound['speed']}/>"
            f"<position_based_velocity_limits velocity_offset={bound['offset']}"
            f" deceleration_limit={bound['deceleration']}/></joint>",
        ]
    flange = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
    if robot.flange is not None:
        site = rigid.site(robot.flange)
        flange = np.array(site.pos), np.array(site.quat)
    last = len(robot.drives)
    parts += [
        f'<link name="link{last + 1}"/>',
        f'<joint name="joint{last + 1}" type="fixed"><parent link="link{last}"/>'
        f'<child link="link{last + 1}"/>{_origin(*flange)}</joint>',
        "</robot>",
    ]
    return "\n".join(parts)


def _origin(position: Floats, quaternion: Floats) -> str:
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, np.asarray(quaternion, float))
    r = matrix.reshape(3, 3)
    # Fixed axes x, y, z: R = Rz(yaw) Ry(pitch) Rx(roll).
    pitch = math.atan2(-r[2, 0], math.hypot(r[0, 0], r[1, 0]))
    if abs(abs(pitch) - math.pi / 2) < 1e-9:  # only roll -+ yaw is defined
        roll, yaw = math.copysign(1.0, pitch) * math.atan2(r[0, 1], r[1, 1]), 0.0
    else:
        roll, yaw = math.atan2(r[2, 1], r[2, 2]), math.atan2(r[1, 0], r[0, 0])
    return f'<origin xyz="{_numbers(position)}" rpy="{_numbers((roll, pitch, yaw))}"/>'


def _numbers(values: Sequence[float] | Floats) -> str:
    return " ".join(repr(float(value)) for value in values)
