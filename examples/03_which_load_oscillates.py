"""Which payload makes an arm oscillate? Eigenvalues and mode shapes of the linearised sampled arm."""

import warnings

import numpy as np

from dashpot import Controller, InputWarning, Payload, Robot, build, load_controller
from dashpot.simulation.linear import linearise, modes

robot = Robot.load("k807")
config = load_controller("k807-resonant")
with warnings.catch_warnings():
    warnings.simplefilter("ignore", InputWarning)  # these gains are a bad example on purpose
    controller = Controller.from_config(config, robot.drives)

pose = np.array(robot.home)
pose[robot.index("joint6")] = np.radians(-3)  # axes 5 and 7 nearly parallel
for mass in (0.0, 1.0, 2.3, 3.5, 4.5):
    plant = build(robot, config.period, [Payload(1.2, 0.115, length=0.23), Payload(mass, 0.23)])
    arm = linearise(plant, controller.joints, pose, config.period, config.sampling)
    worst = next(mode for mode in modes(arm, controller) if mode.frequency > 0.5)
    shape = ", ".join(f"{abs(s):.2f}" for s in worst.shape[4:])
    verdict = "grows" if worst.growth > 0 else "decays"
    print(
        f"{mass:3.1f} kg: {worst.frequency:4.1f} Hz {verdict} at {worst.growth:+.2f} /s, joints 5-7: {shape}"
    )
