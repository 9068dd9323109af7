"""The proof that one design does not exist: its inequalities against the package's own port, and its cuts."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dashpot.certify.box import at
from dashpot.certify.exact import holds
from dashpot.certify.joint import sampled_joint
from dashpot.certify.loads import radii
from dashpot.certify.port import lift
from dashpot.control.sampled import add_position_loop
from dashpot.design import candidates as quantity
from dashpot.design.candidates import Gains
from dashpot.studies import designs_necessary as necessary
from dashpot.studies.designs_necessary import Corner, Inequalities, creeping, entries, unstable
from dashpot.studies.designs_proof import FEW, INSTEAD, Bounds, asked, both, coordinates, refute


@pytest.fixture(scope="module")
def case():
    duty, wishes = asked()
    return duty, wishes, Corner.of(duty)


def drive_at(duty, corner):
    point = {
        "rotor_inertia": corner.m,
        "viscous_friction": corner.v,
        "stiffness": corner.k,
        "damping": corner.c,
        "torque_gain": corner.torque,
        "position_gain": corner.position,
        "latency": 0,
    }
    return at(duty.drive, point)


def joint_of(duty, corner, gains):
    drive, scales = drive_at(duty, corner)
    block = add_position_loop(duty.blocks(gains, brake=True)[0], gains.kp[0], gains.kd[0])
    return sampled_joint(drive, block, duty.sampling, duty.period, scales)


def log_range(low, high):
    return st.floats(np.log(low), np.log(high)).map(np.exp)


@st.composite
def some_gains(draw):
    spring = draw(st.one_of(st.just(0.0), log_range(0.1, 300)))
    values = (
        draw(log_range(0.05, 200)),
        draw(log_range(0.3, 60)),
        spring,
        draw(log_range(1, 300)),
        draw(log_range(0.1, 20)),
    )
    return Gains(*(np.array([value]) for value in values))


def form_at(inequalities, duty, gains):
    """The form (1) at single gains, and the size of its terms, (f,) each; by the enclosure of a point."""
    p, kappa = coordinates(duty, gains)
    interval = None if gains.K[0] == 0 else np.array([[kappa[0], kappa[0]]])
    upper, middle, size = entries(inequalities, np.repeat(p[None], 5, 1), interval)
    assert np.allclose(upper, middle, rtol=0, atol=1e-12 * size[..., None, None])
    return middle[0, :, 0, 0], size[0]


@settings(max_examples=60, deadline=None)
@given(some_gains())
def test_the_form_has_the_sign_of_the_port(case, gains):
    duty, _, corner = case
    inequalities = Inequalities.of(corner, shares=(0.02, 0.1, 0.3, 0.5, 0.7, 0.85, 0.93, 0.99))
    value, size = form_at(inequalities, duty, gains)
    damping = lift(joint_of(duty, corner, gains), 32).least_damping(inequalities.omega * duty.period)
    clear = np.abs(value) > 1e-3 * size
    assert np.array_equal(value[clear] < 0, damping[clear] < 0)


@settings(max_examples=40, deadline=None)
@given(some_gains())
def test_the_limit_at_no_frequency(case, gains):
    duty, _, corner = case
    gains = replace(gains, K=np.zeros(1))
    inequalities = Inequalities.of(corner, shares=(1e-3, 2e-3))
    p, _ = coordinates(duty, gains)
    first, second = form_at(inequalities, duty, gains)[0]
    limit = p[0] @ inequalities.creep @ p[0]
    assert limit == pytest.approx((4 * first - second) / 3, abs=1e-6 * (1 + abs(first) + p[0] @ p[0]))


def test_where_the_linear_form_fails_the_free_rotor_grows(case):
    duty, _, corner = case
    inequalities = Inequalities.of(corner)
    rng = np.random.default_rng(0)
    grew = []
    for sprung in (False, True) * 60:
        low, high = np.log([[0.05, 0.3, 0.1, 1, 1], [200, 1e3, 300, 3e3, 3e3]])
        values = np.exp(rng.uniform(low, high))
        gains = Gains(*(np.array([value]) for value in values * [1, 1, sprung, 1, 1]))
        p, kappa = coordinates(duty, gains)
        if unstable(inequalities, np.repeat(p[None], 5, 1), np.array([[kappa[0]] * 2]) if sprung else None)[
            0
        ]:
            link = np.array([1e-5 * corner.m])
            assert radii(joint_of(duty, corner, gains), link, 0 * link)[0] > 1
            grew.append(sprung)
    assert 10 < sum(grew) < len(grew) - 10


@settings(max_examples=40, deadline=None)
@given(st.data())
def test_bounds_of_a_piece_hold_inside(case, data):
    duty, wishes, corner = case
    inequalities = Inequalities.of(corner, shares=(0.03, 0.3, 0.85))
    sprung = data.draw(st.booleans())
    rng = np.random.default_rng(data.draw(st.integers(0, 10**6)))
    edges = rng.dirichlet(np.ones(5), 5) @ Bounds.of(duty, wishes).edges(corner, sprung=sprung)
    kappa = np.sort(rng.exponential(data.draw(log_range(1, 1e4)), 2))[None] if sprung else None
    if sprung and data.draw(st.booleans()):
        kappa[0, 1] = np.inf
    upper, _, size = entries(inequalities, edges[None], kappa)
    share = rng.dirichlet(np.ones(5))
    inner = None
    if sprung:
        inside = kappa[0, 0] + rng.random() * (min(kappa[0, 1], 1e6) - kappa[0, 0])
        inner = np.array([[inside, inside]])
    point = share @ edges
    value = entries(inequalities, np.repeat(point[None, None], 5, 1), inner)[1][0, :, 0, 0]
    assert np.all(value <= share @ upper[0] @ share + 1e-12 * size[0])
    fails = unstable(inequalities, edges[None], kappa)[0]
    assert not fails or unstable(inequalities, np.repeat(point[None, None], 5, 1), inner)[0]


@settings(max_examples=100, deadline=None)
@given(some_gains(), log_range(0.01, 1000))
def test_the_cone_holds_the_gains_within_the_wishes(case, gains, scale):
    duty, wishes, corner = case
    wishes = wishes.changed(
        {name: min(scale * wishes.limits[name], 3.0) for name in ("error_ratio", "load_error")}
    )
    weak = replace(duty, torque_gain=1 - duty.drive.torque_gain_error)
    values = (quantity.error_ratio(weak, gains)[0], quantity.load_error(weak, gains)[0])
    limits = (wishes.error_ratio, wishes.load_error)
    if all(abs(value / limit - 1) > 1e-9 for value, limit in zip(values, limits, strict=True)):
        p, _ = coordinates(duty, gains)
        edges = Bounds.of(duty, wishes).edges(corner, sprung=bool(gains.K[0] > 0))
        inside = (np.linalg.solve(edges.T, p[0]) >= 0).all()
        assert inside == all(value < limit for value, limit in zip(values, limits, strict=True))


def test_no_design_is_as_good_as_the_hand_picked_one(case):
    duty, wishes, corner = case
    found = both(Inequalities.of(corner, *FEW), Bounds.of(duty, wishes))
    for row in found.values():
        by = row["refuted_by"]
        assert row["proven"]
        assert row["pieces"] == by["unstable"] + by["creeping"] + sum(by["passivity_hz"].values())


def test_gains_within_the_wishes_fail_the_exact_test_at_that_corner(case):
    duty, wishes, corner = case
    drive = duty.drive
    rng = np.random.default_rng(0)
    for sprung in (False, True):
        edges = Bounds.of(duty, wishes).edges(corner, sprung=sprung)
        for _ in range(25):
            p = np.exp(rng.normal(0, 3, 5)) @ edges
            p /= p[necessary.ONE]
            a, x = drive.rotor_inertia / p[necessary.MU], p[necessary.X]
            if a * x == 0:
                continue
            R = a / (a * x + drive.viscous_friction)
            K = a * np.exp(rng.uniform(-3, 7)) if sprung else 0.0
            values = (R, a - R * drive.viscous_friction, K, p[necessary.KP], p[necessary.KD])
            gains = Gains(*(np.array([value]) for value in values))
            assert not holds(joint_of(duty, corner, gains), 0.0)


def test_what_is_certified_is_not_refuted(case):
    duty, wishes, corner = case
    inequalities = Inequalities.of(corner)
    weak = replace(duty, torque_gain=1 - duty.drive.torque_gain_error)
    for values in INSTEAD.values():
        gains = Gains(*(np.array([value]) for value in values))
        assert (form_at(inequalities, duty, gains)[0] > 0).all()
        point = np.repeat(coordinates(duty, gains)[0][None], 5, 1)
        assert not unstable(inequalities, point, None)[0]
        assert not creeping(inequalities, point)[0]
        # Wishes that these gains keep leave pieces open, however long one cuts.
        kept = wishes.changed(
            {
                "error_ratio": 1.01 * float(quantity.error_ratio(weak, gains)[0]),
                "load_error": 1.01 * float(quantity.load_error(weak, gains)[0]),
            }
        )
        assert not refute(inequalities, Bounds.of(duty, kept), sprung=False, most=300)["proven"]
