"""``dashpot identify``: from a simulated log to a robot file that certify reads."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from dashpot.arm.payload import Payload
from dashpot.arm.plant import build
from dashpot.arm.robot import Robot
from dashpot.cli import main
from dashpot.control.controller import Controller, load_controller
from dashpot.logs import write_log
from dashpot.logs.log import Log, Segment, from_recording
from dashpot.simulation.simulate import Scenario, run
from dashpot.simulation.trajectory import multisine

GAINS = """period = 0.001
sampling = "average"
[[joint]]
name = "joint7"
R = 2.0
D = 40.0
"""
KEYS = ("rotor_inertia", "viscous_friction", "coulomb_friction")


@pytest.fixture(scope="module")
def log():
    """Twelve seconds of the iiwa14 with a payload, joints 6 and 7."""
    robot, config = Robot.load("iiwa14"), load_controller("iiwa14")
    controller = Controller.from_config(config, robot.drives)
    path = multisine(robot.home, 12.0, config.period, 5, amplitude=0.35, band=(0.15, 1.2), tones=5)
    plant = build(robot, config.period, [Payload(2.0, 0.1)])
    whole = from_recording(run(Scenario(plant, controller, path)), controller.sampling)
    part = whole.segments[0]
    columns = {
        k: getattr(part, k)[:, 5:] for k in ("command", "torque", "position", "velocity", "link_position")
    }
    return Log(whole.joints[5:], whole.period, (Segment(part.time, **columns),), whole.sampling)


@pytest.fixture
def dashpot(capsys, tmp_path, monkeypatch):
    """Runs the command in a folder of its own: (status, stdout, stderr)."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")

    def dashpot(*arguments):
        capsys.readouterr()
        with pytest.raises(SystemExit) as left:
            main([str(argument) for argument in arguments])
        return left.value.code, *capsys.readouterr()

    return dashpot


def test_from_log_to_certificate(dashpot, log, tmp_path):
    write_log(log.only("joint7"), tmp_path / "log.mcap")
    status, out, err = dashpot("identify", "log.mcap", "--robot", "iiwa14")
    assert (status, err) == (0, "")
    assert all(len(line) <= 80 for line in out.splitlines())
    assert "next: dashpot certify out/identify/iiwa14.toml CONTROLLER" in out
    folder = tmp_path / "out/identify"
    names = {".dashpot", "identify.json", "iiwa14.toml", "iiwa14.xml"}
    names |= {"joint7.png", "joint7.pdf"}
    assert {p.name for p in folder.iterdir()} == names
    results = json.loads((folder / "identify.json").read_text())
    assert results["identified"]
    assert (results["sampling"], results["robot_file"]) == ("point", "out/identify/iiwa14.toml")
    old, new = Robot.load("iiwa14"), Robot.load(folder / "iiwa14.toml")
    assert new.drives[:6] == old.drives[:6]
    for before, after, found in zip(old.drives[6:], new.drives[6:], results["joints"], strict=True):
        assert after.identified["log"] == "log.mcap"
        assert after.identified["sha256"] == results["sha256"]
        for key in KEYS:
            # The file's own values made the log: what is written lies near, and its box covers the interval.
            value, half = getattr(after, key), after.uncertainty[key]
            assert value == pytest.approx(getattr(before, key), rel=0.05)
            interval = found["values"][key]
            assert value * (1 - half) <= interval["low"] * (1 + 1e-9)
            assert interval["high"] <= value * (1 + half) * (1 + 1e-9)
    (tmp_path / "gains.toml").write_text(GAINS)
    status, out, _ = dashpot("certify", "out/identify/iiwa14.toml", "gains.toml", "--json")
    assert status == 0
    assert [joint["name"] for joint in json.loads(out)["joints"]] == ["joint7"]
    (tmp_path / "gains.toml").write_text(GAINS.replace("R = 2.0", "R = 50.0").replace("D = 40.0", "D = 1.0"))
    status, out, err = dashpot("certify", "out/identify/iiwa14.toml", "gains.toml")
    assert (status, err) == (1, "")  # not certified: a bench that shows why is written, with the new drive
    bench = next((tmp_path / "out/certify").rglob("*robot*.toml"))
    assert Robot.load(bench).drives[0].rotor_inertia > 0


def test_json_one_joint_and_in_place(dashpot, log, tmp_path):
    write_log(log, tmp_path / "log.parquet")
    source = Robot.load("iiwa14")
    given = tmp_path / "mine.toml"
    given.write_text(source.file.read_text().replace('"iiwa14.xml"', f'"{source.model}"'))
    arguments = ("identify", "log.parquet", "--robot", given, "--joint", "joint7", "--json", "--in-place")
    status, out, err = dashpot(*arguments, "--scale", 0)
    assert (status, err) == (0, "")
    assert [joint["name"] for joint in json.loads(out)["joints"]] == ["joint7"]
    written, copy = Robot.load(given), Robot.load(tmp_path / "out/identify/mine.toml")
    assert written.drives == copy.drives
    assert written.model.resolve() == copy.model.resolve() == source.model.resolve()
    assert written.drives[:6] == source.drives[:6]
    assert written.drives[6].identified["quantities"]


def test_a_log_at_rest_is_refused_and_writes_no_values(dashpot, log, tmp_path):
    part = log.segments[0]
    rng = np.random.default_rng(0)
    still = np.tile(part.position[:1], (len(part.time), 1))
    noise = 0.02 * rng.normal(size=(2, *still.shape))
    rest = Segment(part.time, 1 + noise[0], 1 + noise[1], still, 0 * still, still)
    write_log(Log(log.joints, log.period, (rest,), "point"), tmp_path / "log.csv")
    status, out, _ = dashpot("identify", "log.csv", "--robot", "iiwa14", "--sampling", "point")
    assert status == 1
    assert "refused: joint6, joint7" in out
    assert all(len(line) <= 80 for line in out.splitlines())
    results = json.loads(Path("out/identify/identify.json").read_text())
    assert not results["identified"]
    for joint in results["joints"]:
        assert not set(KEYS) & set(joint["values"])
        assert all(refusal["reason"] and refusal["motion"] for refusal in joint["refused"])


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--robot", "k8"), "neither a file nor a bundled robot"),
        (("--robot", "iiwa14", "--joint", "joint1"), "not in the log; log: joint6, joint7; robot: joint1"),
        (("--robot", "iiwa14", "--joint", "elbow"), "not in the log"),
        (("--robot", "iiwa14", "--scale", "nan"), "must be -0.5 to 0.5"),
        (("--robot", "iiwa14", "--in-place"), "a bundled robot is not changed"),
        (("--robot", "iiwa14", "--out", "."), "log.csv, which is read; choose another folder"),
        (("--robot", "iiwa14", "--states", "/a", "--commands", "/a"), "must be three different topics"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(dashpot, log, tmp_path, arguments, said):
    write_log(log, tmp_path / "log.csv")
    status, out, err = dashpot("identify", "log.csv", "--sampling", "point", *arguments)
    assert (status, out) == (2, "")
    assert re.search(said, err)
    assert len(err.splitlines()) == 1
    assert [p.name for p in tmp_path.iterdir()] == ["log.csv"]


def test_log_and_robot_without_a_common_joint(dashpot, log, tmp_path):
    write_log(Log(("elbow", "wrist"), log.period, log.segments, "point"), tmp_path / "log.csv")
    status, _, err = dashpot("identify", "log.csv", "--robot", "iiwa14", "--sampling", "point")
    assert status == 2
    assert "share no joint; log: elbow, wrist; robot: joint1, joint2" in err
