"""The rest position of a closed loop under gravity, from which a run starts without a drop."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from dashpot.arm.plant import Plant
from dashpot.control.sampled import IN_EFFECT, NW, NX, POSITION, POSITION_REF, TORQUE, TORQUE_REF, pd_block
from dashpot.support.arrays import Floats

ITERATIONS, TOLERANCE = 200, 1e-10  # [rad]


@dataclass(frozen=True)
class Equilibrium:
    """Rest under gravity.

    Attributes:
        rotor: Rotor angles, (n,) [rad].
        deflection: Of the transmissions, (n,) [rad].
        torque: Held by each joint's controller or servo, (n,) [N m]: the load, less what the robot's gravity
            compensation holds.
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
    torque_reference: Floats | None = None,
    carried: Callable[[Floats], Floats] | None = None,
) -> Equilibrium | None:
    """Finds the rest position at a constant reference by iterating sag and gravity.

    Args:
        plant: The arm.
        joints: Controlled joints, in the order of the blocks; the others hang on their servos.
        blocks: (nc,) records of `dashpot.control.sampled.BLOCK_DTYPE`.
        reference: (n,) [rad].
        bypass: Joints under their position loop alone.
        torque_reference: (n,) [N m]; None: zero. Servos do not see it.
        carried: Torque that the robot's gravity compensation adds at rotor angles (n,) [rad]: (n,) [N m].

    Returns:
        The equilibrium, or None where a joint has no position loop to hold it, a drive is not strong enough,
        or the iteration does not settle.
    """
    drives, n = plant.drives, len(plant.drives)
    laws = {i: _Static.of(pd_block(float(drive["servo_kp"]), 0.0)) for i, drive in enumerate(drives)}
    for name, block in zip(joints, blocks, strict=True):
        laws[plant.robot.index(name)] = _Static.of(block, name in bypass)
    inputs = np.zeros((n, NW))
    inputs[:, POSITION_REF] = reference
    if torque_reference is not None:
        inputs[:, TORQUE_REF] = torque_reference
    if not all(law.holds for law in laws.values()):
        return None
    data = mujoco.MjData(plant.model)
    rotor = np.array(reference, float)
    deflection, states = np.zeros(n), np.zeros((n, NX))
    for _ in range(ITERATIONS):
        data.qpos[plant.rotor_qpos], data.qpos[drives["spring_qpos"]] = rotor, deflection
        mujoco.mj_forward(plant.model, data)
        load = np.array((data.qfrc_bias - data.qfrc_gravcomp)[plant.rotor_dof])
        own = 0.0 if carried is None else carried(rotor)
        torque = load - own
        inputs[:, TORQUE] = drives["sensor_gain"] * load + drives["sensor_bias"] - own
        inputs[:, IN_EFFECT] = torque
        before = rotor, deflection
        rotor, deflection = np.empty(n), -load / drives["stiffness"]
        for i, law in laws.items():
            states[i], rotor[i] = law.at(inputs[i], torque[i])
        if not np.isfinite(rotor).all():
            return None
        if max(np.abs(rotor - before[0]).max(), np.abs(deflection - before[1]).max()) < TOLERANCE:
            break
    else:
        return None
    if (np.abs(torque) > drives["torque_limit"]).any():
        return None
    controlled = [plant.robot.index(name) for name in joints]
    return Equilibrium(rotor, deflection, torque, states[controlled])


@dataclass(frozen=True)
class _Static:
    """A block at rest: ``x = A x + B w`` and ``torque = C x + D w``, to be solved for x and the position.

    With an integrator x is not a function of w, but x and the position together are.

    Attributes:
        inverse: Of that system in (x, position), (nx + 1, nx + 1); None where it has no solution.
        B: (nx, NW).
        D: (NW,).
    """

    inverse: Floats | None
    B: Floats
    D: Floats

    @classmethod
    def of(cls, block: NDArray[np.void], bypass: bool = False) -> _Static:
        nx = 0 if bypass else int(block["nx"])
        B, D = block["B"][:nx], block["bypass"] if bypass else block["D"]
        system = np.zeros((nx + 1, nx + 1))
        system[:nx, :nx], system[:nx, nx] = np.eye(nx) - block["A"][:nx, :nx], -B[:, POSITION]
        system[nx, :nx], system[nx, nx] = block["C"][:nx], D[POSITION]
        try:
            return cls(np.asarray(np.linalg.inv(system)), B, D)
        except np.linalg.LinAlgError:
            return cls(None, B, D)

    @property
    def holds(self) -> bool:
        """Whether a position loop pulls the joint back: one over its static gain is negative, or zero."""
        return self.inverse is not None and bool(self.inverse[-1, -1] <= np.finfo(float).eps)

    def at(self, w: Floats, torque: float) -> tuple[Floats, float]:
        """Block states (NX,) and position [rad] that give a torque [N m]; w is without position."""
        if self.inverse is None:
            raise ValueError("nothing holds this joint")
        found = self.inverse @ np.append(self.B @ w, torque - self.D @ w)
        states = np.zeros(NX)
        states[: len(found) - 1] = found[:-1]
        return states, float(found[-1])
