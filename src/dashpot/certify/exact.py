"""Exact test of a port without sub-intervals and without a frequency grid.

``Re G >= level`` on the whole unit circle means that ``integral(-tau w - level w^2)`` is positive for every
motion of the link. The stationary motions of that form obey a Hamiltonian system between ticks; over a period

    Y(h) = A Y(0) - G y(h),     y(0) = H Y(0) + A' y(h)         (y: co-state)

and with the jump J at the ticks this is the symplectic pencil of a discrete Riccati equation with matrices
``(A J, G, J' H J)``. Its eigenvalues on the unit circle are the frequencies at which the form is singular.
Where the Riccati equation has its stabilising solution P, P is a storage function and the form is positive at
all frequencies (discrete KYP lemma, after the lifting of Bamieh and Pearson, 1992).

The matrices of one period come from a short step by doubling, which stays bounded however stiff the
transmission is; the exponential of the Hamiltonian would overflow. So does the Riccati equation's solution
(structure-preserving doubling, Chu, Fan, Lin and Wang, 2004).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.linalg.lapack import dgeev, dgesv, dggev

from dashpot.certify.joint import DEFLECTION, SPEED, SampledJoint, scaled
from dashpot.support.arrays import Floats

CIRCLE = 1e-6  # distance from the unit circle within which an eigenvalue may lie on it
SHORT = 1.2  # fastest eigenvalue times the first step: below pi/2 there is no conjugate point in it
DOUBLINGS = 40
RINGS = 0.9  # modulus above which a pole is looked around on the grid
STABLE = 1e-9  # distance of the held joint's eigenvalues from the unit circle
RESIDUAL = 1e-11  # of the Riccati equation, relative; sound solutions stay below 2e-12


@dataclass(frozen=True)
class Form:
    """The quadratic form over one period as a discrete Riccati problem, in scaled units.

    Attributes:
        A: A J, (n, n).
        G: (n, n), positive semidefinite.
        Q: J' H J, (n, n).
        power: Unit of energy [J].
        spring: The energy ``spring deflection^2 / 2`` is counted apart [J].
    """

    A: Floats
    G: Floats
    Q: Floats
    power: float
    spring: float


def _solve(a: Floats, b: Floats) -> Floats:
    """`numpy.linalg.solve` without its overhead, which is most of the time at this size."""
    return np.asarray(dgesv(a, b)[2])


def _eigenvalues(a: Floats) -> tuple[Floats, Floats]:
    """Real and imaginary parts."""
    real, imaginary, *_ = dgeev(a, compute_vl=0, compute_vr=0)
    return real, imaginary


def held(joint: SampledJoint) -> Floats:
    """Transition over one period, from tick to tick, with the link held; (size, size), scaled."""
    F, _, _, jump = scaled(joint)
    flow = np.eye(len(jump))
    flow[: len(F), : len(F)] = expm(F * joint.period)
    return np.asarray(flow @ jump)


@dataclass(frozen=True)
class Rest:
    """The joint with its link held: its stability, and the equilibria a position loop gives it.

    Attributes:
        radius: Largest modulus of an eigenvalue other than that of the equilibria.
        poles: Those eigenvalues that ring, without conjugates.
        shape: Equilibrium with the link displaced, (size,), scaled; None without a position loop.
        momentum: What it is conjugate to, (size,) [J], states scaled.
        stiffness: Of the position loop at rest, seen from the link [N m/rad].
    """

    radius: float
    poles: NDArray[np.complex128]
    shape: Floats | None = None
    momentum: Floats | None = None
    stiffness: float = 0.0


def at_rest(joint: SampledJoint) -> Rest:
    """Analyses the joint with its link held."""
    A = held(joint)
    values = np.linalg.eigvals(A).astype(complex)
    if joint.position is not None:
        at_one = int(np.abs(values - 1).argmin())
        settles = bool(abs(values[at_one] - 1) <= 1e-6)
        values = np.delete(values, at_one) if settles else values
    size = np.abs(values)
    radius, poles = float(size.max()), values[(size > RINGS) & (values.imag >= 0)]
    if joint.position is None or not settles:
        return Rest(radius, poles)
    left, sizes, right = np.linalg.svd(A - np.eye(len(A)))
    if sizes[-2] < 1e-12 * sizes[0]:
        return Rest(np.inf, poles)
    shape, momentum = right[-1], left[:, -1]
    F, b, t, jump = scaled(joint)
    after = (jump @ shape)[: len(F)]
    link = shape[joint.position] - shape[0]
    torque = float(t @ after)
    slope = float(b @ momentum[: len(F)])
    if link == 0 or slope == 0:
        return Rest(np.inf, poles)
    return Rest(radius, poles, shape, momentum * torque / slope, -torque / (link * joint.period))


def unfit(rest: Rest) -> str:
    """Why no link may hang on a joint that is not even at rest with its link held; empty where it is."""
    if not rest.radius < 1 - STABLE:
        return "the joint with its link held is unstable"
    if rest.stiffness < 0:
        return "the position loop pushes the link away"
    return ""


@dataclass(frozen=True)
class Loss:
    """Power to be subtracted from a form, ``(row Y + row_w w)^2``.

    Attributes:
        row: (n,) for the states that move between ticks.
        row_w: For the link velocity.
    """

    row: Floats
    row_w: float


def quadratic_form(joint: SampledJoint, level: float, rest: Rest, loss: Loss | None = None) -> Form | None:
    """The form ``integral(-tau w - level w^2)`` over one period, without the equilibria.

    Args:
        joint: The sampled joint.
        level: [N m s/rad], below the transmission's damping.
        rest: Of the same joint.
        loss: Power to be subtracted as well.

    Returns:
        None where the form is not even positive within one period from rest.
    """
    n, size = len(joint.flow), len(joint.jump)
    F, b, t, jump = scaled(joint)
    # Lagrangian 1/2 (weight w^2 + 2 w cross Y + Y' states Y). The rate of the spring's energy has been taken
    # out of it: with it, three large blocks of the Hamiltonian cancel where the damping is small.
    spring = t[DEFLECTION] * joint.units[DEFLECTION]
    weight, cross, states = 2 * (-joint.torque_w - level), -t, np.zeros((n, n))
    cross[DEFLECTION] = 0.0
    states[DEFLECTION, SPEED] = states[SPEED, DEFLECTION] = -t[DEFLECTION] * joint.units[SPEED]
    if loss is not None:
        row = loss.row * joint.units[:n]
        weight -= 2 * loss.row_w**2
        cross = cross - 2 * loss.row_w * row
        states -= 2 * np.outer(row, row)
    if not weight > 0:
        return None
    given = np.outer(cross, cross) / weight - states
    power = np.sqrt(np.abs(given).max() * weight) / np.abs(b).max()  # unit of energy that balances the blocks
    if not (np.isfinite(power) and power > 0):
        return None
    hamiltonian = np.empty((2 * n, 2 * n))
    hamiltonian[:n, :n] = F - np.outer(b, cross) / weight
    hamiltonian[n:, n:] = -hamiltonian[:n, :n].T
    hamiltonian[:n, n:] = -np.outer(b, b) * (power / weight)
    hamiltonian[n:, :n] = given / power
    if not np.isfinite(hamiltonian).all():
        return None
    period = _over(hamiltonian, joint.period)
    if period is None:
        return None
    A, G, H = np.eye(size), np.zeros((size, size)), np.zeros((size, size))
    A[:n, :n], G[:n, :n], H[:n, :n] = period
    form = Form(A @ jump, G, jump.T @ H @ jump, float(power), float(spring))
    if rest.shape is None or rest.momentum is None:
        return form
    momentum = rest.momentum.copy()
    momentum[DEFLECTION] += spring * rest.shape[DEFLECTION]
    return _without_equilibria(form, rest.shape, momentum / power)


def _over(hamiltonian: Floats, time: float) -> tuple[Floats, Floats, Floats] | None:
    """(A, G, H) over a time; None at a conjugate point."""
    n = len(hamiltonian) // 2
    fastest = float(np.hypot(*_eigenvalues(hamiltonian)).max()) * time
    halvings = max(0, int(np.ceil(np.log2(fastest / SHORT)))) if fastest > 0 else 0
    short = expm(hamiltonian * (time / 2.0**halvings))
    if not np.isfinite(short).all():
        return None
    inverse = np.linalg.inv(short[n:, n:])
    A, G, H = inverse.T, -short[:n, n:] @ inverse, -inverse @ short[n:, :n]
    for _ in range(halvings):
        inner = np.eye(n) + G @ H
        if not np.isfinite(inner).all() or not _eigenvalues(inner)[0].min() > 0:
            return None
        both = _solve(inner, np.concatenate([A, G], 1))
        G, H = G + A @ both[:, n:] @ A.T, H + A.T @ H @ both[:, :n]
        G, H, A = (G + G.T) / 2, (H + H.T) / 2, A @ both[:, :n]
    return A, G, H


def _without_equilibria(form: Form, r: Floats, psi: Floats) -> Form | None:
    """Takes the pole at z = 1 out: a displaced link at rest neither stores nor gives out energy here.

    The co-state is shifted by X Y with X symmetric and X shape = momentum: that adds a stored energy, which
    does not change the form, after which it no longer depends on the displacement. That direction is dropped.

    Args:
        form: With the equilibria.
        r: Their shape.
        psi: Their momentum, in the form's unit of energy.
    """
    rr = r @ r
    X = (np.outer(psi, r) + np.outer(r, psi)) / rr - np.outer(r, r) * (psi @ r) / rr**2
    A, G = form.A, form.G
    inner = np.eye(len(A)) + G @ X
    both = _solve(inner, np.concatenate([A, G], 1))
    new_A, new_G = both[:, : len(A)], both[:, len(A) :]
    new_Q = form.Q - X + A.T @ X @ new_A
    scale = np.abs(new_Q).max(initial=1.0) * np.sqrt(rr)
    if np.abs(new_A @ r - r).max() > 1e-6 * np.sqrt(rr) or np.abs(new_Q @ r).max() > 1e-6 * scale:
        return None
    rest_of = np.linalg.svd(r[None])[2][1:]  # orthonormal complement of r
    new_A, new_G, new_Q = (rest_of @ part @ rest_of.T for part in (new_A, new_G, new_Q))
    return Form(new_A, new_G, new_Q, form.power, form.spring)


def crossings(form: Form) -> Floats:
    """Angles in [0, pi] [rad per period] at which the form is singular."""
    n = len(form.A)
    left, right = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, 2 * n))
    left[:n, :n], left[n:, :n], left[n:, n:] = form.A, -form.Q, np.eye(n)
    right[:n, :n], right[:n, n:], right[n:, n:] = np.eye(n), form.G, form.A.T
    real, imaginary, beta, *_ = dggev(left, right, compute_vl=0, compute_vr=0)
    # |alpha| = |beta| on the circle; infinite eigenvalues have beta = 0.
    on_circle = np.abs(np.hypot(real, imaginary) - np.abs(beta)) < CIRCLE * np.abs(beta)
    return np.unique(np.abs(np.arctan2(imaginary[on_circle], real[on_circle] * np.sign(beta[on_circle]))))


def positive(form: Form) -> bool:
    """Whether a form is positive at all frequencies: no crossing, and a storage function.

    Either alone is right but for rounding, which is not the same in both.
    """
    return len(crossings(form)) == 0 and storage(form) is not None


def holds(joint: SampledJoint, level: float, loss: Loss | None = None, *, stored: bool = False) -> bool:
    """Whether a joint is fit to carry a link and its form lies above a level at all frequencies.

    Args:
        joint: The sampled joint.
        level: [N m s/rad].
        loss: Power to be subtracted as well.
        stored: Ask for a storage function too, as a verdict must; the crossings alone are faster.
    """
    with np.errstate(all="ignore"):
        try:
            rest = at_rest(joint)
            form = None if unfit(rest) else quadratic_form(joint, level, rest, loss)
            return form is not None and (positive(form) if stored else not len(crossings(form)))
        except (np.linalg.LinAlgError, ValueError):  # not finite somewhere
            return False


def storage(form: Form) -> Floats | None:
    """The stabilising solution P of ``P = Q + A' P (I + G P)^-1 A``, or None where there is none.

    P is checked after the fact: residual, ``I + G P`` with positive eigenvalues, closed loop stable.
    """
    A, G, P = form.A, form.G, form.Q
    n = len(A)
    eye = np.eye(n)
    for _ in range(DOUBLINGS):
        both = _solve(eye + G @ P, np.concatenate([A, G], 1))
        step = A.T @ P @ both[:, :n]
        G, P, A = G + A @ both[:, n:] @ A.T, P + step, A @ both[:, :n]
        G, P = (G + G.T) * 0.5, (P + P.T) * 0.5
        size = float(np.abs(P).max())
        if not size < 1e30:
            return None
        if float(np.abs(step).max()) <= 1e-14 * size:
            break
    inner = eye + form.G @ P
    if not _eigenvalues(inner)[0].min() > 0:
        return None
    closed = _solve(inner, form.A)
    residual = P - form.Q - form.A.T @ P @ closed
    if np.abs(residual).max() > RESIDUAL * max(np.abs(P).max(), np.abs(form.Q).max()):
        return None
    return P if np.hypot(*_eigenvalues(closed)).max() < 1 - CIRCLE else None
