"""A campaign against raw ``mj_step``, its dataset included, and on two workers against one."""

from __future__ import annotations

import os
import tempfile
import time
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from measure import SETS, Rows

from dashpot.campaign.execute import _local, execute
from dashpot.campaign.scenario import Campaign
from dashpot.campaign.spec import Spec
from dashpot.campaign.store import Store, create

TEXT = """
robot = "fr3"
controller = "fr3"
duration = 3.0
amplitude = 0.2
chunk = 16
[axes]
payload = [0.0, 2.0]
fault = ["none"]
seed = {{ low = 0, high = {0}, points = {1} }}
"""
SEEDS = 16


def campaign(rows: Rows) -> None:
    """Throughput per core in CPU time; scaling in wall clock, processes started beforehand."""
    plan = Campaign(Spec.parse(TEXT.format(SEEDS - 1, SEEDS), None))
    ratio = np.zeros(SETS)
    for i in range(SETS):
        raw = _raw(plan)
        with tempfile.TemporaryDirectory() as folder:
            out = Path(folder) / "out.zarr"
            create(out, plan)
            store = Store(out, plan)
            begin = time.process_time()
            execute(plan, store, workers=0)
            ratio[i] = raw / (time.process_time() - begin)
            store.close()
    rows.section(
        f"Campaign of {plan.spec.size} scenarios of 4 s of fr3", "CPU time of one process, dataset written"
    )
    rows.add("campaign_ratio", "raw mj_step over campaign", ratio, least=0.9)
    if (os.cpu_count() or 1) < 2:
        return
    speedup = np.zeros(SETS)
    for i in range(SETS):
        speedup[i] = _wall(plan, 1) / _wall(plan, 2)
    rows.add("campaign_speedup", "two workers: times faster", speedup, least=1.8)


def _raw(plan: Campaign) -> float:
    """CPU seconds of ``mj_step`` alone for as many steps as the campaign takes."""
    seconds = 0.0
    for index in range(0, plan.spec.size, SEEDS):
        scenario = plan.scenario(index)
        plant, trajectory = scenario.plant, scenario.trajectory
        data = mujoco.MjData(plant.model)
        data.qpos[plant.rotor_qpos] = trajectory.position[0]
        mujoco.mj_forward(plant.model, data)
        steps = round(trajectory.period / plant.timestep) * len(trajectory.position)
        begin = time.process_time()
        mujoco.mj_step(plant.model, data, nstep=steps)
        seconds += SEEDS * (time.process_time() - begin)
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
