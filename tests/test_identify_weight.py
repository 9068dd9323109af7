"""Logs of robots that carry their own weight."""

from dataclasses import replace

import numpy as np
import pytest

from dashpot.arm.plant import build
from dashpot.arm.robot import Robot
from dashpot.control.controller import Controller, ControllerConfig, JointGains
from dashpot.identify import identify_joint
from dashpot.identify.weight import weight_aligned
from dashpot.logs.log import from_recording
from dashpot.simulation.simulate import Scenario, run
from dashpot.simulation.trajectory import Trajectory

HEAVY = """<mujoco><option timestep="0.001"/><worldbody><body name="link"><joint name="joint" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.6" size="0.03" mass="4"/><site name="flange" pos="0 0 -0.6"/></body>
</worldbody></mujoco>"""
CARRIES = """name = "rod"
model = "rod.xml"
flange = "flange"
home = [0.0]
gravity_compensation = true
[[joint]]
name = "joint"
rotor_inertia = 0.4
viscous_friction = 1.0
coulomb_friction = 0.5
stiffness = 8000.0
damping = 2.0
torque_limit = 80.0
sensor_bandwidth = 40.0
sensor_order = 1
torque_noise = 0.01
"""


def test_a_robot_that_carries_its_own_weight_shows_its_friction_all_the_same(tmp_path):
    """Sensor and hold are late, the weight taken off is not: 12 N m/rad times that looks like friction."""
    (tmp_path / "rod.xml").write_text(HEAVY)
    (tmp_path / "rod.toml").write_text(CARRIES)
    robot = Robot.load(tmp_path / "rod.toml")
    config = ControllerConfig((JointGains("joint", R=1.0, D=5.0, kp=400.0, kd=40.0),), period=1e-3)
    plant = build(robot, 1e-4)
    time = np.arange(20_000) * 1e-3
    rates = 2 * np.pi * np.array([0.31, 0.77, 1.3])
    angle, speed, growth = (
        sum(0.25 * rate**k * f(rate * time) for rate in rates)
        for k, f in ((0, np.sin), (1, np.cos), (2, lambda x: -np.sin(x)))
    )
    path = Trajectory(1e-3, angle[:, None], speed[:, None], growth[:, None])
    controller = Controller.from_config(config, robot.drives)
    log = from_recording(run(Scenario(plant, controller, path, gravity_compensation=True)), "point")
    left = identify_joint(log, "joint", robot.drives[0]).values["viscous_friction"]
    slope = 4 * 9.81 * 0.3
    lag = 0.5e-3 + 1 / (2 * np.pi * 40)
    assert left.low > 1.0
    assert left.value == pytest.approx(1.0 + slope * lag * np.cos(angle).mean(), abs=0.01)
    aligned = weight_aligned(log, robot)
    found = identify_joint(aligned, "joint", robot.drives[0])
    assert abs(found.values["viscous_friction"].value - 1.0) < 0.15 * abs(left.value - 1.0)
    assert "stiffness" not in found.values
    assert weight_aligned(log, replace(robot, model=None)) is None
