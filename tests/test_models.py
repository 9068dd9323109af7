"""The bundled arms: published figures, kinematics from independent sources, and a first stand-still."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from dashpot.arm.dynamics import full_mass
from dashpot.arm.payload import Payload
from dashpot.arm.plant import build
from dashpot.arm.robot import BUNDLED, Robot
from dashpot.control.controller import Controller, ControllerConfig, JointGains, load_controller
from dashpot.simulation.simulate import Scenario, run
from dashpot.simulation.trajectory import hold

FACTS = {  # total mass [kg], flange at home [m], its z axis there
    "k807": (53.3, (0.50621, 0, 0.49489), (1, 0, 0)),
    "fr3": (16.20741, (0.30689, 0, 0.59028), (0, 0, -1)),
    "iiwa14": (25.61, (0.55641, 0, 0.39773), (0, 0, -1)),
}


@pytest.fixture(scope="module", params=BUNDLED)
def arm(request):
    robot = Robot.load(request.param)
    return robot, mujoco.MjModel.from_xml_path(str(robot.model))


def at(model, q):
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_forward(model, data)
    return data


def turn(axis, angle):
    a = np.asarray(axis, float)
    K = np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


def poses(model, count, seed=0):
    return np.random.default_rng(seed).uniform(
        model.jnt_range[:, 0], model.jnt_range[:, 1], (count, model.nq)
    )


def test_robot_file_and_model_belong_together(arm):
    robot, model = arm
    assert (
        robot.joints
        == tuple(model.joint(i).name for i in range(7))
        == tuple(f"joint{i}" for i in range(1, 8))
    )
    np.testing.assert_allclose(model.key("home").qpos, robot.home, atol=1e-9)
    assert model.jnt_limited.all()
    assert (robot.home > model.jnt_range[:, 0]).all()
    assert (robot.home < model.jnt_range[:, 1]).all()
    assert model.body(model.site(robot.flange).bodyid[0]).name == "link7"
    # The drives bring these; in the model they would count twice.
    assert not model.dof_armature.any()
    assert not model.dof_damping.any()
    assert not model.dof_frictionloss.any()


def test_mass_and_flange_are_where_they_are_known_to_be(arm):
    robot, model = arm
    mass, position, z = FACTS[robot.name]
    site = at(model, robot.home).site("flange")
    assert model.body_mass.sum() == pytest.approx(mass)
    np.testing.assert_allclose(site.xpos, position, atol=1e-5)
    np.testing.assert_allclose(site.xmat.reshape(3, 3)[:, 2], z, atol=1e-6)


def test_models_need_no_mesh_and_touch_nothing(arm):
    _, model = arm
    assert model.nmesh == model.nu == model.nsensor == 0
    assert not model.geom_contype.any()
    assert not model.geom_conaffinity.any()


def test_the_last_axis_runs_through_the_flange_and_inertias_are_possible(arm):
    robot, model = arm
    for q in poses(model, 30):
        data = at(model, q)
        site = data.site(robot.flange)
        np.testing.assert_allclose(site.xmat.reshape(3, 3)[:, 2], data.xaxis[6], atol=1e-6)
        assert np.linalg.norm(np.cross(site.xpos - data.xanchor[6], data.xaxis[6])) < 1e-9
        assert np.linalg.eigvalsh(full_mass(model, data))[0] > 0
    inertia = model.body_inertia[1:]
    assert (inertia.sum(1) - 2 * inertia.max(1) >= -1e-12).all()  # triangle inequality


def test_the_arm_can_hold_itself_up_and_its_modes_are_lightly_damped(arm):
    robot, model = arm
    data = at(model, robot.home)
    assert (np.abs(data.qfrc_bias) < [d.torque_limit for d in robot.drives]).all()
    inertia = np.diag(full_mass(model, data))
    for drive, J in zip(robot.drives[:6], inertia, strict=False):  # the seventh carries nothing yet
        omega = np.sqrt(drive.stiffness * (1 / drive.rotor_inertia + 1 / J))
        assert 0.005 < drive.damping * omega / (2 * drive.stiffness) < 0.1
        assert 5 < omega / (2 * np.pi) < 500


def test_k807_is_the_scaled_product_of_exponentials():
    model = mujoco.MjModel.from_xml_path(str(Robot.load("k807").model))
    offsets = [(0, 0), (0.508, -0.1016), (0, 0.1016), (0.5461, 0.0857), (0, -0.0857), (0.5461, 0.0845)]
    offsets += [(0, -0.0845), (0.1778, 0)]
    to_world = np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0.0]])  # arm x, y, z -> world z, x, y
    shoulder = None
    for q in poses(model, 50, seed=1):
        R, p = np.eye(3), np.zeros(3)
        for i, (x, y) in enumerate(offsets):
            p = p + R @ np.array([x * 0.63, y * 0.63, 0])
            if i < 7:
                R = R @ turn([1, 0, 0] if i % 2 == 0 else [0, 0, 1], q[i])
        data = at(model, q)
        offset = data.site("flange").xpos - to_world @ p
        shoulder = offset if shoulder is None else shoulder
        np.testing.assert_allclose(offset, shoulder, atol=1e-6)
    assert model.body_mass.sum() == pytest.approx(53.3)
    straight = at(model, np.zeros(7))
    assert straight.site("flange").xpos[2] - straight.body("link2").xpos[2] == pytest.approx(0.8, abs=2e-3)


FR3 = [(0, 0, 0.333, 0), (0, 0, 0, -1), (0, -0.316, 0, 1), (0.0825, 0, 0, 1)]
FR3 += [
    (-0.0825, 0.384, 0, -1),
    (0, 0, 0, 1),
    (0.088, 0, 0, 1),
]  # offset and quarter turns about x, Franka's table


def test_fr3_has_frankas_kinematics_and_masses():
    model = mujoco.MjModel.from_xml_path(str(Robot.load("fr3").model))
    for q in poses(model, 50, seed=2):
        R, p = np.eye(3), np.zeros(3)
        for (x, y, z, quarter), angle in zip(FR3, q, strict=True):
            p = p + R @ [x, y, z]
            R = R @ turn([1, 0, 0], quarter * np.pi / 2) @ turn([0, 0, 1], angle)
        np.testing.assert_allclose(at(model, q).site("flange").xpos, p + R @ [0, 0, 0.107], atol=1e-6)
    hand = 0.6544 + 2 * 0.0291
    links = [2.92747, 2.93554, 2.2449, 2.6156, 2.32712, 1.81704]
    np.testing.assert_allclose(model.body_mass[1:7], links)
    assert model.body("link7").mass[0] > hand


IIWA = [  # position, orientation, mass, centre, principal inertias: MuJoCo Menagerie kuka_iiwa_14
    ("0 0 .1575", "1 0 0 0", 5.76, "0 -.03 .12", ".0333 .033 .0123"),
    ("0 0 .2025", "0 0 1 1", 6.35, ".0003 .059 .042", ".0305 .0304 .011"),
    ("0 .2045 0", "0 0 1 1", 3.5, "0 .03 .13", ".025 .0238 .0076"),
    ("0 0 .2155", "1 1 0 0", 3.5, "0 .067 .034", ".017 .0164 .006"),
    ("0 .1845 0", "0 0 1 1", 3.5, ".0001 .021 .076", ".01 .0087 .00449"),
    ("0 0 .2155", "1 1 0 0", 1.8, "0 .0006 .0004", ".0049 .0047 .0036"),
    ("0 .081 0", "0 0 1 1", 1.2, "0 0 .02", ".001 .001 .001"),
]


def test_iiwa14_has_the_published_kinematics_and_inertias():
    text = '<mujoco><compiler angle="radian"/><worldbody>'
    for p, quat, mass, centre, inertia in IIWA:
        text += f'<body pos="{p}" quat="{quat}"><joint axis="0 0 1"/>'
        text += f'<inertial mass="{mass}" pos="{centre}" diaginertia="{inertia}"/>'
    text += '<site name="flange" pos="0 0 .045"/>' + "</body>" * 7 + "</worldbody></mujoco>"
    ours, theirs = (
        mujoco.MjModel.from_xml_path(str(Robot.load("iiwa14").model)),
        mujoco.MjModel.from_xml_string(text),
    )
    for q in poses(ours, 30, seed=3):
        a, b = at(ours, q), at(theirs, q)
        np.testing.assert_allclose(a.site("flange").xpos, b.site("flange").xpos, atol=1e-5)
        np.testing.assert_allclose(a.site("flange").xmat, b.site("flange").xmat, atol=1e-5)
        mass = full_mass(theirs, b)
        np.testing.assert_allclose(full_mass(ours, a), mass, atol=1e-4 * mass.max())


def gentle(robot, period):
    """Gains on all joints: K = 0, a position loop too slow to meet the elastic modes."""
    joints = []
    for drive in robot.drives:
        m, R = drive.rotor_inertia, 5.0
        D = max(6 * m * R, drive.viscous_friction)
        joints.append(JointGains(drive.name, R=R, D=D, K=0.0, kp=60 * m**0.5, kd=10 * m**0.5))
    return Controller.from_config(ControllerConfig(tuple(joints), period=period), robot.drives)


@pytest.mark.parametrize(
    ("name", "period"), [("k807", 5e-3), ("k807", 1e-3), ("fr3", 1e-3), ("iiwa14", 1e-3)]
)
def test_every_arm_holds_its_home_pose_with_a_payload(name, period):
    robot = Robot.load(name)
    plant = build(robot, period, [Payload(2.0)])
    recording = run(Scenario(plant, gentle(robot, period), hold(robot.home, 0.5, period)))
    assert recording.diverged_at is None
    assert np.abs(recording.link_position - robot.home).max() < 0.3
    assert np.abs(recording.velocity[-20:]).max() < 1.0


@pytest.mark.parametrize(
    ("name", "controller"), [("fr3", "fr3"), ("iiwa14", "iiwa14"), ("k807", "k807-wrist")]
)
@pytest.mark.parametrize("payload", [0.0, 3.0])
def test_bundled_controllers_hold_quietly(name, controller, payload):
    """At rest nothing but sensor noise: no hunting on friction, no slow growth."""
    robot, config = Robot.load(name), load_controller(controller)
    plant = build(robot, config.period, [Payload(payload, 0.1)])
    loop = Controller.from_config(config, robot.drives)
    recording = run(Scenario(plant, loop, hold(robot.home, 3.0, config.period)))
    last = recording.sample[-round(1 / config.period) :]
    assert np.ptp(last, axis=0).max() < 10 * max(drive.torque_noise for drive in robot.drives)
    assert np.abs(recording.link_velocity[-100:]).max() < 0.02
