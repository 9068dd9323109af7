"""The box certificate: the inequalities its proof rests on, and no exception at points inside."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_certify import WRIST, H, block_of, random_joint

from dashpot.certify.box import DRIVE, POINTS, Box, at, certify_box
from dashpot.certify.index import passivity_index
from dashpot.certify.joint import Scales, sampled_joint
from dashpot.certify.port import lift
from dashpot.certify.shadow import with_shadow

UNSURE = replace(
    WRIST,
    uncertainty={"rotor_inertia": 0.15, "viscous_friction": 0.3, "stiffness": 0.15, "damping": 0.3},
    torque_gain_error=0.02,
)


def dissipation(k, c, omega):
    return c * omega**2 / (k**2 + c**2 * omega**2)


@given(
    k=st.tuples(st.floats(1e2, 1e5), st.floats(1, 3)),
    c=st.tuples(st.floats(1e-3, 1e2), st.floats(1, 20)),
    share=st.tuples(st.floats(0, 1), st.floats(0, 1)),
)
def test_one_transmission_dissipates_least(k, c, share):
    """k' = k_max sqrt(c_max/c_min), c' = c_max bounds every (k, c) of the box from below, at every omega."""
    (k_low, k_high), (c_low, c_high) = ((low, low * ratio) for low, ratio in (k, c))
    omega = np.geomspace(1e-2, 1e8, 400)
    inside = dissipation(k_low + share[0] * (k_high - k_low), c_low + share[1] * (c_high - c_low), omega)
    bound = dissipation(k_high * np.sqrt(c_high / c_low), c_high, omega)
    assert (bound <= inside * (1 + 1e-9)).all()


def rotor_driven(joint, drive, motion, fine):
    """Deflection energy books of a joint whose rotor is moved: transmitted torque, motor torque, per step.

    The rotor's speed is held on fine steps; Euler steps of the signal path, independent of the exact lifting.
    """
    n = len(joint.flow)
    dt = joint.period / fine
    m, v = drive.rotor_inertia, drive.viscous_friction
    Y = np.zeros(len(joint.jump))
    torque, motor = [], []
    speed = np.gradient(motion, dt)
    acceleration = np.gradient(speed, dt)
    for i in range(len(motion)):
        if i % fine == 0:
            Y[1] = speed[i]
            if joint.position is not None:
                Y[joint.position] = motion[i]
            Y = joint.jump @ Y
        u = Y[n - 1]
        tau = u - m * acceleration[i] - v * speed[i]
        torque.append(tau)
        motor.append(u)
        Y[n - 2] += dt * tau / joint.period  # the average
    return np.array(torque), np.array(motor)


def test_for_a_given_rotor_motion_torques_are_affine_in_rotor_and_position_loop():
    """The identity the proof between the corners rests on: u and tau at a corner mix like the corners."""
    block = block_of(WRIST, "explicit", 6, 3, 1.0, 40.0, 3.0, latency=1)
    t = np.arange(0, 20 * 40) * H / 40
    motion = 0.1 * np.sin(40 * t) ** 2 * (1 - np.exp(-20 * t))
    corners = list(itertools.product((0.04, 0.06), (0.3, 0.9), (0.9, 1.1)))
    found = {}
    middle = tuple(np.mean([corner[i] for corner in corners]) for i in range(3))
    for m, v, beta in [*corners, middle]:
        drive = replace(WRIST, rotor_inertia=m, viscous_friction=v)
        joint = sampled_joint(drive, block, "average", H, Scales(position=beta))
        found[m, v, beta] = np.array(rotor_driven(joint, drive, motion, 40))
    mixed = np.mean([found[corner] for corner in corners], axis=0)
    np.testing.assert_allclose(found[middle], mixed, atol=1e-9 * np.abs(mixed).max())


def test_the_shadow_is_the_difference_in_torque():
    """Joint and shadow along a link motion: the joint's own part is not disturbed by its shadow."""
    block = block_of(WRIST, "implicit", 6, 3, 1.0, 40.0, 3.0)
    corner = replace(WRIST, rotor_inertia=0.06, viscous_friction=0.9)
    joint = sampled_joint(corner, block, "average", H, Scales(position=1.1))
    shadowed, loss = with_shadow(joint, corner, 0.01, 0.3, 1 - 1.0 / 1.1)
    assert loss is not None
    N = 64
    port = lift(shadowed, N)
    rng = np.random.default_rng(1)
    x, motor = np.zeros(len(port.A)), []
    size = len(joint.jump)
    held = len(joint.flow) - 1
    for _ in range(30):
        motor.append(x)
        x = port.A @ x + port.B @ np.repeat(rng.normal(size=4), N // 4)
    plain, y = lift(joint, N), np.zeros(size)
    rng = np.random.default_rng(1)
    for _ in range(30):
        y = plain.A @ y + plain.B @ np.repeat(rng.normal(size=4), N // 4)
    np.testing.assert_allclose(x[: held + 1], y[: held + 1], rtol=1e-8, atol=1e-10)
    assert np.abs(x[held + 1 :]).max() > 1e-6


def test_a_point_box_agrees_with_the_index():
    rng = np.random.default_rng(7)
    for _ in range(12):
        drive, block = random_joint(rng)
        found = certify_box(drive, block, "average", H)
        nominal = passivity_index(drive, block, "average", H)
        assert found.proven == nominal.passive
        assert found.worst.value == pytest.approx(nominal.value)


def test_no_point_of_a_proven_box_fails():
    rng = np.random.default_rng(11)
    proven = 0
    while proven < 5:
        drive, block = random_joint(rng)
        half = {name: rng.uniform(0, 0.3) for name in DRIVE}
        drive = replace(drive, uncertainty=half, torque_gain_error=rng.uniform(0, 0.04))
        latency = int(block["latency"]) + int(rng.integers(2))
        if not passivity_index(drive, block, "average", H).passive:
            continue
        found = certify_box(drive, block, "average", H, latency)
        if not found.proven:
            assert not found.worst.passive
            there, scales = at(drive, found.point)
            assert not passivity_index(there, block, "average", H, scales).passive
            continue
        proven += 1
        box = Box.of(drive, block, latency)
        for _ in range(20):
            point = {name: rng.uniform(*box.ranges[name]) for name in POINTS}
            point["latency"] = float(rng.integers(box.ranges["latency"][0], latency + 1))
            there, scales = at(drive, point)
            inside = passivity_index(there, block, "average", H, scales)
            assert inside.passive, (drive, block, point)
            assert inside.value >= 0.9 * found.worst.value


def test_worst_point_is_named():
    found = certify_box(UNSURE, block_of(WRIST, "explicit", 3, 3, 1.0), "average", H)
    assert not found.proven
    assert found.worst.value == pytest.approx(-0.087, rel=0.02)
    assert found.point["rotor_inertia"] == pytest.approx(0.85 * WRIST.rotor_inertia)
    assert found.point["torque_gain"] == pytest.approx(1.02)
    calm = certify_box(UNSURE, block_of(WRIST, "explicit", 1, 1, 1.0), "average", H)
    assert calm.proven
    assert calm.worst.value == pytest.approx(0.49, rel=0.01)


def test_longer_latency_is_part_of_the_box():
    block = block_of(WRIST, "explicit", 3, 3, 1.0)
    assert certify_box(WRIST, block, "average", H).proven
    late = certify_box(WRIST, block, "average", H, 3)
    assert not late.proven
    assert late.point["latency"] > 0


def test_without_transmission_damping_nothing_is_certified():
    """Without c the port has no damping at high frequency and any torque feedback takes some away."""
    found = certify_box(replace(WRIST, damping=0.0), block_of(WRIST, "implicit", 1, 1, 0.0), "average", H)
    assert not found.proven


def test_link_friction_counts_where_the_transmission_is_known():
    block = block_of(WRIST, "explicit", 10, 3, 1.0)
    held = replace(WRIST, link_friction=1.0)
    assert not certify_box(WRIST, block, "average", H).proven
    assert certify_box(held, block, "average", H).proven
    unsure = replace(held, uncertainty={"rotor_inertia": 0.03, "viscous_friction": 0.05})
    found = certify_box(unsure, block, "average", H)
    assert found.proven
    # For given torque it is convex in the torque's scale: the ends of that prove nothing.
    assert not certify_box(replace(held, torque_gain_error=0.001), block, "average", H).proven
    rng, box = np.random.default_rng(0), Box.of(unsure, block)
    for _ in range(30):
        there, scales = at(unsure, {name: rng.uniform(*box.ranges[name]) for name in POINTS})
        assert passivity_index(there, block, "average", H, scales).passive
