"""``dashpot certify`` and ``dashpot map``: verdicts, JSON, pictures, and loads one can run."""

from __future__ import annotations

import json
import math
import re

import numpy as np
import pytest

from dashpot.arm.drive import Drive
from dashpot.arm.robot import Robot
from dashpot.certify.certificate import certify_arm
from dashpot.certify.counterexample import Counterexample
from dashpot.certify.index import passivity_index
from dashpot.certify.joint import sampled_joint
from dashpot.certify.loads import Load, oscillation
from dashpot.certify.map import index_map
from dashpot.certify.testbench import replay, write
from dashpot.cli import main
from dashpot.control.controller import ControllerConfig, JointGains, joint_block, load_controller
from dashpot.control.sampled import VirtualPassive, add_position_loop, virtual_passive_block
from dashpot.simulation.recording import Recording

ROBOT = """
name = "one"

[[joint]]
name = "wrist / [1]"
rotor_inertia = 0.05
viscous_friction = 0.6
stiffness = 6e3
damping = 0.7
torque_limit = 40.0
coulomb_friction = 0.02
"""
CONTROLLER = """
period = 0.005
form = "{form}"

[[joint]]
name = "wrist / [1]"
R = {R}
D = {D}
K = 1.0
kp = {kp}
kd = {kd}
"""


@pytest.fixture
def files(tmp_path, monkeypatch):
    """Writes a robot without a model and a controller."""
    monkeypatch.chdir(tmp_path)

    def files(form="explicit", R=3.0, D=3.0, kp=0.0, kd=0.0, robot=ROBOT):
        (tmp_path / "robot.toml").write_text(robot)
        (tmp_path / "controller.toml").write_text(CONTROLLER.format(form=form, R=R, D=D, kp=kp, kd=kd))
        return "robot.toml", "controller.toml"

    return files


@pytest.fixture
def dashpot(capsys):
    def dashpot(*arguments):
        with pytest.raises(SystemExit) as left:
            main([str(argument) for argument in arguments])
        out, err = capsys.readouterr()
        return left.value.code, out, err

    return dashpot


def test_a_model_that_is_not_there_is_said(files, dashpot):
    robot, controller = files(robot=ROBOT.replace('name = "one"', 'name = "one"\nmodel = "none.xml"', 1))
    status, _, err = dashpot("certify", robot, controller, "--json")
    assert status in (0, 1)
    assert err.startswith("dashpot: warning: robot.toml: model = 'none.xml': no such file")


def strict(text):
    def refuse(name):
        raise AssertionError(f"{name} is not JSON")

    return json.loads(text, parse_constant=refuse)


@pytest.mark.parametrize(
    ("gains", "index"),
    [
        ({}, 0.70),
        ({"R": 6.0}, 0.44),
        ({"R": 10.0}, -0.58),
        ({"R": 1.0, "D": 1.0, "kp": 60.0, "kd": 1.0}, -0.78),
    ],
)
def test_json_and_exit_status(files, dashpot, gains, index, tmp_path):
    status, out, err = dashpot("certify", *files(**gains), "--json")
    found = strict(out)
    (joint,) = found["joints"]
    assert status == (0 if index > 0 else 1)
    assert found["certified"] is joint["certified"] is (index > 0)
    assert joint["name"] == "wrist / [1]"
    assert joint["index"] == pytest.approx(index, rel=0.03)
    assert joint["worst_index"] <= joint["index"]
    assert 0 <= joint["frequency_hz"] <= 100 + 1e-9
    assert (joint["counterexample"] is None) == (index > 0)
    assert err == ""
    assert not (tmp_path / "out").exists()
    if index == -0.58:
        assert 0.0237 < joint["counterexample"]["inertia"] < 0.0288


def test_folder_holds_pictures_and_benches_that_run(files, dashpot, tmp_path):
    status, out, err = dashpot("certify", *files(R=1.0, D=1.0, kp=60.0, kd=1.0))
    assert status == 1
    assert err == ""
    folder = tmp_path / "out" / "certify"
    assert (folder / "wrist_1_.png").stat().st_size > 20_000
    assert strict((folder / "certificate.json").read_text())["certified"] is False
    bench = folder / "wrist_1_"
    assert Robot.load(bench / "robot.toml").drives[0].rotor_inertia == 0.05
    command = out.split("dashpot simulate ")[1].split("certified")[0].splitlines()[0].split()
    status, out, _ = dashpot("simulate", *command, "--duration", "12")
    assert status == 0
    angle = Recording.load(tmp_path / "out" / "simulate" / "recording.npz").position[:, 0]
    early, late = angle[len(angle) // 4 : len(angle) // 2], angle[-len(angle) // 4 :]
    assert np.ptp(late) > 2 * np.ptp(early)


def test_every_bundled_verdict():
    for robot, controller, certified in (("fr3", "fr3", True), ("k807", "k807-wrist", False)):
        found = certify_arm(Robot.load(robot), load_controller(controller))
        assert found.certified is certified
        for joint in found.joints:
            assert joint.certified == certified
            assert (joint.counterexample is None) == certified
    assert found.others == ("joint1", "joint2", "joint3", "joint4")


def test_uncertainty_decides(files, dashpot):
    half = "rotor_inertia = 0.15, viscous_friction = 0.3, stiffness = 0.15, damping = 0.3"
    unsure = f"{ROBOT}torque_gain_error = 0.02\nuncertainty = {{ {half} }}\n"
    status, out, _ = dashpot("certify", *files(robot=unsure), "--json")
    (joint,) = strict(out)["joints"]
    assert status == 1
    assert joint["index"] == pytest.approx(0.7, rel=0.01)
    assert joint["worst_index"] < 0
    assert joint["worst_point"]["rotor_inertia"] == pytest.approx(0.0425)


def test_unstable_is_the_lowest_number(files, dashpot):
    status, out, _ = dashpot("certify", *files(R=200.0, D=0.01), "--json")
    (joint,) = strict(out)["joints"]
    assert status == 1
    assert joint["index"] < -1e308
    assert "unstable" in joint["reason"]


def test_bad_input_is_one_line(files, dashpot, tmp_path):
    robot, controller = files()
    (tmp_path / "other.toml").write_text((tmp_path / controller).read_text().replace("wrist / [1]", "elbow"))
    for arguments, said in (
        (("certify", robot, "other.toml"), "the robot has no such joint; it has wrist / [1]"),
        (("certify", robot, "nothing.toml"), "no such file"),
        (("map", robot, controller, "--joint", "elbow"), "not controlled; controlled: wrist / [1]"),
        (("map", robot, controller, "--points", "1"), "must be 2 to 1000"),
    ):
        status, _, err = dashpot(*arguments)
        assert status == 2
        assert len(err.splitlines()) == 1
        assert said in err
    assert not (tmp_path / "out").exists()


def test_map_agrees_with_the_index(files, dashpot, tmp_path):
    """Independent of it: discs at single frequencies, against the level set of the whole."""
    status, _, _ = dashpot("map", *files(kp=30.0, kd=3.0), "--points", "24")
    assert status == 0
    assert (tmp_path / "out" / "map" / "wrist_1_.png").exists()
    with np.load(tmp_path / "out" / "map" / "wrist_1_.npz") as saved:
        R, D, index = saved["R"], saved["D"], saved["index"]
    drive = Robot.load("robot.toml").drives[0]
    rng = np.random.default_rng(0)
    agreed = 0
    for i, j in rng.integers(24, size=(40, 2)):
        law = VirtualPassive(R[j], D[i], 1.0, 0.05, 0.6)
        block = add_position_loop(virtual_passive_block(law, 0.005, "explicit"), 30.0, 3.0)
        exact = passivity_index(drive, block, "average", 0.005)
        if abs(exact.value) > 0.02:
            assert (index[i, j] >= 0) == exact.passive
            agreed += 1
        if math.isfinite(index[i, j]) and exact.value > -5:
            assert index[i, j] <= exact.value + 0.02 * abs(exact.value) + 0.01
    assert agreed > 30
    assert (index >= 0).any()
    assert (index < 0).any()


@pytest.mark.parametrize(("form", "latency"), [("explicit", 0), ("explicit", 2), ("implicit", 1)])
def test_map_marks_gains_at_which_a_load_oscillates(form, latency):
    drive = Drive("w", rotor_inertia=0.05, viscous_friction=0.6, stiffness=6e3, damping=0.7, torque_limit=40)

    def block(R, D):
        made = virtual_passive_block(VirtualPassive(R, D, 1.0, 0.05, 0.6), 0.005, form)
        made["latency"] = latency
        return made

    R, D = np.geomspace(0.5, 60, 12), np.geomspace(0.5, 60, 12)
    found = index_map(drive, block, (0.0, 0.0), "average", 0.005, R, D, tried=12)
    assert found.oscillates.any()
    assert (found.index[found.oscillates] < 0).all()


@pytest.mark.parametrize(
    ("load", "gains"),
    [
        (Load("inertia", 0.5), JointGains("j", R=1.0, D=1.0, K=1.0, kp=60.0, kd=1.0)),
        (Load.pendulum(2.0, 0.4), JointGains("j", R=1.0, D=1.0, K=1.0, kp=60.0, kd=1.0)),
        (Load("inertia and spring", 0.4, 15.0), JointGains("j", R=1.0, D=1.0, K=1.0, kp=60.0, kd=1.0)),
    ],
)
def test_simulator_oscillates_as_predicted(load, gains, tmp_path):
    drive = Drive(
        "j",
        rotor_inertia=0.05,
        viscous_friction=0.6,
        coulomb_friction=0.01,
        stiffness=6e3,
        damping=0.7,
        torque_limit=60.0,
    )
    config = ControllerConfig((gains,), period=0.005, form="explicit")
    joint = sampled_joint(drive, joint_block(gains, drive, config), "average", 0.005)
    motion = oscillation(joint, load)
    assert motion.growth > 0
    expected = Counterexample(load, motion.frequency, motion.growth)
    seen = replay(*write(tmp_path, load, drive, gains, config), expected)
    assert seen.frequency == pytest.approx(motion.frequency, rel=0.05)
    assert seen.growth == pytest.approx(motion.growth, rel=0.25)


@pytest.mark.parametrize(
    ("robot", "sampling", "said"),
    [
        (ROBOT.replace("damping = 0.7\n", ""), "average", "give `damping` in the robot file"),
        (ROBOT, "point", "average the torque over the period, or filter it"),
        (ROBOT.replace("viscous_friction = 0.6", "viscous_friction = 0.0"), "average", ""),
    ],
)
def test_what_cannot_be_certified_is_said_and_drawn(files, dashpot, tmp_path, robot, sampling, said):
    """A drive without damping, bare point samples, no friction: a picture without a certified region."""
    paths = files(robot=robot)
    controller = tmp_path / "controller.toml"
    controller.write_text(controller.read_text().replace("form =", f'sampling = "{sampling}"\nform ='))
    status, out, err = dashpot("certify", *paths)
    assert status == 1
    assert err == ""
    assert said in " ".join(out.split())
    assert (tmp_path / "out" / "certify" / "wrist_1_.png").exists()
    status, _, _ = dashpot("map", *paths, "--points", "8")
    assert status == 0
    if said:
        with np.load(tmp_path / "out" / "map" / "wrist_1_.npz") as saved:
            assert (saved["index"] < 0).all()


def test_joints_of_which_the_same_holds_are_explained_together(tmp_path, monkeypatch, dashpot):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    status, out, _ = dashpot("certify", "k807", "k807-wrist")
    assert status == 1
    assert len(re.findall("oscillates at", out)) == 1
    assert "joint5, joint6, joint7: at the worst point" in out
    assert not re.search(r"\de[+-]\d", out)  # no exponents
    head, _, first = out.splitlines()[1:4]
    assert re.split("  +", head.strip()) == [
        *("joint", "index", "worst", "margin", "at [Hz]", "verdict", "as brake", "worst")
    ]
    assert len(re.split("  +", first.strip())) == 8
    assert max(len(line) for line in out.splitlines() if "dashpot simulate" not in line) <= 80
