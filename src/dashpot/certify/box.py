"""A joint's port over a whole box of drive parameters: proven between the corners, not only at them.

Let the rotor's motion be given. Then motor torque u and transmitted torque ``tau = u - (m s + v) q_r'`` do
not depend on the transmission and are affine in (m, v, beta), beta the scale of the position loop. The energy
that flows in at the port is

    E = E_D(tau) + v |q_r'|^2 - <u, q_r'>,       D(w) = c w^2 / (k^2 + c^2 w^2),

E_D the transmission's dissipation. Hence, for E to be positive over the box

- transmission: D falls with k, and as a function of c is smallest at an end. A transmission with
  ``k' = k_max sqrt(c_max/c_min)``, ``c' = c_max`` dissipates at most as much as any of the box, at every
  frequency;
- (m, v, beta): E is affine but for the convex E_D. Its tangent at the centre of the box lies below it and is
  affine, so it is smallest at a corner; there it is ``E - E_D(tau - tau_0)`` with tau_0 the torque at the
  centre for the same rotor motion. A shadow of the controller gives that difference;
- torque scale alpha: with tau given instead, u is affine in alpha, and so is E: the ends suffice;
- latency: each value by itself.

Each corner is one exact test (`dashpot.certify.exact`). The tangent's error falls with the square of the box:
where a corner fails the box is cut in two.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from copy import copy
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dashpot.arm.drive import Drive
from dashpot.certify.exact import holds
from dashpot.certify.index import Index, passivity_index
from dashpot.certify.joint import Scales, holds_torque, sampled_joint, uses
from dashpot.certify.shadow import with_shadow
from dashpot.certify.threads import one_thread
from dashpot.control.sampled import POSITION, VELOCITY

MOST_CELLS = 128
NARROW = 1e-3  # relative half-width below which cutting further proves nothing more
INSIDE = 64  # points tried inside the box
FINER = 1e-3  # relative step by which the search for the worst point goes down
DRIVE = ("rotor_inertia", "viscous_friction", "stiffness", "damping")
CONTINUOUS = (*DRIVE, "torque_gain", "position_gain")
POINTS = (*CONTINUOUS, "latency")
"""Coordinates of a point of the box."""


@dataclass(frozen=True)
class Box:
    """Ranges of what is uncertain about a joint, {coordinate: (lowest, highest)}; see `POINTS`.

    Attributes:
        ranges: SI units; latency in samples.
    """

    ranges: Mapping[str, tuple[float, float]]

    @classmethod
    def of(cls, drive: Drive, block: NDArray[np.void], latency_max: int | None = None) -> Box:
        """The box a drive states: its `uncertainty`, its `torque_gain_error`, and the latency's range."""
        ranges: dict[str, tuple[float, float]] = {}
        for name in DRIVE:
            value, half = getattr(drive, name), drive.uncertainty.get(name, 0.0)
            ranges[name] = (value * (1 - half), value * (1 + half))
        gain = (1 - drive.torque_gain_error, 1 + drive.torque_gain_error)
        located = uses(block, POSITION) or uses(block, VELOCITY)
        ranges["torque_gain"], ranges["position_gain"] = gain, gain if located else (1.0, 1.0)
        latency = int(block["latency"])
        ranges["latency"] = (latency, latency if latency_max is None else latency_max)
        return cls(ranges)

    @property
    def centre(self) -> dict[str, float]:
        """The middle."""
        return {name: (low + high) / 2 for name, (low, high) in self.ranges.items()}

    def corners(self, names: tuple[str, ...]) -> Iterator[dict[str, float]]:
        """All combinations of ends of some coordinates."""
        ends = [sorted(set(self.ranges[name])) for name in names]
        for values in itertools.product(*ends):
            yield dict(zip(names, values, strict=True))

    def proof_corners(self) -> Iterator[dict[str, float]]:
        """Corners of what the proof does not treat otherwise: rotor, scales, and every latency."""
        low, high = self.ranges["latency"]
        for latency in range(int(low), int(high) + 1):
            for corner in self.corners(("rotor_inertia", "viscous_friction", "torque_gain", "position_gain")):
                yield corner | {"latency": float(latency)}

    def halves(self) -> tuple[Box, Box] | None:
        """Cut across the coordinate that is relatively widest; None where all are `NARROW`."""

        def width(name: str) -> float:
            low, high = self.ranges[name]
            return (high - low) / (high + low) if high > low else 0.0

        name = max(("rotor_inertia", "viscous_friction", "damping", "position_gain"), key=width)
        if width(name) < NARROW:
            return None
        low, high = self.ranges[name]
        middle = (low + high) / 2
        return Box({**self.ranges, name: (low, middle)}), Box({**self.ranges, name: (middle, high)})


@dataclass(frozen=True)
class BoxCertificate:
    """What holds over the whole box.

    Attributes:
        proven: Whether the port is passive at every point of the box.
        worst: Index at the worst point found.
        point: That point.
        cells: Pieces of the box that were needed for the proof.
        reason: In words, where it is not proven.
    """

    proven: bool
    worst: Index
    point: Mapping[str, float]
    cells: int
    reason: str = ""


def at(drive: Drive, point: Mapping[str, float]) -> tuple[Drive, Scales]:
    """Drive and signal path at a point of the box."""
    scales = Scales(point["torque_gain"], point["position_gain"], int(point["latency"]))
    return _varied(drive, {name: point[name] for name in DRIVE if name in point}), scales


def _varied(drive: Drive, changes: Mapping[str, float]) -> Drive:
    """A copy with other values, without the checks that are meant for what a user writes."""
    varied = copy(drive)
    for name, value in {**changes, "uncertainty": {}}.items():
        object.__setattr__(varied, name, value)
    return varied


@one_thread
def certify_box(
    drive: Drive, block: NDArray[np.void], sampling: str, period: float, latency_max: int | None = None
) -> BoxCertificate:
    """Certifies a joint over the box of its drive's uncertainty.

    Args:
        drive: The drive with `uncertainty` and `torque_gain_error`.
        block: A record of `dashpot.control.sampled.BLOCK_DTYPE`.
        sampling: "average" or "point".
        period: [s].
        latency_max: Longest latency [samples]; None: that of the block.

    Raises:
        InputError: A coefficient is not finite, or the sensor's latency is not a whole number of samples.
    """
    box = Box.of(drive, block, latency_max)
    if holds_torque(block):
        point = box.centre | {"latency": float(block["latency"])}
        found = passivity_index(drive, block, sampling, period)
        return BoxCertificate(False, found, point, 0, found.reason)
    point, worst = worst_point(box, drive, block, sampling, period)
    if not worst.passive:
        return BoxCertificate(False, worst, point, 0, worst.reason)
    waiting, cells = [box], 0
    while waiting:
        cells += 1
        cell = waiting.pop()
        if _proven(cell, drive, block, sampling, period):
            continue
        halves = cell.halves()
        if halves is None or cells + len(waiting) >= MOST_CELLS:
            reason = f"no point of the box was found to fail, but {cells} pieces do not prove it"
            return BoxCertificate(False, worst, point, cells, reason)
        waiting += halves
    return BoxCertificate(True, worst, point, cells)


def worst_point(
    box: Box, drive: Drive, block: NDArray[np.void], sampling: str, period: float
) -> tuple[dict[str, float], Index]:
    """Searches the box for its smallest index: all corners, then coordinate by coordinate from the worst.

    One exact test tells whether a point lies below the smallest index so far; only then is it computed.
    """

    def index(point: Mapping[str, float]) -> Index:
        there, scales = at(drive, point)
        return passivity_index(there, block, sampling, period, scales)

    def below(point: Mapping[str, float], level: float) -> bool:
        there, scales = at(drive, point)
        joint = sampled_joint(there, block, sampling, period, scales)
        return not holds(joint, level - there.link_friction)

    point = box.centre | {"latency": float(block["latency"])}
    worst = index(point)

    def lowered(trial: dict[str, float]) -> bool:
        nonlocal point, worst
        if not np.isfinite(worst.value) or not below(trial, worst.value - FINER * abs(worst.value)):
            return False
        found = index(trial)
        if not found.value < worst.value:
            return False
        point, worst = trial, found
        return True

    for trial in itertools.chain(box.corners(POINTS), _inside(box)):
        lowered(trial)
    step = 0.5
    while step > 0.03:
        moved = False
        for name in CONTINUOUS:
            low, high = box.ranges[name]
            for direction in (-step, step) if high > low else ():
                trial = dict(point)
                trial[name] = float(np.clip(point[name] + direction * (high - low), low, high))
                moved |= trial[name] != point[name] and lowered(trial)
        step = step if moved else step / 2
    return point, worst


def _inside(box: Box) -> Iterator[dict[str, float]]:
    """Points between the corners, evenly spread (Kronecker sequence); the transmission stays at its ends."""
    inner = ("rotor_inertia", "viscous_friction", "torque_gain", "position_gain")
    if all(low == high for low, high in (box.ranges[name] for name in inner)):
        return
    ends = list(box.corners(("stiffness", "damping", "latency")))
    steps = 1 / 1.1673039782614187 ** np.arange(1, 5)  # root of x^5 = x + 1
    for i in range(INSIDE):
        between = (0.5 + i * steps) % 1
        point = dict(ends[i % len(ends)])
        for name, share in zip(inner, between, strict=True):
            low, high = box.ranges[name]
            point[name] = float(low + share * (high - low))
        yield {name: point[name] for name in POINTS}


def _proven(cell: Box, drive: Drive, block: NDArray[np.void], sampling: str, period: float) -> bool:
    """Whether every corner of a cell passes the exact test of its tangent."""
    if not cell.ranges["damping"][0] > 0:
        return False
    stand_in = StandIn.of(cell, drive)
    return all(stand_in.holds(corner, block, sampling, period) for corner in cell.proof_corners())


@dataclass(frozen=True)
class StandIn:
    """What takes the drive's place in the proof of a cell: the transmission that dissipates least.

    Attributes:
        drive: With that transmission.
        centre: Middle of the cell, where the tangent touches.
        friction: Link friction that counts [N m s/rad].
    """

    drive: Drive
    centre: Mapping[str, float]
    friction: float

    @classmethod
    def of(cls, cell: Box, drive: Drive) -> StandIn:
        """The stand-in of a cell whose damping is above zero."""
        (k_low, k), (c_low, c_high) = cell.ranges["stiffness"], cell.ranges["damping"]
        # Link friction adds a convex term in transmission and torque scale, for which neither the stand-in
        # nor the ends suffice: it counts where those are certain.
        gain_low, gain_high = cell.ranges["torque_gain"]
        certain = k_low == k and c_low == c_high and gain_low == gain_high
        changes = {"stiffness": k * np.sqrt(c_high / c_low), "damping": c_high}
        return cls(_varied(drive, changes), cell.centre, drive.link_friction if certain else 0.0)

    def holds(
        self,
        corner: Mapping[str, float],
        block: NDArray[np.void],
        sampling: str,
        period: float,
        *,
        stored: bool = True,
    ) -> bool:
        """Whether one corner passes the exact test of its tangent, for a verdict with a storage function.

        Stability with the link held is looked at as well, at the corners: no eigenvalue can leave the unit
        circle between them, because the form would be singular there.
        """
        there, scales = at(self.drive, corner)
        joint = sampled_joint(there, block, sampling, period, scales)
        if joint.speed_in_sample:
            return False
        joint, loss = with_shadow(
            joint,
            there,
            corner["rotor_inertia"] - self.centre["rotor_inertia"],
            corner["viscous_friction"] - self.centre["viscous_friction"],
            1 - self.centre["position_gain"] / corner["position_gain"],
            self.friction,
        )
        return holds(joint, -self.friction, loss, stored=stored)
