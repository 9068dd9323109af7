"""Identify a drive from a log: an informative motion, a simulated log, intervals, and the truth."""

from dashpot import Controller, Robot, load_controller
from dashpot.arm.payload import Payload
from dashpot.arm.plant import build
from dashpot.excite import excite
from dashpot.identify import identify_joint
from dashpot.logs.log import from_recording
from dashpot.simulation.simulate import Scenario, run

robot, config = Robot.load("k807"), load_controller("k807-wrist")
weight = Payload(3.0, 0.15)  # kg, m off the axis: without it joint 7's sensor shows nothing but J q''
motion = excite(robot, duration=20.0, period=config.period, joints=("joint6", "joint7"), payloads=[weight])

controller = Controller.from_config(config, robot.drives)
plant = build(robot, config.period, [weight])
log = from_recording(run(Scenario(plant, controller, motion.trajectory)), controller.sampling)
# Your own: log = dashpot.logs.read_log("log.mcap"), columns as in docs/logs.md.

name = "joint7"
drive = robot.drives[robot.index(name)]
found = identify_joint(log.only(name), name, drive)
for key, estimate in found.values.items():
    truth = getattr(drive, key, None)
    print(
        f"{name} {key:18s} {estimate.value:10.4g} in [{estimate.low:.4g}, {estimate.high:.4g}] "
        f"{estimate.unit}{'' if truth is None else f', simulated {truth:g}'}"
    )
for refusal in found.refused:
    print(f"{name} refused {', '.join(refusal.quantities)}: {refusal.reason}")
