"""The port of a sampled joint: closed forms, grid against pencil, soundness against loads that oscillate."""

import math
from dataclasses import replace

import numpy as np
import pytest

from dashpot.certify.index import crossings, hermitian_minimum, minimum, passivity_index, without_integrator
from dashpot.certify.port import Port, lift
from dashpot.drive import Drive
from dashpot.sampled import VirtualPassive, add_position_loop, empty_block, pd_block, virtual_passive_block

WRIST = Drive("w", rotor_inertia=0.05, viscous_friction=0.6, stiffness=6e3, damping=0.7, torque_limit=40)
ELBOW = Drive("e", rotor_inertia=0.6, viscous_friction=2.0, stiffness=1.4e4, damping=5.0, torque_limit=87)


def block_of(drive, form, R, D, K, kp=0.0, kd=0.0, period=0.005, latency=0):
    law = VirtualPassive(R, D, K, drive.rotor_inertia, drive.viscous_friction)
    block = add_position_loop(virtual_passive_block(law, period, form), kp, kd)
    block["latency"] = latency
    return block


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
    ],
)
def test_reference_values_at_200_hz(form, R, D, kp, kd, index):
    found = passivity_index(WRIST, block_of(WRIST, form, R, D, 1.0, kp, kd), "average", 0.005)
    assert found.decided
    assert found.value == pytest.approx(index, rel=0.03)


@pytest.mark.parametrize(("bandwidth", "index"), [(None, -50.9), (400.0, 2.55), (150.0, 4.95)])
def test_a_sensor_filter_makes_point_samples_passive(bandwidth, index):
    block = block_of(ELBOW, "implicit", 10, 60, 6, period=0.001)
    found = passivity_index(replace(ELBOW, sensor_bandwidth=bandwidth), block, "point", 0.001)
    assert found.value == pytest.approx(index, rel=0.03)


def test_without_a_controller_the_index_is_that_of_the_joint():
    """Rotor and transmission alone: min over frequency of Re 1/(1/(m s + v) + s/(k + c s)), at most v."""
    found = passivity_index(WRIST, empty_block(), "average", 0.005)
    s = 1j * 2 * math.pi * np.geomspace(0.01, 1e4, 20000)
    m, v, k, c = WRIST.rotor_inertia, WRIST.viscous_friction, WRIST.stiffness, WRIST.damping
    exact = (1 / (1 / (m * s + v) + s / (k + c * s))).real.min()
    assert found.decided
    assert found.value == pytest.approx(exact, rel=0.02)


def test_energy_is_exact():
    """p from the lifted model equals the finely integrated torque along a random link motion."""
    block, N, fine = block_of(WRIST, "implicit", 10, 3, 1.0, 30.0, 1.0, latency=1), 4, 64
    coarse, dense = (lift(WRIST, block, "average", 0.005, n) for n in (N, N * fine))
    rng = np.random.default_rng(0)
    x, y = np.zeros(len(coarse.A)), np.zeros(len(dense.A))
    for _ in range(50):
        w = rng.normal(size=N)
        dense_w = np.repeat(w, fine)
        p, q = coarse.C @ x + coarse.D @ w, dense.C @ y + dense.D @ dense_w
        np.testing.assert_allclose(p, q.reshape(N, fine).sum(1), atol=1e-9 * np.abs(p).max())
        x, y = coarse.A @ x + coarse.B @ w, dense.A @ y + dense.B @ dense_w


def random_joint(rng):
    drive = replace(
        WRIST,
        rotor_inertia=10 ** rng.uniform(-2, 0),
        viscous_friction=10 ** rng.uniform(-1, 1),
        stiffness=10 ** rng.uniform(3, 4.5),
        damping=10 ** rng.uniform(-1, 1),
    )
    R, D, K = 10 ** rng.uniform(-0.5, 1.3), 10 ** rng.uniform(-0.5, 1.5), rng.choice([0, 0.1, 1.0])
    kp, kd = rng.choice([0.0, 1.0]) * np.array([10 ** rng.uniform(0.5, 2), 10 ** rng.uniform(-1, 1)])
    form, latency = rng.choice(["explicit", "implicit"]), int(rng.integers(3))
    return drive, block_of(drive, form, R, D, K, kp, kd, latency=latency)


def load_loop(port: Port, inertia: float, spring: float) -> float:
    """Spectral radius of the joint with a load: link inertia on a spring to the world.

    The load's velocity is made constant on sub-intervals by the midpoint rule, which keeps it passive: a fair
    partner at any N.
    """
    N, h = port.intervals, port.period / port.intervals
    # Sub-interval by sub-interval: v+ = v - (p + spring * angle part)/J with midpoint velocity w.
    n = len(port.A)
    size = n + 2
    w_rows = np.zeros((N, size))  # w_i from [x, v, q] at the start of the period
    v, q = np.eye(size)[n], np.eye(size)[n + 1]
    for i in range(N):
        # J (v+ - v) = -p_i - spring h (q + h w/2), w = (v + v+)/2, p_i = C_i x + sum_j<=i D_ij w_j
        known = port.C[i] @ np.eye(n, size) + port.D[i, :i] @ w_rows[:i]
        left = 2 * inertia + port.D[i, i] + spring * h * h / 2
        w = (2 * inertia * v - known - spring * h * q) / left
        w_rows[i] = w
        v, q = 2 * w - v, q + h * w
    loop = np.vstack([port.A @ np.eye(n, size) + port.B @ w_rows, v, q])
    return float(np.abs(np.linalg.eigvals(loop)).max())


def test_soundness_where_the_index_is_positive_no_load_oscillates():
    rng = np.random.default_rng(3)
    passes = refuted = refused = 0
    for _ in range(60):
        drive, block = random_joint(rng)
        found = passivity_index(drive, block, "average", 0.005)
        lifted = lift(drive, block, "average", 0.005, 8)
        worst = max(
            load_loop(lifted, J, spring) for J in np.geomspace(1e-4, 30, 60) for spring in (0.0, 10.0, 1e3)
        )
        if found.passive:
            passes += 1
            assert worst < 1 + 1e-7, (drive, block)
        else:
            refused += 1
            refuted += worst > 1 + 1e-7
    assert passes > 10
    assert refused > 10
    assert refuted > 0.6 * refused


def test_grid_and_pencil_agree():
    rng = np.random.default_rng(5)
    for _ in range(15):
        port, _ = without_integrator(lift(*random_joint(rng), "average", 0.005, 8))
        if port is None:
            continue
        value, _, decided = minimum(port)
        dense = hermitian_minimum(port, np.linspace(1e-4, math.pi, 20000)).min()
        if decided:
            assert value <= dense + 1e-3 * abs(dense)
        level = dense + 0.3 * abs(dense) + 1e-3
        assert len(crossings(port, level)) > 0


def test_an_unstable_joint_is_refused_with_the_reason():
    """PD at 200 Hz with far too much velocity gain: unstable with the link held."""
    found = passivity_index(WRIST, pd_block(100.0, 60.0), "average", 0.005)
    assert not found.passive
    assert found.value == -math.inf
    assert "unstable" in found.reason
