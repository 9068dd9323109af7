"""What a supervisor may assume, and the thresholds that follow from the drives (docs/supervisor.md)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf, erfcinv

from dashpot.arm.drive import Drive
from dashpot.control.controller import Controller, Sampling
from dashpot.control.sampled import IN_EFFECT, NX, POSITION_REF, TORQUE
from dashpot.control.supervisorsettings import SupervisorSettings
from dashpot.errors import InputError
from dashpot.support.arrays import Floats

HOLD_TIME = 0.1  # [s], damping over stiffness of the encoder brake once a joint stands; assumed


_WATCH: tuple[str, ...] = ("inertia", "viscous", "inertia_error", "viscous_error", "torque_error")
_WATCH += (
    "torque_mid",
    "torque_lag",
    "allowance",
    "noise",
    "noise_tick",
    "torque_range",
    "torque_rate",
    "torque_jump",
)
_WATCH += (
    "lower",
    "upper",
    "speed_limit",
    "jump",
    "stand",
    "mismatch",
    "bias_limit",
    "moving",
    "floor",
    "damping",
    "hold",
)
WATCH_DTYPE = np.dtype(
    [*((name, "f8") for name in _WATCH), ("load", "f8", (NX,)), ("stuck", "i4"), ("reserved", "i4")],
    align=True,
)
"""Layout of ``dp_watch`` in native/dashpot_supervisor.h."""
_GAINS = ("residual_gain", "speed_gain", "load_gain", "bias_gain", "band_gain")
_COUNTS = (
    "torque_age",
    "encoder_age",
    "brake_ticks",
    "debounce",
    "stop_ticks",
    "still_ticks",
    "half_cycles",
    "window",
)
RULES_DTYPE = np.dtype(
    [
        *((name, "f8") for name in ("period", *_GAINS, "still_speed", "drift", "release")),
        *((name, "i4") for name in (*_COUNTS, "keep_load")),
    ],
    align=True,
)
"""Layout of ``dp_rules`` in native/dashpot_supervisor.h."""


def load_state(block: NDArray[np.void]) -> Floats:
    """States of a block in equilibrium under a sensed torque of 1 N m, position loop off: (4,).

    Solves ``x = A x + B_tau + B_u u``, ``u = C x + D_tau + D_u u``. Zeros where a block has no equilibrium
    (an integrator): it starts from rest.
    """
    n = int(block["nx"])
    system = np.zeros((n + 1, n + 1))
    system[:n, :n] = np.eye(n) - block["A"][:n, :n]
    system[:n, n] = -block["B"][:n, IN_EFFECT]
    system[n, :n], system[n, n] = -block["C"][:n], 1 - block["D"][IN_EFFECT]
    forcing = np.append(block["B"][:n, TORQUE], block["D"][TORQUE])
    state = np.zeros(NX)
    if n and np.linalg.cond(system) < 1e12:
        state[:n] = np.linalg.solve(system, forcing)[:n]
    return state


def stand_of(block: NDArray[np.void], friction: float) -> float:
    """How far a reference may go while friction holds a joint [rad]: ``2 friction / kappa``.

    kappa = du/d(reference) of the block in equilibrium, position and sensed torque constant. A resting rotor
    carries ``u - tau_s``, from -friction to +friction. An integrator only shortens that: of a block that has
    one, kappa is its direct gain. Infinite without a position loop: nothing has to follow.

    Args:
        block: The joint's controller block.
        friction: Largest of the resting rotor [N m].
    """
    n = int(block["nx"])
    system = np.zeros((n + 1, n + 1))
    system[:n, :n] = np.eye(n) - block["A"][:n, :n]
    system[:n, n] = -block["B"][:n, IN_EFFECT]
    system[n, :n], system[n, n] = -block["C"][:n], 1 - block["D"][IN_EFFECT]
    forcing = np.append(block["B"][:n, POSITION_REF], block["D"][POSITION_REF])
    settles = np.linalg.cond(system) < 1e12
    kappa = abs(float(np.linalg.solve(system, forcing)[n] if settles else forcing[n]))
    return 2 * friction / kappa if kappa > 0 else math.inf


def _gain(period: float, time: float) -> float:
    return -math.expm1(-period / time)


def rules_record(settings: SupervisorSettings, period: float) -> NDArray[np.void]:
    """The arm's rules as the native code wants them, a record of `RULES_DTYPE`."""
    window = max(8, round(settings.residual_time / period))
    record = np.zeros((), RULES_DTYPE)
    record["period"] = period
    record["residual_gain"] = _gain(1, window)
    record["speed_gain"] = _gain(1, 4)
    record["load_gain"] = _gain(period, 0.1)
    record["bias_gain"] = _gain(period, settings.bias_time)
    record["band_gain"] = _gain(period, 1 / (2 * math.pi * settings.oscillation_corner))
    record["still_speed"], record["drift"] = settings.still_speed, settings.drift
    record["release"] = min(1.0, period / settings.release_time)
    for key in ("torque_age", "encoder_age", "debounce", "keep_load"):
        record[key] = getattr(settings, key)
    record["stop_ticks"] = max(1, round(settings.stop_time / period))
    record["brake_ticks"] = max(1, round(settings.brake_time / period))
    record["still_ticks"] = max(1, round(settings.still_time / period))
    record["half_cycles"] = 2 * settings.oscillation_cycles
    record["window"] = window
    return record


def watch_record(
    drive: Drive,
    block: NDArray[np.void],
    settings: SupervisorSettings,
    period: float,
    sampling: Sampling,
    limits: tuple[float, float] = (-math.inf, math.inf),
) -> NDArray[np.void]:
    """The thresholds of one joint, derived from its drive: a record of `WATCH_DTYPE`.

    Args:
        drive: The drive, with its uncertainty.
        block: The joint's controller block.
        settings: What may be assumed.
        period: Of the controller [s].
        sampling: Of the torque.
        limits: Range of the joint [rad].
    """
    s, unsure = settings, drive.uncertainty
    m, v = drive.rotor_inertia, drive.viscous_friction
    gain = float(rules_record(s, period)["residual_gain"])
    breakaway = max(drive.coulomb_friction, drive.stribeck_friction)
    friction = breakaway * (1 + max(unsure.get("coulomb_friction", 0.0), s.friction_margin))
    bias = s.bias_limit * drive.torque_limit
    sigmas = math.sqrt(2) * float(erfcinv(s.false_alarms))  # two-sided
    noise = drive.torque_noise + drive.torque_resolution / math.sqrt(12)
    resolution = drive.position_resolution
    lag = drive.torque_latency + (0.5 * period if sampling == "point" else 0.0)
    if drive.sensor_bandwidth is not None:  # delay of the filter at low frequency
        corner = 2 * math.pi * drive.sensor_bandwidth
        lag += (2 * drive.sensor_damping if drive.sensor_order == 2 else 1.0) / corner
    k, c = (
        getattr(drive, key) * (1 + unsure.get(key, 0.0)) for key in ("stiffness", "damping")
    )  # at their largest
    record = np.zeros((), WATCH_DTYPE)
    record["inertia"], record["viscous"] = m / period, v
    record["inertia_error"] = max(unsure.get("rotor_inertia", 0.0), s.model_margin) * m / period
    record["viscous_error"] = max(unsure.get("viscous_friction", 0.0), s.model_margin) * v
    record["torque_error"] = drive.torque_gain_error
    record["torque_mid"] = 0.5 if sampling == "point" else 0.0
    record["torque_lag"] = lag / period
    record["allowance"] = friction + bias
    record["noise"] = sigmas * noise * math.sqrt(gain / (2 - gain)) + 2 * gain * m * resolution / period**2
    record["noise_tick"] = sigmas * noise + 2 * m * resolution / period**2
    record["torque_range"] = s.torque_range * drive.torque_limit
    record["torque_rate"] = 2 * s.speed_limit * k * period
    record["torque_jump"] = 4 * s.speed_limit * c + 2 * sigmas * noise + drive.hysteresis
    record["lower"], record["upper"] = limits
    record["speed_limit"], record["jump"] = s.speed_limit, 2 * resolution
    stand = stand_of(block, friction)
    record["stand"] = min(stand if s.stand is None or math.isinf(stand) else s.stand, 1e12)
    record["mismatch"] = 0.02 * s.speed_limit + 2 * gain * resolution / period
    record["bias_limit"] = bias
    record["moving"] = max(0.02, 4 * resolution / period)
    record["floor"] = max(s.oscillation_floor * drive.torque_limit, 8 * noise)
    record["damping"] = min(0.25 * m / period / (1 + int(block["latency"])), math.sqrt(drive.stiffness * m))
    record["hold"] = record["damping"] / HOLD_TIME
    record["load"] = load_state(block)
    if noise > 0 and drive.torque_noise > 0:
        # Chance that a sample falls into the same step of the sensor as the one before, at most.
        step = drive.torque_resolution / (2 * math.sqrt(2) * drive.torque_noise)
        same = float(erf(step)) if step > 0 else 0.0
        if same < 0.9:
            needed = math.log(s.false_alarms) / math.log(same) if same > 0 else 0
            record["stuck"] = max(s.debounce, math.ceil(needed))
    return record


def watch_records(
    controller: Controller,
    drives: Sequence[Drive],
    settings: SupervisorSettings,
    limits: Mapping[str, tuple[float, float]] | None = None,
) -> NDArray[np.void]:
    """The thresholds of a controller's joints, (n,) records of `WATCH_DTYPE`; arguments as of `Supervisor`.

    Raises:
        InputError: A controlled joint has no drive, or a range is empty.
    """
    by_name = {drive.name: drive for drive in drives}
    records = []
    for name, block in zip(controller.joints, controller.blocks, strict=True):
        if name not in by_name:
            raise InputError(f"has no drive; there are {', '.join(by_name)}", joint=name)
        lower, upper = (limits or {}).get(name, (-math.inf, math.inf))
        if not lower < upper:
            raise InputError(
                "lower must be below upper", joint=name, quantity="limits [rad]", value=(lower, upper)
            )
        means = settings, controller.period, controller.sampling, (lower, upper)
        records.append(watch_record(by_name[name], block, *means))
    return np.array(records)
