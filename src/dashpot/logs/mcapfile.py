"""The container of an MCAP log: channels, compressed chunks with their index, and the summary at the end."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dashpot.logs.mcapreader import MAGIC, package
from dashpot.logs.messages import METADATA

LARGEST = 1 << 22  # [bytes] of a chunk before compression
HEADER, FOOTER, SCHEMA, CHANNEL, CHUNK, MESSAGE_INDEX = 1, 2, 3, 4, 6, 7
CHUNK_INDEX, STATISTICS, METADATA_RECORD, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = 8, 11, 12, 13, 14, 15
ENTRY = np.dtype([("time", "<u8"), ("offset", "<u8")])  # of a message index


class McapFile:
    """A file that is written from front to back; every chunk in it is whole on its own.

    Attributes:
        counts: Messages of each channel so far.
    """

    def __init__(self, path: Path, metadata: Mapping[str, str]) -> None:
        """Begins the file; one that is there is overwritten.

        Raises:
            DashpotError: zstandard is not installed.
            OSError: The file cannot be written.
        """
        self._compressor = package("zstandard").ZstdCompressor(level=1)
        self._error: OSError | None = None
        self._position = 0  # in the file
        self._schemas: dict[str, tuple[int, bytes]] = {}
        self._channels: dict[int, bytes] = {}
        self.counts: dict[int, int] = {}
        self._span: list[int] = []
        self._chunk_indexes: list[bytes] = []
        self._empty()
        meta = _record(METADATA_RECORD, _text(METADATA) + _map(metadata))
        begin = MAGIC + _record(HEADER, _text("ros2") + _text(f"dashpot {version('dashpot')}"))
        self._metadata = (len(begin), len(meta))
        self._file = path.open("wb", buffering=0)
        try:
            self._put(begin + meta)
        except OSError:
            self._file.close()
            raise

    def check(self) -> None:
        """Raises what went wrong before, if anything did: what follows on half a record cannot be read."""
        if self._error is not None:
            raise self._error

    def close(self) -> None:
        """Closes the file as it is."""
        self._file.close()

    def channel(self, topic: str, kind: str, definition: str) -> int:
        """Registers a topic with the definition of its messages; returns its number."""
        known = self._schemas.get(kind)
        if known is None:
            number = len(self._schemas) + 1
            content = struct.pack("<H", number) + _text(kind) + _text("ros2msg") + _text(definition)
            known = self._schemas[kind] = (number, _record(SCHEMA, content))
            self._put(known[1])
        channel = len(self._channels) + 1
        content = struct.pack("<HH", channel, known[0]) + _text(topic) + _text("cdr") + _map({})
        self._channels[channel] = _record(CHANNEL, content)
        self.counts[channel] = 0
        self._put(self._channels[channel])
        return channel

    def append(self, data: bytes, stamps: NDArray[np.int64], starts: Mapping[int, int], stride: int) -> None:
        """Adds records to the chunk; a channel's begin at its start, then every ``stride`` bytes."""
        for channel, start in starts.items():
            entries = np.empty(len(stamps), ENTRY)
            entries["time"] = stamps
            entries["offset"] = self._size + start + stride * np.arange(len(stamps))
            self._entries.setdefault(channel, []).append(entries)
            self.counts[channel] += len(stamps)
        self._parts.append(data)
        self._size += len(data)
        if self._size >= LARGEST:
            self.end_chunk()

    def end_chunk(self) -> None:
        """Compresses what has been added and writes it."""
        if not self._parts:
            return
        plain = b"".join(self._parts)
        entries = {channel: np.concatenate(parts) for channel, parts in self._entries.items()}
        first = min(int(e["time"].min()) for e in entries.values())
        last = max(int(e["time"].max()) for e in entries.values())
        packed = self._compressor.compress(plain)
        span = struct.pack("<QQ", first, last)
        crc = zlib.crc32(plain)
        chunk = _record(
            CHUNK,
            span
            + struct.pack("<QI", len(plain), crc)
            + _text("zstd")
            + struct.pack("<Q", len(packed))
            + packed,
        )
        begin, offsets, indexes = self._position, [], []
        place = begin + len(chunk)
        for channel, rows in entries.items():
            offsets.append(struct.pack("<HQ", channel, place))
            raw = rows.tobytes()
            indexes.append(_record(MESSAGE_INDEX, struct.pack("<HI", channel, len(raw)) + raw))
            place += len(indexes[-1])
        where = b"".join(offsets)
        self._chunk_indexes.append(
            _record(
                CHUNK_INDEX,
                span
                + struct.pack("<QQI", begin, len(chunk), len(where))
                + where
                + struct.pack("<Q", place - begin - len(chunk))
                + _text("zstd")
                + struct.pack("<QQ", len(packed), len(plain)),
            )
        )
        self._span = (
            [min(first, *self._span[:1]), max(last, *self._span[1:])] if self._span else [first, last]
        )
        self._empty()
        self._put(b"".join([chunk, *indexes]))

    def finish(self) -> None:
        """Writes the end of the data, and the summary that lets readers seek."""
        end = _record(DATA_END, struct.pack("<I", 0))
        summary_start = self._position + len(end)
        counts = b"".join(struct.pack("<HQ", channel, count) for channel, count in self.counts.items())
        statistics = struct.pack(
            "<QHIIIIQQI",
            sum(self.counts.values()),
            len(self._schemas),
            len(self._channels),
            0,
            1,
            len(self._chunk_indexes),
            *(self._span or (0, 0)),
            len(counts),
        )
        groups = (
            (SCHEMA, b"".join(record for _, record in self._schemas.values())),
            (CHANNEL, b"".join(self._channels.values())),
            (STATISTICS, _record(STATISTICS, statistics + counts)),
            (CHUNK_INDEX, b"".join(self._chunk_indexes)),
            (METADATA_INDEX, _record(METADATA_INDEX, struct.pack("<QQ", *self._metadata) + _text(METADATA))),
        )
        body, offsets, place = b"", b"", summary_start
        for opcode, group in groups:
            if group:
                offsets += _record(SUMMARY_OFFSET, struct.pack("<BQQ", opcode, place, len(group)))
            body += group
            place += len(group)
        foot = struct.pack("<BQQQ", FOOTER, 20, summary_start, place)
        crc = zlib.crc32(body + offsets + foot)
        self._put(end + body + offsets + foot + struct.pack("<I", crc) + MAGIC)

    def _empty(self) -> None:
        self._parts: list[bytes] = []
        self._size = 0
        self._entries: dict[int, list[NDArray[np.void]]] = {}

    def _put(self, data: bytes) -> None:
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[self._file.write(rest) :]
        except OSError as error:  # what follows on half a record could not be read: every later call says so
            self._error = error
            raise
        self._position += len(data)


def _record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def _text(text: str) -> bytes:
    raw = text.encode()
    return struct.pack("<I", len(raw)) + raw


def _map(items: Mapping[str, str]) -> bytes:
    raw = b"".join(_text(key) + _text(value) for key, value in items.items())
    return struct.pack("<I", len(raw)) + raw
