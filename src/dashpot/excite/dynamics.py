"""Torques that a motion of the rigid arm asks of its links and motors."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from dashpot.arm.drive import Drive
from dashpot.arm.plant import Plant
from dashpot.support.arrays import Floats


def link_torque(plant: Plant, q: Floats, w: Floats, a: Floats) -> Floats:
    """Torque that moves the links of the rigid arm, by inverse dynamics: (t, n) [N m].

    Args:
        plant: The arm with its payload.
        q: (t, n) [rad].
        w: (t, n) [rad/s].
        a: (t, n) [rad/s^2].
    """
    model, data = plant.model, mujoco.MjData(plant.model)
    qpos = np.tile(data.qpos, (len(q), 1))
    qvel, qacc = np.zeros((2, len(q), model.nv))
    qpos[:, plant.rotor_qpos], qvel[:, plant.rotor_dof], qacc[:, plant.rotor_dof] = q, w, a
    torque = np.empty((len(q), model.nv))
    for i in range(len(q)):
        data.qpos[:], data.qvel[:], data.qacc[:] = qpos[i], qvel[i], qacc[i]
        mujoco.mj_inverse(model, data)
        torque[i] = data.qfrc_inverse
    # The spring hinge, undeflected, carries the link alone.
    return np.asarray(torque[:, plant.spring_dof])


def motor_torque(drives: Sequence[Drive], w: Floats, a: Floats, tau: Floats) -> Floats:
    """``m q'' + v q' + f sgn q' + tau_s`` with each drive's largest friction level, (t, n) [N m]."""
    m = np.array([drive.rotor_inertia for drive in drives])
    v = np.array([drive.viscous_friction for drive in drives])
    return np.asarray(m * a + v * w + largest_friction(drives) * np.sign(w) + tau)


def largest_friction(drives: Sequence[Drive]) -> Floats:
    """Largest friction at low speed, (n,) [N m]."""
    return np.array([max(drive.coulomb_friction, drive.stribeck_friction) for drive in drives])
