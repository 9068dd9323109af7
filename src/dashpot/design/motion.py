"""Many sampled joints at once, each carrying a rigid link: how one drive answers under many controllers.

Exact between sub-steps for the elastic, filtered, sampled joint. The loop is native/dashpot_stops.c around
the controller that also runs on the robot. Friction slips or sticks as in native/dashpot_runner.c; which,
is asked once per sub-step. Limits act as they do there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from dashpot import _native
from dashpot.arm.drive import PRESLIDING, Drive
from dashpot.certify.joint import SPEED, sampled_joint
from dashpot.certify.threads import one_thread
from dashpot.support.arrays import Floats

SUBSTEP = 2e-4  # [s] between two questions whether friction slips; at 1e-3 a swing is off by up to 5 %
WINDOW = 0.05  # [s] over which a motion is looked at for an end
STILL = 2e-4  # change of speed within it, over the first speed, that counts as none


@dataclass(frozen=True)
class Motion:
    """What happened, at the ticks.

    Attributes:
        time: (ticks,) [s].
        speed: Of the link, (ticks, k) [rad/s].
        command: Torque issued, (ticks, k) [N m].
    """

    time: Floats
    speed: Floats
    command: Floats


@one_thread
def move(
    drive: Drive,
    blocks: NDArray[np.void],
    sampling: str,
    period: float,
    inertia: float,
    *,
    speed: float,
    duration: float,
    load: float = 0.0,
    torque_gain: float = 1.0,
) -> Motion:
    """Lets joints with a rigid link run on from a speed under their brake, warm started from that speed.

    Until then the motor has moved them evenly, against friction and load.

    Args:
        drive: Their drive.
        blocks: (k,) brakes, records of `dashpot.control.sampled.BLOCK_DTYPE` of one latency, reading torque.
        sampling: "average" or "point".
        period: [s].
        inertia: Of the link [kg m^2].
        speed: Of rotor and link at first [rad/s].
        duration: [s].
        load: Constant torque on the link [N m].
        torque_gain: Sensor times actuator scale over the assumed one [-].
    """
    joint = sampled_joint(drive, blocks[0], sampling, period)
    n = len(joint.flow)
    held, mean = n - 1, n - 2
    # Link speed, load, and friction join the joint's own states: a spring z and a damper while it sticks, a
    # constant torque while it slips. The spring keeps moving until it is stretched to the friction torque.
    link, push, spring, slips = n, n + 1, n + 2, n + 3
    stiffness = PRESLIDING * drive.stiffness
    damper = math.sqrt(stiffness * drive.rotor_inertia)
    both = np.zeros((n + 4, n + 4))
    both[:n, :n], both[:n, link] = joint.flow, joint.velocity_in
    both[link, :n], both[link, link] = joint.torque / inertia, joint.torque_w / inertia
    both[link, push], both[spring, SPEED] = 1 / inertia, stiffness
    slip, stick = both.copy(), both
    slip[SPEED, slips] = -1 / drive.rotor_inertia
    stick[SPEED, spring] = -1 / drive.rotor_inertia
    stick[SPEED, SPEED] -= damper / drive.rotor_inertia
    substeps = max(1, math.ceil(period / SUBSTEP))
    slipping, sticking = (np.ascontiguousarray(expm(flow * (period / substeps))) for flow in (slip, stick))
    average, filtered = sampling == "average", drive.sensor_bandwidth is not None
    sample, start = np.zeros(n + 4), np.zeros(n + 4)
    if average:
        sample[mean] = 1.0
    elif filtered:
        sample[2] = 1.0
    else:
        sample[:n], sample[link] = joint.torque, joint.torque_w
    # In even motion the transmission carries the load, the motor friction as well.
    coulomb = drive.coulomb_friction
    drag = math.copysign(coulomb, speed) + drive.viscous_friction * speed
    start[[SPEED, link]] = speed
    start[push], start[spring] = load, math.copysign(coulomb, speed)
    start[0], start[held] = (
        -load / drive.stiffness,
        np.clip(drag - load, -drive.torque_limit, drive.torque_limit),
    )
    if average:
        start[mean] = -load
    if filtered:
        start[2] = -load
    ticks = math.ceil(duration / period) + 1
    speeds, commands = np.empty((len(blocks), ticks)), np.empty((len(blocks), ticks))
    if len(blocks):
        _native.stops(
            np.ascontiguousarray(blocks).view(np.uint8),
            slipping,
            sticking,
            start,
            sample,
            rotor=SPEED,
            held=held,
            link=link,
            spring=spring,
            slips=slips,
            mean=mean if average else -1,
            substeps=substeps,
            late=round(drive.torque_latency / period),
            coulomb=coulomb,
            damper=damper,
            torque_gain=torque_gain,
            speed=speed,
            window=max(2, round(WINDOW / period)),
            still=STILL * abs(speed),
            speeds=speeds,
            commands=commands,
        )
    return Motion(period * np.arange(ticks, dtype=float), speeds.T, commands.T)
