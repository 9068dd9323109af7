"""Tries to prove the identification wrong: random drives, their logs from the simulator, and blind logs.

- Coverage: how often the 95 % intervals hold the simulated drive's values; errors; what was refused.
- Comparison: plain least squares on differentiated data, on the same logs.
- Blind logs: each hides some quantities, all of which must be refused.

A log follows from (seed, number) alone. ``python -m dashpot.studies.identification`` prints the result as
JSON.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from dashpot.errors import InputWarning
from dashpot.identify import identify_joint
from dashpot.identify.estimate import DriveEstimate
from dashpot.logs.log import Log
from dashpot.studies.identification_blind import KINDS
from dashpot.studies.identification_cases import JOINT, Bench, known, random_bench, simulate, to_log, truth
from dashpot.studies.soundness import spread

DRIVES, SEEDS = 200, 5
RECORDED = 20  # drives whose estimates are kept one by one
COMPARED = ("rotor_inertia", "viscous_friction", "coulomb_friction")


@dataclass(frozen=True)
class Verdict:
    """One log.

    Attributes:
        number: Of the drive.
        truth: The simulated values.
        found: Quantity -> (value, low, high).
        refused: Quantities refused, with the reason.
        plain: What plain least squares gives.
        period: Of the log [s].
        seconds: Time the identification took [s].
    """

    number: int
    truth: dict[str, float]
    found: dict[str, tuple[float, float, float]]
    refused: dict[str, str]
    plain: dict[str, float]
    period: float
    seconds: float


def judge(seed: int, number: int) -> Verdict:
    """Simulates and identifies one random drive."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)  # some drives are unusual on purpose
        bench = random_bench(seed, number)
        step = bench.plant().timestep
        log = to_log(bench, simulate(bench, seed, number))
        sensor = known(bench, step)
    start = time.perf_counter()
    estimate = identify_joint(log, JOINT, sensor)
    return Verdict(
        number,
        truth(bench, step),
        {name: (e.value, e.low, e.high) for name, e in estimate.values.items()},
        reasons(estimate),
        plain_least_squares(log),
        bench.period,
        time.perf_counter() - start,
    )


def reasons(estimate: DriveEstimate) -> dict[str, str]:
    """Quantity -> why it was refused."""
    return {name: refusal.reason for refusal in estimate.refused for name in refusal.quantities}


def plain_least_squares(log: Log) -> dict[str, float]:
    """``u = alpha tau + m q'' + v q' + tau_c sgn q' + b`` with central differences, sample by sample."""
    h, segment = log.period, log.segments[0]
    assert segment.position is not None
    q = segment.position[:, 0]
    speed = (q[2:] - q[:-2]) / (2 * h)
    acceleration = (q[2:] - 2 * q[1:-1] + q[:-2]) / h**2
    X = np.stack(
        [segment.torque[1:-1, 0], acceleration, speed, np.sign(speed), np.ones(len(speed))],
        1,
    )
    theta = np.linalg.lstsq(X, segment.command[1:-1, 0], rcond=None)[0]
    return dict(zip(COMPARED, theta[1:4].tolist(), strict=True))


def judge_blind(seed: int, kind: str, number: int) -> tuple[str, int, list[str], dict[str, str]]:
    """One blind log: (kind, number, what is missing among the refused, what was refused and why)."""
    blind = KINDS[kind]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        bench: Bench = blind.bench(seed, number)
        # A kind is told from the others by its place in the list as well.
        log = blind.make(bench, np.random.default_rng([seed, number, 2, list(KINDS).index(kind)]))
        sensor = known(bench, bench.plant().timestep)
    refused = reasons(identify_joint(log, JOINT, sensor))
    return kind, number, [name for name in blind.hidden if name not in refused], refused


def summary(verdicts: Sequence[Verdict]) -> dict[str, Any]:
    """Coverage and errors per quantity, for JSON."""
    rows: dict[str, Any] = {}
    inside = total = 0
    for name in verdicts[0].truth:
        asked = [v for v in verdicts if not name.startswith("stribeck") or v.truth["stribeck_friction"] > 0]
        given = [v for v in verdicts if name in v.found]
        if not given:
            continue
        values = np.array([(v.truth[name], *v.found[name]) for v in given])
        held = (values[:, 2] <= values[:, 0]) & (values[:, 0] <= values[:, 3])
        inside, total = inside + int(held.sum()), total + len(held)
        error = np.abs(values[:, 1] - values[:, 0])
        relative = name not in ("torque_bias", "torque_scale_error", "latency")
        scale = np.abs(values[:, 0]) if relative else 1.0
        rows[name] = {
            "given": len(given),
            "of": len(asked),
            "covered": round(float(held.mean()), 4),
            "median_error": float(np.median(error / scale)),
            "median_half_width": float(np.median((values[:, 3] - values[:, 2]) / 2 / scale)),
            "relative": relative,
        }
        if name in COMPARED:
            plain = np.array([v.plain[name] for v in given])
            rows[name]["median_error_of_plain_least_squares"] = float(
                np.median(np.abs(plain - values[:, 0]) / scale)
            )
    whole = sum(all(name in v.found for name in COMPARED) for v in verdicts)
    complete = sum(not v.refused for v in verdicts)
    return {
        "drives": len(verdicts),
        "inertia_and_friction_identified": whole,
        "everything_identified": complete,
        "covered": round(inside / total, 4),
        "quantities": rows,
        "median_seconds": float(np.median([v.seconds for v in verdicts])),
        "refusals": sorted(
            {f"{name}: {reason}" for v in verdicts for name, reason in v.refused.items() if name in COMPARED}
        ),
    }


def held(verdict: Verdict) -> tuple[int, int]:
    """How many of the intervals given hold the truth, and how many were given."""
    inside = [low <= verdict.truth[name] <= high for name, (_, low, high) in verdict.found.items()]
    return sum(inside), len(inside)


def each(verdict: Verdict) -> dict[str, Any]:
    """One drive, for JSON: what the tests make again."""
    inside, given = held(verdict)
    values = {name: float(f"{verdict.found[name][0]:.6g}") for name in COMPARED if name in verdict.found}
    return {"held": inside, "given": given, "estimates": values}


def study(seed: int, drives: int, seeds: int, workers: int) -> dict[str, Any]:
    """The whole study."""
    verdicts = spread(partial(judge, seed), list(range(drives)), workers, "drives")
    tasks = [(kind, number) for kind in KINDS for number in range(seeds)]
    blind = spread(partial(_blind, seed), tasks, workers, "blind logs")
    kinds = {
        kind: {
            "logs": seeds,
            "refused": sum(not missing for k, _, missing, _ in blind if k == kind),
            "must_refuse": list(KINDS[kind].hidden),
            "says": next((next(iter(why.values()), "") for k, _, _, why in blind if k == kind), ""),
        }
        for kind in KINDS
    }
    return {
        "random_drives": summary(verdicts) | {"each": [each(verdict) for verdict in verdicts[:RECORDED]]},
        "blind_logs": {
            "logs": len(blind),
            "refused": sum(not missing for _, _, missing, _ in blind),
            "kinds": kinds,
            "missed": [[kind, number, missing] for kind, number, missing, _ in blind if missing],
        },
    }


def _blind(seed: int, task: tuple[str, int]) -> tuple[str, int, list[str], dict[str, str]]:
    return judge_blind(seed, *task)


def main() -> None:
    """Prints the study as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--drives", type=int, default=DRIVES)
    parser.add_argument("--seeds", type=int, default=SEEDS, help="logs per kind of blind log")
    parser.add_argument("--workers", type=int, default=max(1, os.cpu_count() or 1))
    given = parser.parse_args()
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    start = time.perf_counter()
    result = study(given.seed, given.drives, given.seeds, given.workers)
    command = f"python -m dashpot.studies.identification --seed {given.seed} --drives {given.drives}"
    print(json.dumps({"command": f"{command} --seeds {given.seeds}", "seed": given.seed, **result}, indent=1))
    print(f"{time.perf_counter() - start:.0f} s", file=sys.stderr)


if __name__ == "__main__":
    main()
