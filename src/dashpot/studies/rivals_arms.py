"""Every brake and every tracker on whole arms, under the same random motions and payloads.

``python -m dashpot.studies.rivals_arms`` writes docs/evidence/rivals-arms.json, the tables of docs/rivals.md
and their figure, docs/images/rivals-arms.png.

1. Each law is tuned once per drive type (`dashpot.studies.rivals_tuning`: the same motions and limits for
   all, ``--budget`` tries per number that is tuned), on a joint with the inertias and loads it has at home.
   The virtual passive law is also designed, told the same (`dashpot.studies.rivals_arms_designed`).
2. Brakes: the arm follows a random multisine under the tuned PD, the same for all; then all controlled joints
   lose their encoder and the brake takes over. Shorted windings and the mechanical brake belong to the plant
   and have no law; encoder damping keeps its encoder.
3. Trackers: the same motions without a loss, and a rest for the noise of the torque.

``--seeds`` motions are run with every payload, the same for every brake, ``--tracker-seeds`` of them for
trackers, and an eighth of both on arms that are shown apart. The fr3's own weight is balanced: once the
encoders are gone nothing carries it, and what would be compared is who holds 35 N m, not who brakes. "fr3
with its weight" shows what happens then.

What is made is kept in ``--parts``, piece by piece: a run that is stopped goes on where it was.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import dashpot._native as _native
from dashpot.arm.robot import Robot
from dashpot.control.controller import ControllerConfig
from dashpot.control.laws import law_from_table, to_table
from dashpot.simulation.recording import Recording
from dashpot.simulation.simulate import Scenario, run_many
from dashpot.studies import rivals_arms_measures as measures
from dashpot.studies.rivals_arms_cases import (
    ARMS,
    SETTINGS,
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
from dashpot.studies.rivals_arms_designed import DUTIES, designed, wishes
from dashpot.studies.rivals_arms_measures import Seen
from dashpot.studies.rivals_arms_parts import Parts
from dashpot.studies.rivals_arms_tables import write_document
from dashpot.studies.rivals_arms_tuning import tuned
from dashpot.support.workers import cores, each

SEEDS, TRACKER_SEEDS, BUDGET, SEED = 168, 42, 24, 1  # 504 runs per arm and brake with three payloads
CHUNK = 42  # seeds that are run at once, and kept
QUANTILES = (5.0, 25.0, 50.0, 75.0, 95.0)  # of stop angles, for the figure
Say = Callable[[str], None]


@dataclass(frozen=True)
class Rival:
    """A row of a table.

    Attributes:
        name: In the tables.
        law: Key among the tuned laws; None: the bundled controller.
        fault: Of the drives once the encoders are lost, for brakes that belong to the plant.
        duty: Key among the designs, instead of a law.
    """

    name: str
    law: str | None
    fault: str | None = None
    duty: str | None = None


@dataclass(frozen=True)
class Found:
    """The laws that were found for the arms, as JSON holds them.

    Attributes:
        tuned: Arm -> drive type -> what `tuned` gives.
        designed: Arm -> duty -> what `designed` gives.
    """

    tuned: Mapping[str, Mapping[str, Any]]
    designed: Mapping[str, Mapping[str, Any]]

    @classmethod
    def of(cls, result: Mapping[str, Any]) -> Found:
        """From the JSON of a study."""
        return cls(result["tuning"], result["designs"])


BRAKES = (
    Rival("off", "brake off"),
    Rival("shorted windings", "brake off", "shorted_windings"),
    Rival("mechanical brake", "brake off", "mechanical_brake"),
    Rival("static torque feedback", "brake static_feedback"),
    Rival("rotor observer", "brake rotor_observer"),
    Rival("latched torque", "brake latched_torque"),
    Rival("encoder damping", "brake encoder_damping"),
    Rival("virtual passive, tuned", "brake virtual_passive"),
    Rival("virtual passive, designed", None, duty="brake"),
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
    Rival("virtual passive, designed", None, duty="tracker"),
    Rival("virtual passive, bundled", None),
)


def chosen(arm: Arm, rival: Rival, found: Found) -> ControllerConfig | None:
    """The controller of a row: a tuned law on the joints of every drive type, a design, or the bundled one.

    None: the design was refused.
    """
    if rival.duty is not None:
        joints = found.designed[arm.like or arm.name][rival.duty]["joints"].values()
        if any("refused" in joint for joint in joints):
            return None
        return replace(
            bundled(arm), joints=tuple(law_from_table(joint["law"]) for joint in joints), file=None
        )
    return bundled(arm) if rival.law is None else tuned_config(arm, rival.law, found)


def tuned_config(arm: Arm, law: str, found: Found) -> ControllerConfig:
    """The controller with a law as it was tuned for every drive type."""
    own = found.tuned[arm.like or arm.name]
    return with_load_model(
        arm, config(arm, laws_of({kind: own[kind]["laws"][law]["law"] for kind in arm.types}))
    )


@dataclass(frozen=True)
class Runs:
    """Runs with every payload, and what is kept of them.

    Attributes:
        arm: The arm.
        seeds: Of motions and noise.
        parts: Where runs are kept.
    """

    arm: Arm
    seeds: range
    parts: Parts

    def seen(
        self,
        name: str,
        controller: ControllerConfig,
        scenario: Callable[[float, int], Scenario],
        reduce: Callable[[Scenario, Recording], Seen],
        *about: object,
    ) -> dict[float, list[Seen]]:
        """Payload [kg] -> the measures of each run; ``about`` is what they hang on beside the controller."""
        found: dict[float, list[Seen]] = {}
        for payload in self.arm.payloads:
            found[payload] = []
            for first in self.seeds[::CHUNK]:
                some = [seed for seed in range(first, first + CHUNK) if seed in self.seeds]
                found[payload] += self.parts.made(
                    f"{self.arm.name} {name} {payload:g} kg {first}",
                    [_table(controller), SETTINGS, payload, some, *about],
                    lambda payload=payload, some=some: run_many(  # type: ignore[misc]
                        [scenario(payload, seed) for seed in some], reduce=reduce
                    ),
                )
        return found


def _table(controller: ControllerConfig) -> dict[str, Any]:
    """A controller as JSON can hold it."""
    means = {name: getattr(controller, name) for name in ("period", "latency", "sampling", "form", "blend")}
    return means | {"joints": [to_table(law) for law in controller.joints]}


def brake_row(rival: Rival, own: ControllerConfig, found: Found, runs: Runs) -> dict[str, Any]:
    """Runs one brake on one arm with every payload, and sums up."""
    arm = runs.arm
    controller = braking(own, tuned_config(arm, "tracker pd", found))
    seen = runs.seen(
        f"brake {rival.name}",
        controller,
        lambda payload, seed: stop(arm, controller, payload, seed, rival.fault),
        measures.stopping(rival.fault),
        rival.fault,
        measures.SETTINGS,
    )
    angles = measures.worst_joints([one for every in seen.values() for one in every], "stop_angle")
    return _summed(controller, seen, measures.STOP) | {
        "stop_angle_quantiles": measures.spread(angles, QUANTILES)
    }


def tracker_row(rival: Rival, own: ControllerConfig, runs: Runs) -> dict[str, Any]:
    """Runs one tracker on one arm with every payload, moving and at rest, and sums up."""
    arm = runs.arm
    moving = runs.seen(
        f"tracker {rival.name}", own, lambda payload, seed: track(arm, own, payload, seed), measures.tracking
    )
    still = Runs(arm, runs.seeds[:1], runs.parts).seen(
        f"rest {rival.name}",
        own,
        lambda payload, seed: rest(arm, own, payload, seed),
        measures.resting,
        measures.SETTINGS,
    )
    sizes = {}
    for payload, seen in moving.items():
        mean, deviation = (np.median(measures.worst_joints(seen, name)) for name in measures.TRACK)
        sizes[payload] = np.hypot(mean, deviation)
    noise = max(max(one["noise_torque"]) for every in still.values() for one in every)
    return _summed(own, moving, measures.TRACK) | {
        "worst_payload": max(sizes, key=lambda payload: sizes[payload]),
        "noise_torque": measures.number(noise),
    }


def _summed(
    controller: ControllerConfig, seen: Mapping[float, list[Seen]], names: Sequence[str]
) -> dict[str, Any]:
    every = [one for of_payload in seen.values() for one in of_payload]
    return {
        "scenarios": len(every),
        "payloads": {f"{payload:g}": measures.summary(own, names) for payload, own in seen.items()},
        "all": measures.summary(every, names),
        "joints": measures.medians(every, names, [law.name for law in controller.joints]),
        "first": measures.rounded(every[0]),
    }


def certified(arm: Arm, controllers: Sequence[ControllerConfig], brakes: bool, parts: Parts) -> list[bool]:
    """Whether each controller is certified on every joint; brakes without their position loop."""
    tasks, rows = [], []
    for i, controller in enumerate(controllers):
        alone = released(controller) if brakes else controller
        for law in alone.joints:
            drive = robot(arm).drives[robot(arm).index(law.name)]
            alike = replace(drive, name="joint", servo=None, coulomb_friction=0.0)
            named = replace(law, name="joint")
            task = (alike, named, replace(alone, joints=(named,)))
            if task not in tasks:
                tasks.append(task)
            rows.append((i, tasks.index(task)))
    verdicts = parts.made(
        f"{arm.name} certificates {'brakes' if brakes else 'trackers'}",
        [_table(controller) for controller in controllers],
        lambda: each(measures.certificate, tasks, cores()),
    )
    return [all(verdicts[t] for i, t in rows if i == row) for row in range(len(controllers))]


def study(
    seeds: int,
    tracker_seeds: int,
    budget: int,
    seed: int,
    *,
    found: Found | None = None,
    parts: Parts,
    say: Say = lambda _: None,
    arms: Sequence[Arm] = ARMS,
    brakes: Sequence[Rival] = BRAKES,
    trackers: Sequence[Rival] = TRACKERS,
) -> dict[str, Any]:
    """The whole comparison; for JSON.

    Args:
        seeds: Motions per payload for brakes.
        tracker_seeds: For trackers.
        budget: Sets tried per tuned number.
        seed: The first of the motions, and that of the tuning.
        found: Laws found before; None: they are tuned and designed now.
        parts: Where what is made is kept.
        say: Told what is being done.
        arms: The arms; those that take over another's laws after it.
        brakes: The rows of the brakes.
        trackers: The rows of the trackers.
    """
    if found is None:
        own = [arm for arm in arms if not arm.like]
        found = Found(
            {arm.name: tuned(arm, budget, seed, parts) for arm in own},
            {arm.name: {duty: _designed(arm, duty, parts, say) for duty in DUTIES} for arm in own},
        )
    rows: dict[str, list[dict[str, Any]]] = {"brakes": [], "trackers": []}
    linear = {arm: measures.linearised(arm, bundled(arm), seed) for arm in arms}
    for part, rivals in (("brakes", brakes), ("trackers", trackers)):
        braked = part == "brakes"
        for arm in arms:
            if arm.like and not braked:  # the links' weight is no matter of tracking
                continue
            motions = max(1, (seeds if braked else tracker_seeds) // arm.share)
            runs = Runs(arm, range(seed, seed + motions), parts)
            configs = {rival: made for rival in rivals if (made := chosen(arm, rival, found)) is not None}
            verdicts: list[Any] = [None] * len(configs)
            if not arm.like:
                verdicts = certified(arm, list(configs.values()), braked, parts)
            certificates = dict(zip(configs, verdicts, strict=True))
            for rival in rivals:
                row: dict[str, Any] = {"arm": arm.name, "name": rival.name}
                if rival in configs:
                    say(f"{arm.name}: {rival.name}")
                    ours = configs[rival]
                    row["certified"] = certificates[rival]
                    row["oscillates"] = measures.oscillates(arm, ours, linear[arm], braked)
                    row |= brake_row(rival, ours, found, runs) if braked else tracker_row(rival, ours, runs)
                else:
                    assert rival.duty is not None
                    row["refused"] = refusal(found.designed[arm.like or arm.name][rival.duty])
                rows[part].append(row)
    return {
        "command": f"python -m dashpot.studies.rivals_arms --seeds {seeds} --tracker-seeds {tracker_seeds} "
        f"--budget {budget} --seed {seed}",
        "seed": seed,
        "seeds_per_payload": seeds,
        "tracker_seeds_per_payload": tracker_seeds,
        "budget": budget,
        "tuning": found.tuned,
        "designs": found.designed,
        **rows,
    }


def _designed(arm: Arm, duty: str, parts: Parts, say: Say) -> Any:
    say(f"{arm.name}: designing a {duty}")
    spec = wishes(arm, duty)
    inputs = [spec.preset, spec.wishes, spec.own, _table(bundled(arm))]
    return parts.made(f"{arm.name} design {duty}", inputs, lambda: designed(arm, duty))


def refusal(design: Mapping[str, Any]) -> dict[str, list[str]]:
    """Joint -> why it has no gains, of a design that was refused."""
    return {name: joint["refused"] for name, joint in design["joints"].items() if "refused" in joint}


def files_of(robot: Robot) -> list[Path]:
    """The robot's description and its model."""
    return [Path(path) for path in (robot.file, robot.model) if path is not None]


def main() -> None:
    """Runs the study and writes JSON, tables and figure."""
    parser = argparse.ArgumentParser(description="Every brake and tracker on whole arms.")
    parser.add_argument("--seeds", type=int, default=SEEDS, help="motions per payload, for brakes")
    parser.add_argument("--tracker-seeds", type=int, default=TRACKER_SEEDS, help="the same, for trackers")
    parser.add_argument("--budget", type=int, default=BUDGET, help="sets tried per tuned number and drive")
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument(
        "--parts", type=Path, default=Path("out/rivals-arms"), help="what is made is kept here"
    )
    parser.add_argument(
        "--redraw", action="store_true", help="only tables and figure, from the JSON as it is"
    )
    parser.add_argument("--docs", type=Path, default=Path("docs"))
    options = parser.parse_args()
    path = options.docs / "evidence" / "rivals-arms.json"
    if not options.redraw:
        start = time.monotonic()
        files = [path for arm in ARMS for path in files_of(robot(arm))]
        result = study(
            options.seeds,
            options.tracker_seeds,
            options.budget,
            options.seed,
            parts=Parts(options.parts, Path(_native.__file__), *files),
            say=lambda line: print(f"{time.monotonic() - start:6.0f} s  {line}", file=sys.stderr, flush=True),
        )
        part = path.with_suffix(".json.part")
        part.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
        part.replace(path)
    write_document(json.loads(path.read_text(encoding="utf-8")), options.docs)


if __name__ == "__main__":
    main()
