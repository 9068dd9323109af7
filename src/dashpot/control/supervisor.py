"""The runtime supervisor: plausible signals, ordered fallbacks, and a reason for every decision.

It runs natively (native/dashpot_supervisor.h) in place of the controller's step, with the settings and
thresholds of `dashpot.control.thresholds`. Here it is wrapped, and its decisions are put into words;
docs/supervisor.md explains all.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

import dashpot._native as _native
from dashpot.arm.drive import Drive
from dashpot.control.controller import Controller
from dashpot.control.supervisorsettings import SupervisorSettings
from dashpot.control.thresholds import (
    RULES_DTYPE,
    WATCH_DTYPE,
    load_state,
    rules_record,
    watch_records,
)
from dashpot.errors import InputError

State = Literal["track", "torque_brake", "encoder_brake", "safe"]
STATES: tuple[State, ...] = ("track", "torque_brake", "encoder_brake", "safe")
"""In order: each is worse than the one before."""

EVENTS = {
    "encoder lost": 1,
    "torque sensor lost": 2,
    "stop requested": 4,
    "law oscillates or fails": 8,
    "brake late or drifting": 16,
}
"""What the decision depends on, as bits of `next_state`."""


class Reason(NamedTuple):
    """Why a decision was made."""

    name: str
    words: str
    unit: str


REASONS = (
    Reason("none", "no reason", ""),
    Reason("operator", "the operator asked for a stop", ""),
    Reason("host", "the host is lost", ""),
    Reason("reference", "a reference is not a number", ""),
    Reason("encoder_not_finite", "the encoder gives no number", "rad"),
    Reason("encoder_stale", "the encoder sample is too old", "ticks"),
    Reason("encoder_range", "the angle is outside the joint's range", "rad"),
    Reason("encoder_rate", "the encoder moves faster than the joint can", "rad/s"),
    Reason("encoder_inconsistent", "position and velocity of the encoder disagree", "rad/s"),
    Reason("encoder_frozen", "the encoder stands, the rotor does not", "N m"),
    Reason("torque_not_finite", "the torque sensor gives no number", "N m"),
    Reason("torque_stale", "the torque sample is too old", "ticks"),
    Reason("torque_range", "the torque is beyond the sensor's range", "N m"),
    Reason("torque_rate", "the torque changes faster than the transmission allows", "N m"),
    Reason("torque_stuck", "the torque sample repeats itself in spite of its noise", "ticks"),
    Reason("torque_residual", "the rotor's motion does not fit sensed and motor torque", "N m"),
    Reason("residual_at_rest", "encoder and torque sensor disagree, and either may be wrong", "N m"),
    Reason("law_not_finite", "the control law gives no number", "N m"),
    Reason("oscillation", "the motor keeps up an oscillation", "N m"),
    Reason("stop_late", "the joint did not come to rest in time", "rad/s"),
    Reason("blind", "nobody can see whether the arm has stopped", "s"),
    Reason("drift", "the joint leaves the place where it came to rest", "rad"),
    Reason("sag", "the joint moves on under the brake", "rad"),
    Reason("encoder_stands", "the encoder stands while the reference moves on", "rad"),
    Reason("done", "the motion is over", ""),
    Reason("parked", "the arm has come to rest", "rad/s"),
)
"""In the order of ``DP_WHY_*`` in native/dashpot_supervisor.h."""


@dataclass(frozen=True)
class Decision:
    """One entry of the log.

    Attributes:
        time: [s] since the supervisor was made.
        tick: Its tick.
        joint: The joint concerned, or None: the arm.
        before: State before.
        after: State after; the same where trust was lost but the state was already bad enough.
        reason: Name of the reason, one of `REASONS`.
        value: What was seen, in `unit`.
        threshold: What would have been accepted, in `unit`.
        unit: Unit of both.
        words: The reason in words.
    """

    time: float
    tick: int
    joint: str | None
    before: State
    after: State
    reason: str
    value: float
    threshold: float
    unit: str
    words: str

    def __str__(self) -> str:
        said = f"{self.time:.3f} s: {self.joint + ': ' if self.joint else ''}{self.words}"
        if self.unit and not math.isnan(self.value):
            said += f" ({self.value:.4g} {self.unit}, limit {self.threshold:.4g})"
        return f"{said}: {self.before} -> {self.after}"


class Supervisor:
    """A controller under supervision: use its `step` instead of the controller's.

    >>> controller.inputs.torque[:] = sensed     # and the other inputs, as without a supervisor
    >>> supervisor.torque_age[:] = 0             # ticks since the last fresh sample, (n,)
    >>> status = supervisor.step(command)        # writes (n,) N m; allocates nothing
    >>> if supervisor.apply_brake: ...           # close the mechanical brake

    Attributes:
        controller: What is supervised.
        settings: As given.
        watch: (n,) records of `WATCH_DTYPE`: the thresholds.
        gravity: What the robot itself adds to the torque from this tick on, (n,) [N m]; write it before
            `step`. Zero: nothing.
        torque_age: Age of the torque samples, (n,) [ticks]; write it before `step`. 0: fresh.
        encoder_age: Age of the encoder samples, (n,) [ticks].
        step: ``step(out) -> status``: one tick on ``controller.inputs``; out (n,) receives torques [N m].
        guard: The native object.
    """

    def __init__(
        self,
        controller: Controller,
        drives: Sequence[Drive],
        settings: SupervisorSettings | None = None,
        *,
        limits: Mapping[str, tuple[float, float]] | None = None,
    ) -> None:
        """Derives the thresholds.

        Args:
            controller: To be supervised; its modes and states are steered from here on.
            drives: Of the robot; those of the controller's joints are used.
            settings: None: the defaults.
            limits: Joint name -> range of its angle [rad], margin included; others are not checked.

        Raises:
            InputError: A controlled joint has no drive, or a range is empty.
        """
        self.controller, self.settings = controller, settings or SupervisorSettings()
        self.watch = watch_records(controller, drives, self.settings, limits)
        self.guard = native_guard(controller.core, self.watch, self.settings, controller.period)
        self.gravity = self.guard.gravity
        self.torque_age, self.encoder_age = self.guard.torque_age, self.guard.encoder_age
        self.step = self.guard.step

    @property
    def state(self) -> State:
        """Where the arm is, one of `STATES`."""
        return STATES[self.guard.state]

    @property
    def apply_brake(self) -> bool:
        """Whether the mechanical brake must close."""
        return self.guard.apply_brake

    @property
    def stopped(self) -> bool:
        """Whether a brake has been seen to bring the arm to rest."""
        return self.guard.stopped

    @property
    def log(self) -> list[Decision]:
        """The decisions, oldest first; the latest 64, which is all since the last reset."""
        return decisions(self.guard, self.controller.joints, self.controller.period)

    def stop(self, reason: Literal["operator", "host", "done"] = "operator") -> None:
        """Asks for a stop by the torque brake from the next tick on.

        Raises:
            InputError: Another reason.
        """
        if reason not in ("operator", "host", "done"):
            raise InputError('must be "operator", "host" or "done"', quantity="reason", value=reason)
        self.guard.stop([r.name for r in REASONS].index(reason))

    def park(self) -> None:
        """From now on a brake that has brought the arm to rest is followed by the mechanical one: "safe"."""
        self.guard.park()

    def reset(self) -> None:
        """Back to tracking, every signal trusted, states and torques cleared; the log stays. At rest only."""
        self.guard.reset()

    def joint(self, name: str) -> dict[str, Any]:
        """Rotor balance and its limit [N m], speed [rad/s], latched bias [N m], and trust of one joint."""
        keys = ("residual", "limit", "speed", "bias", "encoder_trusted", "torque_trusted", "half_cycles")
        return dict(zip(keys, self.guard.joint_state(self.controller.index(name)), strict=True))


def native_guard(
    core: _native.Core, watch: NDArray[np.void], settings: SupervisorSettings, period: float
) -> _native.Guard:
    """The native supervisor of a native controller."""
    if (WATCH_DTYPE.itemsize, RULES_DTYPE.itemsize) != (_native.WATCH_SIZE, _native.RULES_SIZE):
        raise RuntimeError("the native library was built from another version; reinstall dashpot")
    rules = rules_record(settings, period)
    return _native.Guard(core, rules.reshape(1).view(np.uint8), watch.view(np.uint8))


def decisions(guard: _native.Guard, joints: Sequence[str], period: float) -> list[Decision]:
    """What a native supervisor has decided, oldest first; the latest 64, which is all since a reset."""
    return [decision(raw, joints, period) for raw in guard.log()]


def decision(
    raw: tuple[int, int, int, int, int, float, float], joints: Sequence[str], period: float
) -> Decision:
    """A native decision in words."""
    tick, joint, before, after, why, value, threshold = raw
    return Decision(
        tick * period,
        tick,
        joints[joint] if joint >= 0 else None,
        STATES[before],
        STATES[after],
        REASONS[why].name,
        value,
        threshold,
        REASONS[why].unit,
        REASONS[why].words,
    )


def next_state(state: State, *events: str) -> State:
    """The state that follows on a state and events, names of `EVENTS`: the whole decision."""
    return STATES[_native.next_state(STATES.index(state), sum({EVENTS[e] for e in events}))]


__all__ = [
    "EVENTS",
    "REASONS",
    "STATES",
    "Decision",
    "Supervisor",
    "SupervisorSettings",
    "decision",
    "load_state",
    "next_state",
]
