"""Laws the virtual passive law and its network must obey for any parameters, by numbers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from dashpot.control.law import (
    K_tau_from_R,
    R_from_K_tau,
    TorqueFeedbackLaw,
    bias_drift,
    creep_rate,
    hold_torque,
    max_torque_gain_error,
    positive_real_margin,
    positive_real_with_model_error,
    static_R,
)
from dashpot.control.network import VirtualNetwork, as_matrix
from dashpot.errors import InputError

W = np.geomspace(1e-4, 1e5, 400)


def decades(low, high):
    return st.floats(np.log10(low), np.log10(high)).map(lambda x: 10.0**x)


# m, v, R, D, K
joint = st.tuples(
    decades(1e-2, 5), decades(1e-2, 20), decades(0.05, 50), decades(1e-2, 200), decades(1e-3, 1e3)
)
laws = settings(max_examples=60, deadline=None)


def spd(rng, n, low=0.5, high=5.0):
    q, _ = np.linalg.qr(rng.normal(size=(n, n)))
    return (q * rng.uniform(low, high, n)) @ q.T


def random_law(rng, n=3, *, full=True):
    D = spd(rng, n) if full else rng.uniform(0.5, 5, n)
    K = spd(rng, n) if full else rng.uniform(0.5, 5, n)
    return TorqueFeedbackLaw(
        *rng.uniform(0.2, 3, (3, n)), 0.5 * (D + D.T) if full else D, 0.5 * (K + K.T) if full else K
    )


# --- Z and C ---------------------------------------------


@laws
@given(joint)
def test_impedance_is_positive_real(p):
    m, v, R, D, K = p
    Z = TorqueFeedbackLaw(*p).Z(1j * W)
    assert Z.shape == (400, 1)
    assert Z.real.min() >= -1e-9 * abs(Z).max()
    assert positive_real_with_model_error(m, v, m, v, R, D, K)


@laws
@given(joint)
def test_impedance_limits(p):
    m, v, R, D, K = p
    a = R * v + D
    law, free = TorqueFeedbackLaw(m, v, R, D, K), TorqueFeedbackLaw(m, v, R, D, 0)
    assert law.Z(0)[0] == pytest.approx(R * v)
    assert law.Z(1e12)[0] == pytest.approx(a, rel=1e-6)
    assert free.Z(0)[0] == pytest.approx(R * v * a / D)
    assert free.C(0)[0] == pytest.approx(R * a / (D + R * a))


@laws
@given(joint)
def test_torque_feedback_is_K_tau_at_rest_and_below_unity_at_all_frequencies_if_D_is_large_enough(p):
    m, v, R, D, K = p
    law = TorqueFeedbackLaw(m, v, R, D, K)
    assert law.C(0)[0] == pytest.approx(R / (1 + R))
    assert law.C(0)[0] == pytest.approx(law.K_tau[0])
    damped = TorqueFeedbackLaw(m, v, R, max(D, np.sqrt(R * m * K)), K)
    assert abs(damped.C(1j * W)).max() < 1 + 1e-12


@laws
@given(joint, st.floats(0.1, 100), st.floats(-100, 100))
def test_closed_forms(p, re, im):
    s = complex(re, im)
    law, (m, v, R, D, K) = TorqueFeedbackLaw(*p), p
    a = R * v + D
    assert law.Z(s)[0] == pytest.approx(R * (m * s + v) * (a * s + K) / (R * m * s**2 + D * s + K))
    assert law.C(s)[0] == pytest.approx(R * (a * s + K) / (R * m * s**2 + (D + R * a) * s + (1 + R) * K))


@pytest.mark.parametrize("seed", range(10))
def test_full_matrices_agree_with_network_and_state_space(seed):
    rng = np.random.default_rng(seed)
    law, s = random_law(rng), complex(rng.uniform(0.1, 3), rng.uniform(-5, 5))
    Z = law.Z(s)
    assert Z.shape == (3, 3)
    np.testing.assert_allclose(law.network().impedance(s), Z, rtol=1e-10)
    A, B, C, D = law.state_space_tau()
    response = C @ np.linalg.solve(s * np.eye(6) - A, B) + D
    to_tau, to_u = response[:, :3], response[:, 3:]
    np.testing.assert_allclose(np.linalg.solve(np.eye(3) - to_u, to_tau), law.C(s), rtol=1e-9)
    # tau_x - u' = -(m s + v) theta'
    np.testing.assert_allclose(to_tau * (law.m * s + law.v), Z, rtol=1e-9)
    on_axis = law.Z(1j * W)
    hermitian = on_axis + np.conj(np.swapaxes(on_axis, -1, -2))
    assert np.linalg.eigvalsh(hermitian).min() > -1e-9


@pytest.mark.parametrize("seed", range(5))
def test_decoupled_law_is_the_coupled_one_with_diagonal_matrices(seed):
    rng = np.random.default_rng(seed)
    law, s = random_law(rng, full=False), 1j * W
    same = TorqueFeedbackLaw(law.m, law.v, law.R, np.diag(law.D), np.diag(law.K))
    for mine, full in ((law.Z(s), same.Z(s)), (law.C(s), same.C(s))):
        np.testing.assert_allclose(mine, np.diagonal(full, axis1=1, axis2=2), rtol=1e-12)


def test_singular_stiffness_has_a_finite_impedance_at_rest():
    direction = np.array([0.6, 0.8])
    law = TorqueFeedbackLaw(1.0, 0.5, [2.0, 3.0], np.eye(2) * 2, 4 * np.outer(direction, direction))
    np.testing.assert_allclose(law.Z(0), law.Z(1e-8), rtol=1e-6)
    np.testing.assert_allclose(law.C(0), law.C(1e-8), rtol=1e-6)


def test_a_scalar_applies_to_every_joint():
    law = TorqueFeedbackLaw([0.1, 0.2], 0.5, 10, [3.0, 4.0], 0)
    assert law.n == 2
    np.testing.assert_array_equal(law.R, [10, 10])


@laws
@given(decades(1e-4, 1e4))
def test_K_tau_and_R_are_inverse(R):
    assert R_from_K_tau(K_tau_from_R(R)) == pytest.approx(R, rel=1e-9)


# --- energy ---------------------------------------------


def smooth_motion(rng, n):
    """A band-limited random motion and its first two derivatives."""
    amplitude, frequency, phase = (
        rng.normal(size=(4, n)),
        rng.uniform(0.3, 4, (4, n)),
        rng.uniform(0, 6, (4, n)),
    )

    def at(t):
        turn = frequency * t + phase
        x, v = amplitude * np.sin(turn), amplitude * frequency * np.cos(turn)
        return x.sum(0), v.sum(0), (-(frequency**2) * x).sum(0)

    return at


def energy_defect(net, rng, seconds=4.0):
    """Integrates the network along a random motion; error of the energy balance, scale of the energy."""
    n, n_c = net.n, net.n_c
    at = smooth_motion(rng, n)

    def rate(t, y):
        xc, xcd = y[:n_c], y[n_c : 2 * n_c]
        u = net.output(*at(t), xc, xcd)
        return [*xcd, *net.xc_acceleration(*at(t), xc, xcd), net.storage_rate(u, at(t)[1], xcd)]

    start = np.append(rng.normal(size=2 * n_c), 0.0)
    solution = solve_ivp(rate, (0, seconds), start, method="DOP853", rtol=1e-12, atol=1e-12)
    x, xd, _ = (np.array(part) for part in zip(*(at(t) for t in solution.t), strict=True))
    xc, xcd, supplied = np.split(solution.y.T, [n_c, 2 * n_c], axis=1)
    S = net.storage(x, xd, xc, xcd)
    assert (net.dissipation(xd, xcd) >= -1e-12).all()
    return abs(S - S[0] - supplied[:, 0]).max(), S.max()


KINDS = ["displacement", "velocity", "acceleration"]
COMBINATIONS = [[k for i, k in enumerate(KINDS) if bits >> i & 1] for bits in range(1, 8)]


@pytest.mark.parametrize("kinds", COMBINATIONS, ids="+".join)
def test_storage_balance_of_every_feedback_kind(kinds):
    rng = np.random.default_rng(len("".join(kinds)))
    net = VirtualNetwork.from_feedback(
        *(spd(rng, 2) for _ in range(3)), **{kind: spd(rng, 2) for kind in kinds}
    )
    defect, scale = energy_defect(net, rng)
    assert defect < 1e-8 * max(scale, 1)
    s = 1j * W
    Z = net.impedance(s)
    assert np.linalg.eigvalsh(Z + np.conj(np.swapaxes(Z, 1, 2))).min() > -1e-8 * abs(Z).max()
    np.testing.assert_allclose(Z, np.swapaxes(Z, 1, 2), rtol=1e-9, atol=1e-9)  # no gyrator: reciprocal


@pytest.mark.parametrize("full", [False, True])
def test_storage_balance_of_the_torque_feedback_law(full):
    rng = np.random.default_rng(11)
    law = random_law(rng, full=full)
    defect, scale = energy_defect(law.network(), rng)
    assert defect < 1e-8 * max(scale, 1)


@pytest.mark.parametrize("full", [False, True])
def test_lyapunov_function_of_a_robot_falls_at_the_rate_of_A14(full):
    """Joints on a coupled, configuration-free load, no gravity: T + storage along free motion."""
    rng = np.random.default_rng(12)
    law, load = random_law(rng, full=full), spd(rng, 3)
    inertia = load + np.diag(law.m)
    A, B, C, _ = law.state_space_tau()

    def rate(_, y):
        xc, w = y[:6], y[6:9]
        u = C @ xc
        acceleration = np.linalg.solve(inertia, u)  # (11): the joints' own friction is left out of the plant
        # tau_x by its definition (9), with the controller's v in it
        tau_x = u - law.m * acceleration - law.v * w
        return [*(A @ xc + B @ np.append(tau_x, u)), *acceleration, law.lyapunov_rate(w, xc[3:])]

    start = np.append(rng.normal(size=9), 0.0)
    y = solve_ivp(rate, (0, 10), start, method="DOP853", rtol=1e-12, atol=1e-12).y.T
    L = law.lyapunov(
        y[:, 6:9], y[:, :3], y[:, 3:6], 0.5 * np.einsum("ti,ij,tj->t", y[:, 6:9], inertia, y[:, 6:9])
    )
    np.testing.assert_allclose(L - L[0], y[:, 9], atol=1e-8 * L[0])
    assert (np.diff(L) <= 1e-9).all()


def test_sign_of_the_virtual_coordinate_is_free():
    """(A1) couples theta' + x_c'; `from_feedback` couples x_a - x_c. Same network, x_c reversed."""
    law = TorqueFeedbackLaw(0.6, 0.0, 10.0, 60.0, 6.0)
    ours = VirtualNetwork.from_feedback(mass=0, damping=60, stiffness=6, acceleration=6.0)
    np.testing.assert_allclose(law.network().impedance(1 + 2j), ours.impedance(1 + 2j))
    flip = np.diag([1.0, -1.0])
    np.testing.assert_allclose(flip @ law.network().M @ flip, ours.M)


def test_output_map_is_equation_10():
    rng = np.random.default_rng(3)
    net = random_law(rng).network()
    xa, xad, xadd, xc, xcd = rng.normal(size=(5, 8, 3))
    xcdd = net.xc_acceleration(xa, xad, xadd, xc, xcd)
    u = xcdd @ net.H_M.T + xcd @ net.H_D.T + xc @ net.H_K.T + net.g(xa, xad, xadd)
    np.testing.assert_allclose(net.output(xa, xad, xadd, xc, xcd), u)
    full = np.hstack([xadd, xcdd]) @ net.M.T + np.hstack([xad, xcd]) @ net.D.T + np.hstack([xa, xc]) @ net.K.T
    np.testing.assert_allclose(full, np.hstack([-u, 0 * u]), atol=1e-12)


# --- statics of the brake ---------------------------------------------


def settle(law, *, load=0.0, bias=0.0, J=0.5, seconds=400.0):
    """Final velocity of rotor + rigid load J under a constant load torque and a torque-sensor bias."""
    A, B, C, _ = law.state_space_tau()
    m, v = law.m[0], law.v[0]

    def rate(_, y):
        u = C[0] @ y[:2]
        acceleration = (u + load - v * y[2]) / (m + J)
        tau_s = J * acceleration - load
        return [*(A @ y[:2] + B @ [tau_s + bias, u]), acceleration]

    return solve_ivp(rate, (0, seconds), np.zeros(3), method="LSODA", rtol=1e-10, atol=1e-12).y[2, -1]


@pytest.mark.parametrize("K", [0.0, 2.0])
def test_creep_and_bias_drift_by_simulation(K):
    R, D, v = 5.0, 3.0, 0.6
    law, R0 = TorqueFeedbackLaw(0.2, v, R, D, K), static_R(R, D, K, v)
    assert settle(law, load=0.7) == pytest.approx(creep_rate(0.7, R0, v), rel=1e-6)
    assert settle(law, bias=0.1) == pytest.approx(bias_drift(0.1, R0, v), rel=1e-6)
    assert (R0 == R) == (K > 0)


@pytest.mark.parametrize("K", [0.0, 2.0])
@pytest.mark.parametrize(("factor", "holds"), [(0.99, True), (1.01, False)])
def test_hold_torque_by_simulation(K, factor, holds):
    """At standstill tau_s = -load; the motor ends up at C(0) tau_s and friction must carry the rest."""
    R, D, v, tau_c = 5.0, 3.0, 0.6, 0.3
    law = TorqueFeedbackLaw(0.2, v, R, D, K)
    load = factor * hold_torque(tau_c, static_R(R, D, K, v))
    A, B, C, _ = law.state_space_tau()
    rest = solve_ivp(lambda _, y: A @ y + B @ [-load, C[0] @ y], (0, 300), [0, 0], method="LSODA", rtol=1e-9)
    friction_needed = abs(C[0] @ rest.y[:, -1] + load)
    assert (friction_needed <= tau_c) == holds


# --- model error ---------------------------------------------

factor = decades(0.1, 10)


@settings(max_examples=150, deadline=None)
@given(joint, factor, st.one_of(st.just(0.0), factor))
def test_positive_real_margin_is_the_least_real_part_and_its_sign_the_inequality(p, em, ev):
    m, v, R, D, K = p
    m_hat, v_hat = m * em, v * ev
    s, a = 1j * np.geomspace(1e-6, 1e7, 20001), R * v_hat + D
    Re = (R * (m * s + v) * (a * s + K) / (R * m_hat * s**2 + D * s + K)).real
    margin, scale = positive_real_margin(m, v, m_hat, v_hat, R, D, K), abs(Re).max()
    assert margin <= Re.min() + 1e-9 * scale
    # A lightly damped resonance is sharper than the grid: compare only where the grid resolves it.
    if R * m_hat * K < 1e3 * D**2:
        assert margin == pytest.approx(Re.min(), abs=1e-2 * scale)
    if abs(margin) > 1e-9 * scale:
        assert (margin > 0) == positive_real_with_model_error(m, v, m_hat, v_hat, R, D, K)


@laws
@given(joint, factor, factor)
def test_without_virtual_stiffness_any_model_error_passes(p, em, ev):
    m, v, R, D, _ = p
    assert positive_real_with_model_error(m, v, m * em, v * ev, R, D, 0.0)
    assert positive_real_margin(m, v, m * em, v * ev, R, D, 0.0) > 0


@laws
@given(joint, st.floats(-1, 1.1))
def test_torque_gain_error_bound_is_exact_for_passivity_of_the_joint(p, relative):
    """Re (m s + v)/(1 - (1 + e) C) >= 0 with stable poles exactly for -1 <= e < D/(R a)."""
    m, v, R, D, K = p
    bound = max_torque_gain_error(R, D, v)
    assert bound <= 1 / R
    e = relative * bound if relative > 0 else relative
    if abs(relative - 1) < 1e-3:
        return
    a = R * v + D
    held = np.roots([R * m, D - e * R * a, (1 - e * R) * K])  # poles with the link held
    assert (held.real.max() < 0) == (e < bound)
    if e < bound:
        port = (1j * W * m + v) / (1 - (1 + e) * TorqueFeedbackLaw(*p).C(1j * W)[:, 0])
        assert port.real.min() >= -1e-8 * abs(port).max()


# --- errors ---------------------------------------------

TWO = dict(m=[1.0, 1.0], v=[1.0, 1.0], R=[1.0, 1.0], D=[1.0, 1.0], K=[0.0, 1.0])


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (dict(R=[1.0, -2.0]), "joint '2': R = -2.0: must be positive and finite"),
        (dict(m=[0.0, 1.0]), "joint '1': m = 0.0: must be positive and finite"),
        (dict(v=[1.0, -0.1]), "joint '2': v = -0.1: must not be negative and must be finite"),
        (dict(D=[1.0, np.nan]), "joint '2': D = nan: must be positive and finite"),
        (dict(K=-1.0), "joint '1': K = -1.0: must not be negative and must be finite"),
        (dict(R=np.eye(2)), "R.shape = (2, 2): must have shape (2,)"),
        (dict(D=[[1.0, 2.0], [2.0, 1.0]]), "smallest eigenvalue of D = -1.0: must be positive definite"),
        (dict(K=[[1.0, 2.0], [2.0, 1.0]]), "smallest eigenvalue of K = -1.0: must be positive semidefinite"),
        (dict(D=[[1.0, 0.5], [0.0, 1.0]]), "D: must be symmetric (D[0,1] = 0.5, D[1,0] = 0)"),
        (dict(D=np.eye(3)), "m.shape = (2,): must have shape (3,)"),
    ],
)
def test_law_errors(change, text):
    with pytest.raises(InputError) as caught:
        TorqueFeedbackLaw(**TWO | change)
    assert str(caught.value) == text


@pytest.mark.parametrize(
    ("M", "D", "K", "n", "text"),
    [
        (-1.0, 0.0, 0.0, 1, "smallest eigenvalue of M = -1.0: must be positive semidefinite"),
        (1.0, -1.0, 0.0, 1, "smallest eigenvalue of sym(D) = -1.0: must be positive semidefinite"),
        (1.0, 0.0, -2.0, 1, "smallest eigenvalue of K = -2.0: must be positive semidefinite"),
        (1.0, 1.0, 1.0, 2, "n = 2: must lie between 1 and 1"),
        (
            [1.0, 0.0],
            [1.0, 0.0],
            0.0,
            1,
            "M, D, K: every virtual coordinate needs inertia, damping or stiffness",
        ),
        ([1.0, 1.0], np.eye(3), 0.0, 1, "D.shape = (3, 3): must have shape (2, 2) or (2,)"),
        (np.ones((2, 3)), 0.0, 0.0, 1, "M.shape = (2, 3): must have shape (n, n)"),
        ([1.0, np.inf], 0.0, 0.0, 1, "M: must be finite"),
    ],
)
def test_network_errors(M, D, K, n, text):
    with pytest.raises(InputError) as caught:
        VirtualNetwork(M, D, K, n)
    assert text in str(caught.value).replace("M = [[1.0, 0.0], [0.0, inf]]", "M")


def test_a_gyrator_is_allowed_and_costs_nothing():
    net = VirtualNetwork(np.eye(2), [[0.0, 3.0], [-3.0, 0.0]], 0.0, 1)
    assert net.dissipation([1.0], [2.0]) == 0


def test_virtual_node_without_inertia_has_an_impedance_but_no_acceleration():
    net = VirtualNetwork.from_feedback(
        mass=0, damping=2.0, stiffness=0, velocity=2.0
    )  # two dashpots in series
    assert net.impedance(1j)[0, 0] == pytest.approx(1.0)
    with pytest.raises(InputError, match="M_cc must be nonsingular"):
        net.xc_acceleration([0.0], [0.0], [0.0], [0.0], [0.0])
    with pytest.raises(InputError, match="must not be zero"):
        net.impedance(0)


@pytest.mark.parametrize("K_tau", [0.0, 1.0, 1.2, -0.5, np.nan])
def test_K_tau_outside_its_interval_is_refused(K_tau):
    with pytest.raises(InputError, match="must lie strictly between 0 and 1"):
        R_from_K_tau(K_tau)


def test_scalar_helpers_check_their_arguments():
    with pytest.raises(InputError, match=r"v \[N m s/rad\] = 0.0: must be positive"):
        creep_rate(1.0, 10.0, 0.0)
    with pytest.raises(InputError, match=r"R \[-\] = -1.0"):
        hold_torque(0.5, -1.0)
    with pytest.raises(InputError, match=r"m_hat = 0\.0"):
        positive_real_with_model_error(1, 1, 0, 1, 1, 1, 1)
    with pytest.raises(InputError, match=r"D \[N m s/rad\] = 0.0"):
        max_torque_gain_error(10, 0, 1)


def test_stored_arrays_are_read_only():
    law = TorqueFeedbackLaw(**TWO)
    with pytest.raises(ValueError, match="read-only"):
        law.R[0] = 5
    with pytest.raises(ValueError, match="read-only"):
        as_matrix("M", 1.0)[0, 0] = 2
