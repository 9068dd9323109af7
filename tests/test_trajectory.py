"""Reference motions: consistent derivatives, rest at the start."""

from __future__ import annotations

import numpy as np
import pytest

from dashpot.errors import InputError
from dashpot.simulation.trajectory import hold, multisine

POSE = [0.3, -0.2, 1.0]


@pytest.mark.parametrize("seed", range(5))
def test_velocity_and_acceleration_are_the_derivatives_of_position(seed):
    h = 1e-4
    motion = multisine(POSE, 3.0, h, seed, amplitude=[0.4, 0.1, 0.0], lead_in=0.5, ramp=0.7)
    for low, high in ((motion.position, motion.velocity), (motion.velocity, motion.acceleration)):
        np.testing.assert_allclose((low[2:] - low[:-2]) / (2 * h), high[1:-1], atol=2e-3 * np.abs(high).max())
    for values in (motion.position, motion.velocity, motion.acceleration):
        assert np.abs(np.diff(values, axis=0)).max() < 0.02  # continuous, the ramp's ends included
    np.testing.assert_array_equal(motion.position[:, 2], 1.0)


@pytest.mark.parametrize("seed", range(5))
def test_a_multisine_starts_at_rest_and_stays_within_its_amplitude(seed):
    motion = multisine(POSE, 6.0, 1e-3, seed, amplitude=0.4, lead_in=1.0)
    before = motion.time <= 0
    assert before.sum() == 1001
    assert motion.time[0] == -1.0
    np.testing.assert_array_equal(motion.position[before], np.tile(POSE, (1001, 1)))
    np.testing.assert_array_equal(motion.velocity[before], 0)
    np.testing.assert_array_equal(motion.acceleration[before], 0)
    away = np.abs(motion.position - POSE).max(0)
    assert (away <= 0.4 + 1e-12).all()
    assert (away > 0.1).all()


def test_a_joint_is_fastest_when_told():
    instant = 2.5
    motion = multisine(POSE, 6.0, 1e-3, 3, peak_speed_at={1: instant})
    other = multisine(POSE, 6.0, 1e-3, 3)
    at = np.argmin(np.abs(motion.time - instant))
    speed = np.abs(motion.velocity[:, 1])
    assert motion.velocity[at, 1] == pytest.approx(speed[motion.time > 1].max())  # after the ramp
    assert motion.position[at, 1] == pytest.approx(POSE[1], abs=1e-9)
    np.testing.assert_array_equal(motion.position[:, [0, 2]], other.position[:, [0, 2]])


def test_seeds_make_motions():
    a, b, c = (multisine(POSE, 2.0, 1e-2, seed).position for seed in (1, 1, 2))
    np.testing.assert_array_equal(a, b)
    assert np.abs(a - c).max() > 0.05


def test_hold_is_rest():
    rest = hold(POSE, 1.0, 5e-3)
    assert rest.position.shape == (200, 3)
    assert not rest.velocity.any()
    assert not rest.acceleration.any()
    np.testing.assert_allclose(rest.time, 5e-3 * np.arange(200))


@pytest.mark.parametrize(
    ("duration", "period", "word"),
    [
        (0.0, 1e-3, "duration"),
        (np.nan, 1e-3, "duration"),
        (2e5, 1e-3, "duration"),
        (1.0, 0.0, "period"),
        (1.0, 2.0, "period"),
        (1.0, np.nan, "period"),
    ],
)
def test_a_bad_duration_or_period_is_refused(duration, period, word):
    with pytest.raises(InputError, match=word):
        hold(POSE, duration, period)
