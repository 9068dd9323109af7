"""Logs of an arm's torques and motion, as `dashpot identify` reads them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.linalg import expm

from dashpot.arm.drive import Drive
from dashpot.control.controller import Sampling
from dashpot.errors import InputError
from dashpot.simulation.recording import Recording
from dashpot.simulation.trajectory import Trajectory
from dashpot.support.arrays import Floats

OPTIONAL = ("position", "velocity", "link_position")
"""Quantities a log may lack; position or velocity must be there."""


@dataclass(frozen=True)
class Segment:
    """A stretch of a log without gaps, sampled uniformly. SI units, link side of the gear.

    A column is NaN throughout where the log lacks the quantity for that joint but has it for others.

    Attributes:
        time: (t,) time stamps [s].
        command: (t, n) torque command [N m], held from its time stamp on.
        torque: (t, n) sensed torque tau_s [N m], positive as in ``u = m q'' + v q' + f + tau_s``.
        position: (t, n) rotor angle over gear ratio [rad], or None.
        velocity: (t, n) its rate [rad/s], or None.
        link_position: (t, n) angle of the link [rad], or None.
    """

    time: Floats
    command: Floats
    torque: Floats
    position: Floats | None = None
    velocity: Floats | None = None
    link_position: Floats | None = None


@dataclass(frozen=True)
class Log:
    """What was measured on an arm.

    Attributes:
        joints: Names of the n joints, in the order of the columns.
        period: Of all segments [s].
        segments: Stretches without gaps, in order of time.
        sampling: ``"average"``: each torque sample is the mean over the last period; or ``"point"``.
        file: Where the log was read from, or None.
        digest: SHA-256 of the file as hex digits; ``""`` for a log made in memory.
    """

    joints: tuple[str, ...]
    period: float
    segments: tuple[Segment, ...]
    sampling: Sampling
    file: Path | None = None
    digest: str = ""

    @property
    def duration(self) -> float:
        """Of all segments together [s]."""
        return self.period * sum(len(segment.time) for segment in self.segments)

    def only(self, joint: str) -> Log:
        """The log of one joint; quantities that were not logged for it are None.

        Raises:
            InputError: The log has no such joint.
        """
        if joint not in self.joints:
            raise InputError(
                f"no such joint in the log; it has {', '.join(self.joints)}", file=self.file, joint=joint
            )
        j = self.joints.index(joint)

        def column(array: Floats | None) -> Floats | None:
            if array is None or np.isnan(array[:, j]).all():
                return None
            return array[:, j : j + 1]

        segments = tuple(
            replace(
                segment,
                command=segment.command[:, j : j + 1],
                torque=segment.torque[:, j : j + 1],
                position=column(segment.position),
                velocity=column(segment.velocity),
                link_position=column(segment.link_position),
            )
            for segment in self.segments
        )
        return replace(self, joints=(joint,), segments=segments)


def from_recording(
    recording: Recording,
    sampling: Sampling,
    *,
    drives: Sequence[Drive] = (),
    trajectory: Trajectory | None = None,
    controlled: Sequence[str] = (),
) -> Log:
    """The log a robot would have kept of a simulated run.

    Position and velocity are the encoder's, the sensed torque is the sample with all of the sensor's errors.
    A servo's torque changes within a control period; its command is the mean of what it asks for over the
    period that begins at the stamp, which is what a command held over that period amounts to. The last tick
    is left out: no period follows. Time counts from the first tick.

    Args:
        recording: The run; what follows a divergence is left out.
        sampling: How the torque was sampled.
        drives: The robot's; needed, with the other two, where joints run under their `Servo`.
        trajectory: What the run followed.
        controlled: Joints that were not under their servo.

    Raises:
        InputError: Less than two ticks were recorded.
    """
    finite = np.asarray(np.isfinite(recording.sample).all(1))
    ticks = (len(finite) if finite.all() else int(np.argmin(finite))) - 1
    if ticks < 1:
        raise InputError("has less than two ticks; there is nothing to log", quantity="recording")
    command = recording.command[:ticks].copy()
    if trajectory is not None:
        for drive in drives:
            if drive.servo is not None and drive.name not in controlled:
                j = recording.joints.index(drive.name)
                command[:, j] = _servo_command(recording, trajectory, drive, j, ticks)
    period = float(recording.time[1] - recording.time[0]) if trajectory is None else trajectory.period
    segment = Segment(
        recording.time[:ticks] - recording.time[0],
        command,
        recording.sample[:ticks],
        recording.position[:ticks],
        recording.velocity[:ticks],
        recording.link_position[:ticks],
    )
    return Log(recording.joints, period, (segment,), sampling)


def _servo_command(recording: Recording, trajectory: Trajectory, drive: Drive, j: int, ticks: int) -> Floats:
    """Mean over each control period of a servo's torque, (ticks,) [N m].

    Between ticks the servo extrapolates its reference r with constant speed, the link moves along the cubic l
    that joins its recorded states, and ``m q'' = kp (r - q) + kd (r' - q') - v q' - k (q - l) - c (q' - l')
    - f`` is stepped as the simulator did. Friction f (with it backlash, hysteresis, and the servo's integral
    part) changes linearly, from and to what brings the rotor from one recorded state to the next.
    """
    assert drive.servo is not None
    h, servo, m, v = trajectory.period, drive.servo, drive.rotor_inertia, drive.viscous_friction
    k, c, kp, kd = drive.stiffness, drive.damping, servo.kp, servo.kd
    link, speed = recording.link_position[: ticks + 1, j], recording.link_velocity[: ticks + 1, j]
    q, w = recording.position[: ticks + 1, j], recording.velocity[: ticks + 1, j]
    if drive.position_resolution > 0:  # the servo does not see the encoder's steps
        q, w = link + recording.torque[: ticks + 1, j] / k, speed
    moved, twice = np.diff(link), speed[:-1] + speed[1:]
    bend = 6 * moved / h**2 - 2 * (speed[:-1] + twice) / h
    turn = 6 * twice / h**2 - 12 * moved / h**3
    dt = float(str(recording.settings.get("timestep", h / 100)))
    A = np.zeros((10, 10))  # q and its rate, r and its rate, l and its three derivatives, f and its rate
    A[[0, 2, 4, 5, 6, 8], [1, 3, 5, 6, 7, 9]] = 1.0
    pull = np.array([-kp, -kd, kp, kd, 0, 0, 0, 0, 0, 0])
    A[1] = (pull + np.array([-k, -v - c, 0, 0, k, c, 0, 0, -1, 0])) / m
    step = expm(A * dt)
    step[1] = dt * A[1] / (1 + dt * (v + c) / m)  # the engine's integrator: implicit in damping only
    step[1, 1] += 1.0
    step[0] = dt * step[1]
    step[0, 0] += 1.0
    Phi, total = np.eye(10), np.zeros((10, 10))
    steps = round(h / dt)
    for _ in range(steps):
        total += Phi
        Phi = step @ Phi
    r, rate = trajectory.position[:ticks, j], trajectory.velocity[:ticks, j]
    start = np.stack([q[:-1], w[:-1], r, rate, link[:-1], speed[:-1], bend, turn])
    friction = np.linalg.solve(Phi[:2, 8:], np.stack([q[1:], w[1:]]) - Phi[:2, :8] @ start)
    mean = total @ np.concatenate([start, friction]) / steps
    error = mean[2] - mean[0]
    torque = pull @ mean + servo.ki * h * (np.cumsum(error) - error / 2)
    return np.asarray(np.clip(torque, -drive.torque_limit, drive.torque_limit))
