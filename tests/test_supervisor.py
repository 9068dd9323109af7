"""The supervisor: its decision exhaustively, its limits under any input, and faults on simulated arms."""

from __future__ import annotations

import itertools
import math
import subprocess
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_plant import one_joint, vpc

from dashpot import _native
from dashpot.arm.drive import Drive
from dashpot.arm.payload import Payload
from dashpot.arm.plant import build
from dashpot.arm.robot import Robot
from dashpot.control.controller import Controller, load_controller
from dashpot.control.sampled import VirtualPassive, add_position_loop, pd_block, virtual_passive_block
from dashpot.control.supervisor import (
    EVENTS,
    REASONS,
    STATES,
    Supervisor,
    SupervisorSettings,
    load_state,
    next_state,
)
from dashpot.control.thresholds import stand_of
from dashpot.errors import InputError
from dashpot.paper.fig6 import _resonance
from dashpot.paper.setup import setup
from dashpot.simulation.equilibrium import settle
from dashpot.simulation.simulate import Scenario, run
from dashpot.simulation.trajectory import Trajectory, hold, multisine
from dashpot.studies.supervision import _ARROW, draw, replay, transitions

NATIVE = Path(__file__).parent.parent / "native"
H = 1e-3
DRIVE = Drive(
    "j",
    rotor_inertia=0.2,
    viscous_friction=1.0,
    coulomb_friction=1.0,
    stiffness=1e4,
    damping=4.0,
    torque_limit=50.0,
    torque_rate_limit=2000.0,
    torque_noise=0.05,
    position_resolution=1e-5,
)
LAW = VirtualPassive(R=8.0, D=20.0, K=0.0, m=0.2, v=1.0)


def guarded(n=1, latency=0, options=None, law=LAW, drive=DRIVE, **kwargs):
    block = add_position_loop(virtual_passive_block(law, H, "implicit"), 60.0, 8.0)
    block["torque_limit"], block["rate_limit"] = drive.torque_limit, drive.torque_rate_limit * H
    block["latency"] = latency
    names = [f"j{i}" for i in range(n)]
    controller = Controller(np.array([block] * n), names, H, "point")
    drives = [Drive(**{**vars(drive), "name": name}) for name in names]
    return Supervisor(controller, drives, options or SupervisorSettings(), **kwargs)


# --- the decision -------------------------------------------------------------------------------------


def every_set_of_events():
    return [c for k in range(len(EVENTS) + 1) for c in itertools.combinations(EVENTS, k)]


def test_the_decision_obeys_its_rules_for_every_state_and_every_set_of_events():
    seen = set()
    for state, events in itertools.product(STATES, every_set_of_events()):
        after = next_state(state, *events)
        seen.add((state, after))
        assert STATES.index(after) >= STATES.index(state)  # never back
        if not events:
            assert after == state
        if after == "track":
            assert not set(events) - {"brake late or drifting"}
        if "encoder lost" in events:
            assert after in ("torque_brake", "safe")
        if "torque sensor lost" in events:
            assert after in ("encoder_brake", "safe")
        if {"encoder lost", "torque sensor lost"} <= set(events):
            assert after == "safe"
        # what is worse never leads to a better state
        for more in EVENTS:
            assert STATES.index(next_state(state, *events, more)) >= STATES.index(after)
        # deciding again from the same events changes nothing, but for the law, whose alarm is cleared
        if "law oscillates or fails" not in events:
            assert next_state(after, *events) in (after, "safe")
    assert len(seen) == 4 + 3 + 2 + 1  # all that the order allows


def test_the_picture_shows_every_transition(tmp_path):
    assert set(transitions()) == set(_ARROW)
    draw(tmp_path / "states.png")
    assert (tmp_path / "states.png").stat().st_size > 1e4


def test_numbers_outside_the_states_are_safe():
    for state in (-1, 4, 1000):
        assert all(_native.next_state(state, events) == 3 for events in range(64))


def test_words_and_numbers_are_the_native_ones():
    assert len(REASONS) == _native.REASONS
    header = (NATIVE / "dashpot_supervisor.h").read_text()
    listed = header[header.index("DP_WHY_NONE") : header.index("DP_NWHY")].replace("\n", " ").split(",")
    assert [name.strip().removeprefix("DP_WHY_").lower() for name in listed if name.strip()] == [
        reason.name for reason in REASONS
    ]


SIGNALS = {  # what a joint may send, each with the event it must lead to within the debounce time
    "good": {},
    "encoder nan": {"position": math.nan},
    "encoder old": {"encoder_age": 50},
    "torque inf": {"torque": math.inf},
    "torque old": {"torque_age": 50},
    "reference nan": {"position_ref": math.nan},
}


def feed(supervisor, tick, joint, signal):
    inputs = supervisor.controller.inputs
    values = {
        "torque": 0.01 * math.sin(1.7 * tick + joint),
        "position": 0.0,
        "position_ref": 0.0,
        "torque_age": 0,
        "encoder_age": 0,
        **SIGNALS[signal],
    }
    supervisor.torque_age[joint] = values.pop("torque_age")
    supervisor.encoder_age[joint] = values.pop("encoder_age")
    for key, value in values.items():
        getattr(inputs, key)[joint] = value


def test_every_sequence_of_faults_ends_where_the_decision_says():
    """All sequences of three faults and stops on two joints: order, limits, reasons, no way back."""
    kinds = [(j, name) for j in (0, 1) for name in SIGNALS if name != "good"] + [(-1, "stop")]
    out = np.zeros(2)
    options = SupervisorSettings(stop_time=0.03, still_time=0.2)
    for sequence in itertools.product(kinds, repeat=3):
        supervisor = guarded(2, options=options)
        state, last, events = "track", np.zeros(2), set()
        tick = 0
        for joint, name in sequence:
            if name == "stop":
                supervisor.stop("host")
                events.add("stop requested")
            elif name == "reference nan":
                events.add("stop requested")
            else:
                events.add("encoder lost" if name.startswith("encoder") else "torque sensor lost")
            for _ in range(5):
                for j in (0, 1):
                    feed(supervisor, tick, j, name if j == joint else "good")
                supervisor.step(out)
                tick += 1
                assert np.isfinite(out).all()
                assert (np.abs(out) <= 50).all()
                assert (np.abs(out - last) <= 2 + 1e-12).all()
                assert STATES.index(supervisor.state) >= STATES.index(state)
                assert supervisor.apply_brake == (supervisor.state == "safe")
                state, last = supervisor.state, out.copy()
            expected = "track"
            for step in range(len(events) + 1):  # the order of arrival does not matter
                expected = next_state(expected, *events) if step else expected
            assert state == expected
        if state != "track":
            for _ in range(150):  # signals come back: trust does not, and a brake that nobody sees ends
                for j in (0, 1):
                    feed(supervisor, tick, j, "good")
                supervisor.step(out)
                tick += 1
                assert STATES.index(supervisor.state) >= STATES.index(state)
                state = supervisor.state
            if "encoder lost" in events:
                assert state == "safe"
        if state == "safe":
            assert (out == 0).all()
        path = [(d.before, d.after) for d in supervisor.log if d.before != d.after]
        steps = [a for a, _ in path] + [state]  # every change of state has its entry and its reason
        assert steps[0] == "track"
        assert all(b == d for (_, b), (d, _) in itertools.pairwise(path))
        assert not path or path[-1][1] == state
        assert all(d.reason != "none" and d.words for d in supervisor.log)
        assert len(supervisor.log) <= _native.LOG


def test_reset_gives_the_controller_back_as_it_was():
    supervisor, out = guarded(2), np.zeros(2)
    supervisor.controller.set_mode("j1", "bypass")
    for tick in range(20):
        for j in (0, 1):
            feed(supervisor, tick, j, "torque inf" if tick > 4 else "good")
            feed(supervisor, tick, j, "encoder nan" if tick > 10 else "good")
            supervisor.controller.inputs.torque[j] = math.inf if tick > 4 else 0.01 * tick
        supervisor.step(out)
    assert supervisor.state == "safe"
    supervisor.reset()
    assert supervisor.state == "track"
    assert not supervisor.apply_brake
    assert [supervisor.controller.state(j)["mode"] for j in ("j0", "j1")] == ["active", "bypass"]
    assert all(supervisor.controller.state(j)["position_loop"] for j in ("j0", "j1"))
    for tick in range(50):
        for j in (0, 1):
            feed(supervisor, tick, j, "good")
        supervisor.step(out)
    assert supervisor.state == "track"


awkward = st.floats() | st.sampled_from([math.nan, math.inf, -math.inf, 1e300, 5e-324, 0.0, 1.0])


@given(
    st.lists(
        st.tuples(st.lists(awkward, min_size=14, max_size=14), st.integers(-3, 9), st.integers(-3, 9)),
        min_size=1,
        max_size=40,
    ),
    st.integers(0, 3),
    st.booleans(),
)
@settings(max_examples=150, deadline=None)
def test_no_input_gives_a_torque_that_is_not_finite_or_beyond_its_limits(ticks, latency, stop):
    supervisor, out, last, state = guarded(2, latency), np.full(2, np.nan), np.zeros(2), 0
    for values, torque_age, encoder_age in ticks:
        supervisor.controller.core.inputs[:] = np.reshape(values, (7, 2))
        supervisor.torque_age[:], supervisor.encoder_age[:] = torque_age, encoder_age
        if stop:
            supervisor.stop()
        supervisor.step(out)
        assert np.isfinite(out).all()
        assert (np.abs(out) <= 50).all()
        assert (np.abs(out - last) <= 2 * (1 + 1e-12)).all()
        assert STATES.index(supervisor.state) >= state
        last, state = out.copy(), STATES.index(supervisor.state)


# --- the law goes on carrying the load ----------------------------------------------------------------


@given(
    st.floats(0.5, 50),
    st.floats(0.1, 50),
    st.sampled_from([0.0, 3.0]),
    st.sampled_from(["implicit", "explicit"]),
)
@settings(max_examples=40, deadline=None)
def test_the_state_under_a_load_is_the_laws_own_equilibrium(R, D, K, form):
    law = VirtualPassive(R, D, K, 0.2, 1.0)
    block = virtual_passive_block(law, H, form)
    static = R / (1 + R) if K else R * law.a / (D + R * law.a)
    controller, out = Controller(np.array([block]), ["j"], H), np.zeros(1)
    controller.core.preset(0, load_state(block), static)
    controller.inputs.torque[:] = 1.0
    for _ in range(5):
        controller.step(out)
        assert out[0] == pytest.approx(static, rel=1e-6)


class Rig:
    """An elastic arm in MuJoCo under a supervised controller, one tick at a time, for faults of any kind."""

    def __init__(self, robot, controller, reference, payload=0.0, options=None, seed=0, quiet=False):
        self.plant = plant = build(robot, controller.period, [Payload(payload, 0.1)] if payload else [])
        self.supervisor = Supervisor(controller, robot.drives, options)
        self.c, self.d, self.data = controller, plant.drives, mujoco.MjData(plant.model)
        self.index = np.array([robot.index(j) for j in controller.joints])
        self.reference, self.rng, self.noise = reference, np.random.default_rng(seed), 0.0 if quiet else 1.0
        found = settle(plant, controller.joints, controller.blocks, reference.position[0], [])
        self.data.qpos[plant.rotor_qpos] = found.rotor
        self.data.qpos[self.d["spring_qpos"]] = found.deflection
        for i, j in enumerate(self.index):
            controller.core.preset(i, found.states[i], found.torque[j])
        mujoco.mj_forward(plant.model, self.data)
        n = len(self.d)
        tau = -self.d["stiffness"] * found.deflection
        self.motor, self.filter = np.zeros(n), np.stack([tau, 0 * tau])
        self.motor[self.index] = found.torque[self.index]
        self.measured, self.sum, self.z, self.friction = tau, tau * 0, tau * 0, tau * 0
        self.steps, self.tick, self.out = (
            round(controller.period / plant.timestep),
            0,
            np.zeros(len(self.index)),
        )
        self.encoder = self.data.qpos[plant.rotor_qpos].copy()
        self.push = 0.0  # on the links [N m]

    def sense(self):
        """Torque, position, velocity of all joints, as the native runner samples them."""
        qpos, qvel, d = self.data.qpos, self.data.qvel, self.d
        tau = self.sum / self.steps if self.c.sampling == "average" and self.tick else self.measured
        self.sum = 0 * tau
        q, w = qpos[d["rotor_qpos"]].copy(), qvel[d["rotor_dof"]].copy()
        step = d["position_resolution"]
        if step.any():
            q = step * np.floor(q / step + 0.5)
            w = (q - self.encoder) / self.c.period if self.tick else w
        self.encoder = q
        return tau + self.noise * d["sensor_noise"] * self.rng.normal(size=len(tau)), q, w

    def go(self, ticks, fault=None):
        """Runs; fault(rig, torque, position, velocity) may change the samples of the controlled joints."""
        d, plant, inputs = self.d, self.plant, self.c.inputs
        rows = []
        for _ in range(ticks):
            tau, q, w = (x[self.index] for x in self.sense())
            true = (self.data.qpos[d["rotor_qpos"]].copy(), self.data.qvel[d["rotor_dof"]].copy())
            self.supervisor.torque_age[:] = self.supervisor.encoder_age[:] = 0
            if fault:
                fault(self, tau, q, w)
            k = min(self.tick, len(self.reference.position) - 1)
            inputs.torque[:], inputs.position[:], inputs.velocity[:] = tau, q, w
            inputs.position_ref[:] = self.reference.position[k, self.index]
            inputs.velocity_ref[:] = self.reference.velocity[k, self.index]
            self.supervisor.step(self.out)
            for i, j in enumerate(self.index):
                self.motor[j] = self.c.core.joint_state(i)[3]
            for s in range(self.steps):
                self.physics(plant.timestep, k, s)
            rows.append((*true, self.out.copy(), tau))
            self.tick += 1
        return tuple(np.array(x) for x in zip(*rows, strict=True))

    def physics(self, dt, k, s):
        d, data, plant = self.d, self.data, self.plant
        q, w = data.qpos[d["rotor_qpos"]], data.qvel[d["rotor_dof"]]
        moving = self.supervisor.state == "track"
        if moving:  # the other joints' own servos stop with the arm
            self.stop = self.reference.position[k]
        ref, rate = self.stop, self.reference.velocity[k] * moving
        torque = d["servo_kp"] * (ref + s * dt * rate - q) + d["servo_kd"] * (rate - w)
        torque[self.index] = self.motor[self.index]
        torque = np.clip(torque, -d["torque_limit"], d["torque_limit"])
        brake = 0.0
        if self.supervisor.apply_brake:  # a mechanical brake: friction of three times the torque limit
            brake = np.clip(200 * w, -3 * d["torque_limit"], 3 * d["torque_limit"])
        data.qfrc_applied[d["rotor_dof"]] = torque - self.friction - brake + self.push
        data.qfrc_applied[d["spring_dof"]] = self.push
        mujoco.mj_step(plant.model, data)
        e, de, w = data.qpos[d["spring_qpos"]], data.qvel[d["spring_dof"]], data.qvel[d["rotor_dof"]]
        tau = -(d["stiffness"] * e + d["damping"] * de)
        self.z = np.clip(self.z + d["presliding_stiffness"] * w * dt, -d["coulomb"], d["coulomb"])
        self.friction = np.clip(self.z + d["presliding_damping"] * w, -d["coulomb"], d["coulomb"])
        seen = tau
        if d["filtered"].any():
            self.filter = np.einsum("jab,bj->aj", d["filter_a"], self.filter) + (d["filter_b"].T * tau)
            seen = self.filter[0]
        self.sum = self.sum + 0.5 * (self.measured + seen)
        self.measured = seen


def arm(name, controller=None, *, payload=0.0, seed=0, duration=6.0, quiet=False, options=None, still=False):
    robot = Robot.load(name)
    if quiet:
        robot = robot.with_drives({joint: {"torque_noise": 0.0} for joint in robot.joints})
    config = load_controller(controller or name)
    path = multisine(robot.home, duration, config.period, seed, lead_in=0.2)
    if still:
        path = hold(robot.home, duration, config.period)
    c = Controller.from_config(config, robot.drives)
    return Rig(robot, c, path, payload, options, seed, quiet)


def test_the_rig_is_the_simulator():
    rig = arm("k807", "k807-wrist", payload=2.0, quiet=True)
    robot = rig.plant.robot
    q, _, u, _ = rig.go(200)
    expected = run(Scenario(rig.plant, rig.c, rig.reference.until(rig.reference.start + 1.0)))
    assert robot.joints == expected.joints
    np.testing.assert_allclose(q, expected.position, atol=1e-9)
    np.testing.assert_allclose(u, expected.command[:, rig.index], atol=1e-6)
    assert rig.supervisor.state == "track"


# --- no false alarms ----------------------------------------------------------------------------------

ARMS = (("k807", "k807-wrist"), ("fr3", "fr3"), ("iiwa14", "iiwa14"))


@pytest.mark.parametrize(("name", "controller"), ARMS)
@pytest.mark.parametrize("payload", [0.0, 1.5, 3.0])
def test_tracking_raises_no_alarm(name, controller, payload):
    robot, config = Robot.load(name), load_controller(controller)
    plant = build(robot, config.period, [Payload(payload, 0.1)])
    for seed in (round(payload),):
        path = multisine(robot.home, 2.5, config.period, seed, lead_in=0.2, amplitude=0.6)
        recording = run(Scenario(plant, Controller.from_config(config, robot.drives), path, seed=seed))
        supervisor, worst = replay(recording, config, robot, path)
        assert supervisor.state == "track", supervisor.log
        assert worst < 0.8  # the rotor balance, as a part of its limit


@pytest.mark.parametrize("seed", [1])
def test_a_stop_on_request_comes_to_rest_and_stays(seed):
    rig = arm("k807", "k807-wrist", payload=3.0 * seed, seed=seed)
    rig.go(300)
    rig.supervisor.stop()
    _, w, _, _ = rig.go(350)
    assert [d.reason for d in rig.supervisor.log] == ["operator"]
    assert rig.supervisor.state == "torque_brake"
    assert rig.supervisor.stopped
    assert np.abs(w[-100:, rig.index]).max() < 0.02


# --- faults -------------------------------------------------------------------------------------------


def freeze(at, joint, *, speed_too):
    kept = {}

    def fault(rig, tau, q, w):
        if rig.tick >= at:
            kept.setdefault("q", q[joint])
            kept.setdefault("w", w[joint])
            q[joint] = kept["q"]
            w[joint] = 0.0 if speed_too else kept["w"]

    return fault


@pytest.mark.parametrize("name", ["fr3", "iiwa14"])
def test_a_frozen_encoder_is_blamed_at_1_khz_too(name):
    rig = arm(name, payload=1.0, seed=3)
    _, w, _, _ = rig.go(700)
    joint = int(np.abs(w[-1, rig.index]).argmax())
    assert abs(w[-1, joint]) > 0.2
    rig.go(30, freeze(rig.tick, joint, speed_too=True))
    first = rig.supervisor.log[0]
    assert (first.reason, first.joint, first.after) == ("encoder_frozen", rig.c.joints[joint], "torque_brake")
    assert first.tick < 710
    before = rig.supervisor.joint(first.joint)["speed"]
    assert math.copysign(1, before) == math.copysign(1, w[-1, joint])


@pytest.mark.parametrize("speed_too", [True, False])
def test_a_frozen_encoder_is_found_and_the_arm_braked_without_it(speed_too):
    rig = arm("k807", "k807-wrist", payload=1.0, seed=3)
    _, w, _, _ = rig.go(260)
    joint = int(np.abs(w[-1, rig.index]).argmax())
    assert abs(w[-1, rig.index[joint]]) > 0.2
    fault = freeze(rig.tick, joint, speed_too=speed_too)
    start = rig.tick
    _, w, _, _ = rig.go(300, fault)
    first = rig.supervisor.log[0]
    assert first.reason == ("encoder_frozen" if speed_too else "encoder_inconsistent")
    assert (first.joint, first.after) == (rig.c.joints[joint], "torque_brake")
    assert (first.tick - start) * rig.c.period < 0.1
    assert np.abs(w[-50:, rig.index]).max() < 0.05  # stopped by the torque alone
    rig.go(300, fault)
    assert rig.supervisor.log[-1].reason == "blind"  # and, as nobody can see it, held by the brake
    assert rig.supervisor.apply_brake


def test_a_load_that_the_brake_cannot_hold_is_given_to_the_mechanical_brake_at_once():
    """The fr3 without gravity compensation: joint 5 loses its encoder, and joint 4, which is seen, sinks."""
    rig = arm("fr3", payload=3.0, seed=1)
    rig.go(900)

    def lost(rig, tau, q, w):
        q[4] = math.nan

    start, before = rig.tick, rig.data.qpos[rig.d["rotor_qpos"]].copy()
    rig.go(800, lost)
    safe = next(d for d in rig.supervisor.log if d.after == "safe")
    assert safe.reason == "sag"
    assert 0.3 < (safe.tick - start) * H < 1.0  # not 2 s, the stop_time
    assert abs(abs(safe.value) - safe.threshold) < 0.01  # [rad]: at the first tick beyond
    way = np.abs(rig.data.qpos[rig.d["rotor_qpos"]] - before)
    assert way.max() < 0.5


@given(st.floats(0.2, 3.0), st.floats(0.05, 0.5), st.floats(0.01, 0.2))
@settings(max_examples=15, deadline=None)
def test_a_braked_joint_may_move_on_by_its_drift_and_no_more(speed, brake_time, drift):
    options = SupervisorSettings(brake_time=brake_time, drift=drift, stop_time=60.0, still_speed=0.01)
    supervisor, out = guarded(options=options), np.zeros(1)
    supervisor.stop()
    inputs, ticks = supervisor.controller.inputs, 0
    while supervisor.state != "safe" and ticks < 2000:
        ticks += 1
        feed(supervisor, ticks, 0, "good")
        inputs.position[:], inputs.velocity[:] = speed * H * ticks, speed
        # on the rotor's equation, so that no sensor is in doubt
        inputs.torque[:] = out - speed + 1e-3 * (ticks % 2)
        supervisor.step(out)
    said = [d for d in supervisor.log if d.reason == "sag"]
    assert len(said) == 1
    expected = round(brake_time / H) + drift / (speed * H)
    assert abs(ticks - expected) <= 2


@given(st.floats(-2.0, 2.0), st.booleans())
@settings(max_examples=60, deadline=None)
def test_an_encoder_that_stands_while_the_reference_moves_is_lost(speed, alive):
    """However smoothly the rotor moves: friction hides it in the rotor balance."""
    supervisor, out = guarded(), np.zeros(1)
    inputs, limit = supervisor.controller.inputs, float(supervisor.watch["stand"][0])
    for tick in range(400):
        feed(supervisor, tick, 0, "good")
        inputs.position_ref[:] = speed * H * tick
        inputs.position[:] = 1e-5 * (tick % 7 == 0) if alive else 0.0
        inputs.velocity[:] = 0.0
        inputs.torque[:] = out + 1e-3 * (tick % 2)
        supervisor.step(out)
        lost = not alive and abs(speed) * H * tick > limit
        assert (supervisor.state == "track") is not lost
        if lost:
            break
    assert all(d.reason == "encoder_stands" for d in supervisor.log)


@given(st.floats(0.0, 1.0), st.sampled_from([-1.0, 1.0]), st.booleans())
@settings(max_examples=60, deadline=None)
def test_an_encoder_halts_faster_than_any_torque_halts_a_rotor(speed, sign, quantised):
    """Frozen is what stands after a period that no torque explains; a joint that friction stops is not."""
    step = 1e-5 if quantised else 0.0
    drive = replace(DRIVE, position_resolution=step, torque_noise=0.0)
    supervisor, out = guarded(drive=drive), np.zeros(1)
    inputs, watch = supervisor.controller.inputs, supervisor.watch[0]
    q, w, start = 0.0, sign * speed, 200
    for tick in range(start + 10):
        feed(supervisor, tick, 0, "good")
        if tick < start:  # at constant speed, on the rotor's equation
            q += w * H
        inputs.position[:] = inputs.position_ref[:] = round(q / step) * step if step else q
        inputs.velocity[:] = inputs.velocity_ref[:] = w if tick < start else 0.0
        inputs.torque[:] = out - 1.0 * w + 1e-6 * (tick % 2)
        supervisor.step(out)
        if supervisor.state != "track":
            break
    # m w/h, less 10 % that the inertia may be wrong, against friction, bias and the encoder's step
    beyond = (watch["inertia"] - watch["inertia_error"]) * speed - watch["allowance"] - watch["noise_tick"]
    if beyond > 2.0:  # [N m]: what the bound on friction, gain and lag adds
        assert supervisor.log[0].reason == "encoder_frozen"
        assert tick - start <= supervisor.settings.debounce
    if speed < 0.5 * watch["allowance"] / watch["inertia"]:
        assert supervisor.state == "track"


def test_a_joint_that_goes_farther_than_unbraked_is_given_to_the_mechanical_brake_before_its_time():
    """Under a load that the motor does not hold: not after brake_time, at drift beyond the speed it had."""
    options = SupervisorSettings(brake_time=10.0, stop_time=60.0)
    supervisor, out = guarded(options=options), np.zeros(1)
    supervisor.stop()
    inputs, entry, fall = supervisor.controller.inputs, 0.2, 3.0  # [rad/s], [rad/s^2]
    for tick in range(1000):
        feed(supervisor, tick, 0, "good")
        t = H * tick
        speed = entry + fall * t
        inputs.position[:], inputs.velocity[:] = entry * t + 0.5 * fall * t**2, speed
        inputs.torque[:] = out - speed - DRIVE.rotor_inertia * fall + 1e-3 * (tick % 2)
        supervisor.step(out)
        if supervisor.state == "safe":
            break
    assert supervisor.log[-1].reason == "sag"
    assert t == pytest.approx(math.sqrt(2 * options.drift / fall), abs=5 * H)


@pytest.mark.parametrize("name", ["virtual_passive", "pd"])
def test_a_joint_may_stand_while_its_friction_is_turned_round(name):
    """``2 friction / kappa``: a block in equilibrium asks for twice the friction more after that way."""
    stiffness = 60.0
    if name == "pd":
        block, kappa = pd_block(stiffness, 8.0), stiffness
    else:
        block = add_position_loop(virtual_passive_block(LAW, H, "implicit"), stiffness, 8.0)
        static = LAW.R * (LAW.R * LAW.v + LAW.D) / LAW.D  # R_s of K = 0
        kappa = stiffness * static / (1 + static)
    assert stand_of(block, 1.3) == pytest.approx(2 * 1.3 / kappa, rel=1e-9)
    released = virtual_passive_block(LAW, H, "implicit")
    assert stand_of(released, 1.3) == math.inf
    assert supervised_stand(0.01) == 0.01  # unless the user says
    friction = DRIVE.coulomb_friction * (1 + SupervisorSettings().friction_margin)
    if name == "virtual_passive":
        assert supervised_stand(None) == pytest.approx(2 * friction / kappa)


def supervised_stand(stand):
    return float(guarded(options=SupervisorSettings(stand=stand)).watch["stand"][0])


def test_a_slow_motion_that_turns_round_is_no_standing_encoder():
    """The fr3 with a quantised encoder: dry friction holds its joints through 33 mrad of the reference."""
    robot, config = Robot.load("fr3"), load_controller("fr3")
    robot = robot.with_drives({joint: {"position_resolution": 1e-5} for joint in robot.joints})
    time = np.arange(0, 6.0, config.period)
    q = np.array(robot.home) + 0.05 * np.sin(2 * np.pi * time / 6.0)[:, None]
    v = np.gradient(q, config.period, axis=0)
    path = Trajectory(
        position=q, velocity=v, acceleration=np.gradient(v, config.period, axis=0), period=config.period
    )
    controller = Controller.from_config(config, robot.drives)
    scenario = Scenario(
        build(robot, config.period),
        controller,
        path,
        supervisor=SupervisorSettings(),
        gravity_compensation=True,
    )
    recording = run(scenario)
    assert recording.settings["supervisor"]["decisions"] == []
    ways = []
    for angle, reference in zip(recording.position.T, q.T, strict=True):
        turns = np.r_[0, np.flatnonzero(np.diff(angle)) + 1, len(time) - 1]
        ways.append(max(np.ptp(reference[a : b + 1]) for a, b in itertools.pairwise(turns)))
    stand = Supervisor(controller, robot.drives).watch["stand"]
    assert max(ways[:5]) > 0.025  # so that a smaller limit is a false alarm
    assert (np.array(ways) < stand).all()


def jump(at, joint, size, until=10**9):
    def fault(rig, tau, q, w):
        if at <= rig.tick < until:
            q[joint] += size

    return fault


def test_an_encoder_that_jumps_is_lost_but_a_single_outlier_is_bridged():
    rig = arm("fr3", seed=1, options=SupervisorSettings())
    rig.go(300, jump(200, 2, 0.5, until=202))
    assert rig.supervisor.state == "track"
    rig.go(20, jump(300, 2, 0.5))
    first = rig.supervisor.log[0]
    assert (first.reason, first.joint, first.after) == ("encoder_rate", "joint3", "torque_brake")
    assert first.tick < 300 + 4


def test_a_biased_torque_sensor_is_found_and_the_encoders_brake():
    rig = arm("k807", "k807-wrist", payload=1.0, seed=2)
    rig.go(250)

    def bias(rig, tau, q, w):
        tau[1] += 2.0

    _, w, _, _ = rig.go(500, bias)
    first = rig.supervisor.log[0]
    assert (first.reason, first.joint, first.after) == ("torque_residual", "joint6", "encoder_brake")
    assert rig.supervisor.stopped
    assert np.abs(w[-50:, rig.index]).max() < 0.02


def test_both_signals_lost_fade_the_torque_and_close_the_brake():
    rig = arm("k807", "k807-wrist", payload=1.0, seed=2)
    rig.go(250)

    def lost(rig, tau, q, w):
        tau[0], q[2] = math.nan, math.nan

    _, w, u, _ = rig.go(100, lost)
    assert rig.supervisor.state == "safe"
    held = u[1]  # the last torque before SAFE
    assert (np.abs(np.diff(u[1:], axis=0)) <= np.abs(held) * rig.c.period / 0.1 + 1e-9).all()
    assert (u[23:] == 0).all()  # after 0.1 s
    assert np.abs(w[-1, rig.index]).max() < 0.1


def test_the_change_to_the_brake_is_no_larger_than_what_the_law_demands(tmp_path):
    """At rest under a load the torque changes by at most the friction, the creeping share and the noise."""
    for load in (0.0, 3.0, 10.0):
        robot = one_joint(
            tmp_path,
            1.0,
            gravity=9.81,
            mass=2.0,
            lever=load / (2 * 9.81),
            torque_noise=0.02,
            coulomb_friction=0.5,
        )
        c = vpc(robot, 1e-3, 10.0, 40.0, 0.0, kp=60.0, kd=12.0, sampling="point")
        rig = Rig(robot, c, hold([0.0], 2.0, 1e-3))
        _, _, _, tau = rig.go(300)
        rig.supervisor.stop()
        before = rig.out.copy()
        rig.go(1)
        law = VirtualPassive(10.0, 40.0, 0.0, 0.05, 0.6)
        static = 10 * law.a / (40 + 10 * law.a)
        bound = (1 - static) * np.abs(tau).max() + 0.5 + 0.02 * 6 * 2
        assert abs(rig.out[0] - before[0]) <= bound
        assert bound < max(2.5, 0.3 * load)


def test_in_motion_the_bump_is_the_bite_of_the_brake():
    """Beyond the load it carries on, the brake starts with a w: minus that, the torque is continuous."""
    rig = arm("k807", "k807-wrist", payload=1.5, seed=5)
    rig.go(320)
    before, speeds = rig.out.copy(), [rig.supervisor.joint(j)["speed"] for j in rig.c.joints]
    rig.supervisor.stop()
    _, _, u, tau = rig.go(1)
    for i, name in enumerate(rig.c.joints):
        block, drive = rig.c.blocks[i], rig.plant.robot.drives[rig.index[i]]
        bite = block["C"] @ block["warm"] * rig.supervisor.joint(name)["speed"]
        moving = drive.viscous_friction * abs(speeds[i]) + drive.coulomb_friction
        inertial = drive.rotor_inertia * 5  # [N m] at 5 rad/s^2, more than this motion has
        assert abs(u[0, i] - before[i] - bite) <= moving + inertial + 0.1 * abs(tau[0, i]) + 0.2


def test_the_latched_bias_is_the_sensors_and_not_the_load():
    """Moving both ways under gravity with a biased sensor: the estimate is the bias, whatever hangs there."""
    for seed, bias in ((1, -0.25),):
        options = SupervisorSettings(bias_time=1.0)
        rig = arm("k807", "k807-wrist", payload=2.0, seed=seed, duration=12.0, options=options)

        def biased(rig, tau, q, w, bias=bias):
            tau += bias

        rig.go(900, biased)
        rig.supervisor.stop()
        rig.go(2, biased)
        assert rig.supervisor.state == "torque_brake"
        found = [rig.supervisor.joint(j)["bias"] for j in rig.c.joints]
        assert np.sign(found).tolist() == [np.sign(bias)] * 3
        np.testing.assert_allclose(found, bias, atol=0.15)


# --- oscillation --------------------------------------------------------------------------------------


def test_static_feedback_beyond_its_limit_is_found_and_damped(tmp_path):
    """u = K tau with K > 1 drives the joint by itself: found within six cycles of the floor, then damped."""
    robot = one_joint(tmp_path, 0.3, torque_noise=0.02, coulomb_friction=0.1, torque_limit=40.0)
    c = vpc(robot, 1e-3, 10.0, 40.0, 0.0, kp=60.0, kd=12.0, sampling="point")
    c.blocks["nx"] = 0
    c.blocks["C"] = c.blocks["B"] = 0
    c.blocks["D"][0] = [1.02, 0, -60.0, -0.3, 60.0, 0.3, 0, 1]
    c = Controller(c.blocks, c.joints, c.period, c.sampling)
    rig = Rig(robot, c, hold([0.0], 4.0, 1e-3))
    rig.go(50)
    rig.push = 10.0
    rig.go(100)
    rig.push = 0.0
    _, w, _, _ = rig.go(2500)
    assert rig.supervisor.log[0].reason == "oscillation"
    assert rig.supervisor.log[0].after == "encoder_brake"
    assert np.abs(w[-200:]).max() < 0.02


@pytest.mark.filterwarnings("ignore::dashpot.errors.InputWarning")  # its gains are bad on purpose
def test_the_resonant_controller_is_found_with_the_payload_it_resonates_with_only():
    """Fig. 6 (b), tapped at 1.25 s: with 5 lb the tap grows, with 0 and 10 lb it decays."""
    arm, config = setup(), load_controller("k807-resonant")
    controller = Controller.from_config(config, arm.robot.drives)
    for case, reasons in (("0 lb", []), ("5 lb", ["oscillation"]), ("10 lb", [])):
        scenario = replace(_resonance(arm, controller, 0, case), events=[])
        supervisor, _ = replay(run(scenario), config, arm.robot, scenario.trajectory)
        assert [d.reason for d in supervisor.log] == reasons
        if reasons:
            assert supervisor.state == "encoder_brake"
            found = supervisor.log[0].time + scenario.trajectory.start
            assert 1.25 < found < 1.25 + 0.1 + 1.5


def test_a_shaken_arm_is_not_an_oscillating_one(tmp_path):
    """A hand that shakes the joint at 3 Hz puts energy in; the motor takes it out: no alarm."""
    robot = one_joint(tmp_path, 0.3, torque_noise=0.02, coulomb_friction=0.1, torque_limit=20.0)
    c = vpc(robot, 1e-3, 10.0, 40.0, 0.0, kp=60.0, kd=12.0, sampling="point")
    path = hold([0.0], 3.0, 1e-3)
    external = 8 * np.sin(2 * np.pi * 3 * path.time)[:, None]
    recording = run(Scenario(build(robot, 1e-3), c, path, external=external))
    assert np.abs(recording.sample[500:]).max() > 4
    supervisor, _ = replay(recording, None, robot, path, controller=c)
    assert supervisor.state == "track", supervisor.log


# --- settings and deployment --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"speed_limit": 0.0}, "speed_limit [rad/s] = 0.0"),
        ({"stop_time": math.nan}, "stop_time [s]"),
        ({"debounce": 0}, "debounce = 0: must be a whole number, 1 to 16"),
        ({"debounce": 2.0}, "debounce"),
        ({"keep_load": 1}, "keep_load"),
        ({"false_alarms": 1.0}, "false_alarms"),
    ],
)
def test_bad_settings_are_refused_in_one_line(values, said):
    with pytest.raises(InputError) as caught:
        SupervisorSettings(**values)
    assert said in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_a_joint_without_a_drive_and_an_empty_range_are_refused():
    supervisor = guarded()
    with pytest.raises(InputError, match="has no drive"):
        Supervisor(supervisor.controller, [])
    with pytest.raises(InputError, match="lower must be below upper"):
        guarded(limits={"j0": (1.0, 1.0)})
    with pytest.raises(InputError, match="operator"):
        supervisor.stop("weather")


def test_the_range_of_a_joint_is_checked():
    supervisor, out = guarded(limits={"j0": (-1.0, 1.0)}), np.zeros(1)
    for tick in range(10):
        feed(supervisor, tick, 0, "good")
        supervisor.controller.inputs.position[:] = 1.5
        supervisor.step(out)
    first = supervisor.log[0]
    assert (first.reason, first.value, first.threshold, first.unit) == ("encoder_range", 1.5, 1.0, "rad")
    assert str(first) == (
        "0.002 s: j0: the angle is outside the joint's range (1.5 rad, limit 1): track -> torque_brake"
    )


def test_it_is_deployed_with_the_core_alone(tmp_path):
    sources = [str(NATIVE / f"dashpot_{name}.c") for name in ("core", "supervisor")]
    flags = [
        "-std=c99",
        "-pedantic",
        "-Wall",
        "-Wextra",
        "-Werror",
        "-O2",
        "-ffreestanding",
        "-r",
        "-nostdlib",
    ]
    subprocess.run(["cc", *flags, *sources, "-o", "both.o"], cwd=tmp_path, check=True)
    symbols = subprocess.run(
        ["nm", "both.o"], cwd=tmp_path, check=True, capture_output=True, text=True
    ).stdout
    rows = [line.split() for line in symbols.splitlines()]
    assert {row[-1] for row in rows if row[-2] == "U"} <= {"memset", "memcpy"}
    assert not [row for row in rows if row[-2] in "BbDdC"]  # no variables
