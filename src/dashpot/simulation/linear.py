"""The linearised sampled arm: eigenvalues and mode shapes of the closed loop, per pose and payload.

The elastic arm is linearised at rest at a pose and discretised exactly over one control period, the interval
average included; the joint blocks close the loop. Coulomb friction, hysteresis, backlash, limits and the
delay inside the sensor are left out, an inner torque loop is taken as ideal: the result says when small
vibrations grow, not how large they become.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from dashpot.arm.dynamics import full_mass
from dashpot.arm.plant import Plant
from dashpot.control.controller import Controller
from dashpot.control.sampled import IN_EFFECT, NW, POSITION, TORQUE, VELOCITY
from dashpot.support.arrays import Floats


@dataclass(frozen=True)
class SampledArm:
    """An elastic arm over one control period, ``x+ = Phi x + Gamma u``, with what a controller reads.

    Attributes:
        joints: Controlled joints, nc of them; the others are under their servos.
        period: [s].
        phi: (nx, nx).
        gamma: (nx, nc), input: torque in effect over the period.
        read: (3, nc, nx): [torque sample, position, velocity] at the tick, from the state after the period.
        shape: (n, nx): link angles of all joints, for mode shapes.
    """

    joints: tuple[str, ...]
    period: float
    phi: Floats
    gamma: Floats
    read: Floats
    shape: Floats


@dataclass(frozen=True)
class ArmMode:
    """One oscillation of the sampled closed loop.

    Attributes:
        frequency: [Hz].
        growth: Rate of the amplitude [1/s]; positive grows.
        radius: Modulus of the eigenvalue.
        shape: Link motion per joint, (n,) complex, largest entry 1.
    """

    frequency: float
    growth: float
    radius: float
    shape: NDArray[np.complex128]


def linearise(plant: Plant, joints: Sequence[str], pose: Floats, period: float, sampling: str) -> SampledArm:
    """Linearises an arm at rest at a pose and discretises it exactly.

    Args:
        plant: The arm with its payload.
        joints: Joints to be controlled; every other one needs a servo.
        pose: Rotor angles, (n,) [rad].
        period: Control period [s].
        sampling: "average" or "point".
    """
    model, drives = plant.model, plant.drives
    nv, n = model.nv, len(drives)
    rotor, spring = plant.rotor_dof, plant.spring_dof
    data = mujoco.MjData(model)
    data.qpos[plant.rotor_qpos] = pose
    data.qpos[drives["spring_qpos"]] = -plant.load_torque(pose) / drives["stiffness"]
    mass = full_mass(model, data)
    scale = 1 / (1 + drives["inner_gain"])
    mass[rotor, rotor] += model.dof_armature[rotor] * (scale - 1)
    stiffness, damping = _gravity_stiffness(model, data), np.diag(model.dof_damping)
    damping[rotor, rotor] *= scale
    stiffness[spring, spring] += drives["stiffness"]

    controlled = [plant.robot.index(name) for name in joints]
    servos = [i for i in range(n) if i not in controlled]
    nc, ns = len(controlled), len(servos)
    filtered = [i for i in controlled if drives["filtered"][i]]
    orders = [plant.robot.drives[i].sensor_order for i in filtered]
    size = 2 * nv + ns + sum(orders)
    A = np.zeros((size, size))
    torque = np.zeros((n, size))  # transmitted torque from the state
    torque[np.arange(n), spring] = -drives["stiffness"]
    torque[np.arange(n), nv + spring] = -drives["damping"]
    force = np.hstack([-stiffness, -damping, np.zeros((nv, size - 2 * nv))])
    for k, i in enumerate(servos):
        produced = drives["actuator_gain"][i]
        force[rotor[i], rotor[i]] -= produced * drives["servo_kp"][i]
        force[rotor[i], nv + rotor[i]] -= produced * drives["servo_kd"][i]
        force[rotor[i], 2 * nv + k] -= produced * drives["servo_ki"][i]
        A[2 * nv + k, rotor[i]] = 1.0
    inverse = np.linalg.inv(mass)
    A[:nv, nv : 2 * nv] = np.eye(nv)
    A[nv : 2 * nv] = inverse @ force
    seen = torque[controlled].copy()
    at = 2 * nv + ns
    for i, order in zip(filtered, orders, strict=True):
        drive = plant.robot.drives[i]
        omega = 2 * np.pi * float(drive.sensor_bandwidth or 0)
        A[at + order - 1] = omega * torque[i]
        A[at + order - 1, at] -= omega
        if order == 2:
            A[at, at + 1] = omega
            A[at + 1, at + 1] -= 2 * drive.sensor_damping * omega
        seen[controlled.index(i)] = np.eye(size)[at]
        at += order
    seen *= drives["sensor_gain"][controlled][:, None]
    B = np.zeros((size, nc))
    B[nv : 2 * nv] = inverse[:, rotor[controlled]] * drives["actuator_gain"][controlled]

    # One exponential gives the state after a period and the integral of the seen torque over it.
    full = np.zeros((size + 2 * nc, size + 2 * nc))
    full[:size, :size], full[:size, size + nc :] = A, B
    full[size : size + nc, :size] = seen / period
    exact = expm(full * period)
    keep = size + nc
    phi = np.zeros((keep, keep))
    phi[:, :size] = exact[:keep, :size]
    gamma = exact[:keep, keep:]
    read = np.zeros((3, nc, keep))
    if sampling == "average":
        read[0, :, size:] = np.eye(nc)
    else:
        read[0, :, :size] = seen
    read[1, np.arange(nc), rotor[controlled]] = 1.0
    read[2, np.arange(nc), nv + rotor[controlled]] = 1.0
    shape = np.zeros((n, keep))
    shape[np.arange(n), rotor] = shape[np.arange(n), spring] = 1.0
    return SampledArm(tuple(joints), period, phi, gamma, read, shape)


def _gravity_stiffness(model: mujoco.MjModel, data: mujoco.MjData, delta: float = 1e-5) -> Floats:
    """Derivative of the gravity torque with respect to the joint angles, (nv, nv), by central differences."""
    result = np.zeros((model.nv, model.nv))
    rest = data.qpos.copy()
    for i in range(model.nv):
        both = []
        for sign in (1, -1):
            data.qpos[:] = rest
            step = np.zeros(model.nv)
            step[i] = sign * delta
            mujoco.mj_integratePos(model, data.qpos, step, 1)
            mujoco.mj_forward(model, data)
            both.append(data.qfrc_bias - data.qfrc_gravcomp)
        result[:, i] = (both[0] - both[1]) / (2 * delta)
    data.qpos[:] = rest
    return result


def closed_loop(
    arm: SampledArm,
    blocks: NDArray[np.void],
    *,
    bypass: Sequence[str] = (),
    position_loop: bool = True,
) -> Floats:
    """State matrices of arm and controller over one period.

    Args:
        arm: From `linearise`.
        blocks: (..., nc) records of `dashpot.control.sampled.BLOCK_DTYPE`, in the order of ``arm.joints``;
            all with the same latency.
        bypass: Joints whose law is bypassed: their position loop acts alone.
        position_loop: Whether the position loop is connected.

    Returns:
        (..., N, N). The state is [arm, torque in effect, block states, delay lines].
    """
    batch, nc = blocks.shape[:-1], blocks.shape[-1]
    latency = int(blocks["latency"].flat[0])
    if (blocks["latency"] != latency).any():
        raise ValueError("all blocks must have the same latency")
    nx, nb = len(arm.phi), int(blocks["nx"].max())
    p0 = nx  # torque in effect
    b0 = p0 + nc
    l0 = b0 + nc * nb
    size = l0 + nc * latency
    result = np.zeros((*batch, size, size))
    result[..., :nx, :nx] = arm.phi
    for j, name in enumerate(arm.joints):
        block = blocks[..., j]
        inputs = np.zeros((NW, size))  # w of this joint from the state
        inputs[TORQUE, :nx], inputs[POSITION, :nx], inputs[VELOCITY, :nx] = arm.read[:, j]
        inputs[IN_EFFECT, p0 + j] = 1.0
        if not position_loop:
            inputs[POSITION:] = 0.0
        states = slice(b0 + j * nb, b0 + (j + 1) * nb)
        if name in bypass:
            command = block["bypass"] @ inputs
        else:
            command = block["D"] @ inputs
            command[..., states] += block["C"][..., :nb]
            result[..., states, :] = block["B"][..., :nb, :] @ inputs
            result[..., states, states] += block["A"][..., :nb, :nb]
        if latency:
            result[..., l0 + j * latency, :] = command
            for i in range(1, latency):
                result[..., l0 + j * latency + i, l0 + j * latency + i - 1] = 1.0
            effect = np.zeros((*batch, size))
            effect[..., l0 + j * latency + latency - 1] = 1.0
        else:
            effect = command
        result[..., p0 + j, :] = effect
        result[..., :nx, :] += arm.gamma[:, j, None] * effect[..., None, :]
    return result


def spectral_radius(matrices: Floats) -> Floats:
    """Largest eigenvalue modulus of each matrix (..., N, N): (...)."""
    radius: Floats = np.abs(np.linalg.eigvals(matrices)).max(-1)
    return radius


def modes(arm: SampledArm, controller: Controller, **options: object) -> list[ArmMode]:
    """Oscillating modes of arm and controller, the fastest growing first.

    Args:
        arm: From `linearise`.
        controller: Controls ``arm.joints`` in that order.
        **options: ``bypass`` and ``position_loop`` of `closed_loop`.
    """
    values, vectors = np.linalg.eig(closed_loop(arm, controller.blocks, **options))  # type: ignore[arg-type]
    found = []
    for value, vector in zip(values, vectors.T, strict=True):
        if abs(value) < 1e-9 or value.imag < -1e-12:
            continue
        rate = np.log(complex(value)) / arm.period
        shape = arm.shape @ vector[: len(arm.phi)]
        largest = shape[np.argmax(np.abs(shape))]
        found.append(
            ArmMode(
                float(rate.imag) / (2 * np.pi),
                float(rate.real),
                float(abs(value)),
                shape / largest if largest != 0 else shape,
            )
        )
    return sorted(found, key=lambda mode: -mode.growth)
