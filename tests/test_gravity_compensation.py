"""The robot's own gravity compensation: what it adds, what is told of it, what it does when things fail."""

from __future__ import annotations

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dashpot.arm.payload import Payload
from dashpot.arm.plant import build
from dashpot.arm.robot import Robot
from dashpot.control.controller import Controller, load_controller
from dashpot.control.supervisor import SupervisorSettings
from dashpot.errors import InputError
from dashpot.simulation.faults import Fault
from dashpot.simulation.feedforward import with_feedforward
from dashpot.simulation.loop import Loop
from dashpot.simulation.simulate import Event, Scenario, run
from dashpot.simulation.trajectory import hold, multisine

FR3, CONFIG = Robot.load("fr3"), load_controller("fr3")
H = CONFIG.period
IDEAL = {"torque_noise": 0.0, "sensor_bandwidth": None, "torque_gain_error": 0.0}
QUIET = FR3.with_drives({joint: IDEAL for joint in FR3.joints})
BARE = build(QUIET, H)
LADEN = build(QUIET, H, [Payload(2.0, (0.0, 0.0, 0.1))])


def scenario(plant=LADEN, *, ticks=300, on=True, motion=True, faults=(), **keys):
    path = hold(FR3.home, ticks * H, H)
    if motion:
        path = multisine(FR3.home, ticks * H, H, 3, amplitude=0.2, lead_in=0.0)
    controller = Controller.from_config(CONFIG, plant.robot.drives)
    return Scenario(plant, controller, path, faults=faults, gravity_compensation=on, **keys)


RIGID = mujoco.MjModel.from_xml_path(str(FR3.model))
DATA = mujoco.MjData(RIGID)


def weight(angles):
    """Torque that holds the bare arm by virtual work, minus the sum of ``m J^T g`` over bodies: (n,)."""
    data, moves = DATA, np.zeros((3, RIGID.nv))
    data.qpos[: len(angles)] = angles
    mujoco.mj_kinematics(RIGID, data)
    mujoco.mj_comPos(RIGID, data)
    total = np.zeros(RIGID.nv)
    for body in range(1, RIGID.nbody):
        mujoco.mj_jacBodyCom(RIGID, data, moves, None, body)
        total -= RIGID.body_mass[body] * RIGID.opt.gravity @ moves
    return total[: len(angles)]


def weights(angles):
    """The same for rows, (ticks, n) [N m]."""
    return np.array([weight(row) for row in angles])


@given(st.integers(0, 2**31 - 1))
@settings(max_examples=20, deadline=None)
def test_it_is_the_virtual_work_of_the_bare_arms_weight(seed):
    loop = Loop(scenario(ticks=2))
    pose = np.random.default_rng(seed).uniform(-1.5, 1.5, 7)
    np.testing.assert_allclose(loop._gravity.torque(pose), weight(pose), atol=1e-9)


def test_the_controller_is_told_the_torque_without_it():
    """At every tick: sample = true torque less the weight at the angle of the encoder."""
    recording = run(scenario())
    np.testing.assert_allclose(recording.sample, recording.torque - weights(recording.position), atol=1e-9)
    assert recording.settings["gravity_compensation"] is True


def test_the_rotor_obeys_command_and_weight_together():
    """Momentum of the rotors over a run: what the motors gave is the command and the weight."""
    robot = QUIET.with_drives({j: {"coulomb_friction": 0.0} for j in QUIET.joints})
    recording = run(scenario(build(robot, H)))
    given = recording.in_effect + weights(recording.position)
    m = np.array([d.rotor_inertia for d in robot.drives])
    v = np.array([d.viscous_friction for d in robot.drives])
    w = recording.velocity
    mean = 0.5 * (recording.torque[:-1] + recording.torque[1:])
    left = H * (given[:-1] - mean - v * 0.5 * (w[:-1] + w[1:])).sum(0)
    np.testing.assert_allclose(left, m * (w[-1] - w[0]), atol=2e-3)


def test_an_arm_without_payload_rests_under_its_brake_and_sinks_without_it():
    ways = {}
    for on in (True, False):
        case = scenario(BARE, ticks=600, motion=False, on=on)
        released = replace(case, events=[Event(0.0, "all", "position_loop", False)])
        recording = run(released)
        ways[on] = np.abs(recording.link_position - recording.link_position[0]).max()
    assert ways[True] < 1e-6  # [rad]
    assert ways[False] > 0.1


def test_a_run_starts_at_rest_with_a_payload_too():
    recording = run(scenario(ticks=100, motion=False))
    assert np.abs(recording.link_velocity).max() < 1e-6
    at_rest = LADEN.load_torque(recording.position[0]) - weight(recording.position[0])
    np.testing.assert_allclose(recording.command[0], at_rest, atol=0.05)  # only the payload; sag apart


def test_switched_off_or_not_there_it_changes_no_bit():
    without = replace(QUIET, gravity_compensation=False)
    runs = [
        run(scenario(on=False)),
        run(scenario(replace(LADEN, robot=without), on=False)),
        run(scenario(replace(LADEN, robot=without), on=True)),
    ]
    for other in runs[1:]:
        np.testing.assert_array_equal(runs[0].link_position, other.link_position)
        assert "gravity_compensation" not in other.settings


def test_a_run_cut_into_pieces_has_the_bits_of_the_whole():
    case = scenario(faults=[Fault("encoder_frozen", 0.1, joint="joint2", end=0.2)], seed=3)
    whole, pieces = run(case), Loop(case)
    for until in (50, 130, 131, 250):
        pieces.advance(until)
    pieces.advance()
    np.testing.assert_array_equal(whole.link_position, pieces.recording().link_position)
    np.testing.assert_array_equal(whole.sample, pieces.recording().sample)


# --- when things fail ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["encoder_frozen", "encoder_lost", "encoder_jump"])
def test_it_believes_the_encoders_as_they_are(kind):
    """Frozen and lost: it goes on with the last angle. Jumped: with the wrong one."""
    fault = Fault(kind, 0.1, joint="joint4", value=0.2 if kind == "encoder_jump" else None)
    recording = run(scenario(faults=[fault]))
    angles = recording.position.copy()
    at = np.searchsorted(recording.time, 0.1 - 1e-9)
    if kind == "encoder_lost":
        assert np.isnan(angles[at:, 3]).all()
        angles[at:, 3] = angles[at - 1, 3]
    if kind == "encoder_frozen":
        assert (angles[at:, 3] == angles[at - 1, 3]).all()
    np.testing.assert_allclose(recording.sample, recording.torque - weights(angles), atol=1e-9)


@pytest.mark.parametrize(("kind", "value"), [("samples_late", 3), ("samples_dropped", 0.3)])
def test_what_it_adds_travels_with_the_torque_sample(kind, value):
    recording = run(scenario(faults=[Fault(kind, 0.05, value=value)], seed=2))
    for tick in range(
        100, len(recording.time)
    ):  # each is one that was true some ticks ago, of torque and angle alike
        if kind == "samples_late":
            sent, angle = recording.torque[tick - 3], recording.position[tick]  # the angle comes late, too
            np.testing.assert_allclose(recording.sample[tick], sent - weight(angle), atol=1e-9)
        elif (recording.position[tick] == recording.position[tick - 1]).all():
            np.testing.assert_array_equal(recording.sample[tick], recording.sample[tick - 1])


def test_a_stuck_sensor_is_seen_although_the_weight_moves_on():
    """Its samples are checked as they are; a difference to the weight would never repeat itself."""
    noisy = build(FR3, H)
    fault = Fault("torque_stuck", 0.15, joint="joint4")
    recording = run(scenario(noisy, faults=[fault], supervisor=SupervisorSettings()))
    first = recording.settings["supervisor"]["decisions"][0]
    assert (first["reason"], first["joint"], first["after"]) == ("torque_stuck", "joint4", "encoder_brake")
    assert len(set(recording.sample[200:250, 3])) == 50
    assert 0 < first["time"] - 0.15 < 0.01


def test_without_power_nothing_is_carried():
    """All motors off: the arm falls as one without gravity compensation does."""
    fault = Fault("brownout", 0.0, end=0.05)
    found = []
    for on in (True, False):
        case = scenario(BARE, ticks=50, motion=False, on=on, faults=[fault])
        found.append(run(case).link_position)
    way = np.abs(found[0] - found[0][0]).max()
    assert way > 0.005
    np.testing.assert_allclose(found[0] - found[0][0], found[1] - found[1][0], atol=0.05 * way)


@pytest.mark.parametrize("share", [0.0, 0.1, 1.0])
def test_a_weak_motor_carries_no_more_than_its_share(share):
    fault = Fault("saturation", 0.05, joint="joint4", value=share)
    case = scenario(BARE, ticks=200, motion=False, faults=[fault])
    recording = run(case)
    limit = share * FR3.drives[3].torque_limit
    needed = abs(weight(np.array(FR3.home))[3])
    held = limit + (1 + 8) * FR3.drives[3].coulomb_friction > needed
    way = np.abs(recording.link_position[-1, 3] - recording.link_position[0, 3])
    assert (way < 1e-3) == held


def test_a_healthy_motor_has_its_limit_for_the_command_alone():
    """The limits of the interface hold for what is asked, without the weight that the robot adds."""
    weak = QUIET.with_drives({"joint2": {"torque_limit": 3.0}})
    recording = run(scenario(build(weak, H), ticks=300, motion=False))
    assert abs(weight(np.array(FR3.home))[1]) > 3.0
    assert np.abs(recording.link_position - recording.link_position[0]).max() < 1e-6


def test_no_false_alarm_and_the_balance_stays_within_its_limit():
    noisy = build(FR3, H, [Payload(3.0, (0.0, 0.0, 0.1))])
    recording = run(scenario(noisy, ticks=1500, supervisor=SupervisorSettings(), seed=4))
    assert recording.settings["supervisor"]["decisions"] == []
    assert np.abs(recording.reference - recording.link_position).max() < math.radians(5)


# --- other ends ---------------------------------------------------------------------------------------------


def test_refusals(tmp_path):
    text = (FR3.file.read_text()).replace("gravity_compensation = true", 'gravity_compensation = "on"')
    file = tmp_path / "arm.toml"
    file.write_text(text)
    with pytest.raises(InputError, match=r"arm\.toml: gravity_compensation = 'on': must be true or false"):
        Robot.load(file)
    model = tmp_path / "arm.xml"
    model.write_text(FR3.model.read_text().replace('<body name="link3"', '<body name="link3" gravcomp="1"'))
    with pytest.raises(InputError, match="is in the model already, as gravcomp of bodies"):
        Loop(scenario(build(replace(FR3, model=model), H)))


def test_a_load_model_of_the_controller_leaves_out_what_the_robot_carries(tmp_path):
    text = (CONFIG.file.read_text()).replace("R = 10.0\nD = 40.0\nK = 0.0\n", 'law = "pd_gravity"\n')
    file = tmp_path / "law.toml"
    file.write_text(text)
    config, path = load_controller(file), hold(FR3.home, 0.1, H)
    whole = with_feedforward(FR3, config, path).torque[0, :4]
    rest = with_feedforward(FR3, config, path, carried=True).torque[0, :4]
    np.testing.assert_allclose(whole - rest, weight(np.array(FR3.home))[:4], atol=1e-9)
