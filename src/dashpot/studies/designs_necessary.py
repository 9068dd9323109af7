"""What every certified design of one joint obeys, as inequalities between its gains.

With the averaged torque and the implicit form the law is ``y = Q u``: y the controller's input, u the torque
it holds over a period, and with ``s = (2/h) (z - 1)/(z + 1)``, ``x = D/(R a)``, ``mu = m/a``, ``kappa = K/a``

    Q = 1/C = 1 + x + mu (s^2 + kappa v/m)/(s + kappa)          (m, v: of the law).

Let t_n be the transmitted torque at ``w_n = w + 2 pi n/h`` while u = 1 is held: a passive load can make it
anything that fits ``y = Q u``. With ``s_n = (1 - 1/z)/(j w_n h)`` (the mean over a period, and the hold),
``Y = 1/(m j w_n + v)`` the rotor and D the transmission's dissipation, the energy that flows in per period
and what the controller reads are (m, v: of the drive)

    E = sum d |t|^2 - Re(s_n* Y* t),   d = Re Y + D,
    Q = sum L t - kp Theta - kd Omega,   L = alpha s_n + beta (kp/(j w_n) + kd) Y,

Theta and Omega beta times the free rotor's position and speed at a tick. E is not negative anywhere on that
hyperplane iff

    |Q + kp Theta + kd Omega - sum L Y s_n/(2 d)|^2  >=  sum |Y s_n|^2/(4 d) * sum |L|^2/d.              (1)

A few n make (1) necessary, all of them sufficient at that w. Both sides are quadratic forms in
``p = (1, x, mu, kp, kd)``. A certified joint obeys (1) at every frequency, in the limit of none, and for
every drive of the box; and it stays bounded without any load, which asks (see `_free_rotor`) for

    Q + kp Theta + kd Omega > 0   at every real z < -1,                                                  (2)

linear in p.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dashpot.design.candidates import Duty
from dashpot.support.arrays import Floats

Complex = NDArray[np.complex128]

ONE, X, MU, KP, KD = range(5)
ALIASES = np.arange(-12, 13)
SHARES = (*np.geomspace(3e-3, 0.06, 10), *np.linspace(0.08, 0.998, 40))  # of half the sample rate
BEYOND = (-1.02, -1.05, -1.1, -1.2, -1.35, -1.5, -1.75, -2.0, -2.5, -3.0, -4.0, -6.0, -10.0, -20.0)  # real z
AROUND = np.asarray(
    2 * np.exp(2j * np.pi * (np.arange(32) + 0.5) / 32), np.complex128
)  # [rad/s], a circle inside all poles
SLACK = 1e-9  # by how much an inequality must fail, relative to its terms: covers rounding


@dataclass(frozen=True)
class Corner:
    """One drive of the box, and the law's own numbers.

    Attributes:
        m: Rotor inertia [kg m^2].
        v: Viscous friction [N m s/rad].
        k: Stiffness [N m/rad].
        c: Transmission damping [N m s/rad].
        torque: Scale of the torque channel, alpha [-].
        position: Scale of the position loop, beta [-].
        period: h [s].
        rate: v/m of the law [1/s].
    """

    m: float
    v: float
    k: float
    c: float
    torque: float
    position: float
    period: float
    rate: float

    @classmethod
    def of(cls, duty: Duty) -> Corner:
        """The light, smooth, stiff drive with the strongest channels: it fails first."""
        drive, gain = duty.drive, duty.drive.torque_gain_error

        def end(name: str, side: int) -> float:
            return float(getattr(drive, name) * (1 + side * drive.uncertainty.get(name, 0.0)))

        return cls(
            end("rotor_inertia", -1),
            end("viscous_friction", -1),
            end("stiffness", 1),
            end("damping", -1),
            1 + gain,
            1 + gain,
            duty.period,
            drive.viscous_friction / drive.rotor_inertia,
        )

    def tick(self, z: Complex) -> tuple[Complex, Complex]:
        """Theta [rad/(N m)] and Omega [rad/(N m s)] of the free rotor under a held torque."""
        h, v, lag = self.period, self.v, self.m / self.v
        moved = -np.expm1(-h / lag)
        omega = moved / v / (z - np.exp(-h / lag))
        return (lag * moved * omega + (h - lag * moved) / v) / (z - 1), omega

    def trapezoidal(self, z: Complex) -> Complex:
        """s of the law's Tustin rule [1/s]."""
        return np.asarray(2 / self.period * (z - 1) / (z + 1))


@dataclass(frozen=True)
class Inequalities:
    """What a certified design obeys: ``|row p + mu (b - s)|^2 - p' G p >= 0``, and linear ones.

    Attributes:
        corner: The drive.
        omega: (f,) [rad/s].
        s: (f,) of the law [1/s].
        row: (f, 5), with s where K = 0 as coefficient of mu.
        G: (f, 5, 5).
        creep: (5, 5), the whole form at no frequency, for K = 0.
        beyond: (z,), s at real z < -1; real.
        linear: (z, 5), the same for (2).
    """

    corner: Corner
    omega: Floats
    s: Complex
    row: Complex
    G: Floats
    creep: Floats
    beyond: Floats
    linear: Floats

    @classmethod
    def of(
        cls, corner: Corner, shares: Sequence[float] = SHARES, beyond: Sequence[float] = BEYOND
    ) -> Inequalities:
        """Those of a corner.

        Args:
            corner: The drive.
            shares: Frequencies of (1), over half the sample rate; none joins them.
            beyond: Real z of (2).
        """
        omega = np.asarray(shares) * np.pi / corner.period
        row, _, G = _form(corner, np.asarray(omega, np.complex128))
        # The form is analytic and even in the frequency: its limit is its mean over a circle around zero.
        there, back, H = _form(corner, AROUND)
        outer = np.einsum("fi,fj->ij", there, back) / len(AROUND)
        creep = (outer + outer.T).real / 2 - H.mean(0).real
        # mu enters times s, which vanishes but where it meets the pole of kp Theta.
        creep[MU, [ONE, X, MU, KD]] = creep[[ONE, X, MU, KD], MU] = 0.0
        s, linear = _free_rotor(corner, beyond)
        return cls(corner, omega, row[:, MU], row, G.real, creep, s, linear)

    def virtual(self, kappa: Floats) -> tuple[Complex, Floats]:
        """Coefficient of mu for K/a in intervals (k, 2) [1/s]: centres and radii of discs, (k, f).

        ``b = v/m + s (s - v/m)/(s + kappa)``: 1/(s + kappa) runs along less than half a circle, which lies in
        the disc over its chord.
        """
        rate, s = self.corner.rate, self.s
        with np.errstate(divide="ignore"):
            ends = 1 / (s[:, None, None] + kappa) * np.isfinite(kappa)  # (f, k, 2)
        gain = (s * (s - rate))[:, None]
        return (rate + gain * ends.mean(-1)).T, (np.abs(gain * (ends[..., 1] - ends[..., 0])) / 2).T


def _form(corner: Corner, omega: Complex) -> tuple[Complex, Complex, Complex]:
    """Row of (1) at a frequency and at minus that, which is its conjugate on the real axis, and G."""
    h, v, m = corner.period, corner.v, corner.m

    def half(omega: Complex, n: NDArray[np.int64]) -> tuple[Complex, Complex, Complex, Complex]:
        z, w = np.exp(1j * omega * h), omega[:, None] + 2 * np.pi * n / h
        mean = (1 - 1 / z)[:, None] / (1j * w * h)
        Y = 1 / (m * 1j * w + v)
        d = v / (v**2 + (m * w) ** 2) + corner.c * w**2 / (corner.k**2 + (corner.c * w) ** 2)
        speed = corner.position * Y
        L = np.stack([corner.torque * mean, 0 * mean, 0 * mean, speed / (1j * w), speed], 1)
        best = Y * mean / (2 * d)
        theta, speed_at_tick = corner.tick(z)
        row = -np.einsum("fin,fn->fi", L, best)
        row[:, [ONE, X]] += 1.0
        row[:, MU] = corner.trapezoidal(z)
        row[:, KP] += corner.position * theta
        row[:, KD] += corner.position * speed_at_tick
        return row, L, best, np.asarray(d, np.complex128)

    row, L, best, d = half(omega, ALIASES)
    back, M, other, _ = half(-omega, -ALIASES)
    G = np.einsum("fin,fjn,fn->fij", L, M, 1 / d) * np.einsum("fn,fn,fn->f", best, other, d)[:, None, None]
    return row, back, (G + G.swapaxes(1, 2)) / 2


def _free_rotor(corner: Corner, beyond: Sequence[float]) -> tuple[Floats, Floats]:
    """s and the forms of (2): the characteristic function of the joint without a load.

    It is positive far out on the negative real axis and continuous from there to -1. Were it not positive in
    between, the joint would oscillate from tick to tick and grow, with a massless link that takes no energy.
    """
    z = np.asarray(beyond) + 0j
    theta, omega = corner.tick(z)
    s = corner.trapezoidal(z).real
    one = np.ones(len(z))
    linear = np.stack([one, one, s, corner.position * theta.real, corner.position * omega.real], 1)
    return s, linear


def entries(given: Inequalities, cones: Floats, kappa: Floats | None) -> tuple[Floats, Floats, Floats]:
    """Upper bounds of ``p_a' M p_b`` for all edges of cones (k, 5, 5).

    Args:
        given: The inequalities.
        cones: Edges in rows.
        kappa: K/a of each cone, intervals (k, 2) [1/s]; None: K = 0.

    Returns:
        Bounds of (1), (k, f, 5, 5); the same at the middle of kappa; size of the terms (k, f).
    """
    row = np.einsum("kai,fi->kfa", cones, given.row)
    mu = cones[:, None, :, MU]
    if kappa is not None:
        centre, radius = given.virtual(kappa)
        row = row + (centre - given.s)[:, :, None] * mu
    G = np.einsum("kai,fij,kbj->kfab", cones, given.G, cones, optimize=True)
    middle = (
        row.real[..., :, None] * row.real[..., None, :] + row.imag[..., :, None] * row.imag[..., None, :] - G
    )
    size = np.asarray((np.abs(row) ** 2).max(-1) + np.abs(G).max((-1, -2)))
    if kappa is None:
        return middle, middle, size
    off = radius[:, :, None] * mu
    cross = off[..., :, None] * np.abs(row)[..., None, :]
    upper = middle + cross + cross.swapaxes(-1, -2) + off[..., :, None] * off[..., None, :]
    return upper, middle, size


def unstable(given: Inequalities, cones: Floats, kappa: Floats | None) -> NDArray[np.bool_]:
    """Cones (k,) on which (2) fails at one of its points."""
    linear = np.repeat(given.linear[None], len(cones), 0)
    if kappa is not None:  # s > v/m there, so that the coefficient falls with kappa
        rate, s = given.corner.rate, given.beyond
        linear[:, :, MU] = rate + s * (s - rate) / (s + kappa[:, :1])
    values = np.einsum("kai,kzi->kza", cones, linear)
    size = np.einsum("kai,kzi->kza", cones, np.abs(linear)).max(-1)
    return np.asarray((values.max(-1) < -SLACK * size).any(1))


def creeping(given: Inequalities, cones: Floats) -> NDArray[np.bool_]:
    """Cones (k,) on which (1) fails at no frequency, K = 0.

    Between edges that no gains lie on it may vanish, as it does for mu without kp.
    """
    values = cones @ given.creep @ cones.swapaxes(1, 2)
    size = (np.abs(cones) @ np.abs(given.creep) @ np.abs(cones).swapaxes(1, 2)).max((1, 2))
    edge = cones[:, :, ONE] == 0
    free = (values == 0) & edge[:, :, None] & edge[:, None]
    return np.asarray(((values < -SLACK * size[:, None, None]) | free).all((1, 2)))
