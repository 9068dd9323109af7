"""MCAP logs, written while they happen: what is more than a second old survives a kill.

Samples go into compressed chunks, a chunk every 0.4 s at the latest, each whole on its own and handed to the
operating system at once; a file that is never closed lacks only its index. Messages are ROS 2 messages in
CDR, with their definitions in the file (`dashpot.logs.messages`).
"""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dashpot.errors import InputError
from dashpot.logs.cdr import MESSAGE, OPCODE, Cdr, Row, joint_message, tick_row
from dashpot.logs.mcapfile import McapFile
from dashpot.logs.messages import (
    COLUMNS,
    LEVELS,
    LOG,
    LOG_DEFINITION,
    ROSOUT,
    SCALARS,
    TOPICS,
    Level,
)

INTERVAL = 0.4  # [s] after which what has been written goes to the file
BLOCK = 4096  # ticks encoded at a time
NANO = 1_000_000_000
LATEST = (1 << 31) * NANO  # [ns] that a builtin_interfaces/Time can hold


class McapWriter:
    """Writes a log as it happens.

    >>> with McapWriter("run.mcap", joints, period=1e-3, metadata={"sampling": "average"}) as log:
    ...     log.write(time_ns, {"torque": torque, "position": q, "velocity": w, "command": u})
    ...     log.message(time_ns[-1], "warning", "joint6: the encoder stands")

    Calls may come from any thread. A thread of its own puts away what has been written every 0.4 s.

    Attributes:
        path: The file.
        joints: Names, in the order of the columns.
    """

    def __init__(
        self,
        path: str | Path,
        joints: Sequence[str],
        *,
        period: float,
        metadata: Mapping[str, str] | None = None,
    ) -> None:
        """Begins the file; one that is there is overwritten.

        Args:
            path: Ends in ``.mcap``; its folder is made.
            joints: n names, base to tip.
            period: Of the samples [s]; goes into the metadata.
            metadata: More of it; "sampling" is how torque is sampled, "average" or "point".

        Raises:
            InputError: A joint is named twice or not at all, or the file cannot be written.
            DashpotError: zstandard is not installed.
        """
        self.path, self.joints = Path(path), tuple(joints)
        if not self.joints or len(set(self.joints)) < len(self.joints):
            raise InputError(
                "must be names, each once", file=self.path, quantity="joints", value=", ".join(joints)
            )
        self._lock = threading.Lock()
        self._closed = False
        self._columns: tuple[str, ...] = ()
        self._row: Row | None = None
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = McapFile(self.path, {"period": repr(float(period)), **(metadata or {})})
            try:
                self._rosout = self._file.channel(ROSOUT, LOG, LOG_DEFINITION)
            except OSError:
                self._file.close()
                raise
        except OSError as error:
            raise InputError(f"cannot be written: {error.strerror}", file=self.path) from None
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._put_away, name="dashpot-log", daemon=True)
        self._thread.start()

    def write(self, time_ns: NDArray[np.int64], columns: Mapping[str, ArrayLike]) -> None:
        """Adds t samples of every joint.

        Args:
            time_ns: (t,) stamps [ns], on the robot's clock or since 1970.
            columns: Name, one of `dashpot.logs.messages.COLUMNS`, to values (t, n), or (t,) for the state
                of the supervisor; the same names in every call. Integers for mode, status and supervisor.

        Raises:
            InputError: Another column, shape or stamp than these; nothing has been added then.
            OSError: The file cannot be written, e.g. the disk is full.
        """
        stamps = np.asarray(time_ns, np.int64)
        if stamps.ndim != 1:
            raise InputError("must be one-dimensional", file=self.path, quantity="time_ns.shape")
        if len(stamps) and not 0 <= stamps.min() <= stamps.max() < LATEST:
            raise InputError(
                "must be 0 to 2^31 s", file=self.path, quantity="time_ns [ns]", value=int(stamps.min())
            )
        arrays = {name: np.asarray(values) for name, values in columns.items()}
        for name, values in arrays.items():
            wanted = (len(stamps),) if name in SCALARS else (len(stamps), len(self.joints))
            if name in COLUMNS and values.shape != wanted:
                raise InputError(
                    f"must have shape {wanted}", file=self.path, quantity=f"{name}.shape", value=values.shape
                )
        with self._lock:
            self._check()
            if self._row is None:
                self._row = self._begin(tuple(arrays))
            if set(arrays) != set(self._columns):
                raise InputError(
                    f"must be those of the first call: {', '.join(self._columns)}",
                    file=self.path,
                    quantity="columns",
                    value=", ".join(arrays),
                )
            for start in range(0, len(stamps), BLOCK):
                part = slice(start, start + BLOCK)
                self._add(stamps[part], {name: values[part] for name, values in arrays.items()}, self._row)

    def message(self, time_ns: int, level: Level, text: str) -> None:
        """Adds a log message, on /rosout, where viewers look for them.

        Raises:
            InputError: Another level, or a stamp out of range.
            OSError: The file cannot be written.
        """
        if level not in LEVELS:
            raise InputError(f"must be one of {', '.join(LEVELS)}", quantity="level", value=level)
        stamp = int(time_ns)
        if not 0 <= stamp < LATEST:
            raise InputError("must be 0 to 2^31 s", file=self.path, quantity="time_ns [ns]", value=stamp)
        cdr = Cdr()
        cdr.count(stamp // NANO)
        cdr.count(stamp % NANO)
        cdr.data.append(LEVELS[level])
        for words in ("dashpot", text, "", ""):
            cdr.string(words)
        cdr.count(0)
        with self._lock:
            self._check()
            count = self._file.counts[self._rosout]
            head = MESSAGE.pack(OPCODE, MESSAGE.size - 9 + len(cdr.data), self._rosout, count, stamp, stamp)
            self._file.append(head + bytes(cdr.data), np.array([stamp]), {self._rosout: 0}, 0)

    def flush(self) -> None:
        """Hands everything to the operating system now.

        Raises:
            OSError: The file cannot be written.
        """
        with self._lock:
            self._check()
            self._file.end_chunk()

    def close(self) -> None:
        """Writes the rest and the index. Later calls do nothing.

        Raises:
            OSError: The file could not be written.
        """
        if self._closed:
            return
        self._closing.set()
        self._thread.join()
        with self._lock:
            self._closed = True
            try:
                self._file.check()
                self._file.end_chunk()
                self._file.finish()
            finally:
                self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _check(self) -> None:
        if self._closed:
            raise InputError("is closed", file=self.path)
        self._file.check()

    def _put_away(self) -> None:
        while not self._closing.wait(INTERVAL):
            with self._lock, suppress(OSError):  # the next call says it
                self._file.end_chunk()

    def _begin(self, names: tuple[str, ...]) -> Row:
        """Registers the topics of the columns."""
        unknown = [name for name in names if name not in COLUMNS]
        if unknown or not names:
            raise InputError(
                f"must be among {', '.join(COLUMNS)}",
                file=self.path,
                quantity="column",
                value=unknown[0] if unknown else "none",
            )
        messages = []
        for topic in TOPICS:
            if any(name in names for name in topic.columns):
                channel = self._file.channel(topic.name, topic.type, topic.definition)
                messages.append((channel, joint_message(topic, self.joints, names)))
        self._columns = names
        return tick_row(messages)

    def _add(self, stamps: NDArray[np.int64], columns: Mapping[str, NDArray[Any]], row: Row) -> None:
        block = np.empty((len(stamps), len(row.template)), np.uint8)
        block[:] = row.template
        rows = block.reshape(-1).view(row.dtype)
        seconds = stamps // NANO
        nanoseconds = stamps - NANO * seconds
        for i, channel in enumerate(row.starts):
            first = self._file.counts[channel]
            rows[f"sequence@{i}"] = np.arange(first, first + len(stamps)) & 0xFFFFFFFF
            rows[f"log@{i}"] = rows[f"publish@{i}"] = stamps
            rows[f"sec@{i}"], rows[f"nanosec@{i}"] = seconds, nanoseconds
        for name, slot in row.slots.items():
            rows[slot] = columns.get(name, 0)
        self._file.append(block.tobytes(), stamps, row.starts, len(row.template))
