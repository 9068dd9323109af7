"""Design: predictions against simulation and exact loops, the search against chance, refusals in words."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dashpot.arm.robot import Robot
from dashpot.certify.certificate import certify_joint, paired
from dashpot.certify.joint import sampled_joint
from dashpot.certify.loads import loops
from dashpot.control.controller import Controller, JointGains
from dashpot.design import candidates as quantity
from dashpot.design.candidates import Duty, Gains
from dashpot.design.carried import carried
from dashpot.design.conflicts import conflict
from dashpot.design.design import design_joint, duties
from dashpot.design.motion import move
from dashpot.design.prover import NO_FRICTION
from dashpot.design.search import CORNER, COSTLY, KD, RATIO, ZETA, G, JointSearch
from dashpot.design.spec import Spec
from dashpot.design.wishes import LIMITS, PRESETS, Wishes
from dashpot.errors import InputError, InputWarning
from dashpot.studies.designs import off, predicted
from dashpot.studies.designs_bench import stop
from dashpot.studies.designs_cases import random_duty

CHEAP = Wishes("error_ratio", authority=0.9, noise=0.01, margin=0.1)
"""A brake's wish that needs no motion."""


def wrist(**changes):
    """Duty of a K-807i class wrist joint at 200 Hz."""
    drive = Robot.load("k807").drives[4]
    duty = Duty(drive, 0.005, 0, 0, "average", "implicit", 0.1, 0.3, 2.0, 0.5, 0.05, 0.02)
    return replace(duty, **changes)


def filtered(**changes):
    """Duty of an fr3 wrist joint at 1 kHz."""
    drive = Robot.load("fr3").drives[6]
    duty = Duty(drive, 0.001, 0, 0, "point", "implicit", 0.02, 0.05, 1.0, 0.5, 0.05, 0.02)
    return replace(duty, **changes)


def one(R, D, K=0.0, kp=0.0, kd=0.0):
    return Gains(*(np.array([float(value)]) for value in (R, D, K, kp, kd)))


@given(
    g=st.floats(0.1, 100),
    corner=st.floats(1, 1000),
    v=st.just(0.0) | st.floats(1e-3, 20),
    m=st.floats(0.01, 5),
)
@settings(deadline=None)
def test_static_gain_and_corner_are_those_of_the_law(g, corner, v, m):
    duty = wrist(drive=replace(wrist().drive, rotor_inertia=m, viscous_friction=v))
    gains = Gains.of(duty.drive, np.array([g]), np.array([corner]), np.array([math.inf]), 0.0, 0.0)
    R, D = gains.R[0], gains.D[0]
    a = R * v + D
    assert R * a / D == pytest.approx(g, rel=4e-3)  # gains carry four digits
    assert (D + R * a) / (R * m) == pytest.approx(corner, rel=4e-3)
    assert quantity.static_gain(duty, gains)[0] == pytest.approx(R * a / D)
    assert quantity.error_ratio(duty, gains)[0] == pytest.approx(D / (R * a))


@given(e=st.floats(-0.05, 0.05), R=st.floats(0.1, 15), K=st.sampled_from([0.0, 3.0]))
@settings(deadline=None)
def test_a_torque_channel_error_acts_inside_the_static_loop(e, R, K):
    """1 - C(0)(1 + e) is what is left of a load: compared with the block at rest, sample scaled."""
    duty = wrist(torque_gain=1 + e)
    gains = one(R, 8.0, K)
    block = duty.blocks(gains)[0]
    nx = int(block["nx"])
    A, B, C = block["A"][:nx, :nx], block["B"][:nx, 0], block["C"][:nx]
    at_rest = float(C @ np.linalg.solve(np.eye(nx) - A, B) + block["D"][0]) * (1 + e)
    expected = at_rest / (1 - at_rest) if at_rest < 1 else math.inf
    assert quantity.static_gain(duty, gains)[0] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("number", [0, 2, 4, 9])
@pytest.mark.parametrize("spring", [False, True])
def test_a_stop_goes_as_in_the_simulator(number, spring):
    duty = random_duty(7, number)
    duty = replace(duty, drive=replace(duty.drive, torque_noise=0.0))
    v = duty.drive.viscous_friction
    zeta = np.array([1.0 if spring else math.inf])
    gains = Gains.of(duty.drive, np.array([6.0]), np.array([120.0]), zeta, 0.0, 0.0)
    assert gains.R[0] * v + gains.D[0] < duty.drive.torque_limit / duty.speed
    _, seen = stop(duty, gains.joint(duty.drive.name), 0)
    assert quantity.stop_time(duty, gains)[0] == pytest.approx(seen, rel=0.05)


def test_many_joints_move_as_each_does_alone():
    duty = wrist(latency=1, latency_max=1)
    gains = Gains.of(duty.drive, np.geomspace(1, 30, 5), np.geomspace(10, 90, 5), np.array([0.7]), 0.0, 0.0)
    means = {"speed": 0.5, "duration": 0.6, "load": 1.0}
    together = move(duty.drive, duty.blocks(gains), "average", 0.005, 0.3, **means)
    for i in range(5):
        alone = move(duty.drive, duty.blocks(gains[[i]]), "average", 0.005, 0.3, **means)
        assert together.speed[:, i] == pytest.approx(alone.speed[:, 0], abs=1e-12)
    assert (np.abs(together.command) <= duty.drive.torque_limit).all()


def test_what_moves_evenly_goes_on_evenly():
    """A joint that creeps is not simulated to the end; its speed is that of the closed form."""
    duty = wrist(load=6.0)
    gains = one(3.0, 6.0)
    motion = move(duty.drive, duty.blocks(gains), "average", 0.005, 0.3, speed=0.5, duration=8.0, load=6.0)
    assert motion.speed[-1, 0] == pytest.approx(quantity.creep(duty, gains)[0], rel=2e-3)


@given(rate=st.floats(5, 100), level=st.floats(0.01, 0.5))
@settings(deadline=None)
def test_the_time_to_stop_of_a_decay_is_its_logarithm(rate, level):
    time = np.arange(0, 2, 0.001)
    speed = np.exp(-rate * time)[:, None]
    found = quantity.stopped(time, speed, level)[0]
    assert found == pytest.approx(-math.log(level) / rate, abs=1e-4)
    assert quantity.stopped(time, speed + 1.0, level)[0] == math.inf


@pytest.mark.parametrize(("K", "kp", "kd"), [(0.0, 0.0, 0.0), (4.0, 0.0, 0.0), (0.0, 40.0, 3.0)])
def test_noise_is_that_of_the_native_controller(K, kp, kd):
    drive = replace(wrist().drive, torque_noise=0.1, position_resolution=2e-4, torque_limit=4e3)
    duty = wrist(drive=drive, latency=1)
    gains = one(4.0, 9.0, K, kp, kd)
    controller = Controller(duty.blocks(gains), ["joint"], duty.period)
    rng, n = np.random.default_rng(0), 60_000
    torque = rng.normal(0, drive.torque_noise, n)
    position = rng.uniform(-0.5, 0.5, n) * drive.position_resolution
    velocity = np.diff(position, prepend=0.0) / duty.period
    inputs, out, command = np.zeros((7, 1)), np.zeros(1), np.empty(n)
    for k in range(n):
        inputs[:3, 0] = torque[k], position[k], velocity[k]
        controller.step(inputs, out)
        command[k] = out[0]
    expected = quantity.noise(duty, gains)[0] * drive.torque_limit
    assert command[500:].std() == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize("K", [0.0, 5.0])
def test_the_damping_ratio_is_that_of_the_exact_loop(K):
    """Stiff transmission, fast sampling: the slowest oscillation of the loop with the link as load."""
    drive = replace(wrist().drive, stiffness=4e5, damping=60.0)
    duty = wrist(drive=drive, period=2e-4, inertia=0.3)
    gains = one(5.0, 8.0, K, 30.0, 1.0)
    joint = sampled_joint(drive, duty.blocks(gains)[0], "average", duty.period)
    values = np.linalg.eigvals(loops(joint, np.array([0.3]), np.array([0.0]))[0]).astype(complex)
    slow = np.log(values[np.abs(values) > 0.8]) / duty.period
    slow = slow[(np.abs(slow) < 200) & (slow.imag > 1e-3)]
    assert len(slow)
    expected = (-slow.real / np.abs(slow)).min()
    assert quantity.damping_ratio(duty, gains)[0] == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize("preset", ["brake", "track", "gentle"])
def test_designs_are_certified_and_keep_their_limits(preset):
    duty, wishes, loop = filtered(), PRESETS[preset], preset != "brake"
    first = design_joint(duty, wishes, loop)
    assert first.found is not None
    gains = first.found.gains.joint(duty.drive.name)
    verdict = certify_joint(duty.drive, gains, duty.config((gains,)))
    assert verdict.certified
    assert verdict.brake is None or verdict.brake.proven
    assert verdict.margin >= wishes.margin * 0.999
    for name, limit in wishes.limits.items():
        if name in first.assured:
            worse = -1 if name in ("damping_ratio",) else 1
            assert worse * first.assured[name] <= worse * limit * (1 + 1e-9), name
    assert (gains.kp > 0) == loop


def test_the_search_is_deterministic():
    found = [JointSearch(wrist(), CHEAP, False).run() for _ in range(2)]
    assert found[0] is not None
    assert found[1] is not None
    assert found[0].gains.joint("x") == found[1].gains.joint("x")


@pytest.mark.parametrize(
    ("duty", "wishes", "loop"), [(wrist(), CHEAP, False), (filtered(), PRESETS["track"], True)]
)
def test_chance_finds_nothing_better(duty, wishes, loop):
    search = JointSearch(duty, wishes, loop)
    found = search.run()
    assert found is not None
    rng, n = np.random.default_rng(1), 3000
    points = np.zeros((n, 5))
    for axis in (G, CORNER, RATIO, KD):
        points[:, axis] = rng.uniform(*search.range(axis), n)
    points[:, ZETA] = rng.choice([math.inf, 0.7, 1.0, 2.0], n)
    gains = search.gains(points)
    good = np.ones(n, bool)
    for name in sorted(wishes.limits, key=COSTLY.index):
        good[good] = search.kept(name, gains[good])
    assert good.any()
    merit = np.full(n, np.inf)
    merit[good] = search.merit(gains[good])
    better = np.flatnonzero(merit < found.merit - 0.03)
    assert not [i for i in better if search.certain(points[i])]


def test_limits_that_meet_between_the_points_of_the_lattice_are_found():
    """Narrow wishes: first the search goes where they are missed least."""
    easy = JointSearch(filtered(), PRESETS["brake"], False).run()
    assert easy is not None
    search = JointSearch(filtered(), PRESETS["brake"], False)
    stop_time, travel = (float(search.value(name, easy.gains)[0]) for name in ("stop_time", "travel"))
    narrow = CHEAP.changed({"stop_time": 1.02 * stop_time, "travel": 1.02 * travel})
    found = JointSearch(filtered(), narrow, False).run()
    assert found is not None
    assert search.value("stop_time", found.gains)[0] <= 1.02 * stop_time


def test_an_impossible_wish_is_named_with_what_is_possible():
    why = conflict(filtered(), CHEAP.changed({"stop_time": 0.002}), False)
    assert "stop_time" in why.wishes
    shortfall = next(s for s in why.shortfalls if s.name == "stop_time")
    assert shortfall.possible is not None
    assert shortfall.possible > shortfall.wanted == 0.002
    assert "mechanical brake" in why.change


def test_without_damping_or_friction_nothing_is_tried():
    bare = conflict(wrist(drive=replace(wrist().drive, damping=0.0)), CHEAP, False)
    assert "transmission damping" in bare.reason
    smooth = wrist(drive=replace(wrist().drive, viscous_friction=0.0))
    assert conflict(smooth, CHEAP, False).reason == NO_FRICTION
    assert not JointSearch(smooth, CHEAP, False).run()


def test_bare_point_samples_are_to_be_averaged():
    why = conflict(wrist(sampling="point"), CHEAP, False)
    assert "average" in why.change
    assert "point samples" in why.reason


def test_a_load_beyond_the_motor_is_said():
    why = conflict(wrist(load=100.0), CHEAP, False)
    assert "holding the load takes 100 N m, 250 % of the torque limit" in why.reason


# The best brake of drive 42 rings so long that it might stop after 0.09 or after 0.28 s.
@pytest.mark.parametrize(("number", "preset"), [(0, "brake"), (3, "track"), (42, "brake")])
def test_predictions_hold_in_the_simulator(number, preset):
    """A part of `make evidence-design`."""
    row = predicted(0, number, preset)
    assert row["feasible"]
    assert row["certified"]
    for name in ("stop_time", "creep", "error_ratio"):
        if name in row:
            assert off(row[name]) < 0.15, (name, row[name])


def test_what_a_joint_carries_comes_from_the_model():
    """A horizontal rod of mass 2 kg, 0.5 m out: inertia and weight in closed form."""
    robot = Robot.load("k807")
    home = Spec.load("track").changed(payload=2.0, offset=(0.5, 0.0, 0.0), pose="home")
    loaded, empty = (carried(robot, spec, 0.005)["joint7"] for spec in (home, home.changed(payload=0.0)))
    assert loaded.loaded - empty.loaded == pytest.approx(2 * 0.5**2, rel=0.02)  # and a sphere's own
    assert loaded.inertia == empty.inertia == empty.loaded
    worst = carried(robot, home.changed(pose="worst"), 0.005)["joint7"]
    assert worst.load == pytest.approx(2 * 9.81 * 0.5, rel=0.05)
    assert worst.load >= loaded.load
    stated = replace(home, joints=("joint7",), own={"joint7": {"inertia": 0.4, "load": 3.0}})
    assert carried(replace(robot, model=None), stated, 0.005)["joint7"].loaded == 0.4


@pytest.mark.parametrize(
    ("late", "samples"), [(0.0003, (0, 0)), (0.001, (0, 1)), (0.007, (1, 2)), (0.01, (2, 2))]
)
def test_identified_latency_is_designed_for_and_certified(late, samples):
    robot = Robot.load("k807").with_drives({"joint5": {"command_latency": late}})
    needed = duties(robot, Spec.load("track").changed(period=0.005))
    for duty in needed:
        assert (duty.latency, duty.latency_max) == samples
    config = needed[4].config((JointGains("joint5", R=1.0, D=5.0),))
    assert paired(robot, config)
    if samples[1]:
        with pytest.warns(InputWarning, match="raise its latency_max"):
            paired(robot, replace(config, latency=0, latency_max=None))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('preset = "fast"', 'preset = \'fast\': must be one of "brake", "track", "gentle"'),
        ("stoptime = 1", "stoptime: unknown key; did you mean 'stop_time'?"),
        ("stop_time = -1", "stop_time [s] = -1.0: must be above 0"),
        ("margin = nan", "margin [-] = nan: must be finite"),
        ("offset = [1, 2]", "must be three finite numbers"),
        ('[[joint]]\nname = "j"\nspeed = 1', "joint 'j': speed: unknown key"),
        ("beside = { travle = 1 }", "did you mean 'travel'"),
        ("latency = 1.5", "latency = 1.5: must be a whole number"),
        ("period = 5", "period [s] = 5.0: must be at least 1e-05 and at most 1 s"),
        ("residual_speed = 1", "must be below 1"),
        ('gravity_compensated = "no"', "must be true or false"),
    ],
)
def test_specifications_that_break_a_rule(tmp_path, text, message):
    path = tmp_path / "spec.toml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        Spec.load(path)
    assert str(path) in str(caught.value)
    assert message in str(caught.value)


def test_a_presets_limit_can_be_taken_away(tmp_path):
    path = tmp_path / "spec.toml"
    path.write_text('preset = "track"\ncreep = "none"\n[[joint]]\nname = "a"\ncreep = 0.5\n')
    spec = Spec.load(path)
    assert "creep" not in spec.of(None).limits
    assert spec.of("a").limits["creep"] == 0.5
    assert set(PRESETS["track"].limits) <= set(LIMITS)


def test_unknown_joints_are_named():
    with pytest.raises(InputError, match="joint 'elbow': the robot has no such joint"):
        duties(Robot.load("k807"), Spec(joints=("elbow",)))
