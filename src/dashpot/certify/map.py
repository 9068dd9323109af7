"""Where in the plane of R and D a joint is certified, and where loads oscillate.

At one frequency the controller enters the port through one complex number, ``1/C(z)``. All it meets is a disc
that belongs to the plant: with the eigenvalues h_i of the port's Hermitian part without torque loop, a the
motor's column, b the sample's row in their basis and P the transfer from motor to sample,

    Re G >= level  <=>  |2 (1/C - P)* + X|^2 > A B,    A = sum |a_i|^2/(h_i - level),  B and X alike,

as long as no h_i lies below the level (one may, then both A and B have to be negative and the sign turns). So
a map costs a table of discs and one frequency response per point.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label

from dashpot.arm.drive import Drive
from dashpot.certify.exact import at_rest, unfit
from dashpot.certify.joint import SampledJoint, Scales, sampled_joint, scaled
from dashpot.certify.loads import GROWS, loops, radii
from dashpot.certify.port import one_period
from dashpot.certify.threads import one_thread
from dashpot.control.sampled import (
    BLOCK_DTYPE,
    IN_EFFECT,
    POSITION,
    TORQUE,
    VELOCITY,
    add_position_loop,
    empty_block,
)
from dashpot.support.arrays import Floats

INTERVALS = 32
ANGLES = np.concatenate([np.geomspace(1e-4, 0.1, 28), np.linspace(0.11, np.pi, 84)])
LEVELS = 40  # on each side of zero
LOADS = np.geomspace(1 / 30, 300, 28)  # inertias tried, relative to the rotor's
NOMINAL = Scales()
BatchBlocks = NDArray[np.void]


@dataclass(frozen=True)
class IndexMap:
    """Index over a grid of gains.

    Attributes:
        R: (nr,) [-].
        D: (nd,) [N m s/rad].
        index: (nd, nr) largest tabulated level at or below the index [N m s/rad]; -inf: unstable, or below
            all levels.
        coarse: Indices of the gains at which loads were tried, (rows, columns).
        oscillates: (len(rows), len(columns)) whether one of the inertias tried oscillates.
    """

    R: Floats
    D: Floats
    index: Floats
    coarse: tuple[NDArray[np.int64], NDArray[np.int64]]
    oscillates: NDArray[np.bool_]


@dataclass(frozen=True)
class _Discs:
    """Plant at all angles and levels: motor-to-sample transfer, and A B, X and the count of h_i below."""

    transfer: NDArray[np.complex128]
    radius2: Floats
    centre: NDArray[np.complex128]
    below: NDArray[np.int64]
    negative: NDArray[np.bool_]


def _levels(drive: Drive) -> Floats:
    """From far below zero up to the transmission's damping."""
    top = 0.999 * drive.damping
    size = drive.damping + drive.viscous_friction or np.sqrt(drive.stiffness * drive.rotor_inertia)
    down = -np.geomspace(1e3 * size, 1e-3 * (drive.damping or size), LEVELS)
    return np.concatenate([down, np.linspace(0, top, LEVELS)])


def _listening(kp: float, kd: float) -> NDArray[np.void]:
    """A block whose torque is the controller's input: torque sample and position loop together."""
    block = empty_block()
    block["D"][[TORQUE, POSITION, VELOCITY]] = 1.0, -kp, -kd
    return block


def _discs(
    drive: Drive, kp: float, kd: float, sampling: str, period: float, levels: Floats, scales: Scales
) -> _Discs:
    joint = sampled_joint(drive, _listening(kp, kd), sampling, period, scales)
    moves, jump, held = one_period(joint, INTERVALS), scaled(joint)[3], len(joint.flow) - 1
    sample = jump[held] * joint.units[held]  # [N m] from the state before the tick
    silent = jump.copy()
    silent[held] = 0.0
    motor = np.zeros(len(jump))
    motor[held] = 1 / joint.units[held]
    z = np.exp(1j * ANGLES)[:, None, None]
    resolvent = np.linalg.inv(z * np.eye(len(jump)) - moves.flow @ silent)
    alone = moves.D + moves.energy @ silent @ resolvent @ moves.B
    column = moves.energy @ motor + moves.energy @ silent @ resolvent @ (moves.flow @ motor)
    row = sample @ resolvent @ moves.B
    transfer = np.einsum("i,kij,j->k", sample, resolvent, moves.flow @ motor)
    h, V = np.linalg.eigh((alone + np.conj(np.swapaxes(alone, -1, -2))) / 2)
    scale = INTERVALS / period
    a = np.einsum("kij,ki->kj", V.conj(), column) * np.sqrt(scale)
    c = np.einsum("kij,ki->kj", V.conj(), row.conj()) * np.sqrt(scale)
    weight = 1 / (h[None] * scale - levels[:, None, None])
    first = (np.abs(a) ** 2 * weight).sum(-1)
    second = (np.abs(c) ** 2 * weight).sum(-1)
    return _Discs(
        transfer,
        first * second,
        (a.conj() * c * weight).sum(-1),
        (weight < 0).sum(-1),
        (first < 0) & (second < 0),
    )


def response(blocks: BatchBlocks, angles: Floats) -> NDArray[np.complex128]:
    """Frequency response of blocks (k,) from torque sample to torque in effect, (k, len(angles))."""
    nx = int(blocks["nx"].max(initial=0))
    z = np.exp(1j * angles)
    delay = blocks["latency"].astype(int)
    A, B, C = blocks["A"][:, :nx, :nx], blocks["B"][:, :nx], blocks["C"][:, :nx]
    heard, own = (np.repeat(blocks["D"][:, i, None], len(z), 1).astype(complex) for i in (TORQUE, IN_EFFECT))
    # (z I - A)^-1 by Leverrier and Faddeev: numerator and characteristic polynomial together.
    eye = np.eye(nx)
    term = np.broadcast_to(eye, A.shape)
    powers = z[None, :] ** np.arange(nx + 1)[:, None]
    denominator = np.repeat(powers[None, nx], len(blocks), 0)
    sums = [np.zeros_like(heard), np.zeros_like(heard)]
    for i in range(1, nx + 1):
        for total, channel in zip(sums, (TORQUE, IN_EFFECT), strict=True):
            total += np.einsum("ki,kij,kj->k", C, term, B[:, :, channel])[:, None] * powers[nx - i]
        step = A @ term
        coefficient = -np.trace(step, axis1=-2, axis2=-1) / i
        denominator = denominator + coefficient[:, None] * powers[nx - i]
        term = step + coefficient[:, None, None] * eye
    heard, own = heard + sums[0] / denominator, own + sums[1] / denominator
    command = heard / (1 - own * z ** -(1.0 + delay[:, None]))
    return np.asarray(command * z ** -delay[:, None].astype(float))


@one_thread
def index_map(
    drive: Drive,
    block: Callable[[float, float], NDArray[np.void]],
    loop: tuple[float, float],
    sampling: str,
    period: float,
    R: Floats,
    D: Floats,
    *,
    scales: Scales = NOMINAL,
    tried: int = 48,
) -> IndexMap:
    """Maps the index over R and D.

    Args:
        drive: The joint's drive.
        block: Makes the torque-feedback block of a pair (R, D), without position loop.
        loop: kp and kd of the position loop to add [N m/rad, N m s/rad].
        sampling: "average" or "point".
        period: [s].
        R: (nr,) [-].
        D: (nd,) [N m s/rad].
        scales: Departures of torque and position channel from nominal; the latency is that of the blocks.
        tried: About how many values of R and of D `LOADS` are tried at; 0: none.
    """
    levels = _levels(drive)
    discs = _discs(drive, *loop, sampling, period, levels, scales)
    blocks = np.empty(len(D) * len(R), BLOCK_DTYPE)
    for i, (d, r) in enumerate(itertools.product(D, R)):
        blocks[i] = block(r, d)
    pieces = np.array_split(blocks, max(1, len(blocks) // 4000))
    index = np.concatenate([_highest(discs, some, levels) for some in pieces]).reshape(len(D), len(R))

    def joint_at(i: int, j: int) -> SampledJoint:
        whole = add_position_loop(blocks[i * len(R) + j], *loop)
        return sampled_joint(drive, whole, sampling, period, scales)

    if drive.damping == 0 or joint_at(0, 0).speed_in_sample:  # what is positive is so at finite N only
        index = np.minimum(index, -np.finfo(float).tiny)
    # Where the form is positive no eigenvalue of the held joint can cross the unit circle: one exact look at
    # every connected region is enough.
    regions, count = label(index >= 0)
    for region in range(1, count + 1):
        where = np.argwhere(regions == region)
        i, j = where[np.argmax(index[tuple(where.T)])]
        if unfit(at_rest(joint_at(i, j))):
            index[regions == region] = -np.inf
    rows = np.unique(np.linspace(0, len(D) - 1, tried).round().astype(int))
    columns = np.unique(np.linspace(0, len(R) - 1, tried).round().astype(int))
    inertias = LOADS * drive.rotor_inertia
    oscillates = np.zeros((len(rows), len(columns)), bool)
    flows = None
    for a, i in enumerate(rows):
        for e, j in enumerate(columns):
            if index[i, j] < 0:
                joint = joint_at(i, j)
                if flows is None:
                    flows = _flows(joint, inertias)
                if joint.speed_in_sample:
                    oscillates[a, e] = radii(joint, inertias, 0 * inertias).max() > 1 + GROWS
                else:
                    oscillates[a, e] = _grows(joint, flows)
    return IndexMap(R, D, index, (rows, columns), oscillates)


def _highest(discs: _Discs, blocks: BatchBlocks, levels: Floats) -> Floats:
    """Largest level at which every angle's disc is avoided, by bisection over the table; (k,)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        outside = 2 * (1 / response(blocks, ANGLES) - discs.transfer)  # inf where there is no torque feedback
    outside = np.where(np.isfinite(outside), outside, 1e150).conj()
    low, high = np.full(len(blocks), -1), np.full(len(blocks), len(levels))
    while (high - low > 1).any():
        middle = np.where(high - low > 1, (low + high) // 2, np.maximum(low, 0))
        distance2 = np.abs(outside + discs.centre[middle]) ** 2
        free = discs.below[middle] == 0
        one = (discs.below[middle] == 1) & discs.negative[middle] & (distance2 < discs.radius2[middle])
        good = ((free & (distance2 > discs.radius2[middle])) | one).all(1)
        low, high = (
            np.where(good & (high - low > 1), middle, low),
            np.where(~good & (high - low > 1), middle, high),
        )
    return np.where(low >= 0, levels[np.maximum(low, 0)], -np.inf)


def _flows(joint: SampledJoint, inertias: Floats) -> Floats:
    """Loop with each inertia but for the jump at the tick: the same for every controller of this shape."""
    still = replace(joint, jump=np.eye(len(joint.jump)), speed_in_sample=False)
    return loops(still, inertias, np.zeros_like(inertias))


def _grows(joint: SampledJoint, flows: Floats) -> bool:
    size = len(joint.jump)
    jump = np.eye(size + 2)
    jump[:size, :size] = scaled(joint)[3]
    return bool(np.abs(np.linalg.eigvals(flows @ jump)).max() > 1 + GROWS)
