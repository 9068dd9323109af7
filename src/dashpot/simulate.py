"""Closed-loop simulation: scenarios in, recordings out, at native speed and on several threads."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

import dashpot._native as _native
from dashpot.controller import MODES, Controller, ControllerConfig
from dashpot.equilibrium import settle
from dashpot.errors import DashpotError, InputError
from dashpot.payload import Payload
from dashpot.plant import Plant, build
from dashpot.recording import CHANNELS, Recording
from dashpot.robot import Robot
from dashpot.sampled import BLOCK_DTYPE, Floats
from dashpot.trajectory import Trajectory

EVENT_DTYPE = np.dtype([("tick", "i4"), ("joint", "i4"), ("kind", "i4"), ("value", "i4")])
EventKind = Literal["mode", "position_loop", "warm_start"]
_KINDS = {"mode": 0, "position_loop": 1, "warm_start": 2}


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
class Scenario:
    """One closed-loop run.

    Attributes:
        plant: The arm with its payload (`dashpot.plant.build`), for the controller's period.
        controller: The controller, or None: every joint under the robot's own servo.
        trajectory: References; the arm starts at rest, in equilibrium with gravity, at their
            first position.
        events: In any order.
        external: Torque on each link, (ticks, n) [N m], or None.
        seed: Seed of the sensor noise.
        label: For messages.
    """

    plant: Plant
    controller: Controller | None
    trajectory: Trajectory
    events: Sequence[Event] = ()
    external: Floats | None = None
    seed: int = 0
    label: str = ""


@cache
def _mj_step() -> int:
    """Address of ``mj_step`` in the library the mujoco package loaded."""
    folder = Path(mujoco.__file__).parent
    for path in sorted([*folder.glob("libmujoco*"), *folder.glob("mujoco.dll")]):
        address = ctypes.cast(ctypes.CDLL(str(path)).mj_step, ctypes.c_void_p).value
        if address:
            return address
    raise DashpotError(f"{folder}: no MuJoCo library with mj_step; reinstall mujoco")


def _events(scenario: Scenario) -> NDArray[np.void]:
    controller, trajectory = scenario.controller, scenario.trajectory
    rows: list[tuple[int, int, int, int]] = []
    for event in scenario.events:
        if event.kind not in _KINDS:
            raise InputError(f"must be one of {', '.join(_KINDS)}", quantity="event kind", value=event.kind)
        if controller is None:
            raise InputError("events need a controller", quantity=event.kind)
        if event.kind == "mode" and event.value not in MODES:
            raise InputError(
                f"must be one of {', '.join(MODES)}", joint=event.joint, quantity="mode", value=event.value
            )
        tick = (event.time - trajectory.start) / trajectory.period
        if not -0.5 <= tick < len(trajectory.position) - 0.5:  # also catches NaN
            raise InputError(
                f"outside the trajectory, {trajectory.time[0]:g} to {trajectory.time[-1]:g} s",
                joint=event.joint,
                quantity="event time [s]",
                value=event.time,
            )
        tick = round(tick)
        value = MODES.index(str(event.value)) if event.kind == "mode" else int(bool(event.value))
        names = controller.joints if event.joint == "all" else (event.joint,)
        rows += [(tick, controller.index(name), _KINDS[event.kind], value) for name in names]
    rows.sort(key=lambda row: row[0])
    return np.array(rows, EVENT_DTYPE)


def _start(scenario: Scenario, core: Any, events: NDArray[np.void], data: Any) -> None:
    """Puts the arm at rest in equilibrium with the first reference; without one, at it with slack springs."""
    plant, controller = scenario.plant, scenario.controller
    reference = scenario.trajectory.position[0]
    joints = controller.joints if controller else ()
    blocks = controller.blocks if controller else np.zeros(0, BLOCK_DTYPE)
    modes = {joint: "active" for joint in joints}
    for event in events:
        if event["tick"] == 0 and event["kind"] == _KINDS["mode"]:
            modes[joints[event["joint"]]] = MODES[event["value"]]
    found = None
    if "off" not in modes.values():
        bypass = [j for j, mode in modes.items() if mode == "bypass"]
        torque = None if scenario.trajectory.torque is None else scenario.trajectory.torque[0]
        found = settle(plant, joints, blocks, reference, bypass, torque)
    if found is None:
        data.qpos[plant.rotor_qpos] = reference
        return
    data.qpos[plant.rotor_qpos] = found.rotor
    data.qpos[plant.drives["spring_qpos"]] = found.deflection
    for i, joint in enumerate(joints):
        core.preset(i, found.states[i], found.torque[plant.robot.index(joint)])


def _check(scenario: Scenario) -> None:
    """Checks that plant, controller, trajectory and external torque fit together."""
    plant, controller, trajectory = scenario.plant, scenario.controller, scenario.trajectory
    shape, period = (len(trajectory.position), len(plant.drives)), trajectory.period
    steps = round(period / plant.timestep)
    if abs(steps * plant.timestep - period) > 1e-9 * period or steps < 1:
        raise InputError(
            f"must be a multiple of the plant's time step {plant.timestep:g} s; build the plant with it",
            quantity="period [s]",
            value=period,
        )
    if controller is not None and abs(controller.period - period) > 1e-12:
        raise InputError(
            f"differs from the controller's {controller.period:g} s",
            quantity="trajectory period [s]",
            value=period,
        )
    arrays = {
        f"trajectory {name}": getattr(trajectory, name) for name in ("position", "velocity", "acceleration")
    }
    if trajectory.torque is not None:
        arrays["trajectory torque [N m]"] = trajectory.torque
    if scenario.external is not None:
        arrays["external torque [N m]"] = scenario.external
    for quantity, array in arrays.items():
        if np.shape(array) != shape:
            raise InputError(f"must have shape {shape}", quantity=quantity, value=np.shape(array))
        if not np.isfinite(array).all():
            raise InputError("must be finite", quantity=quantity)


def _drives(scenario: Scenario) -> NDArray[np.void]:
    """The plant's drives with their controllers, sampling and noise seeds."""
    plant, controller = scenario.plant, scenario.controller
    drives = plant.drives.copy()
    if controller is not None:
        for i, name in enumerate(controller.joints):
            drives["control"][plant.robot.index(name)] = i
        drives["average"] = controller.sampling == "average"
    for drive, spec in zip(drives, plant.robot.drives, strict=True):
        if drive["control"] < 0 and spec.servo is None:
            raise InputError(
                "is neither in the controller nor has it a servo; add one or the other",
                file=plant.robot.file,
                joint=spec.name,
            )
    drives["rng"] = np.random.SeedSequence(scenario.seed).generate_state(len(drives), np.uint64)
    return drives


def run(scenario: Scenario) -> Recording:
    """Runs one scenario; the same scenario gives the same bits on any number of threads.

    Raises:
        InputError: Periods, shapes or joints of plant, controller and trajectory do not fit together.
    """
    _check(scenario)
    plant, controller, trajectory = scenario.plant, scenario.controller, scenario.trajectory
    ticks, n = trajectory.position.shape
    steps = round(trajectory.period / plant.timestep)
    drives = _drives(scenario)
    # A fresh native controller: scenarios that share one must not share its state.
    core = _native.Core(controller.blocks.view(np.uint8)) if controller else None
    external = scenario.external
    if external is not None:
        external = np.ascontiguousarray(external, float)
    data = mujoco.MjData(plant.model)
    events = _events(scenario)
    _start(scenario, core, events, data)
    mujoco.mj_forward(plant.model, data)
    torque = np.zeros((ticks, n)) if trajectory.torque is None else trajectory.torque
    reference = np.stack([trajectory.position, trajectory.velocity, trajectory.acceleration, torque])
    record = np.full((len(CHANNELS), ticks, n), np.nan)
    status = np.zeros(ticks, np.int32)
    outcome, tick = _native.run(
        core,
        drives.view(np.uint8),
        events.view(np.uint8),
        _mj_step(),
        plant.model._address,
        data._address,
        data.qpos,
        data.qvel,
        data.qfrc_applied,
        plant.timestep,
        steps,
        ticks,
        np.ascontiguousarray(reference),
        external,
        record,
        status,
    )
    time = trajectory.time
    settings: dict[str, object] = {
        "robot": plant.robot.name,
        "period": trajectory.period,
        "timestep": plant.timestep,
        "seed": scenario.seed,
        "label": scenario.label,
    }
    return Recording(
        plant.robot.joints,
        time,
        trajectory.position,
        **dict(zip(CHANNELS, record, strict=True)),
        status=status,
        diverged_at=float(time[tick]) if outcome else None,
        settings=settings,
    )


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
    seed: int = 0,
) -> Recording:
    """Builds the plant and the controller and runs once: the short way for one scenario."""
    from dashpot.rivals.gravity import with_feedforward

    trajectory = with_feedforward(robot, config, trajectory)
    plant = build(robot, trajectory.period, payloads)
    controller = Controller.from_config(config, robot.drives) if config else None
    return run(Scenario(plant, controller, trajectory, events, seed=seed))
