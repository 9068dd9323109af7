"""The port of a sampled joint: link velocity in, reaction energy out, lifted exactly over one period.

The joint is cut at its output. The link velocity w is prescribed, constant on N sub-intervals of a period;
``p_i`` is minus the integral of the transmitted torque over sub-interval i, so that ``sum p_i w_i`` is the
energy put into the joint in that period, exactly. Rotor, friction, transmission, sensor filter, sampler,
controller block, delay line and hold are all inside.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from dashpot.drive import Drive
from dashpot.sampled import IN_EFFECT, NW, POSITION, TORQUE, VELOCITY, Floats


@dataclass(frozen=True)
class Port:
    """A lifted joint over one period, ``x+ = A x + B w``, ``p = C x + D w``.

    Attributes:
        A: (n, n).
        B: (n, N).
        C: (N, n).
        D: (N, N).
        period: [s].
    """

    A: Floats
    B: Floats
    C: Floats
    D: Floats
    period: float

    @property
    def intervals(self) -> int:
        """Sub-intervals N."""
        return len(self.D)

    @property
    def scale(self) -> float:
        """N/h: turns an eigenvalue of the energy form into a damping [1/s]."""
        return self.intervals / self.period

    def response(self, omega: Floats) -> NDArray[np.complex128]:
        """``G(exp(j omega))`` at angles (...,) [rad per period]: (..., N, N)."""
        z = np.exp(1j * np.asarray(omega, float))[..., None, None]
        states = np.linalg.solve(z * np.eye(len(self.A)) - self.A, self.B + 0j * z)
        return np.asarray(self.D + self.C @ states, np.complex128)


@dataclass(frozen=True)
class _Continuous:
    """Joint between ticks: ``x' = A x + b_w w + b_u u``; rows give transmitted and seen torque."""

    A: Floats
    b_w: Floats
    b_u: Floats
    torque: Floats
    torque_w: float
    seen: Floats
    seen_w: float


def _continuous(drive: Drive, position: bool) -> _Continuous:
    """States: deflection (rotor minus link), rotor speed, [rotor position], [filter, filter rate]."""
    m, v, k, c = drive.rotor_inertia, drive.viscous_friction, drive.stiffness, drive.damping
    filtered = drive.sensor_bandwidth is not None
    n = 2 + position + 2 * filtered
    A, b_w, b_u = np.zeros((n, n)), np.zeros(n), np.zeros(n)
    torque = np.zeros(n)
    torque[:2] = k, c
    A[0, 1], b_w[0] = 1.0, -1.0
    A[1] = -torque / m
    A[1, 1] -= v / m
    b_w[1], b_u[1] = c / m, 1 / m
    if position:
        A[2, 1] = 1.0
    seen, seen_w = torque, -c
    if drive.sensor_bandwidth is not None:
        omega, zeta, i = 2 * np.pi * drive.sensor_bandwidth, drive.sensor_damping, 2 + position
        A[i, i + 1] = omega
        A[i + 1] += omega * torque
        A[i + 1, i] -= omega
        A[i + 1, i + 1] -= 2 * zeta * omega
        b_w[i + 1] = -omega * c
        seen, seen_w = np.eye(n)[i], 0.0
    return _Continuous(A, b_w, b_u, torque, -c, seen, seen_w)


def lift(drive: Drive, block: NDArray[np.void], sampling: str, period: float, intervals: int) -> Port:
    """Lifts a joint with its controller block over one period.

    The torque channel's constant gain error, Coulomb friction, backlash and limits are left out.

    Args:
        drive: The joint's drive.
        block: A record of `dashpot.sampled.BLOCK_DTYPE`.
        sampling: "average" or "point".
        period: [s].
        intervals: N.
    """
    uses_position = bool(block["D"][POSITION] != 0 or np.any(block["B"][:, POSITION] != 0))
    joint = _continuous(drive, uses_position)
    n = len(joint.A)
    # Over one sub-interval: state, and the integrals of transmitted and seen torque.
    full = np.zeros((n + 4, n + 4))
    full[:n, :n], full[:n, n], full[:n, n + 1] = joint.A, joint.b_u, joint.b_w
    full[n + 2, :n], full[n + 2, n + 1] = joint.torque, joint.torque_w
    full[n + 3, :n], full[n + 3, n + 1] = joint.seen, joint.seen_w
    exact = expm(full * (period / intervals))
    step, step_u, step_w = exact[:n, :n], exact[:n, n], exact[:n, n + 1]

    X, U, W = np.eye(n), np.zeros(n), np.zeros((n, intervals))  # state so far, from x, u and w
    energy, energy_u, D = np.zeros((intervals, n)), np.zeros(intervals), np.zeros((intervals, intervals))
    mean, mean_u, mean_w = np.zeros(n), 0.0, np.zeros(intervals)
    for i in range(intervals):
        torque, torque_u, torque_w = exact[n + 2, :n], exact[n + 2, n], exact[n + 2, n + 1]
        energy[i], energy_u[i], D[i] = -torque @ X, -(torque @ U + torque_u), -torque @ W
        D[i, i] -= torque_w
        seen, seen_u, seen_w = exact[n + 3, :n], exact[n + 3, n], exact[n + 3, n + 1]
        mean, mean_u, mean_w = mean + seen @ X, mean_u + seen @ U + seen_u, mean_w + seen @ W
        mean_w[i] += seen_w
        X, U, W = step @ X, step @ U + step_u, step @ W
        W[:, i] += step_w

    # Closed loop: [joint, interval average, torque in effect, block, delay line].
    average = sampling == "average"
    nx, latency = int(block["nx"]), int(block["latency"])
    in_effect = n + average
    first = in_effect + 1
    line = first + nx
    size = line + latency
    inputs = np.zeros((NW, size))
    if average:
        inputs[TORQUE, n] = 1.0
    else:
        inputs[TORQUE, :n] = joint.seen
    inputs[IN_EFFECT, in_effect] = inputs[VELOCITY, 1] = 1.0
    if uses_position:
        inputs[POSITION, 2] = 1.0
    command = block["D"] @ inputs
    command[first:line] += block["C"][:nx]
    effect = np.eye(size)[line + latency - 1] if latency else command

    A, B = np.zeros((size, size)), np.zeros((size, intervals))
    A[:n, :n], B[:n] = X, W
    A[:n] += np.outer(U, effect)
    if average:
        A[n, :n], B[n] = mean / period, mean_w / period
        A[n] += mean_u / period * effect
    A[in_effect] = effect
    A[first:line] = block["B"][:nx] @ inputs
    A[first:line, first:line] += block["A"][:nx, :nx]
    if latency:
        A[line] = command
        A[line + 1 :, line:-1] = np.eye(latency - 1)
    C = np.zeros((intervals, size))
    C[:, :n] = energy
    C += np.outer(energy_u, effect)
    return Port(A, B, C, D, period)
