"""``dashpot run``: its checklist, its refusals, its log, and an adapter of one's own."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_cli import dashpot  # noqa: F401 - a fixture

from dashpot.arm.payload import Payload
from dashpot.arm.plant import build
from dashpot.arm.robot import Robot
from dashpot.certify.certificate import certify_arm
from dashpot.certify.digest import JUDGED, digest
from dashpot.control.controller import Controller, load_controller
from dashpot.control.supervisor import Supervisor, SupervisorSettings
from dashpot.errors import DashpotError, InputError
from dashpot.hardware.checks import Heard, Verdicts, at_rest, before_link, listen
from dashpot.hardware.interface import Hardware, Sample
from dashpot.hardware.realtime import undisturbed
from dashpot.hardware.runtime import LoopSettings, control, joint_order
from dashpot.hardware.sim import LinkSettings, SimHardware
from dashpot.simulation.prepare import encoder_ranges
from dashpot.simulation.simulate import Scenario
from dashpot.simulation.trajectory import hold, multisine

EXAMPLES = Path(__file__).parent.parent / "examples"
ROBOT, CONFIG = Robot.load(EXAMPLES / "own_arm.toml"), load_controller(EXAMPLES / "own_gains.toml")
CALM = LoopSettings(priority=0)


@pytest.fixture
def own_arm(monkeypatch):
    monkeypatch.syspath_prepend(str(EXAMPLES))
    from own_hardware import OwnArm

    return OwnArm("", ROBOT)


def supervised(**about):
    controller = Controller.from_config(CONFIG, ROBOT.drives)
    return Supervisor(controller, ROBOT.drives, **about)


# --- an adapter of one's own -------------------------------------------------------------------------------


def test_the_example_is_short_and_complete(own_arm):
    assert len((EXAMPLES / "own_hardware.py").read_text().splitlines()) < 60
    assert isinstance(own_arm, Hardware)


def test_the_example_follows_a_motion_and_ends_at_rest(own_arm):
    supervisor = supervised(limits=encoder_ranges(build(ROBOT, CONFIG.period)))
    path = multisine(ROBOT.home, 1.2, CONFIG.period, 2, amplitude=0.2, ramp=0.5, lead_in=0.1)
    seen = []
    write = own_arm.write

    def writing(torque):
        seen.append((own_arm.data.time, *own_arm.data.qpos[own_arm.motor], *torque))
        write(torque)

    own_arm.write = writing
    tolerant = replace(CALM, late_cycles=10**6, longest_gap=10**6)
    outcome = control(own_arm, supervisor, path, settings=tolerant)
    assert (outcome.end, outcome.state, outcome.braked) == ("done", "safe", True), outcome
    time, angle = np.array(seen)[:, 0], np.array(seen)[:, 1:3]
    reference = np.array([np.interp(time - time[0], path.time - path.time[0], q) for q in path.position.T]).T
    moving = time - time[0] < 1.2
    assert np.abs(reference[moving]).max() > 0.05
    assert np.abs(angle - reference)[moving].max() < 0.03
    assert np.abs(own_arm.data.qvel[own_arm.motor]).max() < 0.02
    assert (own_arm.torque == 0).all()
    assert outcome.statistics["cycles"] == len(seen)


def test_the_example_holds_where_it_is_found(own_arm):
    own_arm.data.qpos[own_arm.motor] = 0.3, -0.2
    outcome = control(own_arm, supervised(), duration=0.2, settings=CALM)
    assert outcome.end == "done", outcome
    np.testing.assert_allclose(own_arm.data.qpos[own_arm.motor], (0.3, -0.2), atol=1e-4)


def test_the_first_torque_continues_the_one_in_effect(own_arm):
    """Whatever held the arm before: no step of torque at the start."""
    sent = []
    own_arm.torque[:] = 3.0, -2.0
    own_arm.write = lambda torque: sent.append(torque.copy())
    control(own_arm, supervised(), duration=0.05, settings=CALM)
    np.testing.assert_allclose(sent[0], (3.0, -2.0), atol=1e-9)


def test_joints_and_periods_must_be_the_robots(own_arm):
    controller = Controller.from_config(CONFIG, ROBOT.drives)
    own_arm.joints = ("elbow", "shoulder")
    assert list(joint_order(own_arm, controller)) == [1, 0]
    own_arm.joints = ("elbow", "shoulder", "wrist")
    with pytest.raises(InputError, match=r"wrist.*not in the controller"):
        joint_order(own_arm, controller)
    own_arm.joints = ("elbow",)
    with pytest.raises(InputError, match=r"shoulder.*the robot has no such joint; it has elbow"):
        joint_order(own_arm, controller)
    own_arm.joints, own_arm.period = ("elbow", "shoulder"), 0.002
    with pytest.raises(InputError, match=r"differs from the robot's cycle, 0\.002 s"):
        joint_order(own_arm, controller)


def test_swapped_joints_get_their_own_torques(own_arm):
    """The order of the robot's arrays is the robot's."""

    class Swapped:
        joints, period, paced, reason = ("elbow", "shoulder"), 0.001, True, ""

        def __init__(self):
            self.sent = []

        def start(self): ...

        def read(self, sample):
            sample.time = 1e-3 * len(self.sent)
            sample.torque, sample.velocity, sample.in_effect = (1.0, 5.0), 0.0, (1.0, 5.0)
            sample.torque += 1e-3 * np.random.default_rng(len(self.sent)).standard_normal(2)
            sample.position = -0.1, 0.4
            return True

        def write(self, torque):
            self.sent.append(torque.copy())

        def apply_brake(self): ...

        def stop(self): ...

    robot = Swapped()
    control(robot, supervised(), duration=0.02, settings=CALM)
    np.testing.assert_allclose(robot.sent[0], (1.0, 5.0), atol=1e-6)


# --- what the operating system grants ----------------------------------------------------------------------


def test_every_measure_says_what_it_costs_and_is_undone(monkeypatch):
    import gc
    import os

    def refuse(*_):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    with undisturbed(50, cpu=10**4) as measures:
        assert not gc.isenabled()
    assert gc.isenabled()
    assert [m.name for m in measures] == ["memory", "priority", "processor", "kernel"]
    said = {m.name: m for m in measures}
    assert not said["priority"].granted
    assert "milliseconds" in said["priority"].said
    assert "setcap" in said["priority"].said
    assert "10000 is refused" in said["processor"].said
    assert all("\n" not in m.said for m in measures)


# --- the checklist -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def verdicts():
    return Verdicts.of(certify_arm(ROBOT, CONFIG).table())


def failing(checks):
    return {check.name for check in checks if check.passed is False}


def test_all_is_well_with_the_example(verdicts):
    controller = Controller.from_config(CONFIG, ROBOT.drives)
    path = hold(ROBOT.home, 0.1, CONFIG.period)
    checks = before_link(ROBOT.drives, CONFIG, controller, verdicts, SupervisorSettings(), path=path)
    assert not failing(checks)
    assert len(checks) == 5


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"torque_limit": 41.0}, "torque limit"),
        ({"torque_limit": np.inf}, "torque limit"),
        ({"rate_limit": 2.1}, "torque rate"),
        ({"rate_limit": np.inf}, "torque rate"),
    ],
)
def test_limits_beyond_the_drives_fail(verdicts, change, name):
    blocks = Controller.from_config(CONFIG, ROBOT.drives).blocks.copy()
    for key, value in change.items():
        blocks[key][0] = value
    controller = Controller(blocks, ROBOT.joints, CONFIG.period, CONFIG.sampling)
    checks = before_link(ROBOT.drives, CONFIG, controller, verdicts, SupervisorSettings())
    assert failing(checks) == {name}
    assert next(check for check in checks if check.passed is False).joint == "shoulder"


def test_a_motion_too_fast_or_too_far_fails(verdicts):
    controller = Controller.from_config(CONFIG, ROBOT.drives)
    still = hold(ROBOT.home, 0.1, CONFIG.period)
    ranges = {"shoulder": (-2.5, 2.5), "elbow": (-2.5, 2.5)}

    def of(**change):
        path = replace(still, **{key: getattr(still, key) + value for key, value in change.items()})
        means = verdicts, SupervisorSettings()
        return failing(before_link(ROBOT.drives, CONFIG, controller, *means, path=path, ranges=ranges))

    assert of() == set()
    assert of(velocity=6.3) == {"motion: speed"}
    assert of(position=np.array([0.0, -2.6])) == {"motion: angle"}
    assert of(position=np.nan) == {"motion: angle"}


def heard(**change) -> Heard:
    rng = np.random.default_rng(0)
    ticks, n = 400, 2
    arrays = {
        "time": CONFIG.period * np.arange(ticks),
        "arrival": 5.0 + CONFIG.period * np.arange(ticks),
        "torque": 0.02 * rng.standard_normal((ticks, n)),
        "position": np.zeros((ticks, n)),
        "velocity": np.zeros((ticks, n)),
    }
    for key, value in change.items():
        if key in arrays:
            arrays[key] = arrays[key] + value
    return Heard(**arrays, age=change.get("age", 0))


ELBOW = np.array([0.0, 1.0])
ODD = np.arange(400) % 50 == 0


@pytest.mark.parametrize(
    ("change", "name", "joint"),
    [
        ({}, None, ""),
        ({"torque": 0.4 * ELBOW}, "torque bias", "elbow"),
        ({"torque": np.array([0.0, np.nan])}, "torque bias", "elbow"),
        ({"torque": 0.08 * np.sin(np.arange(400))[:, None] * ELBOW}, "torque noise", "elbow"),
        ({"position": 2.6 * ELBOW}, "angle", "elbow"),
        ({"position": np.array([0.0, np.nan])}, "angle", "elbow"),
        ({"velocity": 0.03 * ELBOW}, "speed at rest", "elbow"),
        ({"time": 0.02 * CONFIG.period * np.arange(400)}, "robot's cycle", ""),
        ({"time": np.cumsum(ODD * CONFIG.period)}, "samples lost", ""),
        ({"arrival": 3 * CONFIG.period * ODD}, "jitter, 99 %", ""),
        ({"age": 3}, "age of samples", ""),
    ],
)
def test_what_the_sensors_say_at_rest(change, name, joint):
    drives = [replace(drive, torque_noise=0.02) for drive in ROBOT.drives]
    controller = Controller.from_config(CONFIG, drives)
    ranges = {"shoulder": (-2.5, 2.5), "elbow": (-2.5, 2.5)}
    about = {"ranges": ranges, "load": np.zeros(2)}
    checks = at_rest(heard(**change), drives, controller, SupervisorSettings(), **about)
    assert name in failing(checks) or (name is None and not failing(checks))
    if name:
        assert next(check for check in checks if check.name == name).joint == joint


@pytest.mark.parametrize(("name", "mass"), [("fr3", 0.0), ("fr3", 3.0), ("iiwa14", 0.0)])
def test_a_simulated_arm_on_its_brakes_shows_the_noise_of_its_sensors_alone(name, mass):
    """Its links have stopped ringing before anybody listens."""
    robot, config = Robot.load(name), load_controller(name)
    controller = Controller.from_config(config, robot.drives)
    plant = build(robot, config.period, [Payload(mass)] if mass else [])
    still = hold(robot.home, 1.0, config.period)
    scenario = Scenario(plant, controller, still, seed=1, gravity_compensation=True)
    arm = SimHardware(scenario, LinkSettings(realtime=False))
    try:
        heard_ = listen(arm, controller, 500)
    finally:
        arm.stop()
    checks = at_rest(heard_, robot.drives, controller, SupervisorSettings(), realtime=False)
    assert not failing(checks), checks
    stated = np.array([drive.torque_noise for drive in robot.drives])
    assert (np.abs(heard_.torque.std(0) / stated - 1) < 0.3).all()


def test_a_sensor_that_repeats_itself_and_a_clock_that_stands_fail():
    drives = [replace(drive, torque_noise=0.02) for drive in ROBOT.drives]
    controller = Controller.from_config(CONFIG, drives)
    stuck = heard()
    stuck.torque[:, 1] = 0.1
    assert "torque sensors" in failing(at_rest(stuck, drives, controller, SupervisorSettings()))
    stands = replace(heard(), time=np.zeros(400))
    assert "robot's clock" in failing(at_rest(stands, drives, controller, SupervisorSettings()))


# --- the certificate is of these coefficients --------------------------------------------------------------


def test_the_digest_changes_with_everything_the_certificate_depends_on():
    blocks = Controller.from_config(CONFIG, ROBOT.drives).blocks
    drives, seen = list(ROBOT.drives), {digest(ROBOT.drives, blocks, CONFIG)}
    for key in JUDGED:
        value = getattr(drives[0], key)
        other = {"sensor_order": 1, "sensor_bandwidth": 150.0}.get(key, 1e-3 + 1.01 * (value or 0.0))
        changed = [replace(drives[0], **{key: other}), *drives[1:]]
        seen.add(digest(changed, blocks, CONFIG))
    seen.add(digest([replace(drives[0], uncertainty={}), *drives[1:]], blocks, CONFIG))
    seen.add(digest(drives, blocks, replace(CONFIG, latency_max=1)))
    for key in blocks.dtype.names:
        changed = blocks.copy()
        field = changed[key].reshape(len(blocks), -1)
        field[0, 0] = np.nextafter(field[0, 0], 10.0) if field.dtype == float else field[0, 0] + 1
        seen.add(digest(drives, changed, CONFIG))
    assert len(seen) == 1 + len(JUDGED) + 2 + len(blocks.dtype.names)
    # and with nothing else
    quiet = [replace(drive, torque_noise=0.5, coulomb_friction=0.1) for drive in drives]
    assert digest(quiet, blocks, CONFIG) in seen


def test_a_certificate_of_other_gains_is_refused(dashpot, tmp_path):  # noqa: F811
    robot, gains = EXAMPLES / "own_arm.toml", EXAMPLES / "own_gains.toml"
    status, out, _ = dashpot("certify", robot, gains, "--json")
    assert status == 0
    good = tmp_path / "certificate.json"
    good.write_text(out)
    other = tmp_path / "other.toml"
    other.write_text(gains.read_text().replace("R = 6.0", "R = 5.999999", 1))
    via = ("--via", "own_hardware:OwnArm")
    sys.path.insert(0, str(EXAMPLES))
    try:
        status, out, _ = dashpot("run", robot, gains, *via, "--check", "--certificate", good, "--priority", 0)
        assert "2 of 2" in out
        assert ("ready: no torque was sent" in out) == (status == 0)
        status, out, _ = dashpot("run", robot, other, *via, "--certificate", good)
    finally:
        sys.path.remove(str(EXAMPLES))
    assert status == 1
    assert "no torque is sent: 1 of" in out
    assert json.loads(good.read_text())["digest"][:12] in out


def test_what_is_not_certified_does_not_run(dashpot):  # noqa: F811
    status, out, _ = dashpot("run", "k807", "k807-wrist", "--lock-step")
    assert status == 1
    assert "0 of 3" in out
    assert "--uncertified" in out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--via", "own"), "--via = 'own': must be sim, franka, or module:Class"),
        (
            ("--via", "no_such_module:Arm"),
            "--via = 'no_such_module:Arm': cannot be imported: No module named",
        ),
        (("--via", "json:JSONDecoder"), "cannot be made: TypeError"),
        (("--via", "fractions:Fraction"), "cannot be made: "),
        (("--via", "franka"), "--host: is needed"),
        (("--via", "json:dumps", "--fault", "encoder_lost@1"), "--fault: is for --via sim"),
        (("--duration", "nan"), "--duration [s] = nan: must be positive"),
        (("--duration", "1e9"), "must be at most 600 s"),
        (("--motion", "nowhere.csv"), 'must be "hold" or a CSV file'),
        (("--log", "run.csv"), "--log = 'run.csv': must end in .mcap"),
        (("--samples", "1"), "--samples = 1: must be 10 to 100000"),
        (("--samples", "100000000"), "--samples = 100000000: must be 10 to 100000"),
        (("--cpu", "-3"), "--cpu = -3: not a processor that this process may use: "),
        (("--seed", "-1"), "--seed = -1: must be a whole number, 0 to"),
        (("--host", "1.2.3.4"), "--host = '1.2.3.4': is for a robot"),
        (("--record", "arm.csv"), "--record = 'arm.csv': must end in .npz"),
        (("--record", "nowhere/arm.npz"), "--record = 'nowhere/arm.npz': is in no folder"),
        (("--priority", "100"), "--priority = 100: must be 0 (none) to 99"),
        (("--certificate", "none.json"), "--certificate: is not looked at with --uncertified"),
        (("--cpu", "99999"), "--cpu = 99999: not a processor that this process may use: "),
        (("--log", "nowhere/run.mcap"), "--log = 'nowhere/run.mcap': is in no folder that can be written"),
        (("--payload", "-1"), "--payload [kg] = -1.0: must be at least 0"),
        (
            ("--fault", "encoder_lost:joint9@1", "--lock-step"),
            "--fault joint = 'joint9': no such joint; k807",
        ),
        (("--fault", "encoder_lost@99", "--lock-step"), "--fault encoder_lost start [s] = 99.0: outside"),
    ],
)
def test_bad_input_is_one_line(dashpot, arguments, said):  # noqa: F811
    status, _, lines = dashpot("run", "k807", "k807-wrist", "--uncertified", *arguments)
    assert status == 2
    assert len(lines) == 1
    assert said in lines[0]


def test_a_log_without_its_package_is_refused_before_there_is_a_link(dashpot, monkeypatch):  # noqa: F811
    monkeypatch.setitem(sys.modules, "zstandard", None)
    monkeypatch.setattr("dashpot.commands.run.connected", lambda *_: pytest.fail("connected"))
    status, _, lines = dashpot("run", "k807", "k807-wrist", "--uncertified", "--log", "run.mcap")
    assert status == 2
    assert lines[-1].startswith("dashpot: error: MCAP logs need zstandard: ")
    assert lines[-1].endswith("[logs]'")


def test_something_that_is_no_adapter_is_named(dashpot, tmp_path, monkeypatch):  # noqa: F811
    (tmp_path / "half_an_arm.py").write_text("class Arm:\n    def __init__(self, host, robot): ...\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    status, _, lines = dashpot("run", "k807", "k807-wrist", "--uncertified", "--via", "half_an_arm:Arm")
    assert status == 2
    assert "lacks something; an adapter has joints, period" in lines[0]


def test_lock_step_ends_where_it_should_and_logs_every_tick(dashpot, tmp_path):  # noqa: F811
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    log = tmp_path / "run.mcap"
    status, out, _ = dashpot(
        *("run", "k807", "k807-wrist", "--uncertified", "--lock-step", "--duration", 0.5),
        *("--fault", "torque_stuck:joint6@0.3", "--log", log, "--record", tmp_path / "arm.npz"),
    )
    assert status == 1
    assert "stopped by the supervisor" in out
    with log.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        messages = [(channel.topic, message) for _, channel, _, message in reader.iter_decoded_messages()]
    states = [message for topic, message in messages if topic == "/joint_states"]
    said = [message.msg for topic, message in messages if topic == "/rosout"]
    with np.load(tmp_path / "arm.npz") as recorded:
        chosen = [4, 5, 6]
        np.testing.assert_array_equal(
            [s.position for s in states], recorded["position"][: len(states), chosen]
        )
        np.testing.assert_array_equal([s.effort for s in states], recorded["sample"][: len(states), chosen])
    assert f"{len(states)} cycles" in out
    assert any("repeats itself" in line for line in said)
    assert any("come to rest" in line or "safe" in line for line in said)


def test_a_sample_starts_empty():
    sample = Sample.of(("a",))
    assert np.isnan([sample.time, *sample.torque, *sample.in_effect]).all()


@pytest.mark.alone
def test_on_a_terminal_it_keeps_a_line_that_is_gone_at_the_end():
    """A real terminal: what draws on it must not swallow what the processes say to each other."""
    pty = pytest.importorskip("pty")
    ours, theirs = pty.openpty()
    command = [sys.executable, "-m", "dashpot", "run", "k807", "k807-wrist", "--uncertified"]
    lenient = ("--samples", "50", "--duration", "1")
    process = subprocess.Popen([*command, *lenient], stdin=theirs, stdout=subprocess.PIPE, stderr=theirs)
    os.close(theirs)
    seen = b""
    with suppress(OSError):  # the terminal's other end is closed: the process is gone
        while select.select([ours], [], [], 120)[0]:
            seen += os.read(ours, 4096)
    os.close(ours)
    out, _ = process.communicate(timeout=60)
    assert b"track" in seen, out.decode()
    assert b"jitter " in seen
    assert seen.rstrip().endswith(b"\x1b[2K")  # the line is taken back
    assert b"cycles of 5 ms" in out


def child_of(parent: int, named: bytes) -> int:
    for entry in Path("/proc").iterdir():
        with suppress(OSError):  # it has ended meanwhile
            if entry.name.isdigit() and named in (entry / "cmdline").read_bytes():
                status = (entry / "stat").read_text()
                if int(status.rpartition(")")[2].split()[1]) == parent:
                    return int(entry.name)
    raise AssertionError(f"no process {named!r}")


@pytest.mark.alone
def test_a_log_that_was_cut_off_is_said(tmp_path):
    """The run goes on without its log, and ends as a run does; its exit status tells."""
    log = tmp_path / "run.mcap"
    command = [sys.executable, "-m", "dashpot", "run", "k807", "k807-wrist", "--uncertified"]
    means = ("--samples", "10", "--duration", "6", "--log", str(log))
    process = subprocess.Popen([*command, *means], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    end = time.monotonic() + 60
    while not (log.exists() and log.stat().st_size > 4000) and time.monotonic() < end:
        assert process.poll() is None, "".join(process.communicate())
        time.sleep(0.02)  # until rows are in it: the run has begun
    os.kill(child_of(process.pid, b"dashpot.hardware.scribe"), signal.SIGKILL)
    out, _ = process.communicate(timeout=120)
    assert process.returncode == 1
    assert "its writer was ended (status -9); the log is cut off" in " ".join(out.split())
    assert "mechanical brakes closed" in " ".join(out.split())


def test_a_recording_that_cannot_be_written_is_said(tmp_path):
    path = hold(ROBOT.home, 0.2, CONFIG.period)
    scenario = Scenario(
        build(ROBOT, CONFIG.period), Controller.from_config(CONFIG, ROBOT.drives), path, seed=1
    )
    record = tmp_path / "arm.npz"
    record.mkdir()
    arm = SimHardware(scenario, LinkSettings(realtime=False, record=record))
    arm.start()
    with pytest.raises(DashpotError, match="recording is lost"):
        arm.stop()
