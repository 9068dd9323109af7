"""MCAP files, whole or cut off: every message of every whole chunk, read from the front without an index.

Readers that seek need the index a file ends with. A log of a program that was killed has none, and what it
does have is good: records are read one after the other up to the first that is not whole. A chunk whose
checksum is wrong is left out.
"""

from __future__ import annotations

import mmap
import struct
import zlib
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dashpot.errors import DashpotError, InputError
from dashpot.logs.cdr import MESSAGE
from dashpot.logs.messages import Field
from dashpot.support.arrays import Floats
from dashpot.support.installing import install

MAGIC = b"\x89MCAP0\r\n"
RECORD = struct.Struct("<BQ")
SCHEMA, CHANNEL, MESSAGE_OPCODE, CHUNK, METADATA, DATA_END, FOOTER = 3, 4, 5, 6, 12, 15, 2
LARGEST = 1 << 32  # [bytes] of a chunk: more can only be damage
NANO = 1_000_000_000


@dataclass
class Messages:
    """What one topic carries.

    Attributes:
        kind: Name of the message type.
        definition: Its text.
        encoding: Of the messages: "cdr" for ROS 2.
        logged: Log times [ns].
        payloads: The messages' bytes.
    """

    kind: str
    definition: str
    encoding: str
    logged: list[int] = field(default_factory=list)
    payloads: list[bytes] = field(default_factory=list)


@dataclass
class Content:
    """What a file holds.

    Attributes:
        topics: By name, in the order in which the file names them.
        metadata: By name of the record.
        cut: Whether it ends without the end of its data.
        damaged: Chunks left out.
    """

    topics: dict[str, Messages] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    cut: bool = False
    damaged: int = 0


class _Cursor:
    """Reads the parts of a record; struct.error where it is too short."""

    def __init__(self, data: Any, position: int = 0) -> None:
        self.data, self.position = data, position

    def number(self, kind: str) -> int:
        (value,) = struct.unpack_from(f"<{kind}", self.data, self.position)
        self.position += struct.calcsize(f"<{kind}")
        return int(value)

    def raw(self, length: int) -> bytes:
        part = bytes(self.data[self.position : self.position + length])
        if len(part) < length:
            raise struct.error("too short")
        self.position += length
        return part

    def text(self) -> str:
        return self.raw(self.number("I")).decode()

    def map(self) -> dict[str, str]:
        end = self.number("I") + self.position
        items = {}
        while self.position < end:
            key = self.text()
            items[key] = self.text()
        return items


class _Scan:
    def __init__(self, wanted: Collection[str] | None) -> None:
        self.content, self.wanted = Content(), wanted
        self.schemas: dict[int, tuple[str, str]] = {0: ("no schema", "")}
        self.channels: dict[int, Messages | None] = {}

    def record(self, opcode: int, data: bytes) -> None:
        cursor = _Cursor(data)
        if opcode == SCHEMA:
            number, name, _, text = cursor.number("H"), cursor.text(), cursor.text(), cursor.text()
            self.schemas[number] = (name, text)
        elif opcode == CHANNEL:
            number, schema, topic, encoding = (
                cursor.number("H"),
                cursor.number("H"),
                cursor.text(),
                cursor.text(),
            )
            named = self.content.topics.setdefault(
                topic, Messages(*self.schemas.get(schema, self.schemas[0]), encoding)
            )
            read = self.wanted is None or topic.strip("/") in self.wanted
            self.channels[number] = named if read else None
        elif opcode == METADATA:
            name = cursor.text()
            self.content.metadata[name] = cursor.map()
        elif opcode == MESSAGE_OPCODE:
            channel, _, logged, _ = struct.unpack_from("<HIQQ", data)
            self.message(channel, logged, data[22:])

    def message(self, channel: int, logged: int, payload: bytes) -> None:
        into = self.channels.get(channel)
        if into is not None:
            into.logged.append(logged)
            into.payloads.append(payload)

    def chunk(self, data: bytes) -> None:
        """Records of a chunk: all of them, or none where it is damaged."""
        plain = _plain(data)
        position, size = 0, len(plain)
        while position < size:  # checks the frame first, so that half a chunk never counts
            _, length = RECORD.unpack_from(plain, position)
            position += RECORD.size + length
        if position != size:
            raise ValueError("records do not fill the chunk")
        position = 0
        while position < size:
            opcode, length = RECORD.unpack_from(plain, position)
            end = position + RECORD.size + length
            if opcode == MESSAGE_OPCODE:
                _, _, channel, _, logged, _ = MESSAGE.unpack_from(plain, position)
                if self.channels.get(channel) is not None:
                    self.message(channel, logged, plain[position + MESSAGE.size : end])
            else:
                self.record(opcode, plain[position + RECORD.size : end])
            position = end


def _plain(data: bytes) -> bytes:
    """Uncompressed records of a chunk; ValueError where it is damaged."""
    cursor = _Cursor(data, 16)
    size, crc, compression = cursor.number("Q"), cursor.number("I"), cursor.text()
    packed = cursor.raw(cursor.number("Q"))
    if size > LARGEST:
        raise ValueError("too large")
    if compression == "zstd":
        zstandard = package("zstandard")
        if zstandard.frame_content_size(packed) not in (-1, size):
            raise ValueError("two sizes")
        plain = zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)
    elif compression == "lz4":
        plain = package("lz4.frame").decompress(packed)
    elif compression == "":
        plain = packed
    else:
        raise ValueError(f"compression {compression!r}")
    if len(plain) != size or (crc and zlib.crc32(plain) != crc):
        raise ValueError("checksum")
    return bytes(plain)


def package(name: str) -> Any:
    """A package of the extra "logs".

    Raises:
        DashpotError: It is not installed.
    """
    import importlib

    try:
        return importlib.import_module(name)
    except ImportError:
        said = name.partition(".")[0]
        raise DashpotError(f"MCAP logs need {said}: {install('logs')}") from None


def scan(path: Path, wanted: Collection[str] | None = None) -> Content:
    """Reads a file from its front to its end, or to where it was cut off.

    Args:
        path: The file.
        wanted: Topics, without outer slashes, whose messages are kept; None: all.

    Raises:
        InputError: It is no MCAP file, or not one whole record is left of it.
        DashpotError: A package that unpacks it is not installed.
    """
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
        size = len(data)
        if data[: len(MAGIC)] != MAGIC[:size]:
            raise InputError("not an MCAP file: it does not begin like one", file=path)
        found, position, whole = _Scan(wanted), len(MAGIC), False
        while not whole:
            if size - position < RECORD.size:
                break
            opcode, length = RECORD.unpack_from(data, position)
            if opcode == 0 or length > size - position - RECORD.size:
                break
            position += RECORD.size
            if opcode in (DATA_END, FOOTER):
                whole = True
            elif opcode in (SCHEMA, CHANNEL, MESSAGE_OPCODE, CHUNK, METADATA):
                record = data[position : position + length]
                try:
                    if opcode == CHUNK:
                        found.chunk(record)
                    else:
                        found.record(opcode, record)
                except (DashpotError, MemoryError):
                    raise
                except Exception:  # what the unpackers of a damaged chunk raise is their own
                    found.content.damaged += 1
            position += length
        found.content.cut = not whole
    if not found.content.topics:
        raise InputError(
            "has no topics" if whole else "not a whole MCAP file: it was cut off before its first topic",
            file=path,
        )
    return found.content


@dataclass(frozen=True)
class Block:
    """Messages of one layout.

    Attributes:
        rows: (r,) which of the topic's messages they are, from 0.
        stamps: (r,) of their headers [ns].
        names: Of their joints.
        arrays: Field to (r, its length), or (r,) for a single number.
    """

    rows: NDArray[np.intp]
    stamps: NDArray[np.int64]
    names: tuple[str, ...]
    arrays: dict[str, Floats]


def decode(payloads: Sequence[bytes], fields: Sequence[Field], topic: str, file: Path) -> list[Block]:
    """Decodes messages that begin with a header: single numbers, then names of joints, then arrays.

    Messages of one length whose names and lengths are the same bytes are taken apart together.

    Raises:
        InputError: A message is too short, or is not CDR; naming it.
    """
    lengths = np.array([len(payload) for payload in payloads])
    blocks = []
    for length in np.unique(lengths):
        left = np.flatnonzero(lengths == length)
        table = np.frombuffer(b"".join(payloads[i] for i in left.tolist()), np.uint8).reshape(len(left), -1)
        while len(left):
            try:
                order, names, places = _layout(table[0].tobytes(), fields)
            except (struct.error, UnicodeDecodeError, ValueError):
                raise InputError(
                    f"message {left[0] + 1} of {topic}: is not a whole message of its type", file=file
                ) from None
            fixed = np.ones(table.shape[1], bool)
            fixed[4:12] = False
            for offset, count, dtype, _ in places.values():
                fixed[offset : offset + count * dtype.itemsize] = False
            alike = (table[:, fixed] == table[0, fixed]).all(1)
            one = table[alike]
            stamp = np.ascontiguousarray(one[:, 4:12])
            seconds = stamp[:, :4].copy().view(f"{order}i4")[:, 0].astype(np.int64)
            rest = stamp[:, 4:].copy().view(f"{order}u4")[:, 0].astype(np.int64)
            arrays = {}
            for name, (offset, count, dtype, scalar) in places.items():
                part = np.ascontiguousarray(one[:, offset : offset + count * dtype.itemsize])
                values = part.view(dtype).astype(float) if count else np.zeros((len(one), 0))
                arrays[name] = values[:, 0] if scalar else values
            blocks.append(Block(left[alike], NANO * seconds + rest, names, arrays))
            left, table = left[~alike], table[~alike]
    return blocks


_Places = dict[str, tuple[int, int, np.dtype[Any], bool]]


def _layout(data: bytes, fields: Sequence[Field]) -> tuple[str, tuple[str, ...], _Places]:
    """Byte order, names of joints, and offset, length, type of each field of one message."""
    if data[:2] not in (b"\x00\x00", b"\x00\x01"):
        raise ValueError("not plain CDR")
    order = "<" if data[1] else ">"
    position = 12

    def align(size: int) -> None:
        nonlocal position
        position += -(position - 4) % size

    def count() -> int:
        nonlocal position
        align(4)
        (value,) = struct.unpack_from(f"{order}I", data, position)
        position += 4
        return int(value)

    def string() -> str:
        nonlocal position
        length = count()
        raw = data[position : position + length]
        if len(raw) < length:
            raise ValueError("too short")
        position += length
        return raw.rstrip(b"\0").decode()

    string()
    names: tuple[str, ...] | None = None
    places: _Places = {}
    for item in fields:
        dtype = np.dtype(item.kind).newbyteorder("<" if order == "<" else ">")
        if item.scalar:
            align(dtype.itemsize)
            places[item.name] = (position, 1, dtype, True)
            position += dtype.itemsize
        else:
            if names is None:
                names = tuple(string() for _ in range(_at_most(count(), len(data))))
            length = _at_most(count(), len(data))
            if length:
                align(dtype.itemsize)
            places[item.name] = (position, length, dtype, False)
            position += length * dtype.itemsize
        if position > len(data):
            raise ValueError("too short")
    return order, names or (), places


def _at_most(count: int, most: int) -> int:
    if count > most:
        raise ValueError("too short")
    return count
