"""The arms, laws and scenarios of `dashpot.studies.rivals_arms`."""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from dashpot.arm.dynamics import full_mass
from dashpot.arm.payload import Payload
from dashpot.arm.plant import Plant, build
from dashpot.arm.robot import Robot
from dashpot.control.controller import Controller, ControllerConfig, Law, load_controller
from dashpot.control.laws import law_from_table, to_table
from dashpot.errors import InputWarning
from dashpot.simulation.faults import Fault
from dashpot.simulation.simulate import Event, Scenario
from dashpot.simulation.trajectory import Trajectory, hold, multisine
from dashpot.studies.rivals_bench import Bench
from dashpot.studies.rivals_tuning import ASSUMED

AMPLITUDE, RAMP = 0.35, 0.6  # [rad] about home, and [s] in which the motion swells
LOST, WATCHED = 1.2, 6.0  # [s]: when all encoders are lost, and how long is watched then
TRACKED, REST = 3.0, 0.8  # [s] of a tracker's motion and of its rest
SETTINGS = {"amplitude": AMPLITUDE, "ramp": RAMP, "lost": LOST, "watched": WATCHED}
SETTINGS |= {"tracked": TRACKED, "rest": REST}
Laws = Mapping[str, Law]  # drive type -> law, its name a placeholder


@dataclass(frozen=True)
class Arm:
    """An arm of the comparison.

    Attributes:
        name: In tables.
        robot: Bundled robot.
        controller: Bundled virtual passive controller; the period and the controlled joints are its.
        types: Drive type -> the controlled joints that have it; one tuning each.
        payloads: On the flange, lightest first [kg]; the smallest stands for an empty tool.
        offset: Of their centre along the flange's x axis [m].
        balanced: Whether the arm's own weight is taken off it.
        period: Of the controllers, instead of the bundled one's [s].
        like: Name of the arm whose tuned and designed laws it takes over; empty: it has its own.
        share: One in how many motions is run; above 1, the arm is shown apart.
    """

    name: str
    robot: str
    controller: str
    types: Mapping[str, tuple[str, ...]]
    payloads: tuple[float, ...]
    offset: float
    balanced: bool = False
    period: float | None = None
    like: str = ""
    share: int = 1

    @property
    def joints(self) -> tuple[str, ...]:
        """Controlled joints, base to tip."""
        return tuple(joint for names in self.types.values() for joint in names)

    def __hash__(self) -> int:
        return hash(self.name)


_WRIST = {"wrist": ("joint5", "joint6", "joint7")}
_FR3 = {"large": ("joint1", "joint2", "joint3", "joint4"), "small": ("joint5", "joint6", "joint7")}
ARMS = (
    Arm("k807", "k807", "k807-wrist", _WRIST, (0.5, 2.0, 5.0), 0.23),
    Arm("fr3", "fr3", "fr3", _FR3, (0.5, 1.5, 3.0), 0.1, balanced=True),
    Arm("k807 at 1 kHz", "k807", "k807-wrist", _WRIST, (0.5, 2.0, 5.0), 0.23, period=1e-3, share=8),
    Arm("fr3 with its weight", "fr3", "fr3", _FR3, (0.5, 1.5, 3.0), 0.1, like="fr3", share=8),
)


@cache
def robot(arm: Arm) -> Robot:
    """The arm's description; a balanced one has each link's weight taken off where it acts."""
    return Robot.load(arm.robot)


@cache
def plant(arm: Arm, payload: float) -> Plant:
    """The elastic arm with a payload [kg]."""
    whole = robot(arm)
    period = bundled(arm).period
    loads = [Payload(payload, arm.offset)] if payload else []
    if not arm.balanced:
        return build(whole, period, loads)
    spec = mujoco.MjSpec.from_file(str(whole.model))
    for body in spec.bodies:
        body.gravcomp = 1.0  # of the links; payloads are hung on as bodies of their own
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "balanced.xml"
        path.write_text(spec.to_xml(), encoding="utf-8")
        return build(replace(whole, model=path), period, loads)


@cache
def benches(arm: Arm) -> dict[str, Bench]:
    """Drive type -> the joint on which its laws are tuned.

    Its link goes from the lightest with the smallest payload to the heaviest with the largest, its load up to
    the largest that weight puts on a joint of that type, all at home.
    """
    whole, config = robot(arm), bundled(arm)
    lightest, full = plant(arm, arm.payloads[0]), plant(arm, arm.payloads[-1])
    home = np.asarray(whole.home, float)
    load = np.abs(full.load_torque(home))
    light, heavy = (_link_inertia(one, home) for one in (lightest, full))
    found = {}
    for kind, names in arm.types.items():
        of = [whole.index(name) for name in names]
        least, most = float(light[of].min()), float(heavy[of].max())
        rounded = [float(f"{value:.3g}") for value in (least, most - least, load[of].max())]
        found[kind] = Bench(arm.robot, names[0], config.period, config.sampling, *rounded)
    return found


def _link_inertia(plant: Plant, pose: Any) -> Any:
    data = mujoco.MjData(plant.model)
    data.qpos[plant.rotor_qpos] = pose
    return np.diag(full_mass(plant.model, data))[plant.spring_dof]


def bundled(arm: Arm) -> ControllerConfig:
    """The hand-picked virtual passive controller, at the arm's period."""
    config = load_controller(arm.controller)
    return config if arm.period is None else replace(config, period=arm.period, file=None)


def config(arm: Arm, laws: Laws) -> ControllerConfig:
    """A law per drive type on every joint of it."""
    joints = [replace(laws[kind], name=name) for kind, names in arm.types.items() for name in names]
    return replace(bundled(arm), joints=tuple(joints), file=None)


def with_load_model(arm: Arm, config: ControllerConfig) -> ControllerConfig:
    """A load model's payload is `ASSUMED` of the largest: wrong for all but a middle one."""
    wrong: dict[str, Any] = {"payload": ASSUMED * arm.payloads[-1], "offset": arm.offset}
    joints = [replace(law, **wrong) if law.law == "pd_gravity" else law for law in config.joints]
    return replace(config, joints=tuple(joints))


def controller(arm: Arm, config: ControllerConfig) -> Controller:
    """Built without the warnings about gains that a tuning may well choose."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        return Controller.from_config(config, robot(arm).drives)


def braking(config: ControllerConfig, mover: ControllerConfig) -> ControllerConfig:
    """A brake's controller that tracks by the mover's position loop until the encoders are lost."""
    joints = []
    for law, loop in zip(config.joints, mover.joints, strict=True):
        gains: dict[str, Any] = {"kp": vars(loop)["kp"], "kd": vars(loop)["kd"]}
        joints.append(replace(law, **gains))
    return replace(config, joints=tuple(joints))


def loss(config: ControllerConfig) -> list[Event]:
    """The position loop alone, then the brake alone, warm started where it has a velocity."""
    events = []
    for law in config.joints:
        events += [Event(0.0, law.name, "mode", "bypass"), Event(LOST, law.name, "mode", "active")]
        events += [Event(LOST, law.name, "warm_start")] * law.warm
        events += [Event(LOST, law.name, "position_loop", False)] * (not law.keeps_encoder)
    return events


def stop(arm: Arm, config: ControllerConfig, payload: float, seed: int, fault: str | None = None) -> Scenario:
    """A random motion in which all controlled joints lose their encoder at `LOST`.

    Args:
        arm: The arm.
        config: Of `braking`.
        payload: [kg].
        seed: Of motion and sensor noise.
        fault: Of every controlled drive from then on, or None.
    """
    made = controller(arm, config)
    duration = LOST + WATCHED + config.period  # the last tick is at its end
    path = multisine(
        robot(arm).home, duration, config.period, seed, amplitude=AMPLITUDE, ramp=RAMP, lead_in=0.0
    )
    faults = [Fault(fault, LOST, joint=law.name) for law in config.joints] if fault else []  # type: ignore[arg-type]
    return Scenario(plant(arm, payload), made, path, loss(config), seed=seed, faults=faults)


def track(arm: Arm, config: ControllerConfig, payload: float, seed: int) -> Scenario:
    """A random motion to be followed."""
    path = multisine(
        robot(arm).home, TRACKED, config.period, seed, amplitude=AMPLITUDE, ramp=RAMP, lead_in=0.0
    )
    return _tracking(arm, config, payload, seed, path)


def rest(arm: Arm, config: ControllerConfig, payload: float, seed: int) -> Scenario:
    """Rest at home, where the torque command is load and noise."""
    return _tracking(arm, config, payload, seed, hold(robot(arm).home, REST, config.period))


def _tracking(arm: Arm, config: ControllerConfig, payload: float, seed: int, path: Trajectory) -> Scenario:
    from dashpot.simulation.feedforward import gravity_reference

    modelled = [law for law in config.joints if law.law == "pd_gravity"]
    if modelled:
        chosen = [robot(arm).index(law.name) for law in modelled]
        every = 10  # ticks between evaluations of the model; the motion is slow
        coarse = replace(path, position=path.position[::every])
        torque = np.zeros_like(path.position)
        model = plant(arm, vars(modelled[0])["payload"])
        given = gravity_reference(model, None, coarse)
        for j in chosen:
            torque[:, j] = np.interp(path.time, path.time[::every], given[:, j])
        path = replace(path, torque=torque)
    return Scenario(plant(arm, payload), controller(arm, config), path, seed=seed)


def released(config: ControllerConfig) -> ControllerConfig:
    """The brakes alone, without a position loop: what is certified."""
    none: dict[str, Any] = {"kp": 0.0, "kd": 0.0}
    return replace(config, joints=tuple(replace(law, **none) for law in config.joints))


def tables(laws: Laws) -> dict[str, dict[str, Any]]:
    """Laws as JSON holds them, by drive type."""
    return {kind: to_table(law) for kind, law in laws.items()}


def laws_of(tables: Mapping[str, Mapping[str, Any]]) -> dict[str, Law]:
    """Reads `tables` back."""
    return {kind: law_from_table(table) for kind, table in tables.items()}
