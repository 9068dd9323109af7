"""A campaign against raw ``mj_step``, its dataset included, and on two workers against one."""

from __future__ import annotations

import os
import tempfile
import time
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from measure import SETS, Rows, interleave

from dashpot.campaign.execute import _local, execute
from dashpot.campaign.scenario import Campaign
from dashpot.campaign.spec import Spec
from dashpot.campaign.store import Store, create
from dashpot.simulation.engine import quiet_engine

TEXT = """
robot = "fr3"
controller = "fr3"
duration = 3.0
amplitude = 0.2
chunk = {0}
[axes]
payload = [0.0, 2.0]
fault = ["none"]
seed = {{ low = 0, high = {1}, points = {2} }}
"""
ROUNDS = 5


def campaign(rows: Rows) -> None:
    """Throughput per core in CPU time; scaling in wall clock, processes started beforehand."""
    plan = _plan(chunk=4, seeds=2)
    best = interleave(
        {
            "raw": lambda: _raw(plan, profiler=True),
            "bare": lambda: _raw(plan, profiler=False),
            "campaign": lambda: _campaign(plan),
        },
        ROUNDS,
    )
    rows.section("Campaign of 4 s scenarios of fr3", "CPU time of one process, dataset written")
    rows.add("campaign_ratio", "raw mj_step over campaign", best["raw"] / best["campaign"], least=3.0)
    rows.add(
        "campaign_bare",
        "the same without MuJoCo's profiler, which the campaign leaves out",
        best["bare"] / best["campaign"],
    )
    if (os.cpu_count() or 1) < 2:
        return
    many = _plan(chunk=16, seeds=16)
    speedup = np.zeros(SETS)
    for i in range(SETS):
        speedup[i] = _wall(many, 1) / _wall(many, 2)
    rows.add("campaign_speedup", "two workers: times faster", speedup, least=1.8)


def _plan(chunk: int, seeds: int) -> Campaign:
    return Campaign(Spec.parse(TEXT.format(chunk, seeds - 1, seeds), None))


def _campaign(plan: Campaign) -> float:
    """CPU seconds of a whole campaign, as its command runs it."""
    quiet_engine()
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out.zarr"
        create(out, plan)
        store = Store(out, plan)
        begin = time.process_time()
        execute(plan, store, workers=0)
        seconds = time.process_time() - begin
        store.close()
    return seconds


def _raw(plan: Campaign, *, profiler: bool) -> float:
    """CPU seconds of ``mj_step`` alone for as many steps as the campaign takes."""
    if profiler:
        mujoco.set_mjcb_time(None)  # as the package comes
    else:
        quiet_engine()
    seconds = 0.0
    for index in range(plan.spec.size):
        scenario = plan.scenario(index)
        plant, trajectory = scenario.plant, scenario.trajectory
        data = mujoco.MjData(plant.model)
        data.qpos[plant.rotor_qpos] = trajectory.position[0]
        mujoco.mj_forward(plant.model, data)
        steps = round(trajectory.period / plant.timestep) * len(trajectory.position)
        begin = time.process_time()
        mujoco.mj_step(plant.model, data, nstep=steps)
        seconds += time.process_time() - begin
    return seconds


def _wall(plan: Campaign, workers: int) -> float:
    """Wall-clock seconds from the first chunk of every worker on."""
    again: Any = [*range(plan.spec.chunks)] * 3
    results = _local(plan, again, workers)
    for _ in range(workers):  # starts processes, imports and builds
        next(results)
    begin, count = time.perf_counter(), 0
    for _ in results:
        count += 1
    return (time.perf_counter() - begin) / count


__all__ = ["campaign"]
