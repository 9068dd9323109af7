"""The real-time loop: its laws in lock-step, and the safe state at every end."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_supervisor import H, guarded

from dashpot import _native
from dashpot.arm.payload import Payload
from dashpot.arm.plant import build
from dashpot.arm.robot import Robot
from dashpot.cli import main
from dashpot.commands.run_link import standing
from dashpot.control.controller import Controller, load_controller
from dashpot.control.supervisor import Supervisor, SupervisorSettings
from dashpot.hardware.interface import Sample
from dashpot.hardware.ring import COLUMNS, ROW_DTYPE, Ring
from dashpot.hardware.runtime import LoopSettings, control
from dashpot.hardware.sim import LinkSettings, SimHardware
from dashpot.simulation.faults import Fault
from dashpot.simulation.prepare import encoder_ranges
from dashpot.simulation.recording import CHANNELS, Recording
from dashpot.simulation.simulate import PayloadChange, Scenario, run
from dashpot.simulation.trajectory import Trajectory, multisine

CALM = LoopSettings(priority=0)  # nothing is asked of the operating system
FLOW = replace(CALM, flow=True)


def columns(path: Trajectory, chosen: list[int]) -> Trajectory:
    arrays = {key: getattr(path, key)[:, chosen] for key in ("position", "velocity", "acceleration")}
    return replace(path, **arrays)


class Bench:
    """A scenario of simulate, and the same as a robot behind a link with a supervisor on this side."""

    def __init__(self, name: str, controller: str, *, seconds=0.6, after=0.3, **about):
        robot, config = Robot.load(name), load_controller(controller)
        self.plant = build(robot, config.period)
        self.path = multisine(robot.home, seconds, config.period, 3, amplitude=0.3, lead_in=0.1)
        made = Controller.from_config(config, robot.drives)
        self.scenario = Scenario(
            self.plant, made, self.path, supervisor=SupervisorSettings(stop_time=0.5), **about
        )
        self.supervisor = Supervisor(
            Controller.from_config(config, robot.drives),
            robot.drives,
            self.scenario.supervisor,
            limits=encoder_ranges(self.plant),
        )
        self.motion = columns(self.path, [robot.index(joint) for joint in made.joints])
        self.after = after

    def arm(self, tmp_path: Path, **means) -> SimHardware:
        self.record = tmp_path / "arm.npz"
        link = LinkSettings(record=self.record, after=self.after, **{"realtime": False, **means})
        longer = replace(self.scenario, trajectory=standing(self.path, 2.0 + self.after))
        return SimHardware(longer, link, supervisor=self.supervisor)

    def control(self, tmp_path: Path, **about):
        arm = self.arm(tmp_path)
        outcome = control(arm, self.supervisor, self.motion, start=arm.equilibrium(), settings=FLOW, **about)
        return outcome, Recording.load(self.record)


def same(a: Recording, b: Recording, ticks: int) -> None:
    for channel in CHANNELS:
        np.testing.assert_array_equal(
            getattr(a, channel)[:ticks], getattr(b, channel)[:ticks], err_msg=channel
        )


# --- lock-step is simulate ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("robot", "controller", "faults", "changes"),
    [
        ("fr3", "fr3", (), (PayloadChange(0.2, Payload(2.0)),)),
        ("k807", "k807-wrist", (Fault("encoder_frozen", 0.3, joint="joint6"),), ()),
        (
            "fr3",
            "fr3",
            (
                Fault("torque_nan", 0.2, joint="joint2"),
                Fault("samples_dropped", 0.1, joint="joint5", value=0.2),
            ),
            (),
        ),
        ("k807", "k807-wrist", (Fault("samples_late", 0.1, end=0.4, value=2.0),), ()),
    ],
    ids=["payload", "frozen encoder", "no torque", "late samples"],
)
@pytest.mark.parametrize("carried", [False, True], ids=["bare", "carried"])
def test_lock_step_has_the_bits_of_simulate(tmp_path, robot, controller, faults, changes, carried):
    if carried and robot == "k807":
        pytest.skip("has no gravity compensation of its own")
    bench = Bench(
        robot, controller, faults=faults, payload_changes=changes, seed=7, gravity_compensation=carried
    )
    whole = run(bench.scenario)
    outcome, recorded = bench.control(tmp_path)
    # A run hands an arm that has come to rest to its brakes; simulate goes on to watch it.
    parked = [d.tick for d in outcome.decisions if d.reason == "parked"]
    ticks = min([len(whole.time), recorded.settings["watchdog_at"], *parked])
    assert ticks * bench.scenario.controller.period > 0.3
    first = min([ticks, *(d.tick - 3 for d in outcome.decisions)]) if carried else ticks
    same(whole, recorded, first)
    # Where samples are bad, the weight is known in simulate, and part of what is bridged over a link.
    np.testing.assert_allclose(
        whole.link_position[first:ticks], recorded.link_position[first:ticks], atol=1e-7
    )
    said = [(d["tick"], d["reason"]) for d in whole.settings["supervisor"]["decisions"] if d["tick"] < ticks]
    assert [(d.tick, d.reason) for d in outcome.decisions if d.tick < ticks] == said
    assert outcome.state == "safe"
    assert outcome.statistics["late"] == outcome.statistics["same"] == 0
    assert outcome.end == ("supervisor" if said or not outcome.braked else "done")


def test_an_arm_that_carries_itself_does_not_sink_while_it_is_stopped(tmp_path):
    arms = [Bench("fr3", "fr3", gravity_compensation=carried).control(tmp_path) for carried in (True, False)]
    sunk = []
    for (outcome, recorded), end in zip(arms, ("done", "supervisor"), strict=True):
        assert outcome.end == end  # who could not be braked to rest has not just come to the end
        asked, links = outcome.decisions[0].tick, recorded.link_position
        sunk.append(np.nanmax(np.abs(links[asked:] - links[asked])))
    assert sunk[0] < 0.03  # it moves at 0.6 rad/s when it is stopped
    assert sunk[1] > 5 * sunk[0]


# --- the cycle ---------------------------------------------------------------------------------------------

TORQUES = st.floats(allow_nan=True, allow_infinity=True, width=64)
AGES = st.integers(-(2**31), 2**31 - 1)


def cycle_of(supervisor, *, ticks=1, until=-1, ring=None, late_cycles=10, longest_gap=20, reference=0.0):
    n = len(supervisor.controller.joints)
    sample = Sample.of(supervisor.controller.joints)
    for name in ("torque", "position", "velocity", "in_effect"):
        setattr(sample, name, 0.0)
    arrays = (sample.torque, sample.position, sample.velocity, sample.in_effect)
    path = np.zeros((4, ticks, n))
    path[0] = reference
    cycle = _native.Cycle(
        supervisor.guard,
        (*arrays, sample.torque_age, sample.encoder_age),
        np.arange(n, dtype=np.int32),
        path,
        until,
        H,
        late_cycles,
        longest_gap,
        ring,
    )
    return cycle, sample


@settings(max_examples=150, deadline=None)
@given(
    st.lists(
        st.tuples(TORQUES, TORQUES, TORQUES, TORQUES, AGES, AGES, TORQUES, st.booleans()),
        min_size=1,
        max_size=60,
    ),
    st.integers(0, 3),
    TORQUES,
)
def test_no_sample_makes_a_torque_that_is_not_finite_or_beyond_its_limits(garbage, latency, reference):
    supervisor = guarded(2, latency)
    cycle, sample = cycle_of(supervisor, reference=reference)
    block = supervisor.controller.blocks[0]
    limit, rate = block["torque_limit"], block["rate_limit"]
    last, phases = np.zeros(2), [0]
    for tick, (torque, position, velocity, effect, age, other, clock, well) in enumerate(garbage):
        if not well:
            sample.torque, sample.position, sample.velocity, sample.in_effect = (
                torque,
                position,
                velocity,
                effect,
            )
            sample.torque_age[:], sample.encoder_age[:] = age, other
        phases.append(cycle.step(tick * H if well else clock))
        assert np.isfinite(cycle.out).all()
        assert (np.abs(cycle.out) <= limit).all()
        assert (np.abs(cycle.out - last) <= rate * (1 + 1e-12)).all()
        last = cycle.out.copy()
    assert phases == sorted(phases)  # a run never goes back


def test_lost_ticks_age_the_samples_and_too_many_stop_the_arm():
    def outcome(times, **limits):
        supervisor = guarded(1)
        cycle, sample = cycle_of(supervisor, **limits)
        for i, time_ in enumerate(times):
            sample.torque = 0.1 * math.sin(i)
            cycle.step(time_ * H)
        reasons = [(d.reason, d.after) for d in supervisor.log]
        return cycle.statistics, reasons

    statistics, reasons = outcome(range(100))
    assert (statistics["cycles"], statistics["late"], statistics["lost"], reasons) == (100, 0, 0, [])
    # One stall that is short enough is bridged, one that is not is the end.
    statistics, reasons = outcome([*range(50), *range(65, 100)])
    assert (statistics["late"], statistics["lost"], statistics["longest"], reasons) == (1, 15, 15, [])
    assert outcome([*range(50), *range(75, 100)])[1] == [("host", "torque_brake")]
    # Every second tick lost is half the sample rate: not what was certified.
    assert outcome(range(0, 400, 2))[1][0] == ("host", "torque_brake")
    # More than can be bridged, again and again: both signals are too old.
    assert {after for _, after in outcome(range(0, 400, 5))[1]} == {"safe"}
    # A beat of two clocks loses nothing.
    beat = [tick - tick % 2 for tick in range(400)]
    statistics, reasons = outcome(beat)
    assert (reasons, statistics["same"]) == ([], 200)
    # A clock that stands means no samples.
    assert outcome([0, 1, 2] + 20 * [3])[1][0][1] == "safe"
    assert outcome([0, 1, 2] + 20 * [math.nan])[1][0][1] == "safe"


def test_the_reference_keeps_the_time_of_the_robot_and_stands_at_its_end():
    supervisor = guarded(1)
    ring = Ring(rows=64)
    path = np.arange(10.0)[:, None] * 1e-4
    cycle, sample = cycle_of(supervisor, ticks=10, ring=ring.memory, reference=path)
    for tick in (0, 1, 2, 5, 6, 9, 12):
        sample.torque = 0.01 * tick
        cycle.step(100.0 + tick * H)
    seen = ring.drain()["reference"][:, 0]
    np.testing.assert_allclose(seen, 1e-4 * np.array([0, 1, 2, 5, 6, 9, 9]))


@settings(max_examples=50, deadline=None)
@given(st.lists(st.integers(0, 40), min_size=1, max_size=30), st.integers(1, 32))
def test_a_ring_gives_every_row_once_in_order_or_counts_it(bursts, rows):
    supervisor = guarded(1)
    ring = Ring(rows=rows)
    cycle, sample = cycle_of(supervisor, ring=ring.memory)
    got, tick = [], 0
    for burst in bursts:
        for _ in range(burst):
            sample.torque = math.sin(tick)
            cycle.step(tick * H)
            tick += 1
        got += list(ring.drain()["tick"])
    got += list(ring.drain()["tick"])
    assert got == sorted(set(got))
    assert len(got) + ring.missed == tick
    if max(bursts) < rows:
        assert ring.missed == 0


def test_a_ring_read_while_it_is_written_never_gives_half_a_row():
    supervisor = guarded(3)
    ring = Ring(rows=16)
    cycle, _ = cycle_of(supervisor, ring=ring.memory)
    writer = threading.Thread(target=cycle.step_many, args=(300_000,))
    writer.start()
    seen, last, writing, rows = 0, -1, True, ()
    while writing or len(rows):
        writing = writer.is_alive()
        rows = ring.drain()
        if len(rows):
            ticks = rows["tick"]
            np.testing.assert_array_equal(ticks, np.arange(ticks[0], ticks[0] + len(ticks)))
            np.testing.assert_array_equal(rows["clock"] % 300_000, ticks)  # step_many's count
            assert ticks[0] > last
            last = ticks[-1]
            seen += len(rows)
    writer.join()
    assert seen > 0


def test_layouts_are_the_native_ones():
    assert ROW_DTYPE.itemsize == _native.ROW_SIZE
    assert len(COLUMNS) + 4 == _native.ROW_COLUMNS


def test_an_array_assigned_to_a_sample_is_copied():
    sample = Sample.of(("a", "b"))
    array = sample.torque
    sample.torque = np.array([1.0, 2.0])
    sample.torque_age = 3
    assert sample.torque is array
    assert list(array) == [1.0, 2.0]
    assert list(sample.torque_age) == [3, 3]


# --- every end is the safe state ---------------------------------------------------------------------------


def resting(recorded: Recording, seconds: float = 0.1) -> None:
    """At its end the arm has no torque and, but for the links' ringing, does not move: its brakes hold it."""
    there = np.isfinite(recorded.position).all(1)
    last = np.flatnonzero(there)[-1]
    ticks = max(2, round(seconds / (recorded.time[1] - recorded.time[0])))
    controlled = np.abs(recorded.in_effect[last]) == 0
    assert controlled.any()
    assert np.isfinite(recorded.in_effect[: last + 1]).all()
    angle = recorded.position[last - ticks : last + 1]
    assert np.ptp(angle[:, controlled], axis=0).max() < 2e-3
    assert np.abs(recorded.velocity[last - 5 : last + 1, controlled].mean(0)).max() < 0.02


class Wrapped:
    """A simulated arm whose adapter breaks in some way, some time."""

    def __init__(self, arm: SimHardware, at: int, call: str, how) -> None:
        self.arm, self.at, self.call, self.how, self.count = arm, at, call, how, 0
        self.joints, self.period, self.paced = arm.joints, arm.period, arm.paced
        self.calls: list[str] = []

    def __getattr__(self, name):
        if name not in ("start", "read", "write", "apply_brake", "stop"):
            return getattr(self.arm, name)

        def call(*arguments):
            self.calls.append(name)
            self.count += name == "read"
            if name == self.call and self.count >= self.at:
                return self.how(self.arm)
            return getattr(self.arm, name)(*arguments)

        return call


def broken(_):
    raise ValueError("the bus\nis down")


def lost(arm):
    arm.reason = "emergency stop pressed"
    return False


@pytest.mark.parametrize(
    ("call", "how", "end", "reason"),
    [
        ("read", broken, "failed", "ValueError: the bus is down"),
        ("read", lost, "robot", "emergency stop pressed"),
    ],
    ids=["read raises", "read is False"],
)
def test_a_failing_adapter_ends_with_closed_brakes(tmp_path, call, how, end, reason):
    bench = Bench("k807", "k807-wrist", after=0.6)
    arm = bench.arm(tmp_path)
    broken_arm = Wrapped(arm, 60, call, how)
    outcome = control(broken_arm, bench.supervisor, bench.motion, start=arm.equilibrium(), settings=FLOW)
    assert (outcome.end, outcome.reason, outcome.problems) == (end, reason, ())
    assert broken_arm.calls[-2:] == ["apply_brake", "stop"]
    resting(Recording.load(bench.record))


def test_brakes_that_raise_do_not_keep_the_motors_on(tmp_path):
    bench = Bench("k807", "k807-wrist", after=0.6)
    arm = bench.arm(tmp_path)
    outcome = control(
        Wrapped(arm, 60, "apply_brake", broken),
        bench.supervisor,
        bench.motion,
        start=arm.equilibrium(),
        settings=FLOW,
    )
    assert outcome.end == "failed"  # at the end of the motion, in the loop
    resting(Recording.load(bench.record))


def test_an_arm_that_dies_is_a_lost_link(tmp_path):
    bench = Bench("k807", "k807-wrist")
    arm = bench.arm(tmp_path)
    outcome = control(
        Wrapped(arm, 60, "write", lambda arm: arm.process.kill()),
        bench.supervisor,
        bench.motion,
        start=arm.equilibrium(),
        settings=FLOW,
    )
    assert outcome.end == "robot"
    assert "the link to the arm is lost" in outcome.reason
    arm.stop()  # again: does nothing


def test_silence_closes_the_brakes_on_the_robots_side(tmp_path):
    bench = Bench("k807", "k807-wrist", after=0.6)
    arm = bench.arm(tmp_path, watchdog=7)
    sample = Sample.of(arm.joints)
    arm.start()
    for _ in range(50):
        assert arm.read(sample)
        arm.write(np.zeros(3))
    arm._socket.close()  # not a word more
    arm.process.wait(60)
    recorded = Recording.load(bench.record)
    assert recorded.settings["watchdog_at"] == 49 + 7  # ticks count from zero
    resting(recorded)


def test_the_watchdog_tells_a_host_that_was_away(tmp_path):
    bench = Bench("k807", "k807-wrist")
    arm = bench.arm(tmp_path, realtime=True, watchdog=3)
    sample = Sample.of(arm.joints)
    arm.start()
    assert arm.read(sample)
    time.sleep(20 * arm.period)
    while arm.read(sample):
        arm.write(np.zeros(3))
    assert "watchdog" in arm.reason
    arm.stop()


LONG = (
    "run",
    "k807",
    "k807-wrist",
    "--uncertified",
    "--lock-step",
)  # hangs on nothing else this machine does


def long_run(tmp_path: Path) -> tuple[list[str], Path, Path]:
    """Arguments of a run in whose midst the arm moves, its log, and the arm's own recording."""
    record, log, motion = tmp_path / "arm.npz", tmp_path / "run.mcap", tmp_path / "motion.csv"
    ticks = np.arange(0, 300.0, 0.1)
    wave = 0.3 * (1 - np.cos(2 * np.pi * 0.25 * ticks))
    rows = [f"{t:.2f},{w:.6f}" for t, w in zip(ticks, wave, strict=True)]
    motion.write_text("\n".join(["time,joint6/position", *rows]) + "\n")
    return [*LONG, *map(str, ("--motion", motion, "--record", record, "--log", log))], log, record


def until_it_moves(log: Path) -> None:
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline and (not log.exists() or log.stat().st_size < 200_000):
        time.sleep(0.02)


def left(record: Path) -> Recording:
    deadline = time.monotonic() + 60
    while not record.exists() and time.monotonic() < deadline:
        time.sleep(0.05)
    return Recording.load(record)


def test_ctrl_c_brakes_to_rest(tmp_path, capsys):
    arguments, log, record = long_run(tmp_path)

    def press() -> None:
        until_it_moves(log)
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=press)
    thread.start()
    with pytest.raises(SystemExit) as left_with:
        main(arguments)
    thread.join()
    said = capsys.readouterr().out
    assert left_with.value.code == 130, said
    assert "the operator asked for a stop" in said
    assert "braked to rest, motors off, mechanical brakes closed" in said
    recorded = left(record)
    resting(recorded)
    assert np.nanmax(np.abs(recorded.velocity[:, 5])) > 0.1  # it did move


@pytest.mark.parametrize(
    "numbers", [(signal.SIGTERM,), (signal.SIGINT, signal.SIGTERM)], ids=["once", "twice"]
)
def test_a_signal_asks_for_a_stop_and_a_second_one_does_not_wait(tmp_path, numbers):
    bench = Bench("k807", "k807-wrist", after=0.6)
    arm = bench.arm(tmp_path)

    def sent(arm):
        for number in numbers if wrapped.count == 60 else ():
            signal.raise_signal(number)
        return SimHardware.read(arm, wrapped.sample)

    wrapped = Wrapped(arm, 60, "read", sent)
    wrapped.sample = None
    read = wrapped.read

    def reading(sample):
        wrapped.sample = sample
        return read(sample)

    wrapped.__dict__["read"] = reading
    handlers = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    outcome = control(wrapped, bench.supervisor, bench.motion, start=arm.equilibrium(), settings=FLOW)
    assert (outcome.end, outcome.signal) == ("stopped", numbers[0])
    assert (outcome.state, outcome.braked) == (
        ("safe", True) if len(numbers) == 1 else ("torque_brake", False)
    )
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == handlers
    resting(Recording.load(bench.record))


def test_a_killed_host_leaves_an_arm_at_rest(tmp_path):
    arguments, log, record = long_run(tmp_path)
    process = subprocess.Popen(
        [sys.executable, "-m", "dashpot", *arguments], stdout=subprocess.DEVNULL, start_new_session=True
    )
    until_it_moves(log)
    process.kill()
    process.wait()
    recorded = left(record)
    assert not recorded.settings["stopped"]  # nobody said stop
    tripped = recorded.settings["watchdog_at"]
    assert np.abs(recorded.in_effect[tripped - 1]).max() > 0.1  # until then the last torque was held
    assert (recorded.in_effect[tripped - 19 : tripped, 4:] == recorded.in_effect[tripped - 1, 4:]).all()
    assert (
        recorded.in_effect[tripped + 1 :][np.isfinite(recorded.in_effect[tripped + 1 :]).all(1)][:, 4:] == 0
    ).all()
    resting(recorded)
