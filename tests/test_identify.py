"""Identification: filter and regression against closed forms and Monte Carlo, drives against simulation."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import erf

from dashpot.arm.drive import Drive
from dashpot.errors import InputError, InputWarning
from dashpot.identify import identify_joint
from dashpot.identify.refusals import ALL
from dashpot.identify.regression import long_run, two_stage
from dashpot.identify.transmission import stop
from dashpot.identify.weak import WeakForm, sensor_memory
from dashpot.logs.log import Log, Segment
from dashpot.studies import identification_blind, identification_cases
from dashpot.studies.identification import judge, judge_blind, plain_least_squares
from dashpot.studies.identification_blind import KINDS
from dashpot.studies.identification_cases import JOINT, known, random_bench, simulate, to_log, truth

SEED = 31
DRIVES = (0, 2)
SOME_KINDS = [kind for i, kind in enumerate(KINDS) if i % 5 == 1]  # all: make evidence-identify
DRIVE = Drive(JOINT, rotor_inertia=1.0, viscous_friction=1.0, stiffness=1e4, torque_limit=1e3)
FILTERED = replace(DRIVE, sensor_bandwidth=60.0, sensor_damping=0.7, torque_latency=1.3e-3)


@pytest.fixture(scope="module", autouse=True)
def short():
    """Logs of half the length that the evidence has."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(identification_cases, "DURATION", 12.0)
        patch.setattr(identification_blind, "SECONDS", 10.0)
        yield


@pytest.fixture(scope="module")
def case(short):
    """A random drive, its log, what is known of it, and the truth."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        bench = random_bench(SEED, 2)
        step = bench.plant().timestep
        log = to_log(bench, simulate(bench, SEED, 2))
        return log, known(bench, step), truth(bench, step)


@pytest.fixture(scope="module")
def estimate(case):
    return identify_joint(case[0], JOINT, case[1])


def changed(log, **channels):
    """The log with channels of its first segment replaced."""
    return replace(log, segments=(replace(log.segments[0], **channels),))


# The weak form


@pytest.mark.parametrize("derivative", [0, 1, 2])
@pytest.mark.parametrize("sampling", ["point", "average"])
def test_a_sine_passes_kernel_and_sensor_as_theory_says(derivative, sampling):
    h, kernel, omega = 1e-3, 6e-3, 2 * math.pi * 7.3
    t = h * np.arange(4000)
    weak = WeakForm(len(t), h, kernel, FILTERED, sampling)
    s = 1j * omega
    x = s / (2 * math.pi * 60.0)
    gain = math.exp(-0.5 * (kernel * omega) ** 2) * np.exp(-s * 1.3e-3) / (1 + 1.4 * x + x * x)
    if sampling == "average":
        gain *= (1 - np.exp(-s * h)) / (s * h)
    expected = (s**derivative * gain * np.exp(s * t)).imag
    found = weak.filtered(weak.spectrum(np.sin(omega * t)), derivative=derivative)
    # What the low-pass remembers and the kernel sees of the ends is left out.
    edge = math.ceil((sensor_memory(FILTERED, sampling, h) + 8 * kernel) / h)
    assert np.abs(found - expected)[edge:-edge].max() < 1e-6 * omega**derivative


def test_a_held_command_is_integrated_exactly_at_any_latency():
    h, kernel, latency = 5e-3, 0.012, 0.0031
    u = np.random.default_rng(3).normal(size=400)
    weak = WeakForm(len(u), h, kernel, DRIVE, "point")
    found = weak.filtered(weak.spectrum(u), hold=True, delay=latency)
    starts = h * np.arange(len(u)) + latency
    for k in (150, 200, 251):
        edges = (k * h - np.array([starts, starts + h])) / (math.sqrt(2) * kernel)
        assert found[k] == pytest.approx(0.5 * np.sum(u * (erf(edges[0]) - erf(edges[1]))), abs=1e-7)


# The regression


def test_the_stop_operator_is_the_element_that_sticks_and_slips():
    x = np.cumsum(np.random.default_rng(5).normal(size=3000))
    z, expected = 0.0, [0.0]
    for step in np.diff(x):
        z = min(max(z + step, -4.0), 4.0)
        expected.append(z)
    assert np.abs(stop(x, 4.0) - expected).max() < 1e-9


def test_instruments_take_out_the_bias_of_noisy_regressors_and_intervals_hold():
    rng = np.random.default_rng(8)
    inside, errors, plain = 0, [], []
    for _ in range(100):
        truth = np.cumsum(rng.normal(size=(1500, 2)), 0) * 0.05 + rng.normal(size=(1500, 2)) * 0.1
        y = truth @ [2.0, -1.0]
        noisy, other = (truth + 0.5 * rng.normal(size=truth.shape) for _ in range(2))
        found = two_stage(y, noisy, other, 1500.0)
        half = found.quantile * math.sqrt(found.cov[0, 0])
        errors.append(found.theta[0] - 2)
        plain.append(np.linalg.lstsq(noisy, y, rcond=None)[0][0] - 2)
        inside += abs(errors[-1]) < half
    assert abs(np.mean(plain)) > 10 * abs(np.mean(errors))
    assert 0.90 <= inside / 100 <= 0.99
    assert found.unseen.shape[1] == 0


def test_long_run_variance_of_a_correlated_series_is_that_of_its_sum():
    rng = np.random.default_rng(1)
    sums, found = [], []
    for _ in range(400):
        series = np.convolve(rng.normal(size=2000), np.ones(12), "valid")
        sums.append(series.sum())
        found.append(long_run(series[:, None], 20)[0, 0])
    assert np.mean(found) == pytest.approx(np.var(sums), rel=0.15)


def test_a_direction_that_only_noise_shows_is_called_unseen():
    rng = np.random.default_rng(2)
    motion = np.cumsum(rng.normal(size=1000)) * 0.1
    X = np.stack([motion + 0.01 * rng.normal(size=1000), 3 * motion + 0.01 * rng.normal(size=1000)], 1)
    found = two_stage(X @ [1.0, 1.0], X, np.stack([motion, rng.normal(size=1000)], 1), 300.0)
    direction = found.unseen[:, 0] * np.sqrt((X * X).mean(0))
    assert found.unseen.shape[1] == 1
    assert np.abs(direction @ [1, 1]) < 0.1  # one up, the other down


# Whole drives


def test_intervals_hold_the_simulated_drives():
    found = [judge(SEED, number) for number in DRIVES]
    held, total = 0, 0
    for verdict in found:
        for name, (value, low, high) in verdict.found.items():
            true = verdict.truth[name]
            held, total = held + (low <= true <= high), total + 1
            assert abs(value - true) <= 2.5 * max(high - value, value - low), (verdict.number, name)
    assert total >= 12
    assert held / total >= 0.9
    inertia = [
        abs(v.found["rotor_inertia"][0] / v.truth["rotor_inertia"] - 1)
        for v in found
        if "rotor_inertia" in v.found
    ]
    viscous = [
        abs(v.found["viscous_friction"][0] / v.truth["viscous_friction"] - 1)
        for v in found
        if "viscous_friction" in v.found
    ]
    assert np.median(inertia) < 0.01
    assert np.median(viscous) < 0.03


def test_plain_least_squares_is_biased_where_the_weak_form_is_not(case, estimate):
    log, _, true = case
    plain = plain_least_squares(log)["rotor_inertia"]
    mine = estimate.values["rotor_inertia"].value
    assert abs(plain / true["rotor_inertia"] - 1) > 10 * abs(mine / true["rotor_inertia"] - 1)


def test_torques_in_another_unit_give_the_same_drive_in_that_unit(case, estimate):
    log, drive, _ = case
    segment = log.segments[0]
    other = changed(log, command=0.1 * segment.command, torque=0.1 * segment.torque)
    found = identify_joint(other, JOINT, replace(drive, torque_limit=0.1 * drive.torque_limit))
    for name, mine in estimate.values.items():
        factor = 1.0 if name in ("latency", "torque_scale_error", "stribeck_velocity") else 0.1
        assert found.values[name].value == pytest.approx(factor * mine.value, rel=1e-5, abs=1e-9)
        assert found.values[name].high == pytest.approx(factor * mine.high, rel=1e-5, abs=1e-9)


def test_a_joint_that_counts_the_other_way_is_the_same_drive(case, estimate):
    log, drive, _ = case
    s = log.segments[0]
    other = changed(
        log, command=-s.command, torque=-s.torque, position=-s.position, link_position=-s.link_position
    )
    found = identify_joint(other, JOINT, drive)
    for name, mine in estimate.values.items():
        sign = -1 if name == "torque_bias" else 1
        assert found.values[name].value == pytest.approx(sign * mine.value, rel=1e-6, abs=1e-9)


def test_each_joint_of_a_log_is_identified_by_itself(case, estimate):
    log, drive, _ = case
    s = log.segments[0]
    rng = np.random.default_rng(0)
    two = [np.column_stack([rng.normal(size=len(s.time)), x]) for x in (s.command, s.torque, s.position)]
    links = np.column_stack([s.link_position, s.link_position])
    both = replace(log, joints=("other", JOINT), segments=(Segment(s.time, *two, None, links),))
    both = changed(both, link_position=links[:, ::-1].copy())
    assert identify_joint(both, JOINT, drive).values == estimate.values


def test_a_log_in_two_pieces_tells_the_same_within_its_intervals(case):
    log, drive, true = case
    s = log.segments[0]
    cut = len(s.time) // 2
    parts = [
        Segment(s.time[i], s.command[i], s.torque[i], s.position[i], None, s.link_position[i])
        for i in (slice(0, cut), slice(cut + 40, None))
    ]
    found = identify_joint(replace(log, segments=tuple(parts)), JOINT, drive).values["rotor_inertia"]
    assert abs(found.value - true["rotor_inertia"]) < 2 * (found.high - found.value)


def test_a_logged_velocity_does_whatever_its_delay_within_a_period(case):
    log, drive, true = case
    s = log.segments[0]
    quotient = np.diff(s.position, axis=0, prepend=s.position[:1]) / log.period
    found = identify_joint(changed(log, position=None, velocity=quotient, link_position=None), JOINT, drive)
    assert "stiffness" not in found.values
    for name in ("rotor_inertia", "viscous_friction", "coulomb_friction"):
        estimate = found.values[name]
        assert abs(estimate.value - true[name]) < 2 * (estimate.high - estimate.value)
        assert abs(estimate.value / true[name] - 1) < 0.05


def test_residual_and_prediction_add_up_to_the_command(estimate):
    fit = estimate.fit
    assert np.allclose(fit.predicted + fit.residual, fit.measured)
    assert fit.residual_std == pytest.approx(np.std(fit.residual[fit.used]), rel=1e-6)
    assert 0.3 < fit.used.mean() < 1


# Refusals


@pytest.mark.parametrize("kind", SOME_KINDS)
def test_a_log_that_hides_something_is_refused_and_says_what(kind):
    _, _, missing, refused = judge_blind(SEED, kind, 0)
    assert not missing
    assert all(reason and "\n" not in reason for reason in refused.values())


def test_a_known_scale_tells_what_an_inertia_alone_hides():
    kind = KINDS["no load but inertia"]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        bench = kind.bench(SEED, 1)
        log = kind.make(bench, np.random.default_rng(4))
    step = bench.plant().timestep
    sensor, true = known(bench, step), truth(bench, step)
    blind = identify_joint(log, JOINT, sensor)
    told = identify_joint(log, JOINT, sensor, scale=bench.drive.torque_scale_error)
    assert "rotor_inertia" not in blind.values
    found = told.values["rotor_inertia"]
    assert abs(found.value - true["rotor_inertia"]) < 1.5 * (found.high - found.value)
    assert "torque_scale_error" not in told.values


@pytest.mark.parametrize(
    ("change", "rule"),
    [
        (lambda s: {"torque": np.where(s.time[:, None] > 5, np.nan, s.torque)}, "must be finite"),
        (lambda s: {"position": s.position * 1e9}, "check the unit"),
        (lambda s: {"position": None}, "neither position nor velocity"),
    ],
)
def test_values_that_cannot_be_are_named(case, change, rule):
    log, drive, _ = case
    with pytest.raises(InputError, match=rule) as caught:
        identify_joint(changed(log, **change(log.segments[0])), JOINT, drive)
    assert JOINT in str(caught.value)


def test_a_joint_that_is_not_there_and_a_scale_that_cannot_be_are_named(case):
    log, drive, _ = case
    with pytest.raises(InputError, match="no such joint"):
        identify_joint(log, "joint9", drive)
    with pytest.raises(InputError, match=r"between -0\.5 and 0\.5"):
        identify_joint(log, JOINT, drive, scale=math.nan)


def test_a_torque_of_the_other_sign_is_refused(case):
    log, drive, _ = case
    found = identify_joint(changed(log, torque=-log.segments[0].torque), JOINT, drive)
    assert not found.values
    assert "sign" in found.refused[0].motion


@pytest.mark.parametrize("samples", [0, 1, 2, 30, 400])
def test_the_shortest_logs_are_refused(samples):
    columns = np.random.default_rng(0).normal(size=(4, samples, 1))
    segment = Segment(np.arange(samples) * 0.01, columns[0], columns[1], columns[2], None, columns[3])
    found = identify_joint(Log((JOINT,), 0.01, (segment,), "point", None, ""), JOINT, DRIVE)
    assert not found.values
    assert set(ALL) <= set(found.refused[0].quantities)


@pytest.mark.parametrize("scale", [1e-12, 1.0, 1e3])
def test_noise_alone_is_refused_at_any_size(scale):
    columns = scale * np.random.default_rng(7).normal(size=(3, 8000, 1))
    segment = Segment(np.arange(8000) * 1e-3, columns[0], columns[1], columns[2] / 2, None, None)
    drive = replace(DRIVE, torque_limit=5e3)
    found = identify_joint(Log((JOINT,), 1e-3, (segment,), "point", None, ""), JOINT, drive)
    assert {"rotor_inertia", "viscous_friction"} <= {n for r in found.refused for n in r.quantities}
