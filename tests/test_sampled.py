"""Laws of the sampled joint block: exactness, Tustin, static gain, stability, energy, position loop."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import cont2discrete

from dashpot.control.law import TorqueFeedbackLaw
from dashpot.control.sampled import (
    BLOCK_DTYPE,
    IN_EFFECT,
    NW,
    POSITION,
    POSITION_REF,
    TORQUE,
    TORQUE_REF,
    VELOCITY,
    VELOCITY_REF,
    VirtualPassive,
    add_position_loop,
    empty_block,
    pd_block,
    virtual_passive_block,
)

FORMS = ("explicit", "implicit")
laws = settings(max_examples=30, deadline=None)


def decades(low, high):
    return st.floats(np.log10(low), np.log10(high)).map(lambda x: 10.0**x)


gains = st.builds(
    VirtualPassive,
    R=decades(0.05, 50),
    D=decades(1e-2, 200),
    K=st.just(0.0) | decades(1e-3, 1e3),
    m=decades(1e-2, 5),
    v=st.just(0.0) | decades(1e-2, 20),
)
periods = decades(5e-4, 1e-2)
seeds = st.integers(0, 2**32 - 1)


def run(block, w, x=None):
    """Output of the linear block for w (ticks, NW)."""
    n = int(block["nx"])
    x = np.zeros(n) if x is None else x
    A, B, C, D = block["A"][:n, :n], block["B"][:n], block["C"][:n], block["D"]
    out = []
    for row in w:
        out.append(C @ x + D @ row)
        x = A @ x + B @ row
    return np.array(out), x


def transfer(block, z, column):
    n = int(block["nx"])
    A, B, C = block["A"][:n, :n], block["B"][:n, column], block["C"][:n]
    return C @ np.linalg.solve(z * np.eye(n) - A, B) + block["D"][column]


def feedback(block, z, latency=0):
    """u/tau with the block's own torque in effect."""
    G, H = transfer(block, z, TORQUE), transfer(block, z, IN_EFFECT)
    return G / (1 - H * z ** -(latency + 1))


def continuous(p):
    """Eqs. (20)-(21), written out again: input tau - u', output u."""
    A = np.array([[0.0, 1.0], [-p.K / (p.R * p.m), -p.D / (p.R * p.m)]])
    return A, np.array([[0.0], [1 / p.m]]), np.array([[p.K, p.R * p.v + p.D]])


def static_gain(p):
    return p.R / (1 + p.R) if p.K > 0 else p.R * p.a / (p.D + p.R * p.a)


# --- discretisation --------------------------------------


@laws
@given(gains, periods, seeds)
def test_explicit_form_is_the_exact_zero_order_hold(p, h, seed):
    A, B, C = continuous(p)
    Ad, Bd, *_ = cont2discrete((A, B, C, np.zeros((1, 1))), h, "zoh")
    w = np.zeros((60, NW))
    w[:, [TORQUE, IN_EFFECT]] = np.random.default_rng(seed).normal(size=(60, 2))
    x, expected = np.zeros(2), []
    for row in w:  # both inputs were held over the period that ends at the tick
        x = Ad @ x + Bd[:, 0] * (row[TORQUE] - row[IN_EFFECT])
        expected.append(C[0] @ x)
    u, _ = run(virtual_passive_block(p, h, "explicit"), w)
    np.testing.assert_allclose(u, expected, rtol=1e-8, atol=1e-9 * np.abs(expected).max())


@laws
@given(gains, periods)
def test_implicit_form_is_tustin_of_the_law(p, h):
    block = virtual_passive_block(p, h, "implicit")
    law = TorqueFeedbackLaw(p.m, p.v, p.R, p.D, p.K)
    for wh in (1e-3, 1e-2, 0.1, 0.5, 1.5, 3.0):
        s = 2j / h * np.tan(wh / 2)
        assert transfer(block, np.exp(1j * wh), TORQUE) == pytest.approx(law.C(s)[0], rel=1e-7)
    assert not block["B"][:, IN_EFFECT].any()
    assert block["D"][IN_EFFECT] == 0


@laws
@given(gains, periods, st.sampled_from(FORMS), st.integers(0, 3))
def test_static_gain(p, h, form, latency):
    block = virtual_passive_block(p, h, form)
    assert feedback(block, 1.0, latency) == pytest.approx(static_gain(p), rel=1e-5)


@laws
@given(gains, periods)
def test_forms_agree_at_low_frequency(p, h):
    wh = 1e-3
    explicit, implicit = (feedback(virtual_passive_block(p, h, form), np.exp(1j * wh)) for form in FORMS)
    # half a sample from the hold, one from the delay of u': both of first order in wh
    assert abs(explicit / implicit - 1) < 3 * wh * (1 + abs(implicit))


@laws
@given(gains, periods, st.sampled_from(FORMS), seeds)
def test_block_is_linear(p, h, form, seed):
    rng = np.random.default_rng(seed)
    block = add_position_loop(virtual_passive_block(p, h, form), *rng.uniform(0, 50, 2))
    w, b = rng.normal(size=(2, 40, NW)), rng.normal(size=2)
    u = [run(block, row)[0] for row in w]
    both, _ = run(block, np.tensordot(b, w, 1))
    assert both == pytest.approx(b @ np.array(u), abs=1e-9 * (1 + np.abs(u).max()))


@laws
@given(gains, periods, st.sampled_from(FORMS))
def test_block_is_stable(p, h, form):
    block = virtual_passive_block(p, h, form)
    n = int(block["nx"])
    assert n == (2 if p.K else 1)
    # only the slowest pole, K/D, comes within rounding of the unit circle
    assert np.abs(np.linalg.eigvals(block["A"][:n, :n])).max() < 1 + 1e-12


@laws
@given(gains, periods, seeds)
def test_implicit_gain_stays_below_one(p, h, seed):
    p = VirtualPassive(p.R, max(p.D, np.sqrt(p.R * p.m * p.K)), p.K, p.m, p.v)
    block = virtual_passive_block(p, h, "implicit")
    z = np.exp(1j * np.concatenate([np.geomspace(1e-6, np.pi, 60), [np.pi]]))
    assert max(abs(transfer(block, zi, TORQUE)) for zi in z) < 1
    w = np.zeros((200, NW))
    w[:, TORQUE] = np.random.default_rng(seed).normal(size=200)
    u, _ = run(block, w)
    assert (u**2).sum() <= (w**2).sum()  # the same in the time domain: no more energy than was put in


# --- energy ----------------------------------------------


@laws
@given(gains, periods, seeds)
def test_implicit_form_keeps_an_exact_energy_balance(p, h, seed):
    """S = 1/2 R m xc'^2 + 1/2 (1+R) K xc^2: dS = h (R tau xc' - (D + R a) xc'^2), all at mid-step."""
    block = virtual_passive_block(p, h, "implicit")
    n = int(block["nx"])
    A, B, C = p.continuous()
    gamma = np.linalg.solve(np.eye(n) - h / 2 * A, B * h / 2)
    tau, x, states = np.random.default_rng(seed).normal(size=100), np.zeros(n), []
    w = np.zeros(NW)
    for w[TORQUE] in tau:
        u = block["C"][:n] @ x + block["D"] @ w
        states.append(x + gamma * (w[TORQUE] - u))  # [xc, xc'] of Eqs. (20)-(21) at the tick
        assert C @ states[-1] == pytest.approx(u, abs=1e-9)
        x = block["A"][:n, :n] @ x + block["B"][:n] @ w
    xd = np.array(states)[:, -1]
    xc = np.array(states)[:, 0] if n == 2 else 0 * xd
    S = 0.5 * p.R * p.m * xd**2 + 0.5 * (1 + p.R) * p.K * xc**2
    mid, load = (xd[1:] + xd[:-1]) / 2, (tau[1:] + tau[:-1]) / 2
    power = h * (p.R * load * mid - (p.D + p.R * p.a) * mid**2)
    scale = S.max() + np.abs(power).max()
    np.testing.assert_allclose(np.diff(S), power, atol=1e-9 * scale)


@laws
@given(gains, periods, seeds)
def test_explicit_form_stores_no_more_than_it_is_given(p, h, seed):
    """1/2 R m xc'^2 + 1/2 K xc^2 grows by at most R (tau - u') times the displacement of xc."""
    block = virtual_passive_block(p, h, "explicit")
    n = int(block["nx"])
    w = np.zeros((100, NW))
    w[:, [TORQUE, IN_EFFECT]] = np.random.default_rng(seed).normal(size=(100, 2))
    e, states = w[:, TORQUE] - w[:, IN_EFFECT], [np.zeros(n)]
    for row in w:
        states.append(run(block, row[None], states[-1])[1])
    x = np.array(states)
    moved = np.diff(x[:, 0]) if n == 2 else (p.R * e * h - p.R * p.m * np.diff(x[:, 0])) / p.D
    S = 0.5 * p.R * p.m * x[:, -1] ** 2 + (0.5 * p.K * x[:, 0] ** 2 if n == 2 else 0.0)
    given_in = p.R * e * moved
    assert (np.diff(S) <= given_in + 1e-9 * (S.max() + np.abs(given_in).max())).all()


# --- position loop ---------------------------------------


@laws
@given(gains, periods, st.sampled_from(FORMS), decades(0.1, 1e3), decades(0.01, 10))
def test_position_loop_pushes_towards_the_reference(p, h, form, kp, kd):
    """Joint stuck, sensor reading zero, reference ahead: positive torque at once and for good."""
    block = add_position_loop(virtual_passive_block(p, h, form), kp, kd)
    for column, sign in ((POSITION_REF, 1), (POSITION, -1), (TORQUE_REF, 1)):
        assert feedback(block, 1.0) > 0
        assert sign * transfer(block, 1.0, column) > 0
        assert sign * block["D"][column] > 0
    assert block["D"][VELOCITY_REF] == -block["D"][VELOCITY] > 0


@laws
@given(gains.filter(lambda p: p.K > 0), periods, st.sampled_from(FORMS), decades(0.1, 1e3))
def test_position_loop_divides_the_static_load_error_by_R(p, h, form, kp):
    """At rest the sensor reads the motor torque: u = R kp error."""
    block = add_position_loop(virtual_passive_block(p, h, form), kp, 0.0)
    own = transfer(block, 1.0, TORQUE) + transfer(block, 1.0, IN_EFFECT)
    error = transfer(block, 1.0, POSITION_REF)
    if form == "explicit":  # tau_s = u' = u: they cancel, the rest is the open law with gain R
        assert own == pytest.approx(0, abs=1e-5 * p.R)
    assert error / (1 - own) == pytest.approx(p.R * kp, rel=1e-4 * (1 + p.R))


@laws
@given(gains, periods, st.sampled_from(FORMS), seeds)
def test_position_loop_is_added_to_the_torque_sample(p, h, form, seed):
    rng = np.random.default_rng(seed)
    kp, kd = rng.uniform(0, 100, 2)
    block = virtual_passive_block(p, h, form)
    kept = block.copy()
    loop, pd = add_position_loop(block, kp, kd), pd_block(kp, kd)
    assert block.tobytes() == kept.tobytes()
    w = rng.normal(size=(50, NW))
    tau_pd = (
        kp * (w[:, POSITION_REF] - w[:, POSITION])
        + kd * (w[:, VELOCITY_REF] - w[:, VELOCITY])
        + w[:, TORQUE_REF]
    )
    shifted = w.copy()
    shifted[:, TORQUE] += tau_pd
    u = run(block, shifted)[0]
    assert run(loop, w)[0] == pytest.approx(u, abs=1e-9 * (1 + np.abs(u).max()))
    assert w @ loop["bypass"] == pytest.approx(tau_pd, abs=1e-9)
    assert run(pd, w)[0] == pytest.approx(tau_pd, abs=1e-9)
    assert int(pd["nx"]) == 0


# --- warm start ------------------------------------------


@laws
@given(gains, periods, st.floats(-5, 5))
def test_warm_start_is_the_law_released_one_period_ago(p, h, velocity):
    A, _, C = continuous(p)
    free = cont2discrete((A, np.zeros((2, 1)), C, np.zeros((1, 1))), h, "zoh")[0]
    half = np.linalg.solve(np.eye(2) - h / 2 * A, np.eye(2) + h / 2 * A)
    start = np.array([0.0, -velocity])
    gamma = (C @ np.linalg.solve(np.eye(2) - h / 2 * A, [0.0, h / 2 / p.m])).item()
    for form, expected in (("explicit", C @ free @ start), ("implicit", C @ half @ start / (1 + gamma))):
        block = virtual_passive_block(p, h, form)
        u, _ = run(block, np.zeros((1, NW)), block["warm"][: int(block["nx"])] * velocity)
        assert u[0] == pytest.approx(expected.item(), rel=1e-8, abs=1e-9 * p.a)


@laws
@given(gains, st.sampled_from(FORMS), st.floats(-5, 5))
def test_first_torque_of_a_warm_start_is_a_times_the_velocity(p, form, velocity):
    """For a period short against m/a the joint is braked at once with -a velocity."""
    h = 1e-5 * min(
        p.m / p.a, p.R * p.m / p.D, p.a / p.K if p.K else np.inf, np.sqrt(p.R * p.m / (p.K + 1e-9))
    )
    block = virtual_passive_block(p, h, form)
    u, _ = run(block, np.zeros((1, NW)), block["warm"][: int(block["nx"])] * velocity)
    assert u[0] == pytest.approx(-p.a * velocity, rel=1e-4, abs=1e-12)


def test_empty_block():
    block = empty_block()
    assert block.dtype == BLOCK_DTYPE
    assert np.isinf([block["torque_limit"], block["rate_limit"]]).all()
    assert not block["A"].any()
    assert not block["D"].any()
