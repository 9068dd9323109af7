"""Mass matrix and natural frequencies of an elastic arm."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from dashpot.support.arrays import Floats


def stiffest_mode(model: Any, drives: NDArray[np.void], poses: Sequence[Floats]) -> float:
    """Highest natural frequency of rotors against links over some poses [rad/s]."""
    data = mujoco.MjData(model)
    stiffness = np.zeros((model.nv, model.nv))
    spring = drives["spring_dof"]
    stiffness[spring, spring] = drives["stiffness"] + np.where(
        drives["hysteresis"] > 0, drives["hysteresis_stiffness"], 0.0
    )
    highest = 0.0
    for q in poses:
        data.qpos[drives["rotor_qpos"]] = q
        mass = full_mass(model, data)
        # With an inner torque loop closed the rotor looks (1 + gain) times lighter.
        rotor = drives["rotor_dof"]
        armature = model.dof_armature[rotor]
        mass[rotor, rotor] += armature / (1 + drives["inner_gain"]) - armature
        highest = max(highest, float(eigh(stiffness, mass, eigvals_only=True)[-1]))
    return math.sqrt(highest)


def full_mass(model: Any, data: Any) -> Floats:
    """Joint-space mass matrix at data.qpos, (nv, nv) [kg m^2]."""
    mujoco.mj_forward(model, data)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    return mass
