"""Log messages of a ROS 2 log, rcl_interfaces/msg/Log."""

from __future__ import annotations

import struct
from collections.abc import Iterator

from dashpot.logs.mcapreader import Messages
from dashpot.logs.messages import LEVELS, Level

NAME = "dashpot"  # whose messages are kept whatever their level


def log_messages(messages: Messages) -> Iterator[tuple[int, Level, str]]:
    """Stamp [ns], level and text of dashpot's messages and of every warning and error of others."""
    for logged, payload in zip(messages.logged, messages.payloads, strict=True):
        try:
            order = "<" if payload[1] else ">"
            seconds, nanoseconds, level = struct.unpack_from(f"{order}iIB", payload, 4)
            name, end = _string(payload, 13, order)
            text, _ = _string(payload, end, order)
        except (struct.error, IndexError, UnicodeDecodeError):
            continue  # not of this type; a picture can do without it
        if name == NAME or level >= LEVELS["warning"]:
            grave: Level = "info"
            for word, least in LEVELS.items():
                if level >= least:
                    grave = word
            yield (seconds * 1_000_000_000 + nanoseconds) or logged, grave, text


def _string(data: bytes, position: int, order: str) -> tuple[str, int]:
    position += -(position - 4) % 4
    (length,) = struct.unpack_from(f"{order}I", data, position)
    end = position + 4 + length
    if end > len(data):
        raise struct.error("too short")
    return data[position + 4 : end].rstrip(b"\0").decode(), end
