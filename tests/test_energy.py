"""Energy of joints from their signals, and the trace of the controller: balances, closed forms, same bits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dashpot.arm.drive import Drive
from dashpot.arm.plant import build
from dashpot.arm.robot import Robot
from dashpot.control.controller import MODES, Controller, ControllerConfig, load_controller
from dashpot.control.energy import EnergyMeter
from dashpot.control.jointlaw import JointGains
from dashpot.control.supervisor import STATES, SupervisorSettings
from dashpot.errors import InputError
from dashpot.logs import read_log
from dashpot.logs.log import from_recording
from dashpot.logs.runlog import write_run
from dashpot.logs.samples import read_samples
from dashpot.simulation.faults import Fault
from dashpot.simulation.simulate import Event, Scenario, run
from dashpot.simulation.trace import run_traced
from dashpot.simulation.trajectory import multisine

M, V = 0.6, 2.0
DRIVE = Drive(
    "j",
    rotor_inertia=M,
    viscous_friction=V,
    coulomb_friction=0.0,
    stiffness=1.4e4,
    damping=5.0,
    torque_limit=1e3,
)


def along(h, form, K, seconds=1.0):
    """The law on a rotor that is made to move smoothly: time, q, q', mean tau_s, u in effect, u, states."""
    gains = JointGains("j", R=5.0, D=20.0, K=K, kp=0.0, kd=0.0)
    config = ControllerConfig((gains,), period=h, form=form, blend=0.0)
    controller = Controller.from_config(config, [DRIVE])
    t = h * np.arange(round(seconds / h) + 1)
    q, w = 0.3 * np.sin(5 * t) + 0.1 * t**2, 1.5 * np.cos(5 * t) + 0.2 * t
    tau, effect, command, x = (np.zeros((len(t), 1)) for _ in range(4))
    x = np.zeros((len(t), 4))
    controller.inputs.torque[:] = 0.0
    for k in range(1, len(t)):
        effect[k] = command[k - 1]
        tau[k] = effect[k] - M * (w[k] - w[k - 1]) / h - V * (q[k] - q[k - 1]) / h
        controller.inputs.torque[:] = tau[k]
        controller.step(command[k])
        state = controller.state("j")["x"]
        x[k, : len(state)] = state
    meter = EnergyMeter([DRIVE], config)
    states = {f"x{i}": x[:, [i]] for i in range(4)}
    found = meter.update(tau, q[:, None], w[:, None], effect, states)
    return t, q, w, found, command[:, 0], x, (gains, meter)


@pytest.mark.parametrize("form", ["explicit", "implicit"])
@pytest.mark.parametrize("K", [0.0, 30.0])
def test_the_laws_storage_obeys_its_balance(form, K):
    """d virtual = -u dq - R v q'^2 dt - D xc'^2 dt.

    What is off shrinks with the square of the period, or with the period where the block takes u' = u.
    """
    gap = []
    for h in (2e-3, 1e-3, 5e-4):
        _, q, w, found, u, x, (gains, meter) = along(h, form, K)
        _, storage = meter._laws[0]
        storage._last = None
        xc, rate = storage.update(x)
        S = found["energy_virtual"][:, 0]
        begin = len(S) // 4  # the law has started from rest on a moving joint
        lost = gains.R * V * w**2 + gains.D * rate**2
        if K > 0:
            np.testing.assert_allclose(np.gradient(xc, h)[begin:-1], rate[begin:-1], atol=20 * h)
        out = 0.5 * (u[1:] + u[:-1]) * np.diff(q) + 0.5 * h * (lost[1:] + lost[:-1])
        off = np.cumsum(np.diff(S)[begin:] + out[begin:])
        gap.append(np.abs(off).max() / S.max())
    most, shrinks = (1e-4, 0.3) if form == "explicit" else (0.05, 0.6)
    assert gap[-1] < most
    assert gap[1] < shrinks * gap[0]
    assert gap[2] < shrinks * gap[1]


@pytest.mark.parametrize("form", ["explicit", "implicit"])
@pytest.mark.parametrize("K", [0.0, 30.0])
def test_the_laws_state_is_told_from_its_block(form, K):
    """u = a xc' + K xc, Eq. (21), exactly."""
    _, _, _, _, u, x, (gains, meter) = along(1e-3, form, K, 0.3)
    law, storage = meter._laws[0]
    storage._last = None
    xc, rate = storage.update(x)
    np.testing.assert_allclose(law.a * rate + gains.K * xc, u, rtol=1e-9, atol=1e-9)


def test_work_and_loss_are_those_of_the_rotors_equation():
    _, _, w, found, *_ = along(5e-4, "implicit", 0.0)
    h = 5e-4
    viscous = np.concatenate([[0.0], np.cumsum(0.5 * h * V * (w[1:] ** 2 + w[:-1] ** 2))])
    np.testing.assert_allclose(found["energy_dissipated"][:, 0], viscous, atol=2e-3 * viscous[-1])
    np.testing.assert_allclose(found["energy_kinetic"][:, 0], 0.5 * M * w**2)


@settings(max_examples=25, deadline=None)
@given(st.lists(st.integers(0, 30), min_size=1, max_size=6), st.sampled_from(["average", "point"]), st.data())
def test_energies_do_not_depend_on_how_the_samples_are_dealt_out(sizes, sampling, data):
    t, n = sum(sizes), 3
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    drives = [replace(DRIVE, name=name) for name in "abc"]
    laws = (
        JointGains("a", R=5.0, D=20.0, K=0.0, kp=1.0, kd=1.0),
        JointGains("c", R=3.0, D=9.0, K=4.0, kp=1.0, kd=1.0),
    )
    config = ControllerConfig(laws, period=1e-3, sampling=sampling)
    arrays = rng.normal(size=(4, t, n))
    arrays[rng.random(arrays.shape) < 0.05] = np.nan
    states = {f"x{i}": rng.normal(size=(t, n)) for i in range(4)}
    whole = EnergyMeter(drives, config).update(*arrays, states)
    meter, parts, at = EnergyMeter(drives, config), [], 0
    for size in sizes:
        part = slice(at, at + size)
        parts.append(meter.update(*arrays[:, part], {name: x[part] for name, x in states.items()}))
        at += size
    for name, values in whole.items():
        np.testing.assert_allclose(np.vstack([part[name] for part in parts]), values, rtol=1e-9, atol=1e-9)
        assert np.isfinite(values).any() or t == 0
    assert np.isnan(whole["energy_virtual"][:, 1]).all()  # no law
    assert (whole["energy_potential"][~np.isnan(arrays[0])] >= 0).all()


def test_shapes_that_do_not_fit_are_refused():
    one = np.zeros((3, 1))
    with pytest.raises(InputError, match=r"velocity.shape = \(2, 1\): must have shape \(3, 1\)"):
        EnergyMeter([DRIVE]).update(one, one, one[:2], one)


@pytest.fixture(scope="module")
def traced():
    robot, config = Robot.load("k807"), load_controller("k807-wrist")
    controller = Controller.from_config(config, robot.drives)
    path = multisine(robot.home, 1.0, config.period, 3, amplitude=0.3, lead_in=0.2)
    events = [Event(0.5, "joint6", "position_loop", False), Event(0.6, "joint5", "mode", "bypass")]
    scenario = Scenario(build(robot, config.period), controller, path, events, seed=4)
    return robot, config, scenario, *run_traced(scenario)


def test_a_trace_changes_no_bit_of_the_run(traced):
    _, _, scenario, recording, trace = traced
    other = run(scenario)
    for name in ("position", "torque", "sample", "command", "in_effect", "status"):
        np.testing.assert_array_equal(getattr(other, name), getattr(recording, name))
    five = recording.joints.index("joint5")
    tick = int(np.argmin(np.abs(recording.time - 0.6)))
    assert MODES[int(trace.mode[tick - 1, five])] == "active"
    assert MODES[int(trace.mode[tick, five])] == "bypass"
    assert not trace.mode[:, 0].any()  # under its servo


def test_the_controller_replayed_over_the_samples_has_the_traced_states(traced):
    """The controller is a function of the recorded samples, bit by bit."""
    robot, config, scenario, recording, trace = traced
    controller = Controller.from_config(config, robot.drives)
    places = [recording.joints.index(name) for name in controller.joints]
    for i, j in enumerate(places):  # the state before the first tick, from the one after it
        controller.core.preset(i, trace.x[0, j], recording.command[0, j])
    command = np.zeros(len(places))
    path = scenario.trajectory
    for k in range(1, int(np.argmin(np.abs(recording.time - 0.5)))):
        inputs = controller.inputs
        inputs.torque[:], inputs.position[:] = recording.sample[k, places], recording.position[k, places]
        inputs.velocity[:], inputs.position_ref[:] = recording.velocity[k, places], path.position[k, places]
        inputs.velocity_ref[:] = path.velocity[k, places]
        inputs.acceleration_ref[:] = path.acceleration[k, places]
        inputs.torque_ref[:] = 0.0 if path.torque is None else path.torque[k, places]
        controller.step(command)
        np.testing.assert_array_equal(command, recording.command[k, places])
        for name, j in zip(controller.joints, places, strict=True):
            state = controller.state(name)["x"]
            np.testing.assert_array_equal(state, trace.x[k, j, : len(state)])


def test_the_log_of_a_run_reads_back_without_options(traced, tmp_path):
    robot, config, scenario, recording, trace = traced
    log = from_recording(
        recording, "average", drives=robot.drives, trajectory=scenario.trajectory, controlled=["joint5"]
    )
    path = tmp_path / "run.mcap"
    write_run(path, log, recording, trace, robot, config, scenario.trajectory)
    back = read_log(path)
    assert (back.joints, back.sampling) == (log.joints, "average")
    (a,), (b,) = log.segments, back.segments
    for name in ("command", "torque", "position", "velocity", "link_position"):
        np.testing.assert_array_equal(getattr(b, name), getattr(a, name))
    samples = read_samples(path)
    assert samples.span[0] == pytest.approx(recording.time[0])
    np.testing.assert_array_equal(samples.series["x0"].values, trace.x[:-1, :, 0])
    np.testing.assert_array_equal(samples.series["link_torque"].values, recording.torque[:-1])
    energy = samples.series["energy_dissipated"].values
    friction = np.array([drive.coulomb_friction for drive in robot.drives])
    slid = np.abs(np.diff(recording.position[:-1], axis=0)).sum(0)
    assert (
        energy[-1] > 0.5 * friction * slid
    ).all()  # and with noise and steps of the encoder, not much more
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_what_the_supervisor_does_is_traced_and_said(tmp_path):
    robot, config = Robot.load("k807"), load_controller("k807-wrist")
    controller = Controller.from_config(config, robot.drives)
    path = multisine(robot.home, 1.0, config.period, 3, amplitude=0.3, lead_in=0.2)
    scenario = Scenario(
        build(robot, config.period),
        controller,
        path,
        faults=[Fault("encoder_lost", 0.5, joint="joint6")],
        supervisor=SupervisorSettings(),
    )
    recording, trace = run_traced(scenario)
    said = recording.settings["supervisor"]["decisions"]
    first = int(np.argmax(trace.supervisor > 0))
    assert STATES[int(trace.supervisor[first])] == "torque_brake" == said[0]["after"]
    assert recording.time[first] == pytest.approx(said[0]["time"])
    log = from_recording(recording, "average", drives=robot.drives, trajectory=path)
    write_run(tmp_path / "run.mcap", log, recording, trace, robot, config, path)
    texts = [
        (round(one.time, 6), one.level, one.text) for one in read_samples(tmp_path / "run.mcap").happenings
    ]
    assert texts[0] == (0.5, "info", "simulated fault: joint6: encoder lost")
    assert texts[1][1] == "warning"
    assert "track -> torque brake" in texts[1][2]
