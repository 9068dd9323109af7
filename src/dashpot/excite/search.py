"""The search for an informative motion inside the limits.

Per joint a sum of sine waves about a mean pose, ``q = home + r(t) (c + sum_k a_k sin(2 pi f_k t + phi_k))``,
with a quintic ramp r at both ends: periodic in between, at rest before and after. Frequencies are multiples
of a base frequency, from slow ones (friction, gravity) to fast ones (inertia). Candidates are drawn joint by
joint; the arm's motion is put together from them, because a joint's gravity torque, without which its sensor
shows nothing but inertia times acceleration, often comes from the motion of the others.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from dashpot.arm.drive import Drive
from dashpot.arm.dynamics import full_mass
from dashpot.arm.payload import Payload
from dashpot.arm.plant import Plant, build
from dashpot.arm.robot import Robot
from dashpot.certify.threads import one_thread
from dashpot.errors import InputError
from dashpot.excite.dynamics import largest_friction, link_torque, motor_torque
from dashpot.excite.limits import LEAST_AMPLITUDE, Limits, check_weight, ranges
from dashpot.excite.promise import Promise, merit, predicted_log, promise
from dashpot.excite.tones import RAMP, Tones, arm, motion
from dashpot.simulation.trajectory import Trajectory
from dashpot.support.arrays import Floats

SHORTEST, LONGEST = 5.0, 600.0  # [s] of a motion
TONES = 6  # sine waves per joint
SLOWEST, FASTEST = 0.1, (0.6, 1.2, 2.4)  # [Hz] of the tones; candidates of the fastest
LEAST_PERIOD = 5.0  # [s] of the periodic part
DRAWS, KEPT, ROUNDS = 200, 4, 2  # motions per joint, of which kept; rounds of putting the arm's together
CENTRES = (0.0, -0.4, 0.4)  # mean poses, of the way to the limit
COARSE = 0.04  # [s] between the moments at which one joint's candidates are judged
FINE = 0.002  # [s] between those at which speeds are held against their limit
ROUNDING = 0.999  # of position and speed limits, for what lies between those moments
MOMENTS = 300  # of a motion at which the arm's torque is computed to judge it
TORQUE_STEP = 0.02  # [s] between those at which it is held against its limit
POSES = 60  # drawn to see how gravity varies
BEYOND = 30.0  # weight of a torque beyond its limit, logarithmic: such a motion will be shrunk
SHRINK = 0.93  # of the amplitudes, where a torque is too large
HIDDEN = 1e-3  # of the torque limit: gravity a candidate is judged with where there is none


@dataclass(frozen=True)
class JointMotion:
    """What a motion asks of one joint, and what it promises.

    Attributes:
        name: Of the joint.
        low, high: Where it goes [rad].
        lower, upper: Where it may go [rad]: stops less a margin.
        speed: Largest [rad/s].
        torque: Largest motor torque over all payloads [N m].
        share: The same over the torque limit [-].
        promise: With the heaviest payload; None for a joint that rests.
    """

    name: str
    low: float
    high: float
    lower: float
    upper: float
    speed: float
    torque: float
    share: float
    promise: Promise | None


@dataclass(frozen=True)
class Excitation:
    """A motion for an arm.

    Attributes:
        robot: The arm.
        trajectory: From rest at home to rest at home.
        joints: One per joint of the robot.
        torque: Motor torque, at each moment with the payload that asks most, (t, n) [N m].
        torque_time: Its moments, (t,) [s].
    """

    robot: Robot
    trajectory: Trajectory
    joints: tuple[JointMotion, ...]
    torque: Floats
    torque_time: Floats


@one_thread
def excite(
    robot: Robot,
    *,
    duration: float = 45.0,
    period: float = 0.005,
    joints: Sequence[str] = (),
    payloads: Sequence[Payload] = (),
    limits: Limits | None = None,
    seed: int = 0,
) -> Excitation:
    """Finds an informative motion inside the limits. Self-collision and surroundings are not checked.

    Args:
        robot: With a model.
        duration: Of the motion, ramps included [s].
        period: Between its samples [s].
        joints: That move; none: all. The others rest at home.
        payloads: Each must be within the torque limits, one at a time; besides, always the bare flange.
        limits: None: the defaults.
        seed: Of the draws.

    Raises:
        InputError: Limits that leave no motion, with the joint and the reason. A motion that does not tell
            a joint is no error: see `JointMotion.promise`.
    """
    limits = limits or Limits()
    if not SHORTEST <= duration <= LONGEST:
        raise InputError(f"must be {SHORTEST:g} to {LONGEST:g} s", quantity="--duration [s]", value=duration)
    moving = [robot.index(name) for name in dict.fromkeys(joints)] or list(range(len(robot.drives)))
    # Lightest first; the heaviest shows the torque sensor most.
    loads = sorted([Payload(0.0), *(x for x in payloads if x.mass > 0)], key=lambda load: load.mass)
    plants = [build(robot, period, [load] if load.mass > 0 else []) for load in loads]
    spans = ranges(plants[0], limits, moving)
    check_weight(plants, limits)
    rng = np.random.default_rng(seed)
    inertia, gravity = _typical_load(plants[-1], spans, rng)
    choices = {
        j: _candidates(robot.drives[j], inertia[j], gravity[j], spans[j], limits, duration, rng)
        for j in moving
    }
    pick = _together(plants, choices, limits, duration)
    pick, torque, at = _within_torque(plants, pick, limits, duration)
    ticks = period * np.arange(round(duration / period) + 1, dtype=np.float64)
    path = Trajectory(period, *arm(robot, pick, ticks, duration))
    log = predicted_log(plants[-1], path, seed)
    told = []
    for j, drive in enumerate(robot.drives):
        q, peak = path.position[:, j], float(np.abs(torque[:, j]).max())
        told.append(
            JointMotion(
                drive.name,
                float(q.min()),
                float(q.max()),
                float(spans[j, 0]),
                float(spans[j, 1]),
                float(np.abs(path.velocity[:, j]).max()),
                peak,
                peak / drive.torque_limit,
                promise(log, drive) if j in pick else None,
            )
        )
    return Excitation(robot, path, tuple(told), torque, at)


def _typical_load(plant: Plant, spans: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Link inertia at home [kg m^2] and variation of gravity's torque per angle [N m/rad], each (n,)."""
    data = mujoco.MjData(plant.model)
    data.qpos[plant.rotor_qpos] = plant.robot.home
    inertia = full_mass(plant.model, data)[plant.spring_dof, plant.spring_dof]
    poses = rng.uniform(spans[:, 0], spans[:, 1], (POSES, len(spans)))
    varies = np.std([plant.load_torque(pose) for pose in poses], axis=0) / poses.std(0)
    least = HIDDEN * np.array([drive.torque_limit for drive in plant.robot.drives])
    return np.asarray(inertia), np.maximum(varies, least)


def _candidates(
    drive: Drive,
    inertia: float,
    gravity: float,
    span: Floats,
    limits: Limits,
    duration: float,
    rng: np.random.Generator,
) -> list[Tones]:
    """The most informative of many random motions of one joint, best first, each as large as limits allow."""
    reach = float(span[1] - span[0]) / 2
    steady = duration - 2 * min(RAMP, duration / 4)
    t, fine = np.arange(0.0, duration, COARSE), np.arange(0.0, duration, FINE)
    found: list[tuple[float, Tones]] = []
    for _ in range(DRAWS):
        periods = int(rng.integers(1, max(1, int(steady / LEAST_PERIOD)) + 1))
        base = periods / steady
        fastest = float(rng.choice(FASTEST))
        ideal = np.geomspace(SLOWEST, fastest, TONES) * np.exp(rng.uniform(-0.15, 0.15, TONES))
        frequency = base * np.unique(np.maximum(np.rint(ideal / base), 1))
        # Shares of speed, turned into amplitudes: a slow wave of the same speed is larger.
        share = rng.dirichlet(np.full(len(frequency), 1.0))
        tones = Tones(frequency, share / frequency, rng.uniform(0, 2 * math.pi, len(frequency)))
        q, w, a = motion(tones, t, duration)
        factor = float(min(reach / np.abs(q).max(), limits.speed / np.abs(w).max()))
        load = inertia * a + gravity * q
        found.append((merit(drive, factor * w, factor * a, factor * load), tones.scaled(factor)))
    found.sort(key=lambda pair: pair[0])
    kept = []
    for centre in CENTRES:
        for _, tones in found[:KEPT]:
            # About another mean pose there is less room.
            moved = tones.scaled(1 - abs(centre)).about(centre * reach)
            q, w, _ = motion(moved, fine, duration)
            room = min(reach / np.abs(q).max(), limits.speed / np.abs(w).max())
            kept.append(moved.scaled(min(1.0, float(ROUNDING * room))))
    return kept


def _together(
    plants: Sequence[Plant], choices: dict[int, list[Tones]], limits: Limits, duration: float
) -> dict[int, Tones]:
    """A motion of the arm: joint after joint, the candidate that leaves all of them most certain."""
    pick = {j: tones[0] for j, tones in choices.items()}
    best = _score(plants, pick, limits, duration)
    for _ in range(ROUNDS):
        for j, tones in choices.items():
            for candidate in (x.scaled(sign) for x in tones for sign in (1.0, -1.0)):
                tried = pick | {j: candidate}
                score = _score(plants, tried, limits, duration)
                if score < best:
                    best, pick = score, tried
    return pick


def _score(plants: Sequence[Plant], pick: dict[int, Tones], limits: Limits, duration: float) -> float:
    """Of a motion of the whole arm: the sum of the joints' merits, with the torque the links send back."""
    drives = plants[-1].robot.drives
    t = np.linspace(0.0, duration, MOMENTS)
    q, w, a = arm(plants[-1].robot, pick, t, duration)
    tau = link_torque(plants[-1], q, w, a)
    score = sum(merit(drives[j], w[:, j], a[:, j], tau[:, j]) for j in pick)
    used = np.abs(motor_torque(drives, w, a, tau)).max(0)
    allowed = limits.torque_share * np.array([drive.torque_limit for drive in drives])
    return score + BEYOND * float(np.log(np.maximum(used / allowed, 1.0)).sum())


def _within_torque(
    plants: Sequence[Plant], pick: dict[int, Tones], limits: Limits, duration: float
) -> tuple[dict[int, Tones], Floats, Floats]:
    """Shrinks motions until every joint keeps to its share of torque with every payload."""
    robot = plants[0].robot
    drives = robot.drives
    allowed = limits.torque_share * np.array([drive.torque_limit for drive in drives])
    rates = np.array([drive.torque_rate_limit for drive in drives])
    t = np.arange(0.0, duration + TORQUE_STEP / 2, TORQUE_STEP)
    while True:
        q, w, a = arm(robot, pick, t, duration)
        loads = np.stack([link_torque(plant, q, w, a) for plant in plants])
        demands = np.stack([motor_torque(drives, w, a, tau) for tau in loads])
        worst = np.abs(demands).argmax(0)[None]
        torque = np.take_along_axis(demands, worst, 0)[0]
        # Friction turns over at once where a joint reverses; a limited command follows within a few periods.
        smooth = demands - largest_friction(drives) * np.sign(w)
        rate = np.abs(np.diff(smooth, axis=1)).max((0, 1)) / TORQUE_STEP
        used = np.maximum(np.abs(torque).max(0) / allowed, rate / rates)
        j = int(np.argmax(used))
        if used[j] <= 1:
            return pick, torque, t
        i = int(np.argmax(np.abs(torque[:, j])))
        for k in _to_blame(plants[int(worst[0, i, j])], pick, j, q[i], a[i], float(torque[i, j])):
            pick = pick | {k: pick[k].scaled(SHRINK)}
        if max(float(np.abs(tones.amplitude).max()) for tones in pick.values()) < LEAST_AMPLITUDE / TONES:
            raise InputError(
                f"no motion stays within {allowed[j]:.3g} N m: weight and friction alone take that much; use "
                "a lighter payload, another home or a larger --torque-share",
                file=robot.file,
                joint=robot.joints[j],
                quantity="--torque-share [-]",
                value=limits.torque_share,
            )


def _to_blame(plant: Plant, pick: dict[int, Tones], j: int, q: Floats, a: Floats, torque: float) -> list[int]:
    """The moving joint whose acceleration adds most to joint j's torque; all, where none adds much."""
    data = mujoco.MjData(plant.model)
    data.qpos[plant.rotor_qpos] = q
    share = full_mass(plant.model, data)[plant.rotor_dof[j], plant.rotor_dof] * a * np.sign(torque)
    k = max(pick, key=lambda joint: float(share[joint]))
    return [k] if share[k] > 0.05 * abs(torque) else list(pick)
