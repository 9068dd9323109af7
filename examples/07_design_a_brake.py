"""From wishes to gains: a brake for one joint, what it will do, and why a faster one does not exist."""

from dataclasses import replace

from dashpot import Robot, certify_joint
from dashpot.design.conflicts import conflict
from dashpot.design.design import design_joint, duties
from dashpot.design.spec import Spec

robot = Robot.load("fr3")
spec = Spec.load("brake").changed(payload=2.0, offset=(0.0, 0.0, 0.1), joints=("joint6",))
duty = duties(robot, spec)[0]
print(f"joint6 carries up to {duty.loaded:.2g} kg m^2 and {duty.load:.2g} N m over its range")

design = design_joint(duty, spec.of("joint6"), loop=False)
assert design.found is not None
gains = design.found.gains.joint("joint6")
print(f"R = {gains.R:g}, D = {gains.D:g} N m s/rad, K = {gains.K:g} N m/rad")
print(f"limited by: {', '.join(design.found.binding)}")
stop_time, hold = design.predicted["stop_time"], design.predicted["hold"]
print(f"stops within {1e3 * stop_time:.0f} ms, then holds {hold:.2g} N m")

verdict = certify_joint(duty.drive, gains, duty.config((gains,)))
print(f"certified: {verdict.certified}, margin {verdict.margin:.2g}")

# Ask for too much.
wishes = replace(spec.of("joint6"), stop_time=0.005)
why = conflict(duty, wishes, loop=False)
for shortfall in why.shortfalls:
    print(f"{shortfall.name}: {shortfall.wanted:g} wanted, {shortfall.possible:.3g} possible")
print(f"what would help: {why.change}")
