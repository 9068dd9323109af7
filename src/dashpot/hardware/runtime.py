"""The real-time loop: samples in, one native call, torques out, and an end that is always the safe state.

Per cycle Python makes three calls, `Hardware.read`, ``Cycle.step`` and `Hardware.write`, and nothing else
runs in this process: the log and the status line are drawn from a ring in shared memory by another one
(`dashpot.hardware.scribe`). docs/hardware.md says how a run ends in each case.
"""

from __future__ import annotations

import math
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

import dashpot._native as _native
from dashpot.control.controller import Controller
from dashpot.control.sampled import NW
from dashpot.control.supervisor import STATES, Decision, State, Supervisor
from dashpot.errors import DashpotError, InputError
from dashpot.hardware.interface import Hardware, Sample
from dashpot.hardware.realtime import Measure, undisturbed
from dashpot.simulation.trajectory import Trajectory
from dashpot.support.arrays import Floats

RUN, BRAKE, SAFE, OVER = range(4)
FOREVER = -1
AT_ONCE = 2  # signals, of the same kind or not, after which the brakes close without waiting for rest

End = Literal["done", "stopped", "supervisor", "robot", "failed"]


@dataclass(frozen=True)
class LoopSettings:
    """How much lateness a run tolerates, and what it asks of the operating system.

    Attributes:
        late_cycles: Late cycles in a row that are too many, and likewise more than a third of all: the
            supervisor stops the arm, reason "host". A cycle is late if the robot's clock lost ticks before
            it.
        longest_gap: Ticks lost at once that are too many, the same.
        priority: Real-time priority asked for, 1 to 99; 0: none, and no memory is locked either.
        cpu: Processor to stay on; None: any.
        flow: The ring may fill faster than it is emptied: wait for its reader (a simulation without a clock).
    """

    late_cycles: int = 10
    longest_gap: int = 20
    priority: int = 80
    cpu: int | None = None
    flow: bool = False


@dataclass(frozen=True)
class Start:
    """Where a controller begins: in equilibrium.

    Attributes:
        states: Of the blocks, (n, NX).
        torque: In effect for long, (n,) [N m].
    """

    states: Floats
    torque: Floats


@dataclass(frozen=True)
class Outcome:
    """How a run ended. The motors are off and the brakes are closed, however it did.

    Attributes:
        end: "done": the motion was over; "stopped": by a signal; "supervisor": by its own decision; "robot":
            the robot ended it, or the link was lost; "failed": the adapter raised an exception.
        reason: One line.
        state: Of the supervisor at the end; "safe" unless robot, adapter or a second signal cut it short.
        braked: Whether the arm was brought to rest before the mechanical brakes closed.
        decisions: Of the supervisor.
        signal: Number of the signal that stopped it, or 0.
        statistics: Cycles, those that came late, ticks lost, histogram of the jitter in bins of 1 us.
        measures: What the operating system granted.
        problems: Exceptions while stopping, one line each.
    """

    end: End
    reason: str
    state: State
    braked: bool
    decisions: tuple[Decision, ...]
    signal: int
    statistics: dict[str, Any]
    measures: tuple[Measure, ...] = ()
    problems: tuple[str, ...] = field(default=())


def control(
    hardware: Hardware,
    supervisor: Supervisor,
    trajectory: Trajectory | None = None,
    *,
    duration: float | None = None,
    start: Start | None = None,
    settings: LoopSettings | None = None,
    ring: NDArray[np.uint8] | None = None,
) -> Outcome:
    """Controls a robot until the motion is over, somebody stops it, or something fails.

    Ctrl-C and SIGTERM, where this is the main thread, ask the supervisor for a stop: the arm is braked to
    rest, then the mechanical brakes close. A second one closes them at once.

    Args:
        hardware: The robot; its joints are the controller's, in any order.
        supervisor: With its controller; both are fresh, or reset.
        trajectory: References in the order of ``controller.joints``, (ticks, n); after its end it stands.
            None: where the arm is found.
        duration: Of the run, on the robot's clock [s]; None: that of the trajectory, or without one no end.
        start: State of the controller; None: in equilibrium with what the sensors say at rest.
        settings: None: the defaults.
        ring: Memory for the rows that others read (`dashpot.hardware.ring.Ring`), or None.

    Returns:
        How it ended. Exceptions of the adapter are in it, too; only bad arguments raise.

    Raises:
        InputError: Joints, periods or shapes do not fit together, or the arm cannot be held where it is
            found.
    """
    settings = settings or LoopSettings()
    controller = supervisor.controller
    order = joint_order(hardware, controller)
    sample = Sample.of(hardware.joints)
    if trajectory is None or start is None:
        _look(hardware, sample)
    reference = _reference(controller, trajectory, sample, order)
    until = FOREVER
    if duration is not None or trajectory is not None:
        ticks = reference.shape[1] if duration is None else duration / controller.period
        until = max(1, round(ticks))
    if start is None:
        _bumpless(controller)
    begin(controller, start or rest(controller, sample, order))
    arrays = (sample.torque, sample.position, sample.velocity, sample.in_effect)
    ages = (sample.torque_age, sample.encoder_age)
    cycle = _native.Cycle(
        supervisor.guard,
        (*arrays, *ages),
        order,
        reference,
        until,
        controller.period,
        settings.late_cycles,
        settings.longest_gap,
        ring,
    )
    with _signals(supervisor) as received, undisturbed(settings.priority, settings.cpu) as measures:
        end, reason, problems = _run(hardware, cycle, sample, received, settings.flow)
    cycle.close()
    log = tuple(supervisor.log)
    first = next((d for d in log if d.before == "track" and d.after != "track"), None)
    if end == "over":
        why = first.reason if first else "operator"
        end = {"done": "done", "operator": "stopped"}.get(why, "supervisor")
        if end == "done" and not supervisor.stopped:  # the motion, but not the stop
            end, first = "supervisor", log[-1]
        reason = str(first) if end == "supervisor" else first.words if first else ""
    return Outcome(
        end,  # type: ignore[arg-type]
        reason,
        supervisor.state,
        supervisor.stopped,
        log,
        received[0] if received else 0,
        cycle.statistics,
        tuple(measures),
        tuple(problems),
    )


def _run(
    hardware: Hardware, cycle: _native.Cycle, sample: Sample, received: list[int], flow: bool
) -> tuple[str, str, list[str]]:
    """The loop; how it ended, why, and what went wrong while stopping."""
    read, step, write, out = hardware.read, cycle.step, hardware.write, cycle.out
    wait = None if hardware.paced else cycle.wait
    end, reason, closed = "over", "", False
    problems: list[str] = []
    try:
        hardware.start()
        while True:
            if wait is not None:
                wait()
            if not read(sample):
                end, reason = "robot", hardware.reason or "the robot ended the motion and gave no reason"
                break
            phase = step(sample.time)
            write(out)
            if phase >= SAFE and not closed:
                closed = True
                hardware.apply_brake()
            if phase == OVER:
                break
            if len(received) >= AT_ONCE:
                end, reason = "stopped", "stopped twice: the brakes were closed at once"
                break
            if flow and cycle.behind > 4096:
                _wait_for_reader(cycle)
    except Exception as error:
        end, reason = "failed", said(error)
    finally:
        for action in (hardware.stop,) if closed else (hardware.apply_brake, hardware.stop):
            try:
                action()
            except Exception as error:
                problems.append(f"{action.__name__}: {said(error)}")
    return end, reason, problems


def _wait_for_reader(cycle: _native.Cycle, patience: float = 10.0) -> None:
    last = time.monotonic() + patience
    while cycle.behind > 2048 and time.monotonic() < last:
        time.sleep(0.002)


def said(error: BaseException) -> str:
    """An exception in one line."""
    text = " ".join(str(error).split())
    return (
        text if isinstance(error, DashpotError) and text else f"{type(error).__name__}: {text}".rstrip(": ")
    )


def joint_order(hardware: Hardware, controller: Controller) -> NDArray[np.int32]:
    """Place of every joint of the controller in the robot's arrays, (n,).

    Raises:
        InputError: Joints or periods differ.
    """
    for name in controller.joints:
        if name not in hardware.joints:
            raise InputError(f"the robot has no such joint; it has {', '.join(hardware.joints)}", joint=name)
    for name in hardware.joints:
        if name not in controller.joints:
            raise InputError(
                "is under torque control of this robot, but not in the controller; add it there", joint=name
            )
    if not math.isclose(hardware.period, controller.period, rel_tol=1e-6):
        raise InputError(
            f"differs from the robot's cycle, {hardware.period:g} s",
            quantity="controller's period [s]",
            value=controller.period,
        )
    return np.array([hardware.joints.index(name) for name in controller.joints], np.int32)


def _look(hardware: Hardware, sample: Sample) -> None:
    if not hardware.read(sample):
        raise DashpotError(f"the robot gives no samples: {hardware.reason or 'no reason given'}")


def _reference(
    controller: Controller, trajectory: Trajectory | None, sample: Sample, order: NDArray[np.int32]
) -> Floats:
    """(4, ticks, n)."""
    n = len(controller.joints)
    if trajectory is None:
        found = sample.position[order]
        if not np.isfinite(found).all():
            raise InputError(
                "is not known, so that it cannot be held; give a motion",
                joint=controller.joints[int(np.argmin(np.isfinite(found)))],
                quantity="position [rad]",
            )
        reference = np.zeros((4, 1, n))
        reference[0, 0] = found
        return reference
    if trajectory.position.shape[1:] != (n,) or not math.isclose(
        trajectory.period, controller.period, rel_tol=1e-9
    ):
        raise InputError(
            f"must have {n} columns, one per joint, at {controller.period:g} s",
            quantity="trajectory",
            value=(trajectory.position.shape, trajectory.period),
        )
    torque = np.zeros_like(trajectory.position) if trajectory.torque is None else trajectory.torque
    return np.ascontiguousarray(
        np.stack([trajectory.position, trajectory.velocity, trajectory.acceleration, torque])
    )


def rest(controller: Controller, sample: Sample, order: NDArray[np.int32]) -> Start:
    """The controller in equilibrium with a sample of an arm at rest.

    The torque that has been in effect is what the robot says, else the sensed one; block states solve
    ``x = A x + B w`` at zero position error, zeros where they cannot (an integrator).
    """
    sensed = np.nan_to_num(sample.torque[order])
    asked = sample.in_effect[order]
    blocks = controller.blocks
    torque = np.clip(
        np.where(np.isfinite(asked), asked, sensed), -blocks["torque_limit"], blocks["torque_limit"]
    )
    states = np.zeros((len(blocks), blocks["B"].shape[1]))
    for j, block in enumerate(blocks):
        n = int(block["nx"])
        w = np.zeros(NW)
        w[0], w[1] = sensed[j], torque[j]
        system = np.eye(n) - block["A"][:n, :n]
        if n and np.linalg.cond(system) < 1e12:
            states[j, :n] = np.linalg.solve(system, block["B"][:n] @ w)
    return Start(states, torque)


def begin(controller: Controller, start: Start) -> None:
    """Puts a controller into a state of equilibrium."""
    for j, (states, torque) in enumerate(zip(start.states, start.torque, strict=True)):
        controller.core.preset(j, np.ascontiguousarray(states), float(torque))


def _bumpless(controller: Controller) -> None:
    """Lets the first torque continue the one in effect; the law's own is faded in over `blend`."""
    for j in range(len(controller.joints)):
        mode = controller.core.joint_state(j)[0]
        controller.core.set_mode(j, 0)
        controller.core.set_mode(j, mode)


@contextmanager
def _signals(supervisor: Supervisor) -> Iterator[list[int]]:
    """Signals ask for a stop; gives the list of those that have come."""
    received: list[int] = []

    def ask(number: int, _: object) -> None:
        received.append(number)
        supervisor.stop("operator")

    before = {}
    if threading.current_thread() is threading.main_thread():
        names = ("SIGINT", "SIGTERM", "SIGHUP")
        numbers = [getattr(signal, name) for name in names if hasattr(signal, name)]
        before = {number: signal.signal(number, ask) for number in numbers}
    try:
        yield received
    finally:
        for number, handler in before.items():
            with suppress(TypeError):  # one that was not set from Python
                signal.signal(number, handler)


__all__ = ["STATES", "LoopSettings", "Outcome", "Start", "begin", "control", "joint_order", "rest", "said"]
