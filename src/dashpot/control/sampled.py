"""The sampled joint controller: one small linear block per joint, the thing that is certified and run.

A block maps ``w = [torque sample, torque in effect, position, velocity, position_ref, velocity_ref,
acceleration_ref, torque_ref]`` to a torque::

    u      = C x + D w
    x(k+1) = A x + B w + E (u_issued - u)

and the torque issued at tick k takes effect ``latency`` ticks later, held for one period. The layout
`BLOCK_DTYPE` is that of ``dp_block`` in native/dashpot_core.h.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from dashpot.support.arrays import Floats

Form = Literal["implicit", "explicit"]

NX, NW = 4, 8
TORQUE, IN_EFFECT, POSITION, VELOCITY, POSITION_REF, VELOCITY_REF, ACCELERATION_REF, TORQUE_REF = range(NW)

BLOCK_DTYPE = np.dtype(
    [
        ("A", "f8", (NX, NX)),
        ("B", "f8", (NX, NW)),
        ("C", "f8", (NX,)),
        ("D", "f8", (NW,)),
        ("E", "f8", (NX,)),
        ("bypass", "f8", (NW,)),
        ("warm", "f8", (NX,)),
        ("torque_limit", "f8"),
        ("rate_limit", "f8"),
        ("blend", "f8"),
        ("nx", "i4"),
        ("latency", "i4"),
    ],
    align=True,
)


@dataclass(frozen=True)
class VirtualPassive:
    """Gains of one joint of Eqs. (20)-(21) with the drive model they rest on.

    Attributes:
        R: R_tau [-].
        D: D_c [N m s/rad].
        K: K_c [N m/rad].
        m: Rotor inertia assumed [kg m^2].
        v: Viscous friction assumed [N m s/rad].
    """

    R: float
    D: float
    K: float
    m: float
    v: float

    @property
    def a(self) -> float:
        """Output gain on the virtual velocity, ``R v + D`` of Eq. (21) [N m s/rad]."""
        return self.R * self.v + self.D

    def continuous(self) -> tuple[Floats, Floats, Floats]:
        """Eqs. (20)-(21) with input ``tau_x - u'``: (A, B, C), states [xc, xc'], or [xc'] where K = 0.

        With K = 0 the displacement xc acts on nothing and would only integrate: it is left out.
        """
        rm = self.R * self.m
        if self.K == 0:
            return np.array([[-self.D / rm]]), np.array([1 / self.m]), np.array([self.a])
        A = np.array([[0.0, 1.0], [-self.K / rm, -self.D / rm]])
        return A, np.array([0.0, 1 / self.m]), np.array([self.K, self.a])


def empty_block() -> NDArray[np.void]:
    """A block of zeros, without limits, as a 0-d record array of `BLOCK_DTYPE`."""
    block = np.zeros((), BLOCK_DTYPE)
    block["torque_limit"] = block["rate_limit"] = math.inf
    return block


def virtual_passive_block(law: VirtualPassive, period: float, form: Form) -> NDArray[np.void]:
    """Discretises Eqs. (20)-(21) without a position loop.

    Explicit: zero-order hold of both inputs over the past period, exact for the interval average, with
    u' the torque in effect over it. Implicit: u' eliminated (u' = u), trapezoidal (Tustin) rule; `E`
    puts the issued torque back in place of u when a limit is active.

    Args:
        law: Gains and drive model.
        period: Sample period [s].
        form: "explicit" or "implicit".

    Returns:
        A record of `BLOCK_DTYPE`; `warm` sets the virtual velocity to minus the joint velocity.
    """
    A, B, C = law.continuous()
    n = len(B)
    at_rest = np.zeros(n)
    at_rest[-1] = -1.0
    block = empty_block()
    block["nx"] = n
    if form == "explicit":
        stacked = np.zeros((n + 1, n + 1))
        stacked[:n, :n], stacked[:n, n] = A, B
        exact = expm(stacked * period)
        phi, gamma = exact[:n, :n], exact[:n, n]
        block["A"][:n, :n] = phi
        block["B"][:n, TORQUE], block["B"][:n, IN_EFFECT] = gamma, -gamma
        block["C"][:n] = C @ phi
        block["D"][TORQUE], block["D"][IN_EFFECT] = C @ gamma, -C @ gamma
        block["warm"][:n] = at_rest
        return block
    eye = np.eye(n)
    solve = np.linalg.inv(eye - period / 2 * A)
    phi, gamma = solve @ (eye + period / 2 * A), solve @ B * (period / 2)
    both = (phi + eye) @ gamma
    loop = 1 + C @ gamma
    block["A"][:n, :n] = phi - np.outer(both, C) / loop
    block["B"][:n, TORQUE] = both / loop
    block["C"][:n] = C / loop
    block["D"][TORQUE] = C @ gamma / loop
    block["E"][:n] = -both
    block["warm"][:n] = phi @ at_rest
    return block


def add_position_loop(block: NDArray[np.void], kp: float, kd: float) -> NDArray[np.void]:
    """Adds the position loop of Fig. 2 to a torque-feedback block.

    ``tau_pd = kp (q_d - q) + kd (q_d' - q') + torque_ref``, positive in the direction of the joint, is
    added to the torque sample (the paper's "subtracted" refers to the opposite sign of the sensed torque).
    In bypass mode tau_pd is the command.

    Args:
        block: Record of `BLOCK_DTYPE`.
        kp: [N m/rad].
        kd: [N m s/rad].

    Returns:
        A new record.
    """
    pd = np.zeros(NW)
    pd[[POSITION, VELOCITY, POSITION_REF, VELOCITY_REF, TORQUE_REF]] = -kp, -kd, kp, kd, 1.0
    result = block.copy()
    result["B"] += np.outer(block["B"][:, TORQUE], pd)
    result["D"] += block["D"][TORQUE] * pd
    result["bypass"] = pd
    return result


def pd_block(kp: float, kd: float) -> NDArray[np.void]:
    """The PD controller alone: ``u = kp (q_d - q) + kd (q_d' - q') + torque_ref``, no state."""
    block = empty_block()
    pd = np.zeros(NW)
    pd[[POSITION, VELOCITY, POSITION_REF, VELOCITY_REF, TORQUE_REF]] = -kp, -kd, kp, kd, 1.0
    block["D"] = block["bypass"] = pd
    return block


def without_encoder(block: NDArray[np.void]) -> NDArray[np.void]:
    """What is left of a block when the position loop is off: its inputs position ... torque_ref are zero."""
    result = block.copy()
    for key in ("B", "D", "bypass"):
        result[key][..., POSITION:] = 0.0
    return result
