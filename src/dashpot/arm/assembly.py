"""An elastic, friction-laden drive put into each joint of any MJCF or URDF.

Each joint becomes two hinges in series on the same body: the rotor (its armature is the rotor inertia,
its damping the viscous friction) and the transmission spring that carries the link.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from dashpot.arm.drive import Drive
from dashpot.arm.payload import Payload, hang
from dashpot.arm.robot import Robot
from dashpot.errors import InputError, InputWarning, ModelError


def elastic_model(robot: Robot, payloads: Sequence[Payload]) -> tuple[Any, list[tuple[float, float]]]:
    """The elastic arm with its payloads: MjModel, and the joints' ranges [rad].

    Raises:
        ModelError: The model file, a joint or the flange site is missing or unusable.
        InputError: The home pose is outside a joint's range.
    """
    spec, rigid = load_spec(robot)
    ranges = [_insert_drive(spec, rigid, drive, robot.model) for drive in robot.drives]
    for drive, angle, (lower, upper) in zip(robot.drives, robot.home, ranges, strict=True):
        if not lower <= angle <= upper:
            raise InputError(
                f"is outside the joint's range, {lower:.4g} to {upper:.4g} rad in {robot.model}",
                file=robot.file,
                joint=drive.name,
                quantity="home [rad]",
                value=angle,
            )
    hang(spec, rigid, robot, payloads)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    # A diverging run must be reported, not silently reset; the plant has no contacts yet.
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET | mujoco.mjtDisableBit.mjDSBL_CONTACT
    # The transmissions are springs and dampers of the engine, and nothing may fall asleep.
    spring, damper = int(mujoco.mjtDisableBit.mjDSBL_SPRING), int(mujoco.mjtDisableBit.mjDSBL_DAMPER)
    spec.option.disableflags &= ~(spring | damper)
    spec.option.enableflags &= ~int(mujoco.mjtEnableBit.mjENBL_SLEEP)
    try:
        model = spec.compile()
    except Exception as error:
        raise ModelError(
            f"{robot.model}: MuJoCo cannot compile the elastic arm: {_one_line(error)}"
        ) from None
    return model, ranges


def load_spec(robot: Robot) -> tuple[Any, Any]:
    """The robot's model file without actuators, sensors and keyframes: (MjSpec, MjModel).

    Meshes that are not there are left out where every body has its own inertia.

    Raises:
        ModelError: The file is missing or MuJoCo cannot read it.
    """
    path = robot.model
    if path is None:
        raise ModelError(f"{robot.file}: model: missing key; simulation needs a MJCF or URDF file")
    if not Path(path).is_file():
        raise ModelError(f"{robot.file}: model = {str(path)!r}: no such file")
    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except Exception as error:  # MuJoCo raises several types
        raise ModelError(f"{path}: MuJoCo cannot read it: {_one_line(error)}") from None
    for group in (spec.actuators, spec.sensors, spec.keys):
        for element in list(group):
            spec.delete(element)
    try:
        return spec, spec.copy().compile()
    except Exception as error:
        reason = _one_line(error)
    for geom in list(spec.geoms):
        if geom.meshname or geom.type == mujoco.mjtGeom.mjGEOM_MESH:
            spec.delete(geom)
    for mesh in list(spec.meshes):
        spec.delete(mesh)
    try:
        model = spec.copy().compile()
    except Exception as error:
        without = _one_line(error)
        if without != reason:
            reason += f" (and without meshes: {without})"
        raise ModelError(f"{path}: MuJoCo cannot compile it: {reason}") from None
    warnings.warn(f"{path}: used without its meshes: {reason}", InputWarning, stacklevel=2)
    return spec, model


def _one_line(error: BaseException) -> str:
    return "; ".join(line.strip() for line in str(error).splitlines() if line.strip())


def _insert_drive(spec: Any, rigid: Any, drive: Drive, path: Path | None) -> tuple[float, float]:
    """Turns a hinge of the rigid arm into rotor and spring; returns the joint's range [rad]."""
    joint = spec.joint(drive.name)
    if joint is None:
        hinges = [rigid.joint(i).name for i in np.flatnonzero(rigid.jnt_type == mujoco.mjtJoint.mjJNT_HINGE)]
        raise ModelError(
            f"{path}: joint {drive.name!r}: not in the model; its hinges: {', '.join(hinges) or 'none'}"
        )
    if joint.type != mujoco.mjtJoint.mjJNT_HINGE:
        raise ModelError(f"{path}: joint {drive.name!r}: must be a hinge")
    body = joint.parent
    if len(body.joints) != 1:
        raise ModelError(f"{path}: joint {drive.name!r}: must be the only joint of its body {body.name!r}")
    inner = 1.0 + (drive.inner_loop.gain if drive.inner_loop else 0.0)
    joint.armature = drive.rotor_inertia * inner
    joint.damping[:] = drive.viscous_friction * inner, 0.0, 0.0
    joint.stiffness[:] = joint.springdamper[:] = 0.0
    joint.frictionloss, joint.limited = 0.0, 0
    compiled = rigid.joint(drive.name)
    spring = body.add_joint(name=f"{drive.name}/transmission", type=mujoco.mjtJoint.mjJNT_HINGE)
    spring.pos, spring.axis = compiled.pos, compiled.axis
    # The file's defaults apply to a new joint too: every one that acts is replaced.
    spring.stiffness[:], spring.damping[:] = (drive.stiffness, 0.0, 0.0), (drive.damping, 0.0, 0.0)
    spring.springdamper[:] = spring.armature = spring.frictionloss = 0.0
    spring.ref = spring.springref = spring.springyield = 0.0
    spring.limited = spring.actfrclimited = 0
    lower, upper = compiled.range
    return (float(lower), float(upper)) if rigid.jnt_limited[compiled.id] else (-math.inf, math.inf)
