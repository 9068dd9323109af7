"""What `bench.py` compares with: the joint blocks in NumPy, scipy.signal, python-control; a Python loop."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
from scipy.linalg import block_diag
from scipy.signal import StateSpace, dlsim

from dashpot.arm.plant import Plant
from dashpot.control.controller import Controller
from dashpot.control.sampled import IN_EFFECT, NW, NX
from dashpot.simulation.trajectory import Trajectory
from dashpot.support.arrays import Floats

Step = Callable[[], object]


class NumpyBlocks:
    """The blocks as one batched product a tick, with limits; no modes, blending, latency or NaN guard."""

    def __init__(self, blocks: Any) -> None:
        n = len(blocks)
        # [u; x+] = M [x; w], one matrix a joint.
        self.M = np.zeros((n, 1 + NX, NX + NW))
        self.M[:, 0, :NX], self.M[:, 0, NX:] = blocks["C"], blocks["D"]
        self.M[:, 1:, :NX], self.M[:, 1:, NX:] = blocks["A"], blocks["B"]
        self.E, self.limit, self.rate = blocks["E"].copy(), blocks["torque_limit"], blocks["rate_limit"]
        self.limit, self.rate = self.limit.copy(), self.rate.copy()
        self.z, self.y = np.zeros((n, NX + NW, 1)), np.zeros((n, 1 + NX, 1))
        self.x, self.w = self.z[:, :NX, 0], self.z[:, NX:, 0]
        self.u, self.next = self.y[:, 0, 0], self.y[:, 1:, 0]
        self.out, self.low, self.high, self.lost = (np.zeros(n) for _ in range(4))
        self.lower = -self.limit

    def step(self) -> Floats:
        """One tick from ``w``; returns ``out`` (n,)."""
        out = self.out
        np.matmul(self.M, self.z, out=self.y)
        np.subtract(out, self.rate, out=self.low)
        np.add(out, self.rate, out=self.high)
        np.minimum(np.maximum(self.u, self.lower, out=out), self.limit, out=out)
        np.minimum(np.maximum(out, self.low, out=out), self.high, out=out)
        np.subtract(out, self.u, out=self.lost)
        np.multiply(self.E, self.lost[:, None], out=self.x)
        np.add(self.x, self.next, out=self.x)
        self.w[:, IN_EFFECT] = out
        return out


def _joint(block: Any) -> tuple[Floats, Floats, Floats, Floats]:
    nx = int(block["nx"])
    return (
        block["A"][:nx, :nx].copy(),
        block["B"][:nx].copy(),
        block["C"][None, :nx].copy(),
        block["D"][None].copy(),
    )


def scipy_per_joint(blocks: Any, w: Floats, period: float) -> Step:
    """``A @ x + B @ u`` on one StateSpace a joint; no limits."""
    systems = [StateSpace(*_joint(block), dt=period) for block in blocks]
    joints = [(s.A, s.B, s.C, s.D) for s in systems]
    states = [np.zeros(len(A)) for A, *_ in joints]
    rows, out = list(w), np.zeros(len(joints))

    def step() -> Floats:
        for j, (A, B, C, D) in enumerate(joints):
            x, wj = states[j], rows[j]
            out[j] = (C @ x + D @ wj)[0]
            states[j] = A @ x + B @ wj
        return out

    return step


def _stacked(blocks: Any) -> tuple[Floats, ...]:
    return tuple(block_diag(*part) for part in zip(*(_joint(b) for b in blocks), strict=True))


def scipy_dlsim(blocks: Any, w: Floats, period: float) -> Step:
    """`scipy.signal.dlsim` over one tick (two samples, to get the next state) of all joints as one system."""
    system = StateSpace(*_stacked(blocks), dt=period)
    u = np.vstack([w.ravel(), w.ravel()])
    state = [np.zeros(system.A.shape[0])]

    def step() -> Floats:
        _, y, x = dlsim(system, u, x0=state[0])
        state[0] = x[1]
        return y[0]

    return step


def python_control(blocks: Any, w: Floats, period: float) -> Step | None:
    """`output` and `dynamics` of python-control on all joints as one system; None if not installed."""
    try:
        import control
    except ImportError:
        return None
    system = control.ss(*_stacked(blocks), period)
    u, state = w.ravel(), [np.zeros(system.nstates)]

    def step() -> Floats:
        y = system.output(0.0, state[0], u)
        state[0] = system.dynamics(0.0, state[0], u)
        return y

    return step


def python_loop(
    plant: Plant,
    controller: Controller,
    trajectory: Trajectory,
    qpos: Floats,
    noise: Floats,
    *,
    every_step: bool,
) -> tuple[float, Floats]:
    """The closed loop written in Python: NumPy over the joints, `Controller.step`, ``mj_step``.

    Drives with friction, sensor filter, sensor noise, interval average and torque limit; what the fr3 has not
    (backlash, hysteresis, inner loop, servo) is left out.

    Args:
        plant: The arm.
        controller: Controls every joint, with its states preset.
        trajectory: References.
        qpos: Initial engine positions.
        noise: Standard normal samples, (ticks, n).
        every_step: Forces and sensor at every physics step, the plant that dashpot simulates; or only at the
            ticks, another and coarser plant.

    Returns:
        CPU time of the loop [s], and rotor positions (ticks, n) [rad].
    """
    model, dr, dt = plant.model, plant.drives, plant.timestep
    steps = round(trajectory.period / dt)
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)

    def view(array: Floats, index: Any) -> Floats:
        cut = array[index[0] :: index[1] - index[0]][: len(index)]
        assert np.array_equal(np.arange(len(array))[index[0] :: index[1] - index[0]][: len(index)], index)
        return cut

    q, w = view(data.qpos, dr["rotor_qpos"]), view(data.qvel, dr["rotor_dof"])
    e, de = view(data.qpos, dr["spring_qpos"]), view(data.qvel, dr["spring_dof"])
    force = view(data.qfrc_applied, dr["rotor_dof"])
    k, c, gain, limit, coulomb = (
        dr[name].copy() for name in ("stiffness", "damping", "actuator_gain", "torque_limit", "coulomb")
    )
    presliding, damping = dr["presliding_stiffness"].copy(), dr["presliding_damping"].copy()
    lower, upper = dr["stop_lower"].copy(), dr["stop_upper"].copy()
    most, least, low, zmax = -coulomb, coulomb, -limit, coulomb / presliding
    zmin = -zmax
    (a00, a01), (a10, a11) = dr["filter_a"].transpose(1, 2, 0).copy()
    b0, b1 = dr["filter_b"].T.copy()
    scale, bias, noise = dr["sensor_gain"].copy(), dr["sensor_bias"].copy(), noise * dr["sensor_noise"]
    tau = -(k * e + c * de)
    x0, x1, seen, total = tau, np.zeros_like(tau), tau, np.zeros_like(tau)
    z, friction = np.zeros_like(tau), np.zeros_like(tau)
    record, out = np.full((8, *trajectory.position.shape), np.nan), np.zeros(len(dr))
    inputs, step, mj_step = controller.inputs, controller.step, mujoco.mj_step
    minimum, maximum = np.minimum, np.maximum
    h, held, advance = (dt, steps, 1) if every_step else (trajectory.period, 1, steps)
    begin = time.thread_time()
    for tick in range(len(trajectory.position)):
        average = total / held if tick else seen
        total = np.zeros_like(total)
        sample = scale * average + bias + noise[tick]
        inputs.torque[:], inputs.position[:], inputs.velocity[:] = sample, q, w
        inputs.position_ref[:], inputs.velocity_ref[:] = trajectory.position[tick], trajectory.velocity[tick]
        inputs.acceleration_ref[:] = trajectory.acceleration[tick]
        step(out)
        rows = record[:, tick]
        rows[0], rows[1], rows[2], rows[3], rows[4], rows[5] = q, w, q + e, w + de, tau, sample
        rows[6] = rows[7] = out
        drive = gain * minimum(maximum(out, low), limit)
        for _ in range(held):
            angle = q + e
            if (angle > upper).any() or (angle < lower).any():
                raise RuntimeError("a stop was reached; the Python loop has none")
            force[:] = drive - friction
            mj_step(model, data, advance)
            tau = -(k * e + c * de)
            z = minimum(maximum(z + w * h, zmin), zmax)
            friction = minimum(maximum(presliding * z + damping * w, most), least)
            x0, x1 = a00 * x0 + a01 * x1 + b0 * tau, a10 * x0 + a11 * x1 + b1 * tau
            total += 0.5 * (seen + x0)
            seen = x0
    return time.thread_time() - begin, record[0]
