"""Evidence for `dashpot design`: are its predictions true, and is there nothing better?

Four parts, each printed as JSON: "predictions": random drives under every preset, each result simulated;
"brute": designs against 100,000 points of a low-discrepancy sequence; "arms": the bundled arms against the
hand-picked gains of their bundled controllers (`dashpot.studies.designs_arms`); "proof": that the one design
that was refused does not exist (`dashpot.studies.designs_proof`).
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from typing import Any

import numpy as np

from dashpot.arm.robot import Robot
from dashpot.certify.certificate import certify_joint
from dashpot.certify.threads import one_thread
from dashpot.design import candidates as quantity
from dashpot.design.design import design_joint, duties
from dashpot.design.search import COSTLY, JointSearch
from dashpot.design.spec import Spec
from dashpot.design.wishes import PRESETS
from dashpot.studies.designs_bench import SWING, bench, creep, load_error, stop
from dashpot.studies.designs_cases import random_duty, scattered
from dashpot.support.workers import cores

COMPARED = ("stop_time", "creep", "error_ratio")
DRIVES, POINTS = 50, 100_000
TOLERANCE = 0.15  # of a prediction
STILL = 1e-4  # [rad/s] that counts as held
LONGEST = 150.0  # [s] of creeping until the virtual spring has taken over
EDGES = (1.15, 0.85)  # of the residual speed: a swing may just reach it
LOST = 10.0  # relative error where nothing was to move and something did
RETRIED = 30  # better points refused by the proof in one piece that get the whole proof
CASES = (("k807", "joint5"), ("fr3", "joint2"), ("fr3", "joint7"), ("iiwa14", "joint4"))
"""Joints searched by brute force, with the largest payload of 3 kg at 0.1 m."""


def predicted(seed: int, number: int, preset: str) -> dict[str, Any]:
    """Designs one random drive and simulates what comes out."""
    duty = random_duty(seed, number)
    drive, name = duty.drive, duty.drive.name
    design = design_joint(duty, PRESETS[preset], preset != "brake")
    if design.found is None:
        assert design.conflict is not None
        return {
            "drive": number,
            "preset": preset,
            "feasible": False,
            "conflict": list(design.conflict.wishes),
            "reason": design.conflict.reason,
            "change": design.conflict.change,
        }
    gains = design.found.gains.joint(name)
    verdict = certify_joint(duty.drive, gains, duty.config((gains,)))
    g = design.found.gains
    _, stopped = stop(duty, gains, seed)
    on = bench(duty, gains)
    # Load that moves the brake, where the motor can hold it at all.
    load = min(max(duty.load, 1.5 * design.predicted["hold"]), 0.8 * duty.drive.torque_limit)
    expected = float(quantity.creep(replace(duty, load=load), g)[0])
    a = g.R[0] * duty.drive.viscous_friction + g.D[0]
    change_over = float((g.D[0] + g.R[0] * a) / ((1 + g.R[0]) * g.K[0])) if g.K[0] else 0.0
    row: dict[str, Any] = {
        "drive": number,
        "preset": preset,
        "feasible": True,
        "certified": verdict.certified and (verdict.brake is None or verdict.brake.proven),
        "margin": design.found.margin,
        "stop_time": [design.predicted["stop_time"], stopped],
        "stop_between": [
            float(quantity.stop_time(replace(duty, residual=share * duty.residual), g)[0]) for share in EDGES
        ],
        "creep": [expected, creep(on, load, seed, settling=min(LONGEST, 6 + 5 * change_over))],
    }
    if preset != "brake":
        with_law, alone = load_error(on, duty.load, seed), load_error(on, duty.load, seed, bypass=True)
        row["error_ratio"] = [design.predicted["error_ratio"], with_law / alone]
        row["friction_band"] = drive.coulomb_friction / gains.kp
    return row


def off(pair: list[float]) -> float:
    """By how much a simulation differs from its prediction, relative; what is held both times does not."""
    expected, seen = pair
    if abs(expected) < STILL:
        return 0.0 if abs(seen) < 3 * STILL else LOST
    return abs(seen / expected - 1)


@one_thread
def brute(robot: str, joint: str, preset: str, points: int) -> dict[str, Any]:
    """Looks for something better than a design among points spread evenly over the whole range."""
    spec = Spec.load(preset).changed(payload=3.0, offset=(0.1, 0.0, 0.0), joints=(joint,))
    if robot == "k807":
        spec = spec.changed(period=0.005, pose="home", gravity_compensated=False)
    duty = duties(Robot.load(robot), spec)[0]
    search = JointSearch(duty, spec.of(joint), spec.loop)
    found = search.run()
    row: dict[str, Any] = {"robot": robot, "joint": joint, "preset": preset, "points": points}
    at = scattered(search, points)
    gains = search.gains(at)
    good = np.ones(points, bool)
    for name in sorted(search.wishes.limits, key=COSTLY.index):
        good[good] = search.kept(name, gains[good])
    merit = np.full(points, np.inf)
    merit[good] = search.merit(gains[good])
    best = np.inf if found is None else found.merit
    better = np.argsort(merit)[: int((merit < best - 1e-3).sum())]
    row |= {"within_limits": int(good.sum()), "better_but_for_the_certificate": len(better), "gain": 0.0}
    retried = 0
    for i in better:
        passed = search.certain(at[i])
        refused = search.prover.last_refusal
        if not passed and refused is not None and refused[0] == "proof" and retried < RETRIED:
            retried += 1
            passed = all(
                prover.certificate(search.block(at[i], brake=brake))[0]
                for prover, brake in {(search.brake, True), (search.prover, not search.loop)}
            )
        if passed:
            row["gain"] = None if found is None else float(1 - np.exp(merit[i] - best))
            break
    row["feasible"] = found is not None
    return row


def _each(label: str, results: Iterator[dict[str, Any]], count: int) -> list[dict[str, Any]]:
    done = []
    for result in results:
        done.append(result)
        print(f"\r{label} {len(done)}/{count} ", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    return done


def predictions(seed: int, drives: int, pool: ProcessPoolExecutor) -> dict[str, Any]:
    """Designs random drives and simulates them."""
    tasks = [(seed, n, preset) for n in range(drives) for preset in PRESETS]
    return summary(_each("designs", pool.map(predicted, *zip(*tasks, strict=True)), len(tasks)))


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """What came out of many rows of `predicted`; those outside the tolerance in full."""
    done = [row for row in rows if row["feasible"]]
    infeasible = [row for row in rows if not row["feasible"]]
    found: dict[str, Any] = {
        "designs": len(rows),
        "feasible": len(done),
        "certified": sum(row["certified"] for row in done),
    }
    outside = []
    for name in COMPARED:
        rows = [row for row in done if name in row and not (name == "error_ratio" and held(row))]
        errors = np.array([off(row[name]) for row in rows])
        found[name] = {
            "compared": len(errors),
            "within_15_percent": int((errors <= TOLERANCE).sum()),
            "median": float(np.median(errors)),
            "worst": float(errors.max()),
        }
        outside += [row for row, error in zip(rows, errors, strict=True) if error > TOLERANCE]
    found["held_by_friction"] = [row for row in done if held(row)]
    return found | {"outside": outside, "infeasible": infeasible}


def held(row: dict[str, Any]) -> bool:
    """Whether friction alone keeps the joint from following the slow motion, so that it has no mean error."""
    return bool(row.get("friction_band", 0.0) > SWING)


def searches(points: int, pool: ProcessPoolExecutor) -> dict[str, Any]:
    """Looks for better designs by brute force."""
    cases = [(*case, preset, points) for case in CASES for preset in PRESETS]
    rows = _each("searches", pool.map(brute, *zip(*cases, strict=True)), len(cases))
    gains = [row["gain"] for row in rows]
    return {
        "largest_gain": max((g for g in gains if g is not None), default=0.0),
        "missed": sum(g is None for g in gains),
        "cases": rows,
    }


def main() -> None:
    """``python -m dashpot.studies.designs predictions|brute|arms|proof [SEED [DRIVES]]``."""
    part, *numbers = sys.argv[1:]
    seed, drives = (int(n) for n in (*numbers, *("0", str(DRIVES))[len(numbers) :]))
    start = time.perf_counter()
    result: dict[str, Any] = {"command": " ".join(["python -m dashpot.studies.designs", *sys.argv[1:]])}
    if part == "arms":
        from dashpot.studies.designs_arms import arms

        result["arms"] = arms()
    elif part == "proof":
        from dashpot.studies.designs_proof import proof

        result |= proof()
    else:
        with ProcessPoolExecutor(cores(), get_context("spawn")) as pool:
            if part == "predictions":
                result |= {"seed": seed, **predictions(seed, drives, pool)}
            else:
                result |= searches(POINTS, pool)
    result["seconds"] = round(time.perf_counter() - start)
    print(json.dumps(result, indent=1, allow_nan=False, default=float))


if __name__ == "__main__":
    main()
