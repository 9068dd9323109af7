"""The robot's rules, as it enforces them cycle by cycle while a client commands torques."""

from __future__ import annotations

from collections import deque

import numpy as np

from dashpot.hardware.franka_server.limits import Limits
from dashpot.hardware.franka_server.messages import Reflex
from dashpot.support.arrays import Floats

ROUNDING = 1e-6  # [N m] by which a torque step may exceed the rule: the state is in single precision
SPEED_MARGIN = 0.1  # [rad/s] above the limit at which the robot stops; assumed
WINDOW = 100  # cycles over which the share of commands received is reported


class Rules:
    """What a motion may do. One object per motion.

    Attributes:
        torque: Command in effect, without gravity, (7,) [N m]: zero, then the last one accepted.
        lost: Cycles in a row without an answer.
    """

    def __init__(self, limits: Limits, enforced: bool = True) -> None:
        """Starts a motion.

        Args:
            limits: Of the robot.
            enforced: Lost cycles end the motion. Without, they are counted only.
        """
        self.limits, self.enforced = limits, enforced
        self.torque = np.zeros(len(limits.torque))
        self.lost = 0
        self._received: deque[bool] = deque(maxlen=WINDOW)

    @property
    def success_rate(self) -> float:
        """Share of the last 100 cycles that were answered in time [-]."""
        return sum(self._received) / len(self._received) if self._received else 0.0

    def command(self, torque: Floats) -> Reflex | None:
        """Accepts a command (7,) [N m], or says why the robot stops instead.

        The first one, like all others, may differ by 1 N m from the last, which was zero.
        """
        if not (np.abs(torque) <= self.limits.torque + ROUNDING).all():
            return Reflex.TAU_J_RANGE_VIOLATION
        if (np.abs(torque - self.torque) > self.limits.torque_step + ROUNDING).any():
            return Reflex.CONTROLLER_TORQUE_DISCONTINUITY
        self.torque[:] = torque
        return None

    def cycle(self, answered: bool) -> Reflex | None:
        """Ends a cycle. Without an answer the last torque stays; after 20 such in a row the robot stops."""
        self._received.append(answered)
        self.lost = 0 if answered else self.lost + 1
        if self.enforced and self.lost >= self.limits.lost:
            return Reflex.COMMUNICATION_CONSTRAINTS_VIOLATION
        return None

    def motion(self, position: Floats, velocity: Floats) -> Reflex | None:
        """Looks at the measured motion: joint angles (7,) [rad] and velocities (7,) [rad/s]."""
        if ((position < self.limits.lower) | (position > self.limits.upper)).any():
            return Reflex.JOINT_POSITION_LIMITS_VIOLATION
        slowest, fastest = self.limits.speeds(position)
        if ((velocity < slowest - SPEED_MARGIN) | (velocity > fastest + SPEED_MARGIN)).any():
            return Reflex.JOINT_VELOCITY_VIOLATION
        return None
