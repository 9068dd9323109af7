"""Global, deterministic search for the best certified gains of one joint.

A candidate is a point ``(log g, log w_c, log kp/kd, zeta, log kd)``. A lattice over the whole range is
looked at column by column: along a column only one coordinate grows, g for a brake, kd for a position loop,
and what is certified is taken to be its lower part. (The form that is certified is affine in kp and kd but
for a small convex term, `dashpot.certify.box`.) That only steers the search; what it returns has its own
certificate. Ever finer lattices around the best columns follow.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dashpot.certify.box import BoxCertificate
from dashpot.certify.threads import one_thread
from dashpot.design import candidates as quantity
from dashpot.design.candidates import Duty, Gains
from dashpot.design.prover import Depth, Prover, Refusal
from dashpot.design.wishes import AT_LEAST, NEED_LOOP, Wishes
from dashpot.support.arrays import Floats

G, CORNER, RATIO, ZETA, KD = range(5)
RANGES = {G: (0.1, 100.0), CORNER: (1.0, 5.0), RATIO: (0.3, 300.0), KD: (1e-4, 1.0)}
"""Of g [-], w_c ([rad/s]; upper end over the sample rate), kp/kd [1/s], kd over the one authority allows."""
SPRINGS = (math.inf, 1.0, 0.7)  # zeta: K = 0, and two virtual springs
BRAKE_POINTS = {G: 30, CORNER: 30}
LOOP_POINTS = {G: 14, CORNER: 10, RATIO: 9, KD: 22}
NEAR = math.log(1.5)  # columns this much worse than the best are still worth a closer look
MOTIONS = ("stop_time", "travel")
"""Quantities that are found by letting the brake stop a joint."""
BASINS = 4  # columns looked at closer
ACROSS = np.linspace(-1, 1, 5)  # a finer lattice, in steps of the coarser one
ALONG = np.linspace(-3, 3, 25)
LAST = 0.008  # logarithmic step at which the search ends
ROUGH, FINE = 0.3, 2  # after this share of the coarse steps, only so many columns are followed
SURE = 0.7  # of the residual speed, below which a swing must stay to count as stopped
DOUBT, SAME = 0.03, 1.1  # share of the residual speed a swing may be off by; times to stop that agree
VAGUE, APART = 0.15, 2.0  # the same, of brakes that ring so long that their time to stop says little
ASIDE = np.linspace(-0.08, 0.08, 17)  # of log g and log w_c, where a clear stop is looked for
COST, DEAR = 0.02, 0.1  # of the merit that a clear stop may cost; the second in place of a vague one
MISSED = 100.0  # merit of a candidate that misses a limit, and more the more it does
AT_ONCE = 4000  # motions simulated side by side
LARGEST = 1e6  # value of a quantity beyond which it gets no worse
MOST_STEPS = 20  # lattices around one column
ROUNDS = 6  # of searching again after a proof has failed
COSTLY = ("authority", "error_ratio", "creep", "load_error", "noise", "damping_ratio", "stop_time", "travel")
"""Limits in the order in which candidates are asked for them."""


@dataclass(frozen=True)
class Found:
    """A certified design of one joint.

    Attributes:
        gains: One candidate, rounded as it is written.
        point: Its coordinates.
        merit: Logarithm of what was made small.
        certificate: Over the whole box.
        brake: Of the same without position loop; None where there is none.
        bare: Index of the drive without controller [N m s/rad].
        binding: What refuses the better candidates around it: limits, and "certificate".
        refusals: Tests that refused candidates, with the position loop and as brake.
    """

    gains: Gains
    point: Floats
    merit: float
    certificate: BoxCertificate
    brake: BoxCertificate | None
    bare: float
    binding: tuple[str, ...]
    refusals: tuple[tuple[Refusal, ...], tuple[Refusal, ...]]

    @property
    def margin(self) -> float:
        """Worst index over that of the bare drive [-]."""
        worst = [c.worst.value for c in (self.certificate, self.brake) if c is not None]
        return min(worst) / self.bare


@dataclass(eq=False)
class _Column:
    """Candidates of which only the last coordinate differs, ascending.

    Attributes:
        points: (rows, 5).
        merit: (rows,), infinite where a limit is not kept.
        row: The best one that is certified as far as tested.
    """

    points: Floats
    merit: Floats
    row: int = 0

    @property
    def point(self) -> Floats:
        return np.asarray(self.points[self.row])

    @property
    def best(self) -> float:
        return float(self.merit[self.row])

    def near(self, other: _Column, steps: dict[int, float], ray: int) -> bool:
        """Whether another column is this one or next to it."""
        here, there = self.points[0], other.points[0]
        close = all(abs(here[i] - there[i]) < 1.5 * step for i, step in steps.items() if i != ray)
        return bool(here[ZETA] == there[ZETA] and close)


def keeps(name: str, value: Floats, limit: float) -> NDArray[np.bool_]:
    """Whether values keep a limit."""
    return value >= limit if name in AT_LEAST else value <= limit


class JointSearch:
    """The search for one joint.

    Args:
        duty: What the joint has to do.
        wishes: Wish and limits.
        loop: Whether it has a position loop.

    Attributes:
        candidates: Looked at so far.
        passed: Merit and point of the best candidate of every column, as far as quick tests tell.
        assured: The duty by which limits and merit are judged: the weakest torque channel the drive states,
            and a stop that does not count on a swing which nearly reaches the residual speed.
    """

    def __init__(self, duty: Duty, wishes: Wishes, loop: bool) -> None:
        self.duty, self.wishes, self.loop = duty, wishes, loop
        some = Gains(*(np.ones(1) for _ in range(5)))
        self.brake = Prover(duty, duty.blocks(some, brake=True)[0], wishes.margin)
        self.prover = Prover(duty, duty.blocks(some)[0], wishes.margin) if loop else self.brake
        self.ray = KD if loop else G
        self.candidates = 0
        self.passed: list[tuple[float, Floats]] = []
        self.assured = replace(
            duty, residual=SURE * duty.residual, torque_gain=1 - duty.drive.torque_gain_error
        )
        self._soft = False
        self._released: dict[tuple[float, ...], bool] = {}
        self._motions: dict[tuple[object, ...], float] = {}

    @property
    def asked(self) -> int:
        """Exact tests made so far."""
        return self.prover.asked + (self.brake.asked if self.loop else 0)

    def gains(self, points: Floats) -> Gains:
        """Gains at points (k, 5)."""
        values = np.exp(np.where(np.arange(5) == ZETA, 0.0, points))
        kd = values[:, KD] if self.loop else 0.0
        return Gains.of(
            self.duty.drive, values[:, G], values[:, CORNER], points[:, ZETA], kd * values[:, RATIO], kd
        )

    def value(self, name: str, gains: Gains) -> Floats:
        """One quantity of many candidates, (k,)."""
        function: Callable[[Duty, Gains], Floats] = getattr(quantity, name)
        if name not in MOTIONS:
            return function(self.assured, gains)
        first, which = quantity.distinct_laws(gains)
        laws = gains[first]
        keys = [(name, *key) for key in zip(laws.R.tolist(), laws.D.tolist(), laws.K.tolist(), strict=True)]
        new = [i for i, key in enumerate(keys) if key not in self._motions]
        if new:
            for start in range(0, len(new), AT_ONCE):
                some = new[start : start + AT_ONCE]
                found = function(self.assured, laws[some]).tolist()
                self._motions.update((keys[i], value) for i, value in zip(some, found, strict=True))
        return np.array([self._motions[key] for key in keys])[which]

    def kept(self, name: str, gains: Gains) -> NDArray[np.bool_]:
        """Whether candidates keep one limit, (k,)."""
        limit = self.wishes.limits[name]
        if not self.loop and name in NEED_LOOP:
            return np.ones(len(gains), bool)
        return keeps(name, self.value(name, gains), limit)

    def _missed(self, gains: Gains) -> Floats:
        """By how much candidates miss the limits, sum of logarithms, (k,)."""
        total = np.zeros(len(gains))
        for name, limit in self.wishes.limits.items():
            if self.loop or name not in NEED_LOOP:
                value = np.clip(self.value(name, gains), 1 / LARGEST, LARGEST)
                excess = np.log(value / max(limit, 1 / LARGEST)) * (-1 if name in AT_LEAST else 1)
                total += np.maximum(excess, 0.0)
        return total

    def merit(self, gains: Gains) -> Floats:
        """Logarithm of what is to be made small, (k,)."""
        merit = np.zeros(len(gains))
        weights = dict(self.wishes.beside)
        weights[self.wishes.minimise] = weights.get(self.wishes.minimise, 0.0) + 1.0
        for name, weight in weights.items():
            if name == "load_error" and not (self.duty.load or self.duty.drive.coulomb_friction):
                value = 1 / (quantity.static_gain(self.assured, gains) * gains.kp)
            else:
                value = np.clip(self.value(name, gains), 1e-9, LARGEST)
            merit += weight * (-1 if name in AT_LEAST else 1) * np.log(value)
        return merit

    @one_thread
    def run(self) -> Found | None:
        """The best certified gains, or None where no candidate within the limits is certified."""
        if self.prover.hopeless:
            return None
        coarse = self._lattice(LOOP_POINTS if self.loop else BRAKE_POINTS)
        columns = self._scan(coarse)
        if not columns:  # what keeps all limits may lie between the points: go where they are missed least
            self._soft = True
            columns = self._scan(coarse)
        steps = {axis: values[1] - values[0] for axis, values in coarse.items() if axis != ZETA}
        basins = self._basins(columns, steps)
        for _ in range(ROUNDS):
            if not basins:
                return None
            rough = sorted((self._closer(c, steps, 1.0, ROUGH) for c in basins), key=lambda c: c.best)
            fine = [self._closer(column, steps, ROUGH, LAST / max(steps.values())) for column in rough[:FINE]]
            best = min(fine, key=lambda c: c.best)
            if best.best >= MISSED:
                return None
            found = self._proven(best.point)
            if found is not None:
                return found if self._clear(found.gains)[0] else self._clearer(found)
            # A test that had not refused anything before has: from now on it is asked early.
            basins = self._basins(columns, steps)
        return None

    def _basins(self, columns: list[_Column], steps: dict[int, float]) -> list[_Column]:
        """The best columns that are not neighbours, each with a point that is certified."""
        waiting, chosen = list(columns), list[_Column]()
        while waiting and len(chosen) < BASINS:
            column = self._settle(waiting)
            if column is None or (chosen and column.best > chosen[0].best + NEAR):
                break
            waiting = [other for other in waiting if not column.near(other, steps, self.ray)]
            chosen.append(column)
        return chosen

    def _closer(self, column: _Column, steps: dict[int, float], size: float, end: float) -> _Column:
        """The best of ever finer lattices around a column, from a share of the coarse steps to another."""
        for _ in range(MOST_STEPS):
            if size <= end:
                break
            here = column.point
            lattice = {ZETA: here[[ZETA]]}
            for axis, step in steps.items():
                values = here[axis] + size * step * (ALONG if axis == self.ray else ACROSS)
                lattice[axis] = np.unique(np.clip(values, *self.range(axis)))
            found = self._scan(lattice, column.best)
            moved = 0.0
            if found:
                column = min(found, key=lambda c: c.best)
                moved = max(abs(column.point[i] - here[i]) / (size * steps[i]) for i in lattice if i != ZETA)
            if moved < 0.99:  # not at an end of the lattice
                size /= 2
        return column

    def _settle(self, columns: list[_Column]) -> _Column | None:
        """The best column whose point is certified; columns that lose theirs are searched again."""
        while columns:
            column = min(columns, key=lambda c: c.best)
            if self.certain(column.point, "proof"):
                return column
            if not self._end(column, math.inf):
                columns.remove(column)
        return None

    def range(self, axis: int) -> tuple[float, float]:
        """Logarithms of the ends of a coordinate."""
        low, high = RANGES[axis]
        if axis == CORNER:
            high /= self.duty.period
        if axis == KD:
            most = (self.wishes.authority or 1.0) * self.duty.drive.torque_limit / self.duty.speed
            low, high = low * most, high * most
        return math.log(low), math.log(high)

    def _lattice(self, points: dict[int, int]) -> dict[int, Floats]:
        lattice = {axis: np.linspace(*self.range(axis), count) for axis, count in points.items()}
        return lattice | {ZETA: np.array(SPRINGS)}

    def certain(self, point: Floats, depth: Depth = "all") -> bool:
        """Whether a point passes the tests, as brake and with its position loop."""
        brake = not self.loop or self.brake.passes(self.block(point, brake=True), depth)
        return brake and self.prover.passes(self.block(point), depth)

    def _scan(self, lattice: dict[int, Floats], best: float = math.inf) -> list[_Column]:
        """Columns that hold something certified, as far as quick tests tell, and near the best."""
        outer = [axis for axis in lattice if axis != self.ray]
        mesh = np.meshgrid(*(lattice[axis] for axis in (*outer, self.ray)), indexing="ij")
        points = np.zeros((*mesh[0].shape, 5))
        for axis, values in zip((*outer, self.ray), mesh, strict=True):
            points[..., axis] = values
        points = points.reshape(-1, len(lattice[self.ray]), 5)
        flat = self.gains(points.reshape(-1, 5))
        self.candidates += len(flat)
        missed = self._missed(flat) if self._soft else None
        good = np.ones(len(flat), bool) if missed is None else missed == 0
        for name in sorted(self.wishes.limits, key=COSTLY.index):
            if good.any() and missed is None:
                good[good] = self.kept(name, flat[good])
        merit = np.full(len(flat), np.inf) if missed is None else MISSED + missed
        if good.any():
            merit[good] = self.merit(flat[good])
        columns = [_Column(p, m) for p, m in zip(points, merit.reshape(points.shape[:2]), strict=True)]
        columns = sorted((c for c in columns if c.merit.min() < math.inf), key=lambda c: c.merit.min())
        slack = NEAR if math.isinf(best) else 0.0
        passed = []
        for column in columns:
            if not column.merit.min() < best + slack:
                break
            if self._end(column, best + slack):
                passed.append(column)
                self.passed.append((column.best, column.point))
                best = min(best, column.best)
        return passed

    def _end(self, column: _Column, below: float) -> bool:
        """Bisects for the end of what is certified in a column; False: nothing with a merit below is."""
        rows = np.flatnonzero(column.merit < below)
        if not len(rows):
            return False
        if self.loop and not self._brakes(column.points[0]):
            return False

        def passes(i: int) -> bool:
            return self.prover.passes(self.block(column.points[rows[i]]), "quick")

        if not passes(0):
            return False
        low, high = 0, len(rows)
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (middle, high) if passes(middle) else (low, middle)
        column.row = int(rows[: low + 1][column.merit[rows[: low + 1]].argmin()])
        return True

    def _brakes(self, point: Floats) -> bool:
        """Whether the gains without position loop pass the quick tests; asked once for each."""
        key = (*point[[G, CORNER, ZETA]].tolist(), len(self.brake.refusals))
        if key not in self._released:
            self._released[key] = self.brake.passes(self.block(point, brake=True), "quick")
        return self._released[key]

    def block(self, point: Floats, *, brake: bool = False) -> NDArray[np.void]:
        """The controller at a point, a record of `dashpot.control.sampled.BLOCK_DTYPE`."""
        block: NDArray[np.void] = self.duty.blocks(self.gains(point[None]), brake=brake)[0]
        return block

    def _proven(self, point: Floats) -> Found | None:
        """The design at a point with its certificates, or None where one fails; its reason is remembered."""
        gains = self.gains(point[None])
        block, brake = self.duty.blocks(gains)[0], self.duty.blocks(gains, brake=True)[0]
        if not self.certain(point):
            return None
        good, certificate = self.prover.certificate(block)
        released = None
        if good and self.loop:
            good, released = self.brake.certificate(brake)
        if not good:
            return None
        return Found(
            gains,
            point,
            float(self.merit(gains)[0]),
            certificate,
            released,
            self.prover.bare,
            self._binding(point),
            (self.prover.refusals, self.brake.refusals),
        )

    def _clear(self, gains: Gains, doubt: float = DOUBT, same: float = SAME) -> NDArray[np.bool_]:
        """Whether the time to stop hangs on no swing that just reaches the residual speed, (k,)."""
        early, late = (
            quantity.stop_time(replace(self.duty, residual=share * self.duty.residual), gains)
            for share in (1 + doubt, 1 - doubt)
        )
        return np.asarray(late <= same * early)

    def _clearer(self, found: Found) -> Found:
        """A design next to one whose time to stop is in doubt, little worse and clear; else the same."""
        points = found.point + np.stack(np.meshgrid(ASIDE, ASIDE), -1).reshape(-1, 2) @ np.eye(5)[[G, CORNER]]
        gains = self.gains(points)
        merit = self.merit(gains)
        vague = not self._clear(found.gains, VAGUE, APART)[0]
        good = merit < found.merit + (DEAR if vague else COST)
        for name in self.wishes.limits:
            good[good] = self.kept(name, gains[good])
        good[good] = self._clear(gains[good])
        for i in np.argsort(merit):
            if good[i] and self.certain(points[i]):
                return self._proven(points[i]) or found
        return found

    def _binding(self, point: Floats) -> tuple[str, ...]:
        """What refuses the candidates nearby that would be better."""
        axes = (G, CORNER, RATIO, KD) if self.loop else (G, CORNER)
        moves = [step * unit for unit in np.eye(5)[list(axes)] for step in (-0.03, 0.03)]
        near = self.gains(point + np.array(moves))
        better = near[self.merit(near) < float(self.merit(self.gains(point[None]))[0]) - 1e-3]
        names = [name for name in self.wishes.limits if len(better) and not self.kept(name, better).all()]
        free = np.ones(len(better), bool)
        for name in names:
            free &= self.kept(name, better)
        blocks, brakes = self.duty.blocks(better), self.duty.blocks(better, brake=True)
        refused = [
            not (self.brake.passes(brakes[i]) and self.prover.passes(blocks[i])) for i in np.flatnonzero(free)
        ]
        return (*names, *(["certificate"] if any(refused) else []))
