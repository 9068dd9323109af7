"""A sampled joint cut at its output: what happens between ticks, and what happens at a tick.

Between ticks ``Y' = F Y + b w`` with the link velocity w as input and ``tau = t Y + t_w w`` the transmitted
torque; at a tick ``Y <- J Y``. Y holds, in this order, the states that move between ticks

    deflection, rotor speed, [rotor position], [sensor filter], [torque average], torque in effect

and those that change at ticks only: [torque samples still in the sensor], block states, past commands.
Everything in `dashpot.certify` starts from this one description.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dashpot.arm.drive import Drive
from dashpot.control.sampled import IN_EFFECT, NW, POSITION, TORQUE, VELOCITY
from dashpot.errors import InputError
from dashpot.support.arrays import Floats

DEFLECTION, SPEED = 0, 1
WHOLE = 1e-6  # samples: how far from a whole number a sensor's latency may be


@dataclass(frozen=True)
class Scales:
    """Departures of the signal path from what the controller assumes.

    Attributes:
        torque: Sensor times actuator scale of the torque channel [-].
        position: Scale of the position loop's torque [-].
        latency: Samples from computing a torque to its taking effect; None: what the block assumes.
    """

    torque: float = 1.0
    position: float = 1.0
    latency: int | None = None


@dataclass(frozen=True)
class SampledJoint:
    """See the module. ``n`` states move between ticks; all arrays are in natural (SI) units.

    Attributes:
        flow: F, (n, n).
        velocity_in: b, (n,).
        torque: t, (n,).
        torque_w: t_w, minus the transmission's damping [N m s/rad].
        jump: J, (size, size).
        units: (size,) typical size of each state, for scaling.
        period: [s].
        speed_in_sample: Whether a torque sample contains the link velocity at the tick: no sensor filter and
            no average stands between them.
        position: Index of the rotor position, or None.
    """

    flow: Floats
    velocity_in: Floats
    torque: Floats
    torque_w: float
    jump: Floats
    units: Floats
    period: float
    speed_in_sample: bool
    position: int | None


def scaled(joint: SampledJoint) -> tuple[Floats, Floats, Floats, Floats]:
    """Flow, velocity input, torque row and jump in the joint's own units."""
    n, units = len(joint.flow), joint.units
    return (
        joint.flow * units[:n] / units[:n, None],
        joint.velocity_in / units[:n],
        joint.torque * units[:n],
        joint.jump * units / units[:, None],
    )


def uses(block: NDArray[np.void], channel: int) -> bool:
    """Whether a block reads an input channel."""
    return bool(block["D"][channel] != 0 or np.any(block["B"][: int(block["nx"]), channel] != 0))


def holds_torque(block: NDArray[np.void]) -> bool:
    """Whether a block reads nothing of the joint, and keeps the torque it once had for ever.

    An integrator cut off from its input, or torque in effect fed back with gain one: a pole at z = 1 that
    nothing in the joint moves. What moves then is the bare drive under a constant torque.
    """
    if any(uses(block, channel) for channel in (TORQUE, POSITION, VELOCITY)):
        return False
    nx, kept = int(block["nx"]), int(block["latency"]) + 1 if uses(block, IN_EFFECT) else 0
    A = np.zeros((nx + kept, nx + kept))
    A[:nx, :nx] = block["A"][:nx, :nx]
    if kept:  # past commands; the oldest is in effect
        A[:nx, -1] = block["B"][:nx, IN_EFFECT]
        A[nx, :nx], A[nx, -1] = block["C"][:nx], block["D"][IN_EFFECT]
        A[range(nx + 1, nx + kept), range(nx, nx + kept - 1)] = 1.0
    return bool(len(A) and np.isfinite(A).all() and (np.abs(np.linalg.eigvals(A) - 1) < 1e-9).any())


def _unit_of(values: Floats) -> float:
    size = float(np.abs(values).max(initial=0.0))
    return size if size > 0 and np.isfinite(size) else 1.0


@np.errstate(all="ignore")  # absurd coefficients: what is not finite is found later
def sampled_joint(
    drive: Drive,
    block: NDArray[np.void],
    sampling: Literal["average", "point"] | str,
    period: float,
    scales: Scales = Scales(),
) -> SampledJoint:
    """Describes a joint with its controller block.

    The law is linear: Coulomb friction, backlash, hysteresis and limits are left out.

    Args:
        drive: The joint's drive.
        block: A record of `dashpot.control.sampled.BLOCK_DTYPE`.
        sampling: "average" or "point".
        period: [s].
        scales: Departures from nominal.

    Raises:
        InputError: A coefficient is not finite, or the sensor's latency is not a whole number of samples.
    """
    for key in ("A", "B", "C", "D"):
        if not np.isfinite(block[key]).all():
            raise InputError("must be finite", joint=drive.name, quantity=f"coefficient {key}")
    m, v, k, c = drive.rotor_inertia, drive.viscous_friction, drive.stiffness, drive.damping
    average, listens = sampling == "average", uses(block, TORQUE)
    located = uses(block, POSITION)
    order = drive.sensor_order if drive.sensor_bandwidth is not None and listens else 0
    average = average and listens

    # Between ticks.
    n = 3 + located + order + average
    held, first_filter, mean = n - 1, 2 + located, 2 + located + order
    F, b, t = np.zeros((n, n)), np.zeros(n), np.zeros(n)
    t[DEFLECTION], t[SPEED] = k, c
    F[DEFLECTION, SPEED], b[DEFLECTION] = 1.0, -1.0
    F[SPEED] = -t / m
    F[SPEED, SPEED] -= v / m
    F[SPEED, held], b[SPEED] = 1 / m, c / m
    if located:
        F[2, SPEED] = 1.0
    seen, seen_w = t.copy(), -c
    if order:
        omega, last = 2 * np.pi * drive.sensor_bandwidth, first_filter + order - 1  # type: ignore[operator]
        F[last] = omega * t
        b[last] = -omega * c
        if order == 1:
            F[last, last] -= omega
        else:
            F[first_filter, last] = omega
            F[last, first_filter] -= omega
            F[last, last] -= 2 * drive.sensor_damping * omega
        seen, seen_w = np.eye(n)[first_filter], 0.0
    if average:
        F[mean], b[mean] = seen / period, seen_w / period

    # At a tick.
    nx, assumed = int(block["nx"]), int(block["latency"])
    actual = assumed if scales.latency is None else scales.latency
    late = drive.torque_latency / period if listens else 0.0
    if abs(late - round(late)) > WHOLE:
        raise InputError(
            f"is {late:.4g} periods; the certificate covers whole ones",
            joint=drive.name,
            quantity="torque_latency [s]",
            value=drive.torque_latency,
        )
    kept = round(late)  # samples still in the sensor
    past = max(actual, assumed + 1 if uses(block, IN_EFFECT) else 0)  # commands to remember
    states, history = n + kept, n + kept + nx
    size = history + past
    sample = np.zeros(size)
    sample[:n] = np.eye(n)[mean] if average else seen
    read = np.zeros((NW, size))
    read[TORQUE] = scales.torque * (np.eye(size)[states - 1] if kept else sample)
    if uses(block, IN_EFFECT):
        read[IN_EFFECT, history + assumed] = 1.0
    read[VELOCITY, SPEED] = scales.position
    if located:
        read[POSITION, 2] = scales.position
    command = block["D"] @ read
    command[states:history] += block["C"][:nx]
    J = np.eye(size)
    if average:
        J[mean] = 0.0
    J[held] = np.eye(size)[history + actual - 1] if actual else command
    if kept:
        J[n] = sample
        J[n + 1 : states] = np.eye(size)[n : states - 1]
    J[states:history] = block["B"][:nx] @ read
    J[states:history, states:history] += block["A"][:nx, :nx]
    if past:
        J[history] = command
        J[history + 1 :] = np.eye(size)[history : size - 1]

    # Units: velocity 1, time one period, torque the geometric mean of spring and rotor.
    newton = np.sqrt(k * m)
    units = np.ones(size)
    units[DEFLECTION] = period
    if located:
        units[2] = period
    units[2 + located : n] = newton
    units[n:states] = newton
    units[history:] = newton
    for i in range(nx):
        drives_it = [newton * _unit_of(block["B"][i, [TORQUE, IN_EFFECT]]), _unit_of(block["B"][i, VELOCITY])]
        units[states + i] = drives_it[0] if listens else drives_it[1]
    return SampledJoint(
        F, b, t, -c, J, units, period, listens and not average and not order, 2 if located else None
    )
