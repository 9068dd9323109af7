"""Every brake and every tracker on whole arms, under the same random motions and payloads.

``python -m dashpot.studies.rivals_arms`` writes docs/evidence/rivals-arms.json, the tables of docs/rivals.md
and their figure, docs/images/rivals-arms.png.

1. Each law is tuned once per drive type (`dashpot.studies.rivals_tuning`: the same motions and limits for
   all, ``--budget`` tries per number that is tuned), on a joint with the inertias and loads it has at home.
2. Brakes: the arm follows a random multisine under the tuned PD, the same for all; then all controlled joints
   lose their encoder and the brake takes over. Shorted windings and the mechanical brake belong to the plant
   and have no law; encoder damping keeps its encoder.
3. Trackers: the same motions without a loss, and a rest for the noise of the torque.

``--seeds`` motions are run with every payload, the same for every brake, and a quarter of them for trackers.
``--tuned`` takes the tuned numbers from a file written before. The fr3's own weight is balanced: once the
encoders are gone nothing carries it, and what would be compared is who holds 35 N m, not who brakes. "fr3
with its weight" shows on a quarter of the motions what happens then.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dashpot.controller import ControllerConfig
from dashpot.simulate import run_many
from dashpot.studies import rivals_arms_measures as measures
from dashpot.studies.rivals_arms_cases import (
    ARMS,
    Arm,
    braking,
    bundled,
    config,
    laws_of,
    released,
    rest,
    robot,
    stop,
    track,
    with_load_model,
)
from dashpot.studies.rivals_arms_tables import write_document
from dashpot.studies.rivals_arms_tuning import tuned
from dashpot.workers import cores, each

SEEDS, BUDGET, SEED = 168, 24, 1  # 504 runs per arm and brake with three payloads
QUARTER = 4  # the share of seeds of trackers, and of an arm that is shown apart
QUANTILES = (5.0, 25.0, 50.0, 75.0, 95.0)  # of stop angles, for the figure
Say = Callable[[str], None]


@dataclass(frozen=True)
class Rival:
    """A row of a table.

    Attributes:
        name: In the tables.
        law: Key among the tuned laws; None: the bundled controller.
        fault: Of the drives once the encoders are lost, for brakes that belong to the plant.
    """

    name: str
    law: str | None
    fault: str | None = None


BRAKES = (
    Rival("off", "brake off"),
    Rival("shorted windings", "brake off", "shorted_windings"),
    Rival("mechanical brake", "brake off", "mechanical_brake"),
    Rival("static torque feedback", "brake static_feedback"),
    Rival("rotor observer", "brake rotor_observer"),
    Rival("latched torque", "brake latched_torque"),
    Rival("encoder damping", "brake encoder_damping"),
    Rival("virtual passive, tuned", "brake virtual_passive"),
    Rival("virtual passive, bundled", None),
)
TRACKERS = (
    Rival("PD", "tracker pd"),
    Rival("PD x R", "tracker pd_scaled"),
    Rival("PID", "tracker pid"),
    Rival("PD + wrong load model", "tracker pd_gravity"),
    Rival("disturbance observer", "tracker disturbance_observer"),
    Rival("torque feedback", "tracker torque_feedback"),
    Rival("inertia shaping", "tracker inertia_shaping"),
    Rival("virtual passive, tuned", "tracker virtual_passive"),
    Rival("virtual passive, bundled", None),
)
Tuned = Mapping[str, Mapping[str, Any]]


def chosen(arm: Arm, rival: Rival, found: Tuned) -> ControllerConfig:
    """The controller of a row: a tuned law on the joints of every drive type, or the bundled one."""
    if rival.law is None:
        return bundled(arm)
    return _tuned_config(arm, rival.law, found)


def _tuned_config(arm: Arm, law: str, found: Tuned) -> ControllerConfig:
    own = found[arm.robot]
    return with_load_model(
        arm, config(arm, laws_of({kind: own[kind]["laws"][law]["law"] for kind in arm.types}))
    )


def brake_row(arm: Arm, rival: Rival, found: Tuned, seeds: int, seed: int) -> dict[str, Any]:
    """Runs one brake on one arm with every payload, and sums up."""
    controller = braking(chosen(arm, rival, found), _tuned_config(arm, "tracker pd", found))
    runs = [(payload, seed + i) for payload in arm.payloads for i in range(seeds)]
    scenarios = [stop(arm, controller, payload, at, rival.fault) for payload, at in runs]
    seen: list[Any] = run_many(scenarios, reduce=measures.stopping(rival.fault))
    angles = measures.worst_joints(seen, "stop_angle")
    return {
        "scenarios": len(runs),
        "payloads": _by_payload(arm, runs, seen, measures.STOP),
        "all": measures.summary(seen, measures.STOP),
        "stop_angle_quantiles": measures.spread(angles, QUANTILES),
        "joints": measures.medians(seen, measures.STOP, [law.name for law in controller.joints]),
        "first": measures.rounded(seen[0]),
    }


def tracker_row(arm: Arm, rival: Rival, found: Tuned, seeds: int, seed: int) -> dict[str, Any]:
    """Runs one tracker on one arm with every payload, moving and at rest, and sums up."""
    controller = chosen(arm, rival, found)
    runs = [(payload, seed + i) for payload in arm.payloads for i in range(seeds)]
    moving = [track(arm, controller, payload, at) for payload, at in runs]
    seen: list[Any] = run_many(moving, reduce=measures.tracking)
    still: list[Any] = run_many(
        [rest(arm, controller, p, seed) for p in arm.payloads], reduce=measures.resting
    )
    by_payload = _by_payload(arm, runs, seen, measures.TRACK)
    sizes = []
    for payload in arm.payloads:
        own = [one for (carried, _), one in zip(runs, seen, strict=True) if carried == payload]
        mean, deviation = (np.median(measures.worst_joints(own, name)) for name in measures.TRACK)
        sizes.append(np.hypot(mean, deviation))
    return {
        "scenarios": len(runs),
        "payloads": by_payload,
        "all": measures.summary(seen, measures.TRACK),
        "worst_payload": arm.payloads[int(np.argmax(sizes))],
        "noise_torque": measures.number(max(max(one["noise_torque"]) for one in still)),
        "joints": measures.medians(seen, measures.TRACK, [law.name for law in controller.joints]),
        "first": measures.rounded(seen[0]),
    }


def _by_payload(
    arm: Arm, runs: list[tuple[float, int]], seen: list[Any], names: tuple[str, ...]
) -> dict[str, Any]:
    return {
        f"{payload:g}": measures.summary(
            [one for (own, _), one in zip(runs, seen, strict=True) if own == payload], names
        )
        for payload in arm.payloads
    }


def certified(arm: Arm, rivals: tuple[Rival, ...], found: Tuned, brakes: bool) -> list[bool]:
    """Whether each row's law is certified on every joint; brakes without their position loop."""
    tasks, rows = [], []
    for i, rival in enumerate(rivals):
        controller = chosen(arm, rival, found)
        if brakes:
            controller = released(controller)
        for law in controller.joints:
            drive = robot(arm).drives[robot(arm).index(law.name)]
            alike = replace(drive, name="joint", servo=None, coulomb_friction=0.0)
            task = (
                alike,
                replace(law, name="joint"),
                replace(controller, joints=(replace(law, name="joint"),)),
            )
            if task not in tasks:
                tasks.append(task)
            rows.append((i, tasks.index(task)))
    verdicts = each(measures.certificate, tasks, cores())
    return [all(verdicts[t] for i, t in rows if i == row) for row in range(len(rivals))]


def study(
    seeds: int, budget: int, seed: int, found: Tuned | None = None, say: Say = lambda _: None
) -> dict[str, Any]:
    """The whole comparison; for JSON."""
    if found is None:
        found = {arm.robot: tuned(arm, budget, seed) for arm in ARMS if arm.robot == arm.name}
    rows: dict[str, list[dict[str, Any]]] = {"brakes": [], "trackers": []}
    for arm in ARMS:
        for part, rivals, row_of in (("brakes", BRAKES, brake_row), ("trackers", TRACKERS, tracker_row)):
            apart = arm.robot != arm.name
            if apart and part == "trackers":
                continue
            verdicts = certified(arm, rivals, found, part == "brakes") if not apart else [None] * len(rivals)
            at = measures.linearised(arm, bundled(arm), seed)
            own = seeds if part == "brakes" and not apart else max(1, seeds // QUARTER)
            for rival, verdict in zip(rivals, verdicts, strict=True):
                say(f"{arm.name}: {rival.name}")
                growing = measures.oscillates(arm, chosen(arm, rival, found), at, part == "brakes")
                row = {"arm": arm.name, "name": rival.name, "certified": verdict, "oscillates": growing}
                rows[part].append(row | row_of(arm, rival, found, own, seed))
    return {
        "command": f"python -m dashpot.studies.rivals_arms --seeds {seeds} --budget {budget} --seed {seed}",
        "seed": seed,
        "seeds_per_payload": seeds,
        "budget": budget,
        "tuning": found,
        **rows,
    }


def main() -> None:
    """Runs the study and writes JSON, tables and figure."""
    parser = argparse.ArgumentParser(description="Every brake and tracker on whole arms.")
    parser.add_argument("--seeds", type=int, default=SEEDS, help="motions per payload")
    parser.add_argument("--budget", type=int, default=BUDGET, help="sets tried per tuned number and drive")
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument(
        "--tuned", type=Path, help="take the tuned numbers from this JSON, made with this budget"
    )
    parser.add_argument(
        "--redraw", action="store_true", help="only tables and figure, from the JSON as it is"
    )
    parser.add_argument("--docs", type=Path, default=Path("docs"))
    options = parser.parse_args()
    path = options.docs / "evidence" / "rivals-arms.json"
    if not options.redraw:
        found = json.loads(options.tuned.read_text(encoding="utf-8"))["tuning"] if options.tuned else None
        result = study(
            options.seeds,
            options.budget,
            options.seed,
            found,
            lambda line: print(line, file=sys.stderr, flush=True),
        )
        part = path.with_suffix(".json.part")
        part.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
        part.replace(path)
    write_document(json.loads(path.read_text(encoding="utf-8")), options.docs)


if __name__ == "__main__":
    main()
