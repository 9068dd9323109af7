"""The drives as the native loop reads them (native/dashpot_runner.h)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

import dashpot._native as _native
from dashpot.arm.drive import PRESLIDING
from dashpot.arm.dynamics import full_mass
from dashpot.arm.robot import Robot
from dashpot.errors import InputError

PRESLIDING_STEP = 0.6  # largest product of time step and a stuck rotor's frequency; 2 would be unstable
HYSTERESIS = 0.25  # stiffness of the hysteresis element over the transmission's; assumed

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


def drive_records(model: Any, robot: Robot, ranges: Sequence[tuple[float, float]]) -> NDArray[np.void]:
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


def set_step(records: NDArray[np.void], robot: Robot, dt: float) -> None:
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
