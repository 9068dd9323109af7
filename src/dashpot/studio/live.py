"""A simulated arm that runs on for as long as somebody watches, and is changed while it runs.

It is the loop of `dashpot.simulation.simulate` with its tables cut into windows of some ticks: where
nothing is changed the bits are the same.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from dashpot.arm.payload import Payload
from dashpot.arm.plant import Plant
from dashpot.arm.robot import Robot
from dashpot.control.controller import MODES, Controller, ControllerConfig, Mode
from dashpot.control.sampled import (
    NW,
    POSITION,
    POSITION_REF,
    TORQUE,
    TORQUE_REF,
    VELOCITY,
    VELOCITY_REF,
)
from dashpot.control.supervisor import STATES, Decision, State, SupervisorSettings, decisions, native_guard
from dashpot.control.thresholds import watch_records
from dashpot.errors import InputError
from dashpot.simulation.compensation import compensation
from dashpot.simulation.equilibrium import settle
from dashpot.simulation.faults import Fault
from dashpot.simulation.loop import Loop, carry
from dashpot.simulation.recording import CHANNELS
from dashpot.simulation.release import tracking_events
from dashpot.simulation.script import native_faults
from dashpot.simulation.simulate import Scenario
from dashpot.simulation.trajectory import Trajectory
from dashpot.studio.failing import Failing
from dashpot.studio.feedforward import Feedforward
from dashpot.studio.handover import hand_over, retuned
from dashpot.studio.push import Push, Taps
from dashpot.studio.references import Hold, Reference
from dashpot.studio.refine import refined
from dashpot.studio.window import Window
from dashpot.support.arrays import Floats

TRACK: State = "track"


class LiveArm(Loop):
    """One arm under one controller.

    Attributes:
        robot: The arm.
        config: Its controller as it is now.
        controller: The same, built.
        payloads: What hangs on the flange.
        reference: Where the arm is to be; set it with `follow`.
        push: A force on a link, or None.
        window: The last one.
    """

    def __init__(
        self,
        robot: Robot,
        config: ControllerConfig,
        plant: Plant,
        reference: Reference,
        *,
        payloads: Sequence[Payload] = (),
        supervisor: SupervisorSettings | None = None,
        seed: int = 0,
        carried: bool = False,
        like: LiveArm | None = None,
    ) -> None:
        """Starts at rest, in equilibrium with the reference, or as another arm moves.

        Args:
            robot: The arm.
            config: Its controller.
            plant: The arm with its payload, for the controller's period (`dashpot.arm.plant.build`).
            reference: From tick 0 on.
            payloads: Those of the plant.
            supervisor: Runs in place of the bare controller; None: none does.
            seed: Of sensor noise and dropped samples.
            carried: Whether the robot's own gravity compensation is on, where it has one.
            like: An arm of the same joints whose motion is taken over.

        Raises:
            InputError: The parts do not fit together.
        """
        self.robot, self.config, self.reference = robot, config, reference
        self.payloads = tuple(payloads)
        self.controller = Controller.from_config(config, robot.drives)
        self._feedforward = Feedforward(robot, config)
        self._since = 0
        self.push: Push | None = None
        self._taps = Taps()
        self._said = 0
        self._frozen: Floats | None = None
        first = self._rows(np.zeros(1, np.int64))
        start = Trajectory(config.period, first[0], first[1], first[2], torque=first[3])
        events = tracking_events(config, 0.0)
        super().__init__(
            Scenario(
                plant, self.controller, start, events,
                seed=seed, supervisor=supervisor, gravity_compensation=carried,
            )
        )  # fmt: skip
        if self.faults is None:
            self.faults = native_faults((), plant, self.controller.joints, start, seed)
        self._failing = Failing(self.faults, self.controller.joints, start, seed)
        self._supervisor = supervisor
        self._modes: dict[str, tuple[Mode, bool]] = {
            joint: ("active", True) for joint in self.controller.joints
        }
        for event in events:
            self._modes[event.joint] = ("bypass", True)
        self.window = Window(
            0,
            np.zeros((len(CHANNELS), 1, len(robot.drives))),
            first[0],
            0 * first[0],
            np.zeros(1, np.int32),
            0.0,
        )
        if like is not None:
            self._move_like(like)

    # What is seen.

    @property
    def plant(self) -> Plant:
        """The arm as it is simulated, with its present load."""
        return self._plant

    @property
    def model(self) -> mujoco.MjModel:
        """The MuJoCo model with the present load."""
        return self._model

    @property
    def data(self) -> mujoco.MjData:
        """Its state; between two windows only."""
        return self._data

    @property
    def time(self) -> float:
        """Since the start [s]."""
        return self.tick * self.config.period

    @property
    def state(self) -> State:
        """The supervisor's; "track" without one."""
        return STATES[self.guard.state] if self.guard else TRACK

    @property
    def carried(self) -> bool:
        """Whether the robot carries its own weight, below the controller."""
        return self._gravity is not None

    @property
    def brake_closed(self) -> bool:
        """Whether the supervisor has told the mechanical brakes to close."""
        return bool(self.guard and self.guard.apply_brake)

    @property
    def stopped(self) -> bool:
        """Whether a brake has been seen to bring the arm to rest."""
        return bool(self.guard and self.guard.stopped)

    def mode(self, joint: str) -> tuple[Mode, bool]:
        """Mode of a joint and whether its position loop is on, as they have been set."""
        return self._modes[joint]

    def news(self) -> list[Decision]:
        """What the supervisor has decided since the last call; times on this arm's clock."""
        if self.guard is None:
            return []
        log = decisions(self.guard, self.controller.joints, self.config.period)
        fresh = self.guard.decisions - self._said
        self._said = self.guard.decisions
        return (
            [replace(d, time=d.time + self._guarded_from) for d in log[len(log) - fresh :]] if fresh else []
        )

    def reference_now(self) -> Floats:
        """Position, velocity and acceleration reference of the coming tick, (3, n)."""
        return np.asarray(self._rows(np.array([self.tick]))[:3, 0])

    def law_state(self, i: int) -> Floats:
        """State of the i-th controlled joint's block."""
        assert self.core is not None
        return np.array(self.core.joint_state(i)[5])

    # What is done to it.

    def follow(self, reference: Reference) -> None:
        """Follows a reference from the coming tick on."""
        self.reference, self._since = reference, self.tick

    def tap(self, joint: int, torque: float, duration: float) -> None:
        """Knocks a link: an external torque [N m] for a duration [s]."""
        ticks = max(1, round(duration / self.config.period))
        self._taps.give(self.tick, ticks, joint, torque)

    def set_mode(self, joint: str, mode: Mode, position_loop: bool) -> None:
        """Sets a joint off, to bypass (position loop only) or active, and its position loop on or off.

        Raises:
            InputError: The supervisor has stopped the arm, or there is no such joint.
        """
        i = self.controller.index(joint)
        self._refuse_if_stopped(joint)
        assert self.core is not None
        self.core.set_mode(i, MODES.index(mode))
        self.core.set_position_loop(i, position_loop)
        self._modes[joint] = (mode, position_loop)

    def warm_start(self, joint: str) -> None:
        """Sets the law's velocity from the rotor's, so that the brake bites at once."""
        assert self.core is not None
        dof = self.plant.rotor_dof[self.robot.index(joint)]
        self.core.warm_start(self.controller.index(joint), float(self._data.qvel[dof]))

    def retune(self, config: ControllerConfig) -> None:
        """Goes on with other numbers: the torque fades from the old law's to the new one's over `blend`.

        A law whose numbers change begins in the equilibrium of its present inputs.

        Raises:
            InputError: Another period or other joints (they need a new arm), or the supervisor has stopped
                it.
        """
        if config.period != self.config.period or [j.name for j in config.joints] != list(
            self.controller.joints
        ):
            raise InputError("another period or other joints need a new arm", quantity="controller")
        controller = Controller.from_config(config, self.robot.drives)
        self._refuse_if_stopped()
        assert self.core is not None
        inputs = self._inputs()[[self.robot.index(name) for name in controller.joints]]
        new = retuned(self.core, self.controller, controller, inputs)
        self.config, self.controller, self.core = config, controller, new
        self.scenario = replace(self.scenario, controller=controller)
        self._feedforward = Feedforward(self.robot, config)
        self._drives["average"] = controller.sampling == "average"
        self.supervise(self._supervisor)

    def supervise(self, settings: SupervisorSettings | None) -> None:
        """Puts a fresh supervisor in charge, or none; modes and position loops are as they were set."""
        assert self.core is not None
        assert self.faults is not None
        stopped = self.state != TRACK
        self._supervisor, self.guard = settings, None
        self.faults.apply_brake = False
        self.faults.stopped_at = -1
        self._frozen = None
        if stopped:
            for joint, (mode, loop) in self._modes.items():
                self.core.set_mode(self.controller.index(joint), MODES.index(mode))
                self.core.set_position_loop(self.controller.index(joint), loop)
        if settings is not None:
            ranges = {
                name: (float(d["stop_lower"]) - 0.1, float(d["stop_upper"]) + 0.1)
                for name, d in zip(self.robot.joints, self._drives, strict=True)
            }
            watch = watch_records(self.controller, self.robot.drives, settings, ranges)
            self.guard = native_guard(self.core, watch, settings, self.config.period)
        self._said = 0
        self._guarded_from = self.time

    _guarded_from = 0.0

    def stop(self) -> None:
        """Asks the supervisor for a stop; nothing without one."""
        if self.guard is not None:
            self.guard.stop(1)

    def resume(self) -> None:
        """Tracking again where the arm is: every signal trusted, brakes open, the load taken over at once."""
        self.supervise(self._supervisor)
        here = np.array(self._data.qpos[self.plant.rotor_qpos])
        blocks, joints = self.controller.blocks, self.controller.joints
        bypass = [joint for joint, (mode, _) in self._modes.items() if mode == "bypass"]
        carried = None if self._gravity is None else self._gravity.torque
        found = settle(self.plant, joints, blocks, here, bypass, carried=carried)
        target = here
        if found is not None:  # where to be told to be, so as to sag to here
            target = 2 * here - found.rotor
            found = settle(self.plant, joints, blocks, target, bypass, carried=carried)
        assert self.core is not None
        for i, joint in enumerate(joints):
            if found is not None:
                self.core.preset(i, found.states[i], float(found.torque[self.robot.index(joint)]))
        self.follow(Hold(target))

    def compensate(self, on: bool) -> None:
        """Switches the robot's own gravity compensation; the controller hands the weight over, or takes it.

        Raises:
            InputError: The robot has none, or the supervisor has stopped the arm.
        """
        if on == self.carried:
            return
        if not self.robot.gravity_compensation:
            raise InputError("the robot has none", quantity="gravity compensation")
        self._refuse_if_stopped()
        assert self.core is not None
        self.scenario = replace(self.scenario, gravity_compensation=on)
        before, self._gravity = self._gravity, compensation(self.scenario, self._plant)
        own = self._gravity or before
        assert own is not None
        weight = own.torque(np.array(self._data.qpos[self.plant.rotor_qpos])) * (1 if on else -1)
        inputs = self._inputs()
        for i, name in enumerate(self.controller.joints):
            j = self.robot.index(name)
            _, loop, _, in_effect, _, _ = self.core.joint_state(i)
            inputs[j, TORQUE] -= weight[j]
            hand_over(self.core, i, self.controller.blocks[i], inputs[j], in_effect - weight[j], loop)
        if not on:
            self._drives["gravity"] = 0.0
        self.supervise(self._supervisor)

    def carry(self, loaded: Plant, payloads: Sequence[Payload]) -> None:
        """Carries other loads from now on, with a shorter time step where their plant needs one."""
        if loaded.timestep < self.plant.timestep * (1 - 1e-12):
            self._plant = refined(self.plant, self._drives, loaded.timestep, self.config.period, self.tick)
        model = loaded.model
        if model.opt.timestep != self.plant.timestep:
            model = copy.copy(model)
            model.opt.timestep = self.plant.timestep
        self._model, self._data = model, carry(model, self._data)
        self._plant = replace(self._plant, model=model)
        self.payloads = tuple(payloads)

    def begin(self, fault: Fault) -> list[int]:
        """Lets something fail from the coming tick on; returns its places in the script, for `end`.

        Raises:
            InputError: The fault does not fit the arm, or too many act at once.
        """
        return self._failing.begin(fault, self.plant, self.tick)

    def end(self, places: Sequence[int]) -> None:
        """Ends what `begin` has begun."""
        self._failing.end(places)

    def go_on(self, ticks: int) -> Window:
        """Runs some ticks."""
        assert self.faults is not None
        when = self.tick + np.arange(ticks)
        rows = np.ascontiguousarray(self._rows(when))
        n = rows.shape[2]
        external = self._taps.torque(when, n)
        if self.push is not None:
            pushed = self.push.torque(self._model, self._data)[self.plant.rotor_dof]
            external = (np.zeros((ticks, n)) if external is None else external) + pushed
        record = np.full((len(CHANNELS), ticks, n), np.nan)
        status = np.zeros(ticks, np.int32)
        origin = self.tick
        self._run(origin + ticks, (rows, external, record, status), origin)
        if self.state != TRACK and self._frozen is None:
            at = min(max(self.faults.stopped_at - origin, 0), ticks - 1)
            self._frozen = rows[:, at].copy()
            self._frozen[1:3] = 0.0
        work = 0.0
        if external is not None:
            link = record[CHANNELS.index("link_position")]
            moved = np.diff(np.vstack([link, self._link_angles()]), axis=0)
            work = float((external * moved).sum())
        self.window = Window(
            origin, record, rows[0], np.zeros_like(rows[0]) if external is None else external, status, work
        )
        return self.window

    def energy(self) -> tuple[float, float]:
        """Kinetic energy, rotors included, and potential energy of gravity and springs [J]."""
        mujoco.mj_energyPos(self._model, self._data)
        mujoco.mj_energyVel(self._model, self._data)
        return float(self._data.energy[1]), float(self._data.energy[0])

    # Inside.

    def _link_angles(self) -> Floats:
        return np.asarray(
            self._data.qpos[self.plant.rotor_qpos] + self._data.qpos[self.plant.drives["spring_qpos"]]
        )

    def _rows(self, ticks: NDArray[np.int64]) -> Floats:
        if self._frozen is not None:
            return np.repeat(self._frozen[:, None], len(ticks), axis=1)
        rows = self.reference.at(ticks - self._since)
        return self._feedforward.added(rows)

    def _inputs(self) -> Floats:
        """What every joint's law saw last, (n, NW); torque in effect left out."""
        window, inputs = self.window, np.zeros((len(self.robot.drives), NW))
        rows = self._rows(np.array([max(self.tick - 1, 0)]))[:, 0]
        inputs[:, TORQUE], inputs[:, POSITION] = window.last("sample"), window.last("position")
        inputs[:, VELOCITY] = window.last("velocity")
        inputs[:, POSITION_REF], inputs[:, VELOCITY_REF], inputs[:, TORQUE_REF] = rows[0], rows[1], rows[3]
        return np.nan_to_num(inputs)

    def _refuse_if_stopped(self, joint: str | None = None) -> None:
        if self.state != TRACK:
            raise InputError("the supervisor has stopped the arm; resume first", joint=joint)

    def _move_like(self, other: LiveArm) -> None:
        for name in ("qpos", "qvel", "qacc_warmstart"):
            getattr(self._data, name)[:] = getattr(other._data, name)
        mujoco.mj_forward(self._model, self._data)
        assert self.core is not None
        assert other.core is not None
        inputs = other._inputs()
        for i, joint in enumerate(self.controller.joints):
            j = self.robot.index(joint)
            torque = float(np.nan_to_num(other.window.last("in_effect")[j]))
            hand_over(self.core, i, self.controller.blocks[i], inputs[j], torque)
