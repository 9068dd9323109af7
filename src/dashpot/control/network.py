"""The general virtual passive controller of section III: a mechanical network simulated on a computer.

A controller whose equations are those of masses, dampers and springs hung on the actuators cannot give out
more energy than it was handed. `VirtualNetwork` is that network; `dashpot.control.law` is the one instance
the paper builds on torque sensors. Everything is SI and link side.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dashpot.errors import InputError

Array = NDArray[np.float64]

_TOLERANCE = 1e-12  # relative to the largest entry: what rounding may do to a symmetric semidefinite matrix


def as_matrix(name: str, value: ArrayLike, n: int | None = None) -> Array:
    """A read-only square float matrix from a scalar, a diagonal or a matrix.

    Args:
        name: How errors call the matrix.
        value: A scalar (times the identity), shape (n,) (a diagonal), or shape (n, n).
        n: Number of rows wanted; None accepts any.

    Raises:
        InputError: The value is not finite or has another shape.
    """
    a = np.array(value, dtype=np.float64)
    if a.ndim == 0:
        a = np.full(1 if n is None else n, a)
    if a.ndim == 1:
        a = np.diag(a)
    if a.ndim != 2 or a.shape[0] != a.shape[1] or n not in (None, a.shape[0]):
        wanted = "(n, n)" if n is None else f"({n}, {n}) or ({n},)"
        raise InputError(f"must have shape {wanted}", quantity=f"{name}.shape", value=np.shape(value))
    if not np.isfinite(a).all():
        raise InputError("must be finite", quantity=name, value=a.tolist())
    a.setflags(write=False)
    return a


def check_symmetric(name: str, matrix: Array, *, definite: bool = False) -> None:
    """Refuse a matrix that is not symmetric and positive semidefinite (or definite).

    Raises:
        InputError: Names the matrix and the entry that breaks symmetry, or its smallest eigenvalue.
    """
    scale = float(np.abs(matrix).max(initial=0.0))
    skew = np.abs(matrix - matrix.T)
    if skew.max(initial=0.0) > _TOLERANCE * scale:
        i, j = np.unravel_index(int(skew.argmax()), skew.shape)
        pair = f"{name}[{i},{j}] = {matrix[i, j]:g}, {name}[{j},{i}] = {matrix[j, i]:g}"
        raise InputError(f"must be symmetric ({pair})", quantity=name)
    smallest = float(np.linalg.eigvalsh(matrix)[0])
    bad = smallest <= _TOLERANCE * scale if definite else smallest < -_TOLERANCE * scale
    if bad:
        rule = "must be positive " + ("definite" if definite else "semidefinite")
        raise InputError(rule, quantity=f"smallest eigenvalue of {name}", value=smallest)


@dataclass(frozen=True, eq=False, init=False)
class VirtualNetwork:
    """A passive mechanical network between n actuator coordinates x_a and n_c virtual ones x_c.

    With x = (x_a, x_c) the network obeys

        [-u; 0] = M x'' + D x' + K x,

    where u (n,) [N m] is what the network applies to the actuators. The upper rows are Eq. (10), the lower
    rows the controller state equation that (16) asks for. M and K are symmetric positive semidefinite; D has
    a positive semidefinite symmetric part and may have a skew (gyroscopic) part, which stores and dissipates
    nothing. Then

        S = 1/2 x'^T M x' + 1/2 x^T K x,    S' = -u^T x_a' - x'^T D x' <= -u^T x_a'.

    Args:
        M: Inertia [kg m^2], shape (n + n_c, n + n_c).
        D: Damping [N m s/rad], same shape.
        K: Stiffness [N m/rad], same shape.
        n: Number of actuator coordinates, listed first.

    Raises:
        InputError: A matrix has the wrong shape or is not symmetric or semidefinite (its name and smallest
            eigenvalue are given), or a virtual coordinate carries no inertia, damping or stiffness at all.
    """

    M: Array
    D: Array
    K: Array
    n: int

    def __init__(self, M: ArrayLike, D: ArrayLike, K: ArrayLike, n: int) -> None:
        size = len(as_matrix("M", M))
        for name, matrix in (("M", M), ("D", D), ("K", K)):
            object.__setattr__(self, name, as_matrix(name, matrix, size))
        object.__setattr__(self, "n", n)
        check_symmetric("M", self.M)
        check_symmetric("sym(D)", (self.D + self.D.T) / 2)
        check_symmetric("K", self.K)
        if not 0 < n <= size:
            raise InputError(f"must lie between 1 and {size}", quantity="n", value=n)
        # With psd parts, the virtual block of M s^2 + D s + K is singular for no s > 0 or for all of them.
        c = slice(n, None)
        virtual = (self.M + self.D + self.K)[c, c]
        if self.n_c and np.linalg.matrix_rank(virtual) < self.n_c:
            raise InputError(
                "every virtual coordinate needs inertia, damping or stiffness", quantity="M, D, K"
            )

    @classmethod
    def from_feedback(
        cls,
        mass: ArrayLike,
        damping: ArrayLike,
        stiffness: ArrayLike,
        *,
        displacement: ArrayLike = 0.0,
        velocity: ArrayLike = 0.0,
        acceleration: ArrayLike = 0.0,
    ) -> VirtualNetwork:
        """A grounded virtual mass-damper-spring coupled to each actuator: the constructions Juang lists.

        Displacement feedback couples x_a to x_c by a spring K_f, velocity feedback by a dashpot D_f,
        acceleration feedback by an inerter M_f; any of them may be combined:

            -u = M_f e'' + D_f e' + K_f e,    e = x_a - x_c,
            mass x_c'' + damping x_c' + stiffness x_c = -u.

        Sign of x_c: here it is a displacement in the direction of x_a, so the coupling sees x_a - x_c. The
        paper's (A1) stores energy in x_a' + x_c': its x_c is minus this one, which changes neither u nor the
        storage.

        Args:
            mass: Virtual inertia [kg m^2]; like all arguments a scalar, a diagonal (n,) or a matrix (n, n).
            damping: Damper from the virtual mass to ground [N m s/rad].
            stiffness: Spring from the virtual mass to ground [N m/rad].
            displacement: Coupling spring K_f [N m/rad].
            velocity: Coupling dashpot D_f [N m s/rad].
            acceleration: Coupling inerter M_f [kg m^2].

        Raises:
            InputError: A matrix is not symmetric positive semidefinite, or shapes do not agree.
        """
        given = {"mass": mass, "damping": damping, "stiffness": stiffness}
        given |= {"displacement": displacement, "velocity": velocity, "acceleration": acceleration}
        n = max((np.shape(value)[0] for value in given.values() if np.ndim(value)), default=1)
        part = {name: as_matrix(name, value, n) for name, value in given.items()}
        for name, matrix in part.items():
            check_symmetric(name, matrix)

        def join(ground: Array, coupling: Array) -> Array:
            return np.block([[coupling, -coupling], [-coupling, ground + coupling]])

        return cls(
            M=join(part["mass"], part["acceleration"]),
            D=join(part["damping"], part["velocity"]),
            K=join(part["stiffness"], part["displacement"]),
            n=n,
        )

    @property
    def n_c(self) -> int:
        """Number of virtual coordinates."""
        return len(self.M) - self.n

    @property
    def H_M(self) -> Array:
        """Controller mass matrix of Eq. (10), -M_ac, shape (n, n_c) [kg m^2]."""
        return -self.M[: self.n, self.n :]

    @property
    def H_D(self) -> Array:
        """Controller damping matrix of Eq. (10), -D_ac, shape (n, n_c) [N m s/rad]."""
        return -self.D[: self.n, self.n :]

    @property
    def H_K(self) -> Array:
        """Controller stiffness matrix of Eq. (10), -K_ac, shape (n, n_c) [N m/rad]."""
        return -self.K[: self.n, self.n :]

    def g(self, xa: ArrayLike, xa_dot: ArrayLike, xa_ddot: ArrayLike) -> Array:
        """Direct term g(y_s) = -(M_aa x_a'' + D_aa x_a' + K_aa x_a) of Eq. (10), shape (..., n) [N m]."""
        a = slice(None, self.n)
        xa, xa_dot, xa_ddot = (np.asarray(x, dtype=np.float64) for x in (xa, xa_dot, xa_ddot))
        direct = xa_ddot @ self.M[a, a].T + xa_dot @ self.D[a, a].T + xa @ self.K[a, a].T
        return np.asarray(-direct)

    def xc_acceleration(
        self, xa: ArrayLike, xa_dot: ArrayLike, xa_ddot: ArrayLike, xc: ArrayLike, xc_dot: ArrayLike
    ) -> Array:
        """x_c'' from the lower rows, M_cc x_c'' = -(M_ca x_a'' + D_c x' + K_c x), shape (..., n_c) [rad/s^2].

        Raises:
            InputError: M_cc is singular: some x_c has no inertia, so its rate, not its acceleration, is
                determined.
        """
        c = slice(self.n, None)
        M_cc = self.M[c, c]
        if np.linalg.matrix_rank(M_cc) < self.n_c:
            raise InputError(
                "M_cc must be nonsingular for x_c'' to exist", quantity="M_cc", value=M_cc.tolist()
            )
        force = np.asarray(xa_ddot) @ self.M[c, : self.n].T
        force = force + _join(xa_dot, xc_dot) @ self.D[c].T + _join(xa, xc) @ self.K[c].T
        return np.asarray(-force @ np.linalg.inv(M_cc).T)

    def output(
        self, xa: ArrayLike, xa_dot: ArrayLike, xa_ddot: ArrayLike, xc: ArrayLike, xc_dot: ArrayLike
    ) -> Array:
        """u = H_M x_c'' + H_D x_c' + H_K x_c + g, Eq. (10), shape (..., n) [N m].

        Args:
            xa: Actuator coordinates [rad], shape (..., n).
            xa_dot: Their rates [rad/s].
            xa_ddot: Their accelerations [rad/s^2].
            xc: Virtual coordinates [rad], shape (..., n_c).
            xc_dot: Their rates [rad/s].

        Raises:
            InputError: M_cc is singular although x_c'' acts on u.
        """
        u = self.g(xa, xa_dot, xa_ddot) + np.asarray(xc_dot) @ self.H_D.T + np.asarray(xc) @ self.H_K.T
        if self.H_M.any():
            u = u + self.xc_acceleration(xa, xa_dot, xa_ddot, xc, xc_dot) @ self.H_M.T
        return np.asarray(u)

    def storage(self, xa: ArrayLike, xa_dot: ArrayLike, xc: ArrayLike, xc_dot: ArrayLike) -> Array:
        """Stored energy S = 1/2 x'^T M x' + 1/2 x^T K x, shape (...) [J]: the q of Eq. (12)."""
        return 0.5 * (_form(self.M, _join(xa_dot, xc_dot)) + _form(self.K, _join(xa, xc)))

    def dissipation(self, xa_dot: ArrayLike, xc_dot: ArrayLike) -> Array:
        """Power lost in the dampers, x'^T sym(D) x' >= 0, shape (...) [W]."""
        return _form(self.D, _join(xa_dot, xc_dot))

    def storage_rate(self, u: ArrayLike, xa_dot: ArrayLike, xc_dot: ArrayLike) -> Array:
        """S' = -u^T x_a' - x'^T sym(D) x', shape (...) [W]; added to T' = u^T x_a' (11) it gives Eq. (15)."""
        return np.asarray(-(np.asarray(u) * np.asarray(xa_dot)).sum(-1) - self.dissipation(xa_dot, xc_dot))

    def impedance(self, s: ArrayLike) -> NDArray[np.complex128]:
        """Driving-point impedance Z(s), u = -Z(s) x_a' [N m s/rad], positive real.

        With P(s) = M s^2 + D s + K, Z = (P_aa - P_ac P_cc^-1 P_ca) / s.

        Args:
            s: Complex frequency [1/s], any shape, not 0 (a held spring makes Z infinite there) and not a
                pole.

        Returns:
            Shape (*s.shape, n, n).

        Raises:
            InputError: s contains 0.
        """
        s = np.asarray(s, dtype=np.complex128)[..., None, None]
        if (s == 0).any():
            raise InputError("must not be zero", quantity="s [1/s]", value=0)
        P = self.M * s**2 + self.D * s + self.K
        a, c = slice(None, self.n), slice(self.n, None)
        return np.asarray((P[..., a, a] - P[..., a, c] @ np.linalg.solve(P[..., c, c], P[..., c, a])) / s)


def _join(a: ArrayLike, c: ArrayLike) -> Array:
    a, c = np.asarray(a, dtype=np.float64), np.asarray(c, dtype=np.float64)
    many = np.broadcast_shapes(a.shape[:-1], c.shape[:-1])
    parts = [np.broadcast_to(x, (*many, x.shape[-1])) for x in (a, c)]
    return np.concatenate(parts, axis=-1)


def _form(matrix: Array, x: Array) -> Array:
    return np.asarray(np.einsum("...i,ij,...j->...", x, matrix, x))
