"""Identified drives written into robot files: intervals covered, everything else untouched."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest

import dashpot
from dashpot.arm.robot import Robot
from dashpot.errors import InputError
from dashpot.identify.estimate import DriveEstimate, Estimate, Fit
from dashpot.identify.writeback import box, new_values, updated, write_back
from dashpot.logs.log import Log, Segment

ROBOT = """# An arm of two joints.
name = "two"   # its name
model = "model/two.xml"
home = [0.1, 0.2]

[[joint]]
# the shoulder
name = "a"
rotor_inertia = 0.2     # data sheet, page 3
viscous_friction = 0.5
stiffness = 1.2e4
torque_limit = 87.0
servo = { kp = 1e4, kd = 200.0 }
uncertainty = { rotor_inertia = 0.15, damping = 0.5 }   # a guess

# between the joints
[[joint]]
name = "b"
rotor_inertia = 0.1
viscous_friction = 0.4
stiffness = 1e4
torque_limit = 12.0
"""


def estimate(joint, **values):
    fit = Fit(*(np.zeros(3) for _ in range(4)), np.ones(3, bool), 0.1, 1234, 0.01)
    found = {key: Estimate(*numbers, "-") for key, numbers in values.items()}
    return DriveEstimate(joint, found, (), fit)


FULL = estimate(
    "a",
    rotor_inertia=(0.18, 0.17, 0.2),
    viscous_friction=(0.45, 0.4, 0.47),
    coulomb_friction=(1.1, 1.0, 1.2),
    torque_bias=(0.3, 0.2, 0.4),
    torque_scale_error=(-0.01, -0.03, 0.01),
    latency=(0.001, 0.0008, 0.00121),
)
TIME = np.arange(10) * 0.01
LOG = Log(("a",), 0.01, (Segment(TIME, TIME[:, None], TIME[:, None]),), "point", None, "ab" * 32)


@pytest.fixture
def robot(tmp_path):
    folder = tmp_path / "given"
    folder.mkdir()
    (folder / "arm.toml").write_text(ROBOT)
    return Robot.load(folder / "arm.toml")


def covered(value, half, low, high):
    return value * (1 - half) <= low * (1 + 1e-12) and value * (1 + half) >= high * (1 - 1e-12)


def test_value_and_half_width_cover_the_interval_whatever_it_is():
    rng = np.random.default_rng(0)
    for _ in range(2000):
        value = 10 ** rng.uniform(-4, 3)
        low, high = value - value * 10 ** rng.uniform(-5, 0.5), value + value * 10 ** rng.uniform(-5, 0.5)
        at, half = box(Estimate(value, low, high, "-"))
        assert 0 <= half < 1
        # A half-width of one is not allowed: what cannot be negative may be cut off at a thousandth.
        assert covered(at, half, max(low, 1.1e-3 * high), high)
        if low > 0.01 * value and high < 1.9 * value:
            assert at == pytest.approx(value, rel=1e-5)
            assert half == pytest.approx(max(value - low, high - value) / value, rel=0.02, abs=2e-5)
    assert box(Estimate(-0.1, -0.3, -0.01, "-")) == (0.0, 0.0)
    at, half = box(Estimate(-0.1, -0.3, 0.2, "-"))
    assert covered(at, half, 1e-3, 0.2)


def test_what_the_certificate_must_cover():
    values, uncertainty = new_values(FULL)
    assert values["torque_gain_error"] == 0.03  # the largest scale error in the interval
    assert values["command_latency"] == 0.00121  # the upper end
    assert (values["torque_bias"], values["torque_scale_error"]) == (0.3, -0.01)
    assert uncertainty["rotor_inertia"] == pytest.approx(0.112)  # 0.02 / 0.18, rounded up
    assert set(uncertainty) == {"rotor_inertia", "viscous_friction", "coulomb_friction"}


def test_everything_else_stays_as_it_was(robot, tmp_path):
    path = write_back(robot, [FULL], LOG, tmp_path / "new" / "arm.toml")
    text, again = path.read_text(), Robot.load(path)
    for kept in (
        "# An arm of two joints.",
        'name = "two"   # its name',
        "# the shoulder",
        "# data sheet, page 3",
        "servo = { kp = 1e4, kd = 200.0 }",
        "# a guess",
        "# between the joints",
    ):
        assert kept in text
    assert text[text.index('name = "b"') :] == ROBOT[ROBOT.index('name = "b"') :]
    a, b = again.drives
    assert b == robot.drives[1]
    assert (a.rotor_inertia, a.coulomb_friction, a.command_latency) == (0.18, 1.1, 0.00121)
    assert (a.stiffness, a.servo) == (robot.drives[0].stiffness, robot.drives[0].servo)
    assert a.uncertainty["damping"] == 0.5  # not identified: as it was
    assert again.model.resolve() == robot.model.resolve()
    assert again.home == robot.home
    assert robot.file.read_text() == ROBOT
    assert [p.name for p in path.parent.iterdir()] == ["arm.toml"]


def test_provenance_is_readable_by_people_and_programs_and_replaced_not_stacked(robot, tmp_path):
    path = write_back(robot, [FULL], LOG, tmp_path / "one.toml")
    second = estimate("a", rotor_inertia=(0.19, 0.18, 0.21))
    once = path.read_text()
    write_back(Robot.load(path), [second], LOG, path)
    text, drive = path.read_text(), Robot.load(path).drives[0]
    assert once.count("# identified from") == text.count("# identified from") == 1
    assert text.count("[joint.identified]") == 1
    assert drive.identified == {
        "log": "in memory",
        "sha256": "ab" * 32,
        "date": drive.identified["date"],
        "dashpot": dashpot.__version__,
        "samples": 1234,
        "confidence": 0.95,
        "quantities": ["rotor_inertia"],
    }
    assert (drive.rotor_inertia, drive.coulomb_friction) == (0.19, 1.1)
    for _ in range(3):  # nothing grows
        write_back(Robot.load(path), [second], LOG, path)
    assert path.read_text() == text


@pytest.mark.parametrize(
    "layout",
    [
        ROBOT.replace("\n", "\r\n"),
        ROBOT.replace(
            "uncertainty = { rotor_inertia = 0.15, damping = 0.5 }   # a guess",
            "[joint.uncertainty]\ndamping = 0.5",
        ),
        'name = "x"\njoint = [{ name = "a", rotor_inertia = 1, viscous_friction = 1, stiffness = 9e3, '
        "torque_limit = 9 }]\n",
        ROBOT.replace("[[joint]]\n# the shoulder", '[[ "joint" ]] # [[joint]]'),
        ROBOT.replace('name = "two"', 'name = """\n[[joint]]\n"""'),
    ],
)
def test_unusual_layouts_are_kept_or_refused_but_never_spoilt(tmp_path, layout):
    given = tmp_path / "odd.toml"
    given.write_bytes(layout.encode())
    robot = Robot.load(given)
    path = tmp_path / "new.toml"
    refused = None
    try:
        write_back(robot, [FULL], LOG, path)
    except InputError as error:
        refused = str(error)
    if refused is not None:
        assert "unusual" in refused
        assert not path.exists()
    else:
        new = tomllib.loads(path.read_bytes().decode())["joint"][0]
        assert new["rotor_inertia"] == 0.18
        assert new["identified"]["samples"] == 1234
        assert (b"\r\n" in path.read_bytes()) == ("\r\n" in layout)
    assert given.read_bytes() == layout.encode()


def test_values_no_drive_may_have_leave_the_old_file(robot, tmp_path):
    path = tmp_path / "new.toml"
    path.write_text("old")
    with pytest.raises(
        InputError, match=r"joint 'a': rotor_inertia \[kg m\^2\] = 50000.0: the identified values"
    ):
        write_back(robot, [estimate("a", rotor_inertia=(5e4, 4e4, 6e4))], LOG, path)
    assert path.read_text() == "old"
    assert {p.name for p in tmp_path.iterdir()} == {"given", "new.toml"}


def test_a_scale_too_uncertain_to_state_changes_nothing(robot, tmp_path):
    wide = estimate("a", rotor_inertia=(0.18, 0.17, 0.2), torque_scale_error=(0.1, -0.6, 0.8))
    path = write_back(robot, [wide], LOG, tmp_path / "given" / "new.toml")
    assert path.read_text() == ROBOT


def test_a_bundled_robot_takes_its_model_along(tmp_path):
    robot = Robot.load("fr3")
    found = estimate(robot.joints[0], rotor_inertia=(0.2, 0.19, 0.21))
    again = Robot.load(write_back(robot, [found], LOG, tmp_path / "fr3.toml"))
    assert again.model == tmp_path / "fr3.xml"
    assert again.model.read_bytes() == robot.model.read_bytes()
    assert again.drives[0].rotor_inertia == 0.2
    assert again.drives[1:] == robot.drives[1:]


def test_text_is_unchanged_where_nothing_was_identified(robot):
    from dashpot.identify.writeback import Provenance

    empty = DriveEstimate("a", {}, (), None)
    assert updated(ROBOT, robot, [empty], Provenance.of(LOG), None) == ROBOT
