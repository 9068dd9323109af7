"""Certify a joint controller of your own: a PD and a torque feedback, written as one linear block."""

from dashpot.arm.drive import Drive
from dashpot.certify.box import certify_box
from dashpot.certify.counterexample import counterexample
from dashpot.certify.index import passivity_index
from dashpot.certify.joint import sampled_joint
from dashpot.control.sampled import POSITION, TORQUE, VELOCITY, empty_block

period = 0.001  # s
drive = Drive(
    "elbow",
    rotor_inertia=0.2,
    viscous_friction=0.5,
    stiffness=1.2e4,
    damping=3.0,
    torque_limit=87.0,
    sensor_bandwidth=150.0,
    uncertainty={"rotor_inertia": 0.15, "viscous_friction": 0.3, "stiffness": 0.2, "damping": 0.5},
)


def block(torque_feedback: float, kp: float, kd: float):
    """u = torque_feedback tau_s - kp q - kd q'; a block may also have up to four states."""
    made = empty_block()
    made["D"][[TORQUE, POSITION, VELOCITY]] = torque_feedback, -kp, -kd
    return made


for gains in ((0.0, 600.0, 30.0), (-2.0, 600.0, 30.0), (0.5, 600.0, 30.0)):
    own = block(*gains)
    index = passivity_index(drive, own, "point", period)
    box = certify_box(drive, own, "point", period)
    print(f"feedback {gains[0]:4g}: index {index.value:7.3g} N m s/rad, ", end="")
    if box.proven:
        print(f"certified over the whole uncertainty, worst {box.worst.value:.3g}")
    else:
        load = counterexample(sampled_joint(drive, own, "point", period), drive)
        print(f"not certified; nominal drive: {load or 'none of the loads tried oscillates'}")
