"""Campaign specifications: what is accepted, how scenarios are laid out, what samples are like."""

from __future__ import annotations

import contextlib
import math
import pickle
from importlib.resources import files

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from dashpot.campaign.requirements import Requirement
from dashpot.campaign.scenario import Campaign
from dashpot.campaign.spec import CHUNK, Spec
from dashpot.control.supervisorsettings import SupervisorSettings
from dashpot.errors import DashpotError, InputError

HEAD = 'robot = "fr3"\ncontroller = "fr3"\nduration = 0.2\n'
SAMPLED = HEAD + 'sample = "{}"\ncount = 32\nseed = 4\n'


def parse(text, head=HEAD):
    return Spec.parse(head + text, None)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[axes]\npayloads = [1.0]", "did you mean 'payload'"),
        ("[axes]\npayload = []", "must not be empty"),
        ("[axes]\npayload = [1.0, 1.0]", "is listed twice"),
        ("[axes]\npayload = [-1.0]", "must be 0 to 10000 kg"),
        ("[axes]\npayload = [nan]", "must be 0 to 10000 kg"),
        ("[axes]\npayload = true", "must be a number"),
        ('[axes]\npayload = ["1"]', "must be a number"),
        ("[axes]\noffset = [[0.0, 1.0]]", "must be a number or [x, y, z]"),
        ("[axes]\npayload = {low = 0.0, high = 1.0}", "needs sample"),
        ("[axes]\npayload = {low = 1.0, high = 0.0, points = 3}", "low must be below high"),
        ("[axes]\npayload = {low = 0.0, high = 1.0, points = 1}", "points must be 2"),
        (
            "[axes]\npayload = {low = 0.0, high = 1.0, points = 3, distribution = 'normal'}",
            "must be one of uniform",
        ),
        (
            "[axes]\npayload = {low = 0.0, high = 1.0, points = 3, distribution = 'log-uniform'}",
            "low above 0",
        ),
        ("[axes]\nseed = [0.5]", "must be a whole number"),
        ("[axes]\ngains.Q = [1.0]", "unknown key"),
        ("[axes]\ngains = [1.0]", "must be a table of R, D, K, kp, kd"),
        ("[axes]\ndrive.joint1.mass = [1.0]", "unknown key"),
        ("[axes]\npose = ['folded']", "no such pose"),
        ("[axes]\npose = {random = 0}", "must be 1 to"),
        ("[axes]\ncontroller = ['fr3']", "belongs above [axes]"),
        ("[axes]\nfault = ['encoder']", 'must be "none" or a table'),
        ("[axes]\nfault = [{kind = 'a', start = 1.0}, {kind = 'a', start = 2.0}]", "is listed twice"),
        ("[axes]\nfault = [{payload_at = []}]", "needs faults or payload_at"),
        ("[axes]\nfault = [{payload_at = [1.0]}]", "must be a list of tables"),
        ("supervisor = 1", "must be true, false or a table"),
        ("supervisor = {stop_tme = 1.0}", "did you mean 'stop_time'"),
        ("supervisor = {stop_time = 0}", "supervisor.stop_time [s]"),
        ("lead_in = -1.0", "lead_in [s]"),
        ("[requirements]\nstopped = {in = []}", "must not be empty"),
        ("[requirements]\nstopped = {in = [1.0], max = 1.0}", "nor stand beside max"),
        ("[requirements]\nstopped = {in = 1.0}", "must be a list of numbers"),
        (
            "[axes]\npayload = [1.0]\n[requirements]\nstopped = {min = 1.0, where = {payload = [1.0, 2.0]}}",
            "not on this axis: 1.0",
        ),
        ("[requirements]\nerror = {max = 1.0}", "unknown key"),
        ("[requirements]\ntorque_peak_deg = {max = 1.0}", "unknown key"),
        ("[requirements]\nerror_max = 1.0", "must be a table"),
        ("[requirements]\nerror_max = {quantile = 0.5}", "needs a max, a min or an in"),
        ("[requirements]\nerror_max = {max = nan}", "must be a finite number"),
        ("[requirements]\nerror_max = {max = 1.0, quantile = 0.0}", "above 0 and at most 1"),
        ("[requirements]\nerror_max = {max = 1.0, min = 2.0}", "min exceeds max"),
        ("[requirements]\nlimited = {max = 1.0, joint = 'joint1'}", "measure per joint"),
        ("[requirements]\nerror_max = {max = 1.0, where = {payload = 1.0}}", "no such axis"),
        ("count = 3", "is for samples only"),
        ("seed = -1", "must be a whole number, 0 to 2147483647"),
        ("chunk = 0", "must be 1 to 10000"),
        ("sample = 'sobol'\ncount = 4", "no axis is a range"),
        ("motion = 'hold'\n[axes]\namplitude = [0.1]", "has no effect on motion"),
        (
            "[axes]\nseed = {low = 0, high = 99999, points = 100000}\n"
            "trajectory = {low = 0, high = 999, points = 1000}",
            "at most 10000000",
        ),
        ("amplitude = 300.0", "at most"),
        ("robot", "not valid TOML"),
    ],
)
def test_bad_specifications_are_refused_in_one_line(text, said):
    with pytest.raises(InputError) as caught:
        parse(text)
    message = str(caught.value)
    assert said in message
    assert len(message.splitlines()) == 1
    assert len(message) < 400


def test_a_name_that_is_no_file_is_said_with_its_key(tmp_path):
    for key, name in (("robot", "fr33"), ("controller", "nope"), ("controller", "nope.toml")):
        other = 'controller = "fr3"' if key == "robot" else 'robot = "fr3"'
        spec = Spec.parse(f'{key} = "{name}"\n{other}', tmp_path / "s.toml")
        with pytest.raises(InputError, match=rf"s\.toml: {key} = '{name}': (neither a file|no such file)"):
            Campaign(spec)
    with pytest.raises(InputError, match=r"s\.toml: axes\.foo: unknown key"):
        Spec.parse(HEAD + "[axes]\nfoo = [1]", "s.toml")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("release = 5.0", "release [s] = 5: must be within the motion, 0 to 0.199 s"),
        ("[axes]\ndrive.joint9.stiffness = [1.1]", "axes.drive.joint9: no such joint; fr3 has joint1, "),
        ("[axes]\ngains.joint9.R = [1.1]", "axes.gains.joint9: no such joint"),
        ("[axes]\ngains.R = [9999]", "axes.gains.R = 9999: R [-] of joint 'joint1' would be 99990.0: must"),
        ("[axes]\npayload = [0, 1]\ngains.R = [1, 9999]", "axes.gains.R = 9999: "),
        ("release = -0.5", "release [s] = -0.5: must be within the motion, 0 to"),
        (
            "[axes]\nfault = [{kind = 'encoder_lost', start = 50}]",
            "axes.fault = 'encoder_lost': encoder_lost s",
        ),
        (
            "[axes]\nfault = [{kind = 'encoder_lots', start = 0.1}]",
            "axes.fault.kind = 'encoder_lots': no such",
        ),
        (
            "[axes]\ngains.R = [0.0, 1.0]",
            "axes.gains.R = 0: R [-] of joint 'joint1' would be 0.0: must be at least",
        ),
        ("[axes]\ndrive.rotor_inertia = [1.0, 0.0]", "rotor_inertia"),
        ("[axes]\npose = ['low']\n[poses]\nlow = [0.0]", "must be 7 angles"),
        ("motion = 'nowhere.csv'", "no such file"),
        ("[axes]\nfault = [{kind = 'no_such_fault', start = 0.1}]", "fault"),
        ("[axes]\nfault = [{payload_at = [{time = 0.1}]}]", "mass"),
        ("[axes]\nfault = [{payload_at = [{time = 0.1, mass = -1}]}]", "mass [kg] = -1"),
        ("[axes]\nfault = [{payload_at = [{time = 9, mass = 1}]}]", "outside the trajectory"),
        ("[axes]\nfault = [{payload_at = [{time = 0.1, mass = 1, offset = [0, 0]}]}]", "[x, y, z]"),
        (
            "[axes]\nfault = [{kind = 'encoder_lost', joint = 'second', start = 0.1}]",
            "axes.fault.joint = 'second'",
        ),
        (
            "[requirements]\nerror_max = {max = 1.0, joint = 'joint9'}",
            "requirements.error_max.joint = 'joint9': no",
        ),
    ],
)
def test_what_cannot_be_simulated_is_refused_before_anything_runs(text, said):
    with pytest.raises(DashpotError, match=r"^[^\n]*$") as caught:
        Campaign(parse(text)).check()
    assert said in str(caught.value)


lengths = st.lists(st.integers(1, 7), min_size=1, max_size=4)


@given(lengths, st.one_of(st.none(), st.integers(1, 50)))
@settings(max_examples=150, deadline=None)
def test_chunks_are_runs_of_indices_that_tile_the_grid(shape, chunk):
    names = ("payload", "amplitude", "trajectory", "seed")[: len(shape)]
    axes = "\n".join(
        f"{name} = [{', '.join(map(str, range(n)))}]" for name, n in zip(names, shape, strict=True)
    )
    spec = parse(("" if chunk is None else f"chunk = {chunk}\n") + f"[axes]\n{axes}")
    assert spec.shape == tuple(shape)
    index = np.arange(spec.size).reshape(spec.shape)
    seen = []
    for k in range(spec.chunks):
        run = spec.chunk_indices(k)
        assert index[spec.chunk_region(k)].ravel().tolist() == list(run)
        assert 1 <= len(run) <= (chunk or CHUNK)
        seen += run
    assert sorted(seen) == list(range(spec.size))


@given(
    st.floats(1e-3, 1e3),
    st.floats(1.001, 1e3),
    st.floats(0, 1),
    st.booleans(),
)
@example(1e-3, 10.0, 1.0, False)
def test_a_range_maps_shares_in_order_and_stays_inside(low, ratio, share, log):
    kind = "log-uniform" if log else "uniform"
    spec = (
        parse(
            f"[axes]\npayload = {{low = {low!r}, high = {low * ratio!r}, distribution = '{kind}'}}",
            SAMPLED.format("sobol"),
        )
        if low * ratio <= 1e4
        else None
    )
    if spec is None:
        return
    axis = spec.axis("payload")
    assert low <= axis.at(share) <= axis.high
    assert axis.at(0.0) == low
    assert axis.at(share) <= axis.at(min(1.0, share + 0.1))
    middle = axis.at(0.5)
    assert middle == pytest.approx(math.sqrt(low * axis.high) if log else (low + axis.high) / 2)


AXES = "[axes]\npayload = {low = 0.0, high = 3.0}\n"
AXES += "drive.stiffness = {low = 0.8, high = 1.2, each_joint = true}\n"


@pytest.mark.parametrize("kind", ["sobol", "latin_hypercube"])
def test_a_sample_puts_one_point_into_every_part_of_every_axis(kind):
    points = parse(AXES, SAMPLED.format(kind)).points(7)
    assert points.shape == (32, 8)
    for column in points.T:
        assert sorted((column * 32).astype(int)) == list(range(32))
    other = parse(AXES, SAMPLED.format(kind).replace("seed = 4", "seed = 5")).points(7)
    assert not np.array_equal(points, other)


def test_scenarios_follow_from_the_specification_alone():
    text = AXES + "gains.kp = [0.9, 1.0]\npose = {random = 3}\nseed = [5, 6]\n"
    one, two = (Campaign(parse(text, SAMPLED.format("sobol"))) for _ in range(2))
    assert one.spec.dims == ("sample", "gains_kp", "pose", "seed")
    assert one.digest == two.digest
    far = pickle.loads(pickle.dumps(one))
    for index in (0, 7, one.spec.size - 1):
        a, b = one.scenario(index), far.scenario(index)
        assert one.values(index) == two.values(index) == far.values(index)
        np.testing.assert_array_equal(a.trajectory.position, b.trajectory.position)
        np.testing.assert_array_equal(a.plant.drives, b.plant.drives)
        np.testing.assert_array_equal(a.controller.blocks, b.controller.blocks)
        assert a.seed == b.seed == (5, 6)[index % 2]
    with pytest.raises(InputError, match="must be 0 to 383"):
        one.values(384)


def test_drive_errors_reach_the_plant_and_not_the_controller():
    text = "[axes]\ndrive.stiffness = [1.0, 1.25]\ndrive.joint2.torque_bias = [0.5]\n"
    campaign = Campaign(parse(text))
    nominal, off = campaign.scenario(0), campaign.scenario(1)
    np.testing.assert_array_equal(nominal.controller.blocks, off.controller.blocks)
    np.testing.assert_allclose(off.plant.drives["stiffness"], 1.25 * nominal.plant.drives["stiffness"])
    assert off.plant.drives["sensor_bias"].tolist() == [0, 0.5, 0, 0, 0, 0, 0]
    assert campaign.scenario(0).plant is nominal.plant  # built once


def test_gains_are_multiplied_for_all_joints_and_for_one():
    campaign = Campaign(parse("[axes]\ngains.R = [0.5]\ngains.joint3.R = [2.0]\ngains.kd = [0.25]\n"))
    given = campaign.configs["fr3"].joints
    scenario = campaign.values(0)
    made = campaign.config("fr3", [(k, v) for k, v in scenario.items() if k.startswith("gains.")]).joints
    for before, after in zip(given, made, strict=True):
        assert before.R * 0.5 * (2.0 if before.name == "joint3" else 1.0) == after.R
        assert after.kd == before.kd * 0.25
        assert (after.D, after.K, after.kp) == (before.D, before.K, before.kp)


def test_random_poses_lie_inside_the_ranges():
    campaign = Campaign(parse("[axes]\npose = {random = 200}\n"))
    poses = np.array([campaign.pose(f"random{i}") for i in range(200)])
    drives = campaign.scenario(0).plant.drives
    margin = np.minimum(0.4, (drives["stop_upper"] - drives["stop_lower"]) / 2)
    assert (poses >= np.maximum(drives["stop_lower"], -np.pi) + margin - 1e-12).all()
    assert (poses <= np.minimum(drives["stop_upper"], np.pi) - margin + 1e-12).all()
    assert (np.ptp(poses, axis=0) > 0.5 * (drives["stop_upper"] - drives["stop_lower"] - 2 * margin)).all()


@given(
    st.dictionaries(
        st.sampled_from(["payload", "offset", "pose", "gains", "drive", "fault", "seed"]),
        st.recursive(
            st.one_of(
                st.integers(-5, 5), st.floats(allow_nan=True), st.booleans(), st.text("ab1 .", max_size=3)
            ),
            lambda inner: st.one_of(
                st.lists(inner, max_size=3),
                st.dictionaries(st.sampled_from(["low", "high", "R", "kind", "random"]), inner, max_size=3),
            ),
            max_leaves=5,
        ),
    )
)
@settings(max_examples=200, deadline=None)
def test_any_axes_are_understood_or_refused(axes):
    from conftest import toml

    text = HEAD + "axes = " + toml(axes) if axes else HEAD
    spec = None
    with contextlib.suppress(InputError):  # whatever else comes is a traceback for the user
        spec = Spec.parse(text, None)
    if spec is not None:
        assert spec.size >= 1
        assert sorted(i for k in range(spec.chunks) for i in spec.chunk_indices(k)) == list(range(spec.size))


def test_a_campaigns_supervisor_goes_before_the_controllers_own(tmp_path):
    text = (files("dashpot") / "controllers" / "fr3.toml").read_text()
    (tmp_path / "law.toml").write_text("supervisor = { stop_time = 0.7, drift = 0.2 }\n" + text)
    head = 'robot = "fr3"\ncontroller = "law.toml"\nduration = 0.2\n'

    def settings_of(line):
        scenario = Campaign(Spec.parse(head + line, tmp_path / "spec.toml")).scenario(0)
        return scenario.supervisor

    assert settings_of("") is None
    assert settings_of("supervisor = true") == SupervisorSettings(stop_time=0.7, drift=0.2)
    both = settings_of("supervisor = { drift = 0.3 }")
    assert both == SupervisorSettings(stop_time=0.7, drift=0.3)


def test_a_robot_carries_its_weight_where_its_file_says_so_unless_told_not_to():
    for robot, controller, has in (("fr3", "fr3", True), ("k807", "k807-wrist", False)):
        head = f'robot = "{robot}"\ncontroller = "{controller}"\nduration = 0.2\n'
        assert Campaign(Spec.parse(head, None)).scenario(0).carried is has
        off = Campaign(Spec.parse(head + "gravity_compensation = false", None)).scenario(0)
        assert not off.carried
    with pytest.raises(InputError, match="gravity_compensation = 'yes': must be true or false"):
        Spec.parse(head + 'gravity_compensation = "yes"', None)


def test_a_requirement_allows_what_keeps_its_bounds():
    bound, among = Requirement("travel", high=0.5), Requirement("supervisor_state", among=(2.0, 3.0))
    assert [bound.allows(value) for value in (0.5, 0.51, math.nan)] == [True, False, False]
    assert [among.allows(value) for value in (2.0, 1.0, math.nan)] == [True, False, False]
