"""The nonlinear rotor term f_i and the apparent inertia m_i of Eqs. (1)-(6), for serial revolute arms.

A rotor rides on the link before it and spins about its joint axis. Besides m_i theta_i'' the motor must
supply the torque f_i that carries the rotor along with that link:

    u_i = m_i theta_i'' + v_i theta_i' + f_i + tau_s,i        (1)

How Eqs. (2)-(6) are read here. M_i is the rotor's inertia in base coordinates, so it turns with the arm, and
M_ri is the same tensor in frame i-1. In (6) the leading A_{i-1}^i acts on the whole cross product; as
printed, a vector of frame i-1 is multiplied with one of frame i. All vectors below are in frame i-1, turned
so that no further rotation is needed. With a gear the rotor turns at N theta' against link i-1, and
d'Alembert gives

    w_r = w + z N theta',    f = N z . [M (w' + w x z N theta') + w_r x M w_r],    m = N^2 z . M z,

w, w' being the motion of link i-1; N = 1 is the paper's direct drive. Two consequences worth knowing:

- An axisymmetric rotor leaves f = (m/N) z . w', nothing else. (A dynamically balanced but not axisymmetric
  one also has (M_y - M_x) w_x w_y, which does not vanish.)
- On the first joint of a fixed base w = w' = 0 and f = 0, whatever the rotor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from dashpot.control.network import Array
from dashpot.errors import InputError

if TYPE_CHECKING:
    import mujoco

_SLACK = 1e-9  # relative tolerance on unit axes, rotations and inertias


@dataclass(frozen=True, eq=False, init=False)
class Chain:
    """Joint frames and rotors of a serial arm with n revolute joints on a fixed base.

    Frame i is fixed to link i. At joint angle q it is turned against the frame of the link before (frame 0:
    the base) by rotation[i] Rot(axis[i], q), and rotor i by rotation[i] Rot(axis[i], N q).

    Args:
        axis: Joint axes in the joint's own frame, unit vectors, shape (n, 3).
        rotation: Rotation matrices from each joint's frame at q = 0 to the frame of the link before, shape
            (n, 3, 3).
        inertia: Rotor inertia about its centre of mass, which lies on the axis, in the joint's frame at q = 0
            [kg m^2], shape (n, 3, 3).
        ratio: Gear ratio N, rotor turns per joint turn seen from the link before, negative if reversed, shape
            (n,) or one number for all.

    Raises:
        InputError: A shape is wrong, an axis is not a unit vector, a rotation not a rotation, an inertia not
            one a body can have, or a ratio zero. Joints are counted from 1.
    """

    axis: Array
    rotation: Array
    inertia: Array
    ratio: Array

    def __init__(
        self, axis: ArrayLike, rotation: ArrayLike, inertia: ArrayLike, ratio: ArrayLike = 1.0
    ) -> None:
        n = np.shape(axis)[0] if np.ndim(axis) else 0
        if np.ndim(ratio) == 0:
            ratio = np.full(n, ratio)
        shapes = {"axis": (n, 3), "rotation": (n, 3, 3), "inertia": (n, 3, 3), "ratio": (n,)}
        for (name, shape), value in zip(shapes.items(), (axis, rotation, inertia, ratio), strict=True):
            array = np.array(value, dtype=np.float64)
            if array.shape != shape:
                raise InputError(f"must have shape {shape}", quantity=f"{name}.shape", value=array.shape)
            if not np.isfinite(array).all():
                raise InputError("must be finite", quantity=name)
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        for i in range(n):
            self._check_joint(i)

    def _check_joint(self, i: int) -> None:
        joint, z, A, M = str(i + 1), self.axis[i], self.rotation[i], self.inertia[i]
        if abs(np.linalg.norm(z) - 1) > _SLACK:
            raise InputError("must be a unit vector", joint=joint, quantity="axis", value=z.tolist())
        if np.abs(A @ A.T - np.eye(3)).max() > _SLACK or np.linalg.det(A) < 0:
            raise InputError("must be a rotation matrix", joint=joint, quantity="rotation", value=A.tolist())
        moments = np.linalg.eigvalsh(M)
        slack = _SLACK * abs(moments).max()
        if np.abs(M - M.T).max() > slack or moments[0] < -slack or moments[2] > moments[:2].sum() + slack:
            rule = "must be symmetric, its principal moments >= 0 and none above the sum of the others"
            raise InputError(rule, joint=joint, quantity="inertia [kg m^2]", value=M.tolist())
        if self.ratio[i] == 0:
            raise InputError("must not be zero", joint=joint, quantity="ratio", value=0.0)

    @classmethod
    def from_mujoco(
        cls,
        model: mujoco.MjModel,
        joint_names: Sequence[str],
        *,
        ratio: ArrayLike = 1.0,
        inertia: ArrayLike | None = None,
    ) -> Chain:
        """The chain through the named hinges of a MuJoCo model, base first.

        Args:
            model: Compiled `mujoco.MjModel`, rigid joints (before elastic ones are inserted).
            joint_names: Hinges of one serial arm in order; bodies between them must be welded.
            ratio: Gear ratios N, as in `Chain`.
            inertia: Rotor inertias (n, 3, 3) as in `Chain`, in each joint's body frame at qpos = 0. By
                default axisymmetric rotors with the model's `armature` as reflected inertia N^2 z.M z; f then
                depends on nothing else.

        Raises:
            InputError: A joint does not exist or is no hinge, or another joint lies between two named ones.
        """
        import mujoco

        identity, n = mujoco.mjtObj.mjOBJ_JOINT, len(joint_names)
        joints = [int(mujoco.mj_name2id(model, identity, name)) for name in joint_names]
        for name, j in zip(joint_names, joints, strict=True):
            if j < 0:
                valid = [mujoco.mj_id2name(model, identity, k) for k in range(model.njnt)]
                raise InputError(f"not in the model, which has {', '.join(map(str, valid))}", joint=name)
            if model.jnt_type[j] != mujoco.mjtJoint.mjJNT_HINGE:
                raise InputError("must be a hinge", joint=name)

        axis = np.array([model.jnt_axis[j] for j in joints]).reshape(n, 3)
        rotation = np.empty((n, 3, 3))
        before = 0
        for i, j in enumerate(joints):
            body = int(model.jnt_bodyid[j])
            zero = -float(model.qpos0[model.jnt_qposadr[j]])  # MuJoCo turns the body by qpos - qpos0
            rotation[i] = rotation_about(axis[i], zero)
            link = body
            while link != before:
                if link == 0 or model.body_jntnum[link] != (link == body):
                    between = "the base" if i == 0 else repr(joint_names[i - 1])
                    raise InputError(
                        f"must follow {between} with no other joint between", joint=joint_names[i]
                    )
                turn = np.empty(9)
                mujoco.mju_quat2Mat(turn, model.body_quat[link])
                rotation[i] = turn.reshape(3, 3) @ rotation[i]
                link = int(model.body_parentid[link])
            before = body

        N = np.broadcast_to(np.asarray(ratio, dtype=np.float64), (n,))
        if inertia is None:
            about_axis = np.array([model.dof_armature[model.jnt_dofadr[j]] for j in joints]) / N**2
            along = np.einsum("ij,ik->ijk", axis, axis)
            # The transverse moments never enter f; a thin disc is the least a body can have.
            inertia = about_axis[:, None, None] * (along + (np.eye(3) - along) / 2)
        return cls(axis, rotation, inertia, N)

    @property
    def apparent_inertia(self) -> Array:
        """m_i = N^2 z . M_ri z, Eq. (3) with a gear, shape (n,) [kg m^2]; the same in every pose."""
        return np.asarray(self.ratio**2 * np.einsum("ij,ijk,ik->i", self.axis, self.inertia, self.axis))


def rotation_about(axis: ArrayLike, angle: ArrayLike) -> Array:
    """Rotation matrices Rot(axis, angle) by Rodrigues' formula, shape (..., 3, 3) for angles (...) [rad]."""
    z = np.asarray(axis, dtype=np.float64)
    angle = np.asarray(angle, dtype=np.float64)[..., None, None]
    cross = np.array([[0, -z[2], z[1]], [z[2], 0, -z[0]], [-z[1], z[0], 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * (cross @ cross))


def rotor_terms(chain: Chain, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> Array:
    """The torques f_i of Eq. (6), geared where the chain is, seen at the joint [N m].

    Args:
        chain: Frames and rotors of the arm.
        q: Joint angles [rad], shape (..., n).
        qd: Joint velocities [rad/s], same shape.
        qdd: Joint accelerations [rad/s^2], same shape.

    Returns:
        f, shape (..., n), such that tau_x = tau_s + f = u - m theta'' - v theta'.

    Raises:
        InputError: The shapes do not agree with the chain.
    """
    q, qd, qdd = (np.asarray(x, dtype=np.float64) for x in (q, qd, qdd))
    n = len(chain.axis)
    for name, x in (("q", q), ("qd", qd), ("qdd", qdd)):
        if x.shape != q.shape or x.shape[-1:] != (n,):
            raise InputError(
                f"must have shape (..., {n}), the same for all", quantity=f"{name}.shape", value=x.shape
            )
    f = np.zeros(q.shape)
    w = wd = np.zeros((*q.shape[:-1], 3))  # motion of link i-1 in its own frame
    for i in range(n):
        z, N, A = chain.axis[i], chain.ratio[i], chain.rotation[i]
        w, wd = w @ A, wd @ A  # rows times A: A^T w, the link's motion in the joint's frame at q = 0
        spin, turn = qd[..., i, None] * z, rotation_about(z, N * q[..., i])
        M = turn @ chain.inertia[i] @ np.swapaxes(turn, -1, -2)
        w_r = w + N * spin
        carried = np.einsum("...ij,...j->...i", M, wd + np.cross(w, N * spin))
        f[..., i] = N * (carried + np.cross(w_r, np.einsum("...ij,...j->...i", M, w_r))) @ z
        wd = wd + qdd[..., i, None] * z + np.cross(w, spin)  # Eq. (5)
        w = w + spin  # Eq. (4)
        turn = rotation_about(z, q[..., i])
        w, wd = (np.einsum("...ji,...j->...i", turn, x) for x in (w, wd))
    return f
