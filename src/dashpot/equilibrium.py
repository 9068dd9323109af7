"""The rest position of a closed loop under gravity, from which a run starts without a drop."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from dashpot.plant import Plant
from dashpot.sampled import IN_EFFECT, NX, POSITION, POSITION_REF, TORQUE, Floats

ITERATIONS, TOLERANCE = 200, 1e-10  # [rad]


@dataclass(frozen=True)
class Equilibrium:
    """Rest under gravity.

    Attributes:
        rotor: Rotor angles, (n,) [rad].
        deflection: Of the transmissions, (n,) [rad].
        torque: Held by each joint, (n,) [N m].
        states: Block states of the controlled joints, (nc, NX).
    """

    rotor: Floats
    deflection: Floats
    torque: Floats
    states: Floats


def settle(
    plant: Plant,
    joints: Sequence[str],
    blocks: NDArray[np.void],
    reference: Floats,
    bypass: Collection[str] = (),
) -> Equilibrium | None:
    """Finds the rest position at a constant reference by iterating sag and gravity.

    Args:
        plant: The arm.
        joints: Controlled joints, in the order of the blocks; the others hang on their servos.
        blocks: (nc,) records of `dashpot.sampled.BLOCK_DTYPE`.
        reference: (n,) [rad].
        bypass: Joints under their position loop alone.

    Returns:
        The equilibrium, or None where a joint has no position loop to hold it, a drive is not strong enough,
        or the iteration does not settle.
    """
    drives, n = plant.drives, len(plant.drives)
    gain = np.zeros((n, 3))  # static gain of the torque from [torque sample, torque in effect, position]
    for i, drive in enumerate(drives):
        gain[i, 2] = -drive["servo_kp"]
    index = [plant.robot.index(name) for name in joints]
    resolvent = []
    for i, name, block in zip(index, joints, blocks, strict=True):
        nx = int(block["nx"])
        passive = name in bypass
        solved = np.zeros((NX, block["B"].shape[1]))
        if not passive:
            try:
                solved[:nx] = np.linalg.solve(np.eye(nx) - block["A"][:nx, :nx], block["B"][:nx])
            except np.linalg.LinAlgError:
                return None
        static = block["bypass"] if passive else block["D"] + block["C"] @ solved
        gain[i] = static[[TORQUE, IN_EFFECT, POSITION]]
        resolvent.append(solved)
    if not (gain[:, 2] < 0).all():
        return None
    data = mujoco.MjData(plant.model)
    rotor = np.array(reference, float)
    deflection = np.zeros(n)
    for _ in range(ITERATIONS):
        data.qpos[plant.rotor_qpos], data.qpos[drives["spring_qpos"]] = rotor, deflection
        mujoco.mj_forward(plant.model, data)
        torque = np.array(data.qfrc_bias[plant.rotor_dof])
        sample = drives["sensor_gain"] * torque + drives["sensor_bias"]
        deflection = -torque / drives["stiffness"]
        before = rotor
        rotor = reference + (torque - gain[:, 0] * sample - gain[:, 1] * torque) / gain[:, 2]
        if not np.isfinite(rotor).all():
            return None
        if np.abs(rotor - before).max() < TOLERANCE:
            break
    else:
        return None
    if (np.abs(torque) > drives["torque_limit"]).any():
        return None
    states = np.zeros((len(joints), NX))
    for k, i in enumerate(index):
        w = np.zeros(blocks["B"].shape[-1])
        w[[TORQUE, IN_EFFECT, POSITION, POSITION_REF]] = sample[i], torque[i], rotor[i], reference[i]
        states[k] = resolvent[k] @ w
    return Equilibrium(rotor, deflection, torque, states)
