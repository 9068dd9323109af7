"""CDR, the bytes of a ROS 2 message, for messages whose layout does not change from one to the next.

Names of joints are fixed, so every message of a topic has its numbers at the same places: a template with
gaps. A row of templates, one per topic, is one tick of a log, and NumPy fills the gaps of many ticks at once.
Little endian; a number of k bytes begins at a multiple of k after the encapsulation header, and an empty
array has no padding after its length, as in ROS 2's own middlewares.
"""

from __future__ import annotations

import struct
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dashpot.logs.messages import Topic

ENCAPSULATION = b"\x00\x01\x00\x00"  # plain CDR, little endian
MESSAGE = struct.Struct("<BQHIQQ")  # of MCAP: opcode, length, channel, sequence, log time, publish time
OPCODE = 5


@dataclass
class Cdr:
    """Bytes of one message, and where its gaps are.

    Attributes:
        data: The template, encapsulation header first.
        gaps: Name to format and offset.
    """

    data: bytearray = field(default_factory=lambda: bytearray(ENCAPSULATION))
    gaps: dict[str, tuple[object, int]] = field(default_factory=dict)

    def align(self, size: int) -> None:
        """Pads to a multiple of ``size`` bytes."""
        self.data += bytes(-(len(self.data) - len(ENCAPSULATION)) % size)

    def count(self, value: int) -> None:
        """A uint32, among others the length of an array."""
        self.align(4)
        self.data += struct.pack("<I", value)

    def string(self, text: str) -> None:
        """With its length and a final zero."""
        raw = text.encode()
        self.count(len(raw) + 1)
        self.data += raw + b"\0"

    def gap(self, name: str, kind: str, count: int | None = None) -> None:
        """Leaves room for one number, or for ``count`` of them."""
        dtype = np.dtype(kind).newbyteorder("<")
        self.align(dtype.itemsize)
        self.gaps[name] = (dtype if count is None else (dtype, (count,)), len(self.data))
        self.data += bytes(dtype.itemsize * (1 if count is None else count))


def joint_message(topic: Topic, joints: Sequence[str], columns: Collection[str]) -> Cdr:
    """The template of a topic's messages; gaps: sec, nanosec and the columns."""
    cdr = Cdr()
    cdr.gap("sec", "i4")
    cdr.gap("nanosec", "u4")
    cdr.string("")
    named = False
    for item in topic.fields:
        if item.scalar:
            cdr.gap(item.column, item.kind)
            continue
        if not named:
            cdr.count(len(joints))
            for joint in joints:
                cdr.string(joint)
            named = True
        if item.column in columns:
            cdr.count(len(joints))
            cdr.gap(item.column, item.kind, len(joints))
        else:
            cdr.count(0)
    return cdr


@dataclass(frozen=True)
class Row:
    """One tick of a log: an MCAP message record per topic, one after the other.

    Attributes:
        template: (size,) bytes.
        dtype: Of the gaps in it; the fields of topic i are called ``name@i``.
        starts: Topic's channel id to the offset of its record.
        slots: Column to its field.
    """

    template: NDArray[np.uint8]
    dtype: np.dtype[np.void]
    starts: dict[int, int]
    slots: dict[str, str]


def tick_row(messages: Sequence[tuple[int, Cdr]]) -> Row:
    """Puts the messages of one tick, (channel id, template), one after the other."""
    data = bytearray()
    names: list[str] = []
    formats: list[object] = []
    offsets: list[int] = []
    starts: dict[int, int] = {}
    slots: dict[str, str] = {}
    for i, (channel, cdr) in enumerate(messages):
        start = starts[channel] = len(data)
        data += MESSAGE.pack(OPCODE, MESSAGE.size - 9 + len(cdr.data), channel, 0, 0, 0)
        for name, kind, offset in (("sequence", "<u4", 11), ("log", "<u8", 15), ("publish", "<u8", 23)):
            names.append(f"{name}@{i}")
            formats.append(kind)
            offsets.append(start + offset)
        for name, (dtype, offset) in cdr.gaps.items():
            names.append(f"{name}@{i}")
            formats.append(dtype)
            offsets.append(start + MESSAGE.size + offset)
            slots[name] = f"{name}@{i}"
        data += cdr.data
    slots.pop("sec", None)
    slots.pop("nanosec", None)
    dtype = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": len(data)})
    return Row(np.frombuffer(bytes(data), np.uint8), dtype, starts, slots)
