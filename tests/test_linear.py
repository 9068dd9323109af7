"""The linearised sampled arm against the nonlinear simulation, and the known facts of one sampled joint."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest
from test_plant import drive_with, one_joint, torque_source, vpc

from dashpot import _native
from dashpot.arm import plant as plant_module
from dashpot.arm.payload import Payload
from dashpot.arm.plant import build
from dashpot.arm.robot import Robot
from dashpot.control.controller import Controller, ControllerConfig, JointGains
from dashpot.simulation.engine import engine
from dashpot.simulation.linear import closed_loop, linearise, modes, spectral_radius
from dashpot.simulation.recording import CHANNELS
from dashpot.simulation.simulate import Event, Scenario, run
from dashpot.simulation.trajectory import hold

H = 5e-3
POSE = np.array([0.2, 0.5, -0.4, 1.4, 0.6, -0.9, 0.3])
WRIST = ("joint5", "joint6", "joint7")


def k807(monkeypatch, *, coulomb=0.0, **changes):
    """The arm without friction, with a payload, at a fine step; joints 6 and 7 behind sensor filters."""
    monkeypatch.setattr(plant_module, "STEP_FRACTION", 0.02)
    robot = Robot.load("k807")
    quiet = {name: {"coulomb_friction": coulomb, "torque_noise": 0.0} for name in robot.joints}
    quiet["joint6"] |= {"sensor_bandwidth": 40.0, "sensor_order": 1}
    quiet["joint7"] |= {"sensor_bandwidth": 60.0}
    quiet["joint3"] |= changes
    return build(robot.with_drives(quiet), H, [Payload(2.3, 0.15)])


def advance(plant, controller, dq, dv, ticks, pose=POSE):
    """Runs the native loop from a disturbed equilibrium: records (channels, ticks, 7), final qpos and qvel.

    The weight is carried from outside, so that springs and motors are at rest in the undisturbed state.
    """
    data = mujoco.MjData(plant.model)
    data.qpos[plant.rotor_qpos] = pose
    data.qpos[:] += dq
    data.qvel[:] = dv
    drives = plant.drives.copy()
    for i, name in enumerate(controller.joints):
        drives["control"][plant.robot.index(name)] = i
    drives["average"] = controller.sampling == "average"
    drives["rng"] = 1
    reference = np.zeros((4, ticks, 7))
    reference[0] = pose
    external = np.tile(plant.load_torque(pose), (ticks, 1))
    record, status = np.full((len(CHANNELS), ticks, 7), np.nan), np.zeros(ticks, np.int32)
    core = _native.Core(controller.blocks.view(np.uint8))
    arguments = (
        drives.view(np.uint8),
        np.zeros(0, np.uint8),
        engine("mj_step"),
        plant.model._address,
        data._address,
    )
    steps = round(H / plant.timestep)
    outcome, _ = _native.run(
        core, *arguments, data.qpos, data.qvel, data.qfrc_applied, plant.timestep, steps, ticks,
        reference, external, record, status,
    )  # fmt: skip
    assert outcome == 0
    return record, data.qpos.copy(), data.qvel.copy()


def test_the_open_arm_over_a_period_is_the_derivative_of_the_simulation(monkeypatch):
    plant = k807(monkeypatch, servo=None)
    names = plant.robot.joints
    source = torque_source(names, H)
    arm = linearise(plant, names, POSE, H, "point")
    nv, delta = plant.model.nv, 1e-5
    scale = np.r_[np.ones(nv), np.full(nv, 100.0)]  # of velocities against angles
    found = np.zeros((2 * nv, 2 * nv))
    for i in range(2 * nv):
        ends = []
        for sign in (1, -1):
            x = np.zeros(2 * nv)
            x[i] = sign * delta * scale[i]
            _, q, v = advance(plant, source, x[:nv], x[nv:], 1)
            ends.append(np.r_[q, v])
        found[:, i] = (ends[0] - ends[1]) / (2 * delta * scale[i])
    expected = arm.phi[: 2 * nv, : 2 * nv]
    balance = scale[None, :] / scale[:, None]
    assert np.abs((found - expected) * balance).max() < 0.01 * np.abs(expected * balance).max()


@pytest.mark.parametrize("latency", [0, 1, 2])
@pytest.mark.parametrize("sampling", ["average", "point"])
@pytest.mark.parametrize("form", ["implicit", "explicit"])
def test_the_closed_loop_matrix_moves_as_the_simulation_does(monkeypatch, latency, sampling, form):
    plant = k807(monkeypatch)
    gains = tuple(JointGains(n, R=4.0, D=3.0, K=5.0, kp=30.0, kd=3.0) for n in WRIST)
    config = ControllerConfig(gains, period=H, latency=latency, sampling=sampling, form=form)
    controller = Controller.from_config(config, plant.robot.drives)
    arm = linearise(plant, WRIST, POSE, H, sampling)
    matrix = closed_loop(arm, controller.blocks)
    nv, ticks = plant.model.nv, 40
    rng = np.random.default_rng(latency)
    dq, dv = 1e-6 * rng.normal(size=nv), 1e-4 * rng.normal(size=nv)
    plus, minus = (advance(plant, controller, s * dq, s * dv, ticks)[0] for s in (1, -1))
    moved = (plus - minus) / 2
    drives = plant.drives
    tau = -(drives["stiffness"] * dq[plant.spring_dof] + drives["damping"] * dv[plant.spring_dof])
    z = np.zeros(len(matrix))
    z[:nv], z[nv : 2 * nv] = dq, dv
    filtered = [i for i in range(4, 7) if drives["filtered"][i]]
    orders = [plant.robot.drives[i].sensor_order for i in filtered]
    assert orders == [1, 2]
    at = len(arm.phi) - 3 - sum(orders)
    for i, order in zip(filtered, orders, strict=True):
        z[at], at = tau[i], at + order  # the filter starts settled
    z[len(arm.phi) - 3 : len(arm.phi)] = tau[4:]  # and the first sample is no average yet
    path = np.array([np.linalg.matrix_power(matrix, k) @ z for k in range(ticks)])
    link = path[:, : len(arm.phi)] @ arm.shape.T
    sample = path[:, : len(arm.phi)] @ arm.read[0].T
    effect = path[1:, len(arm.phi) : len(arm.phi) + 3]
    for name, expected in (("link_position", link), ("sample", sample), ("in_effect", effect)):
        got = moved[CHANNELS.index(name)][: len(expected)]
        got = got if expected.shape[1] == 7 else got[:, 4:]
        assert np.abs(got - expected).max() < 0.03 * np.abs(expected).max(), name


@pytest.mark.parametrize(("order", "poles"), [(1, [-1.0]), (2, np.roots([1, 2 * 0.6, 1]))])
def test_a_sensor_filter_adds_its_poles_and_keeps_constant_torques(tmp_path, order, poles):
    """The filter hangs in series: the arm's own eigenvalues stay, exp(p omega h) of the filter join them."""
    sensor = {"sensor_bandwidth": 30.0, "sensor_order": order, "sensor_damping": 0.6}
    plain, filtered = (
        linearise(
            build(one_joint(tmp_path, 0.2, viscous_friction=0.0, **values), H), ["j"], np.zeros(1), H, "point"
        )
        for values in ({}, sensor)
    )
    expected = np.r_[np.linalg.eigvals(plain.phi), np.exp(np.array(poles) * 2 * math.pi * 30.0 * H)]
    found = np.linalg.eigvals(filtered.phi)
    assert len(found) == len(expected) == len(plain.phi) + order
    assert np.poly(found) == pytest.approx(np.poly(expected), abs=1e-6)
    # A constant torque accelerates the free joint; what the link's inertia takes is transmitted, and is read.
    x = np.zeros(len(filtered.phi))
    for _ in range(1000):
        x = filtered.phi @ x + filtered.gamma[:, 0]
    assert filtered.read[0, 0] @ x == pytest.approx(0.2 / (0.2 + 0.05), rel=1e-6)


# --- one joint: windows of oscillation ------------------------------------------------------------


def radius(folder, J, R, D, K, kp=0.0, kd=0.0, form="explicit", sampling="average", latency=0):
    robot = one_joint(folder, J)
    plant = build(robot, H)
    law = vpc(robot, H, R, D, K, kp, kd, form=form, sampling=sampling, latency=latency)
    arm = linearise(plant, ["j"], np.zeros(1), H, sampling)
    return plant, law, arm


def unstable(folder, inertias, *gains, **options):
    found = []
    for J in inertias:
        _, law, arm = radius(folder, J, *gains, **options)
        # The free joint's angle is a mode at 1 that no law without a position loop touches.
        values = np.sort(np.abs(np.linalg.eigvals(closed_loop(arm, law.blocks))))
        found.append(values[-1] > 1 + 1e-7)
    return np.array(found)


WIDE = np.geomspace(1e-3, 30, 60)


def test_explicit_at_high_gain_is_unstable_in_one_narrow_window_of_inertia(tmp_path):
    window = unstable(tmp_path, [0.022, 0.0232, 0.0235, 0.026, 0.0285, 0.029, 0.031], 10.0, 3.0, 1.0)
    assert window[2:5].all()  # exactly 0.02336 to 0.02874
    assert not window[[0, 1, 5, 6]].any()
    outside = WIDE[(WIDE < 0.0233) | (WIDE > 0.0288)]
    assert not unstable(tmp_path, outside, 10.0, 3.0, 1.0).any()
    both = np.r_[WIDE, np.linspace(0.022, 0.031, 10)]
    assert not unstable(tmp_path, both, 10.0, 3.0, 1.0, form="implicit").any()


@pytest.mark.parametrize(("R", "D"), [(1.0, 1.0), (3.0, 3.0), (6.0, 3.0), (10.0, 1.0)])
def test_what_is_certified_is_stable_for_every_inertia(tmp_path, R, D):
    assert not unstable(tmp_path, WIDE, R, D, 1.0).any()


def test_a_badly_damped_position_loop_is_unstable_for_middle_weights_only(tmp_path):
    # Exactly 0.1667 < J < 4.094; on a grid of 80 inertias that reads 0.19 to 3.8.
    inside = [0.168, 0.21, 0.5, 1.0, 2.0, 3.5, 4.07]
    outside = [0.01, 0.05, 0.1, 0.165, 4.12, 10.0, 30.0]
    assert unstable(tmp_path, inside, 1.0, 1.0, 1.0, 60.0, 1.0).all()
    assert not unstable(tmp_path, outside, 1.0, 1.0, 1.0, 60.0, 1.0).any()
    assert not unstable(tmp_path, inside + outside, 3.0, 3.0, 1.0, 60.0, 4.0).any()


CASES = [
    (0.026, (10.0, 3.0, 1.0, 0.0, 0.0), {}),
    (0.5, (1.0, 1.0, 1.0, 60.0, 1.0), {}),
    (1.5, (1.0, 1.0, 1.0, 60.0, 1.0), {}),
    (0.1, (1.0, 1.0, 1.0, 60.0, 1.0), {}),
    (0.155, (1.0, 1.0, 1.0, 60.0, 1.0), {}),
    (0.18, (1.0, 1.0, 1.0, 60.0, 1.0), {}),
    (10.0, (1.0, 1.0, 1.0, 60.0, 1.0), {}),
    (0.3, (3.0, 3.0, 1.0, 60.0, 4.0), {"form": "implicit", "latency": 1}),
]


@pytest.mark.parametrize(("J", "gains", "options"), CASES)
def test_the_simulation_grows_and_rings_as_the_modes_say(tmp_path, monkeypatch, J, gains, options):
    monkeypatch.setattr(plant_module, "STEP_FRACTION", 0.02)
    plant, law, arm = radius(tmp_path, J, *gains, **options)
    ringing = [mode for mode in modes(arm, law) if mode.frequency > 0.05]
    worst, others = ringing[0], ringing[1:]
    gap = min([worst.growth - m.growth for m in others] + [worst.growth + 400])
    ticks = int(np.clip(6 / gap / H, 100, 3000))
    push = np.zeros((ticks + 120, 1))
    push[:3] = 1e-3
    recording = run(Scenario(plant, law, hold([0.0], len(push) * H, H), external=push))
    y = recording.link_velocity[ticks:, 0]
    # The last part is one oscillation (with a drift that differences take out): y'' = a y' + b y.
    d = y[1:] - y[:-1]
    a, b = np.linalg.lstsq(np.c_[d[1:-1], d[:-2]], d[2:], rcond=None)[0]
    root = np.roots([1, -a, -b])
    rate = np.log(root[np.argmax(root.imag)].astype(complex)) / H
    assert rate.imag / (2 * math.pi) == pytest.approx(worst.frequency, rel=0.02)
    size = math.hypot(rate.imag, rate.real)
    assert rate.real == pytest.approx(worst.growth, rel=0.05, abs=0.005 * size)
    assert (rate.real > 0) == (worst.growth > 0)


def test_scaling_errors_of_sensor_and_actuator_are_seen(tmp_path):
    robot = one_joint(tmp_path, 0.2, torque_scale_error=0.2)
    plant, law = build(robot, H), vpc(robot, H, 10.0, 3.0, 1.0)
    scaled = closed_loop(linearise(plant, ["j"], np.zeros(1), H, "average"), law.blocks)
    plain = build(one_joint(tmp_path, 0.2), H)
    law.blocks["B"][..., 0] *= 1.2
    law.blocks["D"][..., 0] *= 1.2
    expected = closed_loop(linearise(plain, ["j"], np.zeros(1), H, "average"), law.blocks)
    np.testing.assert_allclose(
        np.sort(np.abs(np.linalg.eigvals(scaled))), np.sort(np.abs(np.linalg.eigvals(expected))), atol=1e-7
    )
    plant.drives["actuator_gain"] = 0.5
    halved = linearise(plant, ["j"], np.zeros(1), H, "average")
    expected = linearise(plain, ["j"], np.zeros(1), H, "average").gamma * 0.5
    expected[4] *= 1.2  # the average of the sensor
    np.testing.assert_allclose(halved.gamma, expected)


def test_bypass_and_position_loop_act_as_their_events_do(tmp_path):
    robot = one_joint(tmp_path, 0.5)
    plant, law = build(robot, H), vpc(robot, H, 1.0, 1.0, 1.0, 60.0, 1.0)
    arm = linearise(plant, ["j"], np.zeros(1), H, "average")
    push = np.zeros((1200, 1))
    push[:3] = 1e-3
    sizes = []
    for options, event in (
        ({}, None),
        ({"bypass": ["j"]}, Event(0.0, "j", "mode", "bypass")),
        ({"position_loop": False}, Event(0.0, "j", "position_loop", False)),
    ):
        growth = spectral_radius(closed_loop(arm, law.blocks, **options)) > 1 + 1e-6
        events = [event] if event else []
        speed = run(Scenario(plant, law, hold([0.0], 6.0, H), events, push)).link_velocity[:, 0]
        late, early = np.abs(speed[-200:]).max(), np.abs(speed[50:250]).max()
        assert growth == (late > early)
        sizes.append(growth)
    assert sizes == [True, False, False]


def test_modes_are_sorted_and_their_shapes_normalised(monkeypatch):
    plant = k807(monkeypatch)
    gains = tuple(JointGains(n, R=3.0, D=2.5, K=1.0, kp=20.0, kd=2.0) for n in WRIST)
    controller = Controller.from_config(ControllerConfig(gains, period=H), plant.robot.drives)
    found = modes(linearise(plant, WRIST, POSE, H, "average"), controller)
    growth = [mode.growth for mode in found]
    assert growth == sorted(growth, reverse=True)
    for mode in found:
        assert mode.shape.shape == (7,)
        assert np.abs(mode.shape).max() == pytest.approx(1) or not mode.shape.any()
        assert mode.radius == pytest.approx(math.exp(mode.growth * H))


def test_blocks_with_different_latencies_are_refused(tmp_path):
    robot = one_joint(tmp_path)
    arm = linearise(build(robot, H), ["j"], np.zeros(1), H, "average")
    blocks = np.stack([vpc(robot, H, 1.0, 1.0, 1.0, latency=n).blocks for n in (0, 1)])
    with pytest.raises(ValueError, match="same latency"):
        closed_loop(arm, blocks)
    assert drive_with(build(robot, H), H, np.zeros(3)).diverged_at is None
