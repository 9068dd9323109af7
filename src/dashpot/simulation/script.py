"""Faults as the native loop takes them: one record per fault and joint, at ticks, with its numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

import dashpot._native as _native
from dashpot.arm.plant import Plant
from dashpot.errors import InputError
from dashpot.simulation.faults import (
    BRAKE_DELAY,
    KINDS,
    NAMES,
    STIFFEST_WALL,
    Fault,
    brake_torque,
    short_corner,
)

FAULT_DTYPE = np.dtype(
    [
        *((name, "i4") for name in ("kind", "drive", "first", "last")),
        *((name, "f8") for name in ("value", "damping")),
        ("rng", "u8"),
        *((name, "f8") for name in ("anchor", "side")),
        *((name, "i4") for name in ("acts", "reserved")),
    ],
    align=True,
)
"""Layout of ``dp_fault`` in native/dashpot_faults.h."""
STREAM = 1  # of the seed: dropped samples do not disturb the sensors' noise
MOST_DAMPING = 0.5  # of a rotor's inertia over the physics step: beyond, an explicit damper would shake
FOREVER = 2**31 - 1


class Clock(Protocol):
    """What times are given on: a trajectory, or the time a robot is on."""

    @property
    def start(self) -> float:
        """Time of the first tick [s]."""

    @property
    def period(self) -> float:
        """From one tick to the next [s]."""

    @property
    def ticks(self) -> int:
        """How many there are."""


def tick_of(time: float, clock: Clock, quantity: str, joint: str | None = None) -> int:
    """The tick nearest to a time [s].

    Raises:
        InputError: It is not within the clock's ticks.
    """
    tick = (time - clock.start) / clock.period
    if not -0.5 <= tick < clock.ticks - 0.5:  # also catches NaN
        last = clock.start + clock.period * (clock.ticks - 1)
        raise InputError(
            f"outside the trajectory, {clock.start:g} to {last:g} s",
            joint=joint,
            quantity=f"{quantity} [s]",
            value=time,
        )
    return max(0, round(tick))


def native_faults(
    faults: Sequence[Fault], plant: Plant, controlled: Sequence[str], clock: Clock, seed: int
) -> _native.Faults:
    """The script of one run.

    Args:
        faults: In any order.
        plant: The arm, with the time step it runs at.
        controlled: Joints whose signals a controller sees; the robot's own servos read healthy ones.
        clock: Of the faults' times.
        seed: Of the samples that are dropped.

    Raises:
        InputError: A joint, a time or a value does not fit the arm or the motion.
    """
    if FAULT_DTYPE.itemsize != _native.FAULT_SIZE:
        raise RuntimeError("the native library was built from another version; reinstall dashpot")
    rows = [row for fault in faults for row in fault_rows(fault, plant, controlled, clock)]
    if len(rows) > _native.MAX_FAULTS:
        raise InputError(
            f"at most {_native.MAX_FAULTS}, counting each joint", quantity="faults", value=len(rows)
        )
    records = fault_records(rows, seed)
    inertia = plant.model.dof_armature[plant.rotor_dof]
    drives = np.array(
        [
            (brake_torque(drive), short_corner(drive), MOST_DAMPING * m / plant.timestep)
            for drive, m in zip(plant.robot.drives, inertia, strict=True)
        ]
    )
    return _native.Faults(records.view(np.uint8), drives, BRAKE_DELAY)


FaultRow = tuple[int, int, int, int, float, float]
"""Kind, drive, first and last tick, value and damping of one fault on one joint."""


def sensor_streams(seed: int, drives: int) -> NDArray[np.uint64]:
    """State of each drive's generator of sensor noise, (drives,).

    Raises:
        InputError: The seed is negative.
    """
    if seed < 0:
        raise InputError("must not be negative", quantity="seed", value=seed)
    return np.asarray(np.random.SeedSequence(seed).generate_state(drives, np.uint64), np.uint64)


def fault_records(rows: Sequence[FaultRow], seed: int, before: int = 0) -> NDArray[np.void]:
    """Records of `FAULT_DTYPE`; those that continue a script have their streams after `before` others."""
    records = np.zeros(len(rows), FAULT_DTYPE)
    for record, row in zip(records, rows, strict=True):
        for name, value in zip(("kind", "drive", "first", "last", "value", "damping"), row, strict=True):
            record[name] = value
    streams = np.random.SeedSequence(seed, spawn_key=(STREAM,))
    records["rng"] = streams.generate_state(before + len(rows), np.uint64)[before:]
    return records


def fault_rows(fault: Fault, plant: Plant, controlled: Sequence[str], clock: Clock) -> list[FaultRow]:
    """What a fault does to every joint it reaches; arguments and errors as of `native_faults`."""
    kind, robot = KINDS[fault.kind], plant.robot
    joint = None if fault.joint == "all" else fault.joint
    if joint is not None:
        robot.index(joint)  # refuses an unknown one
    if kind.acts_on == "signal":
        if not controlled or (joint is not None and joint not in controlled):
            raise InputError(
                "is under the robot's own servo, whose signals do not fail; "
                + (f"controlled: {', '.join(controlled)}" if controlled else "no joint has a controller"),
                joint=joint,
                quantity=fault.kind,
            )
        joints = controlled if joint is None else (joint,)
    elif kind.acts_on == "arm":
        joints = robot.joints[:1]
    else:
        joints = robot.joints if joint is None else (joint,)
    first = tick_of(fault.start, clock, f"{fault.kind} start", joint)
    last = FOREVER
    if not math.isinf(fault.end):
        # Beyond the trajectory is no mistake; a fault shorter than a tick lasts one.
        last = min(FOREVER, max(first + 1, round((fault.end - clock.start) / clock.period)))
    rows = []
    for name in joints:
        j = robot.index(name)
        drive, record = robot.drives[j], plant.drives[j]
        value, damping = fault.size(drive), 0.0
        if fault.kind == "contact":
            if value > STIFFEST_WALL * drive.stiffness:
                raise InputError(
                    f"must be at most {STIFFEST_WALL:g} times the transmission's stiffness, "
                    f"{STIFFEST_WALL * drive.stiffness:g} N m/rad",
                    joint=name,
                    quantity="contact value [N m/rad]",
                    value=value,
                )
            damping = float(record["stop_damping"]) * math.sqrt(value / float(record["stop_stiffness"]))
        rows.append((NAMES.index(fault.kind), j, first, last, value, damping))
    return rows
