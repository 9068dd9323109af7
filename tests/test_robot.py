"""Robot files and the bundled arms."""

from __future__ import annotations

import copy
import math

import pytest

from dashpot.arm.drive import Drive
from dashpot.arm.robot import BUNDLED, Robot
from dashpot.errors import InputError

DRIVE = {"name": "a", "rotor_inertia": 0.2, "viscous_friction": 0.5, "stiffness": 1e4, "torque_limit": 40.0}
FILE = {
    "name": "arm",
    "model": "arm.xml",
    "flange": "tip",
    "home": [0, 0.5],
    "joint": [DRIVE, {**DRIVE, "name": "b"}],
}


def test_a_good_file(write):
    file = write(FILE)
    robot = Robot.load(str(file))
    assert robot.joints == ("a", "b")
    assert robot.model == file.parent / "arm.xml"
    assert (robot.flange, robot.home, robot.file) == ("tip", (0.0, 0.5), file)
    assert robot.drives[1] == Drive(**{**DRIVE, "name": "b"})
    assert robot.index("b") == 1
    bare = Robot.load(write({"name": "arm", "joint": [DRIVE]}))
    assert (bare.model, bare.flange, bare.home) == (None, None, (0.0,))


@pytest.mark.parametrize("name", BUNDLED)
def test_bundled_arms_load_without_a_warning(name):
    robot = Robot.load(name)
    assert robot.name == name
    assert len(robot.drives) == 7
    assert robot.model.exists()


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("name", ..., "missing key: name"),
        ("joint", ..., "missing key: joint"),
        ("joint", [], "a robot needs at least one [[joint]]"),
        ("joint", DRIVE, "joint: must be [[joint]] tables"),
        ("joint", 3, "joint: must be [[joint]] tables"),
        ("joint", [[DRIVE]], "joint: must be [[joint]] tables"),
        ("joint", [DRIVE, DRIVE], "joint 'a': is listed twice"),
        ("joint", [{**DRIVE, "rotor_inertia": -0.1}], "joint 'a': rotor_inertia [kg m^2] = -0.1: must be"),
        ("joint", [{**DRIVE, "stiffness": math.nan}], "joint 'a': stiffness [N m/rad] = nan: must be finite"),
        ("joint", [{**DRIVE, "name": "x\ny", "stiffness": 0}], "joint 'x\\ny': stiffness"),
        ("Home", [0, 0], "Home: unknown key; did you mean 'home'?"),
        ("name", 3, "name = 3: must be a string"),
        ("model", ["a.xml"], "model = ['a.xml']: must be a string"),
        ("flange", True, "flange = true: must be a string"),
        ("home", [0.0], "home = [0.0]: must be 2 finite angles [rad], one per joint"),
        ("home", [0.0, math.nan], "home = [0.0, nan]: must be 2 finite angles"),
        ("home", [0, 10**400], "home = [0.0, inf]: must be 2 finite angles"),
        ("home", [0.0, "0"], "home = [0.0, '0']: must be a list of angles"),
        ("home", [0.0, True], "home = [0.0, true]: must be a list of angles"),
        ("home", 0.0, "home = 0.0: must be a list of angles"),
    ],
)
def test_bad_value(refused, key, value, message):
    table = {k: v for k, v in copy.deepcopy({**FILE, key: value}).items() if v is not ...}
    assert refused(Robot.load, table).startswith(message)


def test_not_a_robot():
    with pytest.raises(InputError, match=r"^k808: neither a file nor a bundled robot \(k807, fr3, iiwa14\)$"):
        Robot.load("k808")
    with pytest.raises(InputError, match=r"^k808.toml: no such file$"):
        Robot.load("k808.toml")
    with pytest.raises(InputError):
        Robot.load("x" * 300)


def test_with_drives(write):
    robot = Robot.load(write(FILE))
    changed = robot.with_drives({"b": {"coulomb_friction": 0.5}})
    assert (changed.drives[0], changed.drives[1].coulomb_friction) == (robot.drives[0], 0.5)
    assert robot.drives[1].coulomb_friction == 0
    with pytest.raises(InputError, match="joint 'c': no such joint; it has a, b"):
        robot.with_drives({"c": {}})
    with pytest.raises(InputError, match="joint 'a': stifness: unknown key; did you mean 'stiffness'"):
        robot.with_drives({"a": {"stifness": 1e4}})
    with pytest.raises(InputError, match="joint 'a': stiffness"):
        robot.with_drives({"a": {"stiffness": -1e4}})
    with pytest.raises(InputError, match="joint 'a': name: unknown key"):
        robot.with_drives({"a": {"name": "b"}})


def test_in_python():
    drives = Drive(**DRIVE), Drive(**{**DRIVE, "name": "b"})
    assert Robot("arm", drives).home == (0.0, 0.0)
    with pytest.raises(InputError, match="at least one"):
        Robot("arm", ())
    with pytest.raises(InputError, match="'a': is listed twice"):
        Robot("arm", (drives[0], drives[0]))
