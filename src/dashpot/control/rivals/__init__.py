"""Other joint controllers, the same kind of object as the virtual passive law (docs/rivals.md).

`blocks` has their equations, `brakes` and `tracking` the laws of controller files, `gravity` the torque
reference of a load model.
"""

from dashpot.control.rivals.blocks import (
    disturbance_observer_block,
    encoder_damping_block,
    inertia_shaping_block,
    latched_torque_block,
    pid_block,
    rotor_observer_block,
    scaled_pd_block,
    static_feedback_block,
    torque_feedback_block,
)

__all__ = [
    "disturbance_observer_block",
    "encoder_damping_block",
    "inertia_shaping_block",
    "latched_torque_block",
    "pid_block",
    "rotor_observer_block",
    "scaled_pd_block",
    "static_feedback_block",
    "torque_feedback_block",
]
