"""``dashpot design``: the files it leaves, what it says, and what it refuses."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from html import escape
from pathlib import Path
from typing import get_args, get_type_hints

import pytest

from dashpot.arm.robot import Robot
from dashpot.certify.certificate import certify_arm
from dashpot.cli import main
from dashpot.cli.design import Design as Options
from dashpot.commands.design import MEANS, specification
from dashpot.commands.design_view import sinks
from dashpot.control.controller import load_controller
from dashpot.design.design import PREDICTED, design_arm, duties
from dashpot.design.quantities import QUANTITIES, significant
from dashpot.design.spec import WISHES, Spec
from dashpot.design.wishes import LIMITS, Wish

ROBOT = """
name = "one"

[[joint]]
name = "wrist / [1]"
rotor_inertia = 0.05
viscous_friction = 0.6
stiffness = 6e3
damping = 0.7
torque_limit = 40.0
coulomb_friction = 0.2
torque_noise = 0.005
torque_gain_error = 0.02
"""
SPEC = """
preset = "brake"
minimise = "error_ratio"
beside = {}
speed = 0.4

[[joint]]
name = "wrist / [1]"
inertia = 0.3
load = 2.0
"""


def run(capsys, *arguments):
    with pytest.raises(SystemExit) as left:
        main([str(argument) for argument in arguments])
    out, err = capsys.readouterr()
    return left.value.code, out, err


def strict(text):
    def refuse(name):
        raise AssertionError(f"{name} is not JSON")

    return json.loads(text, parse_constant=refuse)


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "robot.toml").write_text(ROBOT)
    (tmp_path / "spec.toml").write_text(SPEC)
    return tmp_path


@pytest.fixture
def dashpot(here, capsys):
    return lambda *arguments: run(capsys, *arguments)


def test_a_design_from_specification_to_certificate(here, dashpot):
    status, out, err = dashpot("design", "robot.toml", "spec.toml", "--payload", "3", "--authority", "0.8")
    assert (status, err) == (0, "")
    folder = here / "out" / "design"
    names = {"controller.toml", "spec.toml", "design.json", "report.html", "wrist_1_.png"}
    assert {path.name for path in folder.iterdir()} == names | {".dashpot"}
    assert list(here.glob("out/.*")) == []

    # The gains in all files are the same, and certified.
    found = strict((folder / "design.json").read_text())
    (joint,) = found["joints"]
    config = load_controller(folder / "controller.toml")
    (gains,) = config.joints
    robot = Robot.load("robot.toml")
    assert {name: getattr(gains, name) for name in joint["gains"]} == joint["gains"]
    assert certify_arm(robot, config).certified
    assert dashpot("certify", "robot.toml", "out/design/controller.toml", "--json")[0] == 0
    assert f"{gains.R:g}" in out
    assert "every joint certified" in out

    # Flags override the file, the rest of it stays; limits are kept, and said.
    assert found["means"]["payload"] == 3.0
    assert found["means"]["speed"] == 0.4
    assert joint["wishes"]["authority"] == 0.8
    for name in LIMITS:
        if joint["wishes"][name] is not None and name in joint["assured"]:
            assert joint["assured"][name] <= joint["wishes"][name]
    assert joint["certificate"]["margin"] >= 0.1 * (1 - 2e-3)
    assert joint["trade_off"]["quantities"] == ["error_ratio", "travel"]

    # The specification in full designs the same again.
    again = Spec.load(folder / "spec.toml")
    assert again.period is not None
    assert again.latency == again.latency_max == 0
    (same,) = design_arm(robot, again).joints
    assert same.found.gains.joint(gains.name) == gains
    assert same.predicted == joint["predicted"]

    # The report says the same numbers and needs nothing from elsewhere.
    page = (folder / "report.html").read_text()
    assert page.count("<img ") == 1
    assert not re.search(r'(src|href)="(?!data:)', page)
    for name in PREDICTED:
        if name in joint["predicted"]:
            assert escape(QUANTITIES[name].meaning) in page
            assert f">{QUANTITIES[name].shown(joint['predicted'][name])}<" in page


def test_what_cannot_be_simulated_yet_is_not_proposed(dashpot):
    status, out, _ = dashpot("design", "fr3", "brake", "--joint", "joint7")
    assert status == 0
    assert "dashpot simulate" not in out
    assert "not yet to be simulated: joint1, joint2, joint3, joint4, joint5, joint6 without a contr" in out


def test_conflicting_wishes_leave_no_controller(here, dashpot):
    folder = here / "out" / "design"
    folder.mkdir(parents=True)
    (folder / "controller.toml").write_text("# of an earlier run\n")
    (folder / ".dashpot").touch()
    status, out, err = dashpot("design", "robot.toml", "spec.toml", "--error-ratio", "0.001")
    assert (status, err) == (1, "")
    assert not (folder / "controller.toml").exists()
    assert "no controller is written" in out
    assert "error ratio at most 0.001" in out
    (joint,) = strict((folder / "design.json").read_text())["joints"]
    assert joint["gains"] is None
    assert joint["conflict"]["wishes"] == ["error_ratio"]
    (short,) = joint["conflict"]["shortfalls"]
    assert short["wanted"] == 0.001
    assert short["possible"] > 0.001
    assert f"0.001 wanted, {significant(short['possible'])} possible" in out
    change = joint["conflict"]["change"] or joint["conflict"]["tried_in_vain"][0]
    assert change in " ".join(out.split())
    page = (folder / "report.html").read_text()
    assert f"{significant(short['possible'])} possible" in page
    assert "<img" not in page
    assert Spec.load(folder / "spec.toml").of(None).error_ratio == 0.001


def test_a_load_beyond_the_drive_is_said_in_a_second(here, dashpot):
    (here / "spec.toml").write_text(SPEC.replace("load = 2.0", "load = 50.0"))
    began = time.process_time()
    status, out, _ = dashpot("design", "robot.toml", "spec.toml", "--json")
    assert status == 1
    assert time.process_time() - began < 3
    (joint,) = strict(out)["joints"]
    assert "50 N m, 125 % of the torque limit" in joint["conflict"]["reason"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--stop-time", "-1"), "--stop-time [s] = -1.0: must be above 0 and at most 60 s"),
        (("--stop-time", "nan"), "--stop-time [s] = nan: must be finite"),
        (("--period", "5"), "--period [s] = 5.0: must be at least 1e-05 and at most 1 s"),
        (("--latency", "-1"), "must be a whole number of samples"),
        (("--authority", "90"), "--authority [-] = 90.0: must be above 0 and at most 1"),
        (("--payload", "inf"), "--payload [kg] = inf: must be finite"),
        (("--offset", "1", "2"), "--offset [m] = (1.0, 2.0): must be one number or three"),
        (("--joint", "elbow"), "--joint = 'elbow': no such joint; one has wrist / [1]"),
        (("--workers", "0"), "--workers = 0: must be 1 to 1024"),
        (("--out", "."), "--out = '.'"),
    ],
)
def test_bad_flags_are_one_line(here, dashpot, arguments, said):
    before = sorted(here.rglob("*"))
    status, out, err = dashpot("design", "robot.toml", "spec.toml", *arguments)
    assert (status, out) == (2, "")
    assert len(err.splitlines()) == 1
    assert err.startswith("dashpot: error: ")
    assert said in err
    assert sorted(here.rglob("*")) == before


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("stoptime = 1.0", "spec.toml: stoptime: unknown key; did you mean 'stop_time'?"),
        ('preset = "fast"', 'spec.toml: preset = \'fast\': must be one of "brake", "track", "gentle"'),
        ("travel = -1.0", "spec.toml: travel [rad] = -1.0: must be above 0"),
        ("creep = nan", "spec.toml: creep [rad/s] = nan: must be finite"),
        ("[[joint]]\nname = 'elbow'\ncreep = 0.1", "spec.toml: joint 'elbow': the robot has no such joint"),
        ("[[joint]]\nname = 'wrist / [1]'\nmass = 1", "joint 'wrist / [1]': mass: unknown key"),
        ("", "the robot has no model to tell what wrist / [1] carries"),
    ],
)
def test_bad_specifications_are_one_line(here, dashpot, text, said):
    (here / "spec.toml").write_text(text)
    status, out, err = dashpot("design", "robot.toml", "spec.toml")
    assert (status, out) == (2, "")
    assert len(err.splitlines()) == 1
    assert said in err
    assert not (here / "out").exists()


def test_a_preset_or_a_file(dashpot):
    status, _, err = dashpot("design", "robot.toml", "quick")
    assert status == 2
    assert "quick: neither a file nor a preset (brake, track, gentle)" in err


def test_a_folder_that_holds_the_input_is_refused(here, dashpot):
    for name in ("robot.toml", "spec.toml"):
        (here / "in").mkdir(exist_ok=True)
        (here / "in" / name).write_text((here / name).read_text())
    status, _, err = dashpot("design", "in/robot.toml", "in/spec.toml", "--out", "in")
    assert status == 2
    assert "which is read; choose another folder" in err
    assert (here / "in" / "robot.toml").exists()


def test_an_unusual_value_warns_once(here, dashpot):
    (here / "spec.toml").write_text("period = 0.5\n" + SPEC.replace("load = 2.0", "load = 50.0"))
    status, _, err = dashpot("design", "robot.toml", "spec.toml", "--json")
    assert status == 1
    assert err.count("period [s] = 0.5: is unusual") == 1


def test_every_wish_and_mean_has_a_flag(here):
    hints = get_type_hints(Options)
    assert set(WISHES) - {"beside"} | set(MEANS) | {"joint"} <= set(hints)
    assert set(get_args(get_args(hints["minimise"])[0])) == set(get_args(Wish))
    flags = {
        "payload": 2.0,
        "offset": (0.1,),
        "pose": "home",
        "gravity_compensated": "no",
        "minimise": "noise",
        "joint": ("wrist / [1]", "wrist / [1]"),
        "latency": 1,
        "latency_max": 2,
        "sampling": "point",
        "form": "explicit",
        **{name: 0.5 for name in (*LIMITS, "margin", "speed", "residual_speed", "jump")},
    }
    spec = specification(Options("robot.toml", "spec.toml", period=2e-3, **flags))
    wishes = spec.of("wrist / [1]")
    assert wishes.minimise == "noise"
    assert all(getattr(wishes, name) == 0.5 for name in (*LIMITS, "margin"))
    assert (spec.offset, spec.gravity_compensated, spec.joints) == ((0.1, 0, 0), False, ("wrist / [1]",))
    (duty,) = duties(Robot.load("robot.toml"), spec)
    assert (duty.period, duty.latency, duty.latency_max, duty.sampling, duty.form) == (
        2e-3,
        1,
        2,
        "point",
        "explicit",
    )
    assert duty.loaded == 0.3


@pytest.mark.skipif(os.name != "posix", reason="signals of a process group")
def test_ctrl_c_leaves_no_process_and_no_folder(here):
    """To the whole group, as a terminal does it, while two workers search."""
    started = subprocess.Popen(
        [sys.executable, "-m", "dashpot", "design", "k807", "track", "--workers", "2"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        deadline = time.monotonic() + 20
        while time.monotonic() < deadline and len(_group(started.pid)) < 3:
            time.sleep(0.05)
        time.sleep(0.5)
        os.killpg(started.pid, signal.SIGINT)
        out, err = started.communicate(timeout=10)
    finally:
        if started.poll() is None:
            os.killpg(started.pid, signal.SIGKILL)
    assert started.returncode == 130
    assert (out, err) == ("", "dashpot: stopped\n")
    deadline = time.monotonic() + 2
    while time.monotonic() < deadline and _group(started.pid):
        time.sleep(0.05)  # the tracker of resources ends by itself once it reads that everyone has left
    assert _group(started.pid) == []
    assert {path.name for path in here.iterdir()} == {"robot.toml", "spec.toml"}


def _group(leader):
    """Living processes of a process group."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, group = stat.read_text().rsplit(")", 1)[1].split()[:3]
        except OSError:
            continue
        if int(group) == leader and state != "Z":
            found.append(int(stat.parent.name))
    return found


def test_help_names_every_wish_with_its_unit(dashpot):
    status, out, _ = dashpot("design", "--help")
    assert status == 0
    text = " ".join(out.replace("│", " ").split())
    for flag in LIMITS:
        assert f"--{flag.replace('_', '-')}" in text
    for said in ("dashpot design fr3 track", "[rad/s]", "Exit status: 0", "(default: track)"):
        assert said in text


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (5e-15, "0"), (0.12345, "0.123"), (12.345, "12.3"), (1234.5, "1234"), (float("inf"), "-")],
)
def test_numbers_for_people(value, text):
    assert significant(value) == text


@pytest.mark.parametrize(("robot", "said"), [("fr3", False), ("iiwa14", True), ("own_arm.toml", False)])
def test_weight_that_the_file_does_not_carry_is_said(robot, said):
    """Nothing to say of the fr3, whose file says so, and of an arm with vertical axes."""
    path = Path(__file__).parents[1] / "examples" / robot
    assert sinks(Robot.load(str(path) if path.exists() else robot), 1e-3) is said
