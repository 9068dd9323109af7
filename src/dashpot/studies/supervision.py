"""The supervisor over recorded motions."""

from __future__ import annotations

import numpy as np

from dashpot.controller import Controller, ControllerConfig
from dashpot.recording import Recording
from dashpot.robot import Robot
from dashpot.supervisor import Supervisor, SupervisorSettings
from dashpot.trajectory import Trajectory


def replay(
    recording: Recording,
    config: ControllerConfig | None,
    robot: Robot,
    reference: Trajectory,
    settings: SupervisorSettings | None = None,
    controller: Controller | None = None,
) -> tuple[Supervisor, float]:
    """Shows a recorded run to a supervisor up to its first decision, before which it changes nothing.

    Args:
        recording: Of the controller alone, without events.
        config: The controller's file; None where `controller` is given.
        robot: The arm.
        reference: The run's.
        settings: Of the supervisor.
        controller: In place of config.

    Returns:
        The supervisor as it then is, and the largest part of its limit that the rotor balance reached [-].
    """
    if controller is None:
        assert config is not None
        controller = Controller.from_config(config, robot.drives)
    supervisor = Supervisor(controller, robot.drives, settings)
    index = [robot.index(name) for name in controller.joints]
    inputs, out, worst = controller.inputs, np.zeros(len(index)), 0.0
    for k in range(len(recording.time)):
        inputs.torque[:] = recording.sample[k, index]
        inputs.position[:] = recording.position[k, index]
        inputs.velocity[:] = recording.velocity[k, index]
        inputs.position_ref[:] = reference.position[k, index]
        inputs.velocity_ref[:] = reference.velocity[k, index]
        inputs.acceleration_ref[:] = reference.acceleration[k, index]
        if k:  # the torque that was in effect
            for i, j in enumerate(index):
                x = np.array(controller.core.joint_state(i)[5])
                controller.core.preset(i, x, recording.in_effect[k - 1, j])
        supervisor.step(out)
        if supervisor.state != "track":
            break
        for name in controller.joints:
            seen = supervisor.joint(name)
            worst = max(worst, abs(seen["residual"]) / seen["limit"])
    return supervisor, worst
