"""The vectorised arm against MuJoCo, Pinocchio, and itself at other widths."""

import ctypes
import shutil
import subprocess
import warnings
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import mujoco
import numpy as np
import pytest

import dashpot._native as _native
from dashpot.arm.drive import Drive, Servo
from dashpot.arm.payload import Payload
from dashpot.arm.plant import build, with_timestep
from dashpot.arm.robot import Robot
from dashpot.campaign.together import on_lanes
from dashpot.control.controller import Controller, load_controller
from dashpot.errors import InputWarning, ModelError
from dashpot.lanes import WIDTHS, run_lanes, tree_of, unfit
from dashpot.simulation.recording import CHANNELS
from dashpot.simulation.release import tracking_events
from dashpot.simulation.simulate import Scenario, run
from dashpot.simulation.trajectory import hold, multisine
from dashpot.studies.lanes_cases import pinocchio_of, random_arm, random_config, random_scenario

ARMS = [("fr3", "fr3"), ("iiwa14", "iiwa14"), ("k807", "k807-wrist")]
SEED = 20261122
ROOT = Path(__file__).parents[1]

pytestmark = pytest.mark.filterwarnings("ignore::dashpot.errors.InputWarning")


def same_bits(a, b):
    return all(np.array_equal(getattr(a, name), getattr(b, name), equal_nan=True) for name in CHANNELS)


def states(plant, count, rng):
    """Random link angles, rates and torques, and MuJoCo's angles for them."""
    n = tree_of(plant).links
    return rng.uniform(-3, 3, (count, n)), rng.uniform(-5, 5, (count, n)), rng.uniform(-50, 50, (count, n))


def forward(tree, q, qd, torque, width=None):
    count, n = q.shape
    qdd, mass, bias = np.empty((count, n)), np.empty((count, n, n)), np.empty((count, n))
    body = np.repeat(tree.bodies[None], count, axis=0)
    at = width or max(WIDTHS)
    _native.forward_dynamics(tree.raw, body, q, qd, torque, qdd, mass, bias, at)
    return qdd, mass, bias


@pytest.mark.parametrize("width", WIDTHS)
def test_functions_are_good_to_the_last_places(width):
    x = np.concatenate([np.linspace(-60, 60, 4001), [0.0, 1e-300, 1e4, 699.0, 705.0]])
    sine, cosine, decay = (np.empty_like(x) for _ in range(3))
    _native.lane_functions(x, sine, cosine, decay, width)
    np.testing.assert_allclose(sine, np.sin(x), rtol=0, atol=2.3e-16)
    np.testing.assert_allclose(cosine, np.cos(x), rtol=0, atol=2.3e-16)
    alive = np.abs(x) < 700
    np.testing.assert_allclose(decay[alive], np.exp(-np.abs(x[alive])), rtol=5e-16)
    assert (decay[~alive & (np.abs(x) < 1e4)] == 0).all()


def compare_with_pinocchio(plant, rng, count):
    pin = pytest.importorskip("pinocchio")
    tree, other = tree_of(plant), pinocchio_of(plant)
    data = other.createData()
    q, qd, torque = states(plant, count, rng)
    qdd, mass, bias = forward(tree, q, qd, torque)
    for k in range(count):
        expected = pin.nonLinearEffects(other, data, q[k], qd[k])
        np.testing.assert_allclose(bias[k], expected, rtol=1e-10, atol=1e-10)
        crba = np.array(pin.crba(other, data, q[k]))
        crba = np.triu(crba) + np.triu(crba, 1).T
        np.testing.assert_allclose(mass[k], crba, rtol=1e-10, atol=1e-12)
        aba = np.array(pin.aba(other, data, q[k], qd[k], torque[k]))
        assert np.abs(qdd[k] - aba).max() < 1e-10 * max(1.0, np.abs(aba).max())


@pytest.mark.parametrize(("name", "_"), ARMS)
def test_forward_dynamics_is_pinocchios(name, _):
    plant = build(Robot.load(name), 1e-3, [Payload(2.0, (0.05, 0.02, 0.1))])
    compare_with_pinocchio(plant, np.random.default_rng(SEED), 200)


def test_forward_dynamics_of_branched_arms_with_slides_is_pinocchios(tmp_path):
    rng, slides, branches = np.random.default_rng(SEED), 0, 0
    for _ in range(25):
        plant = build(random_arm(rng, tmp_path), 1e-3)
        compare_with_pinocchio(plant, rng, 4)
        record = tree_of(plant).record[0]
        slides += record["slides"].sum()
        parents = record["parent"][: record["links"]].tolist()
        branches += len(parents) - len(set(parents))
    assert slides > 3
    assert branches > 3


def test_random_scenarios_are_mujocos_whatever_runs_beside_them(tmp_path):
    """Every element of a drive, fault, event and payload that a file can name; widths, order and threads."""
    rng, kinds, elements = np.random.default_rng(SEED), set(), set()
    for _ in range(14):
        robot = random_arm(rng, tmp_path)
        config = random_config(rng, robot)
        scenarios = [random_scenario(rng, robot, config) for _ in range(5)]
        found = run_lanes(scenarios, width=2)
        for others in (
            run_lanes(scenarios, threads=2),
            run_lanes(scenarios[::-1])[::-1],
            [run_lanes([scenario])[0] for scenario in scenarios],
        ):
            assert all(map(same_bits, found, others))
        for scenario, recording in zip(scenarios, found, strict=True):
            assert recording.settings["engine"] == "lanes"
            reference = run(scenario)
            assert recording.diverged_at == reference.diverged_at
            np.testing.assert_array_equal(recording.status, reference.status)
            for channel in ("position", "link_position"):
                ours, theirs = getattr(recording, channel), getattr(reference, channel)
                np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-11)
            ours, theirs = recording.settings.get("supervisor"), reference.settings.get("supervisor")
            assert (ours or {}).get("state") == (theirs or {}).get("state")
            kinds |= {fault.kind for fault in scenario.faults}
            elements |= {"supervised"} if scenario.supervisor else {"bare"}
            elements |= {"picked up"} if scenario.payload_changes else set()
            elements |= {"carried"} if scenario.carried else set()
        for drive in robot.drives:
            elements |= {
                key
                for key in ("stribeck_friction", "hysteresis", "backlash", "inner_loop", "torque_latency",
                            "sensor_bandwidth", "position_resolution", "torque_noise")
                if getattr(drive, key)
            }  # fmt: skip
    assert len(kinds) >= 12
    assert len(elements) == 12


@pytest.mark.parametrize(("name", "law"), ARMS)
def test_both_engines_have_the_same_limit_and_come_to_it_in_first_order(name, law):
    """At one step they agree to rounding; halved steps halve the error: Richardson's limit is one."""
    robot, config = Robot.load(name), load_controller(law)
    plant = build(robot, config.period, [Payload(1.0, (0.0, 0.0, 0.1))])
    path = multisine(robot.home, 1.2, config.period, SEED, amplitude=0.3, lead_in=0.1)
    found = []
    for parts in (1, 2, 4, 8):
        scenario = Scenario(
            with_timestep(plant, plant.timestep / parts),
            Controller.from_config(config, robot.drives),
            path,
            tracking_events(config, path.start),
        )
        found.append(run_lanes([scenario])[0].link_position)
        if parts < 4:
            np.testing.assert_allclose(found[-1], run(scenario).link_position, rtol=0, atol=1e-12)
    steps = [np.abs(b - a).max() for a, b in pairwise(found)]
    for coarse, fine in pairwise(steps):
        assert coarse / fine == pytest.approx(2, rel=0.15)
    assert 2 * steps[0] < 3e-4  # rad: the error at the step that is chosen


def free_arm(tmp_path, gravity):
    """Three links without friction or damping, let go: only springs, rotors and links."""
    link = '<inertial mass="2" pos="0.1 0.02 0" diaginertia="0.02 0.015 0.01"/>'
    (tmp_path / "free.xml").write_text(
        f'<mujoco><option gravity="0 0 {-gravity}"/><worldbody><body><joint name="a" axis="0 0 1"/>{link}'
        f'<body pos="0.2 0 0.1"><joint name="b" axis="0 1 0"/>{link}'
        f'<body pos="0.2 0 0"><joint name="c" axis="0.3 1 0.2"/>{link}</body></body></body>'
        "</worldbody></mujoco>"
    )
    drives = tuple(
        Drive(name, rotor_inertia=0.1, viscous_friction=0.0, stiffness=4e3, damping=0.0, torque_limit=50.0,
              servo=Servo(kp=0.0, kd=0.0))
        for name in "abc"
    )  # fmt: skip
    return Robot("free", drives, tmp_path / "free.xml", home=(0.3, -0.4, 0.5))


def thrown(robot, parts):
    """The free arm, knocked and left alone for two seconds, at parts of the step."""
    plant = build(robot, 1e-3)
    plant = with_timestep(plant, plant.timestep / parts)
    path = hold(robot.home, 2.0, 1e-3)
    external = np.zeros_like(path.position)
    external[:20] = 30.0, -20.0, 10.0
    return plant, run_lanes([Scenario(plant, None, path, external=external)])[0]


def test_a_frictionless_arm_keeps_its_energy(tmp_path):
    worst = []
    for parts in (1, 2, 4):
        plant, recording = thrown(free_arm(tmp_path, 9.81), parts)
        data, energy = mujoco.MjData(plant.model), []
        plant.model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
        for tick in range(30, len(recording.time), 7):  # after the knock
            link = recording.link_position[tick], recording.link_velocity[tick]
            rotor = recording.position[tick], recording.velocity[tick]
            data.qpos[plant.rotor_qpos], data.qvel[plant.rotor_dof] = rotor
            data.qpos[plant.drives["spring_qpos"]] = link[0] - rotor[0]
            data.qvel[plant.spring_dof] = link[1] - rotor[1]
            mujoco.mj_forward(plant.model, data)
            energy.append(data.energy.sum())
        energy = np.array(energy)
        kinetic = np.ptp(recording.link_velocity, axis=0).max()
        assert kinetic > 1.0  # rad/s: it does move
        half = len(energy) // 2
        drift = abs(energy[half:].mean() - energy[:half].mean())
        worst.append((np.ptp(energy), drift))
    assert worst[0][1] < 0.02  # J of some 20
    for k in (0, 1):
        assert worst[k][0] / worst[k + 1][0] == pytest.approx(2, rel=0.4)


def test_momentum_about_a_fixed_free_axis_is_kept(tmp_path):
    robot, drift = free_arm(tmp_path, 0.0), []
    for parts in (1, 2):
        plant, recording = thrown(robot, parts)
        tree = tree_of(plant)
        q, qd = recording.link_position[30:], recording.link_velocity[30:]
        _, mass, _ = forward(tree, np.ascontiguousarray(q), np.ascontiguousarray(qd), np.zeros_like(q))
        momentum = np.einsum("kj,kj->k", mass[:, 0], qd) + 0.1 * recording.velocity[30:, 0]
        assert abs(momentum.mean()) > 0.3  # N m s: the knock's
        drift.append(np.ptp(momentum) / abs(momentum.mean()))
    assert drift[0] < 0.01
    assert drift[1] < 0.6 * drift[0]


ELEMENTS = {
    "equality constraint 'tied'": ("", '<equality><joint name="tied" joint1="p"/></equality>'),
    "tendon 'rope'": ("", '<tendon><fixed name="rope"><joint joint="p" coef="1"/></fixed></tendon>'),
    "joint 'p' has limits and no drive": ('limited="true" range="-30 30"', ""),
    "joint 'p' has frictionloss and no drive": ('frictionloss="0.1"', ""),
}


@pytest.mark.parametrize("what", ELEMENTS)
def test_what_only_mujoco_simulates_is_named_and_goes_there(tmp_path, what):
    joint, more = ELEMENTS[what]
    link = '<inertial mass="1" pos="0.1 0 0" diaginertia="0.01 0.01 0.01"/>'
    path = tmp_path / "odd.xml"
    path.write_text(
        f'<mujoco><worldbody><body><joint name="j"/>{link}<body pos="0.2 0 0">'
        f'<joint name="p" axis="0 1 0" {joint}/>{link}</body></body></worldbody>{more}</mujoco>'
    )
    drive = Drive("j", rotor_inertia=0.2, viscous_friction=0.5, stiffness=4e3, damping=1.0, torque_limit=50.0,
                  servo=Servo(kp=100.0, kd=5.0))  # fmt: skip
    robot = Robot("odd", (drive,), path)
    scenario = Scenario(build(robot, 1e-3), None, hold((0.0,), 0.1, 1e-3))
    assert what in unfit(scenario)
    assert "only MuJoCo" in unfit(scenario)
    assert not on_lanes("auto", scenario)
    with pytest.raises(ModelError, match="only MuJoCo"):
        run_lanes([scenario])
    plain = replace(robot, model=free_of(path, tmp_path, joint, more))
    assert on_lanes("auto", replace(scenario, plant=build(plain, 1e-3)))


def free_of(path, folder, *texts):
    """The same model without some of its text."""
    text = path.read_text()
    for part in texts:
        text = text.replace(part, "") if part else text
    (folder / "plain.xml").write_text(text)
    return folder / "plain.xml"


class Lanes(ctypes.Structure):
    """``dp_lanes``; what is not called is left opaque."""

    _fields_ = [("width", ctypes.c_int), ("name", ctypes.c_char_p), ("run", ctypes.c_void_p),
                ("forward", ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 8, ctypes.c_int)),
                ("functions", ctypes.c_void_p)]  # fmt: skip


def test_eight_lanes_have_the_same_bits_also_on_a_machine_without_such_registers(tmp_path):
    compiler = shutil.which("g++") or shutil.which("c++")
    if compiler is None:
        pytest.skip("no C++ compiler")
    native, library = ROOT / "native", tmp_path / "eight.so"
    flags = [
        "-std=c++17",
        "-O1",
        "-fPIC",
        "-ffp-contract=off",
        "-Wno-psabi",
        f"-I{native}",
        f"-I{native}/lanes",
    ]
    sources = [str(native / f"dashpot_{name}.c") for name in ("core", "runner", "faults")]
    subprocess.run([compiler, *flags, "-shared", "-o", library, native / "lanes" / "width8.cpp",
                    "-fpermissive", "-x", "c", *sources], check=True, capture_output=True)  # fmt: skip
    eight = Lanes.in_dll(ctypes.CDLL(str(library)), "dp_lanes_8")
    assert eight.width == 8
    plant = build(Robot.load("fr3"), 1e-3, [Payload(2.0)])
    tree, (q, qd, torque) = tree_of(plant), states(plant, 37, np.random.default_rng(SEED))
    body, qdd = np.repeat(tree.bodies[None], 37, axis=0), np.empty_like(q)
    arrays = [a.ctypes.data for a in (tree.raw, body, q, qd, torque, qdd)]
    eight.forward(*arrays, None, None, 37)
    for width in WIDTHS:
        np.testing.assert_array_equal(qdd, forward(tree, q, qd, torque, width)[0])


def test_warnings_are_not_lost(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("error", InputWarning)
        robot = Robot.load("fr3")
        path = hold(robot.home, 0.02, 1e-3)
        config = load_controller("fr3")
        controller = Controller.from_config(config, robot.drives)
        scenario = Scenario(build(robot, 1e-3), controller, path, tracking_events(config, path.start))
        assert run_lanes([scenario] * 3)[2].diverged_at is None
