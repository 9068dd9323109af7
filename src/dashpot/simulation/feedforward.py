"""The torque reference of a load model: gravity of the arm and of an assumed payload along a motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dashpot.arm.payload import Payload
from dashpot.arm.plant import Plant, build
from dashpot.arm.robot import Robot
from dashpot.control.controller import ControllerConfig
from dashpot.control.rivals.tracking import PDGravity
from dashpot.simulation.trajectory import Trajectory
from dashpot.support.arrays import Floats


def gravity_reference(model: Plant | Robot, payload: Payload | None, trajectory: Trajectory) -> Floats:
    """Torque that holds the arm at rest at every reference position, (ticks, n) [N m].

    Args:
        model: The arm as the controller knows it: a robot, on which the payload is hung, or a plant built
            with what is assumed to hang on it.
        payload: Assumed on the flange; None: nothing more than the model has.
        trajectory: References.
    """
    if isinstance(model, Robot):
        model = build(model, trajectory.period, [] if payload is None or payload.mass == 0 else [payload])
    elif payload is not None and payload.mass > 0:
        model = build(model.robot, trajectory.period, [payload])
    poses, same = np.unique(trajectory.position, axis=0, return_inverse=True)
    torque = np.stack([model.load_torque(pose) for pose in poses])
    return np.asarray(torque[same.ravel()])


def with_feedforward(
    robot: Robot, config: ControllerConfig | None, trajectory: Trajectory, *, carried: bool = False
) -> Trajectory:
    """The trajectory with the torque references that laws "pd_gravity" of a controller ask for.

    Each such joint gets its own, of its own assumed payload; a torque that is there already is added to.
    Where the robot's own gravity compensation is on (`carried`), the bare arm's weight is left out.
    """
    laws = [law for law in config.joints if isinstance(law, PDGravity)] if config is not None else []
    if not laws:
        return trajectory
    own = gravity_reference(robot, None, trajectory) if carried else 0.0
    total = np.zeros_like(trajectory.position) if trajectory.torque is None else trajectory.torque.copy()
    for payload, offset in {(law.payload, law.offset) for law in laws}:
        torque = gravity_reference(robot, Payload(payload, offset), trajectory) - own
        for law in laws:
            if (law.payload, law.offset) == (payload, offset):
                total[:, robot.index(law.name)] += torque[:, robot.index(law.name)]
    return replace(trajectory, torque=total)
