"""Brake a joint from its torque sensor alone: simulate, and remove the position loop at 3 s."""

import numpy as np

from dashpot import Controller, Event, Payload, Robot, Scenario, build, load_controller, multisine, run

robot = Robot.load("k807")
config = load_controller("k807-wrist")
controller = Controller.from_config(config, robot.drives)
plant = build(robot, config.period, [Payload(4.5, 0.23)])
print(plant.step_said)

motion = multisine(robot.home, 6.0, config.period, seed=1, amplitude=0.3, peak_speed_at={6: 3.0})
recording = run(Scenario(plant, controller, motion, [Event(3.0, "joint7", "position_loop", False)]))

released = np.searchsorted(recording.time, 3.0)
for delay in (0.0, 0.1, 0.3, 2.9):
    tick = released + round(delay / config.period)
    angle = np.degrees(recording.link_position[tick, 6])
    speed = np.degrees(recording.link_velocity[tick, 6])
    print(f"{delay:4.1f} s after release: joint7 at {angle:6.2f} deg, {speed:7.2f} deg/s")
