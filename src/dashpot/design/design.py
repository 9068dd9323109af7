"""The design of an arm: joint by joint, from a specification to a controller file."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dashpot.arm.robot import Robot
from dashpot.certify.threads import one_thread
from dashpot.control.controller import SLIGHT, ControllerConfig
from dashpot.design import candidates as quantity
from dashpot.design.candidates import Duty
from dashpot.design.carried import carried
from dashpot.design.conflicts import Conflict, conflict
from dashpot.design.search import DOUBT, Found, JointSearch
from dashpot.design.spec import DEFAULT_PERIOD, Spec
from dashpot.design.wishes import NEED_LOOP, Wishes
from dashpot.support.arrays import Floats
from dashpot.support.workers import each

FRONT = 5  # most points of the trade-off that are tested to the end
PREDICTED = (
    "travel",
    "stop_time",
    "creep",
    "hold",
    "load_error",
    "error_ratio",
    "noise",
    "authority",
    "damping_ratio",
)
"""Quantities a design predicts, as in `dashpot.design.candidates`."""


@dataclass(frozen=True)
class TradeOff:
    """Certified candidates of which none is better in both: the wish against the travel (or the authority).

    Attributes:
        against: Name of the second quantity.
        wish: (k,).
        other: (k,).
        all: The others that were certified, (l, 2).
    """

    against: str
    wish: Floats
    other: Floats
    all: Floats


@dataclass(frozen=True)
class JointDesign:
    """What came out for one joint.

    Attributes:
        name: The joint.
        duty: What it has to do.
        wishes: Wish and limits.
        found: The certified gains, or None.
        predicted: What they will do with the drive as stated.
        assured: The same with the weakest torque channel the drive states; this is what keeps the limits.
        stop_late: Time to stop if the last swings are a little larger than predicted [s].
        trade_off: Between the wish and the stop.
        conflict: Why there is nothing.
        candidates: Looked at.
        asked: Exact tests made.
    """

    name: str
    duty: Duty
    wishes: Wishes
    found: Found | None
    predicted: Mapping[str, float]
    assured: Mapping[str, float]
    stop_late: float
    trade_off: TradeOff | None
    conflict: Conflict | None
    candidates: int
    asked: int


@dataclass(frozen=True)
class Design:
    """What came out for an arm.

    Attributes:
        robot: Its name.
        spec: The specification.
        joints: Base to tip.
    """

    robot: str
    spec: Spec
    joints: tuple[JointDesign, ...]

    @property
    def feasible(self) -> bool:
        """Whether every joint has certified gains."""
        return all(joint.found is not None for joint in self.joints)

    @property
    def config(self) -> ControllerConfig:
        """The controller of the joints that have gains, at least one."""
        done = [joint for joint in self.joints if joint.found is not None]
        return done[0].duty.config(tuple(j.found.gains.joint(j.name) for j in done if j.found is not None))


def duties(robot: Robot, spec: Spec) -> list[Duty]:
    """What every joint to be designed has to do, base to tip.

    Raises:
        InputError: Specification and robot do not fit together.
        ModelError: The model cannot be used.
    """
    spec.check(robot)
    names = spec.joints or robot.joints
    drives = [drive for drive in robot.drives if drive.name in names]
    period = spec.period or DEFAULT_PERIOD
    sampling = spec.sampling or (
        "point" if all(d.sensor_bandwidth is not None for d in drives) else "average"
    )
    found = carried(robot, spec, period)
    result = []
    for drive in drives:
        late = (drive.command_latency or 0.0) / period
        latency = math.floor(late + 0.5) if spec.latency is None else spec.latency
        latest = max(latency, math.ceil(late - SLIGHT)) if spec.latency_max is None else spec.latency_max
        what = found[drive.name]
        result.append(
            Duty(
                drive=drive,
                period=period,
                latency=latency,
                latency_max=latest,
                sampling=sampling,
                form=spec.form,
                inertia=what.inertia,
                loaded=what.loaded,
                load=what.load,
                speed=spec.speed,
                residual=spec.residual_speed,
                jump=spec.jump,
            )
        )
    # One loop runs them all.
    latency = max(duty.latency for duty in result)
    latest = max(duty.latency_max for duty in result)
    for duty in result:
        object.__setattr__(duty, "latency", latency)
        object.__setattr__(duty, "latency_max", latest)
    return result


def design_arm(
    robot: Robot, spec: Spec, *, workers: int = 1, advance: Callable[[], None] = lambda: None
) -> Design:
    """Designs an arm's controller.

    Args:
        robot: The arm.
        spec: What is wanted.
        workers: Processes to share the joints; more than one needs a main module that may be imported.
        advance: Called after every joint.

    Raises:
        InputError: Specification and robot do not fit together.
        ModelError: The model cannot be used.
    """
    tasks = [(duty, spec.of(duty.drive.name), spec.loop) for duty in duties(robot, spec)]
    joints = each(_designed, tasks, workers, advance)
    return Design(robot.name, spec, tuple(joints))


def _designed(task: tuple[Duty, Wishes, bool]) -> JointDesign:
    return design_joint(*task)


@one_thread
def design_joint(duty: Duty, wishes: Wishes, loop: bool) -> JointDesign:
    """Designs one joint: the best certified gains, or why there are none."""
    search = JointSearch(duty, wishes, loop)
    found = search.run()
    if found is None:
        why = conflict(duty, wishes, loop)
        return JointDesign(
            duty.drive.name, duty, wishes, None, {}, {}, math.inf, None, why, search.candidates, search.asked
        )
    return JointDesign(
        duty.drive.name,
        duty,
        wishes,
        found,
        predict(duty, found, loop),
        predict(search.assured, found, loop),
        float(quantity.stop_time(replace(duty, residual=(1 - DOUBT) * duty.residual), found.gains)[0]),
        _trade_off(search, found),
        None,
        search.candidates,
        search.asked,
    )


def predict(duty: Duty, found: Found, loop: bool) -> dict[str, float]:
    """What a design will do, by name as in `PREDICTED`."""
    values = {}
    for name in PREDICTED:
        if loop or name not in NEED_LOOP:
            function: Callable[[Duty, Any], Floats] = getattr(quantity, name)
            values[name] = float(function(duty, found.gains)[0])
    return values


def _trade_off(search: JointSearch, found: Found) -> TradeOff:
    """The front of the certified candidates, and the design itself."""
    wish = search.wishes.minimise
    against = "authority" if wish == "travel" else "travel"
    points = np.array([found.point, *(point for _, point in search.passed)])
    gains = search.gains(points)
    values = np.stack([search.value(wish, gains), search.value(against, gains)], axis=1)
    values = values if wish not in ("damping_ratio",) else values * [-1, 1]
    good = np.array([True, *(search.certain(point, "quick") for point in points[1:])])
    while True:
        front = _front(values, good)
        refused = [i for i in front if i and not search.certain(points[i], "proof")]
        if not refused:
            break
        good[refused] = False
    return TradeOff(against, np.abs(values[front, 0]), values[front, 1], np.abs(values[good]))


def _front(values: Floats, good: NDArray[np.bool_]) -> list[int]:
    """Rows of (k, 2) values that no other good one beats in both columns; at most `FRONT`, evenly spread."""
    front: list[int] = []
    for i in np.lexsort((values[:, 1], values[:, 0])):
        if good[i] and (not front or values[i, 1] < values[front[-1], 1] * (1 - 1e-6)):
            front.append(int(i))
    if len(front) > FRONT:
        front = [front[round(i)] for i in np.linspace(0, len(front) - 1, FRONT)]
    return front
