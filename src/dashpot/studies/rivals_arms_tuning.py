"""Tuning for `dashpot.studies.rivals_arms`: every law once per drive type, by one procedure and budget."""

from __future__ import annotations

import sys
from dataclasses import asdict
from typing import Any

from dashpot.laws import to_table
from dashpot.studies.rivals_arms_cases import Arm, benches
from dashpot.studies.rivals_tuning import ENTRIES, tune

PD = next(entry for entry in ENTRIES if entry.law == "pd")


def tuned(arm: Arm, budget: int, seed: int) -> dict[str, Any]:
    """Drive type -> the joint it was tuned on, and per law its numbers and how they were judged; for JSON.

    A law with n numbers gets n times the budget: more numbers are harder to find with as many tries.

    PD comes first: its position loop moves the joint before a brake takes over, in the tuning of all brakes
    and on the arm.
    """
    found: dict[str, Any] = {}
    for kind, bench in benches(arm).items():
        mover: dict[str, float] | None = None
        rows = {}
        for entry in sorted(ENTRIES, key=lambda entry: entry is not PD):
            sets = max(1, budget * len(entry.tuned))
            law, judged, feasible = tune(entry, sets, seed, bench=bench, mover=mover)
            if entry is PD:
                mover = {"kp": vars(law)["kp"], "kd": vars(law)["kd"]}
            duty = "brake" if entry.brake else "tracker"
            print(f"{arm.name} {kind}: {duty} {law.text}", file=sys.stderr, flush=True)
            rows[f"{duty} {entry.law}"] = {
                "law": to_table(law),
                "sets": sets,
                "sets_within_limits": feasible,
                "value": float(f"{judged.value:.4g}"),
                "damping_ratio": float(f"{judged.damping:.3g}"),
                "noise": float(f"{judged.noise:.3g}"),
            }
        found[kind] = {"joints": list(arm.types[kind]), "bench": asdict(bench), "laws": rows}
    return found
