"""The virtual passive law with torque sensing in continuous time, Eqs. (17)-(21) and appendix A.

The law simulates, behind each joint, a second rotor R times as heavy, coupled so that it soaks up the
joint's energy: in mechanical terms an inerter R m between the joint and a virtual massless node, a damper D
and a spring K from that node to ground, a damper R v on the joint and a gyrator R v between the two.
Sampling, delay and elasticity are left to `dashpot.control.sampled` and `dashpot.certify`. Everything is SI
and link side.

Corrections to the printed equations used throughout (proved one by one in tests/test_law_symbolic.py): (A1)
and (A3) carry R where K_tau is printed; tau_x is a column; R is diagonal; (A8) needs 0 < K_tau < 1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dashpot.control.network import Array, VirtualNetwork, as_matrix, check_symmetric
from dashpot.errors import InputError

Complex = NDArray[np.complex128]


@dataclass(frozen=True, eq=False, init=False)
class TorqueFeedbackLaw:
    """The law of Eqs. (20)-(21) for n joints.

        R m x_c'' + D x_c' + K x_c = R (tau_x - u'),    u = (R v + D) x_c' + K x_c,

    with tau_x = tau_s + f the sensed torque plus the rotor's coupling term and u' the motor torque in effect.

    A scalar applies to every joint. D and K may couple joints; R may not: (A10) needs R m and R v symmetric,
    which leaves only a diagonal R unless two joints share one ratio m/v.

    Args:
        m: Rotor inertia [kg m^2], shape (n,), positive.
        v: Viscous friction [N m s/rad], shape (n,), not negative.
        R: Torque gain R_tau [-], shape (n,), positive.
        D: Virtual damping D_c [N m s/rad], shape (n,) or (n, n), symmetric positive definite.
        K: Virtual stiffness K_c [N m/rad], shape (n,) or (n, n), symmetric positive semidefinite.

    Raises:
        InputError: A value breaks its rule; joints are counted from 1, matrices named with their smallest
            eigenvalue.
    """

    m: Array
    v: Array
    R: Array
    D: Array
    K: Array

    def __init__(self, m: ArrayLike, v: ArrayLike, R: ArrayLike, D: ArrayLike, K: ArrayLike) -> None:
        n = max(np.shape(np.atleast_1d(value))[0] for value in (m, v, R, D, K))
        for name, vector, positive in (("m", m, True), ("v", v, False), ("R", R, True)):
            object.__setattr__(self, name, _vector(name, vector, n, positive=positive))
        for name, gain, definite in (("D", D, True), ("K", K, False)):
            if np.ndim(gain) < 2:
                value = _vector(name, gain, n, positive=definite)
            else:
                value = as_matrix(name, gain, n)
                check_symmetric(name, value, definite=definite)
            object.__setattr__(self, name, value)

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.m)

    @property
    def decoupled(self) -> bool:
        """Whether D and K were both given as (n,): then Z and C are (n,) too."""
        return self.D.ndim == self.K.ndim == 1

    @property
    def K_tau(self) -> Array:
        """K_tau = R / (1 + R) of (A8), shape (n,) [-]; for K > 0 the static gain u/tau_x."""
        return K_tau_from_R(self.R)

    @property
    def a(self) -> Array:
        """Output gain on x_c', R v + D of Eq. (21), shape (n, n) [N m s/rad]."""
        return np.diag(self.R * self.v) + as_matrix("D", self.D, self.n)

    def network(self) -> VirtualNetwork:
        """The law as a `VirtualNetwork`: Eqs. (A9) and (A13) with x_a the joint angles."""
        RM, RV = np.diag(self.R * self.m), np.diag(self.R * self.v)
        D, K = as_matrix("D", self.D, self.n), as_matrix("K", self.K, self.n)
        zero = np.zeros_like(K)
        return VirtualNetwork(
            M=np.block([[RM, RM], [RM, RM]]),
            D=np.block([[RV, -RV], [RV, D]]),
            K=np.block([[zero, zero], [zero, K]]),
            n=self.n,
        )

    def state_space_tau(self) -> tuple[Array, Array, Array, Array]:
        """Eqs. (20)-(21) as (A, B, C, D): states [x_c, x_c'], inputs [tau_x, u'], output u.

        Returns:
            Shapes (2n, 2n), (2n, 2n), (n, 2n), (n, 2n); states in rad and rad/s, inputs and output in N m.
        """
        n, one, zero = self.n, np.eye(self.n), np.zeros((self.n, self.n))
        D, K = as_matrix("D", self.D, n), as_matrix("K", self.K, n)
        per_Rm, per_m = np.diag(1 / (self.R * self.m)), np.diag(1 / self.m)
        A = np.block([[zero, one], [-per_Rm @ K, -per_Rm @ D]])
        B = np.block([[zero, zero], [per_m, -per_m]])
        return A, B, np.hstack([K, self.a]), np.zeros((n, 2 * n))

    def Z(self, s: ArrayLike) -> Complex:
        """Impedance of the law, u = -Z(s) theta' [N m s/rad]; positive real.

        Per joint Z = R (m s + v)(a s + K) / (R m s^2 + D s + K) with a = R v + D. Z(0) is R v for K > 0
        and R v a/D for K = 0; Z(inf) = a. The joint as its load meets it has the impedance m s + v + Z(s).

        Args:
            s: Complex frequency [1/s], any shape; 0 is allowed, poles are not.

        Returns:
            Shape (*s.shape, n) if `decoupled`, else (*s.shape, n, n).
        """
        s = np.asarray(s, dtype=np.complex128)[..., None, None]
        return self._respond(s, np.diag(self.R) @ (np.diag(self.m) * s + np.diag(self.v)), np.zeros(self.n))

    def C(self, s: ArrayLike) -> Complex:
        """Torque feedback u = C(s) tau_x [-] that remains when u' = u is eliminated.

        Per joint C = R (a s + K) / (R m s^2 + (D + R a) s + (1 + R) K): positive feedback below unity. C(0)
        is K_tau for K > 0 and R a/(D + R a) for K = 0.

        Args:
            s: Complex frequency [1/s], any shape; 0 is allowed, poles are not.

        Returns:
            Shape (*s.shape, n) if `decoupled`, else (*s.shape, n, n).
        """
        s = np.asarray(s, dtype=np.complex128)[..., None, None]
        return self._respond(s, np.diag(self.R) + 0 * s, self.R)

    def _respond(self, s: Complex, drive: Complex, feedback: Array) -> Complex:
        """u from R m w' + D w + L y = drive - feedback u, y' = L^T w, u = a w + L y, with K = L L^T.

        The spring force L y replaces x_c as a state: L has full column rank, so s = 0 is no singular case.
        """
        values, vectors = np.linalg.eigh(as_matrix("K", self.K, self.n))
        stiff = values > (0.0 if self.K.ndim == 1 else self.n * np.finfo(float).eps * abs(values[-1]))
        L = vectors[:, stiff] * np.sqrt(values[stiff])
        F, r = np.diag(feedback), L.shape[1]
        system = np.zeros((*s.shape[:-2], self.n + r, self.n + r), dtype=np.complex128)
        inertia = np.diag(self.R * self.m)
        system[..., : self.n, : self.n] = inertia * s + as_matrix("D", self.D, self.n) + F @ self.a
        system[..., : self.n, self.n :] = L + F @ L
        system[..., self.n :, : self.n] = -L.T
        system[..., self.n :, self.n :] = np.eye(r) * s
        right = np.zeros((*s.shape[:-2], self.n + r, self.n), dtype=np.complex128)
        right[..., : self.n, :] = drive
        u = np.hstack([self.a, L]) @ np.linalg.solve(system, right)
        return np.asarray(np.diagonal(u, axis1=-2, axis2=-1) if self.decoupled else u)

    def lyapunov(
        self, theta_dot: ArrayLike, xc: ArrayLike, xc_dot: ArrayLike, kinetic: ArrayLike = 0.0
    ) -> Array:
        """L = T + 1/2 (theta' + x_c')^T R m (theta' + x_c') + 1/2 x_c^T K x_c, (A1) corrected [J].

        Args:
            theta_dot: Joint velocities [rad/s], shape (..., n).
            xc: Controller states [rad], shape (..., n).
            xc_dot: Their rates [rad/s], shape (..., n).
            kinetic: Kinetic energy T of the arm with its rotors [J], shape (...); add its potential energy
                too where gravity acts, which Eq. (11) forgets.

        Returns:
            Shape (...).
        """
        net, still = self.network(), np.zeros(self.n)
        return np.asarray(kinetic) + net.storage(still, theta_dot, xc, xc_dot)

    def lyapunov_rate(self, theta_dot: ArrayLike, xc_dot: ArrayLike) -> Array:
        """dL/dt = -theta'^T R v theta' - x_c'^T D x_c' <= 0, (A14), shape (...) [W].

        The arm's own friction, left out of Eq. (11), comes on top and only helps. Zero does not mean rest: at
        theta' = x_c' = 0 with x_c != 0 the rate vanishes, and only LaSalle's principle carries on from there.
        """
        return -self.network().dissipation(theta_dot, xc_dot)


def _vector(name: str, value: ArrayLike, n: int, *, positive: bool) -> Array:
    a = np.array(value, dtype=np.float64)
    if a.ndim == 0:
        a = np.full(n, a)
    if a.shape != (n,):
        raise InputError(f"must have shape ({n},)", quantity=f"{name}.shape", value=a.shape)
    for i, x in enumerate(a.tolist(), start=1):
        _check(name, x, positive=positive, joint=str(i))
    a.setflags(write=False)
    return a


def _check(name: str, value: float, *, positive: bool, joint: str | None = None) -> float:
    value = float(value)
    if not math.isfinite(value) or value < 0 or (positive and value == 0):
        rule = "must be positive and finite" if positive else "must not be negative and must be finite"
        raise InputError(rule, joint=joint, quantity=name, value=value)
    return value


def R_from_K_tau(K_tau: ArrayLike) -> Array:
    """R = K_tau / (1 - K_tau), (A8) [-].

    Raises:
        InputError: K_tau is not strictly between 0 and 1; only there is R positive and finite.
    """
    K = np.asarray(K_tau, dtype=np.float64)
    for x in np.ravel(K).tolist():
        if not 0 < x < 1:
            raise InputError("must lie strictly between 0 and 1", quantity="K_tau [-]", value=x)
    return np.asarray(K / (1 - K))


def K_tau_from_R(R: ArrayLike) -> Array:
    """K_tau = R / (1 + R), the inverse of (A8) [-].

    Raises:
        InputError: R is not positive.
    """
    R = np.asarray(R, dtype=np.float64)
    for x in np.ravel(R).tolist():
        _check("R [-]", x, positive=True)
    return np.asarray(R / (1 + R))


def static_R(R: float, D: float, K: float, v: float) -> float:
    """The R that counts at standstill, C(0)/(1 - C(0)) [-]: R for K > 0, R (R v + D)/D >= R for K = 0."""
    return R if K > 0 else R * (R * v + D) / D


def creep_rate(tau_g: float, R: float, v: float) -> float:
    """Steady velocity tau_g / ((1 + R) v) under a constant load torque tau_g [N m], in rad/s.

    Holds for K > 0; for K = 0 pass `static_R` for R.

    Raises:
        InputError: R < 0 or v <= 0: without friction there is no steady creep, the joint accelerates.
    """
    return tau_g / ((1 + _check("R [-]", R, positive=False)) * _check("v [N m s/rad]", v, positive=True))


def hold_torque(tau_c: float, R: float) -> float:
    """Largest load (1 + R) tau_c that Coulomb friction tau_c still holds at rest [N m].

    Holds for K > 0; for K = 0 pass `static_R` for R.
    """
    return (1 + _check("R [-]", R, positive=False)) * _check("tau_c [N m]", tau_c, positive=False)


def bias_drift(b: float, R: float, v: float) -> float:
    """Velocity K_tau b / v at which a torque-sensor bias b [N m] drives a free joint, in rad/s.

    Holds for K > 0; for K = 0 pass `static_R` for R.
    """
    return R / (1 + _check("R [-]", R, positive=False)) * b / _check("v [N m s/rad]", v, positive=True)


def positive_real_margin(
    m: float, v: float, m_hat: float, v_hat: float, R: float, D: float, K: float
) -> float:
    """The least Re Z(jw) over all frequencies [N m s/rad] when the gains are built on m_hat, v_hat.

    The sensed net torque is the true one, so Z = R (m s + v)(a s + K) / (R m_hat s^2 + D s + K) with
    a = R v_hat + D. A margin >= 0 means Z is positive real. The joint adds its own friction: it is stable
    with any passive load while the margin exceeds -v. Closed form: Re Z is a ratio of quadratics in w^2.

    Args:
        m: True rotor inertia [kg m^2].
        v: True viscous friction [N m s/rad].
        m_hat: Rotor inertia assumed by the controller [kg m^2].
        v_hat: Viscous friction assumed by the controller [N m s/rad].
        R: Torque gain [-].
        D: Virtual damping [N m s/rad].
        K: Virtual stiffness [N m/rad].

    Raises:
        InputError: m, m_hat, R or D is not positive, or v, v_hat or K is negative.
    """
    for name, x in (("m", m), ("m_hat", m_hat), ("R", R), ("D", D)):
        _check(name, x, positive=True)
    for name, x in (("v", v), ("v_hat", v_hat), ("K", K)):
        _check(name, x, positive=False)
    a = R * v_hat + D
    if K == 0:  # the virtual node is a plain damped mass: Re Z runs monotonically between its ends
        return min(R * v * a / D, m * a / m_hat)
    # Re Z = R (p2 x^2 + p1 x + p0) / (q2 x^2 + q1 x + q0), x = w^2
    p2, p1, p0 = R * m * m_hat * a, D * v * a - R * K * (m_hat * v + m * v_hat), v * K**2
    q2, q1, q0 = (R * m_hat) ** 2, D**2 - 2 * K * R * m_hat, K**2
    turning = np.roots([p2 * q1 - p1 * q2, 2 * (p2 * q0 - p0 * q2), p1 * q0 - p0 * q1])
    inside = [float(x) for x in turning[np.isreal(turning)].real if x > 0]
    values = [R * (p2 * x**2 + p1 * x + p0) / (q2 * x**2 + q1 * x + q0) for x in inside]
    return min([R * v, m * a / m_hat, *values])


def positive_real_with_model_error(
    m: float, v: float, m_hat: float, v_hat: float, R: float, D: float, K: float
) -> bool:
    """Whether Z stays positive real although the gains are built on m_hat, v_hat.

    With a = R v_hat + D it does if and only if

        R K (m_hat v + m v_hat) - D v a <= 2 K sqrt(R m m_hat v a).

    K = 0 and an exact model always pass. `positive_real_margin` gives the arguments, errors and the distance.
    """
    positive_real_margin(m, v, m_hat, v_hat, R, D, K)  # checks the arguments
    a = R * v_hat + D
    return R * K * (m_hat * v + m * v_hat) - D * v * a <= 2 * K * math.sqrt(R * m * m_hat * v * a)


def max_torque_gain_error(R: float, D: float, v: float) -> float:
    """Bound D / (R a), a = R v + D, on the torque-channel gain error e [-]; never above 1/R.

    The channel delivers (1 + e) C(s) where C(s) is meant (sensor scale times actuator scale is 1 + e, u'
    being the command). With exact m and v the joint's impedance (m s + v)/(1 - (1 + e) C) is positive real,
    hence stable with every passive load, for -1 <= e < D/(R a). Beyond it the joint is unstable with its link
    held. So the bound is sharp in continuous time, whatever m and K are; sampling and elasticity can only
    tighten it.

    Raises:
        InputError: R or D is not positive, or v is negative.
    """
    R, D = _check("R [-]", R, positive=True), _check("D [N m s/rad]", D, positive=True)
    return D / (R * (R * _check("v [N m s/rad]", v, positive=False) + D))
