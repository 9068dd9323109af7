"""Motions as CSV: time [s], and per joint position [rad], velocity [rad/s], acceleration [rad/s^2]."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dashpot.arm.robot import MAX_ANGLE, Robot
from dashpot.errors import InputError, InputWarning
from dashpot.logs.channels import TIME, Ints
from dashpot.logs.csvfile import numbers, write_table
from dashpot.simulation.trajectory import Trajectory
from dashpot.support.arrays import Floats

if TYPE_CHECKING:
    from scipy.interpolate import BPoly, CubicSpline

KINDS = ("position", "velocity", "acceleration")
AT_REST = 1e-3  # [rad/s] at which a motion may begin: the arm starts at rest


def write_motion(path: Path, trajectory: Trajectory, joints: tuple[str, ...]) -> None:
    """Writes a motion; time counts from its first sample."""
    names, parts = ["time"], [(trajectory.time - trajectory.time[0]).round(9)[:, None]]
    for j, joint in enumerate(joints):
        names += [f"{joint}/{kind}" for kind in KINDS]
        parts += [getattr(trajectory, kind)[:, j : j + 1] for kind in KINDS]
    write_table(path, names, np.hstack(parts))


def read_motion(
    path: Path,
    robot: Robot,
    period: float,
    *,
    lead_in: float = 0.0,
    duration: float | None = None,
    most: int = 1_000_000,
) -> Trajectory:
    """Reads a motion and samples it at another period; joints the file lacks rest at home.

    With velocity and acceleration the samples are joined by polynomials of fifth degree, with velocity alone
    by cubic ones, and without either by a cubic spline at rest at both ends.

    Args:
        path: A CSV file.
        robot: The arm.
        period: Control period [s].
        lead_in: Time at rest before the motion [s].
        duration: Of the part that is used [s]; None: all.
        most: Samples of the result.

    Raises:
        InputError: Naming file, line, joint and rule.

    Warns:
        InputWarning: The motion does not begin at rest.
    """
    names, rows, lines = numbers(path)
    stamp = next((name for name in TIME if name in names), None)
    if stamp is None:
        raise InputError(f"has no column of time [s], one of {', '.join(TIME)}", file=path)
    time = _checked_time(path, rows[:, names.index(stamp)], lines, stamp)
    columns = _columns(path, names, robot)
    end = time[-1] if duration is None else min(time[-1], duration)
    if (end + lead_in) / period > most:
        raise InputError(f"must be at most {most * period - lead_in:g} s long", file=path)
    ticks = np.arange(round((end + lead_in) / period) + 1) * period - lead_in
    at = np.clip(ticks, 0.0, time[-1])
    moving = (ticks >= 0) & (ticks <= time[-1])
    q = np.tile(np.array(robot.home), (len(ticks), 1))
    w, a = np.zeros_like(q), np.zeros_like(q)
    for joint, found in columns.items():
        given = {kind: rows[:, names.index(name)] for kind, name in found.items()}
        for kind, values in given.items():
            bad = np.flatnonzero(~np.isfinite(values))
            if len(bad):
                raise InputError(
                    f"line {lines[bad[0]]}: must be a finite number",
                    file=path,
                    joint=joint,
                    quantity=found[kind],
                )
        if np.abs(given["position"]).max() > MAX_ANGLE:
            raise InputError(
                f"must be within {MAX_ANGLE:.4g} rad; check the unit",
                file=path,
                joint=joint,
                quantity=found["position"],
                value=float(given["position"][np.argmax(np.abs(given["position"]))]),
            )
        curve = _curve(time, given)
        j = robot.index(joint)
        q[:, j] = curve(at)
        w[:, j] = np.where(moving, curve(at, 1), 0.0)
        a[:, j] = np.where(moving, curve(at, 2), 0.0)
        begin = float(curve(0.0, 1))
        if abs(begin) > AT_REST:
            warnings.warn(
                f"{path}: joint {joint!r}: begins at {begin:.3g} rad/s; the arm starts at rest",
                InputWarning,
                stacklevel=2,
            )
    return Trajectory(period, q, w, a, -lead_in)


def _checked_time(path: Path, time: Floats, lines: Ints, name: str) -> Floats:
    if len(time) < 2:
        raise InputError("has one row; a motion needs two or more", file=path)
    bad = np.flatnonzero(~np.isfinite(time))
    if len(bad) == 0:
        bad = np.flatnonzero(np.diff(time) <= 0) + 1
    if len(bad):
        raise InputError(
            f"line {lines[bad[0]]}: times must be numbers that increase",
            file=path,
            quantity=f"{name} [s]",
            value=float(time[bad[0]]),
        )
    return np.asarray(time - time[0])


def _columns(path: Path, names: list[str], robot: Robot) -> dict[str, dict[str, str]]:
    """Per joint the columns of position, velocity and acceleration."""
    columns: dict[str, dict[str, str]] = {}
    for name in names:
        joint, _, kind = name.rpartition("/")
        if kind in KINDS and joint:
            if names.count(name) > 1:
                raise InputError("there are two columns of this name", file=path, quantity=name)
            if joint not in robot.joints:
                raise InputError(
                    f"the robot has no such joint; it has {', '.join(robot.joints)}", file=path, joint=joint
                )
            columns.setdefault(joint, {})[kind] = name
    for joint, found in columns.items():
        if "position" not in found:
            raise InputError("has no column of position", file=path, joint=joint)
    if not columns:
        raise InputError(
            f"has no column <joint>/position [rad]; the robot's joints: {', '.join(robot.joints)}", file=path
        )
    return columns


def _curve(time: Floats, given: dict[str, Floats]) -> BPoly | CubicSpline:
    from scipy.interpolate import BPoly, CubicSpline  # long to import

    if "velocity" not in given:
        return CubicSpline(time, given["position"], bc_type="clamped")
    kinds = KINDS if "acceleration" in given else KINDS[:2]
    return BPoly.from_derivatives(time, np.stack([given[kind] for kind in kinds], 1))
