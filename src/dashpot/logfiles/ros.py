"""Logs as MCAP: ROS 2 sensor_msgs/msg/JointState messages (CDR)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from dashpot.errors import DashpotError, InputError
from dashpot.log import Log
from dashpot.logfiles.channels import EPOCH, Ints, Key, Raw, Source, Topics
from dashpot.sampled import Floats

TYPE = "sensor_msgs/msg/JointState"
METADATA = "dashpot"  # name of the record that says how torque was sampled
NANO = 1_000_000_000
DEFINITION = f"""std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
{"=" * 80}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{"=" * 80}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""


def ros() -> tuple[Any, Any, Any]:
    """mcap.reader, mcap_ros2.decoder and mcap_ros2.writer.

    Raises:
        DashpotError: They are not installed.
    """
    try:
        import mcap.reader
        import mcap_ros2.decoder
        import mcap_ros2.writer
    except ImportError:
        raise DashpotError("MCAP logs need mcap and mcap-ros2-support: pip install 'dashpot[logs]'") from None
    return mcap.reader, mcap_ros2.decoder, mcap_ros2.writer


@dataclass
class _Channel:
    """What one topic has said so far."""

    topic: str
    fields: dict[str, str]
    stamps: list[int] = field(default_factory=list)  # [ns]
    logged: list[int] = field(default_factory=list)  # [ns]
    layouts: list[tuple[str, ...]] = field(default_factory=list)  # joint names, message by message
    data: dict[str, list[Any]] = field(default_factory=dict)

    def take(self, message: Any, logged: int, file: Path) -> None:
        number = len(self.stamps) + 1
        names = tuple(message.name)
        for name, array in ((f, getattr(message, f)) for f in self.fields):
            if len(array) not in (0, len(names)):
                raise InputError(
                    f"message {number} of {self.topic}: has {len(names)} names but {len(array)} values",
                    file=file,
                    quantity=name,
                )
            self.data.setdefault(name, []).append(array)
        if len(set(names)) < len(names):
            raise InputError(f"message {number} of {self.topic}: a joint is named twice", file=file)
        if self.layouts and self.layouts[-1] == names:
            names = self.layouts[-1]  # one tuple for all
        self.layouts.append(names)
        self.stamps.append(message.header.stamp.sec * NANO + message.header.stamp.nanosec)
        self.logged.append(logged)

    def source(self, origin: int, stamps: Ints) -> Source:
        """By joint and quantity; messages may name their joints in any order, or leave some out."""
        count = len(self.stamps)
        values: dict[Key, Floats] = {}
        start = 0
        while start < count:  # runs of messages of one layout
            names, end = self.layouts[start], start + 1
            while end < count and self.layouts[end] is names:
                end += 1
            for name, quantity in self.fields.items():
                rows = self.data[name][start:end]
                full = [i for i, row in enumerate(rows) if len(row)]
                if full and names:
                    block = np.array([rows[i] for i in full], float)
                    for column, joint in enumerate(names):
                        into = values.setdefault((joint, quantity), np.full(count, np.nan))
                        into[start + np.array(full)] = block[:, column]
            start = end
        return Source(f"message of {self.topic}", np.arange(1, count + 1), (stamps - origin) / NANO, values)


def read_mcap(path: Path, topics: Topics) -> Raw:
    """Reads the joint states of an MCAP file.

    Raises:
        InputError: Naming file, topic, message and rule.
    """
    channels = {topic: _Channel("/" + topic, dict(fields)) for topic, fields in topics.meaning.items()}
    seen: dict[str, str] = {}
    sampling = None
    reader_module, decoder, _ = ros()
    try:
        with path.open("rb") as stream:
            reader = reader_module.make_reader(stream, decoder_factories=[decoder.DecoderFactory()])
            summary = reader.get_summary()
            known = {} if summary is None else summary.channels
            for channel in known.values():
                schema = summary.schemas.get(channel.schema_id)
                seen[channel.topic] = schema.name if schema else "no schema"
            _check_topics(path, seen, channels)
            for record in reader.iter_metadata():
                if record.name == METADATA:
                    sampling = record.metadata.get("sampling")
            wanted = [topic for topic in seen if topic.strip("/") in channels]
            for _, channel, message, decoded in _messages(reader, wanted):
                channels[channel.topic.strip("/")].take(decoded, message.log_time, path)
    except (DashpotError, PermissionError, MemoryError):
        raise
    except Exception as error:  # the reader of a damaged file raises whatever its parts raise
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(
            f"not a whole MCAP file of ROS 2 messages: {reason[:120]}; if it was cut off, try `mcap recover`",
            file=path,
        ) from None
    return Raw(_sources(path, [c for c in channels.values() if c.stamps]), sampling)


def _messages(reader: Any, topics: list[str]) -> Iterator[Any]:
    yield from reader.iter_decoded_messages(topics=topics, log_time_order=False)


def _check_topics(path: Path, seen: dict[str, str], channels: dict[str, _Channel]) -> None:
    """The topics that are needed are there, and their messages are joint states."""
    present = {topic.strip("/") for topic in seen}
    for topic, channel in channels.items():
        if topic not in present and "effort" in channel.fields:
            raise InputError(
                f"has no topic {channel.topic}; its topics: {', '.join(sorted(seen)) or 'none'}; choose with "
                "--states and --commands",
                file=path,
            )
    for topic, kind in seen.items():
        if topic.strip("/") in channels and kind not in (TYPE, "sensor_msgs/JointState"):
            raise InputError(f"topic {topic}: must carry {TYPE}, not {kind}", file=path)


def _sources(path: Path, channels: list[_Channel]) -> list[Source]:
    """Sources on one clock: the headers', or the recorder's where headers carry no stamp."""
    if not channels:
        raise InputError("its topics of joint states have no messages", file=path)
    stamped = all(any(channel.stamps) for channel in channels)
    lists = [np.array(channel.stamps if stamped else channel.logged, np.int64) for channel in channels]
    origin = min(int(stamps.min()) for stamps in lists)
    if origin < EPOCH * NANO:  # not since 1970
        origin = 0
    return [channel.source(origin, stamps) for channel, stamps in zip(channels, lists, strict=True)]


def write_mcap(log: Log, path: Path) -> None:
    """Writes a log: one message per topic and sample, stamped from 0 s on."""
    _, _, writer_module = ros()
    begin = min(0.0, float(log.segments[0].time[0]))  # stamps are not negative
    with path.open("wb") as stream:
        writer = writer_module.Writer(stream)
        schema = writer.register_msgdef(TYPE, DEFINITION)
        writer.add_metadata(METADATA, {"sampling": log.sampling})
        topics = Topics()
        names = list(log.joints)
        count = 0
        for segment in log.segments:
            stamps = np.rint((segment.time - begin) * NANO).astype(np.int64).tolist()
            states = {"position": segment.position, "velocity": segment.velocity, "effort": segment.torque}
            tables = [
                (topics.states, {k: v.tolist() for k, v in states.items() if v is not None}),
                (topics.commands, {"effort": segment.command.tolist()}),
            ]
            if segment.link_position is not None:
                tables.append((topics.links, {"position": segment.link_position.tolist()}))
            for i, stamp in enumerate(stamps):
                header = {"stamp": {"sec": stamp // NANO, "nanosec": stamp % NANO}, "frame_id": ""}
                for topic, arrays in tables:
                    message = {"header": header, "name": names, "position": [], "velocity": [], "effort": []}
                    message |= {key: rows[i] for key, rows in arrays.items()}
                    writer.write_message(topic, schema, message, stamp, stamp, count)
                count += 1
        writer.finish()
