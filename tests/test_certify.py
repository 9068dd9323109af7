"""The certificate of one joint: reference values, laws, grid against exact test, loads that oscillate."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dashpot.arm.drive import Drive
from dashpot.certify.counterexample import counterexample
from dashpot.certify.exact import at_rest, crossings, quadratic_form, storage
from dashpot.certify.index import GRID, passivity_index, settled
from dashpot.certify.joint import Scales, sampled_joint
from dashpot.certify.loads import GRAVITY, Load, loops, oscillation, radii
from dashpot.certify.port import lift
from dashpot.control.sampled import (
    VirtualPassive,
    add_position_loop,
    empty_block,
    pd_block,
    virtual_passive_block,
)
from dashpot.errors import InputError

WRIST = Drive("w", rotor_inertia=0.05, viscous_friction=0.6, stiffness=6e3, damping=0.7, torque_limit=40)
ELBOW = Drive("e", rotor_inertia=0.6, viscous_friction=2.0, stiffness=1.4e4, damping=5.0, torque_limit=87)
H = 0.005
INERTIAS = np.geomspace(1e-4, 50, 300)


def block_of(drive, form, R, D, K, kp=0.0, kd=0.0, period=H, latency=0):
    law = VirtualPassive(R, D, K, drive.rotor_inertia, drive.viscous_friction)
    block = add_position_loop(virtual_passive_block(law, period, form), kp, kd)
    block["latency"] = latency
    return block


def random_joint(rng):
    def around(centre):
        return centre * 10 ** rng.uniform(-1, 1)

    drive = replace(
        WRIST,
        rotor_inertia=around(0.1),
        viscous_friction=around(1.0),
        stiffness=around(8e3),
        damping=around(2.0),
    )
    kp, kd = rng.choice([0.0, 1.0]) * np.array([around(30), around(3)])
    form, latency = rng.choice(["explicit", "implicit"]), int(rng.integers(4))
    K = rng.choice([0.0, around(1.0)])
    return drive, block_of(drive, form, around(3), around(5), K, kp, kd, latency=latency)


@pytest.mark.parametrize(
    ("form", "R", "D", "kp", "kd", "index"),
    [
        ("explicit", 1, 1, 0, 0, 0.70),
        ("explicit", 3, 3, 0, 0, 0.70),
        ("explicit", 6, 3, 0, 0, 0.44),
        ("explicit", 10, 1, 0, 0, 0.315),
        ("explicit", 10, 3, 0, 0, -0.58),
        ("implicit", 10, 3, 0, 0, 0.70),
        ("explicit", 1, 1, 60, 1, -0.78),
        ("explicit", 3, 3, 60, 4, 0.65),
    ],
)
def test_reference_values_at_200_hz(form, R, D, kp, kd, index):
    found = passivity_index(WRIST, block_of(WRIST, form, R, D, 1.0, kp, kd), "average", H)
    assert found.decided
    assert found.passive == (index > 0)
    assert found.value == pytest.approx(index, rel=0.03)


@pytest.mark.parametrize(
    ("drive", "period", "gains", "bandwidth", "index"),
    [
        (ELBOW, 0.001, (10, 60, 6), 400.0, 2.55),
        (ELBOW, 0.001, (10, 60, 6), 150.0, 4.95),
        (WRIST, 0.005, (3, 2.5, 0.25), 150.0, -6.3),
        (WRIST, 0.005, (3, 2.5, 0.25), 50.0, 0.40),
    ],
)
def test_reference_values_behind_a_sensor_filter(drive, period, gains, bandwidth, index):
    block = block_of(drive, "implicit", *gains, period=period)
    found = passivity_index(replace(drive, sensor_bandwidth=bandwidth), block, "point", period)
    assert found.decided
    assert found.value == pytest.approx(index, rel=0.03)


@pytest.mark.parametrize(
    ("drive", "period", "gains", "index"),
    [(ELBOW, 0.001, (10, 60, 6), -50.0), (WRIST, 0.005, (3, 2.5, 0.25), -23.0)],
)
def test_bare_point_samples_are_never_certified(drive, period, gains, index):
    found = passivity_index(drive, block_of(drive, "implicit", *gains, period=period), "point", period)
    assert not found.passive
    assert "average the torque" in found.reason
    assert found.value == pytest.approx(index, rel=0.03)
    # Even where that value is positive: the sample follows the velocity of the link without delay.
    gentle = passivity_index(WRIST, block_of(WRIST, "implicit", 1e-3, 50.0, 0.0), "point", H)
    assert gentle.value > 0
    assert not gentle.passive


def test_averages_of_the_same_joints():
    for drive, period, gains, index in (
        (ELBOW, 0.001, (10, 60, 6), 5.0),
        (WRIST, 0.005, (3, 2.5, 0.25), 0.70),
    ):
        block = block_of(drive, "implicit", *gains, period=period)
        assert passivity_index(drive, block, "average", period).value == pytest.approx(index, rel=0.03)


def test_without_a_controller_the_index_is_that_of_the_joint():
    """Rotor and transmission alone: min over frequency of Re (k + c s)(m s + v) / (m s^2 + (v + c) s + k)."""
    found = passivity_index(WRIST, empty_block(), "average", H)
    s = 1j * 2 * math.pi * np.geomspace(0.01, 1e4, 20000)
    m, v, k, c = WRIST.rotor_inertia, WRIST.viscous_friction, WRIST.stiffness, WRIST.damping
    exact = ((k + c * s) * (m * s + v) / (m * s**2 + (v + c) * s + k)).real.min()
    assert found.value == pytest.approx(exact, rel=3e-3)


def test_energy_is_exact():
    """p from the lifted model equals the finely integrated torque along a random link motion."""
    joint = sampled_joint(WRIST, block_of(WRIST, "implicit", 10, 3, 1.0, 30.0, 1.0, latency=1), "average", H)
    N, fine = 4, 64
    coarse, dense = lift(joint, N), lift(joint, N * fine)
    rng = np.random.default_rng(0)
    x, y = np.zeros(len(coarse.A)), np.zeros(len(dense.A))
    for _ in range(50):
        w = rng.normal(size=N)
        dense_w = np.repeat(w, fine)
        p, q = coarse.C @ x + coarse.D @ w, dense.C @ y + dense.D @ dense_w
        np.testing.assert_allclose(p, q.reshape(N, fine).sum(1), atol=1e-9 * np.abs(p).max())
        x, y = coarse.A @ x + coarse.B @ w, dense.A @ y + dense.B @ dense_w


def test_grid_and_exact_test_agree():
    """More sub-intervals only lower the index, towards the exact one; a level between is crossed."""
    rng = np.random.default_rng(5)
    compared = 0
    for _ in range(25):
        drive, block = random_joint(rng)
        found = passivity_index(drive, block, "average", H)
        if not math.isfinite(found.value):
            continue
        joint = sampled_joint(drive, block, "average", H)
        rest = at_rest(joint)
        values = [settled(joint, rest, N).least_damping(GRID).min() for N in (4, 8, 16)]
        assert values[0] >= values[1] * (1 - 1e-9) >= values[2] * (1 - 1e-9) - 1e-9
        assert found.value <= values[2] + 1e-3 * abs(values[2])
        form = quadratic_form(joint, found.value - 1e-3 * abs(found.value), rest)
        assert form is not None
        assert len(crossings(form)) == 0
        assert storage(form) is not None
        above = quadratic_form(joint, values[0] + 0.1 * abs(values[0]), rest)
        assert above is None or len(crossings(above)) > 0
        compared += 1
    assert compared > 12


def test_taking_the_equilibria_out_leaves_the_damping():
    """The position loop's pole at z = 1 only adds to the imaginary part of the port."""
    joint = sampled_joint(WRIST, block_of(WRIST, "explicit", 3, 3, 1.0, 60.0, 4.0), "average", H)
    angles = np.geomspace(0.01, 3, 40)
    port = lift(joint, 8)
    without = settled(joint, at_rest(joint), 8)
    np.testing.assert_allclose(without.least_damping(angles), port.least_damping(angles), rtol=1e-6)
    assert np.abs(np.linalg.eigvals(port.A)).max() == pytest.approx(1)
    assert np.abs(np.linalg.eigvals(without.A)).max() < 0.9999


def test_storage_function_balances_energy():
    """P from the exact test: along any link motion stored energy rises at most by the energy put in."""
    joint = sampled_joint(WRIST, block_of(WRIST, "explicit", 6, 3, 1.0), "average", H)
    form = quadratic_form(joint, 0.0, at_rest(joint))
    P = storage(form)
    port, rng = lift(joint, 16), np.random.default_rng(2)
    x = np.zeros(len(port.A))
    for _ in range(200):
        w = rng.normal(size=16) * rng.choice([0.0, 1.0])
        energy = (port.C @ x + port.D @ w) @ w
        after = port.A @ x + port.B @ w
        # x' P x is what can still be got out, but for the sign, and without the spring's energy.
        stored = [(form.spring * y[0] ** 2 - form.power * (y @ P @ y)) / 2 for y in (x, after)]
        assert stored[1] - stored[0] <= energy + 1e-9 * abs(energy) + 1e-12
        x = after


def test_a_slow_virtual_spring_does_not_fool_the_storage_function():
    """Its pole, K h/D from z = 1, makes a Riccati residual of 1e-7 look like a solution."""
    drive = Drive(
        "j",
        rotor_inertia=1.5457450483168422,
        viscous_friction=10.907275625097746,
        stiffness=2979.628470988445,
        damping=3.3082380223500736,
        torque_limit=87,
    )
    law = VirtualPassive(
        0.4111786660920488, 3.1395954171263805, 0.0032077247287847356, drive.rotor_inertia, 0.3
    )
    block = add_position_loop(
        virtual_passive_block(law, 0.001, "implicit"), 180.73094081982808, 0.0944613103181006
    )
    joint = sampled_joint(drive, block, "average", 0.001)
    assert lift(joint, 8).least_damping(np.geomspace(1e-5, 1, 400)).min() < -0.01
    assert storage(quadratic_form(joint, 0.0, at_rest(joint))) is None
    assert not passivity_index(drive, block, "average", 0.001).passive


@given(scale=st.floats(0.05, 50), slower=st.floats(0.4, 3))
def test_units_scale_the_index(scale, slower):
    """Torque in another unit scales the index; time in another unit, with everything else, too."""
    drive = replace(
        WRIST,
        rotor_inertia=WRIST.rotor_inertia * scale * slower,
        viscous_friction=WRIST.viscous_friction * scale,
        stiffness=WRIST.stiffness * scale / slower,
        damping=WRIST.damping * scale,
    )
    law = VirtualPassive(6, 3 * scale, scale / slower, drive.rotor_inertia, drive.viscous_friction)
    found = passivity_index(drive, virtual_passive_block(law, H * slower, "explicit"), "average", H * slower)
    assert found.value == pytest.approx(scale * 0.439, rel=2e-3)


def test_link_friction_adds_to_the_index_and_link_inertia_does_not():
    """An inertia neither dissipates nor gives out energy: Re (Z + J s) = Re Z."""
    block = block_of(WRIST, "explicit", 10, 3, 1.0)
    plain = passivity_index(WRIST, block, "average", H)
    vouched = passivity_index(replace(WRIST, link_friction=1.0, link_inertia=5.0), block, "average", H)
    assert vouched.value == pytest.approx(plain.value + 1.0, abs=1e-9)
    assert vouched.passive
    assert not plain.passive


def test_latency_of_the_block_and_of_the_path():
    """An implicit block does not look at the torque in effect: latency is the same wherever it sits."""
    assumed = passivity_index(WRIST, block_of(WRIST, "implicit", 6, 3, 1.0, latency=2), "average", H)
    assert assumed.value < 0.6
    block = block_of(WRIST, "implicit", 6, 3, 1.0)
    for found in (
        passivity_index(WRIST, block, "average", H, Scales(latency=2)),
        passivity_index(replace(WRIST, torque_latency=2 * H), block, "average", H),
    ):
        assert found.value == pytest.approx(assumed.value, rel=1e-6)
    with pytest.raises(InputError, match=r"is 0\.5 periods; the certificate covers whole ones"):
        passivity_index(
            replace(WRIST, torque_latency=H / 2), block_of(WRIST, "implicit", 3, 3, 1), "average", H
        )


def test_an_unstable_joint_is_refused_with_the_reason():
    """PD at 200 Hz with far too much velocity gain: unstable with the link held."""
    found = passivity_index(WRIST, pd_block(100.0, 60.0), "average", H)
    assert not found.passive
    assert found.value == -math.inf
    assert "unstable" in found.reason
    pushing = passivity_index(WRIST, pd_block(-10.0, 1.0), "average", H)
    assert pushing.reason == "the position loop pushes the link away"


def test_soundness_where_the_index_is_positive_no_load_oscillates():
    rng = np.random.default_rng(3)
    J, spring = (grid.ravel() for grid in np.meshgrid(np.geomspace(1e-4, 50, 60), [0.0, 10.0, 1e3, 1e4]))
    passes = refused = refuted = 0
    for _ in range(60):
        drive, block = random_joint(rng)
        found = passivity_index(drive, block, "average", H)
        assert found.decided
        joint = sampled_joint(drive, block, "average", H)
        if found.passive:
            passes += 1
            assert radii(joint, J, spring).max() < 1 + 1e-9, (drive, block)
        else:
            refused += 1
            refuted += counterexample(joint, drive) is not None
    assert passes > 8
    assert refuted >= 0.8 * refused


def window(joint):
    unstable = INERTIAS[radii(joint, INERTIAS, 0 * INERTIAS) > 1 + 1e-9]
    return unstable.min(), unstable.max()


def test_windows_of_inertia_that_oscillate():
    """High gains oscillate in a narrow window of light loads, a position loop at middle loads only."""
    low, high = window(sampled_joint(WRIST, block_of(WRIST, "explicit", 10, 3, 1.0), "average", H))
    assert (low, high) == pytest.approx((0.0238, 0.0287), rel=0.05)
    low, high = window(sampled_joint(WRIST, block_of(WRIST, "explicit", 1, 1, 1.0, 60, 1), "average", H))
    assert (low, high) == pytest.approx((0.168, 4.09), rel=0.05)


def test_loop_with_a_load_is_that_of_fine_integration():
    """The loop's transition against many small steps of the same equations with point values held."""
    load = Load("inertia and spring", 0.3, 40.0)
    block = block_of(WRIST, "explicit", 3, 3, 1.0, 20.0, 1.0, latency=1)
    joint = sampled_joint(WRIST, block, "average", H)
    n, steps = len(joint.flow), 4000
    units = np.append(joint.units, [1.0, H])
    loop = loops(joint, np.array([load.inertia]), np.array([load.stiffness]))[0] * units[:, None] / units
    state = np.random.default_rng(0).normal(size=len(units)) * units
    Y, w, q = joint.jump @ state[:-2], state[-2], state[-1]
    dt = H / steps
    for _ in range(steps):
        half_Y, half_w, half_q = Y, w, q
        for part in (0.5, 1.0):  # explicit midpoint
            torque = joint.torque @ half_Y[:n] + joint.torque_w * half_w
            rate = joint.flow @ half_Y[:n] + joint.velocity_in * half_w
            step_w = (torque - load.stiffness * half_q) / load.inertia
            step_q = half_w
            half_Y = Y.copy()
            half_Y[:n] += part * dt * rate
            half_w, half_q = w + part * dt * step_w, q + part * dt * step_q
        Y, w, q = half_Y, half_w, half_q
    np.testing.assert_allclose(loop @ state / units, np.append(Y, [w, q]) / units, rtol=1e-5, atol=1e-5)


@given(mass=st.floats(0.1, 30), length=st.floats(0.05, 1.5))
def test_pendulums_know_their_payload(mass, length):
    load = Load.pendulum(mass, length)
    assert load.payload == pytest.approx((mass, length))
    swing = oscillation(sampled_joint(WRIST, pd_block(0.0, 0.0), "average", H), load)
    assert swing.growth < 0
    assert load.stiffness / load.inertia == pytest.approx(GRAVITY / length)
