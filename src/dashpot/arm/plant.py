"""The arm in MuJoCo: any MJCF or URDF with an elastic, friction-laden drive put into each joint.

Rotors and transmissions are joints of the model (`dashpot.arm.assembly`). Coulomb and Stribeck friction,
hysteresis, backlash, stops, the inner torque loop, the robot's own servo and the torque sensor run in the
native loop (native/dashpot_runner.c) around ``mj_step``.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
from numpy.typing import NDArray

import dashpot._native as _native
from dashpot.arm.assembly import elastic_model
from dashpot.arm.dynamics import stiffest_mode
from dashpot.arm.payload import Payload
from dashpot.arm.records import DRIVE_DTYPE, drive_records, set_step
from dashpot.arm.robot import Robot
from dashpot.errors import InputError, ModelError
from dashpot.support.arrays import Floats

if TYPE_CHECKING:
    from dashpot.lanes.tree import Tree

SHORTEST_STEP = 1e-6  # [s]; a model that needs a shorter one has a wrong unit, or would run for hours
STEP_FRACTION = 0.3  # largest product of time step and stiffest natural frequency; about 1 % error in it


@dataclass
class Plant:
    """An arm ready to simulate.

    Attributes:
        robot: The arm it was built from.
        model: The MuJoCo model; its time step is set.
        drives: (n,) records of `DRIVE_DTYPE`.
        timestep: Physics step [s].
        stiffest: Highest natural frequency of the elastic joints [rad/s], which set the step.
        step_said: One line that says how the step was chosen.
        loaded: The same arm with other loads, as `with_payload` has built them.
        tree: The arm as the vectorised engine has read it (`dashpot.lanes`), or None.
    """

    robot: Robot
    model: Any
    drives: NDArray[np.void]
    timestep: float
    stiffest: float
    step_said: str
    loaded: dict[tuple[float, ...], Plant] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )
    tree: Tree | None = field(default=None, init=False, repr=False, compare=False)

    @property
    def rotor_qpos(self) -> NDArray[np.int32]:
        """Indices of the rotor angles in qpos, (n,)."""
        return np.array(self.drives["rotor_qpos"])

    @property
    def rotor_dof(self) -> NDArray[np.int32]:
        """Indices of the rotor velocities in qvel, (n,)."""
        return np.array(self.drives["rotor_dof"])

    @property
    def spring_dof(self) -> NDArray[np.int32]:
        """Indices of the deflection rates in qvel, (n,)."""
        return np.array(self.drives["spring_dof"])

    def load_torque(self, q: Floats) -> Floats:
        """Gravity torque each joint must hold at rest at pose ``q`` (n,) [rad]: (n,) [N m]."""
        data = mujoco.MjData(self.model)
        data.qpos[self.rotor_qpos] = q
        mujoco.mj_forward(self.model, data)
        return np.array((data.qfrc_bias - data.qfrc_gravcomp)[self.rotor_dof])


def build(robot: Robot, period: float, payloads: Sequence[Payload] = ()) -> Plant:
    """Builds the elastic arm with its payloads.

    The time step divides the control period and is at most 0.3 / (stiffest natural frequency).

    Args:
        robot: The arm.
        period: Control period [s].
        payloads: Weights on the flange.

    Raises:
        ModelError: The model file, a joint or the flange site is missing or unusable.
        InputError: A drive value cannot be simulated at this step.
    """
    if DRIVE_DTYPE.itemsize != _native.DRIVE_SIZE:
        raise RuntimeError("the native library was built from another version; reinstall dashpot")
    if len(robot.drives) > _native.MAX_JOINTS:
        raise InputError(f"at most {_native.MAX_JOINTS} joints can be simulated", file=robot.file)
    model, ranges = elastic_model(robot, payloads)
    order = [model.joint(name).id for name in robot.joints]
    if order != sorted(order):
        raise ModelError(f"{robot.file}: joints must be listed base to tip, as in {robot.model}")
    records = drive_records(model, robot, ranges)
    spread = np.random.default_rng(0).uniform(-1, 1, (4, len(order)))  # poses around home; any will do
    poses = [np.array(robot.home), *(np.array(robot.home) + spread)]
    try:
        stiffest = stiffest_mode(model, records, poses)
    except (ValueError, np.linalg.LinAlgError):
        raise ModelError(f"{robot.model}: masses and inertias must be finite and positive") from None
    if not np.isfinite(model.opt.gravity).all():
        raise ModelError(f"{robot.model}: gravity = {model.opt.gravity.tolist()}: must be finite")
    steps = max(1, math.ceil(period * stiffest / STEP_FRACTION))
    dt = period / steps
    if dt < SHORTEST_STEP:
        drive = max(robot.drives, key=lambda d: d.stiffness / d.rotor_inertia)
        raise InputError(
            f"with rotor_inertia {drive.rotor_inertia:g} kg m^2 and the links' inertias needs a physics step "
            f"of {dt:.2g} s, shortest: {SHORTEST_STEP:g} s; check their units",
            file=robot.file,
            joint=drive.name,
            quantity="stiffness [N m/rad]",
            value=drive.stiffness,
        )
    model.opt.timestep = dt
    set_step(records, robot, dt)
    said = (
        f"physics step {dt * 1e6:.1f} us = period / {steps}: at most {STEP_FRACTION} / "
        f"(stiffest mode {stiffest:.0f} rad/s)"
    )
    return Plant(robot, model, records, dt, stiffest, said)


def with_payload(plant: Plant, payload: Payload | None, period: float) -> Plant:
    """The same arm with another load instead of all it carries, for a control period [s].

    Its time step is its own. It is built once and kept in `Plant.loaded`.

    Raises:
        InputError: The arm with this payload cannot be simulated.
    """
    load = payload if payload is not None and payload.mass > 0 else None
    key = (period, *((load.mass, *load.position, load.length) if load else ()))
    if key not in plant.loaded:
        plant.loaded[key] = build(plant.robot, period, [load] if load else [])
    return plant.loaded[key]


def with_timestep(plant: Plant, timestep: float) -> Plant:
    """The same plant with a shorter time step [s]."""
    model, drives = copy.copy(plant.model), plant.drives.copy()
    model.opt.timestep = timestep
    set_step(drives, plant.robot, timestep)
    said = f"physics step {timestep * 1e6:.1f} us: the shortest that one of the payloads needs"
    return replace(plant, model=model, drives=drives, timestep=timestep, step_said=said)
