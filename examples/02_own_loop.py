"""The controller in a loop of your own: write the inputs, step, send the command. Nothing is allocated."""

import numpy as np

from dashpot import Controller, ControllerConfig, Drive, JointGains
from dashpot.control.controller import NOT_FINITE

drive = Drive(
    "elbow", rotor_inertia=0.2, viscous_friction=0.5, stiffness=1.2e4, damping=5.0, torque_limit=87.0
)
config = ControllerConfig((JointGains("elbow", R=5.0, D=10.0),), period=0.001)
controller = Controller.from_config(config, [drive])

command = np.zeros(1)
controller.warm_start("elbow", velocity=1.2)  # the last velocity you trusted
for tick in range(5):
    controller.inputs.torque[:] = 3.0  # your sensor, N m
    controller.step(command)
    print(f"tick {tick}: command {command[0]:7.3f} N m")

controller.inputs.torque[:] = np.nan  # a broken sensor
status = controller.step(command)
print(f"sensor lost: command {command[0]:7.3f} N m held, not finite: {bool(status & NOT_FINITE)}")
