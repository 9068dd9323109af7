"""Logs of robots that carry their own weight, as a Franka does.

Such a robot adds g(q) to every command, held for a period, and takes it off the sensed torque
(docs/model.md). What is left of the rotor's equation has no g in it, but for its lag: the samples are
``F[tau](t) - g(q(t))``, F the sensor's delay and low-pass, where ``F[tau - g](t)`` with the g in effect is
wanted. Left so, viscous friction comes out wrong by dg/dq times the lag: too large where the arm hangs, too
small where it stands.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dashpot.arm.drive import Drive
from dashpot.arm.plant import build
from dashpot.arm.robot import Robot
from dashpot.identify.estimate import DriveEstimate, Refusal
from dashpot.identify.spring import TRANSMISSION
from dashpot.logs.log import Log
from dashpot.simulation.compensation import Gravity

WHY = "the robot takes its own weight out of the sensed torque, but the transmission bends under it"
INSTEAD = "a log of the whole torque, weight included; the rest does not need it"


def late(drive: Drive, log: Log) -> float:
    """By how much a sample of the g in effect would lag behind the angles, which change slowly [s]."""
    held = 0.5 * log.period
    delay = held + drive.torque_latency + (0.5 * log.period if log.sampling == "average" else 0.0)
    if drive.sensor_bandwidth is not None:
        order = 1.0 if drive.sensor_order == 1 else 2 * drive.sensor_damping
        delay += order / (2 * np.pi * drive.sensor_bandwidth)
    return delay


def weight_aligned(log: Log, robot: Robot) -> Log | None:
    """The log as if the weight taken off had been that in effect, seen by the sensor: ``F[tau - g]``.

    g is that of the robot's model; as only its change over the delay counts, it need not be exact.

    Returns:
        The log without link angles, for `TRANSMISSION` needs the whole torque. None: g is not known, the
        robot has no model, or the log lacks an angle.

    Raises:
        ModelError: The model cannot be used.
        InputError: Likewise.
    """
    columns = [log.joints.index(name) if name in log.joints else -1 for name in robot.joints]
    if robot.model is None or -1 in columns:
        return None
    if any(s.position is None or np.isnan(s.position[:, columns]).any() for s in log.segments):
        return None
    gravity, segments = Gravity(build(robot, log.period)), []
    for segment in log.segments:
        assert segment.position is not None
        g = np.array([gravity.torque(q) for q in segment.position[:, columns]])
        torque = segment.torque.copy()
        for j, drive in zip(columns, robot.drives, strict=True):
            own = g[:, robot.index(drive.name)]
            torque[:, j] += own - np.interp(segment.time - late(drive, log), segment.time, own)
        segments.append(replace(segment, torque=torque, link_position=None))
    return replace(log, segments=tuple(segments))


def without_transmission(estimate: DriveEstimate) -> DriveEstimate:
    """The estimate with what a log without the weight cannot tell among the refused."""
    return replace(estimate, refused=(*estimate.refused, Refusal(TRANSMISSION, WHY, INSTEAD)))
