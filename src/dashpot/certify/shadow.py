"""What a change of rotor and position loop does to the transmitted torque, the rotor's motion being the same.

A second copy of the joint's signal path, driven by the change: its torque is the difference. The dissipation
of that difference is the error of the tangent in `dashpot.certify.box`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dashpot.arm.drive import Drive
from dashpot.certify.exact import Loss
from dashpot.certify.joint import DEFLECTION, SPEED, SampledJoint


def with_shadow(
    joint: SampledJoint,
    drive: Drive,
    inertia: float,
    friction: float,
    position: float,
    link_friction: float = 0.0,
) -> tuple[SampledJoint, Loss | None]:
    """Adds what a change of rotor and position loop does to the transmitted torque for the same rotor motion.

    Args:
        joint: The joint, its torque sampled as an average or behind a filter.
        drive: Its drive.
        inertia: Change of the rotor inertia [kg m^2].
        friction: Change of the viscous friction [N m s/rad].
        position: Change of the position loop's scale, relative.
        link_friction: Counted in the form [N m s/rad].

    Returns:
        The joint with the shadow's states, and what transmission and link friction dissipate of the
        difference.
    """
    if inertia == friction == position == 0:
        return joint, None
    k, c = drive.stiffness, drive.damping
    n, size = len(joint.flow), len(joint.jump)
    motion = [SPEED] if joint.position is None else [SPEED, joint.position]
    own = [i for i in range(n) if i not in (DEFLECTION, *motion)]  # filter, average, torque in effect
    rest = list(range(n, size))
    # New order: joint's moving states, shadow's deflection and own, joint's tick states, shadow's.
    shadow = [n, *range(n + 1, n + 1 + len(own))]
    moving = n + len(shadow)
    kept = list(range(moving, moving + len(rest)))
    shadow_rest = list(range(moving + len(rest), moving + 2 * len(rest)))
    total = moving + 2 * len(rest)
    place = np.empty(size, int)  # where the joint's states go
    place[:n], place[rest] = np.arange(n), kept
    twin = np.full(size, -1)  # where the shadow of a state goes; motion is shared
    twin[DEFLECTION], twin[own], twin[rest] = shadow[0], shadow[1:], shadow_rest

    flow, velocity = np.zeros((moving, moving)), np.zeros(moving)
    flow[:n, :n], velocity[:n] = joint.flow, joint.velocity_in
    torque, torque_w = np.zeros(moving), -inertia * joint.velocity_in[SPEED]  # difference of the torque
    torque[:n] = -inertia * joint.flow[SPEED]
    torque[SPEED] -= friction
    torque[shadow[-1]] += 1.0
    rate, rate_w = torque / c, torque_w / c  # of the shadow's deflection
    rate[shadow[0]] -= k / c
    flow[shadow[0]], velocity[shadow[0]] = rate, rate_w
    for i in own:
        heard = joint.flow[i, DEFLECTION] / k  # how it hears the torque
        flow[twin[i], twin[own]] = joint.flow[i, own]
        flow[twin[i]] += heard * torque
        velocity[twin[i]] = heard * torque_w

    jump = np.zeros((total, total))
    jump[np.ix_(place, place)] = joint.jump
    jump[shadow[0], shadow[0]] = 1.0
    for i in [*own, *rest]:
        for j in range(size):
            if j in motion:
                jump[twin[i], place[j]] += position * joint.jump[i, j]
            elif j != DEFLECTION:
                jump[twin[i], twin[j]] += joint.jump[i, j]
    units = np.empty(total)
    units[place] = joint.units
    units[twin[twin >= 0]] = joint.units[twin >= 0]
    wide = np.zeros(moving)
    wide[:n] = joint.torque
    damping = np.sqrt(c + link_friction)
    loss = Loss(damping * rate, damping * rate_w)
    return (
        replace(joint, flow=flow, velocity_in=velocity, torque=wide, jump=jump, units=units),
        loss,
    )
