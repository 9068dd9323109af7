"""The real-time loop: its native cycle, and how punctual it is on this machine."""

from __future__ import annotations

import importlib.util
import time

import numpy as np
from measure import SETS, Rows, interleave

import dashpot._native as _native
from dashpot.arm.plant import build
from dashpot.arm.robot import Robot
from dashpot.commands.run import standing
from dashpot.commands.run_view import quantiles
from dashpot.control.controller import Controller, load_controller
from dashpot.control.supervisor import Supervisor, SupervisorSettings
from dashpot.hardware.interface import Sample
from dashpot.hardware.ring import Ring
from dashpot.hardware.runtime import LoopSettings, Outcome, control
from dashpot.hardware.sim import SimHardware
from dashpot.simulation.simulate import Scenario
from dashpot.simulation.trajectory import hold
from dashpot.studies.franka import take_turns

SECONDS = 20.0


# The arm's process may be held up as well: the benchmark goes on without samples, a robot would not.
PATIENT = SupervisorSettings(torque_age=1000, encoder_age=1000)


def supervised(robot: Robot) -> Supervisor:
    controller = Controller.from_config(load_controller("fr3"), robot.drives)
    return Supervisor(controller, robot.drives, PATIENT)


def native_cycle(robot: Robot, ring: Ring | None) -> _native.Cycle:
    """A cycle of seven joints at rest; its sensors repeat themselves, but the work is the same."""
    supervisor = supervised(robot)
    sample = Sample.of(robot.joints)
    sample.torque, sample.position = 0.01, robot.home
    sample.velocity = sample.in_effect = 0.0
    arrays = (sample.torque, sample.position, sample.velocity, sample.in_effect)
    reference = np.zeros((4, 1, len(robot.joints)))
    reference[0] = robot.home
    order = np.arange(len(robot.joints), dtype=np.int32)
    ages = (sample.torque_age, sample.encoder_age)
    memory = None if ring is None else ring.memory
    return _native.Cycle(supervisor.guard, (*arrays, *ages), order, reference, -1, 1e-3, 10, 20, memory)


def punctual(robot: Robot, *, paced: bool) -> Outcome:
    """A simulated arm in real time, held for `SECONDS` under the bundled controller."""
    supervisor = supervised(robot)
    plant = build(robot, supervisor.controller.period)
    path = hold(robot.home, SECONDS, supervisor.controller.period)
    scenario = Scenario(
        plant, Controller.from_config(load_controller("fr3"), robot.drives), standing(path, 4.0)
    )
    arm = SimHardware(scenario, paced=paced)
    settings = LoopSettings(late_cycles=10**6, longest_gap=10**6)  # to the end, whatever this machine does
    return control(arm, supervisor, path, start=arm.equilibrium(), settings=settings, ring=Ring().memory)


def run(rows: Rows) -> None:
    robot = Robot.load("fr3")
    cycles = {"cycle_ring": native_cycle(robot, Ring()), "cycle": native_cycle(robot, None)}
    guard = supervised(robot)

    def timed(work: object, count: int = 20_000) -> float:
        begin = time.thread_time()
        work.step_many(count)  # type: ignore[attr-defined]
        return (time.thread_time() - begin) / count

    best = interleave(
        {
            "guard": lambda: timed(guard.guard),
            **{name: (lambda cycle=cycle: timed(cycle)) for name, cycle in cycles.items()},  # type: ignore[misc]
        },
        10,
    )
    rows.section("Real-time loop, native cycle of 7 joints", "all that runs between read and write")
    rows.add("cycle_guard", "supervisor and controller alone", best["guard"] * 1e6, "us")
    rows.add("cycle", "cycle: ages, deadlines, limits, supervisor", best["cycle"] * 1e6, "us")
    rows.add("cycle_ring", "the same with a row of the log", best["cycle_ring"] * 1e6, "us", most=5.0)
    for paced, by in ((True, "the arm"), (False, "the loop's own clock")):
        outcome = punctual(robot, paced=paced)
        statistics = outcome.statistics
        granted = [m.name for m in outcome.measures if m.granted]
        rows.section(
            f"1 kHz for {SECONDS:g} s, paced by {by}",
            f"simulated fr3 in its own process; granted: {', '.join(granted) or 'nothing'}",
        )
        for share, value in zip((50, 99, 99.9), quantiles(statistics["jitter"]), strict=True):
            rows.add(f"jitter_{paced}_{share}", f"jitter, {share} %", np.full(SETS, value), "us")
        rows.add(f"jitter_{paced}_most", "jitter, most", np.full(SETS, 1e6 * statistics["jitter_most"]), "us")
        late = f"{statistics['late']} late, {statistics['lost']} ticks lost, {statistics['longest']} at once"
        rows.add(
            f"late_{paced}",
            f"late, of {statistics['cycles']} cycles",
            np.full(SETS, 100.0 * statistics["late"] / statistics["cycles"]),
            "%",
            note=late,
        )


def franka(rows: Rows) -> None:
    """Official pylibfranka and a simulated FR3 at 1 kHz, bare and with everything, in turns."""
    if importlib.util.find_spec("pylibfranka") is None:
        rows.more.append("franka: not measured, needs pip install 'dashpot[franka]'")
        return
    found = {name: np.array(values) for name, values in take_turns(SETS, 3000).items()}
    rows.section("FR3 through pylibfranka at 1 kHz", "processor time per cycle; packets of all cycles")
    rows.add("franka_bare", "bare readOnce, writeOnce", 1e6 * found["bare"], "us")
    rows.add("franka_ours", "ours", 1e6 * found["ours"], "us")
    added = (found["ours"] - found["bare"]) / 1e-3
    rows.add("franka_added", "added, of the cycle", added, "x", most=0.1)
    share = {who: found[f"lost_{who}"] / found[f"ticks_{who}"] for who in ("bare", "ours")}
    rows.add("franka_lost_bare", "packets lost, bare", share["bare"])
    lost = share["ours"] - share["bare"]
    rows.add("franka_lost_more", "ours less bare", lost, "x", most=0.0, note="the machine's load")
