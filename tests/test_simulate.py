"""The closed-loop runner as a user meets it: repeatable, checked, and its recordings."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from test_plant import one_joint, torque_source, vpc

from dashpot.arm.drive import Servo
from dashpot.arm.payload import Payload
from dashpot.arm.plant import build
from dashpot.arm.robot import Robot
from dashpot.control.controller import Controller, ControllerConfig, JointGains
from dashpot.control.sampled import POSITION_REF, empty_block
from dashpot.errors import InputError
from dashpot.simulation.recording import CHANNELS, Recording
from dashpot.simulation.simulate import Event, Scenario, run, run_many, simulate
from dashpot.simulation.trajectory import Trajectory, hold, multisine

WRIST = tuple(JointGains(f"joint{i}", R=5.0, D=3.0, K=0.5, kp=60.0, kd=4.0) for i in (5, 6, 7))
CONFIG = ControllerConfig(WRIST, period=5e-3)


def same(a, b):
    return all(
        np.array_equal(getattr(a, name), getattr(b, name), equal_nan=True) for name in (*CHANNELS, "status")
    )


@pytest.fixture(scope="module")
def k807():
    robot = Robot.load("k807")
    return build(robot, 5e-3, [Payload(2.27, 0.1)]), Controller.from_config(CONFIG, robot.drives)


@pytest.fixture
def joint(tmp_path):
    robot = one_joint(tmp_path, torque_noise=0.05, coulomb_friction=0.5)
    return build(robot, 5e-3), vpc(robot, 5e-3, 5.0, 3.0, 0.5, kp=60.0, kd=4.0)


def test_bits_do_not_depend_on_threads_or_order(k807):
    plant, controller = k807
    scenarios = [
        Scenario(plant, controller, multisine(plant.robot.home, 0.3, 5e-3, seed, lead_in=0.1), seed=seed)
        for seed in range(6)
    ]
    alone = [run(scenario) for scenario in scenarios]
    for threads, order in ((1, range(6)), (2, range(6)), (2, [5, 1, 3, 0, 4, 2])):
        found = run_many([scenarios[i] for i in order], threads=threads)
        assert all(same(found[k], alone[i]) for k, i in enumerate(order))
    assert not same(alone[0], alone[1])
    assert all(r.diverged_at is None and np.isfinite(r.position).all() for r in alone)


def test_reduce_sees_each_scenario_and_its_recording(joint):
    plant, controller = joint
    scenarios = [Scenario(plant, controller, hold([0.0], 0.1, 5e-3), seed=i, label=str(i)) for i in range(4)]
    found = run_many(scenarios, threads=2, reduce=lambda s, r: (s.label, r.settings["seed"], len(r.time)))
    assert found == [(str(i), i, 20) for i in range(4)]


def test_every_scenario_starts_fresh(joint):
    plant, controller = joint
    moving = Scenario(plant, controller, multisine([0.0], 0.5, 5e-3, 0, lead_in=0.0))
    first = run(moving)
    run(replace(moving, events=[Event(0.1, "j", "mode", "off"), Event(0.2, "j", "position_loop", False)]))
    controller.set_mode("j", "off")
    controller.step(np.zeros(1))
    assert same(run(moving), first)
    assert not plant.drives["friction_z"].any()


def test_seeds_change_the_noise_and_nothing_else(joint):
    plant, _ = joint
    source = torque_source(["j"], 5e-3)
    rest = np.zeros((200, 1))
    motion = Trajectory(5e-3, rest, np.sin(np.arange(200))[:, None], rest)
    a, b = (run(Scenario(plant, source, motion, seed=seed)) for seed in (0, 1))
    for name in set(CHANNELS) - {"sample"}:
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    assert (a.sample != b.sample).all()


def test_the_short_way_is_the_long_way(k807):
    plant, controller = k807
    trajectory = hold(plant.robot.home, 0.1, 5e-3)
    short = simulate(plant.robot, CONFIG, trajectory, payloads=[Payload(2.27, 0.1)], seed=3)
    assert same(short, run(Scenario(plant, controller, trajectory, seed=3)))
    servos = simulate(
        plant.robot.with_drives({n: {"servo": Servo(kp=1e4, kd=200.0)} for n in plant.robot.joints}),
        None,
        trajectory,
    )
    assert np.abs(servos.position - trajectory.position).max() < 0.1
    assert not servos.status.any()


# --- recordings -----------------------------------------------------------------------------------


def test_a_recording_survives_its_file(k807, tmp_path):
    plant, controller = k807
    recording = run(Scenario(plant, controller, hold(plant.robot.home, 0.1, 5e-3), label="first"))
    recording.diverged_at = 0.05
    recording.position[15:] = np.nan
    path = recording.save(tmp_path / "deep" / "r.npz")
    loaded = Recording.load(path)
    assert same(loaded, recording)
    for name in ("joints", "diverged_at", "settings"):
        assert getattr(loaded, name) == getattr(recording, name)
    np.testing.assert_array_equal(loaded.time, recording.time)
    np.testing.assert_array_equal(loaded.reference, recording.reference)
    assert [p.name for p in path.parent.iterdir()] == ["r.npz"]


@pytest.mark.parametrize("error", [OSError("disk full"), KeyboardInterrupt()])
def test_an_interrupted_write_leaves_nothing_and_spares_the_old_file(joint, tmp_path, monkeypatch, error):
    plant, controller = joint
    recording = run(Scenario(plant, controller, hold([0.0], 0.1, 5e-3)))
    folder = tmp_path / "out"
    recording.save(folder / "old.npz")
    before = (folder / "old.npz").read_bytes()

    def half(stream, **_):
        stream.write(b"PK half a file")
        raise error

    monkeypatch.setattr(np, "savez_compressed", half)
    for name in ("old.npz", "new.npz"):
        with pytest.raises(type(error)):
            recording.save(folder / name)
    assert [p.name for p in folder.iterdir()] == ["old.npz"]
    assert (folder / "old.npz").read_bytes() == before


def test_what_is_no_recording_is_refused(joint, tmp_path):
    plant, controller = joint
    path = run(Scenario(plant, controller, hold([0.0], 0.1, 5e-3))).save(tmp_path / "r.npz")
    raw = path.read_bytes()
    other = tmp_path / "other.npz"
    np.savez(other, a=1)
    array = tmp_path / "array.npy"
    np.save(array, np.zeros(3))
    cases = [b"", b"hello", raw[: len(raw) // 2], raw[:40] + bytes(len(raw) // 2) + raw[40 + len(raw) // 2 :]]
    for k, content in enumerate(cases):
        (tmp_path / f"{k}.npz").write_bytes(content)
    for bad in (other, array, tmp_path, *(tmp_path / f"{k}.npz" for k in range(len(cases)))):
        with pytest.raises(InputError, match="not a dashpot recording"):
            Recording.load(bad)
    with pytest.raises(InputError, match="no such file"):
        Recording.load(tmp_path / "none.npz")


# --- events ---------------------------------------------------------------------------------------


def counting(folder, *, blend=0.0):
    """A joint whose active law commands the position reference and whose bypass commands 7."""
    block = empty_block()
    block["D"][POSITION_REF] = 1.0
    block["bypass"][POSITION_REF] = -1.0
    block["blend"] = blend
    robot = one_joint(folder)
    reference = 1.0 + np.arange(40.0)[:, None] / 100
    trajectory = Trajectory(5e-3, reference, 0 * reference, 0 * reference, start=-0.05)
    return build(robot, 5e-3), Controller(np.array([block]), ["j"], 5e-3, "point"), trajectory


def test_events_take_effect_at_their_tick(tmp_path):
    plant, law, trajectory = counting(tmp_path)
    events = [
        Event(0.1, "j", "mode", "active"),
        Event(0.05, "all", "mode", "bypass"),
        Event(0.12, "j", "position_loop", False),
        Event(0.13, "j", "position_loop", True),
        Event(-0.05, "j", "mode", "off"),
        Event(0.0, "j", "mode", "active"),
    ]
    recording = run(Scenario(plant, law, trajectory, events))
    expected = trajectory.position[:, 0].copy()
    expected[:10] = 0.0
    expected[20:30] *= -1
    expected[34:36] = 0.0
    np.testing.assert_allclose(recording.command[:, 0], expected)


def test_events_at_the_same_time_act_in_the_order_given(tmp_path):
    plant, law, trajectory = counting(tmp_path)
    for last in ("off", "active"):
        events = [Event(0.0, "j", "mode", m) for m in ("off", "active", last)]
        assert (run(Scenario(plant, law, trajectory, events)).command[10:] != 0).all() == (last == "active")


def test_a_latency_delays_the_torque_by_whole_ticks(tmp_path):
    plant, law, trajectory = counting(tmp_path)
    law.blocks["latency"] = 2
    recording = run(Scenario(plant, law, trajectory))
    np.testing.assert_array_equal(recording.in_effect[2:], recording.command[:-2])
    np.testing.assert_array_equal(recording.in_effect[:2], 0)


@pytest.mark.parametrize(
    ("event", "message"),
    [
        (Event(0.2, "j", "mode", "off"), "outside the trajectory"),
        (Event(-0.06, "j", "mode", "off"), "outside the trajectory"),
        (Event(math.nan, "j", "mode", "off"), "outside the trajectory"),
        (Event(math.inf, "j", "mode", "off"), "outside the trajectory"),
        (Event(0.0, "k", "mode", "off"), "'k': not controlled here; controlled: j"),
        (Event(0.0, "j", "mode", "on"), "mode = 'on': must be one of off, bypass, active"),
        (Event(0.0, "j", "mode"), "mode = true: must be one of"),
        (Event(0.0, "j", "stop"), "must be one of mode, position_loop, warm_start"),
    ],
)
def test_impossible_events_are_named(tmp_path, event, message):
    plant, law, trajectory = counting(tmp_path)
    with pytest.raises(InputError, match=message):
        run(Scenario(plant, law, trajectory, [event]))


# --- what does not fit ----------------------------------------------------------------------------


def test_divergence_is_reported_with_its_time(tmp_path):
    robot = one_joint(tmp_path)
    plant, h = build(robot, 5e-3), 5e-3
    plant.drives["torque_limit"] = math.inf
    wild = vpc(robot, h, 5.0, 3.0, 0.5, kp=5e3, kd=500.0)
    wild.blocks["torque_limit"] = math.inf
    push = np.zeros((2000, 1))
    push[100] = 1.0
    recording = run(Scenario(plant, wild, hold([0.0], 10.0, h), external=push))
    at = recording.diverged_at
    assert at is not None
    assert 100 * h < at < 10.0
    tick = round(at / h)
    for name in CHANNELS:
        assert np.isfinite(getattr(recording, name)[: tick + 1]).all()
        assert np.isnan(getattr(recording, name)[tick + 1 :]).all()
    assert np.abs(recording.link_velocity[tick]).max() < 1e4
    loaded = Recording.load(recording.save(tmp_path / "r.npz"))
    assert loaded.diverged_at == at


def test_periods_and_shapes_must_fit(joint):
    plant, controller = joint
    good = hold([0.0], 1.0, 5e-3)

    def scenario(**changes):
        return Scenario(plant, changes.pop("controller", controller), replace(good, **changes))

    with pytest.raises(InputError, match=r"period.*differs from the controller's 0.005 s"):
        run(scenario(period=1e-2))
    with pytest.raises(InputError, match="multiple of the plant's time step"):
        run(scenario(period=4.99e-3))
    with pytest.raises(InputError, match=r"trajectory position = .*must have shape \(200, 1\)"):
        run(scenario(position=np.zeros((200, 2))))
    with pytest.raises(InputError, match=r"trajectory velocity = .*must have shape \(200, 1\)"):
        run(scenario(velocity=np.zeros((199, 1))))
    with pytest.raises(InputError, match="trajectory position: must be finite"):
        run(scenario(position=np.full((200, 1), np.nan)))
    for bad in (np.zeros((200, 2)), np.zeros(200), np.full((200, 1), np.inf)):
        with pytest.raises(InputError, match="external torque"):
            run(Scenario(plant, controller, good, external=bad))
    with pytest.raises(InputError, match="neither in the controller nor has it a servo"):
        run(Scenario(plant, None, good))
    with pytest.raises(InputError, match="no such joint"):
        run(Scenario(plant, Controller(controller.blocks, ["other"], 5e-3), good))
    servo = plant.robot.with_drives({"j": {"servo": Servo(kp=1.0, kd=1.0)}})
    with pytest.raises(InputError, match="events need a controller"):
        run(Scenario(build(servo, 5e-3), None, good, [Event(0.1, "j", "mode", "off")]))


def test_a_servo_follows_and_integrates(tmp_path):
    robot = one_joint(tmp_path, servo=Servo(kp=200.0, kd=10.0, ki=400.0))
    plant, h = build(robot, 5e-3), 5e-3
    recording = run(Scenario(plant, None, hold([0.2], 6.0, h), external=np.full((1200, 1), 8.0)))
    assert recording.position[-1, 0] == pytest.approx(0.2, abs=1e-4)
    assert recording.in_effect[-1, 0] == pytest.approx(-8.0, rel=1e-3)
    weak = one_joint(tmp_path, servo=Servo(kp=200.0, kd=10.0, ki=400.0), torque_limit=5.0)
    recording = run(Scenario(build(weak, h), None, hold([0.2], 2.0, h), external=np.full((400, 1), 8.0)))
    assert np.abs(recording.in_effect).max() == 5.0
