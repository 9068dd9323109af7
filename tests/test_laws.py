"""Every law of controller files: closed forms, limits, continuous time, certificates, files, the core."""

from __future__ import annotations

import math
from dataclasses import MISSING, fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from test_sampled import decades, feedback, laws, transfer

from dashpot.arm.drive import Drive
from dashpot.certify.certificate import certify_joint
from dashpot.certify.index import CONSTANT_TORQUE, passivity_index
from dashpot.certify.joint import Scales, holds_torque, sampled_joint
from dashpot.certify.loads import GROWS, radii
from dashpot.certify.testbench import _toml, replay, write
from dashpot.control.controller import (
    NOT_FINITE,
    RATE_LIMITED,
    TORQUE_LIMITED,
    Controller,
    ControllerConfig,
    JointGains,
    joint_block,
)
from dashpot.control.laws import LAWS, law_from_table, to_table
from dashpot.control.rivals.brakes import EncoderDamping, LatchedTorque, Off, RotorObserver, StaticFeedback
from dashpot.control.rivals.tracking import (
    PD,
    PID,
    DisturbanceObserver,
    InertiaShaping,
    PDGravity,
    PDScaled,
    TorqueFeedback,
)
from dashpot.control.sampled import (
    ACCELERATION_REF,
    IN_EFFECT,
    NW,
    POSITION,
    POSITION_REF,
    TORQUE,
    VELOCITY,
    VELOCITY_REF,
    pd_block,
    without_encoder,
)
from dashpot.errors import InputError

H = 1e-3
DRIVE = Drive(
    "j",
    rotor_inertia=0.2,
    viscous_friction=0.6,
    stiffness=1.2e4,
    damping=3.0,
    torque_limit=80.0,
    torque_gain_error=0.01,
    uncertainty={"rotor_inertia": 0.15, "viscous_friction": 0.3},
)
m, v, k = DRIVE.rotor_inertia, DRIVE.viscous_friction, DRIVE.stiffness
LOOP = {"kp": 400.0, "kd": 15.0}
EXAMPLES = {
    law.law: law
    for law in (
        JointGains("j", R=8.0, D=20.0, K=5.0, kp=60.0, kd=8.0),
        Off("j"),
        StaticFeedback("j", gain=0.8),
        RotorObserver("j", damping=4.0),
        LatchedTorque("j"),
        EncoderDamping("j", damping=20.0),
        PD("j", **LOOP),
        PDScaled("j", R=4.0, kp=100.0, kd=4.0),
        PID("j", ki=1000.0, **LOOP),
        PDGravity("j", payload=2.0, offset=0.1, **LOOP),
        DisturbanceObserver("j", cutoff=3.0, **LOOP),
        TorqueFeedback("j", **LOOP),
        InertiaShaping("j", ratio=0.4, **LOOP),
    )
}
every = pytest.mark.parametrize("law", EXAMPLES.values(), ids=EXAMPLES.keys())
slower = settings(max_examples=12, deadline=None)


def config(law, **settings):
    return ControllerConfig((law,), **{"period": H, **settings})


def block_of(law, drive=DRIVE, **settings):
    return joint_block(law, drive, config(law, **settings))


def test_every_law_is_looked_at():
    assert set(EXAMPLES) == set(LAWS)
    assert [EXAMPLES[name].law for name in LAWS] == list(LAWS)
    assert len({law.label for law in LAWS.values()}) == len(LAWS)


# --- what they become -----------------------------------------------------------------------------


@every
def test_a_block_has_the_limits_of_its_drive(law):
    block = block_of(law, replace(DRIVE, torque_rate_limit=500.0), latency=2, blend=0.05)
    assert block["torque_limit"] == 80
    assert block["rate_limit"] == pytest.approx(0.5)
    assert block["latency"] == 2
    assert block["blend"] == pytest.approx(math.exp(-H / 0.05))


def test_limits_in_which_laws_are_the_pd_controller():
    pd = block_of(PD("j", **LOOP))
    assert block_of(PID("j", ki=0.0, **LOOP)).tobytes() == pd.tobytes()
    assert block_of(InertiaShaping("j", ratio=1.0, **LOOP)).tobytes() == pd.tobytes()
    assert block_of(PDScaled("j", R=1.0, **LOOP)).tobytes() == pd.tobytes()
    assert block_of(PDGravity("j", payload=3.0, **LOOP)).tobytes() == pd.tobytes()
    bare = block_of(TorqueFeedback("j", gain=0.0, viscous_friction=0.0, **LOOP))
    bare["D"][ACCELERATION_REF] = 0.0
    assert bare.tobytes() == pd.tobytes()
    assert block_of(Off("j")).tobytes() == block_of(StaticFeedback("j", gain=0.0)).tobytes()


@laws
@given(decades(0.1, 5), decades(1e-3, 0.1))
def test_static_feedback_is_the_virtual_passive_law_of_a_stiff_dashpot(R, omega):
    """D to infinity at K = 0: C = R a/(R m s + D + R a) tends to R/(1 + R), with an error of 1/D."""
    z = np.exp(1j * omega)
    static = transfer(block_of(StaticFeedback("j", gain=R / (1 + R))), z, TORQUE)
    quiet = replace(DRIVE, torque_gain_error=0.0)
    errors = [
        abs(transfer(block_of(JointGains("j", R=R, D=D), quiet), z, TORQUE) - static) for D in (1e3, 1e4)
    ]
    assert errors[1] == pytest.approx(0.1 * errors[0], rel=0.02)
    assert errors[1] < 0.1


@every
def test_friction_looks_as_heavy_as_a_law_says(law):
    """m th'' + v th' = u - tau with u = C tau at rest: friction over 1 - C(0)."""
    static = abs(feedback(without_encoder(block_of(law)), np.exp(1e-7j)))
    if holds_torque(without_encoder(block_of(law))):
        static = 0.0
    assert 1 - static == pytest.approx(1 / law.friction_factor(DRIVE), abs=1e-6)


@slower
@given(decades(10, 2000), decades(1, 100), decades(0.1, 20), decades(1, 60))
def test_a_disturbance_observer_is_a_pid_controller(kp, kd, cutoff, omega):
    """kp + (kd + v) c, kp c, kd + m c in the limit of fast sampling, the torque it gave fed back to it."""
    h, s, c = 1e-4, 1j * omega, 2 * math.pi * cutoff
    block = block_of(DisturbanceObserver("j", cutoff=cutoff, kp=kp, kd=kd), period=h)
    z = np.exp(s * h)
    own = transfer(block, z, IN_EFFECT) / z
    found = (transfer(block, z, POSITION) + s * transfer(block, z, VELOCITY)) / (1 - own)
    expected = -((kp + (kd + v) * c) + kp * c / s + (kd + m * c) * s)
    assert abs(found - expected) < 0.03 * abs(expected)
    pid = block_of(PID("j", kp=kp + (kd + v) * c, ki=kp * c, kd=kd + m * c), period=h)
    like = transfer(pid, z, POSITION) + s * transfer(pid, z, VELOCITY)
    assert abs(like - expected) < 0.01 * abs(expected)


@slower
@given(st.lists(st.tuples(st.floats(-5, 5), st.floats(-5, 5)), min_size=3, max_size=10), decades(5e-4, 1e-2))
def test_a_fast_disturbance_observer_sees_held_disturbances_exactly(held, h):
    law = DisturbanceObserver("j", cutoff=1e5, kp=0.0)
    block, speed, x = block_of(law, period=h), 0.3, np.array([0.3, 0.0])
    decay = math.exp(-v / m * h)
    for u, d in held:
        speed = decay * speed + (1 - decay) / v * (u + d)
        w = np.zeros(NW)
        w[[VELOCITY, IN_EFFECT]] = speed, u
        command = block["C"][:2] @ x + block["D"] @ w
        x = block["A"][:2, :2] @ x + block["B"][:2] @ w
        assert command == pytest.approx(-d, abs=1e-8)
        assert x == pytest.approx([speed, d], abs=1e-8)


# --- continuous time ------------------------------------------------------------------------------

SOFT, LINK, DAMPER = 300.0, 0.3, 0.5  # a load that moves at a few Hz, so that the limit is soon reached
TURN, START, SPAN = 6.0, 0.4, 0.6  # [rad/s] of the reference, [rad/s] of the joint at first, [s]


def reference(t):
    return 0.2 * (1 - math.cos(TURN * t)), 0.2 * TURN * math.sin(TURN * t), 0.2 * TURN**2 * math.cos(TURN * t)


def continuous(law):
    """``law(t, x, q, w, tau) -> (torque, x')`` and its first state, written down again from its source."""

    def loop(t, q, w, kp, kd):
        r, r1, _ = reference(t)
        return kp * (r - q) + kd * (r1 - w)

    def pd(t, q, w, factor=1.0):
        return factor * loop(t, q, w, law.kp, law.kd)

    match law:
        case JointGains():
            a = law.R * v + law.D

            def vpc(t, x, q, w, tau):
                u = a * x[1] + law.K * x[0]
                net = tau + pd(t, q, w) - u
                return u, [x[1], (law.R * net - law.D * x[1] - law.K * x[0]) / (law.R * m)]

            return vpc, [0.0, 0.0]
        case Off() | LatchedTorque():
            return lambda t, x, q, w, tau: (0.0, []), []
        case StaticFeedback():
            return lambda t, x, q, w, tau: (law.gain * tau, []), []
        case RotorObserver():
            b = law.damping
            return lambda t, x, q, w, tau: (-b * x[0], [(-b * x[0] - tau - v * x[0]) / m]), [START]
        case EncoderDamping():
            return lambda t, x, q, w, tau: (-law.damping * w, []), []
        case PD() | PDGravity():
            return lambda t, x, q, w, tau: (pd(t, q, w), []), []
        case PDScaled():
            return lambda t, x, q, w, tau: (pd(t, q, w, law.R), []), []
        case PID():
            return lambda t, x, q, w, tau: (pd(t, q, w) + law.ki * x[0], [reference(t)[0] - q]), [0.0]
        case DisturbanceObserver():
            c = 2 * math.pi * law.cutoff

            def observer(t, x, q, w, tau):  # d = c/(s + c) ((m s + v) w - u), without a derivative
                u = pd(t, q, w) - (m * c * w - x[0])
                return u, [c * ((m * c - v) * w + u - x[0])]

            return observer, [m * c * START]
        case TorqueFeedback():
            return lambda t, x, q, w, tau: (tau + v * w + m * reference(t)[2] + pd(t, q, w), []), []
        case InertiaShaping():
            return lambda t, x, q, w, tau: (pd(t, q, w, law.ratio) + (1 - law.ratio) * tau, []), []
    raise AssertionError(law)


def smooth(law):
    """Rotor and link angle, (2, 4), at quarters of the span, in continuous time."""
    control, x0 = continuous(law)

    def rate(t, y):
        q, w, p, s = y[:4]
        tau = SOFT * (q - p) + DAMPER * (w - s)
        u, moved = control(t, y[4:], q, w, tau)
        return [w, (u - tau - v * w) / m, s, tau / LINK, *moved]

    at = SPAN * np.arange(1, 5) / 4
    found = solve_ivp(rate, (0, SPAN), [0, START, 0, START, *x0], t_eval=at, rtol=1e-9, atol=1e-10)
    return found.y[[0, 2]]


def ticked(law, h):
    """The same under the block in the core, the torque averaged over each period; exact between ticks."""
    flow = np.zeros((6, 6))  # rotor angle and speed, link's, integral of the torque, motor torque
    flow[0, 1] = flow[2, 3] = 1.0
    flow[4, :4] = SOFT, DAMPER, -SOFT, -DAMPER
    flow[1], flow[3] = -flow[4] / m, flow[4] / LINK
    flow[1, 1] -= v / m
    flow[1, 5] = 1 / m
    step = expm(flow * h)
    controller = Controller.from_config(config(law, period=h), [replace(DRIVE, torque_limit=5e3)])
    if law.warm and not isinstance(law, JointGains):
        controller.warm_start("j", START)
    y, out, found = np.array([0, START, 0, START, 0, 0.0]), np.zeros(1), []
    for tick in range(round(SPAN / h)):
        r, r1, r2 = reference(tick * h)
        controller.step(np.array([y[4] / h, y[0], y[1], r, r1, r2, 0.0])[:, None], out)
        y[4], y[5] = 0.0, out[0]
        y = step @ y
        if (tick + 1) % round(SPAN / h / 4) == 0:
            found.append(y[[0, 2]])
    return np.array(found).T


@every
def test_a_block_tends_to_its_law_in_continuous_time(law):
    expected = smooth(law)
    size = np.abs(expected).max()
    errors = [np.abs(ticked(law, h) - expected).max() / size for h in (5e-4, 2.5e-4)]
    assert errors[1] < 6e-3
    assert errors[1] < 0.6 * errors[0] or errors[0] < 1e-8  # first order at least


# --- the latched torque ---------------------------------------------------------------------------


@laws
@given(
    st.lists(st.floats(-60, 60), min_size=2, max_size=8),
    st.integers(0, 4),
    st.floats(1e-3, 1.0),
    st.none() | st.floats(50, 5e3),
)
def test_the_latched_torque_is_the_last_one(angles, latency, blend, rate):
    drive = replace(DRIVE, torque_rate_limit=math.inf if rate is None else rate)
    law = LatchedTorque("j", kp=1.0)
    controller = Controller.from_config(config(law, latency=latency, blend=blend), [drive])
    controller.set_mode("j", "bypass")
    out = np.zeros(1)
    for angle in angles:
        controller.inputs.position[:] = angle
        controller.step(out)
    last = out[0]
    controller.set_mode("j", "active")
    controller.set_position_loop("j", False)
    for _ in range(50):
        controller.inputs.torque[:] = 7.0
        controller.step(out)
        assert out[0] == pytest.approx(last, abs=1e-8)
    if latency == 0:
        assert out[0] == last


def test_a_latched_torque_needs_to_know_the_last_one():
    law = LatchedTorque("j")
    block_of(law, blend=0.0)
    with pytest.raises(InputError, match=r"joint 'j': blend \[s\] = 0.0: must be above 0 where there is a"):
        block_of(law, blend=0.0, latency=1)


# --- certificates ---------------------------------------------------------------------------------


@every
def test_a_verdict_holds_against_loads_and_has_a_reason(law):
    verdict = certify_joint(DRIVE, law, config(law))
    joint = sampled_joint(DRIVE, block_of(law), "average", H)
    inertia, stiffness = (grid.ravel() for grid in np.meshgrid(np.geomspace(1e-3, 300, 40), [0, 10, 3e3]))
    if verdict.certified:
        assert verdict.reason == ""
        assert radii(joint, inertia, stiffness).max() <= 1 + GROWS
        assert verdict.counterexample is None
    else:
        assert "energy" in verdict.reason or verdict.reason == CONSTANT_TORQUE
    assert verdict.certified == (
        law.law not in ("pid", "disturbance_observer", "torque_feedback", "latched_torque")
    )
    if law.keeps_encoder:
        assert verdict.brake is None


@slower
@given(decades(100, 1e4), st.floats(1, 10), decades(5, 100))
def test_the_index_of_an_integral_is_minus_k_squared_over_ki(kp, corner, kd):
    """1/Z = s/k + 1/(m s + v + kd + kp/s + ki/s^2): Re Z tends to -k^2/ki at low frequency."""
    ki = corner * kp
    found = passivity_index(DRIVE, block_of(PID("j", kp=kp, ki=ki, kd=kd)), "average", H)
    assert not found.passive
    assert found.value == pytest.approx(-(k**2) / ki, rel=0.05)


@slower
@given(decades(200, 2000), st.floats(1, 8), decades(10, 60))
def test_an_integral_oscillates_with_loads_beyond_rouths_limit(kp, corner, kd):
    stiff, h = replace(DRIVE, stiffness=1e6, damping=30.0), 1e-4
    ki = corner * kp
    heaviest = (v + kd) * kp / ki - m
    joint = sampled_joint(stiff, block_of(PID("j", kp=kp, ki=ki, kd=kd), period=h), "average", h)
    below, above = radii(joint, np.array([0.97, 1.03]) * heaviest, np.zeros(2))
    assert below <= 1 + GROWS < above
    assert f"{heaviest:.3g} kg m^2" in PID("j", kp=kp, ki=ki, kd=kd).trouble(stiff)


@pytest.mark.parametrize("name", ["pid", "disturbance_observer", "torque_feedback"])
def test_a_refused_law_oscillates_in_the_simulator(name, tmp_path):
    law = EXAMPLES[name]
    found = certify_joint(DRIVE, law, config(law))
    assert found.counterexample is not None
    files = write(tmp_path, found.counterexample.load, DRIVE, law, config(law), found.point)
    seen = replay(*files, found.counterexample, steps=10)
    assert seen.frequency == pytest.approx(found.counterexample.frequency, rel=0.03)
    assert seen.growth == pytest.approx(found.counterexample.growth, rel=0.1)


@pytest.mark.parametrize("latency", [0, 2])
@pytest.mark.parametrize("name", ["pid", "disturbance_observer", "latched_torque"])
def test_an_integrator_without_encoder_holds_its_torque(name, latency):
    block = without_encoder(block_of(EXAMPLES[name], latency=latency))
    assert holds_torque(block)
    assert not passivity_index(DRIVE, block, "average", H).passive


@every
def test_only_integrators_hold_a_torque(law):
    assert holds_torque(without_encoder(block_of(law))) == (
        law.law in ("pid", "disturbance_observer", "latched_torque")
    )


@every
def test_position_gains_are_all_that_reads_the_position(law):
    """A position channel that reads `factor` times as much, and the law that the bench writes for it."""
    factor = 0.93
    scaled = law.stated(DRIVE).scaled_position(factor)
    one = sampled_joint(DRIVE, block_of(law), "average", H, Scales(position=factor)).jump
    other = sampled_joint(DRIVE, block_of(scaled), "average", H).jump
    if law.law == "disturbance_observer":  # its first state is the speed as read
        one[:, -3] *= factor
        one[-3] /= factor
    np.testing.assert_allclose(other, one, rtol=1e-12, atol=1e-12 * np.abs(one).max())


# --- files ----------------------------------------------------------------------------------------


@st.composite
def any_law(draw):
    kind = LAWS[draw(st.sampled_from(list(LAWS)))]
    values = {}
    for f in fields(kind):
        limits = f.metadata.get("range")
        if limits is None or (f.default is not MISSING and draw(st.booleans())):
            continue
        low, high = limits.typical or (max(limits.low, 1e-3), min(limits.high, 1e3))
        none = st.just(0.0) if limits.low <= 0 and not limits.open_low else st.nothing()
        values[f.name] = min(max(draw(decades(low, high) | none), limits.low), high)
    return law_from_table({"name": "j", "law": kind.law, **values})


def or_none(build):
    """The result, or None where the numbers drawn do not go together."""
    try:
        return build()
    except InputError:
        return None


@settings(max_examples=80, deadline=None)
@given(any_law())
def test_a_law_survives_the_way_through_a_file(tmp_path_factory, law):
    path = tmp_path_factory.mktemp("law") / "c.toml"
    path.write_text(f"period = 0.001\n\n[[joint]]\n{_toml(law)}", encoding="utf-8")
    assert ControllerConfig.load(path).joints == (law,)
    assert law_from_table(to_table(law)) == law


JOINT = {"name": "j1", "law": "pid", "kp": 10.0, "ki": 1.0}
BAD = [
    ({"law": "pdi"}, "joint 'j1': law = 'pdi': must be one of virtual_passive, off, static_feedback, "),
    ({"law": 3}, "joint 'j1': law = 3: must be one of"),
    ({"law": ["pd"]}, "joint 'j1': law = ['pd']: must be one of"),
    ({"R": 3.0}, "joint 'j1': R: unknown key; law \"pid\" has kp, kd, ki"),
    ({"Ki": 3.0}, "joint 'j1': Ki: unknown key; did you mean 'ki'?; law \"pid\" has kp, kd, ki"),
    ({"law": "pd"}, "joint 'j1': ki: unknown key; law \"pd\" has kp, kd"),
    ({"law": "virtual_passive"}, "joint 'j1': ki: unknown key"),
    ({"kp": None}, "joint 'j1': missing key: kp"),
    ({"ki": -1.0}, "joint 'j1': ki [N m/(rad s)] = -1.0: must be at least 0"),
    ({"ki": math.nan}, "joint 'j1': ki [N m/(rad s)] = nan: must be finite"),
    ({"ki": "1"}, "joint 'j1': ki [N m/(rad s)] = '1': must be a number"),
    ({"name": None}, "name: every [[joint]] needs a name"),
]


@pytest.mark.parametrize(("change", "message"), BAD, ids=map(str, range(len(BAD))))
def test_a_bad_law_is_refused_in_one_line(change, message):
    table = {key: value for key, value in {**JOINT, **change}.items() if value is not None}
    with pytest.raises(InputError) as caught:
        law_from_table(table, file="c.toml")
    assert str(caught.value).startswith(f"c.toml: {message}")


def test_gains_of_another_law_are_asked_for_in_vain():
    mixed = ControllerConfig((JointGains("a", R=1.0, D=1.0), PD("b", kp=1.0)), period=H)
    with pytest.raises(InputError, match=r"joint 'b': law = 'pd': has no R and D: this needs law = \"virt"):
        _ = mixed.gains
    assert ControllerConfig(mixed.joints[:1], period=H).gains == mixed.joints[:1]


# --- in the core ----------------------------------------------------------------------------------

wild = st.floats(allow_nan=True, allow_infinity=True) | st.floats(-100, 100)


@settings(max_examples=150, deadline=None)
@given(
    any_law(),
    st.lists(st.lists(wild, min_size=7, max_size=7), min_size=1, max_size=12),
    st.integers(0, 3),
    decades(1, 1e4),
    st.data(),
)
def test_no_law_ever_leaves_its_limits(law, rows, latency, rate, data):
    drive = replace(DRIVE, torque_gain_error=0.0, torque_rate_limit=rate)
    controller = or_none(lambda: Controller.from_config(config(law, latency=latency), [drive]))
    if controller is None:
        return
    out, before = np.zeros(1), 0.0
    for row in rows:
        match data.draw(st.sampled_from(["", "", "mode", "loop", "warm"])):
            case "mode":
                controller.set_mode("j", data.draw(st.sampled_from(["off", "bypass", "active"])))
            case "loop":
                controller.set_position_loop("j", data.draw(st.booleans()))
            case "warm":
                controller.warm_start("j", data.draw(st.floats(-10, 10)))
        status = controller.step(np.array(row)[:, None], out)
        assert abs(out[0]) <= drive.torque_limit
        assert abs(out[0] - before) <= rate * H * (1 + 1e-12) + 1e-12
        if status & NOT_FINITE:
            assert out[0] == before
        before = out[0]
        assert np.isfinite(controller.state("j")["x"]).all()


def test_an_integral_does_not_wind_up_behind_the_limit():
    law = PID("j", kp=100.0, ki=500.0)
    weak = replace(DRIVE, torque_limit=5.0)
    controller, out = Controller.from_config(config(law), [weak]), np.zeros(1)
    controller.inputs.position_ref[:] = 1.0
    for _ in range(5000):
        status = controller.step(out)
    assert status & TORQUE_LIMITED
    assert not status & RATE_LIMITED
    # Without anti-windup the integral alone would be 2500 N m; with it, it settles where u is the limit's
    # distance from kp e: 5 = 100 + x + (share lost per tick balances what the error adds).
    state = controller.state("j")["x"][0]
    assert state == pytest.approx(5.0 - 100.0 + 500.0 * H / (500.0 * H / 100.0) - 500 * H / 2, rel=1e-6)
    controller.inputs.position_ref[:] = 0.0
    controller.step(out)
    assert abs(out[0]) < 6.0


def test_bypass_is_the_position_loop_alone():
    for law in EXAMPLES.values():
        tracked = replace(law, **LOOP)
        expected = pd_block(**LOOP)["D"]
        np.testing.assert_array_equal(block_of(tracked)["bypass"], expected)
    assert expected[[POSITION, VELOCITY]].tolist() == [-400, -15]
    assert expected[[POSITION_REF, VELOCITY_REF]].tolist() == [400, 15]
