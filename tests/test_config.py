"""Controller files: every bad input gives one line that names file, joint, quantity, value and rule."""

from __future__ import annotations

import copy
import math
import re
import warnings

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dashpot.arm.drive import Drive
from dashpot.arm.robot import Robot
from dashpot.control.controller import Controller, ControllerConfig, JointGains, joint_block, load_controller
from dashpot.control.law import max_torque_gain_error
from dashpot.control.sampled import VirtualPassive
from dashpot.control.supervisorsettings import SupervisorSettings
from dashpot.errors import DashpotError, InputError, InputWarning, written

JOINT = {"name": "j1", "R": 5.0, "D": 4.0, "K": 1.0, "kp": 20.0, "kd": 1.0}
FILE = {
    "period": 0.005,
    "latency": 1,
    "sampling": "average",
    "form": "implicit",
    "blend": 0.02,
    "joint": [JOINT, {"name": "j2", "R": 2, "D": 3, "rotor_inertia": 0.1, "viscous_friction": 0.5}],
}
DRIVE = {
    "name": "j1",
    "rotor_inertia": 0.2,
    "viscous_friction": 0.5,
    "stiffness": 1e4,
    "damping": 5.0,
    "torque_limit": 40.0,
    "inner_loop": {"gain": 3.0, "period": 1e-4},
    "servo": {"kp": 1e4, "kd": 100},
    "uncertainty": {"rotor_inertia": 0.1},
}
ROBOT = {"name": "arm", "home": [0.1, 0], "joint": [DRIVE, {**DRIVE, "name": "j2", "stiffness": 10_000}]}
DRIVES = [Drive.from_table(entry) for entry in ROBOT["joint"]]


def changed(path, value, base=FILE):
    """A copy of a file with one entry set, or removed where value is `...`."""
    table = copy.deepcopy(base)
    *parents, key = path
    inner = table
    for parent in parents:
        inner = inner[parent]
    if value is ...:
        del inner[key]
    else:
        inner[key] = value
    return table


def test_a_good_file(write):
    config = ControllerConfig.load(write(FILE))
    assert (config.period, config.latency, config.sampling, config.form) == (0.005, 1, "average", "implicit")
    assert config.joints[0] == JointGains(**JOINT)
    assert config.joints[1].kp == 0
    controller = Controller.from_config(config, DRIVES[::-1])  # by name, not by order
    assert controller.joints == ("j1", "j2")
    assert controller.blocks["latency"].tolist() == [1, 1]
    assert controller.blocks["torque_limit"].tolist() == [40, 40]
    assert controller.blocks["blend"] == pytest.approx(math.exp(-0.25))


def test_defaults_and_whole_numbers(write):
    config = ControllerConfig.load(
        write({"period": 1e-3, "blend": 0, "joint": [{"name": "a", "R": 5, "D": 4}]})
    )
    assert (config.latency, config.sampling, config.form, config.joints[0].K) == (0, "average", "implicit", 0)
    assert isinstance(config.joints[0].R, float)
    with pytest.warns(InputWarning, match=r"period \[s\] = 1"):
        ControllerConfig.load(write({"period": 1, "joint": [{"name": "a", "R": 5, "D": 4}]}))


NOT_NUMBERS = ["5", [5.0], True, {"x": 1}, [], ""]
BAD = [
    (("period",), ..., "missing key: period"),
    (("joint",), ..., "missing key: joint"),
    (("joint", 0, "R"), ..., "joint 'j1': missing key: R"),
    (("joint", 0, "name"), ..., "name: every [[joint]] needs a name"),
    (("joint", 0, "name"), 7, "name = 7: every [[joint]] needs a name"),
    (("joint", 0, "Kp"), 1.0, "joint 'j1': Kp: unknown key; did you mean 'kp'?"),
    (("joint", 0, "stiffness"), 1.0, "joint 'j1': stiffness: unknown key"),
    (("peroid",), 1.0, "peroid: unknown key; did you mean 'period'?"),
    (("per\niod",), 1.0, "per\\niod: unknown key; did you mean 'period'?"),
    (("xyz",), 1.0, "xyz: unknown key; known: blend, form, joint, latency, latency_max, period, sampling"),
    (("joint", 1, "name"), "j1", "joint 'j1': is listed twice"),
    (("joint",), [], "a controller needs at least one [[joint]]"),
    (("joint",), JOINT, "joint: must be [[joint]] tables"),
    (("joint",), [JOINT, 3], "joint: must be [[joint]] tables"),
    (("joint",), "j1", "joint: must be [[joint]] tables"),
    (("latency",), 1.0, "latency = 1.0: must be a whole number of samples, 0 to 16"),
    (("latency",), -1, "latency = -1: must be a whole number of samples, 0 to 16"),
    (("latency",), 99, "latency = 99: must be a whole number of samples, 0 to 16"),
    (("latency",), True, "latency = true: must be a whole number"),
    (("latency_max",), -1, "latency_max = -1: must be a whole number of samples, latency (1) to 16"),
    (("latency_max",), 1.5, "latency_max = 1.5: must be a whole number of samples"),
    (("latency_max",), 17, "latency_max = 17: must be a whole number of samples"),
    (("sampling",), "mean", 'sampling = \'mean\': must be "average" or "point"'),
    (("sampling",), ["average"], "sampling = ['average']: must be"),
    (("form",), "tustin", 'form = \'tustin\': must be "implicit" or "explicit"'),
    (("form",), 1, "form = 1: must be"),
    (("period",), 5, "period [s] = 5.0: must be at least 1e-05 and at most 1 s"),  # meant: 5 ms
    (("period",), 0.0, "period [s] = 0.0: must be at least"),
    (("period",), -0.005, "period [s] = -0.005: must be at least"),
    (("period",), 10**400, "period [s] = inf: must be finite"),
    (("blend",), -1, "blend [s] = -1: must be at least 0"),
    (("blend",), 10**400, "blend [s] = 1000000"),
    (("joint", 0, "R"), 0, "joint 'j1': R [-] = 0.0: must be at least 1e-06 and at most 10000"),
    (("joint", 0, "R"), 10**5000, "joint 'j1': R [-] = inf: must be finite"),
    (("joint", 0, "R"), -3.0, "joint 'j1': R [-] = -3.0: must be"),
    (("joint", 0, "D"), 0.0, "joint 'j1': D [N m s/rad] = 0.0: must be"),
    (("joint", 0, "K"), -1.0, "joint 'j1': K [N m/rad] = -1.0: must be"),
    (("joint", 0, "kp"), -1.0, "joint 'j1': kp [N m/rad] = -1.0: must be"),
    (("joint", 1, "rotor_inertia"), 0.0, "joint 'j2': rotor_inertia [kg m^2] = 0.0: must be"),
    *[(("period",), x, "period [s] = {}: must be a number") for x in NOT_NUMBERS],
    *[(("joint", 0, "D"), x, "joint 'j1': D [N m s/rad] = {}: must be a number") for x in NOT_NUMBERS],
    *[(("joint", 0, "K"), x, "joint 'j1': K [N m/rad] = {}: must be finite") for x in (math.nan, math.inf)],
    *[(("period",), x, "period [s] = {}: must be finite") for x in (math.nan, math.inf, -math.inf)],
]


@pytest.mark.parametrize(("path", "value", "message"), BAD, ids=map(str, range(len(BAD))))
def test_bad_value(refused, path, value, message):
    said = refused(ControllerConfig.load, changed(path, value))
    shown = "" if isinstance(value, int) and value > 10**4000 else written(value)
    assert said.startswith(message.replace("{}", shown))


BAD_FILES = [
    ("", "missing keys: joint, period"),
    ("period = ", "not valid TOML: "),
    ("[[joint]\n", "not valid TOML: "),
    (b"\x00\x01\xff\xfe", "not valid TOML: "),
    ("period = 1" + "0" * 5000, "not valid TOML: "),
    ("period = " + "[" * 5000, "not valid TOML: "),
    ("period = 1\nperiod = 2", "not valid TOML: "),
]


@pytest.mark.parametrize("load", [ControllerConfig.load, Robot.load])
@pytest.mark.parametrize(("content", "message"), BAD_FILES, ids=map(str, range(len(BAD_FILES))))
def test_bad_file(refused, load, content, message):
    said = refused(load, content)
    if content or load == ControllerConfig.load:
        assert said.startswith(message)


@pytest.mark.parametrize("load", [ControllerConfig.load, Robot.load])
def test_no_file(refused, tmp_path, load):
    assert refused(load, tmp_path / "none.toml") == "no such file"
    (tmp_path / "folder.toml").mkdir()
    assert refused(load, tmp_path / "folder.toml") == "cannot be read: Is a directory"
    with pytest.raises(InputError, match="cannot be read: File name too long"):
        load(tmp_path / ("x" * 300 + ".toml"))
    with pytest.raises(InputError):
        load("\0.toml")


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("period",), 0.5),
        (("joint", 0, "R"), 5000.0),
        (("joint", 0, "D"), 1e-4),
        (("joint", 0, "D"), 5e4),
    ],
)
def test_unusual_value_warns_once_and_names_the_file(write, path, value):
    file = write(changed(path, value))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        ControllerConfig.load(file)
    assert [w.category for w in caught] == [InputWarning]
    message = str(caught[0].message)
    assert message.startswith(f"{file}: ")
    assert f"= {value}: is unusual" in message
    assert ("joint 'j1'" in message) == (path[0] == "joint")


def test_unknown_joint(write):
    file = write(changed(("joint", 1, "name"), "elbow"))
    message = re.escape(f"{file}: joint 'elbow': the robot has no such joint; it has j1, j2")
    with pytest.raises(InputError, match=f"^{message}$"):
        Controller.from_config(ControllerConfig.load(file), DRIVES)


def test_in_python_the_same_rules_hold():
    with pytest.raises(InputError, match=r"^joint 'a': R \[-\] = -1: must be"):
        JointGains("a", R=-1, D=1)
    with pytest.raises(InputError, match=r"^period \[s\] = nan: must be finite$"):
        ControllerConfig((JointGains("a", R=1, D=1),), period=math.nan)
    with pytest.raises(InputError, match="at least one"):
        ControllerConfig((), period=1e-3)


# --- torque channel --------------------------------------


@settings(max_examples=50, deadline=None)
@given(st.floats(1, 60), st.floats(0.5, 50), st.floats(0.01, 5), st.floats(0, 0.2))
def test_torque_gain_error_beyond_its_bound_warns(R, D, v, error):
    drive = Drive(
        "j1", rotor_inertia=0.2, viscous_friction=v, stiffness=1e4, torque_limit=40, torque_gain_error=error
    )
    config = ControllerConfig((JointGains("j1", R=R, D=D),), period=1e-3)
    bound = max_torque_gain_error(R, D, v)
    assert bound == pytest.approx(D / (R * VirtualPassive(R, D, 0, 0.2, v).a))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        joint_block(config.joints[0], drive, config, file="c.toml")
    assert len(caught) == (error > D / (R * (R * v + D)))
    for warning in caught:
        assert warning.category is InputWarning
        assert str(warning.message).startswith(
            f"c.toml: joint 'j1': torque_gain_error = {error!r}: exceeds D/(R"
        )
        assert f"{bound:.3g}" in str(warning.message)


def test_friction_assumed_by_the_law_counts_in_the_bound():
    """0.06 is below D/(R a) = 4/52 with the law's own v but above it with the drive's."""
    drive = Drive(
        "j1", rotor_inertia=0.2, viscous_friction=2, stiffness=1e4, torque_limit=40, torque_gain_error=0.06
    )
    joints = JointGains("j1", R=8, D=4), JointGains("j1", R=8, D=4, viscous_friction=0.25)
    with pytest.warns(InputWarning, match="exceeds"):
        joint_block(joints[0], drive, ControllerConfig((joints[0],), period=1e-3))
    joint_block(joints[1], drive, ControllerConfig((joints[1],), period=1e-3))


# --- fuzz ------------------------------------------------

scalars = (
    st.none().map(lambda _: 10**400)
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.floats(0, 10)
    | st.text(st.characters(codec="utf-8"), max_size=6)
    | st.sampled_from(
        ["j1", "j2", "average", "point", "implicit", "explicit", 5e-324, 1e-9, 1e4, 1e6, 0, 1, 16]
    )
)
values = scalars | st.recursive(
    scalars,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=2),
    max_leaves=4,
)


def places(table, path=()):
    items = table.items() if isinstance(table, dict) else enumerate(table)
    for key, value in items:
        yield (*path, key)
        if isinstance(value, dict | list):
            yield from places(value, (*path, key))


@st.composite
def mutated(draw, base):
    table = copy.deepcopy(base)
    for _ in range(draw(st.integers(1, 3))):
        path = draw(st.sampled_from(list(places(table))))
        if draw(st.integers(0, 9)) == 0 and isinstance(path[-1], str):
            path = (*path[:-1], draw(st.text(st.characters(codec="utf-8"), max_size=5)))
        gone = draw(st.integers(0, 9)) == 0
        try:
            table = changed(path, ... if gone else draw(values), table)
        except (KeyError, IndexError):
            continue
        if not table:
            break
    return table


fuzz = settings(
    max_examples=150,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


def survives(file, load, *args):
    """The result, or None for an error; nothing but one-line errors and warnings of our own may come out."""
    result, said = None, []
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            result = load(*args)
        except DashpotError as error:
            said = [str(error)]
    assert {w.category for w in caught} <= {InputWarning}
    said += [str(w.message) for w in caught]
    assert all(line.isprintable() and line.startswith(str(file)) for line in said)
    return result


@fuzz
@given(table=mutated(FILE))
def test_any_controller_file_loads_or_is_refused(write, table):
    config = survives(file := write(table), ControllerConfig.load, file)
    controller = survives("", Controller.from_config, config, DRIVES) if config else None
    if controller is None:
        return
    out = np.zeros(len(controller.joints))
    for _ in range(3):
        controller.inputs.torque[:] = 1.0
        controller.step(out)
        assert (np.abs(out) <= 40).all()


@fuzz
@given(table=mutated(ROBOT))
def test_any_robot_file_loads_or_is_refused(write, table):
    robot = survives(file := write(table), Robot.load, file)
    if robot is None:
        return
    config = ControllerConfig((JointGains(robot.joints[0], R=5, D=4, K=1),), period=1e-3)
    controller = survives("", Controller.from_config, config, robot.drives)
    assert controller is not None
    out = np.zeros(1)
    controller.inputs.torque[:] = 1.0
    controller.step(out)
    assert np.isfinite(out).all()


@settings(max_examples=60, deadline=None)
@given(
    *[
        st.floats(np.log10(low), np.log10(high)).map(lambda x: 10.0**x)
        for low, high in ((1e-6, 1e4), (1e-9, 1e6), (1e-12, 1e7), (1e-9, 1e3), (1e-9, 1e4), (1e-5, 1))
    ],
    st.sampled_from(["explicit", "implicit"]),
)
def test_every_legal_gain_gives_a_finite_controller_or_a_refusal(R, D, K, m, v, period, form):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        drive = Drive("j1", rotor_inertia=m, viscous_friction=v, stiffness=1e4, torque_limit=40)
        config = ControllerConfig((JointGains("j1", R=R, D=D, K=K),), period=period, form=form)
    try:
        controller = Controller.from_config(config, [drive])
    except InputError:
        return
    n = int(controller.blocks[0]["nx"])
    A = controller.blocks[0]["A"][:n, :n]
    assert np.abs(np.linalg.eigvals(A)).max() < 1 + 1e-6


# --- [supervisor] of a controller -----------------------------------------------------------------------


def with_supervisor(tmp_path, text):
    file = tmp_path / "law.toml"
    file.write_text(f'period = 0.001\n{text}\n[[joint]]\nname = "j1"\nR = 5.0\nD = 4.0\n')
    return file


def test_a_controller_may_say_what_its_supervisor_may_assume(tmp_path):
    file = with_supervisor(
        tmp_path, "[supervisor]\nstop_time = 1\ndebounce = 5\nkeep_load = false\nstand = 0.2"
    )
    settings = load_controller(file).supervisor
    assert settings == SupervisorSettings(stop_time=1.0, debounce=5, keep_load=False, stand=0.2)
    assert isinstance(settings.stop_time, float)
    assert load_controller(with_supervisor(tmp_path, "")).supervisor == SupervisorSettings()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("supervisor = true", "law.toml: supervisor = true: must be a table of settings"),
        (
            "[supervisor]\nstop_tme = 1.0",
            "law.toml: supervisor.stop_tme: unknown key; did you mean 'stop_time'?",
        ),
        (
            "[supervisor]\nstop_time = 61.0",
            "law.toml: supervisor.stop_time [s] = 61.0: must be above 0 and at most 60 s",
        ),
        (
            "[supervisor]\ndebounce = 2.5",
            "law.toml: supervisor.debounce = 2.5: must be a whole number, 1 to 16",
        ),
        ('[supervisor]\ndrift = "far"', "law.toml: supervisor.drift [rad] = 'far': must be a number"),
        ("[supervisor]\nbias_limit = nan", "law.toml: supervisor.bias_limit [-] = nan: must be finite"),
        ("[supervisor]\nkeep_load = 1", "law.toml: supervisor.keep_load = 1: must be true or false"),
    ],
)
def test_a_wrong_setting_is_refused_with_file_key_value_and_rule(tmp_path, text, said):
    file = with_supervisor(tmp_path, text)
    with pytest.raises(InputError) as refusal:
        load_controller(file)
    assert str(refusal.value) == f"{tmp_path}/{said}"
