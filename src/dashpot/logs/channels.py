"""What the readers hand over: samples with their stamps, and which column is which."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dashpot.errors import InputError
from dashpot.logs.log import Log
from dashpot.support.arrays import Floats

QUANTITIES = ("command", "effort", "position", "velocity", "link_position")
"""Endings of columns, in the order they are written."""
UNITS = {
    "command": "N m",
    "effort": "N m",
    "position": "rad",
    "velocity": "rad/s",
    "link_position": "rad",
    "acceleration": "rad/s^2",
}
TIME = ("time", "__time", "timestamp")

Ints = NDArray[np.int64]
Key = tuple[str, str]  # joint, quantity


@dataclass(frozen=True)
class Topics:
    """Names of ROS 2 topics, of which PlotJuggler makes the beginnings of column names.

    Attributes:
        states: sensor_msgs/JointState: motor-side position and velocity; effort is the sensed torque.
        commands: Of which effort is the torque command.
        links: Of which position is the link-side angle; need not be there.
    """

    states: str = "/joint_states"
    commands: str = "/joint_command"
    links: str = "/link_states"

    def __post_init__(self) -> None:
        names = [name.strip("/") for name in (self.states, self.commands, self.links)]
        if "" in names or len(set(names)) < 3:
            raise InputError("states, commands and links must be three different topics", quantity="topics")

    @property
    def meaning(self) -> dict[str, dict[str, str]]:
        """Topic, without outer slashes, to the fields of its messages and what they are."""
        return {
            self.states.strip("/"): {"position": "position", "velocity": "velocity", "effort": "effort"},
            self.commands.strip("/"): {"effort": "command"},
            self.links.strip("/"): {"position": "link_position"},
        }


@dataclass(frozen=True)
class Source:
    """Samples that share their stamps: the rows of a table, or the messages of one topic.

    Attributes:
        label: What the rows are: "line", "row", or "message of /topic".
        rows: (t,) their numbers, as a user counts them.
        time: (t,) stamps [s].
        values: (t,) per joint and quantity; NaN where a row has no sample.
    """

    label: str
    rows: Ints
    time: Floats
    values: Mapping[Key, Floats]

    def at(self, i: int) -> str:
        """Where a row is, in words."""
        return f"{self.label} {self.rows[i]}, time {self.time[i]:.9g} s"


@dataclass(frozen=True)
class Raw:
    """A log file's content.

    Attributes:
        sources: One or several.
        sampling: What the file says about its torque samples, or None.
    """

    sources: Sequence[Source]
    sampling: str | None = None


def columns(names: Sequence[str], topics: Topics, file: Path) -> tuple[str, dict[str, Key]]:
    """The time column, and joint and quantity of the others; unknown columns are left out.

    Raises:
        InputError: No column of time, none of a joint, or two that mean the same.
    """
    times = [name for key in TIME for name in names if name.strip() == key]
    if not times:
        raise InputError(
            f"has no column of time, one of {', '.join(TIME)}; its columns: {_some(names)}", file=file
        )
    found: dict[str, Key] = {}
    for name in names:
        key = _meaning(name.strip(), topics)
        if key is None:
            continue
        if key in found.values() or names.count(name) > 1:
            raise InputError(f"there are two columns of {key[1]}", file=file, joint=key[0], quantity=name)
        found[name] = key
    if not found:
        raise InputError(
            "has no column of a joint: <joint>/command, <joint>/effort, <joint>/position, <joint>/velocity; "
            f"its columns: {_some(names)}",
            file=file,
        )
    return times[0], found


def _meaning(name: str, topics: Topics) -> Key | None:
    path, _, last = name.rpartition("/")
    inside = path.removeprefix("/")
    for topic, fields in topics.meaning.items():
        if inside.startswith(topic + "/"):
            quantity = fields.get(last)
            return None if quantity is None else (inside.removeprefix(topic + "/"), quantity)
    return (path, last) if path and last in QUANTITIES else None


def _some(names: Sequence[str], most: int = 8) -> str:
    shown = ", ".join(repr(name) for name in names[:most])
    return shown + (f" and {len(names) - most} more" if len(names) > most else "")


SECONDS, MICROSECONDS, NANOSECONDS = 0.1, 100.0, 1e5  # from and to which a step can only be in one unit
EPOCH = 1e9  # [s] since 1970, the year 2001; a table may stamp its rows so
LATEST = 4.1e9  # [s], the year 2099


def seconds(stamps: Floats | Ints, name: str, file: Path) -> Floats:
    """Finite stamps in seconds; since the first one where they count from 1970.

    Nanoseconds and microseconds are recognised by their size: since 1970, or by steps no other unit allows.

    Raises:
        InputError: The unit cannot be told.
    """
    first, steps = float(stamps[0]), np.abs(np.diff(stamps)).astype(float)
    steps = steps[steps > 0]
    step = float(np.median(steps)) if len(steps) else 0.0
    for scale in (1e-9, 1e-6, 1e-3, 1.0):
        if EPOCH <= first * scale <= LATEST and step * scale <= 1:
            return np.asarray((stamps - stamps[0]) * scale, float)  # whole numbers: the difference is exact
    scale = 1.0 if step <= SECONDS else 1e-9 if step >= NANOSECONDS else 1e-6
    if SECONDS < step < MICROSECONDS:
        raise InputError(
            f"steps by {step:g}: seconds or milliseconds? give it in s (a log takes at least 10 samples a "
            "second), or in whole us or ns",
            file=file,
            quantity=f"{name} [s]",
        )
    return np.asarray(stamps * scale, float)


def table(log: Log) -> tuple[list[str], Floats]:
    """Names and values of a log's columns, (t, 1 + columns); stamps rounded to whole nanoseconds."""
    names = ["time"]
    parts = [np.concatenate([segment.time for segment in log.segments]).round(9)[:, None]]
    for j, joint in enumerate(log.joints):
        for quantity in QUANTITIES:
            arrays = [
                getattr(segment, "torque" if quantity == "effort" else quantity) for segment in log.segments
            ]
            if any(array is None for array in arrays):
                continue
            column = np.concatenate([array[:, j] for array in arrays])
            if not np.isnan(column).all():
                names.append(f"{joint}/{quantity}")
                parts.append(column[:, None])
    return names, np.hstack(parts)


def check_finite(source: Source, file: Path) -> None:
    """Refuses infinite values; NaN is a missing sample.

    Raises:
        InputError: Naming the row.
    """
    for (joint, quantity), values in source.values.items():
        bad = np.flatnonzero(np.isinf(values))
        if len(bad):
            raise InputError(
                f"{source.at(int(bad[0]))}: must be finite",
                file=file,
                joint=joint,
                quantity=f"{quantity} [{UNITS[quantity]}]",
                value=math.copysign(math.inf, values[bad[0]]),
            )
