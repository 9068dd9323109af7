"""The readiness gate at length: where every fault ends, from thousands of scenarios of the bundled preset.

``python -m dashpot.studies.readiness`` runs the preset (or goes on where it was stopped) and prints the
result as JSON. With ``--scenarios`` it takes that many, in chunks drawn at random from the whole, so that
every fault, payload and pose has its share.
"""

from __future__ import annotations

import argparse
import json
import math
import shlex
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from dashpot.campaign.execute import execute
from dashpot.campaign.judge import judge, passed
from dashpot.campaign.scenario import OK, Campaign
from dashpot.campaign.spec import Spec
from dashpot.campaign.store import Store, attributes, check_same, create, open_dataset
from dashpot.commands.campaign_view import progress_bar
from dashpot.control.supervisor import STATES
from dashpot.simulation.engine import quiet_engine

SEED = 1  # of the chunks that are drawn


def evidence(
    spec: Spec, out: Path, scenarios: int | None = None, workers: int | None = None
) -> dict[str, Any]:
    """Runs a campaign, whole or in part, and says what came of every fault.

    Args:
        spec: With the axis "fault" and a supervisor.
        out: Its dataset; continued where it exists.
        scenarios: At least so many; None: all.
        workers: As of `execute`.
    """
    campaign = Campaign(spec)
    campaign.check()
    if out.exists():
        check_same(out, attributes(out), campaign)
    else:
        create(out, campaign)
    order = np.random.default_rng(SEED).permutation(spec.chunks).tolist()
    sizes = np.cumsum([len(spec.chunk_indices(chunk)) for chunk in order])
    taken = len(order) if scenarios is None else int(np.searchsorted(sizes, scenarios)) + 1
    store = Store(out, campaign)
    try:
        with progress_bar(int(sizes[min(taken, len(order)) - 1]), 0) as advance:
            execute(campaign, store, workers=workers, advance=advance, chunks=order[:taken])
    finally:
        store.close()
    with open_dataset(out) as dataset:
        return summary(spec, dataset)


def summary(spec: Spec, dataset: Any) -> dict[str, Any]:
    """Verdicts, and per fault the end states and extremes, of the scenarios that are done."""
    status = dataset["status"].values.ravel()
    good, fault = passed(spec, dataset), dataset["fault"].broadcast_like(dataset["status"])
    names = fault.transpose(*spec.dims).values.ravel()

    def flat(name: str) -> Any:
        values = dataset[name].values
        return values.reshape(status.size, -1)

    state, decided, stopped, way = (
        flat(name) for name in ("supervisor_state", "time_to_decision", "stopped", "travel")
    )
    faults = {}
    for name in spec.axis("fault").labels:
        rows = (names == name) & (status == OK)
        if not rows.any():
            continue
        ends = Counter(state[rows, 0].astype(int).tolist())
        found = decided[rows, 0][np.isfinite(decided[rows, 0])]
        judged = stopped[rows, 0][~np.isnan(stopped[rows, 0])]
        faults[name] = {
            "scenarios": int(rows.sum()),
            "passed": int((good & rows).sum()),
            "end": {STATES[k]: ends[k] for k in sorted(ends)},
            "decided_ms": [_round(1e3 * f(found)) for f in (np.min, np.median, np.max)] if len(found) else [],
            "at_rest": [int(judged.sum()), len(judged)],
            "travel_deg": [_round(math.degrees(q)) for q in np.nanquantile(way[rows].max(1), (0.5, 1))]
            if not np.isnan(way[rows]).all()
            else [],
        }
    return {
        "scenarios": int((status > 0).sum()),
        "of": int(status.size),
        "lost": int((status > OK).sum()),
        "passed": int(good.sum()),
        "seed": spec.seed,
        "requirements": [
            {
                "requirement": verdict.requirement.words,
                "holds": verdict.holds,
                "judged": verdict.judged,
                "kept": round(verdict.kept, 6),
                "worst": [[case.index, case.joint, _round(case.value)] for case in verdict.worst]
                if not verdict.holds
                else [],
            }
            for verdict in judge(spec, dataset)
        ],
        "faults": faults,
    }


def _round(value: float) -> float | None:
    return float(f"{value:.4g}") if math.isfinite(value) else None


def main(arguments: list[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/readiness.zarr"))
    parser.add_argument("--scenarios", type=int, default=None, help="at least so many (default: all)")
    parser.add_argument("--workers", type=int, default=None)
    options = parser.parse_args(arguments)
    quiet_engine()
    found = evidence(Spec.load("readiness"), options.out, options.scenarios, options.workers)
    said = sys.argv[1:] if arguments is None else arguments
    command = shlex.join(["python", "-m", "dashpot.studies.readiness", *said])
    print(json.dumps({"command": command} | found, indent=1))


if __name__ == "__main__":
    main()
