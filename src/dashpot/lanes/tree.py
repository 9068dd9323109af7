"""The arm as the vectorised engine wants it, read from MuJoCo's compiled model of the plant."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np
from numpy.typing import NDArray

import dashpot._native as _native
from dashpot.arm.plant import Plant
from dashpot.errors import ModelError
from dashpot.support.arrays import Floats

NBODY = 10
RENAMES = 1e-14  # a turn that is so close to one that only renames axes is that one
_N = _native.MAX_LINKS
TREE_DTYPE = np.dtype(
    [
        ("links", "i4"),
        *((name, "i4", (_N,)) for name in ("parent", "slides", "drive", "qpos", "dof")),
        ("zero", "f8", (_N,)),
        ("place", "f8", (_N, 3)),
        ("turn", "f8", (_N, 3, 3)),
        ("along", "i4", (_N, 3)),
        ("sense", "f8", (_N, 3)),
        ("gravity", "f8", (3,)),
        *((name, "f8", (_N,)) for name in ("armature", "damping", "stiffness", "rest")),
    ],
    align=True,
)
"""Layout of ``dp_tree`` in native/lanes/dashpot_lanes.h."""
_HINGE, _SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)


@dataclass(frozen=True)
class Tree:
    """A plant's links, joints and rotors.

    Attributes:
        record: (1,) of `TREE_DTYPE`: what all plants of a robot share, whatever they carry.
        bodies: Mass [kg], centre of mass [m] and inertia about it (xx yy zz xy xz yz) [kg m^2] of every link,
            in the frame of its joint, whose z is the axis: (links, 10).
        rotors: Inertia [kg m^2] and viscous friction [N m s/rad] of every drive, (n, 2).
    """

    record: NDArray[np.void]
    bodies: Floats
    rotors: Floats

    @cached_property
    def key(self) -> bytes:
        """The record, to compare it."""
        return self.record.tobytes()

    @property
    def raw(self) -> NDArray[np.uint8]:
        """The record as bytes."""
        return self.record.view(np.uint8)

    @property
    def links(self) -> int:
        """Number of moving links."""
        return int(self.record["links"][0])


def tree_of(plant: Plant) -> Tree:
    """Reads a plant's model.

    Raises:
        ModelError: It has something that this engine does not simulate; MuJoCo does.
    """
    model = plant.model
    _refuse(plant)
    if TREE_DTYPE.itemsize != _native.TREE_SIZE:
        raise RuntimeError("the native library was built from another version; reinstall dashpot")
    drive_of = {int(model.dof_jntid[dof]): j for j, dof in enumerate(plant.rotor_dof)}
    spring_of = {int(model.dof_jntid[dof]): j for j, dof in enumerate(plant.spring_dof)}
    tree = np.zeros(1, TREE_DTYPE)
    record, count = tree[0], 0
    record["parent"], record["drive"] = -1, -1
    # Of every body: the link that it belongs to, and its frame in that of the link's joint.
    frames: list[tuple[int, Floats, Floats]] = [(-1, np.eye(3), np.zeros(3))]
    bodies = np.zeros((_N, NBODY))
    for body in range(1, model.nbody):
        link, turn, place = frames[model.body_parentid[body]]
        place = place + turn @ model.body_pos[body]
        turn = turn @ _matrix(model.body_quat[body])
        first = int(model.body_jntadr[body])
        for joint in range(first, first + int(model.body_jntnum[body])):
            if joint in spring_of:  # turns with its rotor
                continue
            if count == _N:
                raise ModelError(f"{plant.robot.model}: has more than {_N} moving joints")
            axis = _frame(model.jnt_axis[joint])
            anchor = model.jnt_pos[joint]
            record["parent"][count], record["drive"][count] = link, drive_of.get(joint, -1)
            record["slides"][count] = model.jnt_type[joint] == _SLIDE
            record["place"][count], record["turn"][count] = place + turn @ anchor, turn @ axis
            adr, dof = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])
            record["qpos"][count], record["dof"][count] = adr, dof
            record["zero"][count] = model.qpos0[adr]
            if joint in drive_of:
                spring = plant.drives["spring_qpos"][drive_of[joint]]
                record["zero"][count] += model.qpos0[spring]
            else:
                record["armature"][count] = model.dof_armature[dof]
                record["damping"][count] = model.dof_damping[dof]
                record["stiffness"][count] = model.jnt_stiffness[joint]
                record["rest"][count] = model.qpos_spring[adr] - model.qpos0[adr]
            link, turn, place = count, axis.T, -axis.T @ anchor
            count += 1
        frames.append((link, turn, place))
        if link >= 0:
            own = turn @ _matrix(model.body_iquat[body])
            inertia = own @ np.diag(model.body_inertia[body]) @ own.T
            centre = place + turn @ model.body_ipos[body]
            bodies[link] = _together(bodies[link], float(model.body_mass[body]), centre, inertia)
    for i in range(count):
        rounded = np.rint(record["turn"][i])
        only_renames = np.abs(record["turn"][i] - rounded).max() < RENAMES
        if only_renames:
            record["turn"][i] = rounded
        record["along"][i] = np.abs(rounded).argmax(0) if only_renames else -1
        record["sense"][i] = rounded.sum(0)
    record["links"] = count
    record["gravity"] = model.opt.gravity
    if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY:
        record["gravity"] = 0.0
    rotors = np.stack([model.dof_armature[plant.rotor_dof], model.dof_damping[plant.rotor_dof]], axis=1)
    return Tree(tree, bodies[:count].copy(), np.ascontiguousarray(rotors))


def _refuse(plant: Plant) -> None:
    """Names what only MuJoCo simulates."""
    model, where = plant.model, plant.robot.model

    def no(what: str) -> None:
        raise ModelError(f"{where}: {what}: only MuJoCo simulates this")

    for joint in range(model.njnt):
        name, kind = model.joint(joint).name, model.jnt_type[joint]
        dof = model.jnt_dofadr[joint]
        if kind not in (_HINGE, _SLIDE):
            no(f"joint {name!r} is neither a hinge nor a slide")
        if model.jnt_limited[joint] and not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_LIMIT:
            no(f"joint {name!r} has limits and no drive")
        if model.dof_frictionloss[dof] > 0:
            no(f"joint {name!r} has frictionloss and no drive")
        if model.jnt_stiffnesspoly[joint].any() or model.dof_dampingpoly[dof].any():
            no(f"joint {name!r} has a nonlinear spring or damper")
    for i in range(model.neq):
        no(f"equality constraint {model.equality(i).name or i!r}")
    for i in range(model.ntendon):
        no(f"tendon {model.tendon(i).name or i!r}")
    if model.nflex or model.nmocap:
        no("flexible bodies" if model.nflex else "mocap bodies")
    if model.body_gravcomp.any():
        no(f"gravcomp of body {model.body(int(np.argmax(model.body_gravcomp != 0))).name!r}")
    if model.opt.density > 0 or model.opt.viscosity > 0:
        no("a medium with density or viscosity")


def _matrix(quat: Floats) -> Floats:
    out = np.zeros(9)
    mujoco.mju_quat2Mat(out, quat)
    return out.reshape(3, 3)


def _frame(axis: Floats) -> Floats:
    """A rotation whose third column is an axis; its numbers are 0 and 1 where that is x, y or z."""
    z = np.asarray(axis, float) / np.linalg.norm(axis)
    k = int(np.argmax(np.abs(z)))
    x = np.eye(3)[(k + 1) % 3]
    x = x - (x @ z) * z
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def _together(body: Floats, mass: float, centre: Floats, inertia: Floats) -> Floats:
    """A body and another one that is fixed to it."""
    whole = body[0] + mass
    if whole == 0:
        return body
    both = (body[0] * body[1:4] + mass * centre) / whole
    total = _about(body[4:], body[0], body[1:4] - both) + inertia + mass * _spread(centre - both)
    return np.array(
        [whole, *both, *(total[i, k] for i, k in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)))]
    )


def _about(parts: Floats, mass: float, arm: Floats) -> Floats:
    xx, yy, zz, xy, xz, yz = parts
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) + mass * _spread(arm)


def _spread(arm: Floats) -> Floats:
    """Inertia of a unit mass at an arm [m^2]."""
    return np.asarray(arm @ arm * np.eye(3) - np.outer(arm, arm))
