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

from dashpot.certify.joint import SampledJoint, scaled
from dashpot.support.arrays import Floats


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


@dataclass(frozen=True)
class OnePeriod:
    """What a joint does between two ticks, scaled: ``Y(h) = flow Y(0) + B w``, ``p = energy Y(0) + D w``."""

    flow: Floats
    B: Floats
    energy: Floats
    D: Floats


def one_period(joint: SampledJoint, intervals: int) -> OnePeriod:
    """Integrates a joint over one period from just after a tick, w constant on N sub-intervals."""
    F, b, t, jump = scaled(joint)
    n, size, N = len(F), len(jump), intervals
    # Over one sub-interval: state, and the integral of the transmitted torque.
    full = np.zeros((n + 2, n + 2))
    full[:n, :n], full[:n, n], full[n + 1, :n], full[n + 1, n] = F, b, t, joint.torque_w
    exact = expm(full * (joint.period / N))
    step, torque, torque_w = exact[:n, :n], exact[n + 1, :n], exact[n + 1, n]
    powers = np.empty((N + 1, n, n))
    powers[0] = np.eye(n)
    for i in range(N):
        powers[i + 1] = step @ powers[i]
    moved = powers[:N] @ exact[:n, n]  # (N, n): effect of a velocity i sub-intervals ago
    flow, B, energy = np.eye(size), np.zeros((size, N)), np.zeros((N, size))
    flow[:n, :n], B[:n], energy[:, :n] = powers[N], moved[::-1].T, -torque @ powers[:N]
    lag = np.subtract.outer(np.arange(N), np.arange(N))
    response = np.concatenate([[-torque_w], -(moved @ torque)])
    return OnePeriod(flow, B, energy, np.where(lag >= 0, response[np.clip(lag, 0, N)], 0.0))


def lift(joint: SampledJoint, intervals: int) -> Port:
    """Lifts a joint over one period.

    Args:
        joint: See `dashpot.certify.joint.sampled_joint`.
        intervals: N.
    """
    period, jump = one_period(joint, intervals), scaled(joint)[3]
    return Port(period.flow @ jump, period.B, period.energy @ jump, period.D, joint.period)


def without_equilibria(port: Port, shape: Floats, momentum: Floats) -> Port:
    """Takes a position loop's pole at z = 1 out: its Hermitian part on the circle is minus half its residue.

    Args:
        port: With the pole.
        shape: Its right eigenvector, see `dashpot.certify.exact.Rest`.
        momentum: Its left eigenvector.

    Returns:
        A port with the same damping at every frequency, accurate at low ones, too.
    """
    pole = np.outer(shape, momentum) / (momentum @ shape)
    rest = np.eye(len(shape)) - pole
    D = port.D - port.C @ pole @ port.B / 2
    return Port(rest @ port.A, rest @ port.B, port.C @ rest, D, port.period)
