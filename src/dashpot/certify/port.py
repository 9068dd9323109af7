"""The port of a sampled joint: link velocity in, reaction energy out, lifted exactly over one period.

The link velocity w is constant on N sub-intervals of a period; ``p_i`` is minus the integral of the
transmitted torque over sub-interval i, so that ``sum p_i w_i`` is the energy put into the joint in that
period, exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from dashpot.certify.joint import SampledJoint
from dashpot.sampled import Floats


@dataclass(frozen=True)
class Port:
    """A lifted joint over one period, ``x+ = A x + B w``, ``p = C x + D w``; x is the state before a tick.

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

    def least_damping(self, omega: Floats) -> Floats:
        """Smallest eigenvalue of ``(G + G^H)/2`` in damping units at angles (...,): (...) [N m s/rad]."""
        G = self.response(omega)
        H = (G + np.conj(np.swapaxes(G, -1, -2))) / 2
        return np.asarray(np.linalg.eigvalsh(H)[..., 0] * self.scale, float)


def lift(joint: SampledJoint, intervals: int) -> Port:
    """Lifts a joint over one period.

    Args:
        joint: See `dashpot.certify.joint.sampled_joint`.
        intervals: N.
    """
    n, size, N = len(joint.flow), len(joint.jump), intervals
    units = joint.units
    # Over one sub-interval, scaled: state, and the integral of the transmitted torque.
    full = np.zeros((n + 2, n + 2))
    full[:n, :n] = joint.flow * units[:n] / units[:n, None]
    full[:n, n] = joint.velocity_in / units[:n]
    full[n + 1, :n], full[n + 1, n] = joint.torque * units[:n], joint.torque_w
    exact = expm(full * (joint.period / N))
    step, step_w = exact[:n, :n], exact[:n, n]
    torque, torque_w = exact[n + 1, :n], exact[n + 1, n]

    powers = np.empty((N + 1, n, n))  # of the sub-interval's transition
    powers[0] = np.eye(n)
    for i in range(N):
        powers[i + 1] = step @ powers[i]
    moved = powers[:N] @ step_w  # (N, n): effect of a velocity i sub-intervals ago
    flow = np.eye(size)
    flow[:n, :n] = powers[N]
    B = np.zeros((size, N))
    B[:n] = moved[::-1].T
    energy = np.zeros((N, size))
    energy[:, :n] = -torque @ powers[:N]
    lag = np.subtract.outer(np.arange(N), np.arange(N))
    response = np.concatenate([[-torque_w], -(moved @ torque)])
    D = np.where(lag >= 0, response[np.clip(lag, 0, N)], 0.0)
    jump = joint.jump * units / units[:, None]
    return Port(flow @ jump, B, energy @ jump, D, joint.period)
