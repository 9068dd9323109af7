"""Tries to prove the certificate wrong: random joints, thousands of loads on each, and the simulator.

- Soundness: no joint with a positive index may oscillate with any load tried; the same inside proven boxes.
- Tightness: how many of the refused joints have a load that one can name.
- Replays in the nonlinear simulator: `dashpot.studies.soundness_replays`.

A joint follows from (seed, number) alone. ``python -m dashpot.studies.soundness`` prints the result as JSON.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import os
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar

import numpy as np

from dashpot.arm.drive import Drive
from dashpot.certify.box import Box, at, certify_box
from dashpot.certify.counterexample import Counterexample, counterexample
from dashpot.certify.index import passivity_index
from dashpot.certify.joint import SampledJoint, Scales, sampled_joint
from dashpot.certify.loads import GROWS, radii
from dashpot.studies.soundness_cases import INERTIAS, LENGTHS, MASSES, SPRINGS, case, loads, random_point
from dashpot.studies.soundness_checks import precise_radius, single_frequency

UNCERTAINTY = {"rotor_inertia": 0.3, "viscous_friction": 0.5, "stiffness": 0.3, "damping": 0.6}  # largest
GAIN_ERROR = 0.05  # largest
JOINTS, BOXES, SAMPLES = 10_000, 300, 50
SMALL = 0.01  # of viscous friction plus damping: an index that hardly matters
SEARCHED = 1000  # joints that are searched as `counterexample` does, too, where they are certified
SECOND_LOOKS = 5  # loads of a joint that are looked at in higher precision
KEPT = 100  # verdicts written one by one
CHUNK = 20
CERTIFIED, UNDECIDED, REFUTED, REFUSED = "cuxr"
"""Verdicts: certified; undecided; refused, and a load oscillates; refused, none found."""

T = TypeVar("T")


@dataclass(frozen=True)
class Scan:
    """What the loads did to one joint.

    Attributes:
        radius: Largest spectral radius, rounding included.
        looks: Loads above ``1 + GROWS`` that were looked at again.
        unstable: (inertia [kg m^2], stiffness [N m/rad], radius) of those that do grow.
    """

    radius: float
    looks: int
    unstable: tuple[tuple[float, float, float], ...]


def scan(joint: SampledJoint, drive: Drive, *, search: bool = False) -> Scan:
    """Hangs every load on a joint; growth is believed in 60 digits only.

    Args:
        joint: The joint.
        drive: Its drive.
        search: Whether to add the load that `counterexample` climbs to, if it finds one.
    """
    inertia, stiffness = loads(drive)
    found = counterexample(joint, drive) if search else None
    if found is not None:
        inertia, stiffness = (
            np.append(inertia, found.load.inertia),
            np.append(stiffness, found.load.stiffness),
        )
    radius = radii(joint, inertia, stiffness)
    above = [int(i) for i in np.argsort(radius)[::-1][:SECOND_LOOKS] if radius[i] > 1 + GROWS]
    again = [(float(inertia[i]), float(stiffness[i])) for i in above]
    precise = [(*load, precise_radius(joint, *load)) for load in again]
    return Scan(float(radius.max()), len(above), tuple(row for row in precise if row[2] > 1 + GROWS))


@dataclass(frozen=True)
class Verdict:
    """What was found for one joint.

    Attributes:
        number: Of the joint.
        kind: `CERTIFIED`, `UNDECIDED`, `REFUTED` or `REFUSED`.
        loop: Whether it has a position loop.
        index: Its index [N m s/rad].
        scan: Where it is certified or undecided.
        counterexample: Where it is refused.
        small: Whether the index is within `SMALL` of zero.
        single: Least damping shown to a motion of a single frequency [N m s/rad], where none was found.
    """

    number: int
    kind: str
    loop: bool
    index: float
    scan: Scan | None = None
    counterexample: Counterexample | None = None
    small: bool = False
    single: float = math.nan


def judge(seed: int, number: int) -> Verdict:
    """Certifies a joint and tries to prove the verdict wrong."""
    it = case(seed, number)
    index, joint, loop = it.index(), it.joint(), it.gains.kp > 0
    small = abs(index.value) < SMALL * (it.drive.viscous_friction + it.drive.damping)
    if index.passive or not index.decided:
        kind = CERTIFIED if index.passive else UNDECIDED
        seen = scan(joint, it.drive, search=number < SEARCHED)
        return Verdict(number, kind, loop, index.value, seen, small=small)
    found = counterexample(joint, it.drive)
    if found is not None:
        return Verdict(number, REFUTED, loop, index.value, counterexample=found, small=small)
    single = single_frequency(joint, index.frequency)
    return Verdict(number, REFUSED, loop, index.value, small=small, single=single)


@dataclass(frozen=True)
class BoxVerdict:
    """What was found inside one box.

    Attributes:
        number: Of the joint.
        proven: Whether `certify_box` proves it.
        reason: Why not, where no point of the box is known to fail.
        exceptions: Points with a negative index, or an oscillating load, inside a proven box.
        undecided: Points without a decided index inside a proven box.
        missed: How far the smallest index sampled lies below ``worst.value``, relative; negative: above.
    """

    number: int
    proven: bool
    reason: str = ""
    exceptions: int = 0
    undecided: int = 0
    missed: float = 0.0


def judge_box(seed: int, number: int, samples: int = SAMPLES) -> BoxVerdict:
    """Certifies a random box about a joint and looks into it: index at random points, loads at the worst."""
    it, rng = case(seed, number), np.random.default_rng([seed, number, 1])
    wide = {name: float(rng.uniform(0, largest)) for name, largest in UNCERTAINTY.items()}
    it = replace(
        it, drive=replace(it.drive, uncertainty=wide, torque_gain_error=float(rng.uniform(0, GAIN_ERROR)))
    )
    block, sampling, period = it.block, it.config.sampling, it.config.period
    latency_max = it.config.latency + int(rng.integers(0, 2))
    found = certify_box(it.drive, block, sampling, period, latency_max)
    if not found.proven:
        return BoxVerdict(number, False, "unproven" if found.worst.passive else "worst point fails")
    box = Box.of(it.drive, block, latency_max)
    points = [random_point(box, rng, corner=bool(i % 3 == 0)) for i in range(samples)]
    there: list[tuple[Drive, Scales]] = [at(it.drive, point) for point in points]
    indices = [passivity_index(drive, block, sampling, period, scales) for drive, scales in there]
    values = [index.value for index in indices]
    drive, scales = there[int(np.argmin(values))]
    scanned = scan(sampled_joint(drive, block, sampling, period, scales), drive)
    return BoxVerdict(
        number,
        True,
        exceptions=sum(value <= 0 for value in values) + len(scanned.unstable),
        undecided=sum(not index.decided for index in indices),
        missed=1 - min(values) / found.worst.value,
    )


def spread(work: Callable[[Any], T], tasks: Sequence[Any], workers: int, label: str) -> list[T]:
    """Does some work for each task on several processes; the result does not depend on how many."""
    done: list[T] = []
    chunk = max(1, min(CHUNK, len(tasks) // (4 * workers)))
    start = time.perf_counter()
    # Fresh processes: they read the number of threads a matrix may use when they load the library.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context) as pool:
        for i, result in enumerate(pool.map(work, tasks, chunksize=chunk), 1):
            done.append(result)
            if i % 200 == 0 or i == len(tasks):
                print(f"{label}: {i} of {len(tasks)}, {time.perf_counter() - start:.0f} s", file=sys.stderr)
    return done


def summary(verdicts: Sequence[Verdict]) -> dict[str, Any]:
    """Counts of the first and third part, for JSON."""
    of = {kind: [v for v in verdicts if v.kind == kind] for kind in (CERTIFIED, UNDECIDED, REFUTED, REFUSED)}
    refused = of[REFUTED] + of[REFUSED]
    stable = [v for v in refused if v.index > -math.inf]  # with its link held
    scans = [v.scan for v in of[CERTIFIED] if v.scan is not None]
    looped = [v for v in verdicts if v.loop]

    def share(some: Sequence[Verdict]) -> float | None:
        return sum(v.kind == REFUTED for v in some) / len(some) if some else None

    return {
        "soundness": {
            "joints": len(verdicts),
            "certified": len(of[CERTIFIED]),
            "refused": len(refused),
            "undecided": len(of[UNDECIDED]),
            "with_position_loop": len(looped),
            "with_position_loop_certified": sum(v.kind == CERTIFIED for v in looped),
            "loads_per_joint": len(INERTIAS) * len(SPRINGS) + len(MASSES) * len(LENGTHS),
            "certified_and_searched_for_a_load": sum(v.number < SEARCHED for v in of[CERTIFIED]),
            "exceptions": sum(bool(s.unstable) for s in scans),
            "exceptional": [v.number for v in of[CERTIFIED] if v.scan is not None and v.scan.unstable],
            "second_looks": sum(s.looks for s in scans),
            "largest_radius_minus_1": max((s.radius - 1 for s in scans), default=None),
            "undecided_joints": [
                {
                    "number": v.number,
                    "index": v.index,
                    "loads_that_oscillate": v.scan is not None and bool(v.scan.unstable),
                }
                for v in of[UNDECIDED]
            ],
        },
        "tightness": {
            "refused": len(refused),
            "load_found": len(of[REFUTED]),
            "share": share(refused),
            "share_of_those_stable_with_the_link_held": share(stable),
            "unstable_with_the_link_held": len(refused) - len(stable),
            "kinds_of_load": {
                kind: sum(
                    v.counterexample is not None and v.counterexample.load.kind == kind for v in refused
                )
                for kind in ("inertia", "pendulum", "inertia and spring")
            },
            "without_load": {
                "active_only_with_aliases": sum(v.single > 0 for v in of[REFUSED]),
                "active_at_one_frequency": sum(v.single <= 0 for v in of[REFUSED]),
                "index_within_1_percent_of_zero": sum(v.small for v in of[REFUSED]),
                "one_frequency": [
                    {"number": v.number, "index": v.index, "at_one_frequency": v.single}
                    for v in of[REFUSED]
                    if v.single <= 0
                ],
            },
        },
        "verdicts": "".join(v.kind for v in verdicts[:KEPT]),
    }


def box_summary(verdicts: Sequence[BoxVerdict]) -> dict[str, Any]:
    """Counts of the second part, for JSON."""
    proven = [v for v in verdicts if v.proven]
    return {
        "boxes": len(verdicts),
        "proven": len(proven),
        "worst_point_fails": sum(v.reason == "worst point fails" for v in verdicts),
        "unproven": sum(v.reason == "unproven" for v in verdicts),
        "points_per_box": SAMPLES,
        "exceptions": sum(v.exceptions for v in proven),
        "exceptional": [v.number for v in proven if v.exceptions],
        "undecided_points": sum(v.undecided for v in proven),
        "worst_missed_by_5_percent": sum(v.missed > 0.05 for v in proven),
        "worst_missed_by_0.2_percent": sum(v.missed > 0.002 for v in proven),
        "largest_miss": max((v.missed for v in proven), default=None),
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the study as `make evidence-certify` does."""
    from dashpot.studies import soundness_replays

    parser = argparse.ArgumentParser(description="Tries to prove the certificate wrong.")
    parser.add_argument("--joints", type=int, default=JOINTS)
    parser.add_argument("--boxes", type=int, default=BOXES)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    options = parser.parse_args(arguments)
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ[name] = "1"  # the matrices are small
    start, seed, workers = time.perf_counter(), options.seed, options.workers
    verdicts = spread(partial(judge, seed), range(options.joints), workers, "joints")
    certified = [v.number for v in verdicts if v.kind == CERTIFIED]
    boxes = spread(partial(judge_box, seed), certified[: options.boxes], workers, "boxes")
    calm, wild = soundness_replays.chosen(seed, verdicts)
    tasks = [(CERTIFIED, number) for number in calm] + [(REFUTED, number) for number in wild]
    rows = spread(partial(soundness_replays.replayed, seed), tasks, workers, "replays")
    result: dict[str, Any] = {
        "command": f"python -m dashpot.studies.soundness --joints {options.joints} --seed {seed}",
        "seed": seed,
        **summary(verdicts),
        "boxes": box_summary(boxes),
        "replays": soundness_replays.summary(rows[: len(calm)], rows[len(calm) :]),
        "seconds": round(time.perf_counter() - start, 1),
    }
    print(json.dumps(result, indent=2))


if __name__ == "__main__":
    main()
