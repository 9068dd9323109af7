"""The rivals on an arm: runs from equilibrium, torque references, the loss of the encoder, the commands."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dashpot.arm.payload import Payload
from dashpot.arm.plant import build
from dashpot.arm.robot import Robot
from dashpot.cli import main
from dashpot.control.controller import Controller, ControllerConfig, JointGains
from dashpot.control.laws import LAWS
from dashpot.control.rivals.brakes import EncoderDamping, LatchedTorque, Off, RotorObserver, StaticFeedback
from dashpot.control.rivals.tracking import (
    PD,
    PID,
    DisturbanceObserver,
    InertiaShaping,
    PDGravity,
    TorqueFeedback,
)
from dashpot.errors import InputError
from dashpot.simulation.feedforward import gravity_reference, with_feedforward
from dashpot.simulation.release import release_events, tracking_events
from dashpot.simulation.simulate import Scenario, run, simulate
from dashpot.simulation.trajectory import hold, multisine
from dashpot.studies.laws import rows

H = 1e-3
LOAD = Payload(2.0, 0.1)
LOOP = {"kp": 1500.0, "kd": 50.0}


@pytest.fixture(scope="module")
def robot():
    """The fr3 without noise and dry friction, so that statics are seen exactly."""
    whole = Robot.load("fr3")
    quiet = {"coulomb_friction": 0.0, "torque_noise": 0.0, "position_resolution": 0.0}
    return replace(whole, drives=tuple(replace(drive, **quiet) for drive in whole.drives))


def all_joints(robot, kind, **values):
    joints = tuple(kind(drive.name, **values) for drive in robot.drives)
    return ControllerConfig(joints, period=H)


# --- equilibrium ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "values", "exact"),
    [
        (PD, {}, False),
        (PID, {"ki": 2000.0}, True),
        (DisturbanceObserver, {"cutoff": 2.0}, True),
        (TorqueFeedback, {"gain": 0.9}, False),
        (InertiaShaping, {"ratio": 0.5}, False),
        (PDGravity, {"payload": LOAD.mass, "offset": LOAD.offset}, True),  # but for the sag of the links
    ],
)
def test_a_run_starts_in_the_equilibrium_of_its_law(robot, kind, values, exact):
    """At rest, and where the law has no static error, at the reference."""
    config = all_joints(robot, kind, **LOOP, **values)
    found = simulate(robot, config, hold(robot.home, 0.2, H), payloads=[LOAD])
    error = found.position - found.reference
    assert np.ptp(found.position, axis=0).max() < 1e-6
    assert (np.abs(error).max() < (1e-4 if kind is PDGravity else 1e-6)) == exact
    assert np.abs(found.command).max() > 5  # something is held


def test_an_arm_nothing_holds_falls(robot):
    found = simulate(robot, all_joints(robot, Off), hold(robot.home, 0.2, H), payloads=[LOAD])
    assert np.abs(found.position[-1] - found.position[0]).max() > 0.01
    assert not found.command.any()


# --- torque references ----------------------------------------------------------------------------


def test_a_gravity_reference_is_the_torque_of_rest(robot):
    path = multisine(robot.home, 0.4, 0.05, 3, amplitude=0.5, lead_in=0.0)
    plant = build(robot, H, [LOAD])
    expected = np.stack([plant.load_torque(q) for q in path.position])
    for model, payload in ((robot, LOAD), (plant, None), (plant, LOAD)):
        np.testing.assert_allclose(gravity_reference(model, payload, path), expected, atol=1e-9)
    none = gravity_reference(robot, None, path)
    np.testing.assert_allclose(gravity_reference(robot, Payload(0.0), path), none, atol=1e-12)
    # The payload's weight adds linearly.
    double = gravity_reference(robot, Payload(4.0, 0.1), path)
    np.testing.assert_allclose(double - none, 2 * (expected - none), atol=1e-9)


def test_every_joint_gets_the_reference_of_its_own_payload(robot):
    path = hold(robot.home, 0.01, H)
    laws = (PDGravity("joint2", payload=2.0, offset=0.1, **LOOP), PDGravity("joint4", payload=5.0, **LOOP))
    config = ControllerConfig((*laws, PD("joint6", **LOOP)), period=H)
    torque = with_feedforward(robot, config, path).torque
    for law in laws:
        j = robot.index(law.name)
        alone = gravity_reference(robot, Payload(law.payload, law.offset), path)
        np.testing.assert_array_equal(torque[:, j], alone[:, j])
    assert not torque[:, [0, 2, 4, 5, 6]].any()
    assert with_feedforward(robot, replace(config, joints=config.joints[2:]), path) is path
    assert with_feedforward(robot, None, path) is path
    twice = with_feedforward(robot, config, with_feedforward(robot, config, path))
    np.testing.assert_allclose(twice.torque, 2 * torque)


def test_a_wrong_payload_leaves_its_weight_over_kp(robot):
    config = all_joints(robot, PDGravity, payload=0.5, offset=0.1, **LOOP)
    path = hold(robot.home, 0.1, H)
    found = simulate(robot, config, path, payloads=[LOAD])
    error = (found.reference - found.position)[-1]
    plant = build(robot, H, [LOAD])
    missing = (
        plant.load_torque(found.link_position[-1]) - gravity_reference(robot, Payload(0.5, 0.1), path)[-1]
    )
    np.testing.assert_allclose(error, missing / LOOP["kp"], atol=2e-6)


def test_a_torque_reference_must_fit(robot):
    path = hold(robot.home, 0.01, H)
    controller = Controller.from_config(all_joints(robot, PD, **LOOP), robot.drives)
    plant = build(robot, H)
    with pytest.raises(InputError, match=r"trajectory torque \[N m\].*must have shape \(10, 7\)"):
        run(Scenario(plant, controller, replace(path, torque=np.zeros((10, 3)))))
    with pytest.raises(InputError, match="must be finite"):
        run(Scenario(plant, controller, replace(path, torque=np.full((10, 7), np.nan))))
    long = replace(path, torque=np.arange(70.0).reshape(10, 7))
    np.testing.assert_array_equal(long.until(0.005).torque, long.torque[:5])
    assert path.until(0.005).torque is None


# --- the loss of the encoder ----------------------------------------------------------------------


def test_what_is_done_at_the_loss_of_the_encoder():
    laws = (
        JointGains("a", R=1.0, D=1.0, kp=10.0),
        RotorObserver("b", damping=1.0, kp=10.0),
        StaticFeedback("c", gain=0.5),
        EncoderDamping("d", damping=1.0, kp=10.0),
        LatchedTorque("e", kd=1.0),
        PID("f", kp=1.0, ki=1.0),
    )
    config = ControllerConfig(laws, period=H)
    before = [(e.joint, e.kind, e.value) for e in tracking_events(config, -1.0)]
    assert before == [(name, "mode", "bypass") for name in "bde"]
    after = [(e.joint, e.kind, e.value) for e in release_events(config, 2.0)]
    assert after == [
        ("a", "position_loop", False),
        ("b", "mode", "active"),
        ("b", "warm_start", True),
        ("b", "position_loop", False),
        ("c", "position_loop", False),
        ("d", "mode", "active"),
        ("e", "mode", "active"),
        ("e", "position_loop", False),
        ("f", "position_loop", False),
    ]
    assert {e.time for e in release_events(config, 2.0)} == {2.0}
    skipped = release_events(config, 2.0, skip="be")
    assert [e.joint for e in skipped if e.kind != "position_loop"] == ["d"]
    assert tracking_events(config, 0.0, skip="bde") == []


def test_brakes_brake_in_their_order(robot):
    """From a motion of joint 1, about the vertical: no load pulls. The more damping the shorter the way."""
    path = hold(robot.home, 1.0, H)
    moving = replace(path, position=path.position.copy(), velocity=path.velocity.copy())
    moving.position[:, 0] = robot.home[0] + 0.3 * np.maximum(path.time - 0.2, 0.0)
    moving.velocity[:, 0] = np.where(path.time > 0.2, 0.3, 0.0)
    ways = {}
    for law in (
        Off("joint1", **LOOP),
        StaticFeedback("joint1", gain=0.8, **LOOP),
        RotorObserver("joint1", damping=8.0, **LOOP),
        EncoderDamping("joint1", damping=40.0, **LOOP),
    ):
        config = ControllerConfig((law, *(PD(name, **LOOP) for name in robot.joints[1:])), period=H)
        events = tracking_events(config, 0.0) + [
            e for e in release_events(config, 0.6) if e.joint == "joint1"
        ]
        found = simulate(robot, config, moving, events=events)
        after = found.link_position[found.time >= 0.6, 0]
        ways[law.law] = after[-1] - after[0]
    assert list(ways) == sorted(ways, key=ways.get, reverse=True), ways
    assert 0 < ways["encoder_damping"] < 0.2 * ways["off"]


# --- commands -------------------------------------------------------------------------------------

FILE = """period = 0.005
[[joint]]
name = "joint5"
law = "pid"
kp = 34.0
ki = 60.0
kd = 2.8
"""
OTHERS = """[[joint]]
name = "joint6"
law = "latched_torque"
kp = 34.0
kd = 2.8
[[joint]]
name = "joint7"
R = 8.0
D = 8.0
kp = 40.0
kd = 3.0
"""


@pytest.fixture
def controller(tmp_path):
    path = tmp_path / "c.toml"
    path.write_text(FILE + OTHERS)
    return str(path)


def test_the_commands_take_every_law(controller, tmp_path, capsys):
    def command(*args):
        with pytest.raises(SystemExit) as left:
            main([*args, "--out", str(tmp_path / args[0])])
        return left.value.code or 0, " ".join(capsys.readouterr().out.split())

    rivals = tmp_path / "rivals.toml"
    rivals.write_text(FILE)
    status, said = command("certify", "k807", str(rivals))
    assert status == 1
    assert "joint5: the joint gives out energy at its worst frequency: the integral of the position" in said
    made = {path.name for path in (tmp_path / "certify").iterdir()}
    assert {"joint5.png", "joint5"} <= made
    assert 'law = "pid"' in (tmp_path / "certify" / "joint5" / "controller.toml").read_text()
    status, said = command("simulate", "k807", controller, "--release", "2", "--duration", "3")
    assert status == 0
    assert all(name in said for name in ("PID", "latched", "VPC", "servo"))
    status, said = command("map", "k807", controller, "--points", "4")
    assert status == 0
    assert 'joint5: law "pid" has no R and D, no map' in said
    assert sorted(path.name for path in (tmp_path / "map").glob("*.png")) == ["joint7.png"]


def test_a_map_of_another_law_is_refused(controller, tmp_path, capsys):
    with pytest.raises(SystemExit, match="2"):
        main(["map", "k807", controller, "--joint", "joint5", "--out", str(tmp_path / "map")])
    assert (
        "joint 'joint5': law = 'pid': has no R and D: this needs law = \"virtual" in capsys.readouterr().err
    )
    assert not (tmp_path / "map").exists()


def test_the_table_of_the_documentation_is_what_its_command_prints():
    document = (Path(__file__).parents[1] / "docs" / "rivals.md").read_text(encoding="utf-8")
    printed = list(rows())
    assert "\n".join(printed) in document
    for law in LAWS:
        assert f"`{law}`" in document
