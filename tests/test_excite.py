"""Motions for identification: inside every limit, from rest to rest, informative, and replayable."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from dashpot.arm.dynamics import full_mass
from dashpot.arm.payload import Payload
from dashpot.arm.plant import build
from dashpot.arm.robot import Robot
from dashpot.cli import main
from dashpot.control.controller import Controller, load_controller
from dashpot.errors import InputError, InputWarning
from dashpot.excite import Limits, excite, link_torque, motor_torque
from dashpot.excite.promise import merit
from dashpot.identify import identify_joint
from dashpot.identify.refusals import CORE
from dashpot.logs.log import from_recording
from dashpot.logs.motionfile import read_motion, write_motion
from dashpot.simulation.simulate import Scenario, run

K807 = Robot.load("k807")
LIMITS = Limits(amplitude=0.3, speed=0.4, torque_share=0.55)
LOAD = Payload(3.0, 0.15)


@pytest.fixture(scope="module")
def motion():
    return excite(K807, duration=8.0, period=0.005, payloads=[LOAD], limits=LIMITS, seed=4)


def test_motion_keeps_every_limit_with_and_without_the_payload(motion):
    path, home = motion.trajectory, np.array(K807.home)
    assert len(path.position) == 1601
    assert np.abs(path.position - home).max() <= LIMITS.amplitude
    assert np.abs(path.velocity).max() <= LIMITS.speed
    for payloads in ([], [LOAD]):
        plant = build(K807, 0.005, payloads)
        stops = plant.drives["stop_lower"] + 0.1, plant.drives["stop_upper"] - 0.1
        assert (path.position >= stops[0]).all()
        assert (path.position <= stops[1]).all()
        tau = link_torque(plant, path.position[::8], path.velocity[::8], path.acceleration[::8])
        u = motor_torque(K807.drives, path.velocity[::8], path.acceleration[::8], tau)
        limit = LIMITS.torque_share * np.array([drive.torque_limit for drive in K807.drives])
        assert (np.abs(u).max(0) <= 1.01 * limit).all()  # between the moments that were looked at


def test_motion_is_smooth_and_at_rest_at_home_at_both_ends(motion):
    path, home = motion.trajectory, np.array(K807.home)
    for end in (0, -1):
        np.testing.assert_allclose(path.position[end], home, atol=1e-12)
        np.testing.assert_allclose(path.velocity[end], 0, atol=1e-12)
        np.testing.assert_allclose(path.acceleration[end], 0, atol=1e-9)
    h = path.period
    np.testing.assert_allclose(
        np.diff(path.position, axis=0) / h, (path.velocity[1:] + path.velocity[:-1]) / 2, atol=2e-3
    )
    np.testing.assert_allclose(
        np.diff(path.velocity, axis=0) / h, (path.acceleration[1:] + path.acceleration[:-1]) / 2, atol=0.05
    )


def test_torque_of_the_links_is_that_of_the_equation_of_motion():
    """tau = M q'' at rest without gravity, and gravity's torque at rest without acceleration."""
    plant = build(K807, 0.005, [LOAD])
    rng = np.random.default_rng(0)
    q = rng.uniform(-0.5, 0.5, (3, 7))
    a = rng.normal(size=(3, 7))
    still = np.zeros_like(q)
    weight = link_torque(plant, q, still, still)
    moving = link_torque(plant, q, still, a)
    for i in range(3):
        np.testing.assert_allclose(weight[i], plant.load_torque(q[i]), atol=1e-9)
        data = mujoco.MjData(plant.model)
        data.qpos[plant.rotor_qpos] = q[i]
        mass = full_mass(plant.model, data)[np.ix_(plant.spring_dof, plant.rotor_dof)]
        np.testing.assert_allclose(moving[i] - weight[i], mass @ a[i], atol=1e-9)


def test_every_joint_reverses_often_at_several_speeds_and_is_told_well(motion):
    for j, joint in enumerate(motion.joints):
        w = motion.trajectory.velocity[:, j]
        assert np.count_nonzero(np.diff(np.sign(w[np.abs(w) > 1e-3]))) >= 6
        assert np.mean(np.abs(w) < 0.2 * np.abs(w).max()) > 0.1
        assert np.mean(np.abs(w) > 0.6 * np.abs(w).max()) > 0.02
        assert joint.promise.half_widths["rotor_inertia"] < 0.2
        assert joint.promise.half_widths["viscous_friction"] < 0.2


@pytest.mark.parametrize("load", [None, LOAD])
def test_what_excite_promises_is_what_identify_gives_on_the_simulated_log(load):
    """Bare, joint 7 sends back nothing but J q''; a payload off the axis tells every joint of the wrist."""
    config, wrist, payloads = load_controller("k807-wrist"), K807.joints[4:], [load] if load else []
    limits = Limits(amplitude=0.4, speed=0.6)
    found = excite(
        K807, duration=25.0, period=config.period, joints=wrist, payloads=payloads, limits=limits, seed=4
    )
    controller = Controller.from_config(config, K807.drives)
    recording = run(Scenario(build(K807, config.period, payloads), controller, found.trajectory))
    log = from_recording(recording, controller.sampling)
    kept = {}
    for joint, drive in list(zip(found.joints, K807.drives, strict=True))[4:]:
        told = identify_joint(log.only(drive.name), drive.name, drive)
        identified = set(CORE) <= set(told.values)
        kept[drive.name] = joint.promise.kept
        assert identified or not joint.promise.certain
        assert joint.promise.kept or not identified
        if load is not None:
            assert told.values["rotor_inertia"].value == pytest.approx(drive.rotor_inertia, rel=0.06)
        if not joint.promise.kept:
            assert joint.promise.scale_needed
            given = identify_joint(log.only(drive.name), drive.name, drive, scale=0.0)
            assert "rotor_inertia" in given.values
    assert kept == {"joint5": True, "joint6": True, "joint7": load is not None}


def test_merit_prefers_what_tells_torque_and_acceleration_apart():
    t = np.arange(0, 20, 0.02)
    w, a = np.cos(3 * t), -3 * np.sin(3 * t)
    weight = np.sin(0.7 * t)
    alone, weighted = (merit(K807.drives[4], w, a, 0.1 * a + g * weight) for g in (1e-3, 1.0))
    assert weighted < alone - 3
    assert merit(K807.drives[4], w, a, 0.1 * a) == np.inf


def test_same_seed_same_motion_and_another_seed_another():
    options = {"duration": 5.0, "period": 0.01, "joints": ["joint7"], "limits": LIMITS}
    one, two, three = (excite(K807, seed=seed, **options) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one.trajectory.position, two.trajectory.position)
    assert (one.trajectory.position != three.trajectory.position).any()
    np.testing.assert_array_equal(one.trajectory.position[:, :6], np.tile(K807.home[:6], (501, 1)))


@pytest.mark.parametrize(
    ("robot", "options", "said"),
    [
        (K807, {"payloads": [Payload(40.0, 0.5)]}, r"holding still at home takes .* use a lighter payload"),
        (K807, {"limits": Limits(torque_share=0.1)}, "--torque-share"),
        (Robot("bent", K807.drives, K807.model, K807.flange, (0, 0, 0, 2.6, 0, 0, 0)), {}, "from a stop"),
        (K807, {"joints": ["joint9"]}, "no such joint"),
        (K807, {"duration": 1.0}, "must be 5 to 600 s"),
    ],
)
def test_limits_that_leave_no_motion_are_said(robot, options, said):
    with pytest.raises(InputError, match=said):
        excite(robot, **{"duration": 6.0} | options)


@pytest.mark.parametrize("bad", [{"speed": 0.0}, {"amplitude": float("nan")}, {"torque_share": 1.5}])
def test_limits_are_checked(bad):
    with pytest.raises(InputError, match="must be above 0 and at most"):
        Limits(**bad)


def test_motion_file_gives_the_motion_back_at_any_period(motion, tmp_path):
    path = tmp_path / "motion.csv"
    write_motion(path, motion.trajectory, K807.joints)
    same = read_motion(path, K807, 0.005)
    np.testing.assert_allclose(same.position, motion.trajectory.position, atol=1e-9)
    fine = read_motion(path, K807, 0.001, lead_in=1.0)
    assert fine.start == -1.0
    np.testing.assert_allclose(fine.position[1000::5], motion.trajectory.position, atol=1e-9)
    np.testing.assert_array_equal(fine.position[:1000], np.tile(K807.home, (1000, 1)))
    np.testing.assert_allclose(
        np.gradient(fine.position, 0.001, axis=0)[1:-1], fine.velocity[1:-1], atol=1e-4
    )


def test_motion_file_with_positions_of_some_joints_only(tmp_path):
    t = np.linspace(0, 2, 41)
    q = 0.1 * (1 - np.cos(np.pi * t))
    path = tmp_path / "motion.csv"
    path.write_text(
        "time,joint6/position\n" + "\n".join(f"{a:.17g},{b:.17g}" for a, b in zip(t, q, strict=True))
    )
    found = read_motion(path, K807, 0.005)
    np.testing.assert_allclose(found.position[:, 5], 0.1 * (1 - np.cos(np.pi * found.time)), atol=1e-5)
    np.testing.assert_array_equal(found.position[:, 0], K807.home[0])
    assert len(read_motion(path, K807, 0.005, duration=1.0).position) == 201


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("time,joint9/position\n0,0\n1,0\n", "the robot has no such joint; it has joint1"),
        ("time,joint5/velocity\n0,0\n1,0\n", "has no column of position"),
        ("time,x\n0,0\n1,0\n", "has no column <joint>/position"),
        ("joint5/position\n0\n1\n", "has no column of time"),
        ("time,joint5/position\n0,0\n", "has one row"),
        ("time,joint5/position\n0,0\n0,1\n", "line 3: times must be numbers that increase"),
        ("time,joint5/position\n0,0\n1,\n2,0\n", "line 3: must be a finite number"),
        ("time,joint5/position\n0,0\n1,90\n2,0\n", "must be within 12.57 rad; check the unit"),
    ],
)
def test_motion_files_that_are_none(write, refused, content, said):
    assert said in refused(lambda path: read_motion(path, K807, 0.005), write(content, "motion.csv"))


def test_motion_that_begins_moving_is_said(write):
    rows = "\n".join(f"{0.1 * i},{0.1 * i},1" for i in range(10))
    path = write(f"time,joint5/position,joint5/velocity\n{rows}\n", "motion.csv")
    with pytest.warns(InputWarning, match="begins at 1 rad/s; the arm starts at rest"):
        read_motion(path, K807, 0.005)


def test_command_writes_a_motion_that_simulates_into_a_log(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)

    def dashpot(*arguments):
        with pytest.raises(SystemExit) as left:
            main([str(argument) for argument in arguments])
        return left.value.code, *capsys.readouterr()

    arguments = ("--controller", "k807-wrist", "--duration", 5, "--joints", "joint5", "joint6", "--seed", 3)
    status, out, err = dashpot("excite", "k807", *arguments)
    assert (status, err) == (0, "")
    assert "self-collision and surroundings are not checked" in " ".join(out.split())
    assert "seed 3; open out/excite/motion.png" in out
    assert {p.name for p in (tmp_path / "out/excite").iterdir()} == {
        ".dashpot",
        "motion.csv",
        "motion.png",
        "motion.pdf",
    }
    given = ("simulate", "k807", "k807-wrist", "--motion", "out/excite/motion.csv")
    status, out, err = dashpot(*given, "--duration", 0.5, "--log", "out/simulate/log.csv")
    assert (status, err) == (0, "")
    assert "next: dashpot identify out/simulate/log.csv --robot k807 --sampling average" in out
    period = load_controller("k807-wrist").period
    rows = (tmp_path / "out/simulate/log.csv").read_text().splitlines()
    assert len(rows) == 1 + round(1.5 / period)
    assert rows[0].startswith(
        "time,joint1/command,joint1/effort,joint1/position,joint1/velocity,joint1/link_pos"
    )
    status, out, err = dashpot("simulate", "k807", "k807-wrist", "--motion", "walk")
    assert (status, out) == (2, "")
    assert '--motion = \'walk\': must be "multisine", "hold" or a CSV file' in err
    status, out, err = dashpot(*given, "--log", "log.bag")
    assert (status, out) == (2, "")
    assert "--log = 'log.bag': must end in .csv, .parquet, .mcap" in err


@pytest.mark.parametrize(
    ("flag", "value", "said"),
    [
        ("--joints", "joint9", "--joints = 'joint9': no such joint; fr3 has joint1, "),
        ("--torque-share", "2", "--torque-share = 2.0: must be above 0 and at most 1\n"),
        ("--payload", "-1", "--payload [kg] = -1.0: must be at least 0"),
        ("--seed", "-1", "--seed = -1: must be a whole number, 0 to 2147483647"),
    ],
)
def test_a_bad_flag_is_named(capsys, flag, value, said):
    with pytest.raises(SystemExit) as left:
        main(["excite", "fr3", flag, value])
    assert left.value.code == 2
    assert capsys.readouterr().err.startswith(f"dashpot: error: {said}")
