"""Scenarios on the vectorised engine: grouped by arm and time step, each with the bits that it has alone."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import numpy as np

import dashpot._native as _native
from dashpot.arm.plant import Plant, with_payload
from dashpot.errors import InputError, ModelError
from dashpot.lanes.tree import Tree, tree_of
from dashpot.simulation.prepare import Prepared
from dashpot.simulation.recording import Recording
from dashpot.simulation.remember import Remembered

if TYPE_CHECKING:
    from dashpot.simulation.simulate import Scenario

WIDTHS: dict[int, str] = dict(_native.LANES)
"""Lanes that this machine has -> instruction set; the last is the widest."""
BATCH = 8  # groups that one thread runs at a time


def tree_kept(plant: Plant) -> Tree:
    """`tree_of`, read once per plant."""
    if plant.tree is None:
        plant.tree = tree_of(plant)
    return plant.tree


def unfit(scenario: Scenario) -> str:
    """Why a scenario needs MuJoCo; "" where it does not."""
    try:
        tree_kept(scenario.plant)
    except ModelError as error:
        return str(error)
    return ""


class LaneRun(Prepared):
    """A run that the vectorised engine does."""

    def __init__(self, scenario: Scenario, remembered: Remembered | None = None) -> None:
        """Prepares it; arguments as of `Prepared`.

        Raises:
            ModelError: Its plant has something that only MuJoCo simulates.
            InputError: As `dashpot.simulation.simulate.run`.
        """
        super().__init__(scenario, remembered=remembered)
        period, plant = scenario.trajectory.period, self._plant
        self.tree = tree = tree_kept(scenario.plant)
        changes = sorted(scenario.payload_changes, key=lambda change: change.time)
        loads = [tree, *(tree_kept(with_payload(scenario.plant, c.payload, period)) for c in changes)]
        if any(load.key != tree.key for load in loads):
            raise InputError("a payload changes the arm itself", quantity="payload_changes")
        bare = tree_kept(with_payload(scenario.plant, None, period)).bodies if scenario.carried else None
        self.timestep, self.steps = plant.timestep, round(period / plant.timestep)
        self.lane = _native.Lane(
            self.core,
            self._drives.view(np.uint8),
            self._events.view(np.uint8),
            self._qpos,
            self._qvel,
            plant.timestep,
            self.steps,
            self.ticks,
            self._reference,
            self._external,
            self._record,
            self._status,
            self.faults,
            self.guard,
            tree.rotors,
            np.array([0, *(tick for tick, _ in self._models)], np.int32),
            np.stack([load.bodies for load in loads]),
            bare,
        )

    def finish(self) -> Recording:
        """What the engine has recorded."""
        self.tick = self.ticks
        if self.lane.diverged_tick >= 0:
            self.diverged = self.lane.diverged_tick
        found = self.recording()
        found.settings["engine"] = "lanes"
        return found


def run_lanes(
    scenarios: Sequence[Scenario],
    *,
    width: int | None = None,
    threads: int = 1,
    remembered: Remembered | None = None,
) -> list[Recording]:
    """Runs scenarios side by side.

    The bits of a recording depend neither on the others nor on width or threads.

    Args:
        scenarios: In any order, of any robots.
        width: Lanes, one of `WIDTHS`; None: the widest.
        threads: That share the groups.
        remembered: As of `dashpot.simulation.prepare.Prepared`.

    Returns:
        Recordings in the order of the scenarios.

    Raises:
        ModelError: A plant has something that only MuJoCo simulates.
        InputError: As `dashpot.simulation.simulate.run`, or no such width.
    """
    prepared = [LaneRun(scenario, remembered) for scenario in scenarios]
    launch(prepared, width=width, threads=threads)
    return [one.finish() for one in prepared]


def launch(prepared: Sequence[LaneRun], *, width: int | None = None, threads: int = 1) -> None:
    """Runs what has been prepared; arguments and errors as of `run_lanes`."""
    width = max(WIDTHS) if width is None else width
    if width not in WIDTHS:
        raise InputError(f"must be one of {', '.join(map(str, WIDTHS))}", quantity="width", value=width)
    groups: dict[object, list[LaneRun]] = {}
    for one in prepared:
        key = (one.tree.key, len(one.tree.rotors), one.timestep, one.steps)
        groups.setdefault(key, []).append(one)
    work = []
    for group in groups.values():
        group.sort(key=lambda one: one.ticks)  # those that end together run together
        size = width * (BATCH if threads > 1 else len(group))
        work += [group[i : i + size] for i in range(0, len(group), size)]

    def go(part: list[LaneRun]) -> None:
        _native.run_lanes(part[0].tree.raw, [one.lane for one in part], width)

    if threads > 1 and len(work) > 1:
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(go, work))
    else:
        for part in work:
            go(part)
