"""Official pylibfranka against the simulated FR3, each in its own process, over loopback."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from dashpot.arm.payload import Payload
from dashpot.arm.robot import Robot
from dashpot.errors import DashpotError, InputError
from dashpot.hardware.franka import FrankaHardware
from dashpot.hardware.interface import Hardware, Sample, carries_weight

pylibfranka = pytest.importorskip(
    "pylibfranka", reason="no pylibfranka for this platform; it needs Linux on x86-64"
)

from dashpot.hardware.franka_server.arm import Gravity  # noqa: E402
from dashpot.studies.franka import bad, digest, drive, motion, scenario, serve, truth  # noqa: E402
from dashpot.studies.numbers import DOCS  # noqa: E402

DURATION = 3.2  # [s]; the encoder freezes at 2 s


@pytest.fixture(scope="module")
def robot():
    return Robot.load("fr3")


@pytest.fixture(scope="module")
def host():
    """A robot in lock-step with whoever talks to it."""
    with serve("--lock-step", "--payload", "2") as served:
        yield served.host


@pytest.fixture
def hardware(host, robot):
    connected = FrankaHardware(host, robot)
    yield connected
    connected.close()


def test_connecting_leaves_the_priority_alone(host, robot):
    """libfranka takes the highest there is, and every process started later would have it."""
    before = os.sched_getscheduler(0), os.sched_getparam(0).sched_priority
    FrankaHardware(host, robot).close()
    assert (os.sched_getscheduler(0), os.sched_getparam(0).sched_priority) == before


# --- whole runs ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def twice():
    return [scenario(DURATION) for _ in range(2)]


def test_payload_and_frozen_encoder_in_lock_step(twice):
    """The arm keeps its path under 2 kg, and stops and holds from the torque sensors alone."""
    for served, outcome in twice:
        assert [end for end, _, _ in served.ends] == ["stopped by the client"]  # no reflex
        assert outcome.end == "supervisor"
        first = outcome.decisions[0]
        assert (first.joint, first.reason, first.after) == ("joint4", "encoder_frozen", "torque_brake")
        assert 2.0 <= first.time < 2.02
        found = truth(served.recording, motion(DURATION))
        assert found["error_before_rad"] < 0.02
        assert found["error_with_payload_rad"] < 0.04
        assert found["speed_when_frozen_rad_s"] > 0.4
        assert found["way_after_rad"] < 0.03
        assert found["speed_braked_rad_s"] < 0.03
        assert found["drift_braked_rad"] < 0.005
        assert found["speed_at_end_rad_s"] < 5e-3  # the robot's own stop


def test_the_committed_run_is_made_again(twice):
    """Up to the end of this shorter motion; times of the machine are not."""
    served, outcome = twice[0]
    said = json.loads((DOCS / "evidence" / "franka.json").read_text("utf-8"))["repeat"]
    assert str(outcome.decisions[0]) == said["decisions"][0]
    found = truth(served.recording, motion(DURATION))
    for name in ("error_before_rad", "error_with_payload_rad", "speed_when_frozen_rad_s", "way_after_rad"):
        assert found[name] == pytest.approx(said["truth"][name], rel=1e-6), name


def test_lock_step_repeats_bit_by_bit(twice):
    (first, _), (second, _) = twice
    assert len(first.recording.time) > 1e3 * DURATION
    assert digest(first.recording) == digest(second.recording)


def test_the_first_torque_is_zero_and_steps_keep_the_rule(twice, robot):
    recording = twice[0][0].recording
    gravity = Gravity(robot)
    # What the robot added is not in the record; it is computed again from what was sensed.
    share = 0.2
    friction = np.array([(d.viscous_friction, d.coulomb_friction) for d in robot.drives]).T
    deflection = -recording.torque / [drive.stiffness for drive in robot.drives]
    moving = slice(0, round(1e3 * DURATION) - 10)
    added = np.array([gravity.torque(q) for q in (recording.position + deflection)[moving]])
    w = recording.velocity[moving]
    added += share * (friction[0] * w + friction[1] * np.tanh(w / 0.05))
    sent = recording.command[moving] - added
    assert np.abs(sent[0]).max() < 0.01
    steps = np.abs(np.diff(sent, axis=0))
    assert steps.max() < 1.0 + 0.02  # the deflection above leaves out the spring's damping
    assert steps.max() > 0.05


@pytest.mark.parametrize(
    ("kind", "reflex"),
    [("step", "controller_torque_discontinuity"), ("nap", "communication_constraints_violation")],
)
def test_at_1_khz_the_robot_stops_a_bad_controller(kind, reflex):
    with serve() as served:
        assert f'["{reflex}"]' in bad(served.host, kind)
    assert [end for end, _, _ in served.ends] == [f"reflex {reflex}"]
    assert served.recording.time[-1] > 0.5
    assert np.abs(served.recording.link_velocity[-1]).max() < 0.05


def test_at_1_khz_ours_is_not_stopped():
    """A busy machine may lose twenty packets in a row on its own: three attempts."""
    for _ in range(3):
        with serve("--payload-at=0.5=2") as served:
            outcome, _ = drive(served.host, motion(1.5))
        (end, cycles, _) = served.ends[0]
        if "communication" not in end:
            break
    assert end == "stopped by the client"
    assert cycles > 1400
    assert outcome.end in ("done", "supervisor")  # the supervisor, too, may find the machine late
    assert np.abs(served.recording.link_velocity[-1]).max() < 0.05


# --- the adapter --------------------------------------------------------------------------------------------


def test_it_is_hardware(hardware, robot):
    assert isinstance(hardware, Hardware)
    assert carries_weight(hardware)
    assert hardware.joints == robot.joints
    sample = Sample.of(hardware.joints)
    assert hardware.read(sample)
    first = sample.time
    assert hardware.read(sample)
    assert sample.time > first
    assert sample.position == pytest.approx(robot.home, abs=0.01)
    assert (sample.in_effect == 0).all()


def test_gravity_is_what_the_robot_adds(robot, hardware):
    """Pinocchio, from the URDF that the server sends, against the server's own model: the same torque."""
    gravity, sample = Gravity(robot), Sample.of(hardware.joints)
    hardware.read(sample)
    state = hardware._robot.read_once()
    own = gravity.torque(np.array(state.q))
    assert hardware._gravity(state) == pytest.approx(own, abs=2e-4)  # single precision on the wire
    assert np.array(state.O_T_EE) == pytest.approx(gravity.pose, abs=1e-5)
    # What is left of the sensors is the payload that nobody has declared.
    assert abs(sample.torque[0]) < 0.3
    assert sample.torque[1] == pytest.approx(-2.0 * 9.81 * gravity.pose[12], abs=0.3)
    hardware._robot.set_load(1.5, [0.02, 0.0, 0.1], [0.0] * 9)
    while (state := hardware._robot.read_once()).m_load == 0:  # states from before are on their way
        pass
    gravity.mass, gravity.centre = 1.5, np.array([0.02, 0.0, 0.1])
    assert hardware._gravity(state) == pytest.approx(gravity.torque(np.array(state.q)), abs=2e-4)
    hardware._robot.set_load(0.0, [0.0] * 3, [0.0] * 9)


def test_a_declared_load_is_carried(host, robot):
    hardware = FrankaHardware(host, robot, load=Payload(2.0))
    sample = Sample.of(hardware.joints)
    try:
        for _ in range(50):
            hardware.read(sample)
        assert np.abs(sample.torque).max() < 0.3
    finally:
        hardware._robot.set_load(0.0, [0.0] * 3, [0.0] * 9)
        hardware.close()


def test_wild_torques_are_tamed_and_lost_cycles_do_no_harm(hardware):
    rng, sample = np.random.default_rng(2), Sample.of(hardware.joints)
    hardware.start()
    before = np.zeros(7)
    for i in range(40):
        assert hardware.read(sample), hardware.reason
        assert np.abs(sample.in_effect - before).max() <= 1.0
        before = sample.in_effect.copy()
        if i != 20:  # one packet that never comes
            hardware.write(rng.uniform(-200, 200, 7))
    assert np.abs(before).max() > 2
    hardware.apply_brake()
    assert hardware.read(sample)  # still to be looked at
    hardware.write(np.full(7, 5.0))  # goes nowhere
    hardware.stop()
    hardware.stop()
    assert hardware.reason == ""


def test_a_reflex_ends_the_motion_with_its_name(host, hardware):
    sample = Sample.of(hardware.joints)
    hardware.start()
    assert hardware.read(sample)
    hardware._control.writeOnce(pylibfranka.Torques([2.0] * 7))  # around the adapter's limits
    while hardware.read(sample):
        pass
    assert 'motion aborted by reflex! ["controller_torque_discontinuity"]' in hardware.reason
    with pytest.raises(DashpotError, match=r"not ready, mode Reflex: .*clear the errors in Desk"):
        hardware.start()
    hardware._robot.automatic_error_recovery()
    for _ in range(20):
        hardware.read(sample)
    hardware.start()
    hardware.stop()


def test_one_client_at_a_time_and_torques_only(host, robot, hardware):
    with pytest.raises(DashpotError, match="interrupted"):
        FrankaHardware(host, robot)
    with pytest.raises(pylibfranka.CommandException, match="not possible"):
        hardware._robot.start_joint_position_control(pylibfranka.ControllerMode.JointImpedance)
    with pytest.raises(pylibfranka.CommandException, match="rejected"):
        hardware._robot.start_cartesian_velocity_control(pylibfranka.ControllerMode.CartesianImpedance)


def test_errors_say_what_to_do(robot, monkeypatch):
    with pytest.raises(
        DashpotError, match=r"127\.0\.88\.8: no Franka control interface there .*dashpot franka-server"
    ):
        FrankaHardware("127.0.88.8", robot)
    with pytest.raises(DashpotError, match="Host not found"):
        FrankaHardware("no-such-host.invalid", robot)
    with pytest.raises(InputError, match=r"joint1'.*torque_limit .* = 370.*: a Franka takes at most 87 N m"):
        FrankaHardware("127.0.88.8", robot.with_drives({"joint1": {"torque_limit": 370.0}}))
    monkeypatch.setitem(sys.modules, "pylibfranka", None)
    with pytest.raises(DashpotError, match=r"pylibfranka .* does not run here"):
        FrankaHardware("127.0.88.8", robot)


def test_the_command_ends_cleanly_and_refuses_clearly(host, tmp_path):
    def command(*options):
        line = [sys.executable, "-m", "dashpot", "franka-server", *options]
        return subprocess.run(line, capture_output=True, text=True, timeout=60)

    taken = command("--host", host)
    assert taken.returncode == 2
    assert "is in use: another server runs there" in taken.stderr
    assert len(taken.stderr.splitlines()) == 1
    panda = command("--robot", "panda")
    assert panda.returncode == 2
    assert "speaks version 5 of the protocol" in panda.stderr
    assert command("--log", str(tmp_path / "truth.csv")).returncode == 2
    with serve() as served:
        pass
    assert served.recording is None
    assert any("no motion" in line for line in served.lines)
