"""A robot of your own: this class is all it takes. Here it is a MuJoCo arm with elastic joints.

cd examples && dashpot run own_arm.toml own_gains.toml --via own_hardware:OwnArm --duration 3
"""

import mujoco
import numpy as np

STEPS, CLOSED = 10, 500.0  # physics steps per cycle; friction of a closed brake [N m]


class OwnArm:
    """Two joints: motor, transmission with the torque sensor, link. `dashpot.hardware.interface` explains."""

    def __init__(self, host, robot):
        self.joints, self.period, self.reason = robot.joints, 0.001, ""
        self.paced = False  # the loop's clock paces; `read` takes the newest sample
        spec = mujoco.MjSpec.from_file(str(robot.model))
        spec.option.timestep = self.period / STEPS
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        for drive in robot.drives:
            motor = spec.joint(drive.name)
            motor.armature, motor.damping[0] = drive.rotor_inertia, drive.viscous_friction
            spring = motor.parent.add_joint(name=f"{drive.name}/spring", axis=motor.axis)
            spring.stiffness[0], spring.damping[0] = drive.stiffness, drive.damping
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self.motor = [self.model.joint(drive.name).id for drive in robot.drives]
        self.spring = [self.model.joint(f"{drive.name}/spring").id for drive in robot.drives]
        self.k, self.c, self.friction = np.array(
            [(drive.stiffness, drive.damping, drive.coulomb_friction) for drive in robot.drives]
        ).T
        self.torque = np.zeros(len(self.joints))
        self.apply_brake()

    def start(self):
        self.model.dof_frictionloss[self.motor] = self.friction  # the brakes open

    def read(self, sample):
        sample.torque = 0.0
        for _ in range(STEPS):  # a cycle of the robot goes by; the torque sensor averages over it
            self.data.qfrc_applied[self.motor] = self.torque
            mujoco.mj_step(self.model, self.data)
            twist, rate = self.data.qpos[self.spring], self.data.qvel[self.spring]
            sample.torque -= (self.k * twist + self.c * rate) / STEPS
        sample.time, sample.in_effect = self.data.time, self.torque
        sample.position, sample.velocity = self.data.qpos[self.motor], self.data.qvel[self.motor]
        return True  # False, with a `reason`, once your robot has ended the motion

    def write(self, torque):
        self.torque[:] = torque

    def apply_brake(self):
        self.model.dof_frictionloss[self.motor] = CLOSED

    def stop(self):
        self.torque[:] = 0.0
