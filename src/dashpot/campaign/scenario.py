"""From a specification and an index to the scenario: the same one on any machine, in any order."""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import math
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from threading import Lock
from typing import Any, TypeVar

import numpy as np

from dashpot.arm.payload import Payload
from dashpot.arm.plant import Plant, build
from dashpot.arm.robot import Robot
from dashpot.campaign.axes import ADDED, NO_FAULT
from dashpot.campaign.blame import of_name
from dashpot.campaign.checks import check_campaign
from dashpot.campaign.measures import measure
from dashpot.campaign.script import Script
from dashpot.campaign.spec import Spec
from dashpot.certify.testbench import tap
from dashpot.control.controller import Controller, ControllerConfig, load_controller
from dashpot.control.supervisorsettings import SupervisorSettings
from dashpot.errors import InputError
from dashpot.logs.motionfile import read_motion
from dashpot.simulation.feedforward import with_feedforward
from dashpot.simulation.recording import Recording
from dashpot.simulation.release import release_events, tracking_events
from dashpot.simulation.remember import Remembered
from dashpot.simulation.simulate import Scenario
from dashpot.simulation.trajectory import Trajectory, hold, multisine
from dashpot.support.arrays import Floats

DURATION = 6.0  # [s], as of `dashpot simulate`
MAX_TICKS = 1_000_000  # of one recording: about 1 GB of memory for seven joints
KEPT = 16  # plants, controllers and trajectories that are kept for the next scenario
APART = 0.1  # [rad] of random poses from the stops, beside the amplitude of the motion
POSES = 7  # stream of random numbers for poses, apart from the sample's
T = TypeVar("T")

OK, DIVERGED, FAILED = 1, 2, 3
"""Status of a scenario that is done; 0: not yet."""


@dataclass(frozen=True)
class Setting:
    """One scenario in words: the value of every axis and of what is no axis.

    Attributes:
        index: Its index in the campaign.
        values: Axis name -> value.
        payload: On the flange.
        seed: Of the sensor noise.
        event: Time of the release, first fault or first change of payload [s], or None.
    """

    index: int
    values: Mapping[str, Any]
    payload: Payload
    seed: int
    event: float | None


class Campaign:
    """A specification with its robot and controllers, checked, that gives scenarios by index.

    Attributes:
        spec: The specification.
        robot: The nominal robot.
        configs: Controllers by the name the specification gives them.
        digests: SHA-256 of every file that decides the outcome.
        digest: Of everything that decides the outcome.
        remembered: What scenarios of the same plant and controller have in common.
    """

    def __init__(self, spec: Spec) -> None:
        self.spec = spec
        with of_name(spec.file, "robot", spec.robot):
            self.robot = Robot.load(_file(spec, spec.robot))
        self.configs = {}
        for name in spec.controllers:
            with of_name(spec.file, "controller", name):
                self.configs[name] = load_controller(_file(spec, name))
        self.digests = _digests(spec, self.robot, self.configs)
        whole = json.dumps([spec.resolved, self.digests, versions()], sort_keys=True)
        self.digest = hashlib.sha256(whole.encode()).hexdigest()
        self._forget()

    def _forget(self) -> None:
        self._kept: dict[str, OrderedDict[Any, Any]] = {}
        self._lock = Lock()
        self.remembered = Remembered()

    def __getstate__(self) -> dict[str, Any]:
        drop = ("_kept", "_lock", "remembered", "sample", "scripts")
        return {name: value for name, value in self.__dict__.items() if name not in drop}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._forget()

    def _keep(self, kind: str, key: Any, make: Callable[[], T]) -> T:
        """What `make` gives, from memory where the key was asked for lately."""
        with self._lock:
            kept = self._kept.setdefault(kind, OrderedDict())
            if key in kept:
                kept.move_to_end(key)
                return kept[key]  # type: ignore[no-any-return]
        made = make()
        with self._lock:
            kept[key] = made
            while len(kept) > KEPT:
                kept.popitem(last=False)
        return made

    @cached_property
    def sample(self) -> Floats:
        """The sample in the unit cube, (count, dimensions)."""
        return self.spec.points(len(self.robot.joints))

    @cached_property
    def scripts(self) -> dict[str, Script]:
        """The fault axis: name -> what happens.

        Raises:
            InputError: A fault is not one that this version simulates.
        """
        found = {NO_FAULT: Script()}
        if self.spec.has("fault"):
            for value in self.spec.axis("fault").values:
                if value != NO_FAULT:
                    found[value["name"]] = Script.from_value(value, self.spec.file)
        return found

    def values(self, index: int) -> dict[str, Any]:
        """Value of every axis in a scenario.

        Raises:
            InputError: There is no such index.
        """
        spec = self.spec
        if type(index) is not int or not 0 <= index < spec.size:
            raise InputError(f"must be 0 to {spec.size - 1}", file=spec.file, quantity="index", value=index)
        at = [int(i) for i in np.unravel_index(index, spec.shape)]
        found: dict[str, Any] = {}
        if spec.sampled:
            row, column = self.sample[at.pop(0)].tolist(), 0
            for axis in spec.sampled:
                width = len(self.robot.joints) if axis.each_joint else 1
                drawn = tuple(axis.at(share) for share in row[column : column + width])
                found[axis.name], column = drawn if axis.each_joint else drawn[0], column + width
        found |= {axis.name: axis.values[i] for axis, i in zip(spec.grid, at, strict=False)}
        return {axis.name: found[axis.name] for axis in spec.axes}

    def setting(self, index: int, values: Mapping[str, Any] | None = None) -> Setting:
        """What a scenario is about."""
        spec, values = self.spec, self.values(index) if values is None else values
        times = [] if spec.release is None else [spec.release]
        times += self.scripts[_fault_label(values)].times
        payload = Payload(values.get("payload", 0.0), values.get("offset", 0.0))
        return Setting(index, values, payload, values.get("seed", 0), min(times) if times else None)

    def scenario(self, index: int) -> Scenario:
        """The scenario of an index.

        Raises:
            DashpotError: It cannot be built.
        """
        return self.assemble(self.setting(index))

    def assemble(self, setting: Setting) -> Scenario:
        """The scenario of a setting."""
        spec, values = self.spec, setting.values
        name = values.get("controller", spec.controllers[0])
        period = self.configs[name].period
        plant = self._plant(values, setting.payload, period)
        gains = tuple((key, value) for key, value in values.items() if key.startswith("gains."))
        controller = self._keep("controller", (name, gains), lambda: self._controller(name, gains))
        moved = tuple(values.get(key) for key in ("pose", "amplitude", "trajectory"))
        plain = self._keep("path", (period, moved), lambda: self._path(values, period))
        config = self.config(name, gains)
        carried = spec.gravity_compensation and self.robot.gravity_compensation
        path = self._keep(
            "fed",
            (name, gains, period, moved),
            lambda: with_feedforward(self.robot, config, plain, carried=carried),
        )
        events = tracking_events(config, path.start)
        if spec.release is not None:
            events += release_events(config, spec.release)
        external = tap(path, len(self.robot.joints), spec.tap) if spec.tap else None
        script = self.scripts[_fault_label(values)]
        return Scenario(
            plant,
            controller,
            path,
            events,
            external,
            setting.seed,
            f"scenario {setting.index}",
            faults=script.faults_of(config),
            payload_changes=script.changes(setting.payload, spec.file),
            supervisor=self._keep("supervisor", (name, gains), lambda: self._supervisor(config)),
            gravity_compensation=spec.gravity_compensation,
        )

    def _plant(self, values: Mapping[str, Any], payload: Payload, period: float) -> Plant:
        errors = tuple((key, value) for key, value in values.items() if key.startswith("drive."))
        payloads = [payload] if payload.mass > 0 else []

        def make() -> Plant:
            return build(self.disturbed(dict(errors)), period, payloads)

        return self._keep("plant", (errors, payload, period), make)

    def disturbed(self, errors: Mapping[str, Any]) -> Robot:
        """The robot of the plant: its drives with the errors of ``drive.`` axes."""
        changes: dict[str, dict[str, Any]] = {}
        for key, value in errors.items():
            *joint, quantity = key.removeprefix("drive.").split(".")
            names = [".".join(joint)] if joint else list(self.robot.joints)
            parts = value if isinstance(value, tuple) else (value,) * len(names)
            for name, part in zip(names, parts, strict=True):
                own = changes.setdefault(name, {})
                nominal = own.get(quantity, getattr(self.robot.drives[self.robot.index(name)], quantity))
                own[quantity] = nominal + part if quantity in ADDED else nominal * part
        return self.robot.with_drives(changes)

    def _controller(self, name: str, gains: Sequence[tuple[str, float]]) -> Controller:
        return Controller.from_config(self.config(name, gains), self.robot.drives)

    def _supervisor(self, config: ControllerConfig) -> SupervisorSettings | None:
        settings = self.spec.supervisor
        return None if settings is None else replace(config.supervisor, **settings)

    def config(self, name: str, gains: Sequence[tuple[str, float]]) -> ControllerConfig:
        """A controller file with its gains multiplied."""
        config = self.configs[name]
        if not gains:
            return config
        joints = list(config.joints)
        for key, factor in gains:
            *joint, gain = key.removeprefix("gains.").split(".")
            wanted = ".".join(joint)
            if wanted and wanted not in [own.name for own in joints]:
                rule = f"{config.file} does not control it"
                raise InputError(rule, file=self.spec.file, joint=wanted, quantity=f"axes.{key}")
            for i, own in enumerate(joints):
                if wanted in ("", own.name):
                    joints[i] = replace(own, **{gain: getattr(own, gain) * factor})
        return replace(config, joints=tuple(joints))

    def pose(self, name: str) -> tuple[float, ...]:
        """A pose by its name [rad]."""
        spec, n = self.spec, len(self.robot.joints)
        if not (spec.random_poses and name.startswith("random")):
            angles = self.robot.home if name == "home" else spec.poses[name]
            if len(angles) != n:
                raise InputError(
                    f"must be {n} angles", file=spec.file, quantity=f"poses.{name} [rad]", value=angles
                )
            return tuple(angles)
        period = next(iter(self.configs.values())).period
        drives = self._keep("range", None, lambda: build(self.robot, period)).drives
        amplitude = self.spec.axis("amplitude").ends()[1] if spec.has("amplitude") else spec.amplitude
        margin = (amplitude if spec.motion == "multisine" else 0.0) + APART
        margin = margin if spec.pose_margin is None else spec.pose_margin
        low, high = (np.clip(drives[key], -math.pi, math.pi) for key in ("stop_lower", "stop_upper"))
        keep = np.minimum(margin, (high - low) / 2)
        rng = np.random.default_rng([spec.seed, POSES, int(name.removeprefix("random"))])
        return tuple(rng.uniform(low + keep, high - keep).tolist())

    def _path(self, values: Mapping[str, Any], period: float) -> Trajectory:
        spec = self.spec
        if spec.motion not in ("multisine", "hold"):
            path = spec.path(spec.motion)
            if not path.exists():
                raise InputError(
                    'must be "multisine", "hold" or a CSV file, and there is no such file',
                    file=spec.file,
                    quantity="motion",
                    value=spec.motion,
                )
            return read_motion(
                path, self.robot, period, lead_in=spec.lead_in, duration=spec.duration, most=MAX_TICKS
            )
        duration = DURATION if spec.duration is None else spec.duration
        if spec.lead_in + duration > MAX_TICKS * period:
            rule = f"must be at most {MAX_TICKS * period:g} s, {MAX_TICKS} ticks of {period:g} s"
            raise InputError(
                rule, file=spec.file, quantity="lead_in + duration [s]", value=spec.lead_in + duration
            )
        pose = self.pose(values.get("pose", "home"))
        if spec.motion == "hold":
            still = hold(pose, duration + spec.lead_in, period)
            return replace(still, start=-spec.lead_in)
        amplitude = values.get("amplitude", spec.amplitude)
        seed = values.get("trajectory", 0)
        return multisine(pose, duration, period, seed, amplitude=amplitude, lead_in=spec.lead_in)

    def check(self) -> None:
        """Checks every axis at its ends, before anything runs.

        Raises:
            DashpotError: A value is not valid, or a scenario there cannot be built.
        """
        check_campaign(self)

    def measure(self, setting: Setting, scenario: Scenario, recording: Recording) -> dict[str, Any]:
        """Measures of a run of a scenario (`dashpot.campaign.measures`)."""
        limits = np.array([drive.torque_limit for drive in self.robot.drives])
        joints = () if scenario.controller is None else scenario.controller.joints
        rates = np.array([drive.torque_rate_limit for drive in self.robot.drives])
        return measure(recording, setting.event, limits, joints, rates, scenario.plant.drives["stiffness"])


def versions() -> dict[str, str]:
    """Versions of what decides the bits of a simulation."""
    return {name: importlib.metadata.version(name) for name in ("dashpot", "mujoco", "numpy", "scipy")}


def _fault_label(values: Mapping[str, Any]) -> str:
    fault = values.get("fault", NO_FAULT)
    return NO_FAULT if fault == NO_FAULT else str(fault["name"])


def _file(spec: Spec, name: str) -> str:
    """A bundled name as it is, or a file relative to the specification."""
    path = spec.path(name)
    return str(path) if path.exists() and path.is_file() else name


def _digests(spec: Spec, robot: Robot, configs: Mapping[str, ControllerConfig]) -> dict[str, str]:
    read = {spec.robot: robot.file, **{name: config.file for name, config in configs.items()}}
    if robot.model is not None:
        read[f"{spec.robot}: {robot.model.name}"] = robot.model
    if spec.motion not in ("multisine", "hold"):
        read[spec.motion] = spec.path(spec.motion)
    return {
        name: hashlib.sha256(path.read_bytes()).hexdigest()
        for name, path in read.items()
        if path and Path(path).is_file()
    }
