"""The vectorised arm at length: against MuJoCo at its own converged step, and a campaign end to end.

``python -m dashpot.studies.lanes agreement`` (``elements``, ``readiness``) prints the result as JSON.
Scenarios are random in pose, motion, payload and noise. MuJoCo runs at steps h and h/2, and where its order
is asked for, at h/4; its limit is extrapolated from the two finest: ``2 x(h/2) - x(h)``, as its order says.
"""

from __future__ import annotations

import argparse
import json
import math
import shlex
import sys
import tempfile
import time
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dashpot.arm.payload import Payload
from dashpot.arm.plant import build, with_timestep
from dashpot.arm.robot import Robot
from dashpot.campaign.execute import execute
from dashpot.campaign.measures import MEASURES
from dashpot.campaign.scenario import Campaign
from dashpot.campaign.spec import Spec
from dashpot.campaign.store import Store, create, open_dataset
from dashpot.commands.campaign_view import progress_bar
from dashpot.control.controller import Controller, load_controller
from dashpot.errors import InputWarning
from dashpot.lanes import WIDTHS, run_lanes
from dashpot.simulation.engine import quiet_engine
from dashpot.simulation.recording import CHANNELS
from dashpot.simulation.release import tracking_events
from dashpot.simulation.simulate import Scenario, run
from dashpot.simulation.trajectory import multisine
from dashpot.studies.lanes_cases import random_arm, random_config, random_scenario
from dashpot.support.arrays import Floats
from dashpot.support.workers import cores, each

ARMS = {"fr3": ("fr3", 3.0), "iiwa14": ("iiwa14", 7.0), "k807": ("k807-wrist", 4.5)}
"""Robot -> controller and largest payload [kg]."""
SECONDS = 2.0
SEED = 1
ASKED = 10  # of so many scenarios one is asked for its order
EACH = 5  # scenarios of a random arm
TASK = 10  # scenarios that a worker runs at a time


@dataclass(frozen=True)
class Task:
    """Some scenarios of an arm."""

    robot: str
    first: int
    count: int


def agreement(task: Task) -> list[tuple[float, ...]]:
    """Of every scenario: largest angle between the engines at one step, both errors against the limit, ours
    at the end, the order (NaN where it is not asked for), and how far the arm has moved [rad]."""
    quiet_engine()
    found: list[tuple[float, ...]] = []
    for index in range(task.first, task.first + task.count):
        scenario, order = _scenario(task.robot, index), math.nan
        runs = [run(_finer(scenario, parts)).link_position for parts in (1, 2)]
        limit = 2 * runs[1] - runs[0]
        if index % ASKED == 0:
            runs.append(run(_finer(scenario, 4)).link_position)
            limit = 2 * runs[2] - runs[1]
            order = math.log2(_most(runs[0] - runs[1]) / _most(runs[1] - runs[2]))
        ours = run_lanes([scenario])[0].link_position
        errors = (
            _most(ours - runs[0]),
            _most(ours - limit),
            _most(runs[0] - limit),
            _most((ours - limit)[-1:]),
        )
        found.append((*errors, order, float(np.ptp(ours, axis=0).max())))
    return found


def _finer(scenario: Scenario, parts: int) -> Scenario:
    plant = scenario.plant
    return scenario if parts == 1 else replace(scenario, plant=with_timestep(plant, plant.timestep / parts))


def _most(angles: Floats) -> float:
    return float(np.abs(angles).max())


def _scenario(name: str, index: int) -> Scenario:
    law, heaviest = ARMS[name]
    rng = np.random.default_rng([SEED, sorted(ARMS).index(name), index])
    robot, config = Robot.load(name), load_controller(law)
    payload = Payload(float(rng.uniform(0, heaviest)), tuple(rng.uniform(-0.1, 0.1, 3)))
    plant = build(robot, config.period, [payload])
    low, high = (np.clip(plant.drives[key], -3.0, 3.0) for key in ("stop_lower", "stop_upper"))
    pose = np.clip(np.array(robot.home) + rng.uniform(-0.6, 0.6, len(robot.home)), low + 0.4, high - 0.4)
    path = multisine(pose.tolist(), SECONDS - 0.1, config.period, int(rng.integers(2**31)),
                     amplitude=float(rng.uniform(0.05, 0.3)), lead_in=0.1)  # fmt: skip
    return Scenario(
        plant,
        Controller.from_config(config, robot.drives),
        path,
        tracking_events(config, path.start),
        seed=int(rng.integers(2**31)),
        gravity_compensation=True,
    )


def agreements(count: int, workers: int) -> dict[str, Any]:
    """`agreement` of so many scenarios of every bundled arm, summed up [rad]."""
    tasks = [Task(name, first, min(TASK, count - first)) for name in ARMS for first in range(0, count, TASK)]
    results = each(agreement, tasks, workers)
    found = {}
    for name in ARMS:
        parts = [part for task, part in zip(tasks, results, strict=True) if task.robot == name]
        rows = np.concatenate([np.array(part) for part in parts])
        same, ours, theirs, last, order, way = rows.T
        asked = order[~np.isnan(order)]
        found[name] = {
            "scenarios": len(rows),
            "engines_at_one_step": _round(same.max()),
            "error_of_lanes": _quantiles(ours),
            "error_of_mujoco": _quantiles(theirs),
            "error_of_lanes_at_the_end": _quantiles(last),
            "order_of": len(asked),
            "order_median": _round(float(np.median(asked))),
            "order_5_95": [_round(float(q)) for q in np.quantile(asked, (0.05, 0.95))],
            "moved_at_least": _round(way.min()),
        }
    return found


def _quantiles(values: Floats) -> dict[str, float]:
    shares = {"median": 0.5, "99 %": 0.99, "max": 1.0}
    return {name: _round(float(np.quantile(values, share))) for name, share in shares.items()}


def elements(arms: int) -> dict[str, Any]:
    """Random arms with whatever a file can name: bits at all widths, and angles against MuJoCo [rad]."""
    rng, apart, same = np.random.default_rng(SEED), [0.0], True
    kinds: set[str] = set()
    count = diverged = 0
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        for _ in range(arms):
            robot = random_arm(rng, Path(folder))
            config = random_config(rng, robot)
            scenarios = [random_scenario(rng, robot, config) for _ in range(EACH)]
            found = run_lanes(scenarios)
            others = [run_lanes(scenarios[::-1], width=width)[::-1] for width in WIDTHS]
            for index, (scenario, ours) in enumerate(zip(scenarios, found, strict=True)):
                reference, count = run(scenario), count + 1
                kinds |= {fault.kind for fault in scenario.faults}
                diverged += reference.diverged_at is not None
                for other in (part[index] for part in others):
                    pairs = ((getattr(ours, name), getattr(other, name)) for name in CHANNELS)
                    same &= all(np.array_equal(a, b, equal_nan=True) for a, b in pairs)
                if ours.diverged_at != reference.diverged_at:
                    raise RuntimeError("one engine has diverged, the other has not")
                apart.append(float(np.nanmax(np.abs(ours.link_position - reference.link_position))))
    return {
        "arms": arms,
        "scenarios": count,
        "kinds_of_faults": len(kinds),
        "diverged": diverged,
        "same_bits_at_all_widths_and_orders": bool(same),
        "largest_angle_to_mujoco_rad": _round(max(apart)),
    }


def readiness(scenarios: int | None, compared: int, workers: int) -> dict[str, Any]:
    """The readiness campaign on both engines: wall-clock time, and whether they say the same.

    Args:
        scenarios: On the vectorised engine; None: all.
        compared: On both, in chunks drawn at random.
        workers: Processes.
    """
    spec = Spec.load("readiness")
    order = np.random.default_rng(SEED).permutation(spec.chunks).tolist()
    sizes = np.cumsum([len(spec.chunk_indices(chunk)) for chunk in order])
    some = order[: int(np.searchsorted(sizes, compared)) + 1]
    many = order if scenarios is None else order[: int(np.searchsorted(sizes, scenarios)) + 1]
    with tempfile.TemporaryDirectory() as folder:
        seconds, data = {}, {}
        for engine, chunks in (("lanes", many), ("mujoco", some)):
            campaign, out = Campaign(replace(spec, engine=engine)), Path(folder) / f"{engine}.zarr"
            create(out, campaign)
            store = Store(out, campaign)
            begin = time.perf_counter()
            with progress_bar(sum(len(spec.chunk_indices(chunk)) for chunk in chunks), 0) as advance:
                execute(campaign, store, workers=workers, advance=advance, chunks=chunks)
            took = time.perf_counter() - begin
            store.close()
            seconds[engine] = took / sum(len(spec.chunk_indices(chunk)) for chunk in chunks)
            with open_dataset(out) as dataset:
                data[engine] = dataset.load()
    both = (data["mujoco"]["status"].values > 0) & (data["lanes"]["status"].values > 0)
    differ = {}
    for name in MEASURES:
        ours, theirs = (data[engine][name].values[both] for engine in ("lanes", "mujoco"))
        gone = np.isnan(ours) != np.isnan(theirs)
        with np.errstate(invalid="ignore"):
            apart = np.abs(ours - theirs) > 1e-6 * np.maximum(1e-3, np.abs(theirs))
        if count := int((gone | (apart & (ours != theirs))).reshape(len(ours), -1).any(1).sum()):
            differ[name] = count
    return {
        "lanes_scenarios": int((data["lanes"]["status"].values > 0).sum()),
        "lanes_seconds": _round(seconds["lanes"] * int((data["lanes"]["status"].values > 0).sum())),
        "lanes_ms_per_scenario": _round(1e3 * seconds["lanes"]),
        "mujoco_ms_per_scenario": _round(1e3 * seconds["mujoco"]),
        "times_faster": _round(seconds["mujoco"] / seconds["lanes"]),
        "workers": workers,
        "compared": int(both.sum()),
        "scenarios_that_differ_by_measure": differ,
    }


def _round(value: float) -> float:
    return float(f"{value:.3g}")


def main(arguments: list[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("part", choices=["agreement", "elements", "readiness"])
    parser.add_argument("--scenarios", type=int, default=1000, help="of every arm against MuJoCo's limit")
    parser.add_argument("--arms", type=int, default=200, help="random ones")
    parser.add_argument("--campaign", type=int, default=None, help="scenarios of the campaign (default: all)")
    parser.add_argument("--compared", type=int, default=1000, help="of them on both engines")
    parser.add_argument("--workers", type=int, default=cores())
    options = parser.parse_args(arguments)
    said = sys.argv[1:] if arguments is None else arguments
    found: dict[str, Any] = {
        "command": shlex.join(["python", "-m", "dashpot.studies.lanes", *said]),
        "seed": SEED,
        "lanes": {str(width): words for width, words in WIDTHS.items()},
    }
    if options.part == "agreement":
        found["seconds"] = SECONDS
        found["rad"] = agreements(options.scenarios, options.workers)
    elif options.part == "elements":
        found |= elements(options.arms)
    else:
        found |= readiness(options.campaign, options.compared, options.workers)
    print(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
