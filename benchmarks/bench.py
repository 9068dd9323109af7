"""Speed of dashpot as ratios measured in one run: closed loop, step, allocation, threads,
certificate, design of an arm, campaign, vectorised arm, log, real-time loop.

    python benchmarks/bench.py [--json FILE] [--check] [--only PART ...]

Alternatives take turns, in rounds of some milliseconds, and a round counts CPU time of the thread, so that
other programs disturb all of them alike. The rounds are dealt into five sets; each gives a best-of, or a
ratio of two. Shown is the median of the five and, as spread, their smallest and largest. A target is missed
when all five miss it.
"""

from __future__ import annotations

import os

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # idle BLAS threads spin and would disturb the rest; before numpy

import argparse
import copy
import json
import platform
import sys
import time
from itertools import repeat
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import realtime
import rivals
from campaign import campaign
from certify import certificate
from design import design
from lanes import lanes
from log import log
from measure import SETS, Rows, Timed, bytes_in_use, calls, interleave
from rich.console import Console

import dashpot._native as _native
from dashpot.arm.plant import Plant, build
from dashpot.arm.robot import Robot
from dashpot.control.controller import Controller, ControllerConfig, JointGains, load_controller
from dashpot.control.sampled import NX
from dashpot.simulation.simulate import Scenario, run, run_many
from dashpot.simulation.trajectory import multisine
from dashpot.support.arrays import Floats


def fr3_config(robot: Robot, K: float = 0.0) -> ControllerConfig:
    """Seven joints at 1 kHz; gains of the right size."""
    large, wrist = {"D": 20.0, "kp": 600.0, "kd": 30.0}, {"D": 5.0, "kp": 150.0, "kd": 8.0}
    gains = [
        JointGains(name, R=5.0, K=K, **(large if i < 4 else wrist)) for i, name in enumerate(robot.joints)
    ]
    return ControllerConfig(tuple(gains), period=1e-3)


class Loop:
    """A closed loop, with the time of the native loop alone and the state it starts from."""

    def __init__(self, robot: Robot, config: ControllerConfig, seconds: float) -> None:
        self.plant, self.config = build(robot, config.period), config
        self.controller = Controller.from_config(config, robot.drives)
        self.trajectory = multisine(robot.home, seconds, config.period, 0, amplitude=0.3, lead_in=seconds / 3)
        self.steps = round(config.period / self.plant.timestep) * len(self.trajectory.position)
        self.data = mujoco.MjData(self.plant.model)
        self.rates = f"{1 / config.period:.0f} Hz, physics {self.plant.timestep * 1e6:.0f} us"

    def scenario(self, seed: int = 0, plant: Plant | None = None) -> Scenario:
        return Scenario(plant or self.plant, self.controller, self.trajectory, seed=seed)

    def measure(self, scenario: Scenario) -> tuple[float, Any, Floats, list[Any]]:
        """Seconds of the native loop, recording, initial qpos and joint states of a run."""
        seen: list[Any] = []

        def timed(*args: Any) -> object:
            seen.extend((args[6].copy(), [args[0].joint_state(i) for i in range(args[0].n)]))
            begin = time.thread_time()
            result = native_run(*args)
            seen.append(time.thread_time() - begin)
            return result

        native_run = _native.run
        _native.run = timed
        try:
            recording = run(scenario)
        finally:
            _native.run = native_run
        if recording.diverged_at is not None:
            raise RuntimeError("the benchmark's closed loop diverged")
        return seen[2], recording, seen[0], seen[1]

    def native(self) -> float:
        return self.measure(self.scenario())[0] / self.steps

    def whole(self) -> float:
        begin = time.thread_time()
        run(self.scenario())
        return (time.thread_time() - begin) / self.steps

    def raw(self) -> float:
        data = self.data
        mujoco.mj_resetData(self.plant.model, data)
        data.qpos[self.plant.rotor_qpos] = self.trajectory.position[0]
        mujoco.mj_forward(self.plant.model, data)
        begin = time.thread_time()
        mujoco.mj_step(self.plant.model, data, nstep=self.steps)
        return (time.thread_time() - begin) / self.steps


def python_loops(loop: Loop) -> dict[str, Timed]:
    """The Python loops over the first tenth of the run, checked against the native loop."""
    plant = copy.copy(loop.plant)
    plant.drives = loop.plant.drives.copy()
    plant.drives["sensor_noise"] = 0.0
    _, recording, qpos, states = loop.measure(loop.scenario(plant=plant))
    trajectory = copy.copy(loop.trajectory)
    ticks = len(trajectory.position) // 10
    short = {name: getattr(trajectory, name)[:ticks] for name in ("position", "velocity", "acceleration")}
    trajectory = type(trajectory)(trajectory.period, **short, start=trajectory.start)
    noise = np.random.default_rng(0).standard_normal(short["position"].shape)

    def go(plant: Plant, every_step: bool) -> tuple[float, Floats]:
        controller = Controller.from_config(loop.config, plant.robot.drives)
        for i, (_, _, _, torque, _, x) in enumerate(states):
            controller.core.preset(i, np.array(x), torque)
        return rivals.python_loop(plant, controller, trajectory, qpos, noise, every_step=every_step)

    error = np.abs(go(plant, True)[1] - recording.position[:ticks]).max()
    if not error < 1e-9:
        raise RuntimeError(f"the Python loop is not the same plant: positions differ by {error:g} rad")
    steps = loop.steps * ticks // len(loop.trajectory.position)
    return {
        "python": lambda: go(loop.plant, True)[0] / steps,
        "python_coarse": lambda: go(loop.plant, False)[0] / steps,
    }


def closed_loop(rows: Rows) -> None:
    robot = Robot.load("fr3")
    fr3 = Loop(robot, fr3_config(robot), 0.24)
    functions = {"raw": fr3.raw, "native": fr3.native, "whole": fr3.whole, **python_loops(fr3)}
    best = interleave(functions, 20)
    rows.section("Closed loop against raw mj_step", f"fr3, 7 of 7 joints, {fr3.rates}")
    rows.add("fr3_raw", "raw mj_step, per physics step", best["raw"] * 1e6, "us")
    rows.add("fr3_ratio", "native loop, noise, recording on", best["raw"] / best["native"], least=0.95)
    note = f"of {len(fr3.trajectory.position) * 1e-3:.2g} s simulated"
    rows.add("fr3_whole", "same with set-up: run()", best["raw"] / best["whole"], note=note)
    rows.add("fr3_python", "Python loop, same plant (< 1e-9 rad)", best["raw"] / best["python"])
    rows.add(
        "fr3_python_coarse",
        "Python loop, forces held over a tick",
        best["raw"] / best["python_coarse"],
        note="a coarser plant",
    )
    k807 = Loop(Robot.load("k807"), load_controller("k807-wrist"), 0.3)
    best = interleave({"raw": k807.raw, "native": k807.native}, 20)
    rows.section("Closed loop against raw mj_step", f"k807, 3 of 7 joints, {k807.rates}")
    rows.add("k807_raw", "raw mj_step, per physics step", best["raw"] * 1e6, "us")
    rows.add("k807_ratio", "native loop, noise, recording on", best["raw"] / best["native"])


def example_inputs(controller: Controller) -> Floats:
    """Plausible inputs, (7, n), also written to the controller's memory."""
    inputs = np.random.default_rng(1).uniform(-0.01, 0.01, (len(controller.inputs), len(controller.joints)))
    for view, row in zip(controller.inputs, inputs, strict=True):
        view[:] = row
    return inputs


def controller_step(rows: Rows) -> None:
    robot = Robot.load("fr3")
    controller = Controller.from_config(fr3_config(robot, K=50.0), robot.drives)
    inputs, out = example_inputs(controller), np.zeros(7)
    blocks, period = controller.blocks, controller.period
    one = Controller.from_config(fr3_config(robot), robot.drives)  # K_c = 0 as in the bundled files
    example_inputs(one)
    full = blocks.copy()
    full["nx"], full["A"] = NX, full["A"] + 0.1 * np.eye(NX) * (blocks["A"] == 0)
    large = Controller(full, controller.joints, period)
    example_inputs(large)
    w = np.zeros((7, len(inputs) + 1))
    w[:, 0], w[:, 2:] = inputs[0], inputs[1:].T
    batch = rivals.NumpyBlocks(blocks)
    batch.w[:] = w
    for _ in range(200):
        controller.step(out)
        if not np.allclose(batch.step(), out, rtol=1e-12, atol=1e-12):
            raise RuntimeError("the NumPy step does not do the same")

    def native(core: Any, count: int = 50_000) -> float:
        begin = time.thread_time()
        _native.step_many(core, count)
        return (time.thread_time() - begin) / count

    functions: dict[str, Timed] = {
        "native": lambda: native(controller.core),
        "native1": lambda: native(one.core),
        "native4": lambda: native(large.core),
        "out": calls(controller.step, 10_000, out),
        "inputs": calls(controller.step, 10_000, inputs, out),
        "numpy": calls(batch.step, 500),
        "scipy": calls(rivals.scipy_per_joint(blocks, w, period), 200),
        "dlsim": calls(rivals.scipy_dlsim(blocks, w, period), 50),
    }
    control = rivals.python_control(blocks, w, period)
    if control:
        functions["control"] = calls(control, 200)
    best = interleave(functions, 12)
    rows.section("One controller step of 7 joints", "2 states a joint; in brackets: over native")
    for key, what, scale, unit, most in (
        ("native", "native: step_many", 1e9, "ns", 150.0),
        ("native1", "native, 1 state each (K_c = 0)", 1e9, "ns", None),
        ("native4", f"native, {NX} states each", 1e9, "ns", None),
        ("out", "Python: step(out)", 1e6, "us", 1.0),
        ("inputs", "Python: step(inputs, out)", 1e6, "us", None),
        ("numpy", "NumPy, batched, limits", 1e6, "us", None),
        ("scipy", "scipy.signal matrices, joint by joint", 1e6, "us", None),
        ("dlsim", "scipy.signal.dlsim, one tick", 1e6, "us", None),
        ("control", "python-control: output + dynamics", 1e6, "us", None),
    ):
        if key in best:
            ratio = float(np.median(best[key] / best["native"]))
            rows.add(f"step_{key}", what, best[key] * scale, unit, most=most, note=f"({ratio:.3g} x)")
        else:
            rows.table.add_row(what, "not installed", "", "", "pip install dashpot\\[bench]")


def allocation(rows: Rows) -> None:
    rows.section("Memory in use after minus before", "bytes of malloc")
    robot = Robot.load("fr3")
    controller = Controller.from_config(fr3_config(robot), robot.drives)
    example_inputs(controller)
    out = np.zeros(7)

    def many() -> None:
        for _ in repeat(None, 100_000):
            controller.step(out)

    for key, what, work in (
        ("malloc_native", "1e6 native steps", lambda: _native.step_many(controller.core, 1_000_000)),
        ("malloc_python", "1e5 calls of step(out)", many),
    ):
        grown, blocks = np.zeros(SETS), 0
        work()
        bytes_in_use()
        for i in range(SETS):
            before, count = bytes_in_use(), sys.getallocatedblocks()
            work()
            blocks = max(blocks, sys.getallocatedblocks() - count)
            grown[i] = (bytes_in_use() or 0) - (before or 0)
        if before is None:
            rows.table.add_row(what, "not measured", "", "", "needs glibc's mallinfo2")
        else:
            rows.add(key, what, grown, "B", most=0, note=f"Python blocks: {blocks:+d}")
    rows.table.add_row("the core calls no allocator", "", "", "", "nm -u: tests/test_core.py")


def threads(rows: Rows) -> None:
    robot = Robot.load("fr3")
    loop = Loop(robot, fr3_config(robot), 0.75)
    scenarios = [loop.scenario(seed) for seed in range(16)]

    def wall(count: int) -> float:
        begin = time.perf_counter()
        run_many(scenarios, threads=count, reduce=lambda *_: None)
        return time.perf_counter() - begin

    best = interleave({"one": lambda: wall(1), "two": lambda: wall(2)}, 2)
    rows.section("run_many, 16 scenarios of 1 s of fr3", f"wall clock, {os.cpu_count()} cores")
    rows.add("threads_one", "one thread", best["one"], "s")
    rows.add("threads_speedup", "two threads: times faster", best["one"] / best["two"])


_PARTS = (
    closed_loop,
    controller_step,
    allocation,
    threads,
    certificate,
    design,
    campaign,
    lanes,
    log,
    realtime.run,
    realtime.franka,
)
PARTS = {part.__name__: part for part in _PARTS}


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--json", type=Path, help="write the numbers to this file")
    parser.add_argument("--check", action="store_true", help="exit with 1 where a target is missed")
    parser.add_argument("--only", nargs="+", choices=PARTS, default=list(PARTS), help="parts to run")
    options = parser.parse_args()
    rows, begin, load = Rows(), time.perf_counter(), os.getloadavg()[0]
    for part in options.only:
        PARTS[part](rows)
    versions = f"Python {platform.python_version()}, MuJoCo {mujoco.__version__}, NumPy {np.__version__}"
    taken = f"load {load:.1f} before, {os.getloadavg()[0]:.1f} after, {time.perf_counter() - begin:.0f} s"
    rows.table.caption = f"median and range of {SETS} best-ofs; {versions}; {platform.machine()}; {taken}"
    Console(width=None if sys.stdout.isatty() else 110).print(rows.table, *rows.more)
    if options.json:
        about = {"versions": versions, "machine": platform.machine(), "run": taken, "missed": rows.missed}
        options.json.write_text(json.dumps({**about, "results": rows.results}, indent=1) + "\n")
    if rows.missed and options.check:
        print(f"missed: {', '.join(rows.missed)}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
