"""Motions that tell a drive's inertia, friction and torque sensor apart, inside a joint's limits.

Method and what is promised: docs/identify.md.
"""

from dashpot.excite.dynamics import link_torque, motor_torque
from dashpot.excite.limits import Limits
from dashpot.excite.promise import Promise, predicted_log
from dashpot.excite.search import Excitation, JointMotion, excite

__all__ = [
    "Excitation",
    "JointMotion",
    "Limits",
    "Promise",
    "excite",
    "link_torque",
    "motor_torque",
    "predicted_log",
]
