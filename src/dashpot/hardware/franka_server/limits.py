"""What a Franka Research 3 allows: its published limits.

Sources: frankarobotics/franka_description (robots/fr3/joint_limits.yaml) and Franka's documentation of the
control interface ("Limits for Franka Research 3", "Constants").
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dashpot.support.arrays import Floats


@dataclass(frozen=True)
class Limits:
    """Limits of an arm, each (7,), base to tip.

    Attributes:
        torque: Largest commanded torque, gravity not counted [N m].
        lower: Smallest joint angle [rad].
        upper: Largest joint angle [rad].
        speed: Largest joint speed anywhere [rad/s].
        offset: Of the position-dependent limit [rad/s].
        deceleration: Of the position-dependent limit [rad/s^2].
        torque_step: Largest change of the commanded torque from one cycle to the next [N m].
        lost: Cycles in a row without a command after which the robot stops.
    """

    torque: Floats
    lower: Floats
    upper: Floats
    speed: Floats
    offset: Floats
    deceleration: Floats
    torque_step: float = 1.0
    lost: int = 20

    def speeds(self, position: Floats) -> tuple[Floats, Floats]:
        """Slowest and fastest allowed velocity at joint angles (7,) [rad]: each (7,) [rad/s].

        ``min(speed, max(0, sqrt(2 deceleration (upper - q)) - offset))``: the arm must be able to stop before
        its limits; likewise downwards.
        """
        up = np.sqrt(2 * self.deceleration * np.maximum(self.upper - position, 0)) - self.offset
        down = np.sqrt(2 * self.deceleration * np.maximum(position - self.lower, 0)) - self.offset
        return -np.clip(down, 0, self.speed), np.clip(up, 0, self.speed)


FR3 = Limits(
    torque=np.array([87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0]),
    lower=np.array([-2.9007, -1.8361, -2.9007, -3.0770, -2.8763, 0.4398, -3.0508]),
    upper=np.array([2.9007, 1.8361, 2.9007, -0.1169, 2.8763, 4.6216, 3.0508]),
    speed=np.array([2.62, 2.62, 2.62, 2.62, 5.26, 4.18, 5.26]),
    offset=np.array([0.652, 0.25, 0.2005, 0.3542, 0.5738, 0.4885, 0.4592]),
    deceleration=np.array([6.0, 2.585, 3.5, 4.0, 17.0, 5.5, 17.0]),
)
"""Franka Research 3."""
