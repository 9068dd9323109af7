"""Evidence for the FR3 adapter: official pylibfranka against the simulated robot, on one machine.

    python -m dashpot.studies.franka [PART ...] > docs/evidence/franka.json

*repeat*: in lock-step a payload is picked up at 1 s and the encoder of a moving joint freezes at 2 s, twenty
times in a row: the arm brakes and holds, no reflex is raised, and what was true has one hash. *free*: at
1 kHz of wall clock with all rules enforced, bad controllers are stopped and ours is not. *cost*: time added
per cycle to a bare pylibfranka loop, and packets lost, in turns with it.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from dashpot.arm.robot import Robot
from dashpot.control.controller import Controller, load_controller
from dashpot.control.supervisor import Supervisor
from dashpot.errors import DashpotError
from dashpot.hardware.franka import FrankaHardware, connect, pylibfranka
from dashpot.hardware.realtime import undisturbed
from dashpot.hardware.runtime import LoopSettings, Outcome, control
from dashpot.simulation.recording import CHANNELS, Recording
from dashpot.simulation.trajectory import Trajectory, multisine

PERIOD = 1e-3  # [s]
PICK_UP, FROZEN, DURATION = 1.0, 2.0, 4.5  # [s]
MASS, JOINT = 2.0, 3  # [kg] picked up; joint 4 loses its encoder
RUNS, CYCLES, ROUNDS = 20, 2000, 40
STEP, NAP = 5.0, 0.05  # [N m] and [s] of the bad controllers
_numbers = itertools.count()


@dataclass
class Served:
    """A server of `serve`.

    Attributes:
        host: Its address.
        lines: What it has said; complete after the end.
        recording: What was true, after the end; None where nothing moved.
    """

    host: str
    lines: list[str] = field(default_factory=list)
    recording: Recording | None = None

    @property
    def ends(self) -> list[tuple[str, int, int]]:
        """How each motion ended, its cycles, and packets lost."""
        found = (re.fullmatch(r"\S+ s: (.+); (\d+) cycles, (\d+) packets lost", line) for line in self.lines)
        return [(end[1], int(end[2]), int(end[3])) for end in found if end]


@contextmanager
def serve(*options: str) -> Iterator[Served]:
    """Runs ``dashpot franka-server`` in a process of its own, on an address of its own.

    Raises:
        DashpotError: It does not start, or ends by itself.
    """
    number = os.getpid() * 64 + next(_numbers)  # loopback has 2^24 addresses: tests run side by side
    host = f"127.{1 + number // 62500 % 250}.{1 + number // 250 % 250}.{1 + number % 250}"
    served = Served(host)
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "truth.npz"
        command = [sys.executable, "-m", "dashpot", "franka-server", "--host", host, "--log", str(log)]
        process = subprocess.Popen(
            [*command, *options], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        assert process.stdout is not None
        try:
            served.lines.append(process.stdout.readline().rstrip())
            if "listening" not in served.lines[0]:
                raise DashpotError(f"franka-server does not start: {served.lines[0]}")
            yield served
        finally:
            process.send_signal(signal.SIGTERM)
            rest, _ = process.communicate(timeout=60)
            served.lines += [line.rstrip() for line in rest.splitlines()]
        if process.returncode != 0:
            raise DashpotError(f"franka-server ended with status {process.returncode}: {served.lines[-1]}")
        if log.exists():
            served.recording = Recording.load(log)


def motion(duration: float = DURATION) -> Trajectory:
    """All joints around home; the one that loses its encoder is then about as fast as it gets."""
    lead_in, home = 0.5, Robot.load("fr3").home
    peak = {JOINT: FROZEN - lead_in}
    return multisine(home, duration - lead_in, PERIOD, 1, amplitude=0.2, lead_in=lead_in, peak_speed_at=peak)


def drive(
    host: str,
    path: Trajectory | None,
    duration: float | None = None,
    hardware: type[FrankaHardware] = FrankaHardware,
) -> tuple[Outcome, FrankaHardware]:
    """Runs the bundled controller under its supervisor on the robot at an address."""
    robot = Robot.load("fr3")
    controller = Controller.from_config(load_controller("fr3"), robot.drives)
    connected, supervisor = hardware(host, robot), Supervisor(controller, robot.drives)
    outcome = control(connected, supervisor, path, duration=duration)
    connected.close()
    return outcome, connected


def scenario(duration: float = DURATION) -> tuple[Served, Outcome]:
    """Payload at 1 s, frozen encoder at 2 s, in lock-step."""
    script = (f"--payload-at={PICK_UP}={MASS}", f"--fault=encoder_frozen:joint{JOINT + 1}@{FROZEN}")
    with serve("--lock-step", *script) as served:
        outcome, _ = drive(served.host, motion(duration))
    return served, outcome


def digest(recording: Recording) -> str:
    """SHA-256 of all that was true, bit by bit."""
    found = hashlib.sha256()
    for name in CHANNELS:
        found.update(np.ascontiguousarray(getattr(recording, name)).tobytes())
    return found.hexdigest()


def truth(recording: Recording, path: Trajectory) -> dict[str, float]:
    """What the arm really did, worst joint; the clock begins one cycle before the motion."""
    period, ticks = PERIOD, len(recording.time)
    first = 1  # the cycle of zero torque
    reference = path.position[np.clip(np.arange(ticks) - first, 0, path.ticks - 1)]
    error = np.abs(recording.link_position - reference)

    def between(start: float, end: float) -> slice:
        return slice(round(start / period), round(end / period))

    braked = between(FROZEN + 0.5, path.ticks * period)
    at = round(FROZEN / period)
    return {
        "error_before_rad": float(error[between(0, PICK_UP)].max()),
        "error_with_payload_rad": float(error[between(PICK_UP, FROZEN)].max()),
        "speed_when_frozen_rad_s": float(abs(recording.link_velocity[at, JOINT])),
        "speed_braked_rad_s": float(np.abs(recording.link_velocity[braked]).max()),
        "way_after_rad": float(np.abs(recording.link_position[at:] - recording.link_position[at]).max()),
        "drift_braked_rad": float(np.ptp(recording.link_position[braked], axis=0).max()),
        "speed_at_end_rad_s": float(np.abs(recording.link_velocity[-1]).max()),
    }


def repeat(runs: int = RUNS) -> dict[str, Any]:
    """The scenario so many times: hashes, how it ended, what was true."""
    found = []
    for i in range(runs):
        served, outcome = scenario()
        assert served.recording is not None
        found.append((digest(served.recording), outcome, served))
        _say(f"run {i + 1}: {found[-1][0][:16]}, {outcome.end}: {outcome.reason}")
    served, outcome = found[0][2], found[0][1]
    assert served.recording is not None
    return {
        "runs": runs,
        "hashes": sorted({one[0] for one in found}),
        "ended": sorted({f"{one[1].end}: {one[1].reason}" for one in found}),
        "reflexes": sorted({end for one in found for end, _, _ in one[2].ends if "reflex" in end}),
        "decisions": [str(decision) for decision in outcome.decisions],
        "truth": truth(served.recording, motion()),
    }


def bad(host: str, kind: str) -> str:
    """A bare loop that does a forbidden thing after 0.5 s; what pylibfranka raises, or ""."""
    franka = pylibfranka()
    robot = connect(host)
    active = robot.start_torque_control()
    try:
        for i in range(1000):
            active.readOnce()
            if kind == "nap" and i == 500:
                time.sleep(NAP)
            active.writeOnce(franka.Torques([STEP if kind == "step" and i >= 500 else 0.0] * 7))
    except franka.ControlException as error:
        return str(error)
    robot.stop()
    return ""


def free() -> dict[str, Any]:
    """At 1 kHz, rules enforced: a torque step, a nap, and ours, which picks up a payload on the way."""
    found: dict[str, Any] = {}
    for kind in ("step", "nap"):
        with serve() as served:
            raised = bad(served.host, kind)
        found[kind] = {"raised": raised, "ended": served.ends[0][0]}
    with serve(f"--payload-at={PICK_UP}={MASS}") as served:
        outcome, _ = drive(served.host, motion())
    end, cycles, lost = served.ends[0]
    found["ours"] = {"ended": end, "outcome": outcome.end, "cycles": cycles, "lost": lost}
    return found


class _Timed(FrankaHardware):
    """Counts cycles and the processor time they take."""

    cycles, begun, spent = 0, 0.0, 0.0

    def start(self) -> None:
        super().start()
        self.begun = time.thread_time()

    def write(self, torque: Any) -> None:
        super().write(torque)
        self.cycles += 1

    def apply_brake(self) -> None:
        self.spent = time.thread_time() - self.begun
        super().apply_brake()


def bare(host: str, cycles: int) -> float:
    """Processor time per cycle of a loop that does nothing but read and write [s]."""
    franka = pylibfranka()
    robot = connect(host)
    with undisturbed(LoopSettings().priority, None):
        active, zeros = robot.start_torque_control(), [0.0] * 7
        active.readOnce()
        active.writeOnce(franka.Torques(zeros))
        begun = time.thread_time()
        for _ in range(cycles):
            active.readOnce()
            active.writeOnce(franka.Torques(zeros))
        spent = time.thread_time() - begun
        robot.stop()
    return spent / cycles


def take_turns(rounds: int, cycles: int) -> dict[str, list[float]]:
    """Bare and ours at 1 kHz on one robot, per round: processor time of a cycle [s], cycles, packets lost."""
    found: dict[str, list[float]] = {"bare": [], "ours": []}
    found |= {f"{what}_{who}": [] for what in ("ticks", "lost") for who in ("bare", "ours")}
    with serve("--forgiving") as served:
        for _ in range(rounds):
            found["bare"].append(bare(served.host, cycles))
            _, timed = drive(served.host, None, cycles * PERIOD, _Timed)
            assert isinstance(timed, _Timed)
            found["ours"].append(timed.spent / timed.cycles)
    for i, (_, ticks, lost) in enumerate(served.ends):
        who = "ours" if i % 2 else "bare"
        found[f"ticks_{who}"].append(ticks)
        found[f"lost_{who}"].append(lost)
    return found


def cost(rounds: int = ROUNDS, cycles: int = CYCLES) -> dict[str, Any]:
    """What the adapter and the controller add to a bare loop: medians of rounds that took turns."""
    found = take_turns(rounds, cycles)
    median = {name: float(np.median(values)) for name, values in found.items()}
    added = median["ours"] - median["bare"]
    return {
        "bare_us": 1e6 * median["bare"],
        "ours_us": 1e6 * median["ours"],
        "added_us": 1e6 * added,
        "added_of_cycle": added / PERIOD,
        **{
            f"{name}_{who}": sum(found[f"{name}_{who}"])
            for who in ("bare", "ours")
            for name in ("ticks", "lost")
        },
        "chance_of_that_by_luck": luck(found["lost_bare"], found["lost_ours"]),
        "rounds": rounds,
        "cycles": cycles,
        "load": os.getloadavg()[0],
    }


def luck(before: list[float], after: list[float], draws: int = 20_000) -> float:
    """How often rounds that are alike differ by as much in sum: a test of random signs, one-sided."""
    more = np.array(after) - np.array(before)
    signs = np.random.default_rng(0).choice([-1.0, 1.0], (draws, len(more)))
    return float((signs @ more >= more.sum()).mean())


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def main() -> None:
    """Prints the evidence as JSON."""
    parts = {"repeat": repeat, "free": free, "cost": cost}
    chosen = sys.argv[1:] or list(parts)
    if unknown := [name for name in chosen if name not in parts]:
        raise SystemExit(f"no such part: {', '.join(unknown)}; there are {', '.join(parts)}")
    franka = pylibfranka()
    found: dict[str, Any] = {"pylibfranka": franka.__version__}
    for name in chosen:
        found[name] = parts[name]()
        _say(f"{name}: {json.dumps(found[name])}")
    print(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
