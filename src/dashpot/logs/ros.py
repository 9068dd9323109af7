"""Logs as MCAP: ROS 2 sensor_msgs/msg/JointState messages (CDR)."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from dashpot.errors import InputError, InputWarning
from dashpot.logs.channels import EPOCH, Ints, Key, Raw, Source, Topics
from dashpot.logs.log import Log
from dashpot.logs.mcapreader import Block, Content, Messages, decode, package, scan
from dashpot.logs.mcapwriter import NANO, McapWriter
from dashpot.logs.messages import JOINT_STATE, METADATA, TOPICS
from dashpot.support.arrays import Floats

FIELDS = next(topic.fields for topic in TOPICS if topic.type == JOINT_STATE)


def ros() -> None:
    """Checks that MCAP logs can be read and written.

    Raises:
        DashpotError: A package is not installed.
    """
    package("zstandard")


def read_mcap(path: Path, topics: Topics) -> Raw:
    """Reads the joint states of an MCAP file.

    Raises:
        InputError: Naming file, topic, message and rule.

    Warns:
        InputWarning: The file was cut off or is damaged; what is whole of it is used.
    """
    ros()
    content = scan(path, topics.meaning)
    _check_topics(path, content, topics)
    warn_of_damage(path, content)
    sources = joint_sources(path, content, topics)
    return Raw(sources, content.metadata.get(METADATA, {}).get("sampling"))


def warn_of_damage(path: Path, content: Content) -> None:
    """Says what is missing of a file.

    Warns:
        InputWarning: Something is.
    """
    if content.cut:
        warnings.warn(
            f"{path}: was cut off, as by a crash; every whole chunk of it is used", InputWarning, stacklevel=4
        )
    if content.damaged:
        warnings.warn(
            f"{path}: {content.damaged} damaged records left out; the rest is used",
            InputWarning,
            stacklevel=4,
        )


def joint_sources(path: Path, content: Content, topics: Topics) -> list[Source]:
    """Joint states of the topics that are there, on one clock.

    Raises:
        InputError: Naming topic, message and rule; or there are no messages.
    """
    found = []
    for topic, meaning in topics.meaning.items():
        for name, messages in content.topics.items():
            if name.strip("/") == topic and messages.payloads:
                found.append((f"/{topic}", meaning, messages, joint_states(path, f"/{topic}", messages)))
    if not found:
        raise InputError("its topics of joint states have no messages", file=path)
    clock = Clock([(messages, blocks) for _, _, messages, blocks in found])
    return [
        _source(name, meaning, blocks, clock.seconds(messages, blocks))
        for name, meaning, messages, blocks in found
    ]


class Clock:
    """One clock for all topics: the headers' stamps, or the recorder's where some topic's carry none."""

    def __init__(self, topics: list[tuple[Messages, list[Block]]]) -> None:
        self.stamped = all(any(block.stamps.any() for block in blocks) for _, blocks in topics)
        origin = min(int(self._stamps(*topic).min()) for topic in topics)
        self.origin = origin if origin >= EPOCH * NANO else 0  # [ns], where they count from 1970

    def _stamps(self, messages: Messages, blocks: list[Block]) -> Ints:
        if not self.stamped:
            return np.array(messages.logged, np.uint64).astype(np.int64)
        stamps = np.zeros(len(messages.payloads), np.int64)
        for block in blocks:
            stamps[block.rows] = block.stamps
        return stamps

    def seconds(self, messages: Messages, blocks: list[Block]) -> Floats:
        """Stamps of a topic's messages, (t,) [s]."""
        return np.asarray((self._stamps(messages, blocks) - self.origin) / NANO)


def joint_states(path: Path, topic: str, messages: Messages) -> list[Block]:
    """Decodes JointState messages and checks them.

    Raises:
        InputError: An array does not fit the names, or a joint is named twice; naming the message.
    """
    blocks = decode(messages.payloads, FIELDS, topic, path)
    for block in sorted(blocks, key=lambda block: int(block.rows[0])):
        number = block.rows[0] + 1
        for name, values in block.arrays.items():
            if values.shape[1] not in (0, len(block.names)):
                raise InputError(
                    f"message {number} of {topic}: has {len(block.names)} names but {values.shape[1]} values",
                    file=path,
                    quantity=name,
                )
        if len(set(block.names)) < len(block.names):
            raise InputError(f"message {number} of {topic}: a joint is named twice", file=path)
    return blocks


def _source(topic: str, meaning: dict[str, str], blocks: list[Block], time: Floats) -> Source:
    """By joint and quantity; messages may name their joints in any order, or leave some out."""
    values: dict[Key, Floats] = {}
    for block in sorted(blocks, key=lambda block: int(block.rows[0])):
        for field, quantity in meaning.items():
            for column, joint in enumerate(block.names if block.arrays[field].size else ()):
                into = values.setdefault((joint, quantity), np.full(len(time), np.nan))
                into[block.rows] = block.arrays[field][:, column]
    return Source(f"message of {topic}", np.arange(1, len(time) + 1), time, values)


def _check_topics(path: Path, content: Content, topics: Topics) -> None:
    """The topics that are needed are there, and their messages are joint states."""
    seen = content.topics
    present = {topic.strip("/") for topic in seen}
    for topic, fields in topics.meaning.items():
        if topic not in present and "effort" in fields:
            raise InputError(
                f"has no topic /{topic}; its topics: {', '.join(sorted(seen)) or 'none'}; choose with "
                "--states and --commands",
                file=path,
            )
    for topic, messages in seen.items():
        if topic.strip("/") not in topics.meaning:
            continue
        if messages.kind not in (JOINT_STATE, "sensor_msgs/JointState") or messages.encoding != "cdr":
            said = messages.kind if messages.encoding == "cdr" else f"{messages.encoding} messages"
            raise InputError(f"topic {topic}: must carry {JOINT_STATE}, not {said}", file=path)


def write_mcap(log: Log, path: Path) -> None:
    """Writes a log: one message per topic and sample, stamped from 0 s on."""
    begin = min(0.0, float(log.segments[0].time[0]))  # stamps are not negative
    with McapWriter(path, log.joints, period=log.period, metadata={"sampling": log.sampling}) as writer:
        present = [
            name
            for name in ("position", "velocity", "torque", "command", "link_position")
            if any(getattr(segment, name) is not None for segment in log.segments)
        ]
        for segment in log.segments:
            stamps = np.rint((segment.time - begin) * NANO).astype(np.int64)
            columns = {}
            for name in present:
                values = getattr(segment, name)
                columns[name] = np.full_like(segment.command, np.nan) if values is None else values
            writer.write(stamps, columns)
