"""The command: errors of one line, whole output or none, and its exit status."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from dashpot.arm.plant import build
from dashpot.arm.robot import Robot
from dashpot.cli import main
from dashpot.cli.help import usage
from dashpot.cli.overview import COMMANDS
from dashpot.control.controller import Controller, load_controller
from dashpot.errors import InputError
from dashpot.simulation.recording import Recording
from dashpot.simulation.simulate import Scenario, run
from dashpot.simulation.trajectory import hold
from dashpot.simulation.vibration import vibration
from dashpot.support.output import whole_folder

ROBOT, WRIST = Robot.load("k807"), load_controller("k807-wrist")
SHORT = ("simulate", "k807", "k807-wrist", "--duration", "0.05")


@pytest.fixture
def dashpot(capsys, tmp_path, monkeypatch):
    """Runs the command in an empty folder: (status, stdout, lines of stderr)."""
    folder = tmp_path / "cwd"
    folder.mkdir()
    monkeypatch.chdir(folder)

    def dashpot(*arguments):
        capsys.readouterr()
        with pytest.raises(SystemExit) as left:
            main([str(argument) for argument in arguments])
        out, err = capsys.readouterr()
        assert not [p for p in folder.rglob("*") if p.suffix in (".part", ".old") or "MUJOCO" in p.name]
        return left.value.code, out, err.splitlines()

    return dashpot


@pytest.fixture
def arm(tmp_path):
    """Writes the k807 with its files changed: pairs of pattern and text; the controller likewise."""

    def arm(toml=(), xml=(), controller=()):
        paths = []
        for name, source, changes in (
            ("k807.xml", ROBOT.model, xml),
            ("arm.toml", ROBOT.file, toml),
            ("gains.toml", WRIST.file, controller),
        ):
            text = source.read_text()
            for pattern, new in changes:
                text, count = re.subn(pattern, new, text)
                assert count
            paths.append(tmp_path / name)
            paths[-1].write_text(text)
        return paths[1], paths[2]

    return arm


def refused(result):
    status, out, err = result
    assert (status, out) == (2, "")
    assert err[-1].startswith("dashpot: error: ")
    assert all(line.startswith("dashpot: warning: ") for line in err[:-1])
    assert not Path("out").exists()
    return err[-1].removeprefix("dashpot: error: ")


def test_simulate_writes_a_whole_folder_and_replays_from_its_seed(dashpot):
    status, out, err = dashpot(*SHORT, "--seed", 7)
    assert (status, err) == (0, [])
    assert "seed 7; open out/simulate/simulate.png" in out
    folder = Path("out/simulate")
    names = {".dashpot", "recording.npz", "simulate.pdf", "simulate.png"}
    assert {path.name for path in folder.iterdir()} == names
    first = Recording.load(folder / "recording.npz")
    assert dashpot(*SHORT, "--seed", 7)[0] == 0  # replaces the folder
    again = Recording.load(folder / "recording.npz")
    np.testing.assert_array_equal(first.sample, again.sample)
    assert len(list(Path("out").iterdir())) == 1


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("--payload", "nan", "--payload [kg] = nan: must be finite"),
        ("--payload", "-1", "--payload [kg] = -1.0: must not be negative"),
        ("--payload", "1e9", "--payload [kg] = 1e+09: must be at least 0 and at most 10000 kg"),
        ("--offset", "-inf", "--offset [m] = -inf: must be finite"),
        ("--offset", "50", "--offset [m] = 50.0: must be a number or (x, y, z) within 10 m"),
        ("--offset", "1 2", "--offset [m] = (1.0, 2.0): must be one number or three"),
        ("--offset", "0 nan 0", "--offset [m] = (0.0, nan, 0.0): must be finite"),
        ("--amplitude", "30", "--amplitude [rad] = 30.0: must be at most 12.57 rad; check the unit"),
        ("--duration", "0", "--duration [s] = 0.0: must be positive"),
        ("--duration", "1e6", "--duration [s] = 1e+06: must be at most 5000 s, 1000000 ticks of 0.005 s"),
        ("--seed", "-1", "--seed = -1: must be a whole number, 0 to 2147483647"),
        ("--seed", "1" + 23 * "0", "--seed = 1" + 23 * "0" + ": must be a whole number"),
        ("--tap", "1e12", "--tap [N m] = 1e+12: must be -100000 to 100000 N m"),
        ("--log", "/nonexistent/dir/a.csv", "--log = '/nonexistent/dir/a.csv': is in no folder that can be"),
        ("--fault", "brownout", "--fault = 'brownout': must be KIND[:JOINT]@START[-END][=VALUE], times in s"),
        ("--fault", "brownuot@0", "--fault kind = 'brownuot': no such kind of fault; did you mean 'brownout"),
        ("--fault", "torque_nan:joint1@0", "joint 'joint1': --fault torque_nan: is under the robot's own"),
        ("--fault", "brownout@9", "--fault brownout start [s] = 9.0: outside the trajectory, -1 to 0.045 s"),
        ("--payload-at", "0=x", "--payload-at = '0=x': must be TIME=KG, in s and kg, e.g. 2=3.5"),
        ("--payload-at", "0=-1", "--payload-at [kg] = -1.0: must be finite and not negative"),
        ("--payload-at", "9=1", "--payload-at [s] = 9.0: outside the trajectory"),
        ("--payload-at", "nan=4", "--payload-at [s] = nan: outside the trajectory"),
        ("--fault", "encoder_lost:joint9@0", "--fault joint = 'joint9': no such joint; k807 has joint1, "),
        ("--release", "-1", "--release [s] = -1.0: must be within the motion, 0 to 0.045 s"),
        ("--release", "0.05", "--release [s] = 0.05: must be within the motion, 0 to 0.045 s"),
        ("--bypass", "j5", "--bypass = 'j5': not controlled here; controlled: joint5, joint6, joint7"),
        ("--out", ".", "--out = '.': is or holds the current folder"),
        ("--out", "/dev/null/x", "--out = '/dev/null/x': cannot be created: Not a directory"),
        ("--out", "x" * 300, "--out = 'xxx"),
        ("--out", "a\0b", "--out = 'a\\x00b': cannot be created"),
    ],
)
def test_bad_option(dashpot, option, value, message):
    assert refused(dashpot(*SHORT, option, *value.split(" "))).startswith(message)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"xml": [(r"(?s)<worldbody>.*", "")]}, "{dir}/k807.xml: MuJoCo cannot read it: "),
        ({"xml": [(r'mass="[^"]*"', 'mass="0"')]}, "{dir}/k807.xml: MuJoCo cannot compile it: "),
        (
            {"xml": [("<worldbody>", '<option gravity="0 0 nan"/><worldbody>')]},
            "{dir}/k807.xml: gravity = [0.0, 0.0, nan]: must be finite",
        ),
        ({"xml": [('name="joint5"', 'name="elbow"')]}, "{dir}/k807.xml: joint 'joint5': not in the model"),
        (
            {"xml": [('angle="radian"', 'angle="degree"')]},
            "{dir}/arm.toml: joint 'joint2': home [rad] = 0.174533: is outside the joint's range",
        ),
        ({"toml": [("k807.xml", "none.xml")]}, "{dir}/arm.toml: model = '{dir}/none.xml': no such file"),
        (
            {"toml": [("home = .*", "home = [0, 10, 0, 115, 0, -35, 0]")]},
            "{dir}/arm.toml: joint 'joint4': home [rad] = 115.0: must be within 12.57 rad; check the unit",
        ),
        (
            {"toml": [("rotor_inertia = 0.6", "rotor_inertia = -0.6")]},
            "{dir}/arm.toml: joint 'joint1': rotor_inertia [kg m^2] = -0.6: must be at least 1e-09",
        ),
        (
            {"toml": [("rotor_inertia = 0.6", "rotor_inertia = 1e-9")]},
            "{dir}/arm.toml: joint 'joint1': stiffness [N m/rad] = 40000.0: with rotor_inertia 1e-09 kg m^2",
        ),
        (
            {"controller": [("period = .*", "period = 5")]},
            "{dir}/gains.toml: period [s] = 5.0: must be at least 1e-05 and at most 1 s",
        ),
        (
            {"controller": [("joint6", "joint66")]},
            "{dir}/gains.toml: joint 'joint66': the robot has no such joint; it has joint1, joint2",
        ),
    ],
)
def test_bad_file(dashpot, arm, tmp_path, change, message):
    message = message.format(dir=tmp_path)
    assert refused(dashpot("simulate", *arm(**change), "--duration", 0.05)).startswith(message)


def test_a_payload_that_saturates_the_motors_and_a_motion_into_the_stops(dashpot):
    status, out, err = dashpot(*SHORT, "--payload", 40, "--amplitude", 6, "--duration", 1)
    assert status == 0
    assert all(line.startswith("dashpot: warning: ") for line in err)
    joint2 = f"dashpot: warning: {ROBOT.file}: joint 'joint2': "
    assert any(line.startswith(f"{joint2}payload [kg] = 40.0: saturates the motor: holding") for line in err)
    assert any(line.startswith(f"{joint2}--amplitude [rad] = 6.0: runs into a stop") for line in err)
    assert "torque limit reached" in out


def test_an_unstable_loop_is_said_to_diverge(dashpot, arm):
    files = arm(
        toml=[("torque_limit = .*", "torque_limit = 1e5")],
        controller=[(r"\nkp = .*", "\nkp = 1e7"), (r"\nkd = .*", "\nkd = 1e6")],
    )
    status, out, err = dashpot("simulate", *files, "--duration", 1)
    assert status == 1
    assert "diverged at " in out
    assert not re.search(r"\b(nan|inf)\b", out)
    assert all(line.startswith("dashpot: warning: ") for line in err)
    assert Recording.load("out/simulate/recording.npz").diverged_at is not None


def test_an_oscillating_loop_is_said_to_oscillate(dashpot, arm):
    gains = [('form = "implicit"', 'form = "explicit"'), (r"\nR = .*", "\nR = 30"), (r"\nD = .*", "\nD = 3")]
    status, out, _ = dashpot("simulate", *arm(controller=gains), "--duration", 1)
    assert status == 0
    found = re.search(r"^joint6 oscillates: (\S+) N m RMS at (\S+) Hz$", out, re.M)
    assert float(found[1]) > 2
    assert 20 < float(found[2]) <= 100
    recording = Recording.load("out/simulate/recording.npz")
    sample = recording.sample[-200:, 5]
    np.testing.assert_allclose(float(found[1]), sample.std(), rtol=0.2)
    status, out, _ = dashpot("simulate", "k807", "k807-wrist", "--duration", 1)
    assert status == 0
    assert "oscillates" not in out


def test_vibration_of_a_known_signal():
    time = 0.005 * np.arange(600)
    motion = 20 * np.sin(2 * np.pi * 0.4 * time) + 50
    signal = np.stack([motion, motion + 3 * np.sin(2 * np.pi * 31 * time)], 1)
    rms, frequency = vibration(signal, 0.005)
    assert rms[0] < 0.02
    np.testing.assert_allclose(rms[1], 3 / np.sqrt(2), rtol=0.01)
    assert frequency[1] == pytest.approx(31)
    assert vibration(signal[:50], 0.005) is None
    assert vibration(signal, 0.12) is None


def test_a_release_with_a_payload_beside_the_axis(dashpot, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    load = ("--payload", 2, "--offset", -0.1, 0, 0.05)
    status, out, err = dashpot(*SHORT[:3], *load, "--duration", 1, "--release", 0.4)
    assert (status, err) == (0, [])
    assert "k807 under k807-wrist, payload 2 kg at (-0.1, 0, 0.05) m" in out
    assert "all before the release at 0.4 s" in " ".join(out.split())
    headers = [line.split("  ") for line in out.splitlines() if line.startswith("joint ")]
    assert [[part.strip() for part in line if part.strip()] for line in headers] == [
        ["joint", "control", "error [deg]", "dev.", "torque [N m]", "of limit", "vibration [N m]"],
        ["joint", "speed [deg/s]", "below 5 % after [s]", "moved [deg]", "then, to the end [deg]"],
    ]
    recording = Recording.load("out/simulate/recording.npz")
    assert recording.settings["offset_m"] == [-0.1, 0, 0.05]
    rows = out[out.index("After the release") :]
    for j, name in enumerate(("joint5", "joint6", "joint7"), 4):
        speed, took, moved, then = map(float, re.search(rf"{name} +(.*)", rows)[1].split())
        at = np.searchsorted(recording.time, 0.4 - 1e-9)
        assert speed == pytest.approx(np.degrees(abs(recording.link_velocity[at, j])), abs=0.01)
        assert 0 < took < 0.3
        angle = np.degrees(recording.link_position[:, j])
        assert moved + then == pytest.approx(angle[-1] - angle[at], abs=0.011)


def test_faults_and_payloads_on_the_way_are_listed_and_recorded(dashpot, monkeypatch):
    monkeypatch.setenv("COLUMNS", "120")
    faults = (
        "--fault",
        "encoder_lost:joint5@0.1-0.3",
        "--fault",
        "torque_bias@0.2",
        "--fault",
        "torque_nan@0.6",
    )
    status, out, err = dashpot(
        *SHORT[:3], "--duration", 0.8, *faults, "--payload-at", "0.4=3", "--offset", 0.1
    )
    assert (status, err) == (0, [])
    rows = [re.split(r"  +", line.strip()) for line in out.splitlines() if re.match("[A-D]  ", line)]
    assert [row[:5] for row in rows] == [
        ["A", "encoder_lost", "joint5", "0.1", "0.3"],
        ["B", "torque_bias", "all", "0.2", "end"],
        ["C", "payload", "0.4", "end", "3 kg"],
        ["D", "torque_nan", "all", "0.6", "end"],
    ]
    assert "nan" not in out.replace("torque_nan", "")
    recording = Recording.load("out/simulate/recording.npz")
    assert recording.settings["faults"][0] == {
        "kind": "encoder_lost",
        "joint": "joint5",
        "start": 0.1,
        "end": 0.3,
    }
    change = {"time": 0.4, "mass": 3.0, "offset": [0.1, 0.0, 0.0], "length": 0.0}
    assert recording.settings["payload_changes"] == [change]
    lost = np.isnan(recording.position[:, 4])
    np.testing.assert_allclose(recording.time[lost][[0, -1]], [0.1, 0.295])
    assert np.isfinite(recording.link_position).all()


def test_names_are_not_markup_nor_formulas(dashpot, arm, tmp_path):
    robot, gains = arm(toml=[('name = "k807"', r'name = "[b]日[/i] $\\\\x$"')])
    gains = gains.rename(tmp_path / "[red]a$x_$[b].toml")
    status, out, err = dashpot("simulate", robot, gains, "--duration", 0.05)
    assert (status, err) == (0, [])
    assert "[b]日[/i]" in out


def test_engine_options_of_the_file_cannot_switch_the_springs_off(arm):
    flags = '<option><flag spring="disable" damper="disable" sleep="enable"/></option><worldbody>'
    robot = Robot.load(arm(xml=[("<worldbody>", flags)])[0])
    plain, odd = (
        run(Scenario(build(r, 5e-3), Controller.from_config(WRIST, r.drives), hold(r.home, 0.05, 5e-3)))
        for r in (ROBOT, robot)
    )
    np.testing.assert_array_equal(plain.position, odd.position)


def test_no_help_without_a_command(dashpot):
    assert dashpot()[0] == 2
    assert dashpot("simulate", "k807", "nope")[2] == [
        "dashpot: error: nope: neither a file nor a bundled controller "
        "(k807-wrist, k807-resonant, fr3, iiwa14)"
    ]
    assert refused(dashpot("reproduce", "--seeds", 1)) == "--seeds = 1: must be 2 to 1000"
    assert refused(dashpot("reproduce", "--threads", 0)) == "--threads = 0: must be 1 to 1024"


def test_help_is_fast():
    took = [9.9]
    while min(took) >= 0.5 and len(took) < 8:  # processor time: other tests run beside it
        start = os.times()
        done = subprocess.run([sys.executable, "-m", "dashpot", "--help"], capture_output=True, check=True)
        end = os.times()
        took.append(end.children_user - start.children_user + end.children_system - start.children_system)
    assert b"simulate" in done.stdout
    assert min(took) < 0.5


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_stopped_run_leaves_nothing(tmp_path, number, status):
    code = (
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); import dashpot.cli as c; "
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code + "c.main()", *SHORT[:3], "--duration", "2000", "--out", "new/run"],
        cwd=tmp_path,
        stderr=subprocess.PIPE,
    )
    while not list(tmp_path.glob("new/.run.*.part")):
        assert process.poll() is None
        time.sleep(0.02)
    process.send_signal(number)
    assert process.communicate(timeout=10) == (None, b"dashpot: stopped\n")
    assert process.returncode == status
    assert not list(tmp_path.iterdir())


def test_what_dashpot_did_not_write_is_never_replaced(tmp_path):
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis/chapter1").write_text("words")
    (tmp_path / "file").write_text("words")
    (tmp_path / "link").symlink_to("thesis")
    for name in ("thesis", "file", "link"):
        with pytest.raises(InputError, match="not written by dashpot"), whole_folder(tmp_path / name):
            raise AssertionError
    assert (tmp_path / "thesis/chapter1").read_text() == "words"
    with pytest.raises(InputError, match="not written by dashpot"), whole_folder(tmp_path / "late"):
        (tmp_path / "late").write_text("written meanwhile")
    assert (tmp_path / "late").read_text() == "written meanwhile"
    assert {path.name for path in tmp_path.iterdir()} == {"thesis", "file", "link", "late"}


def test_a_failure_leaves_the_old_folder_and_no_new_parents(tmp_path):
    with whole_folder(tmp_path / "run") as folder:
        (folder / "a").write_text("1")
    for target in ("run", "x/y/run"):
        with pytest.raises(FileNotFoundError), whole_folder(tmp_path / target) as folder:
            (folder / "a").rename(folder / "b")
    assert [path.name for path in tmp_path.iterdir()] == ["run"]
    assert (tmp_path / "run/a").read_text() == "1"


def test_a_link_to_a_folder_stays_a_link(tmp_path):
    (tmp_path / "link").symlink_to("real")
    for text in "12":
        with whole_folder(tmp_path / "link") as folder:
            (folder / "a").write_text(text)
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "real/a").read_text() == "2"
    assert {path.name for path in tmp_path.iterdir()} == {"link", "real"}


def test_runs_into_the_same_folder_at_once(tmp_path):
    failed = []

    def write(i):
        try:
            for _ in range(30):
                with whole_folder(tmp_path / "run") as folder:
                    for name in "ab":
                        (folder / name).write_text(str(i))
        except BaseException as error:
            failed.append(error)

    threads = [threading.Thread(target=write, args=(i,)) for i in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failed
    assert (tmp_path / "run/a").read_text() == (tmp_path / "run/b").read_text()
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


@pytest.mark.parametrize(
    "arguments",
    [
        (),
        (np.zeros(2),),
        (np.zeros(3, np.float32),),
        (np.zeros((3, 1)),),
        (np.zeros(6)[::2],),
        ([0.0] * 3,),
        (None,),
        (np.zeros((7, 2)), np.zeros(3)),
    ],
)
def test_step_refuses_other_shapes(arguments):
    controller = Controller.from_config(WRIST, ROBOT.drives)
    with pytest.raises((TypeError, ValueError)):
        controller.step(*arguments)


def test_step_with_nan_holds_a_finite_torque():
    controller = Controller.from_config(WRIST, ROBOT.drives)
    out = np.full(3, np.nan)
    controller.inputs.torque[:] = np.nan
    assert controller.step(out) != 0
    assert np.isfinite(out).all()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_output_that_cannot_be_written_is_said(unbuffered):
    whole = [sys.executable, "-m", "dashpot", "--help"]
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            whole, stdout=full, stderr=subprocess.PIPE, env=os.environ | {"PYTHONUNBUFFERED": unbuffered}
        )
    said = b"dashpot: error: standard output could not be written: No space left on device\n"
    assert (done.returncode, done.stderr) == (2, said)


# A script, and tables, whose printer would end with 1 by itself.
@pytest.mark.parametrize("arguments", [["design", "--help"], ["--help"], ["completion", "zsh"], ["doctor"]])
def test_a_reader_that_leaves_is_no_error(arguments):
    """`dashpot design --help | head`: no traceback when the pipe is closed."""
    whole = [sys.executable, "-m", "dashpot", *arguments]
    command = subprocess.Popen(whole, stdout=subprocess.PIPE, stderr=subprocess.PIPE, bufsize=0)
    command.stdout.close()
    assert command.stderr.read() == b""
    command.stderr.close()
    assert command.wait() == 141


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        ("simulate k807", "CONTROLLER: is missing; usage: dashpot simulate ROBOT CONTROLLER ..."),
        ("simulate", "ROBOT and CONTROLLER: are missing; usage: dashpot simulate ROBOT CONTROLLER ..."),
        ("identify log", "--robot: is missing; usage: dashpot identify LOG --robot ROBOT ..."),
        ("simulate a b --payload x", "--payload = 'x': must be a number; dashpot simulate --help says more"),
        ("replay a b", "INDEX = 'b': must be a whole number; dashpot replay --help says more"),
        ("plot a --window 1", "--window: must be 2 numbers; dashpot plot --help says more"),
        ("simulate a b --tap", "--tap: needs a value; dashpot simulate --help says more"),
        ("simulate --paylod 2 a b", "--paylod: no such option; did you mean --payload?"),
        ("simulate a b --stop-time 2", "--stop-time: no such option; dashpot simulate --help lists them"),
        ("studio --supervise", "--supervise: no such option; did you mean --no-supervise?"),
        ("simulate a b c", "c: is one word too many; usage: dashpot simulate ROBOT CONTROLLER ..."),
        ("studio a b c", "c: is one word too many; usage: dashpot studio [ROBOT] [CONTROLLER] ..."),
        ("doctor --json=3", "--json = '3': takes no value"),
        ("export a b --to rust", "--to = 'rust': must be c or fmu"),
        ("campaign --preset all", "--preset = 'all': must be readiness"),
    ],
)
def test_what_cannot_be_read_is_said_in_one_line_of_this_command(dashpot, typed, said):
    assert dashpot(*typed.split()) == (2, "", [f"dashpot: error: {said}"])


@pytest.mark.parametrize("name", COMMANDS)
@pytest.mark.parametrize("columns", [80, 120])
def test_help_keeps_to_the_terminal_and_to_its_words(dashpot, monkeypatch, name, columns):
    monkeypatch.setenv("COLUMNS", str(columns))
    status, page, err = dashpot(name, "--help")
    assert (status, err) == (0, [])
    assert max(map(len, page.splitlines())) <= columns
    assert page.startswith(f"usage: {usage(name, COMMANDS[name])}\n")
    assert "None" not in page
    assert "default: False" not in page
    assert "may be given several times" in re.sub(r"[\s│]+", " ", page) or "--fault" not in page


def test_errors_are_counted_until_the_supervisor_stops_the_arm(dashpot, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    fault = ("--fault", "encoder_frozen:joint6@0.5", "--supervise")
    status, out, _ = dashpot(*SHORT[:3], "--duration", 2, *fault)
    assert status == 0
    recording = Recording.load("out/simulate/recording.npz")
    stop = recording.settings["supervisor"]["decisions"][0]["time"]
    assert 0.5 <= stop < 0.6
    assert f"all before the supervisor stops the arm at {stop:.4g} s" in out
    shown = (recording.time >= 0) & (recording.time < stop - 1e-9)
    error = np.degrees((recording.reference - recording.link_position)[shown, 5])
    said = re.search(r"^joint6 +VPC +(\S+) +(\S+)", out, re.M)
    assert float(said[1]) == pytest.approx(error.mean(), abs=1e-3)
    assert float(said[2]) == pytest.approx(error.std(), abs=1e-3)
