"""The law derived again with sympy, and every misprint of the paper pinned down: one test each."""

from __future__ import annotations

import numpy as np
import pytest
import sympy as sp

from dashpot.control.law import TorqueFeedbackLaw, positive_real_margin, positive_real_with_model_error

m, R, D, J, Kp, Kd = sp.symbols("m R D J K_p K_d", positive=True)
v, K = sp.symbols("v K", nonnegative=True)
s, t = sp.symbols("s t")
xad, xadd, xc, xcd, xcdd, u, tau = sp.symbols("xad xadd xc xcd xcdd u tau_x")
K_tau = R / (1 + R)
a = R * v + D

tau_x = u - m * xadd - v * xad  # (9)
A4 = K_tau * tau - K_tau * m * xcdd + K_tau * v * xcd
A9 = -R * m * (xadd + xcdd) - R * v * (xad - xcd)
A13 = R * v * xad + R * m * (xadd + xcdd) + K * xc + D * xcd  # = 0
A14 = -R * v * xad**2 - D * xcd**2
A18 = a * xcd + K * xc


def zero(expression):
    return sp.simplify(expression) == 0


def lyapunov_rate(weight):
    """(A3) with the given matrix in the kinetic term, along the controller (A9), (A13)."""
    rate = A9 * xad + weight * m * (xadd + xcdd) * (xad + xcd) + K * xc * xcd
    return sp.expand(rate.subs(xcdd, sp.solve(A13, xcdd)[0]))


# --- the derivation ---------------------------------------------


def test_A4_with_A8_gives_A9():
    implicit = sp.solve(A4.subs(tau, tau_x) - u, u)[0]
    assert zero(implicit - A9)


def test_A9_and_A13_give_the_output_equation_21():
    assert zero(A9.subs(xcdd, sp.solve(A13, xcdd)[0]) - A18)


def test_A13_and_9_give_the_state_equation_20():
    acceleration = sp.solve(A13.subs(xadd, sp.solve(tau_x - tau, xadd)[0]), xcdd)[0]
    u_now = sp.Symbol("u'")
    assert zero(acceleration.subs(u, u_now) - (-K * xc / (R * m) - D * xcd / (R * m) + tau / m - u_now / m))


def test_the_class_implements_20_and_21():
    numbers = {m: 0.3, v: 0.7, R: 4, D: 5, K: 2}
    A, B, C, _ = TorqueFeedbackLaw(*(numbers[x] for x in (m, v, R, D, K))).state_space_tau()
    state = sp.Matrix([xc, xcd])
    row20 = (-K * xc - D * xcd) / (R * m) + (tau - u) / m
    expected = sp.Matrix([xcd, row20]).subs(numbers)
    assert (
        (sp.Matrix(A) * state + sp.Matrix(B) * sp.Matrix([tau, u]) - expected)
        .applyfunc(sp.nsimplify)
        .is_zero_matrix
    )
    assert zero(
        sp.nsimplify((sp.Matrix(C) * state)[0]) - A18.subs({k: sp.nsimplify(x) for k, x in numbers.items()})
    )


def test_impedance_and_feedback_follow_from_20_and_21():
    theta = sp.Symbol("theta")
    torque = -(m * s + v) * s * theta  # tau_x - u'
    virtual = R * torque / (R * m * s**2 + D * s + K)
    Z = R * (m * s + v) * (a * s + K) / (R * m * s**2 + D * s + K)
    assert zero((a * s + K) * virtual + Z * s * theta)
    out = sp.solve(u - (a * s + K) * R * (tau - u) / (R * m * s**2 + D * s + K), u)[0]
    assert zero(out - R * (a * s + K) / (R * m * s**2 + (D + R * a) * s + (1 + R) * K) * tau)


def test_the_inequality_under_model_error_is_the_condition_for_a_positive_real_impedance():
    m_hat, v_hat, x, w = sp.symbols("m_hat v_hat x w", positive=True)
    a_hat = R * v_hat + D
    up = R * (m * s + v) * (a_hat * s + K)
    down = R * m_hat * s**2 + D * s + K
    real = sp.re(sp.expand((up.subs(s, sp.I * w)) * sp.conjugate(down.subs(s, sp.I * w))))
    poly = sp.Poly(sp.expand(real).subs(w, sp.sqrt(x)), x)
    c2, c1, c0 = poly.all_coeffs()
    assert zero(c2 - R**2 * m * m_hat * a_hat)
    assert zero(c0 - R * v * K**2)
    assert zero(c1 - R * (D * v * a_hat - R * K * (m_hat * v + m * v_hat)))
    # c2 x^2 + c1 x + c0 >= 0 for all x >= 0 if and only if -c1 <= 2 sqrt(c0 c2): the inequality, times R.


def test_the_torque_gain_bound_makes_the_joint_passive_whatever_K():
    """With gain 1 + e the real part is p2 x^2 + p1 x + p0 with x = w^2, over a positive denominator.

    -p1 <= 2 sqrt(p2 p0) is an equality at e = D/(R a), holds at e = -1, and is convex in e: it holds between.
    """
    e, w = sp.symbols("e w", real=True)
    x = sp.Symbol("x", positive=True)
    up = (m * s + v) * (R * m * s**2 + (D + R * a) * s + (1 + R) * K)
    down = R * m * s**2 + (D - e * R * a) * s + (1 - e * R) * K
    at = {s: sp.I * w}
    real = sp.expand(sp.re(sp.expand(up.subs(at)) * sp.conjugate(sp.expand(down.subs(at)))))
    p2, p1, p0 = sp.Poly(real.subs(w, sp.sqrt(x)), x).all_coeffs()
    assert zero(p2 - R**2 * m**2 * (v + a * (1 + e)))
    assert zero(p1 - (v * (D + R * a) * (D - e * R * a) - 2 * m * K * R * v * (1 + R)))
    assert zero(p0 - v * (1 + R) * (1 - e * R) * K**2)
    bound = D / (R * a)
    assert zero((p1**2 - 4 * p2 * p0).subs(e, bound))  # the condition -p1 <= 2 sqrt(p2 p0) is tight there
    assert sp.degree(sp.expand(p1), e) == 1  # linear, while p2 p0 is concave in e and its root too
    assert zero(sp.diff(p2 * p0, e, 2) + 2 * R**3 * m**2 * a * v * (1 + R) * K**2)
    assert zero((p1 + 2 * R * m * v * (1 + R) * K - v * (D + R * a) ** 2).subs(e, -1))  # and holds at e = -1:
    assert zero((4 * p2 * p0 - (2 * R * m * v * (1 + R) * K) ** 2).subs(e, -1))


# --- errata ---------------------------------------------


def test_erratum_A1_and_A3_carry_R_where_K_tau_is_printed():
    assert zero(lyapunov_rate(R) - A14)
    left_over = sp.simplify(lyapunov_rate(K_tau) - A14)
    extra = (K_tau - R) * m * (xadd + xcdd) * (xad + xcd)
    assert left_over != 0
    assert zero(left_over - extra.subs(xcdd, sp.solve(A13, xcdd)[0]))


def test_erratum_A17_drops_two_terms_in_u_that_cancel_and_A18_is_right():
    printed = R * tau - R * m * ((-D * xcd - K * xc) / (R * m) + tau / m) + R * v * xcd
    assert zero(printed - A18)
    # (A16) solved for xc'' has -u/m in the bracket; (A4) in terms of R has -R u outside.
    bracket, outside = (-D * xcd - K * xc) / (R * m) + (tau - u) / m, -R * u
    assert zero(R * tau - R * m * bracket + R * v * xcd + outside - A18)
    assert zero(bracket.subs(u, 0) - u / m - bracket)
    assert not zero(R * tau - R * m * bracket + R * v * xcd - A18)  # one of the two alone would be wrong


def test_erratum_A8_needs_K_tau_strictly_between_0_and_1():
    k = sp.Symbol("k", real=True)
    r = k / (1 - k)
    assert sp.solveset(r > 0, k, sp.S.Reals) == sp.Interval.open(0, 1)
    assert sp.limit(r, k, 1, "-") == sp.oo
    assert r.subs(k, sp.Rational(3, 2)) < 0


def test_erratum_symmetric_R_m_and_R_v_force_a_diagonal_R_unless_joints_are_alike():
    m1, m2, v1, v2 = sp.symbols("m1 m2 v1 v2", positive=True)
    r12, r21 = sp.symbols("r12 r21")
    symmetric_m, symmetric_v = r12 * m2 - r21 * m1, r12 * v2 - r21 * v1
    assert sp.solve([symmetric_m, symmetric_v], [r12, r21], dict=True) == [{r12: 0, r21: 0}]
    # alike: one ratio m/v. If R itself must be symmetric, as (20) asks, the inertias must even be equal.
    assert zero(symmetric_v.subs({r12: m1, r21: m2, v1: m1, v2: m2}))
    assert sp.solve(symmetric_m.subs(r21, r12), r12) == [0]
    assert zero(symmetric_m.subs({r21: r12, m2: m1}))


def test_erratum_A14_is_only_semidefinite_and_needs_lasalle():
    at_rest = {xad: 0, xcd: 0}
    assert A14.subs(at_rest) == 0
    storage = R * m * (xad + xcd) ** 2 / 2 + K * xc**2 / 2
    assert storage.subs(at_rest) == K * xc**2 / 2  # energy left, yet no rate
    # LaSalle: staying there needs xad = xadd = xcd = xcdd = 0, and (A13) then leaves K x_c = 0.
    assert A13.subs(at_rest | {xadd: 0, xcdd: 0}) == K * xc
    law = TorqueFeedbackLaw(0.3, 0.5, 2.0, 1.0, 4.0)
    assert law.lyapunov([0.0], [1.0], [0.0]) == pytest.approx(2.0)
    assert law.lyapunov_rate([0.0], [0.0]) == 0


def test_erratum_11_leaves_gravity_out():
    theta = sp.Function("theta")(t)
    inertia, weight = sp.symbols("I mgl", positive=True)
    rate = theta.diff(t)
    acceleration = (u - weight * sp.sin(theta)) / inertia
    T, U = inertia * rate**2 / 2, -weight * sp.cos(theta)
    along = {theta.diff(t, 2): acceleration}
    assert zero(T.diff(t).subs(along) - u * rate + weight * sp.sin(theta) * rate)
    assert not zero(T.diff(t).subs(along) - u * rate)
    assert zero((T + U).diff(t).subs(along) - u * rate)


def test_erratum_under_gravity_the_joint_falls_slowly_it_does_not_hold():
    load = sp.Symbol("tau_g", positive=True)
    C = R * (a * s + K) / (R * m * s**2 + (D + R * a) * s + (1 + R) * K)
    step = load / s  # tau_s = J s w - load/s; (m s + v) w = C tau_s - tau_s
    w = (1 - C) * step / (m * s + v + (1 - C) * J * s)
    k, f = sp.symbols("k f", positive=True)
    final = sp.limit(sp.cancel((s * w).subs({K: k, v: f})), s, 0)
    assert zero(final - load / ((1 + R) * f))


def test_erratum_19_and_A6_print_a_diagonal_matrix_where_a_column_is_meant():
    gain, column = sp.diag(R, 2 * R), sp.Matrix(sp.symbols("tau1 tau2"))
    printed = sp.diag(*column)
    xcdd2 = sp.Matrix(sp.symbols("a1 a2"))
    assert (gain * (column - xcdd2)).shape == (2, 1)
    with pytest.raises(sp.matrices.exceptions.ShapeError):
        gain * printed - xcdd2


def closed_loop(sign):
    """Characteristic polynomial of rotor, rigid load J and u = C (tau_s + sign tau_pd)."""
    C_up, C_down = R * (a * s + K), R * m * s**2 + (D + R * a) * s + (1 + R) * K
    pd = -(Kp + Kd * s)  # tau_pd per theta: positive in the direction that brings theta back to theta_d
    return sp.Poly(sp.expand(C_down * ((J + m) * s**2 + v * s) - C_up * (J * s**2 + sign * pd)), s)


def test_erratum_the_position_offset_is_added_taken_literally_it_is_positive_feedback():
    literal, added = closed_loop(-1), closed_loop(+1)
    # First coefficient positive, last negative: a real unstable pole for any parameters.
    assert literal.LC().is_positive
    assert zero(literal.eval(0) + R * K * Kp)
    assert zero(added.eval(0) - R * K * Kp)
    numbers = {m: 0.6, v: 2, R: 3, D: 10, K: 2, J: 1, Kp: 60, Kd: 4}
    poles = {
        sign: np.roots([float(c.subs(numbers)) for c in closed_loop(sign).all_coeffs()]) for sign in (-1, 1)
    }
    assert poles[1].real.max() < 0
    assert poles[-1].real.max() > 0


def test_position_loop_divides_the_static_load_error_by_R():
    load, theta = sp.symbols("tau_g theta")
    C0 = R / (1 + R)
    # at rest tau_s = -load and u = tau_s
    assert zero(sp.solve(C0 * (-load - Kp * theta) + load, theta)[0] - load / (R * Kp))


def poles_with_load(p, v_hat, inertia, spring):
    """Rotor (exact m, true v) with gains built on v_hat, a rigid load inertia and a spring to ground."""
    m_, v_, R_, D_, K_ = p
    a_hat = R_ * v_hat + D_
    down = np.array([R_ * m_, D_, K_])
    up = R_ * np.polymul([m_, v_], [a_hat, K_])
    # s ((m + J) s + v + Z) + k = 0
    own = np.polymul([m_ + inertia, v_, spring], down)
    return np.roots(np.polyadd(own, np.append(up, 0)))


def test_erratum_underestimated_friction_is_not_always_safe():
    """Section V: 'stability will not be affected if the modeled friction is less than the actual'."""
    p = (0.6, 2.0, 10.0, 0.5, 100.0)
    m_, v_, R_, D_, K_ = p
    assert not positive_real_with_model_error(m_, v_, m_, 0.0, R_, D_, K_)
    # The joint's own friction cannot make up for it: some passive load must oscillate, and does.
    assert positive_real_margin(m_, v_, m_, 0.0, R_, D_, K_) < -v_
    loads = [(j, k) for j in np.geomspace(1e-2, 10, 25) for k in np.geomspace(1, 1e4, 25)]
    assert max(poles_with_load(p, 0.0, j, k).real.max() for j, k in loads) > 0.1
    assert max(poles_with_load(p, v_, j, k).real.max() for j, k in loads) < 0  # exact friction: never
    damped = (m_, v_, R_, 60.0, 6.0)  # a sensible design passes: large D, small K
    assert positive_real_with_model_error(m_, v_, m_, 0.0, R_, 60.0, 6.0)
    assert max(poles_with_load(damped, 0.0, j, k).real.max() for j, k in loads) < 0
