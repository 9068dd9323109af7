"""What `dashpot.studies.rivals_arms` measures on a run, and how many runs become one row."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from dashpot.arm.drive import Drive
from dashpot.certify.certificate import certify_joint
from dashpot.control.controller import ControllerConfig, Law
from dashpot.simulation.faults import short_corner, short_damping
from dashpot.simulation.linear import SampledArm, linearise, modes
from dashpot.simulation.recording import Recording
from dashpot.simulation.simulate import Scenario
from dashpot.studies.rivals_arms_cases import (
    AMPLITUDE,
    LOST,
    RAMP,
    Arm,
    controller,
    plant,
    released,
    robot,
)
from dashpot.support.arrays import Floats

STOPPED, STILL = 0.05, 0.02  # of the speed at the loss [-], or [rad/s], below which a joint has stopped
SLOW = 0.05  # [rad/s]; joints slower than that have no stop time
FIRST, DRIFT = 1.0, 5.0  # [s] after the loss in which a brake stops, and then in which it drifts
QUIET = 0.4  # [s] at the end of a rest
SETTINGS = {"stopped": STOPPED, "still": STILL, "slow": SLOW, "first": FIRST, "drift": DRIFT, "quiet": QUIET}
POSES, GROWS = 4, 1e-3  # random poses beside home; growth [1/s] that counts
STOP = ("stop_time", "stop_angle", "peak_torque", "drift")
TRACK = ("error_mean", "error_std")
Seen = dict[str, list[float]]


def stopping(fault: str | None) -> Callable[[Scenario, Recording], Seen]:
    """Measures a stop, per controlled joint.

    ``stop_time`` [s]: from the loss until the link's speed is within 5 % of what it was, or within `STILL`,
    and stays; infinite if never, NaN where the joint hardly moved. ``stop_angle`` [rad]: farthest from where
    it was, within `FIRST`. ``peak_torque`` [-]: of the motor, shorted windings included, over its limit.
    ``drift`` [rad]: how far the link is after `DRIFT` more from where it was after `FIRST`.
    """

    def measure(scenario: Scenario, found: Recording) -> Seen:
        drives, joints = _controlled(scenario)
        if found.diverged_at is not None:
            return {name: [math.inf] * len(joints) for name in STOP}
        after = found.time >= LOST - 1e-9
        angle, speed = found.link_position[after][:, joints], found.link_velocity[after][:, joints]
        torque = found.in_effect[after][:, joints]
        if fault == "shorted_windings":
            rotor = found.velocity[after][:, joints]
            b, corner = (np.array([of(drive) for drive in drives]) for of in (short_damping, short_corner))
            torque = b * rotor / (1 + (rotor / corner) ** 2)
        first, last = (round(at / scenario.trajectory.period) for at in (FIRST, FIRST + DRIFT))
        limit = np.array([drive.torque_limit for drive in drives])
        return {
            "stop_time": stop_time(speed, scenario.trajectory.period).tolist(),
            "stop_angle": np.abs(angle[: first + 1] - angle[0]).max(0).tolist(),
            "peak_torque": (np.abs(torque).max(0) / limit).tolist(),
            "drift": np.abs(angle[last] - angle[first]).tolist(),
        }

    return measure


def stop_time(speed: Floats, period: float) -> Floats:
    """Time until each column of speeds (ticks, n) [rad/s] stays low [s]; see `stopping`."""
    moving = np.abs(speed) > np.maximum(STOPPED * np.abs(speed[0]), STILL)
    last = len(speed) - np.argmax(moving[::-1], axis=0)  # the tick after the last that moves
    time = np.where(last == len(speed), math.inf, last * period)
    return np.where(np.abs(speed[0]) < SLOW, math.nan, time)


def tracking(scenario: Scenario, found: Recording) -> Seen:
    """Error of the links after the motion has swollen: mean and standard deviation per joint [rad]."""
    _, joints = _controlled(scenario)
    if found.diverged_at is not None:
        return {name: [math.inf] * len(joints) for name in TRACK}
    error = (found.link_position - found.reference)[found.time > RAMP][:, joints]
    return {"error_mean": np.abs(error.mean(0)).tolist(), "error_std": error.std(0).tolist()}


def resting(scenario: Scenario, found: Recording) -> Seen:
    """Standard deviation of the torque command about its trend at rest, over the limit [-]."""
    drives, joints = _controlled(scenario)
    if found.diverged_at is not None:
        return {"noise_torque": [math.inf] * len(joints)}
    last = found.time > found.time[-1] - QUIET
    time, command = found.time[last], found.command[last][:, joints]
    trend = np.polynomial.polynomial.polyfit(time, command, 1)
    noise = (command - np.polynomial.polynomial.polyval(time, trend).T).std(0)
    return {"noise_torque": (noise / [drive.torque_limit for drive in drives]).tolist()}


def _controlled(scenario: Scenario) -> tuple[list[Drive], list[int]]:
    assert scenario.controller is not None
    whole = scenario.plant.robot
    joints = [whole.index(name) for name in scenario.controller.joints]
    return [whole.drives[j] for j in joints], joints


def number(value: float) -> float | None:
    """Four digits; None for what is infinite or not there, which JSON cannot hold."""
    return float(f"{value:.4g}") if math.isfinite(value) else None


def rounded(seen: Seen) -> dict[str, list[float | None]]:
    """One run per joint, for JSON: what a replay must find again."""
    return {name: [number(value) for value in values] for name, values in seen.items()}


def spread(values: Floats, shares: Sequence[float] = (50, 95)) -> list[float | None]:
    """Percentiles of finite and infinite values; interpolation would make NaN of infinite ones."""
    values = values[~np.isnan(values)]
    if not len(values):
        return [None] * len(shares)
    return [number(float(np.percentile(values, share, method="higher"))) for share in shares]


def summary(seen: Sequence[Seen], names: Sequence[str]) -> dict[str, list[float | None]]:
    """Median and 95th percentile over runs of each run's worst joint."""
    rows = {}
    for name in names:
        per_joint = np.array([one[name] for one in seen], float)
        worst = np.where(np.isnan(per_joint), -1.0, per_joint).max(1)
        worst[worst < 0] = math.nan  # no joint has a value
        rows[name] = spread(worst)
    return rows


def worst_joints(seen: Sequence[Seen], name: str) -> Floats:
    """Each run's worst joint, (runs,)."""
    return np.array([max(one[name]) for one in seen], float)


def medians(seen: Sequence[Seen], names: Sequence[str], joints: Sequence[str]) -> dict[str, Any]:
    """Median and 95th percentile per joint."""
    return {
        joint: {name: spread(np.array([one[name][i] for one in seen], float)) for name in names}
        for i, joint in enumerate(joints)
    }


def certificate(task: tuple[Drive, Law, ControllerConfig]) -> bool:
    """Whether a law is certified on a drive over its stated uncertainty."""
    return certify_joint(*task).certified


def poses(arm: Arm, seed: int) -> list[Floats]:
    """Home and `POSES` random ones around it, (n,) [rad]."""
    home = np.asarray(robot(arm).home, float)
    rng = np.random.default_rng(seed)
    return [home, *(home + rng.uniform(-AMPLITUDE, AMPLITUDE, (POSES, len(home))))]


def linearised(arm: Arm, config: ControllerConfig, seed: int) -> dict[float, list[SampledArm]]:
    """Payload [kg] -> the sampled arm at each of `poses`."""
    names = [law.name for law in config.joints]
    return {
        payload: [
            linearise(plant(arm, payload), names, pose, config.period, config.sampling)
            for pose in poses(arm, seed)
        ]
        for payload in arm.payloads
    }


def oscillates(
    arm: Arm, config: ControllerConfig, arms: Mapping[float, list[SampledArm]], brake: bool
) -> dict[str, float] | None:
    """The fastest growing oscillation of the linear sampled arm at any payload and pose; None: all decay."""
    alone = released(config) if brake else config
    made = controller(arm, alone)
    keeps = not brake or any(law.keeps_encoder for law in config.joints)
    worst: dict[str, float] | None = None
    for payload, at in arms.items():
        for one in at:
            for mode in modes(one, made, position_loop=keeps):
                if mode.frequency > 0.02 and mode.growth > max(GROWS, worst["growth"] if worst else 0.0):
                    worst = {"payload": payload, "frequency": mode.frequency, "growth": mode.growth}
    return worst if worst is None else {name: float(f"{value:.3g}") for name, value in worst.items()}
