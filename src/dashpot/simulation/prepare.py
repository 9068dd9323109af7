"""One scenario ready to run: checked, its native parts built, at rest where it starts; and its recording."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

import dashpot._native as _native
from dashpot.arm.plant import Plant, with_payload, with_timestep
from dashpot.control.controller import MODES
from dashpot.control.sampled import BLOCK_DTYPE, empty_block
from dashpot.control.supervisor import STATES, SupervisorSettings, decisions, native_guard
from dashpot.control.thresholds import watch_records
from dashpot.errors import InputError
from dashpot.simulation.compensation import Gravity, compensation
from dashpot.simulation.equilibrium import Equilibrium, settle
from dashpot.simulation.recording import CHANNELS, Recording
from dashpot.simulation.remember import Remembered
from dashpot.simulation.script import Clock, native_faults, sensor_streams, tick_of
from dashpot.simulation.trajectory import Trajectory
from dashpot.support.arrays import Floats

if TYPE_CHECKING:
    from dashpot.simulation.simulate import PayloadChange, Scenario

EVENT_DTYPE = np.dtype([("tick", "i4"), ("joint", "i4"), ("kind", "i4"), ("value", "i4")])
BEYOND = 0.1  # [rad] past the stops, which yield
_KINDS = {"mode": 0, "position_loop": 1, "warm_start": 2}


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
        tick = tick_of(event.time, trajectory, "event time", event.joint)
        value = MODES.index(str(event.value)) if event.kind == "mode" else int(bool(event.value))
        names = controller.joints if event.joint == "all" else (event.joint,)
        rows += [(tick, controller.index(name), _KINDS[event.kind], value) for name in names]
    rows.sort(key=lambda row: row[0])
    return np.array(rows, EVENT_DTYPE)


def equilibrium(scenario: Scenario, plant: Plant | None = None) -> Equilibrium | None:
    """Rest at the first reference, from which a scenario starts; None: there is none."""
    plant = plant or scenario.plant
    return _equilibrium(scenario, plant, _events(scenario))


def _equilibrium(
    scenario: Scenario,
    plant: Plant,
    events: NDArray[np.void],
    gravity: Gravity | None = None,
    remembered: Remembered | None = None,
) -> Equilibrium | None:
    controller, reference = scenario.controller, scenario.trajectory.position[0]
    joints = controller.joints if controller else ()
    blocks = controller.blocks if controller else np.zeros(0, BLOCK_DTYPE)
    modes = {joint: "active" for joint in joints}
    for event in events:
        if event["tick"] == 0 and event["kind"] == _KINDS["mode"]:
            modes[joints[event["joint"]]] = MODES[event["value"]]
    if "off" in modes.values():
        return None
    bypass = tuple(j for j, mode in modes.items() if mode == "bypass")
    torque = None if scenario.trajectory.torque is None else scenario.trajectory.torque[0]

    def find() -> Equilibrium | None:
        own = gravity or compensation(scenario, plant)
        return settle(plant, joints, blocks, reference, bypass, torque, own.torque if own else None)

    if remembered is None:
        return find()
    values = (reference.tobytes(), None if torque is None else torque.tobytes(), bypass, scenario.carried)
    return remembered.of((scenario.plant, controller), ("equilibrium", *values), find)


def _delay_lines(blocks: NDArray[np.void]) -> NDArray[np.void]:
    """What a robot does with torques that come over a link: they take effect `latency` ticks later."""
    lines = np.array([empty_block()] * len(blocks))
    lines["latency"] = blocks["latency"]
    return lines


def _table(trajectory: Trajectory) -> Floats:
    """The references as the native loop reads them, (4, ticks, n)."""
    torque = np.zeros_like(trajectory.position) if trajectory.torque is None else trajectory.torque
    return np.stack([trajectory.position, trajectory.velocity, trajectory.acceleration, torque], dtype=float)


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


def _drives(scenario: Scenario, plant: Plant) -> NDArray[np.void]:
    """The plant's drives with their controllers, sampling and noise seeds."""
    controller = scenario.controller
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
    drives["rng"] = sensor_streams(scenario.seed, len(drives))
    return drives


def encoder_ranges(plant: Plant) -> dict[str, tuple[float, float]]:
    """Joint -> angles [rad] beyond which an encoder cannot be right."""
    drives = plant.drives
    return {
        name: (float(drives["stop_lower"][i]) - BEYOND, float(drives["stop_upper"][i]) + BEYOND)
        for i, name in enumerate(plant.robot.joints)
    }


def check(scenario: Scenario) -> None:
    """Checks a scenario without running it.

    Raises:
        InputError: As `dashpot.simulation.simulate.run` would.
    """
    plant, controller = scenario.plant, scenario.controller
    _check(scenario)
    _drives(scenario, plant)
    _events(scenario)
    controlled = controller.joints if controller else ()
    for change in scenario.payload_changes:
        tick_of(change.time, scenario.trajectory, "payload change")
    native_faults(scenario.faults, plant, controlled, scenario.trajectory, scenario.seed)


def loads(
    plant: Plant, changes: Sequence[PayloadChange], clock: Clock
) -> tuple[list[tuple[int, Any]], Plant]:
    """Ticks and models of changes of payload, in order, and the plant to start with, all at one time step.

    Raises:
        InputError: A change is outside the clock's ticks, or the arm cannot be simulated with that payload.
    """
    found = []
    for change in changes:
        tick = tick_of(change.time, clock, "payload change")
        found.append((tick, with_payload(plant, change.payload, clock.period)))
    found.sort(key=lambda change: change[0])
    step = min([plant.timestep, *(loaded.timestep for _, loaded in found)])
    if step < plant.timestep:
        plant = with_timestep(plant, step)
    models = []
    for tick, loaded in found:
        model = loaded.model
        if model.opt.timestep != step:
            model = copy.copy(model)
            model.opt.timestep = step
        models.append((tick, model))
    return models, plant


class Prepared:
    """A scenario with all that is native in it but the physics.

    Attributes:
        scenario: What is to run.
        ticks: Of the whole run.
        tick: The next one.
        core: The native controller, or None.
        guard: The native supervisor, or None.
        faults: The native faults, or None.
        diverged: Tick at which the simulation blew up, or None.
    """

    def __init__(
        self,
        scenario: Scenario,
        link: _native.Link | None = None,
        gravity: Gravity | None = None,
        remembered: Remembered | None = None,
    ) -> None:
        """Prepares a run.

        Args:
            scenario: What to run.
            link: The controller is at its other end; the scenario's says how the arm starts, and no
                supervisor runs here.
            gravity: The robot's own gravity compensation, if somebody has it already.
            remembered: Where scenarios that have plant and controller in common find what others have
                computed; neither may be changed.

        Raises:
            InputError: As `dashpot.simulation.simulate.run`.
        """
        _check(scenario)
        self.scenario, trajectory = scenario, scenario.trajectory
        self.ticks, n = trajectory.position.shape
        self.tick = 0
        self.diverged: int | None = None
        self._models, self._plant = loads(scenario.plant, scenario.payload_changes, trajectory)
        plant, controller = self._plant, scenario.controller
        # A fresh native controller: scenarios that share one must not share its state.
        self._link, self.core = link, None
        if controller is not None:
            blocks = controller.blocks if link is None else _delay_lines(controller.blocks)
            self.core = _native.Core(blocks.view(np.uint8))
        self._drives, self._events = _drives(scenario, plant), _events(scenario)
        self.faults: _native.Faults | None = None
        self.guard: _native.Guard | None = None
        if scenario.supervisor is not None and link is None:
            self.guard = self._guard(scenario.supervisor, remembered)
        # By the script a supervisor closes the brakes.
        if scenario.faults or self.guard is not None or link is not None:
            controlled = controller.joints if controller else ()
            self.faults = native_faults(scenario.faults, plant, controlled, trajectory, scenario.seed)
        self._qpos, self._qvel = np.array(plant.model.qpos0), np.zeros(plant.model.nv)
        self._start(_equilibrium(scenario, plant, self._events, gravity, remembered))
        if remembered is None:
            self._reference = _table(trajectory)
        else:
            self._reference = remembered.of((trajectory,), "reference", lambda: _table(trajectory))
        external = scenario.external
        self._external = None if external is None else np.ascontiguousarray(external, float)
        self._record = np.full((len(CHANNELS), self.ticks, n), np.nan)
        self._status = np.zeros(self.ticks, np.int32)

    def _guard(self, settings: SupervisorSettings, remembered: Remembered | None) -> _native.Guard:
        plant, controller = self._plant, self.scenario.controller
        if controller is None or self.core is None:
            raise InputError("needs a controller to supervise", quantity="supervisor")

        def find() -> NDArray[np.void]:
            return watch_records(controller, plant.robot.drives, settings, encoder_ranges(plant))

        if remembered is None:
            return native_guard(self.core, find(), settings, controller.period)
        watch = remembered.of((self.scenario.plant, controller), ("watch", settings), find)
        return native_guard(self.core, watch, settings, controller.period)

    def _start(self, found: Equilibrium | None) -> None:
        """At rest in equilibrium with the first reference; where there is none, at it with slack springs."""
        plant, controller = self._plant, self.scenario.controller
        if found is None:
            self._qpos[plant.rotor_qpos] = self.scenario.trajectory.position[0]
            return
        self._qpos[plant.rotor_qpos] = found.rotor
        self._qpos[plant.drives["spring_qpos"]] = found.deflection
        assert self.core is not None or controller is None
        for i, joint in enumerate(controller.joints if controller else ()):
            self.core.preset(i, found.states[i], found.torque[plant.robot.index(joint)])  # type: ignore[union-attr]

    def recording(self) -> Recording:
        """What happened so far; rows that have not been run are NaN."""
        scenario, plant, trajectory = self.scenario, self._plant, self.scenario.trajectory
        time = trajectory.time
        settings: dict[str, object] = {
            "robot": plant.robot.name,
            "period": trajectory.period,
            "timestep": plant.timestep,
            "seed": scenario.seed,
            "label": scenario.label,
        }
        if scenario.carried:
            settings["gravity_compensation"] = True
        if scenario.faults:
            settings["faults"] = [fault.table() for fault in scenario.faults]
        if scenario.payload_changes:
            settings["payload_changes"] = [change.table() for change in scenario.payload_changes]
        if self.guard is not None and scenario.controller is not None:
            log = decisions(self.guard, scenario.controller.joints, trajectory.period)
            settings["supervisor"] = {
                "state": STATES[self.guard.state],
                "apply_brake": self.guard.apply_brake,
                "stopped": self.guard.stopped,
                "decisions": [{**vars(d), "time": d.time + trajectory.start} for d in log],
            }
        return Recording(
            plant.robot.joints,
            time,
            trajectory.position,
            **dict(zip(CHANNELS, self._record, strict=True)),
            status=self._status,
            diverged_at=None if self.diverged is None else float(time[self.diverged]),
            settings=settings,
        )
