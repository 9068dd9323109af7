"""What is kept of a scenario: numbers per joint and per run, from its recording.

What comes after the release or first fault is NaN where there is none, and of joints under their own servo.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import dashpot._native as _native
from dashpot.control.controller import NOT_FINITE, RATE_LIMITED, TORQUE_LIMITED
from dashpot.control.supervisor import STATES
from dashpot.simulation.faults import BRAKE_DELAY
from dashpot.simulation.recording import Recording
from dashpot.simulation.vibration import CORNER, WINDOW, highpass
from dashpot.support.arrays import Floats

NOISE_CORNER = 30.0  # [Hz] commanded torque above it is noise, not motion
SLOWED = 0.05  # of the speed at the event: a joint that has stopped
AT_REST = math.radians(0.5)  # [rad/s] slower than this is at rest in any case
STAYS = 0.05  # [s] for which a stopped joint must stay slow
RESTS = 0.002  # [rad] by which a rotor at rest may swing: a brake is as soft as that at the torque it holds
RESTS_FOR = 0.1  # [s]; with the above 0.02 rad/s, the supervisor's still_speed
SLIPS = 0.3  # [s] that an arm may swing and slip in a brake that has just closed
LAST = 1.0  # [s] at the end over which drift is taken


@dataclass(frozen=True)
class Measure:
    """One measure.

    Attributes:
        unit: SI.
        words: What it is.
        per_joint: Whether it has a value per joint.
    """

    unit: str
    words: str
    per_joint: bool = True


_AFTER = "after the release or first fault"
MEASURES = {
    "error_rms": Measure("rad", "RMS of reference minus link angle, before the release or first fault"),
    "error_max": Measure("rad", "largest tracking error, before the release or first fault"),
    "error_mean": Measure("rad", "mean tracking error, before the release or first fault"),
    "error_std": Measure(
        "rad", "standard deviation of the tracking error, before the release or first fault"
    ),
    "error_after": Measure("rad", f"largest tracking error {_AFTER}"),
    "stop_time": Measure("s", f"until the link is slow and stays so, {_AFTER}; inf: never"),
    "stop_angle": Measure("rad", f"farthest way from where it was until it stops, {_AFTER}"),
    "travel": Measure("rad", f"farthest way from where it was until the end, {_AFTER}"),
    "drift_speed": Measure("rad/s", f"mean speed over the last second, {_AFTER}"),
    "speed_peak": Measure("rad/s", "largest link speed"),
    "torque_peak": Measure("N m", "largest torque asked of the drive"),
    "torque_share": Measure("-", "largest torque asked of the drive over its limit"),
    "torque_noise": Measure("N m", f"RMS of the torque command above {NOISE_CORNER:g} Hz"),
    "vibration": Measure("N m", f"RMS of the sensed torque above {CORNER:g} Hz in the last second"),
    "vibration_share": Measure("-", "vibration over the drive's torque limit"),
    "growth": Measure("-", "vibration over that of the second before: above 1 it grows"),
    "limited": Measure("-", "share of the time in which any joint's torque or its rate was limited", False),
    "not_finite": Measure(
        "-", "share of the time in which any joint's input or torque was not finite", False
    ),
    "rate_share": Measure("-", "largest change of the torque command per tick over the rate limit's"),
    "supervisor_state": Measure("-", "at the end: track 0, torque_brake 1, encoder_brake 2, safe 3", False),
    "brake_closed": Measure("-", "1: the supervisor has closed the mechanical brake", False),
    "time_to_decision": Measure(
        "s", f"until the supervisor's first decision, {_AFTER}; negative: before it; inf: none", False
    ),
    "oscillated": Measure("-", "1: the supervisor found an oscillation that the motor keeps up", False),
    "stopped": Measure(
        "-",
        f"1: every controlled rotor of a stopped arm stays within {RESTS:g} rad in the last {RESTS_FOR:g} s",
        False,
    ),
    "diverged_at": Measure("s", "time at which the simulation diverged; inf: never", False),
}
"""Measures by name; `measure` gives them all."""
_ROWS = (
    *("error_rms", "error_max", "error_mean", "error_std", "error_after"),
    *("stop_time", "stop_angle", "travel", "drift_speed"),
    *("speed_peak", "torque_peak", "torque_step", "torque_noise", "vibration", "earlier"),
)
"""Of native/dashpot_measures.h, in its order."""


def measure(
    recording: Recording,
    event: float | None,
    limits: Floats,
    controlled: Sequence[str],
    rates: Floats | None = None,
    stiffness: Floats | None = None,
) -> dict[str, Any]:
    """All measures of a run.

    Args:
        recording: The run.
        event: Time of the release or first fault [s], or None.
        limits: Torque limits of the drives, (n,) [N m].
        controlled: Joints under the controller; only they are made to stop.
        rates: Torque rate limits of the drives, (n,) [N m/s], infinite where there is none; None: everywhere.
        stiffness: Of the transmissions, (n,) [N m/rad]: rotors are where link and torque say; None: infinite.

    Returns:
        Name -> (n,) array or number, as in `MEASURES`. Of a run that diverged all is NaN but `limited`,
        `not_finite` and `diverged_at`.
    """
    n = len(recording.joints)
    found: dict[str, Any] = {
        name: np.full(n, np.nan) if kind.per_joint else math.nan for name, kind in MEASURES.items()
    }
    found["limited"] = float(((recording.status & (TORQUE_LIMITED | RATE_LIMITED)) != 0).mean())
    found["not_finite"] = float(((recording.status & NOT_FINITE) != 0).mean())
    found["diverged_at"] = math.inf if recording.diverged_at is None else recording.diverged_at
    if recording.diverged_at is not None:
        return found
    time, period = recording.time, float(recording.time[1] - recording.time[0])
    begin = int(np.searchsorted(time, -1e-9))
    at = len(time) if event is None else int(np.searchsorted(time, event - 1e-9))
    numbers = dict(zip(_ROWS, _native_measures(recording, period, begin, at), strict=True))
    for name in ("error_rms", "error_max", "error_mean", "error_std", "error_after", "speed_peak"):
        found[name] = numbers[name]
    braked = np.array([joint in controlled for joint in recording.joints])
    for name in ("stop_time", "stop_angle", "travel", "drift_speed"):
        found[name] = np.where(braked, numbers[name], np.nan)
    found["torque_peak"], found["torque_share"] = numbers["torque_peak"], numbers["torque_peak"] / limits
    if rates is not None and len(time) > 1:
        found["rate_share"] = numbers["torque_step"] / (rates * period)
    found |= _decided(recording, event, controlled, period, stiffness)
    found["torque_noise"], found["vibration"] = numbers["torque_noise"], numbers["vibration"]
    found["vibration_share"] = numbers["vibration"] / limits
    earlier = numbers["earlier"]
    found["growth"] = np.divide(numbers["vibration"], earlier, out=np.full(n, np.nan), where=earlier > 0)
    return found


def _native_measures(recording: Recording, period: float, begin: int, at: int) -> Floats:
    """All that is taken joint by joint, (`_ROWS`, n): native/dashpot_measures.h."""
    channels = ("reference", "link_position", "link_velocity", "command", "in_effect", "sample")
    tables = tuple(np.ascontiguousarray(getattr(recording, name), float) for name in channels)
    powered = _powered(recording)
    last, stays = round(LAST / period), max(1, round(STAYS / period))
    ticks = len(recording.time)
    window = min(round(WINDOW / period), (ticks - begin) // 3)
    found = np.empty((_native.MEASURES, len(recording.joints)))
    filters = highpass(NOISE_CORNER, period), highpass(CORNER, period)
    _native.measure(
        tables, powered, begin, at, period, SLOWED, AT_REST, stays, last, *filters, max(window, 0), found
    )
    return found


def _decided(
    recording: Recording,
    event: float | None,
    controlled: Sequence[str],
    period: float,
    stiffness: Floats | None,
) -> dict[str, Any]:
    """What the supervisor did and whether it was right; nothing where none ran."""
    said: Any = recording.settings.get("supervisor")
    if said is None:
        return {}
    decisions = said["decisions"]
    found = {
        "supervisor_state": float(STATES.index(said["state"])),
        "brake_closed": float(said["apply_brake"]),
        "oscillated": float(any(decision["reason"] == "oscillation" for decision in decisions)),
    }
    if event is not None:
        found["time_to_decision"] = decisions[0]["time"] - event if decisions else math.inf
    # Judged once the supervisor says that the arm has stopped, or the mechanical brake has had its time: to
    # close, to take the arm's energy, and to show that it holds. The link may go on swinging behind it.
    end, closed = float(recording.time[-1]), [d["time"] for d in decisions if d["after"] == "safe"]
    if (closed and end - closed[0] >= BRAKE_DELAY + SLIPS + RESTS_FOR) or said["stopped"]:
        braked = [joint in controlled for joint in recording.joints]
        last = slice(-1 - min(round(RESTS_FOR / period), len(recording.time) - 1), None)
        rotor = recording.link_position[last]
        if stiffness is not None:
            rotor = rotor + recording.torque[last] / stiffness
        found["stopped"] = float(np.ptp(rotor[:, braked], axis=0).max() < RESTS)
    return found


def _powered(recording: Recording) -> NDArray[np.uint8] | None:
    """Whether the controller was called, per tick: in a brownout nobody limits a rate. None: at every one."""
    faults: Any = recording.settings.get("faults", ())
    if all(fault["kind"] != "brownout" for fault in faults):
        return None
    on = np.ones(len(recording.time), np.uint8)
    period = float(recording.time[1] - recording.time[0])
    for fault in faults:
        if fault["kind"] == "brownout":
            first = round((fault["start"] - recording.time[0]) / period)
            last = max(round((min(fault.get("end", math.inf), 1e9) - recording.time[0]) / period), first + 1)
            on[max(first, 0) : last] = 0
    return on
