"""Stribeck friction: the simulated law, its checks, and its identification."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dashpot.arm.drive import Drive, Servo
from dashpot.arm.plant import build
from dashpot.arm.robot import Robot
from dashpot.control.controller import Controller
from dashpot.control.sampled import VELOCITY_REF, empty_block
from dashpot.errors import InputError
from dashpot.simulation.simulate import Scenario, run
from dashpot.simulation.trajectory import Trajectory

ARM = """<mujoco><option gravity="0 0 0"/><worldbody><body><joint name="j" axis="0 1 0"/>
<inertial mass="1" pos="0 0 0" diaginertia=".1 .1 .1"/></body></worldbody></mujoco>"""
VALUES = {
    "rotor_inertia": 0.1,
    "viscous_friction": 2.0,
    "coulomb_friction": 1.0,
    "stiffness": 3e3,
    "damping": 2.0,
    "torque_limit": 100.0,
}


def robot(folder, **values):
    path = folder / "arm.xml"
    path.write_text(ARM)
    return Robot("one", (Drive("j", **{**VALUES, **values}),), path)


@pytest.mark.parametrize("speed", [0.02, 0.05, 0.1, 0.4])
def test_sliding_friction_at_a_steady_speed_is_the_law(tmp_path, speed):
    arm = robot(tmp_path, stribeck_friction=2.5, stribeck_velocity=0.1, servo=Servo(kp=2e3, kd=60.0, ki=2e4))
    h = 1e-3
    time = h * np.arange(3000, dtype=float)[:, None]
    path = Trajectory(h, speed * time, speed + 0 * time, 0 * time)
    recording = run(Scenario(build(arm, h), None, path))
    force = float(recording.in_effect[-500:].mean()) - 2.0 * speed
    assert force == pytest.approx(1.0 + 1.5 * math.exp(-((speed / 0.1) ** 2)), rel=5e-3)


@pytest.mark.parametrize(("torque", "moves"), [(2.3, False), (2.7, True)])
def test_a_resting_rotor_breaks_away_at_the_stribeck_level(tmp_path, torque, moves):
    arm = robot(tmp_path, stribeck_friction=2.5, stribeck_velocity=0.1)
    block = empty_block()
    block["D"][VELOCITY_REF] = 1.0
    ramp = np.minimum(np.arange(600) / 300, 1.0)[:, None] * torque
    path = Trajectory(5e-3, 0 * ramp, ramp, 0 * ramp)
    source = Controller(np.array([block]), ("j",), 5e-3, "point")
    recording = run(Scenario(build(arm, 5e-3), source, path))
    assert (float(np.abs(recording.velocity[-1, 0])) > 0.1) == moves


def test_a_breakaway_level_equal_to_coulomb_friction_changes_nothing(tmp_path):
    block = empty_block()
    block["D"][VELOCITY_REF] = 1.0
    wave = 2 * np.sin(0.05 * np.arange(400))[:, None]
    path = Trajectory(5e-3, 0 * wave, wave, 0 * wave)
    runs = [
        run(Scenario(build(arm, 5e-3), Controller(np.array([block]), ("j",), 5e-3, "point"), path))
        for arm in (robot(tmp_path), robot(tmp_path, stribeck_friction=1.0, stribeck_velocity=0.1))
    ]
    assert np.array_equal(runs[0].position, runs[1].position)


@pytest.mark.parametrize(
    ("values", "quantity"),
    [
        ({"stribeck_friction": 0.5, "stribeck_velocity": 0.1}, "stribeck_friction"),
        ({"stribeck_friction": 1.5}, "stribeck_velocity"),
        ({"stribeck_friction": -1.0}, "stribeck_friction"),
        ({"stribeck_friction": math.nan}, "stribeck_friction"),
    ],
)
def test_a_law_that_cannot_be_is_named(values, quantity):
    with pytest.raises(InputError, match=quantity):
        Drive("j", **{**VALUES, **values})
