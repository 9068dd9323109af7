"""Many sampled joints at once, each carrying a rigid link: how one drive answers under many controllers.

Exact between sub-steps for the elastic, filtered, sampled joint. Coulomb friction slips or
sticks as in native/dashpot_runner.c; which, is asked once per sub-step. Limits act as in dashpot_core.c.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from dashpot.certify.joint import SPEED, sampled_joint
from dashpot.certify.threads import one_thread
from dashpot.drive import PRESLIDING, Drive
from dashpot.sampled import IN_EFFECT, TORQUE, Floats

SUBSTEP = 1e-3  # [s]
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
        blocks: (k,) brakes, records of `dashpot.sampled.BLOCK_DTYPE` of one latency, reading torque.
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
    slipping, sticking = (expm(flow * (period / substeps)).T for flow in (slip, stick))
    coulomb = drive.coulomb_friction
    average = sampling == "average"
    filtered = drive.sensor_bandwidth is not None
    sample_row = np.zeros(n + 4)
    if average:
        sample_row[mean] = 1.0
    elif filtered:
        sample_row[2] = 1.0
    else:
        sample_row[:n], sample_row[link] = joint.torque, joint.torque_w
    ticks, k = math.ceil(duration / period) + 1, len(blocks)
    latency, late = int(blocks["latency"][0]), round(drive.torque_latency / period)
    X = np.zeros((k, n + 4))
    X[:, [SPEED, link]] = speed
    X[:, push], X[:, spring] = load, math.copysign(coulomb, speed)
    x = blocks["warm"] * speed
    law = _Law.of(blocks)
    # In even motion the transmission carries the load, the motor friction as well.
    drag = math.copysign(coulomb, speed) + drive.viscous_friction * speed
    before = np.full(k, np.clip(drag - load, -drive.torque_limit, drive.torque_limit))
    X[:, 0], X[:, held] = -load / drive.stiffness, before
    if average:
        X[:, mean] = -load
    if filtered:
        X[:, 2] = -load
    sensed, pipeline, issued = [np.full(k, -load * torque_gain)] * late, [before] * latency, before
    motion = Motion(period * np.arange(ticks, dtype=float), np.empty((ticks, k)), np.empty((ticks, k)))
    running, check = np.arange(k), max(2, round(WINDOW / period))
    for tick in range(ticks):
        sensed.append(torque_gain * (X @ sample_row))
        issued, x = law.step(x, sensed.pop(0), X[:, held].copy(), issued)
        pipeline.append(issued)
        X[:, held] = pipeline.pop(0)
        motion.speed[tick, running], motion.command[tick, running] = X[:, link], issued
        if average:
            X[:, mean] = 0.0
        for _ in range(substeps):
            if not coulomb:
                X = X @ slipping
                continue
            torque = X[:, spring] + damper * X[:, SPEED]
            X[:, slips] = np.copysign(coulomb, torque)
            X = np.where((np.abs(torque) < coulomb)[:, None], X @ sticking, X @ slipping)
            X[:, spring] = np.minimum(np.maximum(X[:, spring], -coulomb), coulomb)
        if tick % check == check - 1:
            # What has not moved for a while, or creeps on evenly, will go on like that.
            recent = motion.speed[tick + 1 - check : tick + 1, running]
            still = np.ptp(recent, axis=0) < STILL * abs(speed)
            if still.any():
                motion.speed[tick + 1 :, running[still]] = recent.mean(0)[still]
                motion.command[tick + 1 :, running[still]] = motion.command[tick, running[still]]
                go = ~still
                running, X, x, issued, law = running[go], X[go], x[go], issued[go], law[go]
                sensed, pipeline = [s[go] for s in sensed], [u[go] for u in pipeline]
                if not len(running):
                    break
    return motion


@dataclass(frozen=True)
class _Law:
    """Coefficients of k blocks as the loop needs them."""

    A: Floats
    b: Floats
    own: Floats
    C: Floats
    d: Floats
    d_own: Floats
    E: Floats
    limit: Floats
    rate: Floats

    @classmethod
    def of(cls, blocks: NDArray[np.void]) -> _Law:
        nx = max(1, int(blocks["nx"].max()))
        B, D = blocks["B"][:, :nx], blocks["D"]
        return cls(
            blocks["A"][:, :nx, :nx],
            B[:, :, TORQUE],
            B[:, :, IN_EFFECT],
            blocks["C"][:, :nx],
            D[:, TORQUE],
            D[:, IN_EFFECT],
            blocks["E"][:, :nx],
            blocks["torque_limit"],
            blocks["rate_limit"],
        )

    def __getitem__(self, chosen: NDArray[np.bool_]) -> _Law:
        return _Law(*(value[chosen] for value in vars(self).values()))

    def step(self, x: Floats, torque: Floats, in_effect: Floats, last: Floats) -> tuple[Floats, Floats]:
        """Torque issued (k,) and next states (k, nx)."""
        x = x[:, : self.C.shape[1]]
        wanted = (self.C * x).sum(1) + self.d * torque + self.d_own * in_effect
        issued = np.minimum(np.maximum(wanted, last - self.rate), last + self.rate)
        issued = np.minimum(np.maximum(issued, -self.limit), self.limit)
        ahead = (self.A @ x[:, :, None])[:, :, 0] + self.b * torque[:, None] + self.own * in_effect[:, None]
        return issued, ahead + self.E * (issued - wanted)[:, None]
