"""Laws of the other joint controllers, and what every controller must do for the certificate and the core."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from test_sampled import decades, feedback, laws, run, seeds

from dashpot.arm.drive import Drive
from dashpot.certify.index import passivity_index
from dashpot.certify.joint import sampled_joint
from dashpot.certify.port import lift
from dashpot.control.controller import Controller
from dashpot.control.rivals import inertia_shaping_block, rotor_observer_block, static_feedback_block
from dashpot.control.sampled import (
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
from dashpot.errors import InputError

H = 1e-3
WRIST = Drive("w", rotor_inertia=0.05, viscous_friction=0.6, stiffness=6e3, damping=0.7, torque_limit=40.0)
m, v = WRIST.rotor_inertia, WRIST.viscous_friction
SHORT = 1e-6  # a period that a load moving at up to 100 rad/s does not notice


def assert_rotor_looks_like(block, *parts, omega):
    """A load sees the mechanical impedance sum(parts) [N m s/rad] behind the transmission."""
    port = lift(sampled_joint(WRIST, block, "average", SHORT), 1)
    found, s = port.response(omega * SHORT)[0, 0] / SHORT, 1j * omega
    admittance = s / (WRIST.stiffness + WRIST.damping * s)
    # The parts may cancel, at resonance of kp with the rotor: then what is left is known less well.
    rotor, error = sum(parts), 4e-3 * sum(map(abs, parts))
    assert abs(1 / (1 / found - admittance) - rotor) < error


# --- static torque feedback ----------------------------------------------------------------------


@laws
@given(st.floats(0, 0.95), decades(1, 100))
def test_static_feedback_makes_rotor_and_friction_look_heavier(gain, omega):
    """u = K tau: m th'' + v th' = -(1 - K) tau."""
    heavier = (1j * omega * m + v) / (1 - gain)
    assert_rotor_looks_like(static_feedback_block(gain), heavier, omega=omega)


@laws
@given(st.floats(0, 1, exclude_max=True))
def test_static_feedback_is_inertia_shaping_towards_a_heavier_rotor(gain):
    block, shaping = static_feedback_block(gain), inertia_shaping_block(1 - gain, 0.0, 0.0)
    assert block["D"][TORQUE] == pytest.approx(shaping["D"][TORQUE], abs=1e-15)
    assert np.flatnonzero(block["D"]).tolist() in ([TORQUE], [])
    assert int(block["nx"]) == int(shaping["nx"]) == 0


# --- rotor observer ------------------------------------------------------------------------------

observers = st.tuples(decades(1e-2, 5), st.just(0.0) | decades(1e-6, 20), decades(1e-2, 200))


@laws
@given(observers, decades(5e-4, 1e-2), seeds)
def test_the_rotor_observer_is_the_rotor_with_held_torques(values, h, seed):
    inertia, friction, damping = values
    w = np.zeros((8, NW))
    w[:, [TORQUE, IN_EFFECT]] = np.random.default_rng(seed).normal(size=(8, 2))
    start, expected = 0.3, []
    speed = start
    for row in w:  # both torques were held over the period that ends at the tick
        net = row[IN_EFFECT] - row[TORQUE]
        path = solve_ivp(
            lambda _, x, net=net: (net - friction * x) / inertia, (0, h), [speed], rtol=1e-9, atol=1e-12
        )
        speed = path.y[0, -1]
        expected.append(-damping * speed)
    u, state = run(rotor_observer_block(inertia, friction, damping, h), w, np.array([start]))
    np.testing.assert_allclose(u, expected, atol=1e-7 * np.abs(expected).max())
    assert state[0] == pytest.approx(speed, abs=1e-7 * np.abs(expected).max() / damping)


@laws
@given(decades(1e-2, 5), decades(1e-3, 20), decades(1e-2, 200), st.integers(0, 3))
def test_the_rotor_observer_has_its_static_gain(inertia, friction, damping, latency):
    """In a constant load u = -b w and 0 = u - tau - v w: u = b/(v + b) tau."""
    found = feedback(rotor_observer_block(inertia, friction, damping, H), 1.0, latency)
    assert found == pytest.approx(damping / (friction + damping), rel=1e-6)


@laws
@given(decades(0.01, 5), decades(1, 100))
def test_a_true_rotor_observer_brakes_as_damping_at_the_rotor(damping, omega):
    block = rotor_observer_block(m, v, damping, SHORT)
    assert_rotor_looks_like(block, 1j * omega * m + v, damping, omega=omega)


@laws
@given(observers, st.floats(-5, 5))
def test_a_warm_start_sets_the_speed_of_the_observer(values, velocity):
    inertia, friction, damping = values
    block = rotor_observer_block(inertia, friction, damping, H)
    controller = Controller(np.array([block]), ["j"], H)
    controller.warm_start("j", velocity)
    assert controller.state("j")["x"][0] == velocity
    out = np.zeros(1)
    controller.step(out)
    expected = -damping * velocity * math.exp(-friction / inertia * H)
    assert out[0] == pytest.approx(expected, rel=1e-12)


# --- inertia shaping -----------------------------------------------------------------------------


@laws
@given(decades(0.1, 10), st.just(0.0) | decades(0.1, 100), st.just(0.0) | decades(0.01, 5), decades(1, 100))
def test_inertia_shaping_divides_inertia_and_friction_by_its_ratio(ratio, kp, kd, omega):
    """B th'' + v th' = (B/B_d) (w - tau): B/ratio and v/ratio under the PD controller itself."""
    s = 1j * omega
    assert_rotor_looks_like(
        inertia_shaping_block(ratio, kp, kd), (m * s + v) / ratio, kd, kp / s, omega=omega
    )


@laws
@given(decades(0.1, 10), decades(0.1, 100), decades(0.1, 10), seeds)
def test_inertia_shaping_in_words(ratio, kp, kd, seed):
    w = np.random.default_rng(seed).normal(size=(20, NW))
    pd = kp * (w[:, POSITION_REF] - w[:, POSITION]) + kd * (w[:, VELOCITY_REF] - w[:, VELOCITY])
    pd += w[:, TORQUE_REF]
    block = inertia_shaping_block(ratio, kp, kd)
    expected = ratio * pd + (1 - ratio) * w[:, TORQUE]
    np.testing.assert_allclose(w @ block["D"], expected, atol=1e-9 * np.abs(expected).max())
    np.testing.assert_allclose(w @ block["bypass"], pd, atol=1e-9 * np.abs(pd).max())
    assert inertia_shaping_block(1.0, kp, kd) == pd_block(kp, kd)


# --- arguments -----------------------------------------------------------------------------------

GOOD = {
    static_feedback_block: {"gain": 0.5},
    rotor_observer_block: {"inertia": 0.05, "friction": 0.6, "damping": 2.0, "period": H},
    inertia_shaping_block: {"ratio": 3.0, "kp": 60.0, "kd": 4.0},
}
POSITIVE = {"inertia", "period", "ratio"}


@pytest.mark.parametrize(("build", "key"), [(build, key) for build, good in GOOD.items() for key in good])
def test_arguments_are_checked(build, key):
    bad = [math.nan, math.inf, -math.inf, -1e-9, 10**400, True, "1", None, [1.0]]
    bad += [0.0] * (key in POSITIVE) + [1.0, 2] * (key == "gain")
    for value in bad:
        with pytest.raises(InputError) as caught:
            build(**{**GOOD[build], key: value})
        message = str(caught.value)
        assert message.startswith(f"{key} [")
        assert "must be" in message
    if key not in POSITIVE:
        build(**{**GOOD[build], key: 0})


# --- every controller ----------------------------------------------------------------------------


def vpc(form, R, D, K, kp=0.0, kd=0.0, h=H):
    return add_position_loop(virtual_passive_block(VirtualPassive(R, D, K, m, v), h, form), kp, kd)


CONTROLLERS = {
    f"vpc {form} K={K:g} kp={kp:g}": vpc(form, 3.0, 3.0, K, kp, kd)
    for form in ("explicit", "implicit")
    for K in (0.0, 1.0)
    for kp, kd in ((0.0, 0.0), (60.0, 4.0))
} | {
    "pd": pd_block(60.0, 4.0),
    "static feedback": static_feedback_block(0.7),
    "rotor observer": rotor_observer_block(m, v, 2.0, H),
    "lighter rotor": inertia_shaping_block(3.0, 60.0, 4.0),
    "heavier rotor": inertia_shaping_block(0.4, 60.0, 4.0),
}
IDLE = {
    # R = 0 would be nothing at all; the smallest that is a law has a gain of about R
    "vpc explicit": vpc("explicit", 1e-5, 3.0, 0.0),
    "vpc implicit": vpc("implicit", 1e-5, 3.0, 0.0),
    "pd": pd_block(0.0, 0.0),
    "static feedback": static_feedback_block(0.0),
    "rotor observer": rotor_observer_block(m, v, 0.0, H),
    "inertia shaping": inertia_shaping_block(1.0, 0.0, 0.0),
}


@pytest.mark.parametrize("block", CONTROLLERS.values(), ids=CONTROLLERS.keys())
def test_the_index_of_every_controller_is_decided(block):
    found = passivity_index(WRIST, block, "average", H)
    assert found.decided, found.reason
    assert math.isfinite(found.value)
    assert found.value <= WRIST.damping  # what the transmission shows at high frequency


@pytest.mark.parametrize("block", IDLE.values(), ids=IDLE.keys())
def test_a_controller_that_does_nothing_has_the_index_of_the_bare_joint(block):
    bare = passivity_index(WRIST, empty_block(), "average", H)
    found = passivity_index(WRIST, block, "average", H)
    assert found.decided
    assert found.value == pytest.approx(bare.value, rel=1e-3)


@pytest.mark.parametrize("latency", [0, 2])
@pytest.mark.parametrize("block", CONTROLLERS.values(), ids=CONTROLLERS.keys())
def test_every_controller_is_linear_in_the_core(block, latency):
    block = block.copy()
    block["latency"] = latency
    rng = np.random.default_rng(0)
    first, second = rng.normal(size=(2, 60, NW - 1))
    a, b = 0.7, -1.9

    def outputs(rows):
        controller, out, found = Controller(np.array([block]), ["j"], H), np.zeros(1), []
        for row in rows:
            controller.step(np.ascontiguousarray(row[:, None]), out)
            found.append(out[0])
        return np.array(found)

    one, two, both = outputs(first), outputs(second), outputs(a * first + b * second)
    assert np.abs(one).max() > 0.1
    np.testing.assert_allclose(both, a * one + b * two, atol=1e-10 * (1 + np.abs(both).max()))
