"""The simulated Franka by itself: wire, rules, model and arm; test_franka.py drives it by pylibfranka."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from dashpot._native import bounded, take, take_difference
from dashpot.arm.payload import Payload
from dashpot.arm.plant import build
from dashpot.arm.robot import Robot
from dashpot.cli import main
from dashpot.control.controller import Controller, load_controller
from dashpot.errors import InputError
from dashpot.hardware.franka import STEP, TORQUE
from dashpot.hardware.franka_server.arm import Arm, Gravity
from dashpot.hardware.franka_server.limits import FR3
from dashpot.hardware.franka_server.messages import COMMAND, ERRORS, PAYLOADS, STATE, Reflex, Request
from dashpot.hardware.franka_server.rules import Rules
from dashpot.hardware.franka_server.server import Server
from dashpot.simulation.faults import Fault
from dashpot.simulation.loop import Loop
from dashpot.simulation.simulate import PayloadChange, Scenario
from dashpot.simulation.stepped import SteppedArm
from dashpot.simulation.trajectory import multisine


@pytest.fixture(scope="module")
def robot():
    return Robot.load("fr3")


def poses(count, seed=0):
    rng = np.random.default_rng(seed)
    return rng.uniform(FR3.lower, FR3.upper, (count, 7))


# --- wire ---------------------------------------------------------------------------------------------------


def test_messages_are_packed_as_libfranka_packs_them():
    assert (STATE.itemsize, COMMAND.itemsize) == (1377, 371)
    sizes = {
        Request.CONNECT: 4,
        Request.MOVE: 56,
        Request.SET_COLLISION_BEHAVIOR: 416,
        Request.SET_LOAD: 104,
    }
    assert {request: PAYLOADS[request].size for request in sizes} == sizes
    assert set(PAYLOADS) == set(Request)
    assert max(Reflex) < ERRORS
    assert str(Reflex.TAU_J_RANGE_VIOLATION) == "tau_J_range_violation"


# --- rules --------------------------------------------------------------------------------------------------


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_what_the_adapter_sends_never_breaks_a_torque_rule(seed):
    """Whatever is asked for, with packets lost on the way, and the state rounded to single precision."""
    rng = np.random.default_rng(seed)
    rules = Rules(FR3)
    wanted = np.zeros(7)
    for _ in range(400):
        wanted = rng.choice([wanted, rng.uniform(-200, 200, 7)])
        in_effect = rules.torque.astype(np.float32).astype(float)
        sent = np.array(bounded(wanted, in_effect, TORQUE, STEP))
        if rng.random() < 0.9:
            assert rules.command(sent) is None
    assert (np.abs(rules.torque) <= FR3.torque).all()


def test_the_adapter_reaches_what_is_asked_for():
    torque, wanted = np.zeros(7), np.array([87.0, -87.0, 200.0, 0.5, 12.0, -12.0, 20.0])
    for _ in range(90):
        torque = np.array(bounded(wanted, torque, TORQUE, STEP))
    assert torque == pytest.approx(np.clip(wanted, -TORQUE, TORQUE), abs=1e-12)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_torque_that_is_not_finite_holds_the_one_in_effect(bad):
    now = np.linspace(-3, 3, 7)
    assert bounded(np.full(7, bad), now, TORQUE, STEP) == now.tolist()


@pytest.mark.parametrize(
    ("torque", "reflex"),
    [
        (0.0, None),
        (1.0, None),
        (1.01, Reflex.CONTROLLER_TORQUE_DISCONTINUITY),
        (-1.01, Reflex.CONTROLLER_TORQUE_DISCONTINUITY),
        (90.0, Reflex.TAU_J_RANGE_VIOLATION),
        (np.nan, Reflex.TAU_J_RANGE_VIOLATION),
    ],
)
def test_the_first_torque_and_every_step(torque, reflex):
    for joint in range(7):
        rules, command = Rules(FR3), np.zeros(7)
        command[joint] = torque
        assert rules.command(command) is reflex
        assert rules.torque[joint] == (torque if reflex is None else 0.0)


def test_twenty_lost_packets_in_a_row_stop_the_robot_and_nineteen_do_not():
    rules = Rules(FR3)
    assert [rules.cycle(False) for _ in range(19)] == [None] * 19
    assert rules.cycle(True) is None
    assert [rules.cycle(False) for _ in range(19)] == [None] * 19
    assert rules.cycle(False) is Reflex.COMMUNICATION_CONSTRAINTS_VIOLATION
    assert rules.success_rate == pytest.approx(1 / 40)
    forgiving = Rules(FR3, enforced=False)
    assert {forgiving.cycle(False) for _ in range(100)} == {None}


@given(st.integers(0, 6), st.floats(0, 1))
def test_an_arm_at_its_speed_limit_can_stop_before_its_stop(joint, share):
    """Braking at the stated deceleration from the fastest speed allowed ends inside the range."""
    q = FR3.lower + share * (FR3.upper - FR3.lower)
    slowest, fastest = FR3.speeds(q)
    way = fastest**2 / (2 * FR3.deceleration)
    assert (q + way <= FR3.upper + 1e-9)[joint]
    assert (q - slowest**2 / (2 * FR3.deceleration) >= FR3.lower - 1e-9)[joint]
    assert (fastest <= FR3.speed).all()
    assert (slowest <= 0).all()


def test_motion_limits_name_their_reflex(robot):
    rules, home, still = Rules(FR3), np.array(robot.home), np.zeros(7)
    assert rules.motion(home, still) is None
    for joint in range(7):
        fast, far = still.copy(), home.copy()
        fast[joint] = 6.0
        far[joint] = FR3.upper[joint] + 0.01
        assert rules.motion(home, fast) is Reflex.JOINT_VELOCITY_VIOLATION
        assert rules.motion(far, still) is Reflex.JOINT_POSITION_LIMITS_VIOLATION


# --- model --------------------------------------------------------------------------------------------------


def test_the_urdf_is_the_arm(robot):
    """MuJoCo reads the URDF back: mass matrix, gravity and flange are the model's."""
    gravity = Gravity(robot)
    text = gravity.urdf(robot, FR3)
    spec = mujoco.MjSpec.from_string(text)
    spec.body("link7").add_site(name="flange", pos=[0, 0, 0.107])
    spec.compiler.fusestatic = False
    read, own = spec.compile(), gravity._model
    one, other = mujoco.MjData(read), mujoco.MjData(own)
    for q in poses(5):
        one.qpos[:], other.qpos[:] = q, q
        mujoco.mj_forward(read, one)
        mujoco.mj_forward(own, other)
        masses = np.zeros((2, 7, 7))
        mujoco.mj_fullM(read, one, masses[0])
        mujoco.mj_fullM(own, other, masses[1])
        armature = np.diag(own.dof_armature)
        assert masses[0] == pytest.approx(masses[1] - armature, abs=1e-9)
        assert one.qfrc_bias == pytest.approx(other.qfrc_bias, abs=1e-9)
        assert one.site("flange").xpos == pytest.approx(other.site("flange").xpos, abs=1e-9)
        assert one.site("flange").xmat == pytest.approx(other.site("flange").xmat, abs=1e-9)


@given(st.integers(0, 1000), st.floats(0.1, 5), st.floats(-0.2, 0.2), st.floats(0, 0.3))
@example(0, 1.0, 0.0, 6e-8)
@settings(max_examples=5, deadline=None)
def test_a_declared_load_weighs_what_the_payload_does(seed, mass, x, z):
    robot = Robot.load("fr3")
    gravity = Gravity(robot)
    q = poses(1, seed)[0]
    bare = build(robot, 1e-3).load_torque(q)
    assert gravity.torque(q) == pytest.approx(bare, abs=1e-9)
    # MuJoCo takes a centre less than a micrometre off its frame for one in it.
    centre = np.array([x, 0.0, z]) if max(abs(x), z) >= 1e-6 else np.zeros(3)
    gravity.mass, gravity.centre = mass, centre
    loaded = build(robot, 1e-3, [Payload(mass, (x, 0.0, z))]).load_torque(q)
    assert gravity.torque(q) == pytest.approx(loaded, abs=1e-9)


# --- arm ----------------------------------------------------------------------------------------------------


def test_tick_by_tick_the_arm_is_the_simulators_bit_by_bit(robot):
    """The torques of a closed loop, with faults and a payload, pushed from outside: the same arm."""
    config = load_controller("fr3")
    path = multisine(robot.home, 0.5, 1e-3, 3, amplitude=0.2, lead_in=0.1)
    faults = [
        Fault("encoder_frozen", 0.1, joint="joint4"),
        Fault("torque_bias", 0.2, 0.3, "joint2", 3.0),
        Fault("mechanical_brake", 0.35, joint="joint6"),
        Fault("samples_late", 0.2, 0.25),
    ]
    changes = [PayloadChange(0.15, Payload(2.0, 0.05))]
    plant = build(robot, 1e-3)
    controller = Controller.from_config(config, robot.drives)
    loop = Loop(Scenario(plant, controller, path, seed=5, faults=faults, payload_changes=changes))
    start = loop._data.qpos.copy()
    loop.advance()
    expected = loop.recording()

    def later(fault):  # the link's clock starts at zero, the path's at -0.1 s
        return Fault(fault.kind, fault.start + 0.1, fault.end + 0.1, fault.joint, fault.value)

    link = SteppedArm(
        plant,
        1e-3,
        faults=[later(fault) for fault in faults],
        payload_changes=[PayloadChange(0.25, changes[0].payload)],
        seed=5,
        record=True,
    )
    link._data.qpos[:] = start
    sensed = np.zeros((3, 7))
    for torque in expected.in_effect:
        link.sense(*sensed)
        assert link.push(np.ascontiguousarray(torque))
    found = link.recording()
    for name in ("position", "velocity", "link_position", "link_velocity", "torque", "sample", "in_effect"):
        assert np.array_equal(getattr(found, name), getattr(expected, name)), name


def test_sense_and_push_take_turns(robot):
    link = SteppedArm(build(robot, 1e-3), 1e-3)
    with pytest.raises(ValueError, match="take turns"):
        link.push(np.zeros(7))
    link.sense(*np.zeros((3, 7)))
    with pytest.raises(ValueError, match="take turns"):
        link.sense(*np.zeros((3, 7)))
    assert link.push(np.full(7, np.nan))  # no torque rather than NaN
    assert np.isfinite(link.deflection[0]).all()


def test_the_robot_carries_itself_and_what_is_declared(robot):
    """Without torques it rests; with a load it does not know of it sinks; declared, it rests again."""
    moved = {}
    for name, mass, declared in (("bare", 0.0, 0.0), ("unknown", 2.0, 0.0), ("declared", 2.0, 2.0)):
        arm = Arm(robot, Payload(mass), record=True)
        arm.gravity.mass = declared
        arm.begin()
        arm.release()
        for _ in range(300):
            arm.push(np.zeros(7))
            arm.sense()
        way = np.abs(np.diff(arm.recording().link_position[[0, -1]], axis=0)).max()
        moved[name] = way
    assert moved["bare"] < 1e-4
    assert moved["declared"] < 1e-3
    assert moved["unknown"] > 0.1


def test_the_reported_torque_is_the_transmissions(robot):
    """tau_J against k times the deflection of the spring: the sensor sits on the link's side, filtered."""
    arm = Arm(robot, Payload(1.0), seed=3, record=True)
    arm.begin()
    rest = arm.state["tau_J"].astype(float).copy()
    noise = max(drive.torque_noise for drive in robot.drives)
    assert rest == pytest.approx(
        build(robot, 1e-3, [Payload(1.0)]).load_torque(arm.state["theta"]), abs=6 * noise
    )
    stiffness = np.array([drive.stiffness for drive in robot.drives])
    spring = stiffness * (arm.state["theta"].astype(float) - arm.state["q"].astype(float))
    assert rest == pytest.approx(spring, abs=6 * noise + 0.01)  # positions in single precision


def test_arm_and_server_refuse_what_they_cannot_be(robot, capsys):
    six = replace(robot, drives=robot.drives[:6], home=robot.home[:6])
    with pytest.raises(InputError, match=r"a Franka has 7 joints, this robot 6"):
        Arm(six, Payload(0.0))
    with pytest.raises(InputError, match=r"friction compensation \[-\] = 2: must be 0 to 1"):
        Arm(robot, Payload(0.0), friction=2)
    with pytest.raises(InputError, match=r"encoder_lost start \[s\] = -9.0: outside"):
        Arm(robot, Payload(0.0), faults=[Fault("encoder_lost", -9.0)])
    for flags, said in (
        (("--fault", "encoder_lost:joint9@1"), "--fault joint = 'joint9': no such joint"),
        (("--fault", "encoder_lost@-9"), "--fault encoder_lost start [s] = -9.0: outside"),
        (("--friction", "2"), "--friction = 2.0: must be 0 to 1"),
        (("--payload", "-1"), "--payload [kg] = -1.0: must be"),
        (("--seed", "-1"), "--seed = -1: must be a whole number"),
    ):
        with pytest.raises(SystemExit):
            main(["franka-server", *flags])
        assert capsys.readouterr().err.startswith(f"dashpot: error: {said}")
    arm = Arm(robot, Payload(0.0))
    first = Server(arm, FR3, host="127.0.77.1", port=0)
    with pytest.raises(InputError, match=r"127\.0\.77\.1:\d+'?: is in use: another server runs there"):
        Server(arm, FR3, host="127.0.77.1", port=first.address[1])
    first._listener.close()
    with pytest.raises(InputError, match="is no address of this machine"):
        Server(arm, FR3, host="192.0.2.1")


def test_lists_and_arrays_must_fit():
    to = np.zeros(3)
    take([1.0, 2.0, 3.0], to)
    assert to.tolist() == [1, 2, 3]
    take_difference([1.0, 2.0, 3.0], [3.0, 2.0, 1.0], to)
    assert to.tolist() == [-2, 0, 2]
    with pytest.raises(ValueError, match="same size"):
        take([1.0], to)
