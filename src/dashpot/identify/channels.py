"""One joint's channels out of a log, and what can be seen without solving anything."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dashpot.errors import InputError
from dashpot.identify import refusals as rules
from dashpot.identify.windows import Channels, Windows, resolution
from dashpot.logs.log import Log

ABSURD: Mapping[str, float] = {"command": 1e6, "torque": 1e6, "motion": 1e5, "link": 1e5}


def channels_of(log: Log, joint: str) -> list[Channels]:
    """The channels of one joint, a segment each; refuses what cannot be a measurement."""
    if joint not in log.joints:
        raise InputError(
            f"no such joint in the log; it has {', '.join(log.joints)}", file=log.file, joint=joint
        )
    j = log.joints.index(joint)
    found = []
    for segment in log.segments:
        rate = segment.position is None
        motion = segment.velocity if segment.position is None else segment.position
        if motion is None:
            raise InputError("the log has neither position nor velocity", file=log.file, joint=joint)
        link = segment.link_position
        command, torque, moved = (
            np.asarray(x, float)[:, j] for x in (segment.command, segment.torque, motion)
        )
        time = np.asarray(segment.time, float)
        turned = None if link is None else np.asarray(link, float)[:, j]
        channels = Channels(time, command, torque, moved, rate, turned)
        for name, limit in ABSURD.items():
            values = getattr(channels, name)
            if values is None:
                continue
            if not np.isfinite(values).all():
                raise InputError("must be finite", file=log.file, joint=joint, quantity=name)
            if len(values) and np.abs(values).max() > limit:
                raise InputError(
                    f"must be within {limit:g}; check the unit: N m, rad, rad/s",
                    file=log.file,
                    joint=joint,
                    quantity=name,
                    value=float(np.abs(values).max()),
                )
        found.append(channels)
    if len({(c.rate, c.link is None) for c in found}) > 1:
        raise InputError("every segment must have the same channels", file=log.file, joint=joint)
    return found


def hopeless(channels: list[Channels], period: float) -> tuple[str, str] | None:
    """What can be seen without filtering: too short, or something never changes."""
    duration = sum(len(c.time) for c in channels) * period
    if duration < rules.SHORTEST:
        return (
            f"the log is too short: {duration:.2g} s",
            f"log at least {rules.SHORTEST:g} s, better 20 s, of motion; {rules.GENERAL}",
        )
    spread = {
        name: max(float(np.ptp(getattr(c, name))) for c in channels)
        for name in ("command", "torque", "motion")
    }
    if spread["motion"] == 0:
        return "the rotor stands still", rules.GENERAL
    if spread["command"] == 0:
        return "the torque command never changes: nothing to compare the torque with", rules.GENERAL
    if spread["torque"] == 0:
        return "the sensed torque never changes: is the sensor on?", rules.GENERAL
    return None


def no_windows(windows: Windows, channels: list[Channels]) -> tuple[str, str] | None:
    """Why there is nothing to solve the equations on, or None."""
    if len(windows.time) == 0:
        return "the log has no stretch long enough without a gap", "log 2 s and more without a gap"
    if float(windows.limited.mean()) > rules.SATURATED:
        return (
            "the command exceeds the drive's torque_limit most of the time: the torque in effect is not "
            "known",
            "move more gently, or correct torque_limit",
        )
    if windows.independent >= rules.FEWEST:
        return None
    step = 0.0 if channels[0].rate else max(resolution(c.motion) for c in channels)
    if step > 0 and max(float(np.ptp(c.motion)) for c in channels) < 20 * step:
        return (
            f"the rotor stands still: it moves by less than 20 encoder steps of {step:.2g} rad",
            rules.GENERAL,
        )
    if windows.fastest < 2 * windows.slowest:
        return (
            f"the rotor hardly moves: speeds above {windows.slowest:.2g} rad/s can be told from noise and "
            f"encoder steps, the fastest is {windows.fastest:.2g} rad/s",
            f"move at {5 * windows.slowest:.2g} rad/s or faster, or use a finer encoder",
        )
    return (
        f"too little steady motion: {windows.count * windows.stride * windows.period:.2g} s of it lies "
        "clear of "
        "standstill and reversals",
        f"move slower than you reverse now, for longer: {8 * windows.kernel:.2g} s must pass between "
        "reversals",
    )
