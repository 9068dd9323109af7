"""The arm in MuJoCo: any MJCF or URDF with an elastic, friction-laden drive put into each joint.

Each joint becomes two hinges in series on the same body: the rotor (its armature is the rotor inertia,
its damping the viscous friction) and the transmission spring that carries the link. Coulomb and Stribeck
friction, hysteresis, backlash, stops, the inner torque loop, the robot's own servo and the torque sensor run
in the native loop (native/dashpot_runner.c) around ``mj_step``.
"""

from __future__ import annotations

import copy
import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh, expm

import dashpot._native as _native
from dashpot.arm.drive import PRESLIDING, Drive
from dashpot.arm.payload import Payload, hang
from dashpot.arm.robot import Robot
from dashpot.errors import InputError, InputWarning, ModelError
from dashpot.support.arrays import Floats

if TYPE_CHECKING:
    from dashpot.lanes.tree import Tree

PRESLIDING_STEP = 0.6  # largest product of time step and a stuck rotor's frequency; 2 would be unstable
HYSTERESIS = 0.25  # stiffness of the hysteresis element over the transmission's; assumed
SHORTEST_STEP = 1e-6  # [s]; a model that needs a shorter one has a wrong unit, or would run for hours
STEP_FRACTION = 0.3  # largest product of time step and stiffest natural frequency; about 1 % error in it

_HOT: tuple[str, ...] = ("stiffness", "damping", "half_gap", "hysteresis", "coulomb")
_HOT += ("stribeck", "stribeck_rate")
_HOT += ("presliding_stiffness", "presliding_damping", "stop_lower", "stop_upper")
_HOT += ("torque_limit", "actuator_gain", "inner_gain")
_INDICES = ("rotor_qpos", "rotor_dof", "spring_qpos", "spring_dof", "control")
_COLD: tuple[str, ...] = ("hysteresis_stiffness", "stop_stiffness", "stop_damping", "inner_pole")
_COLD += ("servo_kp", "servo_kd", "servo_ki", "servo_limit")
_COLD += ("sensor_gain", "sensor_bias", "sensor_noise", "sensor_resolution", "position_resolution")
DRIVE_DTYPE = np.dtype(
    [
        *((name, "f8") for name in _HOT),
        ("filter_a", "f8", (2, 2)),
        ("filter_b", "f8", (2,)),
        ("motor_limit", "f8"),
        *((name, "i4") for name in (*_INDICES, "average", "filtered", "sensor_delay")),
        *((name, "f8") for name in ("friction_z", "tau", "filter_x0", "filter_x1", "sum", "motor")),
        *((name, "f8") for name in ("measured_tau", "friction", "asked", "gravity", *_COLD)),
        *((name, "i4") for name in ("inner_steps", "reserved")),
        *((name, "f8") for name in ("hysteresis_z", "integral", "inner_torque", "inner_correction", "spare")),
        ("encoder", "f8"),
        ("known", "f8"),
        ("delay", "f8", (_native.MAX_DELAY,)),
        ("rng", "u8"),
    ],
    align=True,
)
"""Layout of ``dp_drive`` in native/dashpot_runner.h."""


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


def load_spec(robot: Robot) -> tuple[Any, Any]:
    """The robot's model file without actuators, sensors and keyframes: (MjSpec, MjModel).

    Meshes that are not there are left out where every body has its own inertia.

    Raises:
        ModelError: The file is missing or MuJoCo cannot read it.
    """
    path = robot.model
    if path is None:
        raise ModelError(f"{robot.file}: model: missing key; simulation needs a MJCF or URDF file")
    if not Path(path).is_file():
        raise ModelError(f"{robot.file}: model = {str(path)!r}: no such file")
    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except Exception as error:  # MuJoCo raises several types
        raise ModelError(f"{path}: MuJoCo cannot read it: {_one_line(error)}") from None
    for group in (spec.actuators, spec.sensors, spec.keys):
        for element in list(group):
            spec.delete(element)
    try:
        return spec, spec.copy().compile()
    except Exception as error:
        reason = _one_line(error)
    for geom in list(spec.geoms):
        if geom.meshname or geom.type == mujoco.mjtGeom.mjGEOM_MESH:
            spec.delete(geom)
    for mesh in list(spec.meshes):
        spec.delete(mesh)
    try:
        model = spec.copy().compile()
    except Exception as error:
        without = _one_line(error)
        if without != reason:
            reason += f" (and without meshes: {without})"
        raise ModelError(f"{path}: MuJoCo cannot compile it: {reason}") from None
    warnings.warn(f"{path}: used without its meshes: {reason}", InputWarning, stacklevel=2)
    return spec, model


def _one_line(error: BaseException) -> str:
    return "; ".join(line.strip() for line in str(error).splitlines() if line.strip())


def _insert_drive(spec: Any, rigid: Any, drive: Drive, path: Path | None) -> tuple[float, float]:
    """Turns a hinge of the rigid arm into rotor and spring; returns the joint's range [rad]."""
    joint = spec.joint(drive.name)
    if joint is None:
        hinges = [rigid.joint(i).name for i in np.flatnonzero(rigid.jnt_type == mujoco.mjtJoint.mjJNT_HINGE)]
        raise ModelError(
            f"{path}: joint {drive.name!r}: not in the model; its hinges: {', '.join(hinges) or 'none'}"
        )
    if joint.type != mujoco.mjtJoint.mjJNT_HINGE:
        raise ModelError(f"{path}: joint {drive.name!r}: must be a hinge")
    body = joint.parent
    if len(body.joints) != 1:
        raise ModelError(f"{path}: joint {drive.name!r}: must be the only joint of its body {body.name!r}")
    inner = 1.0 + (drive.inner_loop.gain if drive.inner_loop else 0.0)
    joint.armature = drive.rotor_inertia * inner
    joint.damping[:] = drive.viscous_friction * inner, 0.0, 0.0
    joint.stiffness[:] = joint.springdamper[:] = 0.0
    joint.frictionloss, joint.limited = 0.0, 0
    compiled = rigid.joint(drive.name)
    spring = body.add_joint(name=f"{drive.name}/transmission", type=mujoco.mjtJoint.mjJNT_HINGE)
    spring.pos, spring.axis = compiled.pos, compiled.axis
    # The file's defaults apply to a new joint too: every one that acts is replaced.
    spring.stiffness[:], spring.damping[:] = (drive.stiffness, 0.0, 0.0), (drive.damping, 0.0, 0.0)
    spring.springdamper[:] = spring.armature = spring.frictionloss = 0.0
    spring.ref = spring.springref = spring.springyield = 0.0
    spring.limited = spring.actfrclimited = 0
    lower, upper = compiled.range
    return (float(lower), float(upper)) if rigid.jnt_limited[compiled.id] else (-math.inf, math.inf)


def stiffest_mode(model: Any, drives: NDArray[np.void], poses: Sequence[Floats]) -> float:
    """Highest natural frequency of rotors against links over some poses [rad/s]."""
    data = mujoco.MjData(model)
    stiffness = np.zeros((model.nv, model.nv))
    spring = drives["spring_dof"]
    stiffness[spring, spring] = drives["stiffness"] + np.where(
        drives["hysteresis"] > 0, drives["hysteresis_stiffness"], 0.0
    )
    highest = 0.0
    for q in poses:
        data.qpos[drives["rotor_qpos"]] = q
        mass = full_mass(model, data)
        # With an inner torque loop closed the rotor looks (1 + gain) times lighter.
        rotor = drives["rotor_dof"]
        armature = model.dof_armature[rotor]
        mass[rotor, rotor] += armature / (1 + drives["inner_gain"]) - armature
        highest = max(highest, float(eigh(stiffness, mass, eigvals_only=True)[-1]))
    return math.sqrt(highest)


def full_mass(model: Any, data: Any) -> Floats:
    """Joint-space mass matrix at data.qpos, (nv, nv) [kg m^2]."""
    mujoco.mj_forward(model, data)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    return mass


def _drive_records(model: Any, robot: Robot, ranges: Sequence[tuple[float, float]]) -> NDArray[np.void]:
    """The drives as the native loop wants them, all but what depends on the time step."""
    records = np.zeros(len(robot.drives), DRIVE_DTYPE)
    data = mujoco.MjData(model)
    data.qpos[[model.joint(name).qposadr[0] for name in robot.joints]] = robot.home
    inertia = np.diag(full_mass(model, data))
    for record, drive, (lower, upper) in zip(records, robot.drives, ranges, strict=True):
        rotor, spring = model.joint(drive.name), model.joint(f"{drive.name}/transmission")
        inner = drive.inner_loop.gain if drive.inner_loop else 0.0
        record["stiffness"], record["damping"] = drive.stiffness, drive.damping
        record["half_gap"] = drive.backlash / 2
        record["hysteresis"] = drive.hysteresis
        record["hysteresis_stiffness"] = HYSTERESIS * drive.stiffness
        record["coulomb"] = drive.coulomb_friction * (1 + inner)
        if drive.stribeck_friction > 0:
            record["stribeck"] = (drive.stribeck_friction - drive.coulomb_friction) * (1 + inner)
            record["stribeck_rate"] = 1 / drive.stribeck_velocity
        record["stop_lower"], record["stop_upper"] = lower, upper
        record["stop_stiffness"] = 0.5 * drive.stiffness
        light = min(drive.rotor_inertia, inertia[spring.dofadr[0]])
        record["stop_damping"] = 0.5 * math.sqrt(0.5 * drive.stiffness * light)
        record["torque_limit"], record["actuator_gain"] = drive.torque_limit, 1.0
        record["motor_limit"] = math.inf
        record["inner_gain"] = inner
        if drive.servo:
            record["servo_kp"], record["servo_kd"] = drive.servo.kp, drive.servo.kd
            record["servo_ki"] = drive.servo.ki
        record["servo_limit"] = drive.torque_limit
        record["sensor_gain"] = 1 + drive.torque_scale_error
        record["sensor_bias"], record["sensor_noise"] = drive.torque_bias, drive.torque_noise
        record["sensor_resolution"] = drive.torque_resolution
        record["position_resolution"] = drive.position_resolution
        record["rotor_qpos"], record["rotor_dof"] = rotor.qposadr[0], rotor.dofadr[0]
        record["spring_qpos"], record["spring_dof"] = spring.qposadr[0], spring.dofadr[0]
        record["control"] = -1
        record["inner_steps"] = 1
    return records


def _set_step(records: NDArray[np.void], robot: Robot, dt: float) -> None:
    """Fills in what depends on the time step: presliding, sensor filter, sensor delay, inner loop."""
    for record, drive in zip(records, robot.drives, strict=True):
        inner = 1 + record["inner_gain"]
        presliding = min(PRESLIDING * drive.stiffness, drive.rotor_inertia * (PRESLIDING_STEP / dt) ** 2)
        record["presliding_stiffness"] = presliding * inner
        record["presliding_damping"] = math.sqrt(presliding * drive.rotor_inertia) * inner
        if drive.sensor_bandwidth is not None:
            omega, zeta = 2 * math.pi * drive.sensor_bandwidth, drive.sensor_damping
            # Both are exact for an input held over the step.
            if drive.sensor_order == 1:  # x' = omega (tau - x); the second state stays zero
                record["filter_a"], record["filter_b"] = 0.0, 0.0
                record["filter_a"][0, 0] = math.exp(-omega * dt)
                record["filter_b"][0] = -math.expm1(-omega * dt)
            else:  # states: filtered torque and its rate over omega
                A = omega * np.array([[0.0, 1.0, 0.0], [-1.0, -2 * zeta, 1.0], [0.0, 0.0, 0.0]])
                exact = expm(A * dt)
                record["filter_a"], record["filter_b"] = exact[:2, :2], exact[:2, 2]
            record["filtered"] = 1
        delay = round(drive.torque_latency / dt)
        if delay > _native.MAX_DELAY:
            raise InputError(
                f"exceeds {_native.MAX_DELAY} physics steps of {dt * 1e6:.0f} us",
                file=robot.file,
                joint=drive.name,
                quantity="torque_latency [s]",
                value=drive.torque_latency,
            )
        record["sensor_delay"] = delay
        if drive.inner_loop:
            record["inner_steps"] = max(1, round(drive.inner_loop.period / dt))
            corner = 2 * math.pi * drive.inner_loop.bandwidth
            record["inner_pole"] = math.exp(-corner * dt)


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
    spec, rigid = load_spec(robot)
    ranges = [_insert_drive(spec, rigid, drive, robot.model) for drive in robot.drives]
    for drive, angle, (lower, upper) in zip(robot.drives, robot.home, ranges, strict=True):
        if not lower <= angle <= upper:
            raise InputError(
                f"is outside the joint's range, {lower:.4g} to {upper:.4g} rad in {robot.model}",
                file=robot.file,
                joint=drive.name,
                quantity="home [rad]",
                value=angle,
            )
    hang(spec, rigid, robot, payloads)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    # A diverging run must be reported, not silently reset; the plant has no contacts yet.
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET | mujoco.mjtDisableBit.mjDSBL_CONTACT
    # The transmissions are springs and dampers of the engine, and nothing may fall asleep.
    spring, damper = int(mujoco.mjtDisableBit.mjDSBL_SPRING), int(mujoco.mjtDisableBit.mjDSBL_DAMPER)
    spec.option.disableflags &= ~(spring | damper)
    spec.option.enableflags &= ~int(mujoco.mjtEnableBit.mjENBL_SLEEP)
    try:
        model = spec.compile()
    except Exception as error:
        raise ModelError(
            f"{robot.model}: MuJoCo cannot compile the elastic arm: {_one_line(error)}"
        ) from None
    order = [model.joint(name).id for name in robot.joints]
    if order != sorted(order):
        raise ModelError(f"{robot.file}: joints must be listed base to tip, as in {robot.model}")
    records = _drive_records(model, robot, ranges)
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
    _set_step(records, robot, dt)
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
    _set_step(drives, plant.robot, timestep)
    said = f"physics step {timestep * 1e6:.1f} us: the shortest that one of the payloads needs"
    return replace(plant, model=model, drives=drives, timestep=timestep, step_said=said)
