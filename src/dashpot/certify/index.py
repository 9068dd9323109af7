"""Passivity index of a port: a frequency grid, and an exact test that nothing hides between its points."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eig, eigvals

from dashpot.certify.port import Port, lift
from dashpot.drive import Drive
from dashpot.sampled import Floats

FIRST_INTERVALS, MOST_INTERVALS = 8, 64
SETTLED = 0.01  # relative change of the index between N and 2 N
CIRCLE = 1e-6  # distance from the unit circle within which an eigenvalue may lie on it
RELATIVE, ROUNDS = 1e-4, 30
GRID = np.concatenate([np.geomspace(1e-4, 0.05, 40), np.linspace(0.05, np.pi, 120)[1:]])


@dataclass(frozen=True)
class Index:
    """Passivity index: the joint's surplus of damping at its port.

    Attributes:
        value: ``min over w of lambda_min((G + G^H)/2) N/h`` [N m s/rad]; -inf: the joint itself is unstable
            or has a pole on the unit circle that no passive port has.
        frequency: Where it is attained [Hz].
        intervals: N used.
        remainder: Change of the index from N/2 to N, an estimate of what is left [N m s/rad].
        decided: Whether grid and exact test agree; if not, ``value`` is an upper bound only.
        reason: In words, where ``value`` is not a finite, decided number.
    """

    value: float
    frequency: float
    intervals: int
    remainder: float
    decided: bool
    reason: str = ""

    @property
    def passive(self) -> bool:
        """Whether the port is certainly passive."""
        return self.decided and self.value > 0 and self.remainder < self.value


def hermitian_minimum(port: Port, omega: Floats) -> Floats:
    """Smallest eigenvalue of ``(G + G^H)/2`` in damping units at angles omega (...,): (...) [N m s/rad]."""
    G = port.response(omega)
    H = (G + np.conj(np.swapaxes(G, -1, -2))) / 2
    return np.asarray(np.linalg.eigvalsh(H)[..., 0] * port.scale, float)


def without_integrator(port: Port) -> tuple[Port | None, str]:
    """Takes the position loop's pole at z = 1 out: its real part on the circle is the constant -K0/2.

    Returns:
        A port with the same Hermitian part on the unit circle and only stable poles, or None and why not.
    """
    values, left, right = eig(port.A, left=True, right=True)
    at_one = np.abs(values - 1) < 1e-7
    if np.abs(values[~at_one]).max(initial=0.0) >= 1 - 1e-10:
        return None, "the joint with its link held is unstable"
    if not at_one.any():
        return port, ""
    if at_one.sum() > 1:
        return None, "more than one pole at z = 1"
    r, q = right[:, at_one].real[:, 0], left[:, at_one].real[:, 0]
    if abs(q @ r) < 1e-12:
        return None, "the pole at z = 1 is not simple"
    projector = np.outer(r, q) / (q @ r)
    residue = port.C @ projector @ port.B
    size = np.abs(residue).max()
    if np.abs(residue - residue.T).max() > 1e-6 * size or np.linalg.eigvalsh(residue)[0] < -1e-6 * size:
        return None, "the residue of the pole at z = 1 is not positive semidefinite"
    keep = np.eye(len(port.A)) - projector
    return Port(keep @ port.A, keep @ port.B, port.C @ keep, port.D - residue / 2, port.period), ""


def crossings(port: Port, level: float) -> Floats:
    """Angles in [0, pi] at which some eigenvalue of ``(G + G^H)/2`` may equal a level [N m s/rad].

    They are the unit-circle eigenvalues of the extended symplectic pencil of ``G + G^~ - 2 level``;
    eigenvalues within `CIRCLE` of it are counted in.
    """
    n, N = len(port.A), port.intervals
    E, F = np.zeros((2 * n + N, 2 * n + N)), np.zeros((2 * n + N, 2 * n + N))
    E[:n, :n] = np.eye(n)
    E[n : 2 * n, n : 2 * n], E[n : 2 * n, 2 * n :] = port.A.T, port.C.T
    F[:n, :n], F[:n, 2 * n :] = port.A, port.B
    F[n : 2 * n, n : 2 * n] = np.eye(n)
    F[2 * n :, :n], F[2 * n :, n : 2 * n] = port.C, port.B.T
    F[2 * n :, 2 * n :] = port.D + port.D.T - 2 * level / port.scale * np.eye(N)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # infinite eigenvalues divide by zero
        z = eigvals(F, E)
    z = z[np.isfinite(z)]
    on_circle = z[np.abs(np.abs(z) - 1) < CIRCLE]
    return np.unique(np.abs(np.angle(on_circle)))


def minimum(port: Port) -> tuple[float, float, bool]:
    """Smallest ``lambda_min((G + G^H)/2)`` of a stable port over all frequencies.

    A grid gives an upper bound; at a level just below it the pencil must have no crossing. Where it has, the
    midpoints between crossings are tried, which finds the dip, and the level drops (after Bruinsma and
    Steinbuch).

    Returns:
        (value [N m s/rad], angle [rad per period], decided).
    """
    values = hermitian_minimum(port, GRID)
    best, angle = float(values.min()), float(GRID[values.argmin()])
    for _ in range(ROUNDS):
        level = best - RELATIVE * max(abs(best), 1e-3 * port.scale * np.abs(port.D).max())
        found = crossings(port, level)
        if not len(found):
            return best, angle, True
        edges = np.concatenate([[0.0], found, [np.pi]])
        tried = np.concatenate([(edges[1:] + edges[:-1]) / 2, found])
        values = hermitian_minimum(port, np.clip(tried, 1e-6, np.pi))
        if values.min() >= level:
            # Tangent or spurious: no point lies below the level, yet the pencil touches the circle.
            return best, angle, False
        best, angle = float(values.min()), float(tried[values.argmin()])
    return best, angle, False


def passivity_index(drive: Drive, block: NDArray[np.void], sampling: str, period: float) -> Index:
    """Index of a sampled joint; N is doubled until it settles.

    Args:
        drive: The joint's drive.
        block: Its controller, a record of `dashpot.sampled.BLOCK_DTYPE`.
        sampling: "average" or "point".
        period: [s].
    """
    before, intervals = np.nan, FIRST_INTERVALS
    while True:
        port, reason = without_integrator(lift(drive, block, sampling, period, intervals))
        if port is None:
            return Index(-np.inf, 0.0, intervals, 0.0, True, reason)
        value, angle, decided = minimum(port)
        change = abs(value - before)
        if change <= SETTLED * abs(value) or 2 * intervals > MOST_INTERVALS:
            reason = "" if decided else "the exact test cannot exclude a lower value"
            return Index(value, angle / (2 * np.pi * period), intervals, float(change), decided, reason)
        before, intervals = value, 2 * intervals
