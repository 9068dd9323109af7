"""Log and status line of a run, in a process of their own: ``python -m dashpot.hardware.scribe RING``.

It reads the ring that the loop writes (`dashpot.hardware.ring`), so that nothing in the loop's process ever
waits for a disk, a terminal or another thread's hold on the interpreter. It ends when the loop closes the
ring, or when the loop's process is gone; then it finishes the log all the same.
"""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dashpot.control.supervisor import STATES, Decision, decision
from dashpot.errors import DashpotError
from dashpot.hardware.ring import COLUMNS, Ring

if TYPE_CHECKING:
    from dashpot.logs.messages import Level

ROUND = 0.05  # [s] between two looks at the ring
SHOWN = 0.2  # [s] between two status lines
READY = "ready"
LEVELS: dict[str, Level] = {"done": "info", "operator": "info", "parked": "info"}


@dataclass(frozen=True)
class Notes:
    """What a scribe must know.

    Attributes:
        joints: Names, in the order of the columns.
        period: [s].
        torque_limit: (n,) [N m].
        log: File, .mcap, or "": none.
        live: Whether to keep a status line on standard error.
        clock: Stamps are those of the host's wall clock; else of the robot's, from 0.
        metadata: Of the log.
    """

    joints: tuple[str, ...]
    period: float
    torque_limit: tuple[float, ...]
    log: str = ""
    live: bool = False
    clock: bool = True
    metadata: tuple[tuple[str, str], ...] = ()


@contextmanager
def scribe(ring: Ring, notes: Notes) -> Iterator[None]:
    """Reads a ring from another process while the block runs, and waits until all is written at its end.

    Raises:
        DashpotError: The log cannot be written: before the block, or, where that shows later, after it.
    """
    if not notes.log and not notes.live:
        yield
        return
    command = [sys.executable, "-m", "dashpot.hardware.scribe", str(ring.file)]
    pipe = subprocess.PIPE
    process = subprocess.Popen(command, stdin=pipe, stdout=pipe, pass_fds=(ring.file,))
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        process.stdin.write(json.dumps(asdict(notes)).encode() + b"\n")
        process.stdin.flush()
        said = process.stdout.readline().decode().strip()
        if said != READY:
            raise DashpotError(said or "the process that writes the log did not come up")
        yield
    finally:
        process.stdin.close()
        said = process.stdout.read().decode().strip()
        process.stdout.close()
        process.wait()
    if said or process.returncode:
        raise DashpotError(
            said or f"{notes.log}: its writer was ended (status {process.returncode}); the log is cut off"
        )


class Book:
    """The log of one run: rows and decisions into a `McapWriter`."""

    def __init__(self, notes: Notes) -> None:
        from dashpot.logs.mcapwriter import McapWriter

        self.notes = notes
        self.writer = McapWriter(notes.log, notes.joints, period=notes.period, metadata=dict(notes.metadata))
        self._last = (0, 0)  # tick and stamp [ns] of the newest row
        self.empty = True

    def stamps(self, rows: NDArray[np.void]) -> NDArray[np.int64]:
        """Of rows, (t,) [ns]; a sample without a time has that of its tick."""
        if self.notes.clock:
            return np.array(rows["clock"])
        time = np.where(np.isfinite(rows["time"]), rows["time"], rows["tick"] * self.notes.period)
        return np.round(np.clip(time, 0, 2**31 - 1) * 1e9).astype(np.int64)

    def close(self) -> None:
        """Ends the file; one without a single row is removed."""
        self.writer.close()
        if self.empty:
            Path(self.notes.log).unlink(missing_ok=True)

    def rows(self, rows: NDArray[np.void]) -> None:
        """Adds rows."""
        self.empty = False
        n = len(self.notes.joints)
        names = (*COLUMNS, "x0", "x1", "x2", "x3", "mode")
        columns: dict[str, Any] = {name: rows[name][:, :n] for name in names}
        columns["status"], columns["supervisor"] = rows["joint_status"][:, :n], rows["state"]
        stamps = self.stamps(rows)
        self.writer.write(stamps, columns)
        self._last = int(rows["tick"][-1]), int(stamps[-1])

    def decision(self, decision: Decision) -> None:
        """Adds a decision of the supervisor."""
        tick, stamp = self._last
        stamp += round((decision.tick - tick) * self.notes.period * 1e9)
        self.writer.message(max(0, stamp), LEVELS.get(decision.reason, "warning"), str(decision))


class StatusLine:
    """One line on a terminal, replaced in place."""

    def __init__(self, notes: Notes) -> None:
        from rich.console import Console
        from rich.live import Live

        self.notes, self._shown = notes, 0.0
        # Standard output is where the loop is told that this process is ready, not a terminal's.
        self.live = Live(
            console=Console(stderr=True),
            auto_refresh=False,
            transient=True,
            redirect_stdout=False,
            redirect_stderr=False,
        )
        self.live.start()

    def show(self, rows: NDArray[np.void], statistics: dict[str, Any]) -> None:
        """Shows the newest row."""
        row, n = rows[-1], len(self.notes.joints)
        time = row["tick"] * self.notes.period
        if 0 <= time - self._shown < SHOWN:
            return
        self._shown = time
        with np.errstate(invalid="ignore"):
            error = np.abs(row["reference"][:n] - row["position"][:n])
            share = np.abs(row["command"][:n]) / np.array(self.notes.torque_limit)
        self.live.update(line(self.notes, time, int(row["state"]), error, share, statistics), refresh=True)

    def close(self) -> None:
        """Removes the line."""
        self.live.stop()


def line(
    notes: Notes,
    time: float,
    state: int,
    error: NDArray[Any],
    share: NDArray[Any],
    statistics: dict[str, Any],
) -> Any:
    """The status line, as rich draws it."""
    from rich.text import Text

    name = STATES[state]
    text = Text.assemble(
        (f"{time:5.1f} s ", "bold"),
        (f"{name.replace('_', ' '):<13}", "green" if name == "track" else "bold yellow"),
        no_wrap=True,
        overflow="ellipsis",
    )
    if np.isfinite(error).any():
        j = int(np.nanargmax(error))
        text.append(f"  error {np.degrees(error[j]):.2f} deg {notes.joints[j]}")
    j = int(np.argmax(share))
    text.append(f"  torque {100 * share[j]:.0f} % {notes.joints[j]}")
    if statistics["late"]:  # it has room in 80 columns, with the jitter, where something else is shorter
        text.append(f"  late {statistics['late']}", "yellow")
    text.append(f"  jitter {1e6 * statistics['jitter_most']:.0f} us", "dim")
    return text


def read(ring: Ring, notes: Notes, book: Book | None, shown: StatusLine | None, alive: Any) -> None:
    """Reads until the loop is over; ``alive`` says whether its process is there, and waits a little."""
    seen = 0
    while True:
        there = alive()
        progress = ring.progress()
        while len(rows := ring.drain()):
            if book is not None:
                book.rows(rows)
            if shown is not None:
                shown.show(rows, progress.statistics)
        if book is not None:
            new = min(progress.count - seen, len(progress.decisions))
            for raw in progress.decisions[len(progress.decisions) - new :]:
                book.decision(decision(raw, notes.joints, notes.period))
        seen = progress.count
        if progress.closed or not there:
            break
    if book is None:
        return
    if ring.missed:
        book.writer.message(
            book._last[1], "error", f"{ring.missed} rows were lost: the log could not keep up"
        )
    if not progress.closed:
        book.writer.message(book._last[1], "error", "the controlling process ended without a stop")


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):  # the loop decides when it is over
        signal.signal(number, signal.SIG_IGN)
    said = json.loads(sys.stdin.readline())
    notes = Notes(**{**said, "joints": tuple(said["joints"])})
    ring = Ring(int((arguments or sys.argv[1:])[0]))

    def alive() -> bool:
        return not select.select([sys.stdin], [], [], ROUND)[0]

    try:
        with ExitStack() as stack:
            book = Book(notes) if notes.log else None
            if book is not None:
                stack.callback(book.close)
            shown = StatusLine(notes) if notes.live else None
            if shown is not None:
                stack.callback(shown.close)
            print(READY, flush=True)
            read(ring, notes, book, shown, alive)
    except DashpotError as error:
        print(error, flush=True)
    except BrokenPipeError:  # the controlling process is gone before it began
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except OSError as error:
        print(f"{notes.log}: cannot be written: {error.strerror}", flush=True)


if __name__ == "__main__":
    main()
