"""The plant against MuJoCo's rigid arm, scipy's integrator and closed forms; its errors."""

from __future__ import annotations

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dashpot.arm import plant as plant_module
from dashpot.arm.drive import Drive, InnerLoop, Servo
from dashpot.arm.dynamics import full_mass
from dashpot.arm.payload import Payload
from dashpot.arm.plant import build
from dashpot.arm.records import HYSTERESIS
from dashpot.arm.robot import Robot
from dashpot.control.controller import Controller, ControllerConfig, JointGains
from dashpot.control.law import bias_drift, creep_rate, hold_torque, static_R
from dashpot.control.sampled import VELOCITY_REF, empty_block
from dashpot.errors import InputError, InputWarning, ModelError
from dashpot.simulation.simulate import Event, Scenario, run
from dashpot.simulation.trajectory import Trajectory, hold

DRIVE = {
    "rotor_inertia": 0.05,
    "viscous_friction": 0.6,
    "stiffness": 6e3,
    "damping": 0.7,
    "torque_limit": 1e3,
}
ARM = """<mujoco><compiler angle="radian"/><option gravity="0 0 {gravity}"/><worldbody><body name="link">
  <joint name="j" axis="0 1 0" {joint}/>
  <inertial mass="{mass}" pos="{lever} 0 0" diaginertia="{J} {J} {J}"/></body></worldbody></mujoco>"""


def write(folder, text, name="arm.xml"):
    path = folder / f"{len(list(folder.iterdir()))}_{name}"
    path.write_text(text)
    return path


def one_joint(folder, J=0.2, *, gravity=0.0, mass=1.0, lever=0.0, joint="", **values):
    """An arm of one link with inertia J about its joint axis, horizontal, and one drive."""
    text = ARM.format(gravity=-gravity, mass=mass, lever=lever, J=J - mass * lever**2, joint=joint)
    return Robot("one", (Drive("j", **{**DRIVE, **values}),), write(folder, text))


def torque_source(joints, period, sampling="point"):
    """A controller that issues its velocity reference as torque."""
    block = empty_block()
    block["D"][VELOCITY_REF] = 1.0
    return Controller(np.array([block] * len(joints)), joints, period, sampling)


def drive_with(plant, period, torque, external=None, *, start=0.0, sampling="point", **options):
    """Runs an arm with given motor torques and link torques, both (ticks,) or (ticks, n)."""
    torque = np.asarray(torque, float).reshape(len(torque), -1)
    rest = np.zeros_like(torque)
    source = torque_source(plant.robot.joints, period, sampling)
    if external is not None:
        external = np.asarray(external, float).reshape(torque.shape)
    return run(
        Scenario(plant, source, Trajectory(period, rest + start, torque, rest), external=external, **options)
    )


def vpc(
    robot, period, R, D, K, kp=0.0, kd=0.0, *, sampling="average", form="implicit", latency=0, blend=0.02
):
    joints = tuple(JointGains(name, R=R, D=D, K=K, kp=kp, kd=kd) for name in robot.joints)
    config = ControllerConfig(
        joints, period=period, sampling=sampling, form=form, latency=latency, blend=blend
    )
    return Controller.from_config(config, robot.drives)


@pytest.fixture
def fine(monkeypatch):
    """Time steps short enough that integration errors do not show."""
    monkeypatch.setattr(plant_module, "STEP_FRACTION", 0.02)


# --- building -------------------------------------------------------------------------------------


def link_motion(plant):
    """Maps link velocities to the velocities of the elastic model, transmissions locked."""
    motion = np.zeros((plant.model.nv, len(plant.drives)))
    motion[plant.rotor_dof, np.arange(len(plant.drives))] = 1.0
    return motion


@pytest.mark.parametrize("name", ["k807", "fr3", "iiwa14"])
def test_inserting_the_drives_leaves_the_rigid_arm_as_it_was(name):
    robot = Robot.load(name)
    plant = build(robot, 1e-3)
    rigid = mujoco.MjModel.from_xml_path(str(robot.model))
    a, b = mujoco.MjData(plant.model), mujoco.MjData(rigid)
    rng = np.random.default_rng(0)
    rotors = np.diag([drive.rotor_inertia for drive in robot.drives])
    motion = link_motion(plant)
    for _ in range(10):
        q, speed = rng.uniform(-1.5, 1.5, 7), rng.normal(size=7)
        split = rng.uniform(-0.1, 0.1, 7)  # a deflection: what counts for the links is the sum
        a.qpos[plant.rotor_qpos], a.qpos[plant.drives["spring_qpos"]] = q - split, split
        a.qvel[:] = motion @ speed
        b.qpos[:], b.qvel[:] = q, speed
        mass = full_mass(plant.model, a)
        expected = full_mass(rigid, b)
        np.testing.assert_allclose(motion.T @ mass @ motion, expected + rotors, atol=1e-9)
        # The links alone are seen by the springs.
        spring = plant.spring_dof
        np.testing.assert_allclose(mass[np.ix_(spring, spring)], expected, atol=1e-9)
        np.testing.assert_allclose(a.qfrc_bias[plant.rotor_dof], b.qfrc_bias, atol=1e-9)
        np.testing.assert_allclose(a.qfrc_bias[spring], b.qfrc_bias, atol=1e-9)
        b.qvel[:] = 0
        mujoco.mj_forward(rigid, b)
        np.testing.assert_allclose(plant.load_torque(q), b.qfrc_bias, atol=1e-9)


@pytest.mark.parametrize("period", [1e-3, 5e-3, 1.7e-3])
def test_the_step_divides_the_period_and_resolves_the_stiffest_mode(tmp_path, period):
    J = 0.02
    plant = build(one_joint(tmp_path, J), period)
    assert plant.stiffest == pytest.approx(math.sqrt(6e3 * (1 / 0.05 + 1 / J)))
    steps = period / plant.timestep
    assert steps == pytest.approx(round(steps), abs=1e-9)
    assert plant.timestep <= 0.3 / plant.stiffest < 1.5 * plant.timestep * (1 + 1 / steps)
    assert plant.model.opt.timestep == plant.timestep
    assert str(round(steps)) in plant.step_said


def test_payloads_add_their_mass_where_they_hang():
    robot = Robot.load("k807")
    q = np.array(robot.home)
    bare, ball, rod = (
        build(robot, 5e-3, p).model for p in ((), [Payload(4.0, 0.23)], [Payload(4.0, 0.23, length=0.3)])
    )
    data = mujoco.MjData(bare)
    data.qpos[[bare.joint(name).qposadr[0] for name in robot.joints]] = q
    mujoco.mj_forward(bare, data)
    tip, frame = data.site("flange").xpos, data.site("flange").xmat.reshape(3, 3)
    axis, anchor = data.xaxis[bare.joint("joint6").id], data.xanchor[bare.joint("joint6").id]
    arm = tip + frame @ [0.23, 0, 0] - anchor
    extra = -axis @ np.cross(arm, [0, 0, -4.0 * 9.81])
    loads = [
        build(robot, 5e-3, p).load_torque(q)[5]
        for p in ((), [Payload(4.0, 0.23)], [Payload(4.0, 0.23, length=0.3)])
    ]
    assert loads[1] - loads[0] == pytest.approx(extra, rel=1e-6)
    assert loads[2] - loads[0] == pytest.approx(extra, rel=1e-6)
    for model in (ball, rod):
        assert model.body_mass.sum() - bare.body_mass.sum() == pytest.approx(4.0)
    assert rod.body("payload0").inertia.max() == pytest.approx(4.0 * 0.3**2 / 12, rel=0.02)
    assert build(robot, 5e-3, [Payload(0.0)]).model.nbody == bare.nbody


@pytest.mark.parametrize("length", [0.0, 0.2])
def test_a_payload_keeps_its_mass_whatever_the_files_compiler_says(tmp_path, length):
    text = """<mujoco><compiler inertiafromgeom="true"/><default><geom density="50"/></default><worldbody>
      <body>
      <joint name="j" axis="0 1 0"/><geom size=".05"/></body></worldbody></mujoco>"""
    robot = Robot("x", (Drive("j", **DRIVE),), write(tmp_path, text))
    assert build(robot, 5e-3, [Payload(3.0, 0.2, length=length)]).model.body(
        "payload0"
    ).mass == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("offset", "value"), [((0, 1), "offset"), (math.nan, "offset"), ((0, 0, 11), "offset")], ids=str
)
def test_a_bad_payload_is_refused(offset, value):
    with pytest.raises(InputError, match=value):
        Payload(1.0, offset)
    with pytest.raises(InputError, match="mass"):
        Payload(-1.0)


# --- files of any kind ----------------------------------------------------------------------------

TWO = """<mujoco>{head}<worldbody><body name="a">
    <joint name="j1" axis="0 1 0" range="{low} {high}" {j1}/>
    <geom type="capsule" size=".03" fromto="0 0 0 .3 0 0"/>
    <body name="b" pos=".3 0 0"><joint name="j2" axis="0 1 0" {j2}/>
      <geom type="capsule" size=".03" fromto="0 0 0 .2 0 0"/>{inner}<site name="tip" pos=".2 0 0"/></body>
  </body></worldbody>{tail}</mujoco>"""
BASIC = {"head": "", "low": -90, "high": 90, "j1": "", "j2": "", "inner": "", "tail": ""}
RADIANS = {"head": '<compiler angle="radian"/>', "low": -math.pi / 2, "high": math.pi / 2}
URDF = """<?xml version="1.0"?><robot name="two">
  <link name="base"/>
  {link}
  <joint name="j1" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 1 0"/>
    <limit lower="-1.57079633" upper="1.57079633" effort="10" velocity="1"/>
    <dynamics damping="5" friction="3"/></joint>
  <joint name="j2" type="continuous"><parent link="a"/><child link="b"/>
    <origin xyz="0.3 0 0"/><axis xyz="0 1 0"/>
  </joint></robot>"""
LINK = """<link name="{name}"><inertial><origin xyz="{x} 0 0"/><mass value="{m}"/>
  <inertia ixx="{I}" iyy="{I}" izz="{I}" ixy="0" ixz="0" iyz="0"/></inertial>{visual}</link>"""
MESH = '<collision><geometry><mesh filename="package://nowhere/a.stl"/></geometry></collision>'


def pair(path, **values):
    return Robot(
        "two",
        tuple(Drive(n, **{**DRIVE, **values}) for n in ("j1", "j2")),
        path,
        file=path.with_suffix(".toml"),
    )


def urdf(visual=""):
    links = (
        LINK.format(name=n, x=x, m=m, I=0.01, visual=visual)
        for n, x, m in (("a", 0.15, 2.0), ("b", 0.1, 1.0))
    )
    return URDF.format(link="\n".join(links))


def same_motion(one, other):
    """Two plants fall alike from the same pose."""
    ticks = 40
    runs = [drive_with(p, 5e-3, np.zeros((ticks, 2)), start=0.3) for p in (one, other)]
    np.testing.assert_allclose(runs[0].link_position, runs[1].link_position, atol=1e-9)
    assert np.ptp(runs[0].link_position[:, 0]) > 0.1


VARIANTS = {
    "radian": RADIANS,
    "own elasticity and friction": {
        "j1": 'stiffness="9 1" damping="7 3" frictionloss="4" armature="2"',
        "j2": 'springdamper="1 1"',
    },
    "defaults": {
        "head": '<default><joint damping="3 1" stiffness="7" ref="40" springref="9" springdamper="1 1"'
        ' frictionloss="2" armature="3" actuatorfrcrange="-1 1"/></default>',
        "j1": 'ref="0"',
        "j2": 'ref="0"',
    },
    "actuators, sensors, keyframes": {
        "tail": '<actuator><position joint="j1" kp="100"/><motor joint="j2"/></actuator>'
        '<sensor><jointpos joint="j1"/><force site="tip"/></sensor>'
        '<keyframe><key qpos="1 1" ctrl="1 1"/></keyframe>'
    },
    "contacts": {"inner": '<geom size=".3"  mass="0"/>', "tail": ""},
    "integrator": {"head": '<option integrator="RK4" timestep="0.1"/>'},
}


@pytest.mark.parametrize("variant", VARIANTS.values(), ids=VARIANTS.keys())
def test_whatever_else_is_in_the_file_the_arm_is_the_same(tmp_path, variant):
    plain = build(pair(write(tmp_path, TWO.format(**BASIC))), 5e-3)
    other = build(pair(write(tmp_path, TWO.format(**{**BASIC, **variant}))), 5e-3)
    assert other.model.nu == other.model.nkey == other.model.nsensor == 0
    np.testing.assert_allclose(other.drives["stop_upper"], [math.pi / 2, math.inf])
    np.testing.assert_allclose(other.drives["stop_lower"], [-math.pi / 2, -math.inf])
    same_motion(plain, other)


def test_joints_in_frames(tmp_path):
    framed = TWO.format(**BASIC).replace(
        '<joint name="j2" axis="0 1 0" />',
        '<frame euler="90 0 0" pos="0 1 0"><joint name="j2" axis="0 0 -1"/></frame>',
    )
    assert "<frame" in framed
    plain, other = (build(pair(write(tmp_path, t)), 5e-3) for t in (TWO.format(**BASIC), framed))
    same_motion(plain, other)


def test_an_explicit_ref_shifts_the_angle_and_nothing_else(tmp_path):
    shifted = {**BASIC, "j1": 'ref="30"', "low": -60, "high": 120}
    plain, other = (build(pair(write(tmp_path, TWO.format(**t))), 5e-3) for t in (BASIC, shifted))
    shift = np.array([math.pi / 6, 0])
    q = np.array([0.4, -0.7])
    np.testing.assert_allclose(plain.load_torque(q), other.load_torque(q + shift), atol=1e-12)
    runs = [
        drive_with(p, 5e-3, np.zeros((200, 2)), start=0.3 + s)
        for p, s in ((plain, 0 * shift), (other, shift))
    ]
    np.testing.assert_allclose(runs[0].link_position + shift, runs[1].link_position, atol=1e-6)
    assert runs[0].link_position[:, 0].max() > math.pi / 2  # it fell on its stop


def test_a_urdf_is_the_same_arm_as_its_mjcf(tmp_path):
    body = '<inertial mass="{m}" pos="{x} 0 0" diaginertia="0.01 0.01 0.01"/>'
    mjcf = f"""<mujoco><worldbody><body><joint name="j1" axis="0 1 0" range="-90 90"/>
      {body.format(m=2, x=0.15)}
      <body pos=".3 0 0"><joint name="j2" axis="0 1 0"/>{body.format(m=1, x=0.1)}</body></body></worldbody>
      </mujoco>"""
    one, other = (
        build(pair(write(tmp_path, mjcf)), 5e-3),
        build(pair(write(tmp_path, urdf(), "a.urdf")), 5e-3),
    )
    np.testing.assert_allclose(one.drives["stop_upper"], other.drives["stop_upper"], atol=1e-6)
    same_motion(one, other)


def test_missing_meshes_warn_where_the_inertias_are_given(tmp_path):
    path = write(tmp_path, urdf(MESH), "a.urdf")
    with pytest.warns(InputWarning, match="used without its meshes"):
        other = build(pair(path), 5e-3)
    same_motion(build(pair(write(tmp_path, urdf(), "a.urdf")), 5e-3), other)


def test_missing_meshes_without_inertias_are_an_error(tmp_path):
    text = """<mujoco><asset><mesh name="m" file="gone.stl"/></asset><worldbody><body><joint name="j1"/>
      <geom type="mesh" mesh="m"/></body></worldbody></mujoco>"""
    with pytest.raises(ModelError, match=r"gone\.stl"):
        build(pair(write(tmp_path, text)), 5e-3)


def test_gravity_compensation_of_the_file_is_no_load(tmp_path):
    text = TWO.format(**BASIC).replace("<body ", '<body gravcomp="1" ')
    plant = build(pair(write(tmp_path, text)), 5e-3)
    np.testing.assert_allclose(plant.load_torque(np.array([0.3, 0.2])), 0, atol=1e-9)
    recording = drive_with(plant, 5e-3, np.zeros((40, 2)), start=0.3)
    np.testing.assert_allclose(recording.link_position, 0.3, atol=1e-9)


SLIDE = TWO.format(**{**BASIC, "j2": 'type="slide"'})
DOUBLE = TWO.format(**{**BASIC, "inner": '<joint name="j3" axis="1 0 0"/>'})


@pytest.mark.parametrize(
    ("text", "change", "message"),
    [
        (SLIDE, {}, "'j2': must be a hinge"),
        (DOUBLE, {}, "'j2': must be the only joint of its body 'b'"),
        (TWO.format(**BASIC), {"flange": "tool"}, "flange = 'tool': no such site.*sites: tip"),
        (TWO.format(**BASIC), {"drives": ("j1", "j9")}, "'j9': not in the model; its hinges: j1, j2"),
        (TWO.format(**BASIC), {"drives": ("j2", "j1")}, "must be listed base to tip"),
        ("<mujoco><worldbody>", {}, "MuJoCo cannot read it"),
        ("", {}, "MuJoCo cannot read it"),
        ("<mujoco><worldbody><body><joint name='j1'/></body></worldbody></mujoco>", {}, "cannot compile it"),
    ],
    ids=["slide", "two joints", "flange", "unknown joint", "order", "broken", "empty", "no mass"],
)
def test_unusable_models_are_named_in_one_line(tmp_path, text, change, message):
    robot = pair(write(tmp_path, text))
    if "drives" in change:
        change = {"drives": tuple(replace(robot.drives[0], name=name) for name in change["drives"])}
    with pytest.raises(ModelError, match=message) as caught:
        build(replace(robot, **change), 5e-3, [Payload(1.0)])
    assert "\n" not in str(caught.value)


def test_a_missing_file_or_no_model_is_an_error(tmp_path):
    robot = pair(tmp_path / "none.xml")
    with pytest.raises(ModelError, match=r"none\.xml'?: no such file"):
        build(robot, 5e-3)
    with pytest.raises(ModelError, match="model: missing key"):
        build(replace(robot, model=None), 5e-3)


def test_too_long_a_sensor_delay_is_an_error(tmp_path):
    with pytest.raises(InputError, match=r"'j'.*torque_latency.*exceeds"):
        build(one_joint(tmp_path, torque_latency=0.09), 5e-3)


# --- motion ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("gravity", [0.0, 9.81])
@pytest.mark.usefixtures("fine")
def test_agrees_with_an_independent_integrator(tmp_path, gravity):
    J, m, v, k, c = 0.2, 0.05, 0.6, 6e3, 0.7
    lever = 0.3
    h, ticks = 5e-3, 120
    plant = build(one_joint(tmp_path, J, gravity=gravity, lever=lever), h)
    rng = np.random.default_rng(1)
    u, f = rng.normal(size=(2, ticks)) * 3
    recording = drive_with(plant, h, u, f)
    x, expected = np.zeros(4), []
    for tick in range(ticks):
        expected.append(x)

        def rates(_, x, tick=tick):
            q, p, w, s = x  # rotor, link
            tau = k * (q - p) + c * (w - s)
            weight = lever * gravity * math.cos(p)  # positive about y is down
            return [w, s, (u[tick] - v * w - tau) / m, (tau + f[tick] + weight) / J]

        x = solve_ivp(rates, (0, h), x, rtol=1e-9, atol=1e-12).y[:, -1]
    expected = np.array(expected)
    found = np.hstack(
        [recording.position, recording.link_position, recording.velocity, recording.link_velocity]
    )
    scale = np.abs(expected).max(0)
    assert np.abs((found - expected) / scale).max() < 5e-3
    assert np.abs((found - expected) / scale)[:, :2].max() < 1e-3
    tau = k * (expected[:, 0] - expected[:, 1]) + c * (expected[:, 2] - expected[:, 3])
    assert np.abs(recording.torque[:, 0] - tau).max() < 1e-2 * np.abs(tau).max()
    np.testing.assert_array_equal(recording.in_effect[:, 0], u)


def test_the_default_step_is_good_to_a_few_per_cent(tmp_path, monkeypatch):
    robot = one_joint(tmp_path)
    kick = np.zeros(100)
    kick[:4] = 5.0
    coarse = drive_with(build(robot, 5e-3), 5e-3, kick)
    monkeypatch.setattr(plant_module, "STEP_FRACTION", 0.01)
    exact = drive_with(build(robot, 5e-3), 5e-3, kick)
    scale = np.abs(exact.link_position).max()
    assert np.abs(coarse.link_position - exact.link_position).max() < 0.02 * scale


@pytest.mark.parametrize("load", [0.9, 0.5])
def test_a_rotor_loaded_below_coulomb_friction_sticks(tmp_path, load):
    plant = build(one_joint(tmp_path, coulomb_friction=2.0), 5e-3)
    t = 5e-3 * np.arange(1200)
    shaking = load * 2.0 + 0.08 * 2.0 * np.sin(2 * math.pi * 3 * t)
    recording = drive_with(plant, 5e-3, np.zeros_like(t), np.where(t < 0.3, t / 0.3, 1) * shaking)
    moved = recording.position[:, 0]
    assert np.abs(moved).max() < 2 * 2.0 / 6e3
    per_cycle = moved[200 :: round(1 / 3 / 5e-3 * 3)]  # one sample a second, the load in the same phase
    assert np.ptp(per_cycle) < 1e-5
    assert abs(moved[1199] - moved[199]) < 1e-4


def test_a_rotor_loaded_above_coulomb_friction_slips(tmp_path):
    plant = build(one_joint(tmp_path, coulomb_friction=2.0), 5e-3)
    recording = drive_with(plant, 5e-3, np.zeros(1000), np.full(1000, 2.3))
    rate = (2.3 - 2.0) / 0.6  # what friction leaves drives it against viscous friction alone
    assert recording.velocity[-1, 0] == pytest.approx(rate, rel=1e-3)


def play(x, limit):
    """State of an elastic - perfectly plastic element over time."""
    z, out = 0.0, [0.0]
    for step in np.diff(x):
        z = min(max(z + step, -limit), limit)
        out.append(z)
    return np.array(out)


PASSIVE = {
    "friction": {"coulomb_friction": 1.0},
    "hysteresis": {"hysteresis": 0.5},
    "backlash": {"backlash": 4e-3},
    "stops": {"joint": 'range="-0.02 0.03"'},
    "all": {"coulomb_friction": 0.3, "hysteresis": 1.0, "backlash": 2e-3, "joint": 'range="-0.02 0.03"'},
    "inner loop friction": {"coulomb_friction": 1.0, "viscous_friction": 0.0},
}


@pytest.mark.parametrize("values", PASSIVE.values(), ids=PASSIVE.keys())
def test_without_motor_torque_energy_never_grows(tmp_path, values):
    values = {"viscous_friction": 0.0, "damping": 0.0, **values}
    J, m, k, h = 0.2, 0.05, 6e3, 1e-5
    plant = build(one_joint(tmp_path, J, **values), h)
    assert plant.timestep == h  # so that every step is recorded
    d = plant.drives[0]
    ticks, kick = 30_000, np.zeros(30_000)
    kick[:1000] = 20.0
    recording = drive_with(plant, h, np.zeros(ticks), kick)
    q, w, p, s = (
        x[:, 0]
        for x in (recording.position, recording.velocity, recording.link_position, recording.link_velocity)
    )
    e = p - q
    energy = 0.5 * m * w**2 + 0.5 * J * s**2
    energy += 0.5 * k * np.maximum(np.abs(e) - d["half_gap"], 0) ** 2
    if d["hysteresis"] > 0:
        energy += 0.5 * k * play(e, d["hysteresis"] / k) ** 2
    if d["coulomb"] > 0:
        energy += 0.5 * k * play(q, d["coulomb"] / k) ** 2
    depth = np.maximum(p - d["stop_upper"], 0) + np.maximum(d["stop_lower"] - p, 0)
    energy += 0.5 * d["stop_stiffness"] * depth**2
    after = energy[1001:]
    rise = after - np.minimum.accumulate(after)
    assert rise.max() < 0.01 * after[0]
    if set(values) - {"viscous_friction", "damping", "backlash"}:
        assert after[-1] < 0.97 * after[0]  # and these dissipate


def test_the_hysteresis_loop_has_its_closed_form_area(tmp_path):
    k, H, h = 6e3, 2.0, 1e-3
    plant = build(one_joint(tmp_path, 0.02, hysteresis=H, damping=0.0, servo=Servo(kp=6e3, kd=30.0)), h)
    t = h * np.arange(4000)
    trajectory = hold([0.0], 4.0, h)
    recording = run(Scenario(plant, None, trajectory, external=30 * np.sin(2 * math.pi * 0.5 * t)[:, None]))
    e = (recording.link_position - recording.position)[2000:, 0]
    e, tau = np.append(e, e[0]), -recording.torque[2000:, 0]
    tau = np.append(tau, tau[0])
    area = np.sum((tau[1:] + tau[:-1]) / 2 * np.diff(e))
    amplitude = np.ptp(e) / 2
    slip = H / (HYSTERESIS * k)
    assert amplitude > 2 * slip
    assert area == pytest.approx(4 * H * (amplitude - slip), rel=0.02)


@pytest.mark.parametrize("damping", [0.0, 0.7])
def test_backlash_transmits_only_damping_inside_the_gap(tmp_path, damping):
    gap, k = 4e-3, 6e3
    plant = build(one_joint(tmp_path, backlash=2 * gap, damping=damping), 1e-3)
    kick = np.zeros(600)
    kick[:20] = 10.0
    recording = drive_with(plant, 1e-3, kick)
    e = (recording.link_position - recording.position)[:, 0]
    rate = (recording.link_velocity - recording.velocity)[:, 0]
    inside = np.abs(e) < gap
    assert 50 < inside.sum() < 550
    tau = recording.torque[:, 0] + damping * rate
    np.testing.assert_allclose(tau[inside], 0, atol=1e-9)
    np.testing.assert_allclose(tau[~inside], -k * (e - np.sign(e) * gap)[~inside], atol=1e-9)


def test_a_link_rebounds_from_its_stop_slower_than_it_came(tmp_path):
    upper, h, J = 0.2, 1e-3, 0.2
    plant = build(one_joint(tmp_path, J, joint=f'range="-1 {upper}"', viscous_friction=0.0), h)
    kick = np.zeros(1500)
    kick[:50] = 5.0
    recording = drive_with(plant, h, kick)
    link, speed = recording.link_position[:, 0], recording.link_velocity[:, 0]
    hit = np.argmax(link > upper)
    mean = (J * speed + 0.05 * recording.velocity[:, 0]) / (J + 0.05)
    before = mean[hit - 30 : hit - 1].mean()
    after = mean[hit + 100 : hit + 130].mean()
    assert -before < after < -0.05 * before
    stiffness = plant.drives["stop_stiffness"][0]
    assert link.max() - upper < before * math.sqrt((J + 0.05) / stiffness)


def response_with(folder, inner, h, **values):
    plant = build(one_joint(folder, 0.2, inner_loop=inner, **values), h)
    t = h * np.arange(round(0.4 / h))
    u = 3 * np.sin(2 * math.pi * 4 * t)
    f = 2 * np.cos(2 * math.pi * 7 * t)
    return drive_with(plant, h, u, f)


@pytest.mark.parametrize("friction", [0.0, 1.0])
def test_a_fast_inner_loop_shows_the_apparent_drive(tmp_path, friction):
    h = 1e-3
    plain = response_with(tmp_path, None, h, coulomb_friction=friction)
    fast = response_with(tmp_path, InnerLoop(gain=5.0, period=1e-6), h, coulomb_friction=friction)
    slow = response_with(
        tmp_path, InnerLoop(gain=5.0, period=5e-4, bandwidth=300.0), h, coulomb_friction=friction
    )
    scale = np.abs(plain.velocity).max()
    near, far = (np.abs(r.velocity - plain.velocity).max() / scale for r in (fast, slow))
    assert near < 0.03
    assert far > 2 * near


def test_a_stuck_rotor_with_an_inner_loop_moves_as_little_as_one_without(tmp_path):
    ramp = np.minimum(np.arange(400) / 200, 1) * 1.8
    moved = [
        drive_with(
            build(one_joint(tmp_path, coulomb_friction=2.0, inner_loop=inner), 5e-3), 5e-3, 0 * ramp, ramp
        )
        for inner in (None, InnerLoop(gain=5.0, period=1e-6))
    ]
    a, b = (r.position[-1, 0] for r in moved)
    assert a == pytest.approx(b, rel=0.02)
    assert abs(a) < 2.0 / 6e3


# --- sensor ---------------------------------------------------------------------------------------


def shaken(folder, h, ticks, sampling, *, plant=None, seed=0, **values):
    """A joint under a rich torque, held constant over 5 ms whatever the period."""
    plant = plant or build(one_joint(folder, **values), h)
    t = 5e-3 * np.floor(h * np.arange(ticks) / 5e-3 + 1e-6)
    u = 4 * np.sin(2 * math.pi * 3 * t) + 2 * np.sin(2 * math.pi * 17 * t + 1)
    return plant, drive_with(plant, h, u, sampling=sampling, seed=seed)


@pytest.mark.parametrize("filtered", [None, 60.0])
def test_an_average_sample_is_the_mean_of_the_torque_over_the_period(tmp_path, filtered):
    plant, slow = shaken(tmp_path, 5e-3, 50, "average", sensor_bandwidth=filtered)
    steps = round(5e-3 / plant.timestep)
    assert steps >= 5
    _, fast = shaken(tmp_path, plant.timestep, 50 * steps, "point", plant=plant)
    np.testing.assert_allclose(slow.torque, fast.torque[::steps], atol=1e-9)
    for tick in range(1, 50):
        over = fast.sample[(tick - 1) * steps : tick * steps + 1, 0]
        mean = (over[:-1] + over[1:]).mean() / 2
        assert slow.sample[tick, 0] == pytest.approx(mean, abs=1e-9)


def test_a_point_sample_is_the_torque_at_the_tick(tmp_path):
    _, recording = shaken(tmp_path, 5e-3, 50, "point")
    np.testing.assert_array_equal(recording.sample, recording.torque)


@pytest.mark.parametrize("frequency", [5.0, 40.0, 80.0])
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.usefixtures("fine")
def test_the_sensor_filter_has_its_frequency_response(tmp_path, frequency, order):
    bandwidth, zeta, h = 50.0, 0.6, 5e-4
    sensor = {"sensor_bandwidth": bandwidth, "sensor_order": order, "sensor_damping": zeta}
    plant = build(one_joint(tmp_path, damping=30.0, **sensor), h)
    t = h * np.arange(round(1.0 / h))
    recording = drive_with(plant, h, np.sin(2 * math.pi * frequency * t))
    wave = np.exp(-2j * math.pi * frequency * t[len(t) // 2 - 1 : -1])
    out, into = (x[len(t) // 2 - 1 : -1, 0] @ wave for x in (recording.sample, recording.torque))
    s, w0 = 2j * math.pi * frequency, 2 * math.pi * bandwidth
    expected = w0 / (s + w0) if order == 1 else w0**2 / (s**2 + 2 * zeta * w0 * s + w0**2)
    assert abs(out / into - expected) < 0.02


def test_a_first_order_sensor_is_exact_for_a_torque_held_over_each_step(tmp_path):
    """x' = omega (tau - x): in closed form the sum of the responses to every step of the torque."""
    plant = build(one_joint(tmp_path, sensor_bandwidth=60.0, sensor_order=1, sensor_damping=0.1), 1e-3)
    dt = plant.timestep
    _, recording = shaken(tmp_path, dt, 400, "point", plant=plant)
    steps = np.diff(recording.torque[:, 0], prepend=0.0)
    response = 1 - np.exp(-2 * math.pi * 60.0 * dt * np.arange(1, 401))
    np.testing.assert_allclose(recording.sample[:, 0], np.convolve(steps, response)[:400], atol=1e-9)
    assert np.abs(recording.sample - recording.torque).max() > 0.1 * np.abs(recording.torque).max()


def test_scale_bias_and_resolution(tmp_path):
    faults = {"torque_scale_error": 0.1, "torque_bias": 0.3, "torque_resolution": 0.25}
    _, recording = shaken(tmp_path, 5e-3, 50, "point", **faults)
    raw = 1.1 * recording.torque + 0.3
    np.testing.assert_allclose(recording.sample, 0.25 * np.floor(raw / 0.25 + 0.5), atol=1e-12)


def test_the_sensor_delay_is_a_delay(tmp_path):
    plant = build(one_joint(tmp_path, torque_latency=2e-3), 1e-3)
    _, recording = shaken(tmp_path, plant.timestep, 300, "point", plant=plant)
    steps = round(2e-3 / plant.timestep)
    assert steps > 1
    np.testing.assert_array_equal(recording.sample[steps:], recording.torque[:-steps])
    np.testing.assert_array_equal(recording.sample[:steps], recording.torque[0, 0])


def test_the_encoder_is_quantised_and_differentiated(tmp_path):
    _, recording = shaken(tmp_path, 5e-3, 50, "point", position_resolution=1e-3)
    counts = recording.position / 1e-3
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-9)
    np.testing.assert_allclose(recording.velocity[1:], np.diff(recording.position, axis=0) / 5e-3, atol=1e-9)


def test_noise_has_its_size_and_is_independent_between_joints_and_seeds(tmp_path):
    plant = build(pair(write(tmp_path, TWO.format(**BASIC)), torque_noise=0.2), 5e-3)
    noise = []
    for seed in (0, 1):
        recording = drive_with(plant, 5e-3, np.zeros((4000, 2)), seed=seed)
        noise += list((recording.sample - recording.torque).T)
    noise = np.array(noise)
    np.testing.assert_allclose(noise.std(1), 0.2, rtol=0.05)
    np.testing.assert_allclose(noise.mean(1), 0, atol=0.015)
    assert np.abs(np.corrcoef(noise) - np.eye(4)).max() < 0.06
    assert abs(np.corrcoef(noise[0][1:], noise[0][:-1])[0, 1]) < 0.06
    assert (np.abs(noise[0]) < 0.2).mean() == pytest.approx(0.683, abs=0.03)


# --- the law on one joint: hold, creep, drift -----------------------------------------------------

LAWS = [(10.0, 6.0, 40.0), (5.0, 3.0, 0.0), (3.0, 2.5, 10.0)]


@pytest.mark.parametrize("form", ["implicit", "explicit"])
@pytest.mark.parametrize(("R", "D", "K"), LAWS)
def test_under_a_load_the_joint_creeps_at_the_closed_form_rate(tmp_path, R, D, K, form):
    v, load, h = 0.6, 5.0, 1e-3
    robot = one_joint(tmp_path, damping=5.0)
    plant = build(robot, h)
    ticks = 12000
    law = vpc(robot, h, R, D, K, form=form)
    recording = run(Scenario(plant, law, hold([0.0], h * ticks, h), external=np.full((ticks, 1), load)))
    expected = creep_rate(load, static_R(R, D, K, v), v)
    assert recording.link_velocity[-500:].mean() == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize(("R", "D", "K"), LAWS)
@pytest.mark.parametrize(("share", "holds"), [(0.95, True), (1.05, False)])
def test_the_brake_holds_up_to_its_hold_torque(tmp_path, R, D, K, share, holds):
    h, friction = 1e-3, 1.0
    robot = one_joint(tmp_path, 0.02, damping=5.0, coulomb_friction=friction)
    load = share * hold_torque(friction, static_R(R, D, K, 0.6))
    # The load comes slowly: from a sudden one the joint must first stop again.
    ramp = np.minimum(np.arange(10000) / 8000, 1)[:, None] * load
    recording = run(Scenario(build(robot, h), vpc(robot, h, R, D, K), hold([0.0], 10.0, h), external=ramp))
    drift = abs(recording.position[-1, 0] - recording.position[-1500, 0])
    assert (drift < 1e-5) == holds
    assert (drift > 1e-3) != holds


def test_a_heavy_link_hunts_slowly_on_the_elasticity_of_the_friction(tmp_path):
    """Below its hold torque the joint is held only if friction is stiff enough before it slips.

    The law takes elastic friction for load: a stuck rotor on a spring feeds vibration of a heavy link, which
    walks it along. The stiffer or the better damped the friction, the less.
    """
    h, friction = 5e-3, 0.5
    robot = one_joint(tmp_path, 0.2, coulomb_friction=friction)
    R = 10.0
    load = 0.5 * hold_torque(friction, R)
    ramp = np.minimum(np.arange(2800) / 1600, 1)[:, None] * load
    creep = []
    for softer in (1, 3):
        plant = build(robot, h)
        plant.drives["presliding_stiffness"] /= softer
        plant.drives["presliding_damping"] /= softer
        recording = run(Scenario(plant, vpc(robot, h, R, 6.0, 1.0), hold([0.0], 14.0, h), external=ramp))
        creep.append((recording.position[-1, 0] - recording.position[2000, 0]) / (799 * h))
    free = creep_rate(load, R, 0.6)
    assert creep[0] < 0.01 * free
    assert 3 * creep[0] < creep[1] < 0.05 * free


@pytest.mark.parametrize(("R", "D", "K"), LAWS)
def test_a_sensor_bias_drifts_the_joint(tmp_path, R, D, K):
    bias, v, h = 0.5, 0.6, 1e-3
    robot = one_joint(tmp_path, damping=5.0, torque_bias=bias)
    recording = run(Scenario(build(robot, h), vpc(robot, h, R, D, K), hold([0.0], 12.0, h)))
    expected = bias_drift(bias, static_R(R, D, K, v), v)
    assert recording.velocity[-500:].mean() == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize(("R", "D", "K"), LAWS)
def test_the_position_loop_carries_a_load_with_an_error_R_times_smaller(tmp_path, R, D, K):
    h, load, kp = 1e-3, 6.0, 60.0
    robot = one_joint(tmp_path, damping=5.0)
    plant, law = build(robot, h), vpc(robot, h, R, D, K, kp, kd=4.0)
    external = np.full((8000, 1), load)
    errors = []
    for mode in ("bypass", "active"):
        scenario = Scenario(plant, law, hold([0.0], 8.0, h), [Event(0.0, "j", "mode", mode)], external)
        errors.append(run(scenario).position[-1, 0])
    assert errors[0] == pytest.approx(load / kp, rel=0.01)
    assert errors[0] / errors[1] == pytest.approx(static_R(R, D, K, 0.6), rel=0.01)


def test_a_warm_start_takes_out_the_speed_that_the_heavier_rotor_can(tmp_path):
    h, J, m, R, D = 1e-3, 0.05, 0.05, 10.0, 10.0
    robot = one_joint(tmp_path, J, damping=5.0, viscous_friction=0.01)
    plant, law = build(robot, h), vpc(robot, h, R, D, 0.0, blend=0.0)
    push = np.zeros((1000, 1))
    push[:100] = 1.0
    off = [Event(0.0, "j", "mode", "off"), Event(0.3, "j", "mode", "active")]
    fractions = []
    for events in (off, [*off, Event(0.3, "j", "warm_start")]):
        speed = run(Scenario(plant, law, hold([0.0], 1.0, h), events, push)).link_velocity[:, 0]
        fractions.append(speed[350] / speed[299])
    assert fractions[1] == pytest.approx((J + m) / (J + (1 + R) * m), rel=0.15)
    assert fractions[0] > 0.8  # started at rest, the virtual mass is first carried along
