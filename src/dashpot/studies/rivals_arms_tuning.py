"""Tuning for `dashpot.studies.rivals_arms`: every law once per drive type, by one procedure and budget."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from dashpot.control.laws import to_table
from dashpot.studies.rivals_arms_cases import Arm, benches
from dashpot.studies.rivals_arms_parts import Parts
from dashpot.studies.rivals_bench import Bench
from dashpot.studies.rivals_tuning import ENTRIES, Entry, tune

PD = next(entry for entry in ENTRIES if entry.law == "pd")


def tuned(arm: Arm, budget: int, seed: int, parts: Parts) -> dict[str, Any]:
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
            name = f"{'brake' if entry.brake else 'tracker'} {entry.law}"
            row = parts.made(
                f"tuning {arm.name} {kind} {name}",
                [asdict(bench), asdict(entry), sets, seed, mover if entry.brake else None],
                lambda entry=entry, sets=sets, bench=bench, mover=mover: _row(  # type: ignore[misc]
                    entry, sets, seed, bench, mover
                ),
            )
            if entry is PD:
                mover = {key: row["law"][key] for key in ("kp", "kd")}
            print(f"{arm.name} {kind}: {name} {row['law']}", file=sys.stderr, flush=True)
            rows[name] = row
        found[kind] = {"joints": list(arm.types[kind]), "bench": asdict(bench), "laws": rows}
    return found


def _row(
    entry: Entry, sets: int, seed: int, bench: Bench, mover: Mapping[str, float] | None
) -> dict[str, Any]:
    law, judged, feasible = tune(entry, sets, seed, bench=bench, mover=mover)
    return {
        "law": to_table(law),
        "sets": sets,
        "sets_within_limits": feasible,
        "value": float(f"{judged.value:.4g}"),
        "damping_ratio": float(f"{judged.damping:.3g}"),
        "noise": float(f"{judged.noise:.3g}"),
    }
