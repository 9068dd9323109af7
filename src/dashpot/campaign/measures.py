"""What is kept of a scenario: numbers per joint and per run, from its recording.

What comes after the release or first fault is NaN where there is none, and of joints under their own servo.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfilt, sosfilt_zi

from dashpot.controller import NOT_FINITE, RATE_LIMITED, TORQUE_LIMITED
from dashpot.faults import BRAKE_DELAY
from dashpot.recording import Recording
from dashpot.sampled import Floats
from dashpot.supervisor import STATES
from dashpot.vibration import CORNER, WINDOW

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
    nothing = np.full(n, np.nan)  # shared: values replace it, none is written into it
    found: dict[str, Any] = {name: nothing if kind.per_joint else math.nan for name, kind in MEASURES.items()}
    found["limited"] = float(((recording.status & (TORQUE_LIMITED | RATE_LIMITED)) != 0).mean())
    found["not_finite"] = float(((recording.status & NOT_FINITE) != 0).mean())
    found["diverged_at"] = math.inf if recording.diverged_at is None else recording.diverged_at
    if recording.diverged_at is not None:
        return found
    time, period = recording.time, float(recording.time[1] - recording.time[0])
    begin = int(np.searchsorted(time, -1e-9))
    at = None if event is None else int(np.searchsorted(time, event - 1e-9))
    # Joint by joint from here on, (n, ticks): neighbours in memory are added up several times faster.
    angle, speed, torque, command = (
        _rows(signal)
        for signal in (recording.link_position, recording.link_velocity, recording.torque, recording.command)
    )
    error = _rows(recording.reference) - angle
    if (before := error[:, begin:at]).size:
        found["error_rms"] = np.sqrt((before**2).mean(1))
        found["error_max"] = largest(before)
        found["error_mean"], found["error_std"] = before.mean(1), before.std(1)
    if at is not None and at < len(time):
        found["error_after"] = largest(error[:, at:])
        braked = np.array([joint in controlled for joint in recording.joints])
        stopped = stops(angle[:, at:], speed[:, at:], period)
        found |= {name: np.where(braked, values, np.nan) for name, values in stopped.items()}
    found["speed_peak"] = largest(speed)
    found["torque_peak"] = largest(_rows(recording.in_effect))
    found["torque_share"] = found["torque_peak"] / limits
    if rates is not None and len(time) > 1:
        stepped = _rows(recording.command[_powered(recording)])
        found["rate_share"] = largest(np.diff(stepped)) / (rates * period)
    soft = 0.0 if stiffness is None else torque / stiffness[:, None]
    found |= _decided(recording, event, controlled, period, angle + soft)
    found["torque_noise"] = rms(above(command[:, begin:], period, NOISE_CORNER))
    swing = above(_rows(recording.sample[begin:]), period, CORNER)
    window = min(round(WINDOW / period), swing.shape[1] // 3)
    if window:
        found["vibration"] = rms(swing[:, -window:])
        found["vibration_share"] = found["vibration"] / limits
        earlier = rms(swing[:, -2 * window : -window])
        found["growth"] = np.divide(found["vibration"], earlier, out=np.full(n, np.nan), where=earlier > 0)
    return found


def _decided(
    recording: Recording, event: float | None, controlled: Sequence[str], period: float, rotor: Floats
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
        last = rotor[braked, -1 - min(round(RESTS_FOR / period), rotor.shape[1] - 1) :]
        found["stopped"] = float(np.ptp(last, axis=1).max() < RESTS)
    return found


def _powered(recording: Recording) -> NDArray[np.bool_]:
    """Ticks at which the controller was called, (ticks,): in a brownout nobody limits a rate."""
    on = np.ones(len(recording.time), bool)
    faults: Any = recording.settings.get("faults", ())
    period = float(recording.time[1] - recording.time[0])
    for fault in faults:
        if fault["kind"] == "brownout":
            first = round((fault["start"] - recording.time[0]) / period)
            last = max(round((min(fault.get("end", math.inf), 1e9) - recording.time[0]) / period), first + 1)
            on[max(first, 0) : last] = False
    return on


def stops(angle: Floats, velocity: Floats, period: float) -> dict[str, Floats]:
    """How joints stop: times [s], ways [rad] and final drift [rad/s], each (n,), from rows (n, ticks).

    A joint has stopped from the first tick on after which its speed stays below 5 % of what it was at the
    first one, or below 0.5 deg/s, for 50 ms; to the end, if that comes earlier.
    """
    n, ticks = angle.shape
    way = np.abs(angle - angle[:, :1])
    slow = np.abs(velocity) < np.maximum(SLOWED * np.abs(velocity[:, :1]), AT_REST)
    stays = max(1, min(round(STAYS / period), ticks))
    counted = np.zeros((n, ticks + 1), np.int32)
    np.cumsum(slow, axis=1, out=counted[:, 1:])
    stopped = counted[:, stays:] - counted[:, :-stays] == stays
    first, ever = stopped.argmax(1), stopped.any(1)
    farthest = np.maximum.accumulate(way, axis=1)
    last = min(round(LAST / period), ticks - 1)
    return {
        "stop_time": np.where(ever, first * period, np.inf),
        "stop_angle": np.where(ever, farthest[np.arange(n), first], farthest[:, -1]),
        "travel": farthest[:, -1],
        "drift_speed": np.abs(angle[:, -1] - angle[:, -1 - last]) / (last * period)
        if last
        else np.abs(velocity[:, -1]),
    }


def _rows(signal: Floats) -> Floats:
    """A signal over time, (ticks, n), as rows (n, ticks)."""
    return np.ascontiguousarray(signal.T)


def above(signal: Floats, period: float, corner: float) -> Floats:
    """The part of rows above a frequency [Hz]; empty where they are sampled too slowly to tell."""
    if 0.5 / period <= 1.5 * corner or not np.isfinite(signal).all():
        return signal[:, :0]
    sections, settled = _highpass(corner, period)
    return np.asarray(sosfilt(sections, signal, zi=settled * signal[:, :1])[0])


def largest(signal: Floats) -> Floats:
    """Largest absolute value of rows; 0 of none."""
    return np.asarray(np.maximum(signal.max(1, initial=0.0), -signal.min(1, initial=0.0)))


def rms(signal: Floats) -> Floats:
    """Root mean square of rows; NaN of none."""
    return np.sqrt((signal**2).mean(1)) if signal.size else np.full(len(signal), np.nan)


@cache
def _highpass(corner: float, period: float) -> tuple[Floats, Floats]:
    sections = butter(4, corner, "highpass", fs=1 / period, output="sos")
    return sections, sosfilt_zi(sections)[:, None]
