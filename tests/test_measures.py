"""What a campaign keeps of a run: against NumPy and SciPy, and of signals whose measures are known."""

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.signal import butter, sosfilt, sosfilt_zi, sosfreqz

from dashpot.campaign.measures import AT_REST, LAST, MEASURES, NOISE_CORNER, SLOWED, STAYS, measure
from dashpot.simulation.recording import CHANNELS, Recording
from dashpot.simulation.vibration import CORNER, WINDOW, highpass


def recording_of(time, **values):
    faults = values.pop("faults", None)
    shape = next(iter(values.values())).shape
    reference = values.pop("reference", np.zeros(shape))
    channels = dict.fromkeys(CHANNELS, np.zeros(shape)) | values
    joints = tuple(f"joint{j}" for j in range(shape[1]))
    settings = {} if faults is None else {"faults": faults}
    return Recording(
        joints, time, reference, **channels, status=np.zeros(len(time), np.int32), settings=settings
    )


def filtered(signal, corner, period):
    """SciPy's, started where the signal has always been at its first value."""
    sections = butter(4, corner, "highpass", fs=1 / period, output="sos")
    return sosfilt(sections, signal, axis=0, zi=sosfilt_zi(sections)[:, :, None] * signal[0])[0]


def stops(angle, speed, period):
    """By the definition, tick by tick: time, angle, travel and drift of one joint."""
    ticks = len(angle)
    slow = np.abs(speed) < max(SLOWED * abs(speed[0]), AT_REST)
    stays = max(1, min(round(STAYS / period), ticks))
    way = np.maximum.accumulate(np.abs(angle - angle[0]))
    first = next((k for k in range(ticks - stays + 1) if slow[k : k + stays].all()), None)
    last = min(round(LAST / period), ticks - 1)
    drift = abs(angle[-1] - angle[-1 - last]) / (last * period) if last else abs(speed[-1])
    return (
        math.inf if first is None else first * period,
        way[-1 if first is None else first],
        way[-1],
        drift,
    )


@given(
    seed=st.integers(0, 2**32 - 1),
    ticks=st.integers(2, 900),
    n=st.integers(1, 9),
    period=st.sampled_from([0.001, 0.002, 0.005, 0.02]),
    share=st.floats(0, 1.1),
    off=st.floats(0, 1),
)
@example(seed=0, ticks=232, n=3, period=0.02, share=0.0, off=0.0)
def test_the_numbers_are_those_of_numpy_and_scipy(seed, ticks, n, period, share, off):
    rng = np.random.default_rng(seed)
    begin = ticks // 8
    time = period * (np.arange(ticks) - begin)
    period = float(time[1] - time[0])  # as a recording has it: by a rounding another
    table = {name: rng.normal(size=(ticks, n)).cumsum(0) * 0.1 for name in ("reference", *CHANNELS)}
    table["link_velocity"] *= np.exp(-rng.uniform(0, 0.2) * np.arange(ticks))[:, None]
    at = min(int(share * ticks), ticks)
    event = None if at == ticks else float(time[at])
    start = float(time[int(off * (ticks - 1))])
    faults = [{"kind": "brownout", "start": start, "end": start + 3 * period}]
    recording = recording_of(time, faults=faults, **table)
    limits, rates = rng.uniform(1, 100, n), rng.uniform(1, 1000, n)
    found = measure(recording, event, limits, recording.joints, rates)
    assert list(found) == list(MEASURES)

    close = {"rtol": 1e-9, "atol": 1e-12}
    error = table["reference"] - table["link_position"]
    before = error[begin:at]
    if len(before):
        np.testing.assert_allclose(found["error_rms"], np.sqrt((before**2).mean(0)), **close)
        np.testing.assert_array_equal(found["error_max"], np.abs(before).max(0))
        np.testing.assert_allclose(found["error_mean"], before.mean(0), **close)
        np.testing.assert_allclose(found["error_std"], before.std(0), **close)
    else:
        assert np.isnan([found[f"error_{name}"] for name in ("rms", "max", "mean", "std")]).all()
    names = ("stop_time", "stop_angle", "travel", "drift_speed")
    if at < ticks:
        np.testing.assert_array_equal(found["error_after"], np.abs(error[at:]).max(0))
        for j in range(n):
            own = stops(table["link_position"][at:, j], table["link_velocity"][at:, j], period)
            np.testing.assert_allclose([found[name][j] for name in names], own, **close)
    else:
        assert np.isnan([found[name] for name in ("error_after", *names)]).all()
    np.testing.assert_array_equal(found["speed_peak"], np.abs(table["link_velocity"]).max(0))
    np.testing.assert_array_equal(found["torque_peak"], np.abs(table["in_effect"]).max(0))
    on = np.ones(ticks, bool)
    first = int(off * (ticks - 1))
    on[first : first + 3] = False
    steps = np.abs(np.diff(table["command"][on], axis=0)).max(0, initial=0.0)
    np.testing.assert_allclose(found["rate_share"], steps / (rates * period), **close)
    if 0.5 / period > 1.5 * NOISE_CORNER:
        noise = np.sqrt((filtered(table["command"][begin:], NOISE_CORNER, period) ** 2).mean(0))
        np.testing.assert_allclose(found["torque_noise"], noise, rtol=1e-8, atol=1e-12)
    window = min(round(WINDOW / period), (ticks - begin) // 3)
    if window:
        swing = filtered(table["sample"][begin:], CORNER, period)
        last, earlier = (
            np.sqrt((part**2).mean(0)) for part in (swing[-window:], swing[-2 * window : -window])
        )
        np.testing.assert_allclose(found["vibration"], last, rtol=1e-7, atol=1e-10)
        np.testing.assert_allclose(found["growth"], last / earlier, rtol=1e-6)


@pytest.mark.parametrize(("corner", "period"), [(3.0, 0.001), (3.0, 0.005), (30.0, 0.001), (30.0, 0.005)])
def test_the_high_pass_is_butterworths(corner, period):
    ours = highpass(corner, period)
    sections = np.column_stack([ours[:, :3], np.ones(2), ours[:, 3:]])
    frequencies, response = sosfreqz(sections, 512, fs=1 / period)
    wanted = sosfreqz(butter(4, corner, "highpass", fs=1 / period, output="sos"), 512, fs=1 / period)[1]
    np.testing.assert_allclose(response[1:], wanted[1:], rtol=1e-9)
    assert abs(response[np.abs(frequencies - corner).argmin()]) < 1
    assert highpass(corner, 0.4 / corner) is None  # sampled too slowly


def test_what_is_not_a_number_is_told_or_left_out():
    time, table = 1e-3 * np.arange(400), np.zeros((400, 2))
    broken = table.copy()
    broken[200, 1] = np.nan
    found = measure(recording_of(time, sample=broken, in_effect=broken), None, np.ones(2), [])
    assert np.isnan(found["vibration"]).all()  # the filter would carry it on
    assert found["torque_peak"][0] == 0
    assert np.isnan(found["torque_peak"][1])


def test_stops_of_a_decaying_swing():
    period, pole = 1e-3, 8.0
    time = period * np.arange(3000)
    speed = 0.5 * np.exp(-pole * time)
    angle = 0.5 / pole * (1 - np.exp(-pole * time))
    recording = recording_of(
        time,
        link_position=np.stack([angle, 0.3 * time], 1),
        link_velocity=np.stack([speed, np.full_like(time, 0.3)], 1),
    )
    found = measure(recording, 0.0, np.ones(2), recording.joints)
    assert found["stop_time"][0] == pytest.approx(math.log(20) / pole, abs=1.1 * period)
    assert found["stop_angle"][0] == pytest.approx(0.5 / pole * 0.95, rel=1e-2)
    assert found["travel"][0] == pytest.approx(0.5 / pole, rel=1e-6)
    assert found["stop_time"][1] == math.inf
    assert found["drift_speed"] == pytest.approx([0.0, 0.3], abs=1e-5)


def test_measures_of_known_signals():
    period, n = 1e-3, 4000
    time = period * np.arange(n) - 1.0
    zero = np.zeros((n, 1))
    growing = (np.exp(0.8 * time) * np.sin(2 * np.pi * 12 * time))[:, None]
    ripple = 0.02 * np.sin(2 * np.pi * 100 * time)[:, None] + np.sin(2 * np.pi * 0.5 * time)[:, None]
    values = dict.fromkeys(CHANNELS, zero) | {"sample": growing, "command": ripple, "in_effect": -3 * ripple}
    values["link_position"] = zero - 0.01
    recording = Recording(("j",), time, zero, **values, status=np.zeros(n, np.int32))
    found = measure(recording, None, np.array([6.0]), ["j"])
    assert found["torque_noise"][0] == pytest.approx(0.02 / math.sqrt(2), rel=0.03)
    assert found["growth"][0] == pytest.approx(math.exp(0.8), rel=0.02)
    for name in ("error_rms", "error_max", "error_mean"):
        assert found[name][0] == pytest.approx(0.01)
    assert found["torque_share"][0] == pytest.approx(0.5, rel=0.03)
    assert np.isnan(found["stop_time"]).all()
    assert (found["limited"], found["diverged_at"]) == (0.0, math.inf)
    after = measure(recording, 1.0, np.array([6.0]), [])
    assert np.isnan(after["stop_time"]).all()  # not under the controller
    assert after["error_after"][0] == pytest.approx(0.01)
