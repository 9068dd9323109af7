"""Closed-loop simulation: scenarios in, recordings out, at native speed and on several threads."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Literal

from dashpot.arm.payload import Payload
from dashpot.arm.plant import Plant, build
from dashpot.arm.robot import Robot
from dashpot.control.controller import Controller, ControllerConfig
from dashpot.control.supervisor import SupervisorSettings
from dashpot.simulation.faults import Fault
from dashpot.simulation.loop import PIECE, Loop
from dashpot.simulation.recording import Recording
from dashpot.simulation.trajectory import Trajectory
from dashpot.support.arrays import Floats

EventKind = Literal["mode", "position_loop", "warm_start"]


@dataclass(frozen=True)
class Event:
    """Something done to the controller at a time.

    Attributes:
        time: [s], on the trajectory's clock.
        joint: Joint name, or "all": every controlled joint.
        kind: "mode" (value "off", "bypass" or "active"), "position_loop" (value True or False), or
            "warm_start" (from the joint's true velocity at that time).
        value: See kind.
    """

    time: float
    joint: str
    kind: EventKind
    value: str | bool = True


@dataclass(frozen=True)
class PayloadChange:
    """The flange picks something up, or lets it go: from then on it carries this load instead of all others.

    Angles and velocities go on as they are: what is picked up moves as the hand does.

    Attributes:
        time: [s], on the trajectory's clock.
        payload: From then on; None: nothing.
    """

    time: float
    payload: Payload | None = None

    def table(self) -> dict[str, Any]:
        """Time [s], mass [kg], offset (3,) [m] and length [m], as JSON can hold them."""
        load = self.payload or Payload(0.0)
        offset = load.position.tolist()
        return {"time": self.time, "mass": load.mass, "offset": offset, "length": load.length}


@dataclass(frozen=True)
class Scenario:
    """One closed-loop run.

    Attributes:
        plant: The arm with its payload (`dashpot.arm.plant.build`), for the controller's period.
        controller: The controller, or None: every joint under the robot's own servo.
        trajectory: References; the arm starts at rest, in equilibrium with gravity, at their
            first position.
        events: In any order.
        external: Torque on each link, (ticks, n) [N m], or None.
        seed: Seed of the sensor noise and of dropped samples.
        label: For messages.
        faults: In any order; those at the same time compose (docs/faults.md).
        payload_changes: In any order.
        supervisor: Runs in place of the bare controller, as on a robot; None: none does. What it decides is
            in ``recording.settings["supervisor"]``.
        gravity_compensation: Whether the robot's own is switched on, where its file says that it has one
            (`Robot.gravity_compensation`): it then adds the torque that holds its bare links at the encoders'
            angles to every command, and the controller gets the sensed torque without it. Without it the
            controller carries the arm.
    """

    plant: Plant
    controller: Controller | None
    trajectory: Trajectory
    events: Sequence[Event] = ()
    external: Floats | None = None
    seed: int = 0
    label: str = ""
    faults: Sequence[Fault] = ()
    payload_changes: Sequence[PayloadChange] = ()
    supervisor: SupervisorSettings | None = None
    gravity_compensation: bool = False

    @property
    def carried(self) -> bool:
        """Whether the robot carries its own weight."""
        return self.gravity_compensation and self.plant.robot.gravity_compensation


def run(scenario: Scenario, advance: Callable[[float], None] | None = None) -> Recording:
    """Runs one scenario; the same scenario gives the same bits on any number of threads.

    Args:
        scenario: What to run.
        advance: Told now and then how far it has come [s]; None: nobody asks. The bits are the same.

    Raises:
        InputError: Periods, shapes or joints of plant, controller and trajectory do not fit together, or an
            event, a fault or a change of payload does not fit them.
    """
    loop = Loop(scenario)
    while advance is not None and loop.tick < loop.ticks and loop.diverged is None:
        loop.advance(loop.tick + PIECE)
        advance(loop.tick * scenario.trajectory.period)
    loop.advance()
    return loop.recording()


def run_many(
    scenarios: Iterable[Scenario],
    *,
    threads: int | None = None,
    progress: str | None = None,
    reduce: Callable[[Scenario, Recording], object] | None = None,
) -> list[object]:
    """Runs scenarios on threads (the native loop releases the GIL) and returns results in order.

    Args:
        scenarios: What to run.
        threads: Number of threads; None: one per core.
        progress: Label of a progress bar on the terminal; None: none.
        reduce: Applied to each scenario and its recording on the thread; None: keep the recordings.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    todo = list(scenarios)

    def work(scenario: Scenario) -> object:
        recording = run(scenario)
        return reduce(scenario, recording) if reduce else recording

    columns = (TextColumn("{task.description:<34}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    console = Console(stderr=True)
    with (
        Progress(*columns, console=console, disable=progress is None or not console.is_terminal) as bar,
        ThreadPoolExecutor(threads or os.cpu_count()) as pool,
    ):
        task = bar.add_task(progress or "", total=len(todo))
        results = []
        try:
            for result in pool.map(work, todo):
                results.append(result)
                bar.advance(task)
        except BaseException:
            pool.shutdown(cancel_futures=True)  # Ctrl-C must not wait for the scenarios still queued
            raise
    return results


def simulate(
    robot: Robot,
    config: ControllerConfig | None,
    trajectory: Trajectory,
    *,
    payloads: Sequence[Payload] = (),
    events: Sequence[Event] = (),
    faults: Sequence[Fault] = (),
    payload_changes: Sequence[PayloadChange] = (),
    seed: int = 0,
) -> Recording:
    """Builds the plant and the controller and runs once: the short way for one scenario."""
    from dashpot.simulation.feedforward import with_feedforward

    trajectory = with_feedforward(robot, config, trajectory)
    plant = build(robot, trajectory.period, payloads)
    controller = Controller.from_config(config, robot.drives) if config else None
    return run(
        Scenario(
            plant,
            controller,
            trajectory,
            events,
            seed=seed,
            faults=faults,
            payload_changes=payload_changes,
        )
    )
