"""What a log holds, as it is, for a picture: every quantity with its own stamps, and what happened when."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dashpot.errors import InputError
from dashpot.logs import SUFFIXES, Topics, read_raw
from dashpot.logs.channels import Raw, check_finite
from dashpot.logs.mcapreader import Block, Content, Messages, decode, scan
from dashpot.logs.messages import JOINT_STATE, LOG, METADATA, START, TOPICS, Field, Level, Topic
from dashpot.logs.ros import Clock, joint_states, ros, warn_of_damage
from dashpot.logs.rosout import log_messages
from dashpot.logs.runlog import happenings
from dashpot.simulation.recording import Recording
from dashpot.support.arrays import Floats

RECORDING = ".npz"
LEARNT = {"command": "command", "effort": "torque"}  # quantities of a table that have another name here


@dataclass(frozen=True)
class Series:
    """One quantity.

    Attributes:
        time: (t,) [s].
        values: (t, n), a column per joint, NaN where there is none; or (t,).
    """

    time: Floats
    values: Floats


@dataclass(frozen=True)
class Happening:
    """A log message.

    Attributes:
        time: [s].
        level: How grave.
        text: What.
    """

    time: float
    level: Level
    text: str


@dataclass(frozen=True)
class Samples:
    """A log's content.

    Attributes:
        joints: n names.
        series: By column of `dashpot.logs.messages.COLUMNS`.
        happenings: In order of time.
        file: Where it was read from.
    """

    joints: tuple[str, ...]
    series: dict[str, Series]
    happenings: tuple[Happening, ...] = ()
    file: Path = field(default_factory=Path)

    @property
    def span(self) -> tuple[float, float]:
        """First and last stamp [s]."""
        ends = [series.time[[0, -1]] for series in self.series.values() if len(series.time)]
        return float(np.min(ends)), float(np.max(ends))

    def between(self, start: float, end: float) -> Samples:
        """What lies in a window of time [s].

        Raises:
            InputError: Nothing does.
        """
        kept = {}
        for name, one in self.series.items():
            inside = (one.time >= start) & (one.time <= end)
            if inside.any():
                kept[name] = Series(one.time[inside], one.values[inside])
        if not kept or not start < end:
            first, last = self.span
            raise InputError(
                f"must be two times within the log, {first:.4g} to {last:.4g} s",
                file=self.file,
                quantity="--window [s]",
                value=(start, end),
            )
        said = tuple(one for one in self.happenings if start <= one.time <= end)
        return replace(self, series=kept, happenings=said)

    def only(self, joints: Sequence[str]) -> Samples:
        """The joints named, in the log's order.

        Raises:
            InputError: The log has no such joint.
        """
        for joint in joints:
            if joint not in self.joints:
                raise InputError(
                    f"no such joint in the log; it has {', '.join(self.joints)}", file=self.file, joint=joint
                )
        columns = [j for j, name in enumerate(self.joints) if name in joints]
        kept = {
            name: one if one.values.ndim == 1 else Series(one.time, one.values[:, columns])
            for name, one in self.series.items()
        }
        return replace(self, joints=tuple(self.joints[j] for j in columns), series=kept)


def read_samples(path: str | Path, topics: Topics | None = None) -> Samples:
    """Reads a log or a recording; of an MCAP file that was cut off, what is whole.

    Args:
        path: ``.mcap``, ``.csv``, ``.parquet``, or a recording ``.npz`` of ``dashpot simulate``.
        topics: Names of topics; None: the usual ones.

    Raises:
        InputError: Naming file, line or message and rule.

    Warns:
        InputWarning: The file was cut off.
    """
    path, topics = Path(path), topics or Topics()
    if path.suffix.lower() == RECORDING:
        samples = _of_recording(path)
    elif path.suffix.lower() == ".mcap" and path.is_file() and path.stat().st_size:
        samples = _of_mcap(path, topics)
    elif path.suffix.lower() not in SUFFIXES:
        raise InputError(f"a log ends in {', '.join((*SUFFIXES, RECORDING))}", file=path)
    else:
        samples = _of_table(path, read_raw(path, topics))
    if not samples.series:
        raise InputError("has no samples", file=path)
    return samples


def _of_recording(path: Path) -> Samples:
    recording = Recording.load(path)
    names = {
        "position": recording.position,
        "velocity": recording.velocity,
        "torque": recording.sample,
        "reference": recording.reference,
        "command": recording.command,
        "in_effect": recording.in_effect,
        "link_position": recording.link_position,
        "link_velocity": recording.link_velocity,
        "link_torque": recording.torque,
    }
    series = {name: Series(recording.time, values) for name, values in names.items()}
    said = tuple(Happening(*one) for one in happenings(recording.settings))
    if recording.diverged_at is not None:
        said = (*said, Happening(recording.diverged_at, "error", "the simulation diverged"))
    return Samples(recording.joints, series, said, path)


def _of_table(path: Path, raw: Raw) -> Samples:
    joints = tuple(dict.fromkeys(joint for source in raw.sources for joint, _ in source.values))
    series = {}
    for source in raw.sources:
        check_finite(source, path)
        for quantity in dict.fromkeys(quantity for _, quantity in source.values):
            values = np.full((len(source.time), len(joints)), np.nan)
            for j, joint in enumerate(joints):
                if (joint, quantity) in source.values:
                    values[:, j] = source.values[joint, quantity]
            there = ~np.isnan(values).all(1)  # a table may have rows of several topics
            if there.any():
                series[LEARNT.get(quantity, quantity)] = Series(source.time[there], values[there])
    return Samples(joints, series, (), path)


def _of_mcap(path: Path, topics: Topics) -> Samples:
    ros()
    content = scan(path)
    warn_of_damage(path, content)
    found = _decoded(path, content, topics)
    if not found:
        raise InputError(
            f"has no joint states on {topics.states}; its topics: {', '.join(sorted(content.topics))}; "
            "choose with --states, --commands and --links",
            file=path,
        )
    clock = Clock([(messages, blocks) for _, messages, blocks in found])
    joints = tuple(dict.fromkeys(name for _, _, blocks in found for block in blocks for name in block.names))
    series = {}
    start = _start(content)
    for topic, messages, blocks in found:
        time = clock.seconds(messages, blocks) + start
        for item in topic.fields:
            values = _column(item, blocks, joints, len(time))
            if item.column and values is not None:
                series[item.column] = Series(time, values)
    said = []
    for messages in content.topics.values():
        if messages.kind == LOG and messages.encoding == "cdr":
            for stamp, level, text in log_messages(messages):
                said.append(Happening((stamp - clock.origin) / 1e9 + start, level, text))
    return Samples(joints, series, tuple(sorted(said, key=lambda one: one.time)), path)


def _start(content: Content) -> float:
    """What a simulator called the time that is stamped 0 [s]."""
    try:
        start = float(content.metadata.get(METADATA, {}).get(START, "0"))
    except ValueError:
        return 0.0
    return start if math.isfinite(start) else 0.0


def _decoded(path: Path, content: Content, topics: Topics) -> list[tuple[Topic, Messages, list[Block]]]:
    """Topics that are known and have messages; those of dashpot's own types only as dashpot defines them."""
    renamed = {
        "/joint_states": topics.states,
        "/joint_command": topics.commands,
        "/link_states": topics.links,
    }
    found = []
    for topic in TOPICS:
        wanted = renamed.get(topic.name, topic.name).strip("/")
        for name, messages in content.topics.items():
            if name.strip("/") != wanted or not messages.payloads or messages.encoding != "cdr":
                continue
            if topic.type == JOINT_STATE and messages.kind in (JOINT_STATE, "sensor_msgs/JointState"):
                found.append((topic, messages, joint_states(path, name, messages)))
            elif messages.kind == topic.type and messages.definition == topic.definition:
                found.append((topic, messages, decode(messages.payloads, topic.fields, name, path)))
    return found


def _column(
    item: Field, blocks: Sequence[Block], joints: tuple[str, ...], count: int
) -> NDArray[np.float64] | None:
    """A field of all messages, (t, n) or (t,); None where no message has it."""
    if item.scalar:
        values = np.zeros(count)
        for block in blocks:
            values[block.rows] = block.arrays[item.name]
        return values
    values = np.full((count, len(joints)), np.nan)
    there = False
    for block in blocks:
        if block.arrays[item.name].shape[1] == len(block.names) and block.names:
            places = np.array([joints.index(name) for name in block.names])
            values[block.rows[:, None], places] = block.arrays[item.name]
            there = True
    return values if there else None
