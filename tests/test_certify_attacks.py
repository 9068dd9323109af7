"""Hostile joints, blocks, boxes and files against the certificate: it may refuse, never pass or break."""

from __future__ import annotations

import json
import math
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dashpot.arm.drive import Drive
from dashpot.arm.plant import build
from dashpot.arm.robot import Robot
from dashpot.certify.box import Box, at, certify_box
from dashpot.certify.counterexample import counterexample
from dashpot.certify.exact import at_rest, crossings, quadratic_form, storage
from dashpot.certify.index import passivity_index
from dashpot.certify.joint import Scales, sampled_joint
from dashpot.certify.loads import Load, radii
from dashpot.certify.port import lift
from dashpot.certify.testbench import write as write_bench
from dashpot.cli import main
from dashpot.control.controller import ControllerConfig, JointGains
from dashpot.control.sampled import (
    IN_EFFECT,
    POSITION,
    TORQUE,
    VELOCITY,
    VirtualPassive,
    add_position_loop,
    empty_block,
    pd_block,
    virtual_passive_block,
)
from dashpot.errors import InputError, InputWarning

H = 0.005


def drive_of(m=0.05, v=0.6, k=6e3, c=0.7, **other):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)  # unusual on purpose
        return Drive(
            "w", rotor_inertia=m, viscous_friction=v, stiffness=k, damping=c, torque_limit=40, **other
        )


WRIST = drive_of()


def law(drive, form, R, D, K=0.0, kp=0.0, kd=0.0, period=H, latency=0):
    gains = VirtualPassive(R, D, K, drive.rotor_inertia, drive.viscous_friction)
    block = add_position_loop(virtual_passive_block(gains, period, form), kp, kd)
    block["latency"] = latency
    return block


def resonator(angle, distance, gain):
    """A block pole at `distance` from the unit circle, driven by the torque sample with `gain` (2,)."""
    block = empty_block()
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    block["A"][:2, :2], block["B"][:2, TORQUE], block["C"][0] = (1 - distance) * turn, gain, 1.0
    block["nx"] = 2
    return block


def leak(kp, kd, distance, from_torque, from_velocity):
    """PD and a very slow first-order state beside it."""
    block = pd_block(kp, kd)
    block["A"][0, 0], block["C"][0], block["nx"] = 1 - distance, 1.0, 1
    block["B"][0, TORQUE], block["B"][0, VELOCITY] = from_torque, from_velocity
    return block


def least(joint, intervals=16):
    """Upper bound of the index: lifted port on a grid that is dense around every pole of the held joint."""
    port = lift(joint, intervals)
    angles = [np.geomspace(1e-5, 0.1, 60), np.linspace(0.1, np.pi, 100)]
    around = np.concatenate([-np.geomspace(1e-2, 100, 25), [0], np.geomspace(1e-2, 100, 25)])
    for pole in np.linalg.eigvals(port.A):
        if abs(pole) > 0.5:
            angles.append(abs(np.angle(pole)) + max(1 - abs(pole), 1e-9) * around)
    grid = np.concatenate(angles)
    return float(port.least_damping(grid[(grid >= 1e-5) & (grid <= np.pi)]).min())


def sane(found):
    """No NaN, and a reason wherever there is no verdict."""
    assert not np.isnan([found.value, found.frequency, found.remainder]).any()
    assert found.decided or found.reason
    assert math.isfinite(found.value) or found.reason


# Joints on which the load named does oscillate.
FILTERED = drive_of(0.35, 0.65, 9.4e4, 2.5e-4, sensor_bandwidth=33.0, sensor_damping=0.034)
RINGING = drive_of(0.06, 0.02, 4.3e4, 1.12e-3, sensor_bandwidth=12.9, sensor_damping=0.0016)
SHARP = drive_of(0.736, 0.343, 7200.0, 2.14e-3, sensor_bandwidth=18.9, sensor_damping=1e-4)
SLACK = drive_of(0.804, 0.2325, 69936.0, 0.01012)
OSCILLATING = {
    "sensor filter at 33 Hz, grows twofold in 0.6 s": (
        FILTERED,
        law(FILTERED, "explicit", 0.015, 0.37, period=2e-4, latency=1),
        "average",
        2e-4,
        Load("inertia and spring", 0.0299, 2.03e4),
    ),
    "point samples behind a lightly damped filter": (
        RINGING,
        law(RINGING, "implicit", 3.4e-4, 8.3, latency=1),
        "point",
        H,
        Load("inertia and spring", 0.00513, 430.0),
    ),
    "sensor filter all but undamped": (
        SHARP,
        law(SHARP, "implicit", 8.9e-5, 1.24, period=1e-3, latency=2),
        "average",
        1e-3,
        Load("inertia", 1.72),
    ),
    "high gain": (
        WRIST,
        law(WRIST, "explicit", 10, 3, 1.0),
        "average",
        H,
        Load("inertia", 0.0268),
    ),
    "position loop": (
        WRIST,
        law(WRIST, "explicit", 1, 1, 1.0, 60, 1),
        "average",
        H,
        Load("inertia", 0.509),
    ),
}


@pytest.mark.parametrize("name", OSCILLATING)
def test_the_loads_do_oscillate(name):
    drive, block, sampling, period, load = OSCILLATING[name]
    joint = sampled_joint(drive, block, sampling, period)
    assert radii(joint, np.array([load.inertia]), np.array([load.stiffness]))[0] > 1 + 1e-7


@pytest.mark.parametrize("name", OSCILLATING)
def test_a_joint_that_a_load_makes_oscillate_never_passes(name):
    drive, block, sampling, period, _ = OSCILLATING[name]
    assert not passivity_index(drive, block, sampling, period).passive


@pytest.mark.parametrize("name", OSCILLATING)
def test_nor_does_a_box_around_it(name):
    drive, block, sampling, period, _ = OSCILLATING[name]
    assert not certify_box(drive, block, sampling, period).proven


NARROW = {
    "resonance 1.6e-6 from the circle": (
        SLACK,
        resonator(0.00786, 1.41e-6, [-4.5594611964e-7, 1.9480589754e-6]),
    ),
    "slow state beside the position loop": (
        drive_of(0.2106, 0.2598, 1082.0, 0.02378),
        leak(21.7635, 0.00162, 1.367e-8, 8e-13, 3.1644e-8),
    ),
}


@pytest.mark.parametrize("name", NARROW)
def test_dips_narrower_than_any_grid_are_not_passed(name):
    drive, block = NARROW[name]
    joint = sampled_joint(drive, block, "average", H)
    dip = {2: 0.007861, 1: 2e-8}[int(block["nx"])]
    near = dip * np.linspace(0.9985, 1.0015, 61)
    assert (
        np.median(lift(joint, 4).least_damping(near)) < 0 or lift(joint, 4).least_damping(near).min() < -0.1
    )
    assert not passivity_index(drive, block, "average", H).passive


def test_no_storage_function_where_the_form_is_singular():
    """What the proof over a box rests on: a solution of the Riccati equation by accident is none."""
    drive, block, sampling, period, _ = OSCILLATING["sensor filter all but undamped"]
    joint = sampled_joint(drive, block, sampling, period)
    rest, accepted = at_rest(joint), 0
    for level in -np.geomspace(1e-6, 1e-1, 40):
        form = quadratic_form(joint, level, rest)
        if form is not None and len(crossings(form)):
            accepted += storage(form) is not None
    assert accepted == 0


@pytest.mark.parametrize("distance", [1e-3, 1e-5, 1e-7, 1e-8])
@pytest.mark.parametrize("angle", [0.05, 0.5, 2.0])
def test_sharp_resonances_of_the_block(angle, distance):
    """Wherever it passes, a scan around the pole agrees."""
    for size in (0.02, 1.0):
        for phase in (0.0, 1.5, 3.0, 4.5):
            gain = size * distance * np.array([math.cos(phase), math.sin(phase)])
            block = resonator(angle, distance, gain)
            found = passivity_index(WRIST, block, "average", H)
            sane(found)
            if found.passive:
                assert least(sampled_joint(WRIST, block, "average", H)) > 0.99 * found.value


@pytest.mark.parametrize("k", [1e3, 1e6, 1e8])
@pytest.mark.parametrize("c", [1e-6, 1e-3, 1.0])
def test_sharp_resonances_of_the_drive(k, c):
    drive = drive_of(k=k, c=c, v=1e-3)
    for block in (empty_block(), law(drive, "implicit", 0.1, 1.0), law(drive, "explicit", 0.5, 0.1)):
        found = passivity_index(drive, block, "average", 1e-3)
        sane(found)
        if found.passive:
            assert least(sampled_joint(drive, block, "average", 1e-3)) > 0.98 * found.value


def test_the_index_of_a_drive_without_friction_is_not_overstated():
    """At low frequency nothing is left of the damping."""
    drive = drive_of(0.1, 1e-8, 1e4, 1e-4)
    found = passivity_index(drive, empty_block(), "average", H)
    sane(found)
    assert found.value <= 1.01 * least(sampled_joint(drive, empty_block(), "average", H)) + 1e-7 * 1e-4


def test_counterexamples_are_not_rounding_errors():
    """A heavy load on a joint without a position loop has two eigenvalues at 1, found to half the digits."""
    for drive in (WRIST, drive_of(v=0.0), drive_of(c=0.0), drive_of(v=0.0, c=0.0)):
        assert counterexample(sampled_joint(drive, empty_block(), "average", H), drive) is None


CORNERS = [
    (m, v, k, c, period)
    for m in (1e-9, 1e3)
    for v in (0.0, 1e4)
    for k in (1e-6, 1e8)
    for c in (0.0, 1e-12, 1e5)
    for period in (1e-5, 1.0)
]


@pytest.mark.parametrize("controlled", [False, True])
def test_drives_at_their_limits(controlled):
    """All corners of what a file may say: a verdict or a refusal, no breakdown."""
    failed = []
    for m, v, k, c, period in CORNERS:
        drive = drive_of(m, v, k, c)
        block = law(drive, "implicit", 1, 1, period=period) if controlled else empty_block()
        try:
            sane(passivity_index(drive, block, "average", period))
        except InputError:
            pass
        except (RuntimeWarning, np.linalg.LinAlgError, ValueError) as error:
            failed.append((m, v, k, c, period, str(error)))
    assert not failed


@pytest.mark.parametrize("R", [1e-6, 1e4])
@pytest.mark.parametrize("D", [1e-9, 1e6])
@pytest.mark.parametrize("K", [0.0, 1e-12, 1e7])
def test_gains_at_their_limits(R, D, K):
    loads = np.geomspace(1e-4, 10, 30), np.repeat([0.0, 100.0, 6e3], 10)
    for form in ("implicit", "explicit"):
        for kp, kd in ((0.0, 0.0), (1e-12, 0.0), (1e7, 1e6), (0.0, 1e-9)):
            block = law(WRIST, form, R, D, K, kp, kd, latency=1)
            found = passivity_index(WRIST, block, "average", H)
            sane(found)
            if found.passive:
                assert radii(sampled_joint(WRIST, block, "average", H), *loads).max() < 1 + 1e-7


@pytest.mark.parametrize("bandwidth", [1e-3, 30.0, 1e6])
@pytest.mark.parametrize(("order", "damping"), [(1, 0.8), (2, 1e-6), (2, 10.0)])
def test_sensor_filters_at_their_limits(bandwidth, order, damping):
    drive = drive_of(sensor_bandwidth=bandwidth, sensor_order=order, sensor_damping=damping)
    for sampling in ("average", "point"):
        found = passivity_index(drive, law(drive, "implicit", 1, 3.0), sampling, H)
        sane(found)
        if found.passive:
            joint = sampled_joint(drive, law(drive, "implicit", 1, 3.0), sampling, H)
            assert least(joint) > 0.98 * found.value


@pytest.mark.parametrize("latency", [0, 1, 16])
@pytest.mark.parametrize("samples", [0, 1, 18])
def test_long_delays(latency, samples):
    drive = drive_of(torque_latency=samples * H)
    block = law(drive, "explicit", 0.1, 3.0, latency=latency)
    found = passivity_index(drive, block, "average", H)
    sane(found)
    if found.passive:
        assert least(sampled_joint(drive, block, "average", H)) > 0.98 * found.value
    with pytest.raises(InputError, match="whole ones"):
        passivity_index(drive_of(torque_latency=(samples + 0.4) * H), block, "average", H)


PLACES = {
    "A": ("A", (0, 0)),
    "B": ("B", (0, TORQUE)),
    "C": ("C", 0),
    "D": ("D", TORQUE),
    "own torque": ("D", IN_EFFECT),
}
ABSURD = [(place, value) for value in (1e-300, 5e-324, 1e300, -1e308, math.inf, math.nan) for place in PLACES]


@pytest.mark.parametrize(("place", "value"), ABSURD)
@pytest.mark.parametrize("box", [False, True])
def test_absurd_coefficients(place, value, box):
    """A hand-made block with one absurd coefficient is judged or refused, in words."""
    block, (key, where) = law(WRIST, "implicit", 3, 3, 1.0), PLACES[place]
    block[key][where] = value
    try:
        found = (certify_box if box else passivity_index)(WRIST, block, "average", H)
    except InputError:
        return
    sane(found.worst if box else found)
    assert math.isfinite(value)


@pytest.mark.parametrize("pole", [1.0, -1.0, 1 + 1e-12, 2.0])
def test_unstable_states_that_nobody_sees_are_refused(pole):
    """They grow in the controller's memory whatever the joint does."""
    block = law(WRIST, "implicit", 3, 3, 1.0)
    block["A"][2, 2], block["nx"] = pole, 3
    found = passivity_index(WRIST, block, "average", H)
    assert not found.passive
    assert found.reason
    block["B"][2, TORQUE] = 1.0
    assert not passivity_index(WRIST, block, "average", H).passive


@pytest.mark.parametrize("pole", [0.0, 0.5, -0.99, 1 - 1e-4])
@pytest.mark.parametrize("seen", ["neither", "driven", "heard"])
def test_stable_states_that_do_nothing_change_nothing(pole, seen):
    block = law(WRIST, "explicit", 6, 3, 1.0, 10.0, 1.0)
    plain = passivity_index(WRIST, block, "average", H)
    block["A"][2, 2], block["nx"] = pole, 3
    if seen == "driven":
        block["B"][2, TORQUE] = 1.0
    elif seen == "heard":
        block["C"][2] = 1.0
    found = passivity_index(WRIST, block, "average", H)
    assert found.decided
    assert found.value == pytest.approx(plain.value, rel=2e-3)


def test_a_very_slow_state_that_does_nothing_leaves_the_size_of_the_index():
    """Whether it can be decided or not."""
    block = law(WRIST, "explicit", 6, 3, 1.0, 10.0, 1.0)
    block["A"][2, 2], block["nx"] = 1 - 1e-6, 3
    found = passivity_index(WRIST, block, "average", H)
    assert -math.inf <= found.value <= WRIST.damping
    assert found.value == -math.inf or found.value > -1e3


def test_a_pole_and_a_zero_that_nearly_cancel():
    block = law(WRIST, "implicit", 3, 3)
    plain = passivity_index(WRIST, block, "average", H)
    block["A"][1, 1], block["B"][1, TORQUE], block["C"][1], block["nx"] = 0.999, 1e-9, 1e-3, 2
    found = passivity_index(WRIST, block, "average", H)
    assert found.decided
    assert found.value == pytest.approx(plain.value, rel=5e-3)


def test_an_integrator_of_position_is_refused():
    block = pd_block(10.0, 1.0)
    block["A"][0, 0], block["B"][0, POSITION], block["C"][0], block["nx"] = 1.0, -0.01, 1.0, 1
    assert not passivity_index(WRIST, block, "average", H).passive


@pytest.mark.parametrize("gain", [0.9, 0.999999, 1.0, 1.000001, 2.0, -1.0])
def test_torque_gains_that_all_but_cancel_the_load(gain):
    """u = gain tau: the motor carries the transmitted torque itself."""
    block = empty_block()
    block["D"][TORQUE] = gain
    found = passivity_index(WRIST, block, "average", H)
    sane(found)
    if found.passive:
        inertia = np.geomspace(1e-4, 10, 60)
        joint = sampled_joint(WRIST, block, "average", H)
        assert radii(joint, inertia, np.zeros(60)).max() < 1 + 1e-7
        assert least(joint) > 0.98 * found.value


@pytest.mark.parametrize("kp", [1e-12, 1e-6, 1e-3, 1.0, 100.0])
def test_position_loops_weak_and_strong(kp):
    """Without velocity gain, and pushing away."""
    for drive in (WRIST, drive_of(v=0.0), drive_of(v=5.0)):
        found = passivity_index(drive, pd_block(kp, 0.0), "average", H)
        sane(found)
        if found.passive:
            assert least(sampled_joint(drive, pd_block(kp, 0.0), "average", H)) > 0.98 * found.value
        assert not passivity_index(drive, pd_block(-kp, 1e-3), "average", H).passive


@settings(max_examples=25, deadline=None)
@given(
    scale=st.floats(1e-2, 1e2),
    slower=st.floats(0.2, 5),
    R=st.floats(0.1, 8),
    D=st.floats(0.3, 10),
    K=st.sampled_from([0.0, 0.5]),
    loop=st.sampled_from([(0.0, 0.0), (10.0, 1.0)]),
    form=st.sampled_from(["implicit", "explicit"]),
)
def test_units_do_not_matter(scale, slower, R, D, K, loop, form):
    """Torque and time in other units scale the index with the position loop and the sensor filter too."""
    plain = drive_of(sensor_bandwidth=60.0)
    other = drive_of(
        0.05 * scale * slower, 0.6 * scale, 6e3 * scale / slower, 0.7 * scale, sensor_bandwidth=60 / slower
    )
    kp, kd = loop
    reference = passivity_index(plain, law(plain, form, R, D, K, kp, kd), "average", H)
    block = law(
        other, form, R, D * scale, K * scale / slower, kp * scale / slower, kd * scale, period=H * slower
    )
    found = passivity_index(other, block, "average", H * slower)
    assert found.passive == reference.passive
    assert found.value == pytest.approx(scale * reference.value, rel=3e-3, abs=1e-6 * scale)


@settings(max_examples=15, deadline=None)
@given(
    friction=st.floats(0, 100), latency=st.integers(0, 4), R=st.floats(0.1, 5), kp=st.sampled_from([0, 10])
)
def test_link_friction_adds_and_latencies_agree(friction, latency, R, kp):
    block = law(WRIST, "implicit", R, 3.0, 1.0, kp, kp / 10)
    late = block.copy()
    late["latency"] = latency
    plain = passivity_index(WRIST, block, "average", H, Scales(latency=latency))
    assert passivity_index(WRIST, late, "average", H).value == pytest.approx(plain.value, rel=1e-6)
    with_friction = passivity_index(replace(WRIST, link_friction=friction), late, "average", H)
    assert with_friction.value == pytest.approx(plain.value + friction, rel=1e-6)


@pytest.mark.parametrize(
    ("form", "R", "D", "kp"), [("explicit", 6, 3, 0), ("explicit", 10, 3, 0), ("implicit", 3, 3, 30)]
)
def test_a_box_without_width_is_the_joint(form, R, D, kp):
    block = law(WRIST, form, R, D, 1.0, kp, kp / 15)
    found, nominal = certify_box(WRIST, block, "average", H), passivity_index(WRIST, block, "average", H)
    assert found.proven == nominal.passive
    assert found.worst == nominal


@pytest.mark.parametrize("width", [0.05, 0.3, 0.99])
@pytest.mark.parametrize(("form", "R", "D", "kp"), [("explicit", 4, 3, 0), ("implicit", 1, 6, 20)])
def test_points_inside_a_proven_box_are_passive(form, R, D, kp, width):
    uncertainty = dict.fromkeys(("rotor_inertia", "viscous_friction", "stiffness", "damping"), width)
    drive = replace(WRIST, uncertainty=uncertainty, torque_gain_error=width / 10)
    block = law(drive, form, R, D, 1.0, kp, kp / 10)
    found = certify_box(drive, block, "average", H)
    assert found.proven or found.reason or found.worst.value <= 0
    rng, box = np.random.default_rng(1), Box.of(drive, block)
    for _ in range(15):
        point = {name: float(rng.choice([*ends, rng.uniform(*ends)])) for name, ends in box.ranges.items()}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", InputWarning)
            index = passivity_index(*at(drive, point)[:1], block, "average", H, at(drive, point)[1])
        if found.proven:
            assert index.value > 0
            assert index.value > 0.9 * found.worst.value


def test_a_window_between_the_corners():
    """Friction compensation tuned to the middle: the box may only pass where every latency does."""
    drive = replace(WRIST, uncertainty={"rotor_inertia": 0.8}, torque_gain_error=0.2)
    for R in (5, 7, 9):
        block = law(drive, "explicit", R, 3, 1.0)
        found = certify_box(drive, block, "average", H, latency_max=1)
        if not found.proven:
            continue
        for inertia in np.linspace(0.2, 1.8, 9) * 0.05:
            for latency in (0, 1):
                there = replace(drive, rotor_inertia=float(inertia), uncertainty={})
                index = passivity_index(there, block, "average", H, Scales(latency=latency))
                assert index.value > 0


def test_no_transmission_damping_at_all_is_not_proven():
    drive = replace(drive_of(c=0.0), uncertainty={"stiffness": 0.1, "damping": 0.9})
    found = certify_box(drive, empty_block(), "average", H)
    assert not found.proven


NAMES = ("[red]x[/red]", "a/b c", "ü ☃/..")


def robot_file(write, names):
    joints = [
        {
            "name": name,
            "rotor_inertia": 0.05,
            "viscous_friction": 0.6,
            "stiffness": 6e3,
            "damping": 0.7,
            "torque_limit": 40.0,
        }
        for name in names
    ]
    return write({"name": "arm", "home": [0.0] * len(names), "joint": joints}, "robot.toml")


def controller_file(write, joints, **other):
    settings = {"period": H, "form": "explicit", **other}
    return write({**settings, "joint": [{"name": n, "R": R, "D": D} for n, R, D in joints]}, "law.toml")


def run(*arguments):
    with pytest.raises(SystemExit) as caught:
        main([str(argument) for argument in arguments])
    return caught.value.code


def strict(text):
    def refuse(word):
        raise AssertionError(word)

    return json.loads(text, parse_constant=refuse)


def test_strange_names_in_the_command(write, capsys):
    controller = controller_file(write, [(NAMES[0], 10.0, 3.0), (NAMES[1], 1.0, 1.0), (NAMES[2], 3.0, 3.0)])
    assert run("certify", robot_file(write, NAMES), controller, "--json") == 1
    table = strict(capsys.readouterr().out)
    assert not table["certified"]
    assert [row["name"] for row in table["joints"]] == list(NAMES)
    assert [row["certified"] for row in table["joints"]] == [False, True, True]
    keys = {"name", "index", "worst_index", "frequency_hz", "certified", "counterexample"}
    assert all(keys <= row.keys() for row in table["joints"])
    assert table["joints"][0]["counterexample"]["growth_per_s"] > 0


def test_sixteen_joints_pass_with_status_0(write, capsys):
    names = [f"j{i}" for i in range(16)]
    controller = controller_file(write, [(name, 1.0, 1.0) for name in names])
    assert run("certify", robot_file(write, names), controller, "--json") == 0
    assert strict(capsys.readouterr().out)["certified"]


def test_an_unstable_joint_is_strict_json(write, capsys):
    """Its index is minus infinity."""
    joint = {"name": "a", "R": 1.0, "D": 1.0, "kp": 1e5, "kd": 1e4}
    controller = write({"period": H, "joint": [joint]}, "law.toml")
    assert run("certify", robot_file(write, ["a"]), controller, "--json") == 1
    row = strict(capsys.readouterr().out)["joints"][0]
    assert row["index"] == -sys.float_info.max
    assert "unstable" in row["reason"]


def test_wrong_joints_and_folders_are_refused(write, tmp_path, capsys):
    robot = robot_file(write, ["a"])
    assert run("certify", robot, controller_file(write, [("b", 1.0, 1.0)]), "--json") == 2
    assert "no such joint" in capsys.readouterr().err
    controller = controller_file(write, [("a", 1.0, 1.0)])
    blocked = tmp_path / "file"
    blocked.touch()
    for out in (blocked, blocked / "below"):
        assert run("certify", robot, controller, "--json", "--out", out) == 2
        assert "--out" in capsys.readouterr().err


@pytest.mark.parametrize(
    "names",
    [
        ("a", "b"),
        ("a b", "a/b"),
    ],
)
def test_every_refused_joint_has_its_own_bench(write, tmp_path, monkeypatch, names):
    monkeypatch.setattr("dashpot.support.plots.save", lambda figure, path: None)
    monkeypatch.setattr("dashpot.certify.plots.draw", lambda *_: None)
    controller = controller_file(write, [(name, 10.0, 3.0) for name in names])
    out = tmp_path / "out"
    assert run("certify", robot_file(write, names), controller, "--json", "--out", out) == 1
    benches = sorted(out.rglob("robot.toml"))
    assert sorted(Robot.load(bench).joints[0] for bench in benches) == sorted(names)
    for bench in benches:
        build(Robot.load(bench), ControllerConfig.load(Path(bench).with_name("controller.toml")).period)


@pytest.mark.parametrize(
    "name",
    [
        "[red]x[/red]",
        "a/b c",
        "ü ☃",
        'q"&<>\\',
        "two\nlines",
    ],
)
@pytest.mark.parametrize(
    "load",
    [
        Load("inertia", 1e-7),
        Load("inertia", 1e5),
        Load.pendulum(0.05, 0.03),
        Load("inertia and spring", 1, 9),
    ],
)
def test_benches_can_be_built(tmp_path, name, load):
    config = ControllerConfig(joints=(JointGains(name, R=3.0, D=3.0),), period=H)
    robot, controller = write_bench(
        tmp_path / "bench", load, replace(WRIST, name=name), config.joints[0], config
    )
    assert ControllerConfig.load(controller).joints[0].name == name
    build(Robot.load(robot), H)
