"""Logs made from recordings: what a robot would have kept of a simulated run."""

from __future__ import annotations

import numpy as np
import pytest

from dashpot.arm.plant import build
from dashpot.arm.robot import Robot
from dashpot.control.controller import Controller, load_controller
from dashpot.errors import InputError
from dashpot.logs.log import Log, Segment, from_recording
from dashpot.simulation.simulate import Scenario, run
from dashpot.simulation.trajectory import multisine


@pytest.fixture(scope="module")
def wrist():
    """The k807 without sensor noise, joints 1-4 under their servos: (robot, controller, path, recording)."""
    robot = Robot.load("k807")
    robot = robot.with_drives({name: {"torque_noise": 0.0} for name in robot.joints})
    config = load_controller("k807-wrist")
    controller = Controller.from_config(config, robot.drives)
    path = multisine(robot.home, 4.0, config.period, 3, amplitude=0.3, band=(0.3, 1.2))
    return robot, controller, path, run(Scenario(build(robot, config.period), controller, path))


def logged(wrist):
    robot, controller, path, recording = wrist
    return from_recording(
        recording,
        controller.sampling,
        drives=robot.drives,
        trajectory=path,
        controlled=controller.joints,
    )


def test_log_obeys_the_rotor_equation_over_each_period(wrist):
    """mean u - mean tau_s = m [q'] / h + v [q] / h + tau_c sign q': the file's values, servo or not."""
    robot, controller, _, recording = wrist
    log = logged(wrist)
    segment, h = log.segments[0], log.period
    assert (log.joints, h, log.sampling) == (robot.joints, controller.period, "average")
    assert segment.time[0] == 0
    for j, drive in enumerate(robot.drives):
        w = recording.velocity[: len(segment.time), j]
        rate = np.diff(segment.position[:, j]) / h
        acceleration = np.diff(w) / h
        sliding = (np.abs(rate) > 0.05) & (np.sign(w[1:]) == np.sign(w[:-1]))
        X = np.stack([acceleration, rate, np.sign(rate), np.ones_like(rate)], 1)[sliding]
        # A torque sample stands for the period before it, a command for the period after it.
        net = (segment.command[:-1, j] - segment.torque[1:, j])[sliding]
        m, v, friction, bias = np.linalg.lstsq(X, net, rcond=None)[0]
        assert m == pytest.approx(drive.rotor_inertia, rel=0.005)
        assert v == pytest.approx(drive.viscous_friction, rel=0.02)
        assert friction == pytest.approx(drive.coulomb_friction, rel=0.01)
        assert abs(bias) < 0.005 * drive.coulomb_friction


def test_commands_of_controlled_joints_are_what_the_controller_sent(wrist):
    _, controller, _, recording = wrist
    log = logged(wrist)
    for name in controller.joints:
        j = log.joints.index(name)
        np.testing.assert_array_equal(log.segments[0].command[:, j], recording.command[:-1, j])


def test_what_follows_a_divergence_is_left_out(wrist):
    recording = wrist[3]
    fields = dict(vars(recording))
    sample = recording.sample.copy()
    sample[100:] = np.nan
    cut = type(recording)(**fields | {"sample": sample})
    log = from_recording(cut, "average")
    assert len(log.segments[0].time) == 99
    assert np.isfinite(log.segments[0].torque).all()
    sample[1:] = np.nan
    with pytest.raises(InputError, match="less than two ticks"):
        from_recording(type(recording)(**fields | {"sample": sample}), "average")


def test_one_joint_of_a_log_has_only_what_was_logged_for_it():
    time = np.arange(5) * 0.01
    both = np.arange(10.0).reshape(5, 2)
    half = both.copy()
    half[:, 1] = np.nan
    log = Log(("a", "b"), 0.01, (Segment(time, both, -both, half, both, None),), "point")
    a, b = log.only("a"), log.only("b")
    assert (a.joints, b.joints) == (("a",), ("b",))
    np.testing.assert_array_equal(a.segments[0].position, both[:, :1])
    assert b.segments[0].position is None
    np.testing.assert_array_equal(b.segments[0].torque, -both[:, 1:])
    assert log.duration == pytest.approx(0.05)
    with pytest.raises(InputError, match="no such joint in the log; it has a, b"):
        log.only("c")
