"""The vectorised arm against raw ``mj_step``, MuJoCo's own batch, and Pinocchio's forward dynamics alone."""

from __future__ import annotations

import ctypes
import os
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import mujoco
import mujoco.batch
import numpy as np
from measure import Rows, Timed, interleave

import dashpot._native as _native
from dashpot.arm.payload import Payload
from dashpot.arm.plant import Plant, build
from dashpot.arm.robot import Robot
from dashpot.control.controller import Controller, load_controller
from dashpot.lanes.run import WIDTHS, LaneRun, tree_kept
from dashpot.lanes.tree import Tree
from dashpot.simulation.engine import quiet_engine
from dashpot.simulation.release import tracking_events
from dashpot.simulation.simulate import Scenario
from dashpot.simulation.trajectory import multisine
from dashpot.studies.lanes_cases import pinocchio_of
from dashpot.support.arrays import Floats

COUNT = 16  # scenarios side by side
SECONDS = 0.12  # of each
ROUNDS = 8
LEAST = {4: 10.0, 8: 20.0}  # times raw mj_step, closed loop of fr3
OPERATIONS: list[int] = []  # of the forward dynamics, as counted
SOURCES = Path(__file__).parent
ARMS = (("fr3", "fr3"), ("iiwa14", "iiwa14"), ("k807", "k807-wrist"))


def lanes(rows: Rows) -> None:
    """Seconds of CPU per physics step of one robot; whole closed loop, noise and recording on."""
    for name, law in ARMS:
        robot, config = Robot.load(name), load_controller(law)
        plant = build(robot, config.period, [Payload(1.0, (0.0, 0.0, 0.1))])
        controller = Controller.from_config(config, robot.drives)
        scenarios = []
        for seed in range(COUNT):
            path = multisine(robot.home, SECONDS, config.period, seed, amplitude=0.2, lead_in=config.period)
            scenarios.append(
                Scenario(plant, controller, path, tracking_events(config, path.start), seed=seed)
            )
        steps = COUNT * len(path.position) * round(config.period / plant.timestep)
        functions: dict[str, Timed] = {
            "raw": _raw(plant, steps, profiler=True),
            "bare": _raw(plant, steps, profiler=False),
        }
        for width in WIDTHS:
            functions[f"lanes{width}"] = _lanes(scenarios, width, steps)
        if name == "fr3":
            functions |= {"batch": _batch(plant, steps // COUNT), **_dynamics(plant)}
        best = interleave(functions, ROUNDS)
        about = f"{len(config.joints)} of {len(robot.joints)} joints, physics {plant.timestep * 1e6:.0f} us"
        rows.section("Vectorised arm against raw mj_step", f"{name}, {COUNT} scenarios, {about}")
        rows.add(f"lanes_{name}_raw", "raw mj_step, per physics step", best["raw"] * 1e6, "us")
        rows.add(
            f"lanes_{name}_bare",
            "the same without MuJoCo's profiler, which reads a clock",
            best["raw"] / best["bare"],
        )
        for width, words in WIDTHS.items():
            ratio = best["raw"] / best[f"lanes{width}"]
            least = LEAST.get(width) if name == "fr3" else None
            without = np.median(best["bare"] / best[f"lanes{width}"])
            note = (
                f"({1e6 * np.median(best[f'lanes{width}']):.3f} us a step; without profiler {without:.1f} x)"
            )
            rows.add(
                f"lanes_{name}_{width}",
                f"closed loop, {width} lanes ({words})",
                ratio,
                least=least,
                note=note,
            )
        if name == "fr3":
            _rivals(rows, best)


def _rivals(rows: Rows, best: dict[str, Floats]) -> None:
    rows.add("lanes_batch", "mujoco.batch, no controller", best["raw"] / best["batch"])
    rows.add("lanes_dynamics", "forward dynamics of the rigid links alone", best["dynamics"] * 1e6, "us")
    rows.add(
        "lanes_limit",
        "the same, were the core never to wait",
        best["limit"] * 1e6,
        "us",
        note=f"({OPERATIONS[0]} operations on {max(WIDTHS)} lanes at its best rate)",
    )
    if "pinocchio" in best:
        note = "(abaInParallel on one thread; no rotors, drives or sensors)"
        rows.add("lanes_pinocchio", "the same by Pinocchio", best["pinocchio"] * 1e6, "us", note=note)


def _cpu(act: Callable[[], object], count: int) -> float:
    begin = time.process_time()
    act()
    return (time.process_time() - begin) / count


def _raw(plant: Plant, steps: int, *, profiler: bool) -> Timed:
    data = mujoco.MjData(plant.model)

    def go() -> float:
        if profiler:
            mujoco.set_mjcb_time(None)  # as the package comes
        else:
            quiet_engine()
        mujoco.mj_resetData(plant.model, data)
        data.qpos[plant.rotor_qpos] = plant.robot.home
        mujoco.mj_forward(plant.model, data)
        return _cpu(lambda: mujoco.mj_step(plant.model, data, nstep=steps), steps)

    return go


def _batch(plant: Plant, steps: int) -> Timed:
    many = mujoco.batch.Batch(plant.model, COUNT, nthread=1)

    def go() -> float:
        mujoco.set_mjcb_time(None)
        many.reset()
        return _cpu(lambda: many.step(nstep=steps), steps * COUNT)

    return go


def _lanes(scenarios: list[Scenario], width: int, steps: int) -> Timed:
    def go() -> float:
        prepared = [LaneRun(scenario) for scenario in scenarios]
        raw, runs = prepared[0].tree.raw, [one.lane for one in prepared]
        seconds = _cpu(lambda: _native.run_lanes(raw, runs, width), steps)
        if any(run.diverged_tick >= 0 for run in runs):
            raise RuntimeError("the benchmark's closed loop diverged")
        return seconds

    return go


def _dynamics(plant: Plant) -> dict[str, Timed]:
    """Forward dynamics of random states, ours and Pinocchio's if it is installed; they must agree."""
    tree, count, again = tree_kept(plant), 32, 100  # few, again and again: from the caches
    rng, n = np.random.default_rng(0), tree.links
    q, qd, torque = (scale * rng.uniform(-1, 1, (count, n)) for scale in (3.0, 3.0, 50.0))
    body, found = np.repeat(tree.bodies[None], count, axis=0), np.empty((count, n))
    width = max(WIDTHS)

    def ours() -> float:
        def many() -> None:
            for _ in range(again):
                _native.forward_dynamics(tree.raw, body, q, qd, torque, found, None, None, width)

        return _cpu(many, count * again)

    functions: dict[str, Timed] = {"dynamics": ours, "limit": _limit(tree, width)}
    try:
        import pinocchio as pin
    except ImportError:
        return functions
    model = pinocchio_of(plant)
    pool, theirs = pin.ModelPool(model, 1), np.zeros((n, count))
    columns = [np.asfortranarray(part.T) for part in (q, qd, torque)]
    ours()
    pin.abaInParallel(1, pool, *columns, theirs)
    if not np.abs(theirs.T - found).max() < 1e-9 * np.abs(found).max():
        raise RuntimeError("Pinocchio's arm is another one")

    def pinocchio() -> float:
        def many() -> None:
            for _ in range(again):
                pin.abaInParallel(1, pool, *columns, theirs)

        return _cpu(many, count * again)

    functions["pinocchio"] = pinocchio
    return functions


def _limit(tree: Tree, width: int) -> Timed:
    """Operations that one state takes, counted, over those that this core does per second and lane."""
    native = SOURCES.parent / "native"
    flags = ["-std=c++17", "-O3", "-fPIC", "-shared", "-Wno-psabi", f"-I{native}", f"-I{native / 'lanes'}"]
    flags += [f"-I{SOURCES}", *{4: ["-mavx2"], 8: ["-mavx512f", "-mprefer-vector-width=512"]}.get(width, [])]
    compiler = os.environ.get("CXX", "c++")
    with tempfile.TemporaryDirectory() as folder:
        loaded = []
        for name, more in (("count", '-DDP_TYPES="lanes_limits.h"'), ("peak", f"-DDP_WIDTH={width}")):
            library = Path(folder) / f"{name}.so"
            source = str(SOURCES / "lanes_limits.cpp")
            subprocess.run([compiler, *flags, more, source, "-o", str(library)], check=True)
            loaded.append(ctypes.CDLL(str(library)))
    count, peak = loaded
    found, q = np.zeros(4, np.int64), np.linspace(-1, 1, tree.links)
    count.count(*(ctypes.c_void_p(part.ctypes.data) for part in (tree.raw, tree.bodies, q, found)))
    OPERATIONS[:] = [int(found.sum())]
    peak.peak.restype, peak.peak.argtypes = ctypes.c_double, [ctypes.c_double]
    return lambda: float(found.sum()) / peak.peak(1.0) / width


__all__ = ["lanes"]
