"""Scripted faults against independent models, closed forms and conservation laws; runs cut into pieces."""

from __future__ import annotations

import math
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from test_plant import fine, one_joint, torque_source, vpc  # noqa: F401 - a fixture
from test_simulate import same

from dashpot.arm.drive import InnerLoop, Servo
from dashpot.arm.payload import Payload
from dashpot.arm.plant import build, with_payload
from dashpot.arm.robot import Robot
from dashpot.control.controller import Controller, load_controller
from dashpot.control.sampled import empty_block
from dashpot.errors import InputError
from dashpot.simulation.faults import (
    BRAKE_DELAY,
    KINDS,
    NAMES,
    Fault,
    brake_torque,
    short_corner,
    short_damping,
)
from dashpot.simulation.loop import Loop
from dashpot.simulation.recording import CHANNELS
from dashpot.simulation.simulate import Event, PayloadChange, Scenario, run, run_many
from dashpot.simulation.trajectory import Trajectory, hold, multisine

H = 5e-3
SIGNAL = [name for name in NAMES if KINDS[name].acts_on == "signal"]


@pytest.fixture(scope="module")
def k807():
    robot, config = Robot.load("k807"), load_controller("k807-wrist")
    plant = build(robot, H, [Payload(2.27, 0.1)])
    path = multisine(robot.home, 0.5, H, 1, lead_in=0.1)
    return Scenario(plant, Controller.from_config(config, robot.drives), path, seed=3)


@pytest.fixture(scope="module")
def shaken(tmp_path_factory):
    """A joint that is driven by given torques: what its sensors say changes nothing."""
    robot = one_joint(tmp_path_factory.mktemp("shaken"), coulomb_friction=0.2)
    torque = 3 * np.sin(0.15 * np.arange(120.0))[:, None]
    path = Trajectory(H, 0 * torque, torque, 0 * torque, start=-0.1)
    return Scenario(build(robot, H), torque_source(["j"], H), path)


def free(folder, seconds, torque=(), *, J=0.2, **values):
    """A joint without friction and gravity; the torques (ticks,) [N m] are those of its motor."""
    values = {"viscous_friction": 0.0, "damping": 0.0, **values}
    robot = one_joint(folder, J, **values)
    path = hold([0.0], seconds, H)
    path.velocity[: len(torque), 0] = torque
    return Scenario(build(robot, H), torque_source(["j"], H), path)


# --- what is no fault -----------------------------------------------------------------------------

NOTHING = {
    "encoder_jump": 0.0,
    "torque_bias": 0.0,
    "torque_drift": 0.0,
    "torque_scale": 1.0,
    "torque_noise": 0.0,
    "samples_dropped": 0.0,
    "samples_late": 0.0,
    "saturation": 1.0,
    "contact": 0.0,
    "mechanical_brake": 0.0,
}


@pytest.mark.parametrize(
    "faults", [[f] for f in NOTHING] + [list(NOTHING)], ids=lambda f: f[0] if len(f) == 1 else "all"
)
def test_faults_of_no_size_change_no_bit(k807, faults):
    script = [Fault(name, 0.1, value=NOTHING[name]) for name in faults]
    assert same(run(replace(k807, faults=script)), run(k807))


@pytest.mark.parametrize("kind", NAMES)
def test_nothing_happens_before_the_start_and_something_after_it(k807, kind):
    value = 0.01 if kind == "saturation" else None  # the default is not missed in so small a motion
    healthy, failed = run(k807), run(replace(k807, faults=[Fault(kind, 0.2, value=value)]))
    at = round((0.2 - k807.trajectory.start) / H)
    for name in CHANNELS:
        np.testing.assert_array_equal(getattr(failed, name)[:at], getattr(healthy, name)[:at])
    assert not same(failed, healthy)


def test_a_joint_is_healthy_again_after_the_end(shaken):
    faults = [Fault(kind, 0.1, 0.2) for kind in SIGNAL]
    healthy, failed = run(shaken), run(replace(shaken, faults=faults))
    after = round((0.2 + 0.1) / H) + 1  # a tick for the difference quotient
    for name in CHANNELS:
        np.testing.assert_array_equal(getattr(failed, name)[after:], getattr(healthy, name)[after:])


# --- signals --------------------------------------------------------------------------------------


def told(healthy, faults, start):
    """Independent model of the signal path: what is told of a joint, and how old it is."""
    tau, q, w = (getattr(healthy, name)[:, 0].copy() for name in ("sample", "position", "velocity"))
    ticks = np.arange(len(tau))

    def acting(kind):
        for fault in faults:
            if fault.kind == kind:
                first, last = (
                    round((t - start) / H) if math.isfinite(t) else len(tau) for t in (fault.start, fault.end)
                )
                yield (ticks >= first) & (ticks < last), fault.value, ticks - first

    gain = np.ones(len(tau))
    for on, value, _ in acting("torque_scale"):
        gain[on] *= value
    tau *= gain
    for on, value, _ in acting("torque_bias"):
        tau[on] += value
    for on, value, age in acting("torque_drift"):
        tau[on] += value * H * age[on]
    offset = np.zeros(len(tau))
    for on, value, _ in acting("encoder_jump"):
        offset[on] += value
    q += offset
    w += np.diff(offset, prepend=offset[0]) / H
    for kind in ("encoder_frozen", "torque_stuck"):
        held = np.zeros(len(tau), bool)
        for on, _, _ in acting(kind):
            held |= on
        for k in ticks[1:]:
            if kind == "torque_stuck":
                tau[k] = tau[k - 1] if held[k] else tau[k]
            elif held[k]:
                q[k], w[k] = q[k - 1], 0.0
            elif held[k - 1]:
                w[k] = (q[k] - q[k - 1]) / H
        if kind == "encoder_frozen" and held[0]:
            w[0] = 0.0
    lost = np.zeros(len(tau), bool)
    for on, _, _ in acting("encoder_lost"):
        lost |= on
    q[lost] = w[lost] = np.nan
    for on, _, _ in acting("torque_nan"):
        tau[on] = np.nan
    delay, dropped = np.zeros(len(tau), int), np.zeros(len(tau), bool)
    for on, value, _ in acting("samples_late"):
        delay = np.where(on, np.maximum(delay, int(value)), delay)
    for on, value, _ in acting("samples_dropped"):
        dropped |= on & (value == 1)
    source = np.maximum.accumulate(np.where(dropped & (ticks > 0), 0, np.maximum(ticks - delay, 0)))
    seen = np.where(lost[source], -1, source)
    return tau[source], q[source], w[source], ticks - source, ticks - np.maximum.accumulate(seen)


PIECES = {"torque_scale": (-2, 2), "torque_bias": (-3, 3), "torque_drift": (-9, 9), "encoder_jump": (-1, 1)}


@st.composite
def signal_faults(draw):
    faults = []
    for _ in range(draw(st.integers(1, 6))):
        kind = draw(st.sampled_from([name for name in SIGNAL if name != "torque_noise"]))
        value = None
        if kind in PIECES:
            value = draw(st.floats(*PIECES[kind]))
        elif kind == "samples_late":
            value = float(draw(st.integers(0, 64)))
        elif kind == "samples_dropped":
            value = float(draw(st.sampled_from([0, 1])))
        first, length = draw(st.integers(0, 110)), draw(st.integers(1, 120))
        faults.append(Fault(kind, -0.1 + first * H, -0.1 + (first + length) * H, value=value))
    return faults


@settings(
    max_examples=60,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(signal_faults())
def test_the_signal_path_is_that_of_an_independent_model(shaken, faults):
    healthy, loop = run(shaken), Loop(replace(shaken, faults=faults))
    ages = []
    for tick in range(loop.ticks):
        loop.advance(tick + 1)
        ages.append(loop.faults.ages[0])
    failed = loop.recording()
    tau, q, w, torque_age, encoder_age = told(healthy, faults, -0.1)
    for name, expected in (("sample", tau), ("position", q), ("velocity", w)):
        np.testing.assert_allclose(getattr(failed, name)[:, 0], expected, rtol=1e-12, atol=1e-9)
    ages = np.array(ages)
    np.testing.assert_array_equal(ages[:, 0], torque_age)
    known = np.maximum.accumulate(np.isfinite(q))  # before the first position the age has no beginning
    np.testing.assert_array_equal(ages[known, 1], encoder_age[known])
    for name in ("link_position", "torque", "command", "in_effect"):  # and the joint itself feels nothing
        np.testing.assert_array_equal(getattr(failed, name), getattr(healthy, name))


@pytest.mark.parametrize(
    ("fault", "drive"),
    [
        (Fault("torque_bias", 0.0, value=1.5), {"torque_bias": 1.5}),
        (Fault("torque_scale", 0.0, value=1.25), {"torque_scale_error": 0.25}),
        (Fault("torque_noise", 0.0, value=0.3), {"torque_noise": 0.3}),
    ],
)
def test_a_bad_sensor_from_the_start_is_a_drive_with_a_bad_sensor(tmp_path, fault, drive):
    def scenario(**values):
        robot = one_joint(tmp_path, 0.2, gravity=9.81, lever=0.3, torque_resolution=0.01, **values)
        return Scenario(build(robot, H), vpc(robot, H, 5.0, 3.0, 0.5), hold([0.3], 0.5, H), seed=2)

    assert same(run(replace(scenario(), faults=[fault])), run(scenario(**drive)))


def test_rates_of_an_encoder_with_steps_are_difference_quotients_whatever_fails(tmp_path):
    robot = one_joint(tmp_path, position_resolution=1e-4)
    path = hold([0.0], 0.5, H)
    path.velocity[:, 0] = 2.0
    scenario = Scenario(build(robot, H), torque_source(["j"], H), path)
    faults = [Fault("encoder_jump", 0.1, 0.3, value=0.05), Fault("encoder_frozen", 0.2, 0.4)]
    found = run(replace(scenario, faults=faults))
    np.testing.assert_allclose(found.velocity[1:], np.diff(found.position, axis=0) / H, atol=1e-9)
    assert found.velocity.max() > 0.05 / H


def test_dropped_samples_are_as_many_as_asked_for_and_replay_from_the_seed(shaken):
    path = shaken.trajectory
    long = [np.tile(getattr(path, name), (20, 1)) for name in ("position", "velocity", "acceleration")]
    scenario = replace(
        shaken, trajectory=Trajectory(H, *long), faults=[Fault("samples_dropped", 0.0, value=0.3)]
    )
    a, again, b = (run(replace(scenario, seed=seed)) for seed in (1, 1, 2))
    assert same(a, again)
    assert not same(a, b)
    repeats = (np.diff(a.sample[:, 0]) == 0).sum()
    n = len(a.time) - 1
    assert abs(repeats - 0.3 * n) < 5 * math.sqrt(n * 0.3 * 0.7)


def test_the_torque_brake_needs_no_encoder(tmp_path):
    robot = one_joint(tmp_path, gravity=9.81, lever=0.3)
    controller = vpc(robot, H, 5.0, 3.0, 0.5, kp=60.0, kd=4.0)
    release = [Event(0.1, "j", "position_loop", False)]
    scenario = Scenario(build(robot, H), controller, hold([0.3], 0.6, H), release)
    healthy = run(scenario)
    blind = run(replace(scenario, faults=[Fault("encoder_lost", 0.1)]))
    for name in set(CHANNELS) - {"position", "velocity"}:
        np.testing.assert_array_equal(getattr(blind, name), getattr(healthy, name))
    assert np.isnan(blind.position[20:]).all()
    assert np.isnan(blind.velocity[20:]).all()


# --- motors ---------------------------------------------------------------------------------------


def test_a_saturated_motor_is_a_weaker_motor(shaken):
    weak = replace(shaken, plant=build(shaken.plant.robot.with_drives({"j": {"torque_limit": 1.5}}), H))
    share = 1.5 / shaken.plant.robot.drives[0].torque_limit
    a, b = run(weak), run(replace(shaken, faults=[Fault("saturation", -0.1, value=share)]))
    for name in ("link_position", "torque"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    assert np.abs(b.in_effect).max() == pytest.approx(1.5)
    assert np.abs(b.command).max() > 2.9


@pytest.mark.parametrize("inner", [None, InnerLoop(gain=3.0, period=1e-3)])
@pytest.mark.usefixtures("fine")
def test_energy_is_conserved_in_a_brownout_and_not_before(tmp_path, inner):
    scenario = free(tmp_path, 0.6, 20 * np.ones(120), inner_loop=inner)
    rotor = 0.05 * (1 + (inner.gain if inner else 0.0))
    found = run(replace(scenario, faults=[Fault("brownout", 0.05, 0.3)]))
    assert (found.in_effect[10:60] == 0).all()
    assert (found.command[10:60] == 0).all()
    deflection, rate = (
        (a - b)[:, 0]
        for a, b in ((found.link_position, found.position), (found.link_velocity, found.velocity))
    )
    energy = rotor * found.velocity[:, 0] ** 2 + 0.2 * found.link_velocity[:, 0] ** 2 + 6e3 * deflection**2
    assert np.ptp(energy[10:61]) < 0.01 * energy[10:61].mean()
    assert energy[70] > 1.1 * energy[60]  # the motor is back
    assert np.abs(rate[10:61]).max() > 0.1  # and the spring did work meanwhile


def test_after_a_brownout_the_controller_goes_on_where_it_was(tmp_path):
    block = empty_block()
    block["nx"], block["A"][0, 0], block["C"][0] = 1, 1.0, 1e-3
    block["B"][0, 4] = 1.0  # counts ticks: position_ref is 1
    robot = one_joint(tmp_path)
    scenario = Scenario(
        build(robot, H), Controller(np.array([block]), ["j"], H, "point"), hold([1.0], 0.4, H)
    )
    counted = run(scenario).command[:, 0]
    found = run(replace(scenario, faults=[Fault("brownout", 0.1, 0.2)])).command[:, 0]
    assert counted[-1] > counted[0]
    np.testing.assert_array_equal(np.r_[found[:20], found[40:]], counted[:60])
    assert (found[20:40] == 0).all()


@pytest.mark.usefixtures("fine")
def test_shorted_windings_slow_a_joint_as_the_closed_form_says(tmp_path):
    scenario = free(tmp_path, 1.0, np.full(40, 20.0), gear_ratio=40.0)
    drive = scenario.plant.robot.drives[0]
    b, corner, inertia = 1.2, short_corner(drive), 0.25
    assert corner == pytest.approx(2.5)
    found = run(replace(scenario, faults=[Fault("shorted_windings", 0.2, value=b)]))
    assert (found.in_effect[40:] == 0).all()
    speed, time = found.link_velocity[40:, 0], found.time[40:] - 0.2
    speed = (
        0.05 * found.velocity[40:, 0] + 0.2 * speed
    ) / inertia  # of the whole, without the spring's swing
    assert speed[0] > 5 * corner

    def clock(w):  # -(J + m) w' = b w / (1 + (w/w_c)^2), integrated
        return np.log(w) + w**2 / (2 * corner**2)

    np.testing.assert_allclose(clock(speed[0]) - clock(speed), b * time / inertia, rtol=0.02, atol=0.02)


def test_the_default_short_stops_a_bare_rotor_in_its_time_constant_and_any_short_is_stable(tmp_path):
    drive = Robot.load("fr3").drives[0]
    bare = drive.rotor_inertia * (1 + (drive.inner_loop.gain if drive.inner_loop else 0))
    assert short_damping(drive) == pytest.approx(bare / 5e-3)
    scenario = free(tmp_path, 0.5, np.full(20, 20.0), coulomb_friction=0.3)
    found = run(replace(scenario, faults=[Fault("shorted_windings", 0.1, value=1e6)]))
    assert np.abs(found.velocity[40:]).max() < 0.05 * np.abs(found.velocity[:20]).max()


@pytest.mark.usefixtures("fine")
def test_a_mechanical_brake_closes_late_and_then_rubs(tmp_path):
    scenario = free(tmp_path, 0.5, np.r_[np.full(20, 50.0), np.zeros(80)], damping=3.0)
    found = run(replace(scenario, faults=[Fault("mechanical_brake", 0.1, value=4.0)]))
    momentum = 0.05 * found.velocity[:, 0] + 0.2 * found.link_velocity[:, 0]
    dead, closed = 20 + round(BRAKE_DELAY / 2 / H), 20 + round(BRAKE_DELAY / H)
    np.testing.assert_allclose(momentum[20 : dead + 1], momentum[20], rtol=1e-6)
    assert momentum[dead] - momentum[closed] == pytest.approx(4.0 * BRAKE_DELAY / 4, rel=0.05)  # a ramp
    later = closed + 40
    assert momentum[later] > 0
    assert momentum[closed] - momentum[later] == pytest.approx(4.0 * 40 * H, rel=1e-3)


@pytest.mark.parametrize("load", [0.9, 1.1])
def test_a_mechanical_brake_holds_up_to_its_friction_with_the_motor_off(tmp_path, load):
    robot = one_joint(tmp_path, gravity=9.81, lever=0.3, mass=1.0, torque_limit=5.0)
    weight = 9.81 * 0.3
    scenario = Scenario(build(robot, H), torque_source(["j"], H), hold([0.0], 1.0, H))
    scenario.trajectory.velocity[:] = -weight  # holds it while the brake closes
    fault = Fault("mechanical_brake", 0.0, value=weight / load)
    found = run(replace(scenario, faults=[fault]))
    moved = found.position[-1, 0] - found.position[15, 0]
    assert (found.in_effect[11:] == 0).all()
    assert (abs(moved) < 1e-3) == (load < 1)
    if load > 1:
        assert moved > 0.05


def test_the_strongest_brake_and_the_strongest_short_count(tmp_path):
    scenario = free(tmp_path, 0.5, np.full(20, 20.0))
    for kind in ("mechanical_brake", "shorted_windings"):
        one = run(replace(scenario, faults=[Fault(kind, 0.1, value=5.0)]))
        two = run(replace(scenario, faults=[Fault(kind, 0.1, value=5.0), Fault(kind, 0.1, value=2.0)]))
        assert same(one, two)


def test_a_supervisor_may_close_the_brakes(k807):
    joints = k807.plant.robot.joints
    never = Fault("torque_bias", 0.49, value=0.0)
    loop = Loop(replace(k807, faults=[never]))
    loop.advance(60)
    loop.faults.apply_brake = True
    loop.advance()
    assert same(loop.recording(), run(replace(k807, faults=[Fault("mechanical_brake", 0.2)])))
    rotors = np.abs(loop.recording().velocity)
    assert rotors[-1].max() < 0.02 * rotors[60].max()
    assert [brake_torque(d) for d in k807.plant.robot.drives] == [
        2 * d.torque_limit for d in k807.plant.robot.drives
    ]
    assert len(loop.faults.ages) == len(joints)


def test_a_servo_does_not_wind_up_while_its_motor_is_off(tmp_path):
    robot = one_joint(tmp_path, servo=Servo(kp=200.0, kd=10.0, ki=400.0), viscous_friction=3.0)
    late, early = hold([0.0], 3.0, H), hold([0.0], 3.0, H)
    late.position[400:] = early.position[200:] = 1.0  # the step comes with the motor, or while it is off
    healthy = run(Scenario(build(robot, H), None, late))
    found = run(Scenario(build(robot, H), None, early, faults=[Fault("brownout", 0.5, 2.0)]))
    assert (found.in_effect[101:400] == 0).all()
    np.testing.assert_allclose(found.link_position[400:], healthy.link_position[400:], atol=1e-9)
    assert healthy.link_position[-1, 0] == pytest.approx(1.0, abs=0.05)


def test_a_supervisor_is_called_in_the_controllers_place(tmp_path):
    native, program = Path(__file__).parent.parent / "native", tmp_path / "supervised"
    sources = [native / f"dashpot_{name}.c" for name in ("core", "runner", "faults")]
    sources.append(Path(__file__).parent / "supervised.c")
    flags = [
        "-std=c99",
        "-Wall",
        "-Wextra",
        "-Werror",
        "-O1",
        "-fsanitize=undefined",
        "-fno-sanitize-recover",
    ]
    subprocess.run(["cc", *flags, f"-I{native}", *sources, "-lm", "-o", program], check=True)
    done = subprocess.run([program], check=True, capture_output=True, text=True)
    *ages, last = done.stdout.splitlines()
    torque, encoder = np.array([line.split() for line in ages], int).T
    k = np.delete(np.arange(200), [55, 56])  # nobody is called in a brownout
    late = np.where((k >= 10) & (k < 20), k - 9, np.where((k >= 40) & (k < 50), np.minimum(k - 39, 3), 0))
    np.testing.assert_array_equal(torque, late)
    np.testing.assert_array_equal(encoder, np.where((k >= 30) & (k < 35), k - 29, late))
    calls, moving, held, torque_in_effect = map(float, last.split())
    assert calls == 198
    assert moving == pytest.approx(58e-3 / 0.25, rel=0.2)  # 1 N m in 58 of 60 ticks; the link still swings
    assert abs(held) < 0.05 * moving
    assert torque_in_effect == 0  # and the motor is off


# --- contact and payload ---------------------------------------------------------------------------


@pytest.mark.parametrize("direction", [1.0, -1.0])
@pytest.mark.usefixtures("fine")
def test_a_wall_pushes_never_pulls_and_gives_back_less_than_it_took(tmp_path, direction):
    push = np.r_[np.full(20, 30.0), np.zeros(180)] * direction
    scenario = free(tmp_path, 1.0, push, damping=3.0)
    k = 1e3
    found, open_ = (run(replace(scenario, faults=f)) for f in ([Fault("contact", 0.15, value=k)], []))
    angle = direction * found.link_position[:, 0]
    momentum = direction * (0.05 * found.velocity[:, 0] + 0.2 * found.link_velocity[:, 0])
    energy = 0.05 * found.velocity[:, 0] ** 2 + 0.2 * found.link_velocity[:, 0] ** 2
    wall, before = angle[30], energy[30]
    assert (np.diff(momentum[30:]) < 1e-9).all()  # it only ever pushes back
    assert momentum[-1] < 0  # and throws the link off
    assert 0 < angle.max() - wall < 1.05 * math.sqrt(before / k)  # not deeper than the energy carries
    assert energy[-1] < before
    assert angle[-1] < wall
    assert direction * open_.link_position[-1, 0] > angle.max()


def test_a_link_leans_on_a_wall_as_deep_as_its_stiffness_says(tmp_path):
    scenario = free(tmp_path, 3.0, np.full(600, 12.0), viscous_friction=2.0, damping=2.0)
    found = run(replace(scenario, faults=[Fault("contact", 0.1, value=800.0)]))
    assert found.link_position[-1, 0] - found.link_position[20, 0] == pytest.approx(12.0 / 800.0, rel=1e-3)


def test_a_payload_changed_for_itself_changes_no_bit(k807):
    k807.plant.loaded.clear()
    changes = [PayloadChange(0.1, Payload(2.27, 0.1)), PayloadChange(0.3, Payload(2.27, 0.1))]
    assert same(run(replace(k807, payload_changes=changes)), run(k807))


@pytest.mark.usefixtures("fine")
def test_what_is_picked_up_brings_its_energy_and_what_is_lost_takes_it(tmp_path):
    push = np.r_[np.full(20, 10.0), np.zeros(100)]
    scenario = free(tmp_path, 0.6, push)
    changes = [PayloadChange(0.2, Payload(2.0, 0.3)), PayloadChange(0.4)]
    healthy, found = run(scenario), run(replace(scenario, payload_changes=changes))
    radius = (3 * 2.0 / (4 * math.pi * 7850)) ** (1 / 3)
    added = 2.0 * 0.3**2 + 0.4 * 2.0 * radius**2
    ticks = np.arange(len(found.time))
    inertia = np.where((ticks >= 40) & (ticks < 80), 0.2 + added, 0.2)
    link, rotor = found.link_velocity[:, 0], found.velocity[:, 0]
    deflection = (found.link_position - found.position)[:, 0]
    energy = 0.05 * rotor**2 + inertia * link**2 + 6e3 * deflection**2
    momentum = 0.05 * rotor + inertia * link
    for first, last in ((21, 40), (40, 80), (80, 120)):
        assert np.ptp(energy[first:last]) < 0.01 * energy[first]
        np.testing.assert_allclose(momentum[first:last], momentum[first], rtol=1e-6)
    # Up to the change nothing is known of it, and at the change only the load's own momentum comes and goes.
    np.testing.assert_allclose(found.link_velocity[:41], healthy.link_velocity[:41], rtol=1e-6)
    assert momentum[40] - momentum[39] == pytest.approx(added * link[40], rel=1e-5)
    assert momentum[80] - momentum[79] == pytest.approx(-added * link[80], rel=1e-5)


def test_a_heavier_load_is_held_with_its_weight(k807):
    plant, load = k807.plant, Payload(4.5, 0.2)
    path = hold(plant.robot.home, 3.0, H)
    found = run(replace(k807, trajectory=path, payload_changes=[PayloadChange(1.0, load)]))
    before, after = (np.array(found.torque[k]) for k in (199, -1))
    np.testing.assert_allclose(before, plant.load_torque(found.link_position[199]), atol=0.05)
    np.testing.assert_allclose(
        after, with_payload(plant, load, H).load_torque(found.link_position[-1]), atol=0.3
    )
    assert np.abs(after - before).max() > 5


def test_a_load_that_needs_a_shorter_step_gets_it_from_the_start(tmp_path):
    robot = one_joint(tmp_path, 0.2)
    heavy = build(robot, H, [Payload(20.0, 0.5)])
    light = build(robot, H)
    assert light.timestep < heavy.timestep
    found = run(
        Scenario(
            heavy, vpc(robot, H, 5.0, 3.0, 0.5), hold([0.0], 0.2, H), payload_changes=[PayloadChange(0.1)]
        )
    )
    assert found.settings["timestep"] == light.timestep
    assert heavy.model.opt.timestep == heavy.timestep  # the scenario's own plant is left as it was


# --- pieces ---------------------------------------------------------------------------------------


@settings(
    max_examples=15,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(cuts=st.lists(st.integers(1, 119), max_size=6))
def test_a_run_cut_into_pieces_is_the_run(k807, cuts):
    events = [Event(0.2, "joint6", "position_loop", False), Event(0.3, "all", "mode", "bypass")]
    faults = [
        Fault("samples_dropped", 0.0, value=0.3),
        Fault("contact", 0.1, 0.3, "joint6"),
        Fault("mechanical_brake", 0.25, 0.4, "joint7"),
        Fault("samples_late", 0.2, 0.4, "joint5", 3),
        Fault("brownout", 0.35, 0.37),
    ]
    scenario = replace(k807, events=events, faults=faults, payload_changes=[PayloadChange(0.15)])
    loop = Loop(scenario)
    for cut in sorted(cuts):
        loop.advance(cut)
        assert loop.tick == cut
        assert np.isnan(loop.recording().link_position[cut:]).all()
    loop.advance()
    assert same(loop.recording(), run(scenario))


def test_bits_of_faults_and_payloads_do_not_depend_on_threads(k807):
    k807.plant.loaded.clear()
    faults = [Fault("samples_dropped", 0.0, value=0.2), Fault("contact", 0.2), Fault("torque_noise", 0.1)]
    changes = [PayloadChange(0.1, Payload(1.0, 0.1)), PayloadChange(0.3)]
    scenarios = [replace(k807, faults=faults, payload_changes=changes, seed=seed) for seed in range(4)]
    alone = [run(scenario) for scenario in scenarios]
    k807.plant.loaded.clear()
    assert all(map(same, run_many(scenarios, threads=2), alone))
    assert not same(alone[0], alone[1])


# --- safety ---------------------------------------------------------------------------------------


@st.composite
def any_fault(draw):
    kind = draw(st.sampled_from(NAMES))
    about = KINDS[kind]
    joint = "all" if about.acts_on == "arm" else draw(st.sampled_from(["all", "joint5", "joint6", "joint7"]))
    value = None
    if about.quantity and draw(st.booleans()):
        high = 2e4 if kind == "contact" else about.high
        value = draw(st.floats(about.low, high))
        value = float(round(value)) if about.unit == "ticks" else value
    start = draw(st.floats(-0.1, 0.45))
    return Fault(kind, start, start + draw(st.floats(1e-3, 1.0)), joint, value)


@settings(
    max_examples=60,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(faults=st.lists(any_fault(), min_size=1, max_size=8), mass=st.none() | st.floats(0.1, 5))
def test_no_faults_ever_make_a_torque_that_is_not_finite_or_beyond_the_limit(k807, faults, mass):
    change = [PayloadChange(0.2, Payload(mass, 0.1))] if mass else []
    found = run(replace(k807, faults=faults, payload_changes=change))
    assert found.diverged_at is None
    limits = [drive.torque_limit for drive in k807.plant.robot.drives]
    for torque in (found.command, found.in_effect):
        assert np.isfinite(torque).all()
        assert (np.abs(torque) <= limits).all()
    assert np.isfinite(found.link_position).all()


# --- input ----------------------------------------------------------------------------------------


@given(any_fault())
def test_a_fault_survives_its_text_and_its_table(fault):
    assert Fault.from_text(str(fault)) == fault
    assert Fault.from_table(fault.table()) == fault


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"start": 1.0}, "missing key: kind"),
        ({"kind": "encoder_lost"}, "missing key: start"),
        ({"kind": "encoder_lots", "start": 1}, "did you mean 'encoder_lost'?"),
        ({"kind": ["brownout"], "start": 1}, "no such kind of fault"),
        ({"kind": "brownout", "start": 1, "stop": 2}, "unknown key"),
        ({"kind": "brownout", "start": "1"}, "brownout start [s] = '1': must be a number"),
        ({"kind": "brownout", "start": math.nan}, "must be a number"),
        ({"kind": "brownout", "start": math.inf}, "must be finite"),
        ({"kind": "brownout", "start": 2, "end": 2}, "brownout end [s] = 2.0: must be after the start, 2 s"),
        ({"kind": "brownout", "start": 2, "joint": "j"}, "is of the whole arm"),
        ({"kind": "encoder_lost", "start": 2, "joint": 5}, 'must be the name of a joint, or "all"'),
        ({"kind": "encoder_lost", "start": 2, "value": 1}, "takes no value"),
        ({"kind": "saturation", "start": 2, "value": 2}, "value [-] = 2.0: share, must be 0 to 1"),
        ({"kind": "samples_late", "start": 2, "value": 1.5}, "whole number of ticks"),
        ({"kind": "samples_late", "start": 2, "value": 65}, "must be 0 to 64 ticks"),
        ({"kind": "torque_bias", "start": 2, "value": True}, "bias, must be -10000 to 10000 N m"),
        ({"kind": "torque_bias", "start": 2, "value": 10**400}, "bias, must be"),
    ],
)  # fmt: skip
def test_bad_tables_are_named(table, message):
    with pytest.raises(InputError) as caught:
        Fault.from_table(table, file="faults.toml")
    assert str(caught.value).startswith("faults.toml: ")
    assert message in str(caught.value)


@pytest.mark.parametrize(
    "text", ["", "brownout", "brownout@", "@1", "brownout@a", "brownout@1-", "brownout@1=", "brownout:@1"]
)
def test_bad_texts_are_shown_the_form(text):
    with pytest.raises(InputError, match=r"must be KIND\[:JOINT\]@START\[-END\]\[=VALUE\]"):
        Fault.from_text(text)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (Fault("torque_bias", 0.1, joint="joint9"), "'joint9': no such joint"),
        (Fault("torque_bias", 0.1, joint="joint1"), "'joint1': torque_bias: is under the robot's own servo"),
        (
            Fault("torque_bias", 0.6),
            r"torque_bias start \[s\] = 0.6: outside the trajectory, -0.1 to 0.495 s",
        ),
        (Fault("torque_bias", -0.2), "outside the trajectory"),
        (Fault("contact", 0.1, joint="joint5", value=1e7), "at most 4 times the transmission's stiffness"),
        (PayloadChange(0.6), r"payload change \[s\] = 0.6: outside the trajectory"),
        (PayloadChange(math.nan), "outside the trajectory"),
    ],
)
def test_what_does_not_fit_the_run_is_named(k807, change, message):
    key = "faults" if isinstance(change, Fault) else "payload_changes"
    with pytest.raises(InputError, match=message):
        run(replace(k807, **{key: [change]}))


def test_signals_do_not_fail_where_there_is_no_controller(tmp_path):
    robot = one_joint(tmp_path, servo=Servo(kp=200.0, kd=10.0))
    scenario = Scenario(build(robot, H), None, hold([0.0], 0.1, H), faults=[Fault("torque_nan", 0.0)])
    with pytest.raises(InputError, match="no joint has a controller"):
        run(scenario)


def test_too_many_faults_are_refused(k807):
    with pytest.raises(InputError, match="at most 256, counting each joint"):
        run(replace(k807, faults=[Fault("saturation", 0.1)] * 37))


def test_the_documented_table_is_the_table():
    text = (Path(__file__).parent.parent / "docs" / "faults.md").read_text(encoding="utf-8")
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in text.splitlines()
        if line[:3] == "| `"
    ]
    expected = []
    for name, kind in KINDS.items():
        span = f"{kind.low:.4g} to {kind.high:.4g}" if kind.quantity else ""
        unit = f" [{kind.unit}]" if kind.quantity else ""
        expected.append([f"`{name}`", kind.meaning, kind.quantity + unit, span, kind.default_said])
    assert rows == expected
