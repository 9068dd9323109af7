"""Samples with stamps of their own, put on a uniform grid of time, stretch by stretch.

Sensed torque sets the grid. Steps may be off by 0.3 periods, and a sample may be missing: there, measurements
are interpolated, and the command and torque averages keep their integral. Longer gaps split the log.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dashpot.control.controller import Sampling
from dashpot.errors import InputError, InputWarning
from dashpot.logs.channels import Key, Raw, Source, check_finite
from dashpot.logs.log import OPTIONAL, Log, Segment
from dashpot.logs.units import warn_of_units
from dashpot.support.arrays import Floats

GAP = 2.5  # periods between samples from which on the log is split
JITTER = 0.3  # periods by which a step may differ from one period, or from two
IRREGULAR = 0.05  # share of steps beyond that from which on the log is refused
EXACT = 0.02  # periods within which a stamp is taken to be on the grid
SHORTEST = 50  # samples of a stretch worth keeping
SLOWER = 1.5  # periods of the torque that another quantity may take
PERIODS = (1e-5, 0.1)  # [s] valid
REQUIRED = ("command", "effort")


@dataclass(frozen=True)
class _Series:
    time: Floats
    value: Floats
    period: float

    def stretches(self, held: bool) -> Floats:
        """Starts and ends of what it covers without a gap, (k, 2) [s]; a held value lasts a period longer."""
        cut = np.flatnonzero(np.diff(self.time) > GAP * self.period)
        starts = self.time[np.concatenate([[0], cut + 1])]
        ends = self.time[np.concatenate([cut, [len(self.time) - 1]])]
        return np.stack([starts, ends + (self.period if held else 0.0)], 1)


def make_log(raw: Raw, sampling: Sampling, file: Path, digest: str) -> Log:
    """Puts a file's samples on a grid.

    Raises:
        InputError: Stamps that do not increase, irregular sampling, or nothing that can be used.
    """
    series: dict[Key, _Series] = {}
    for source in raw.sources:
        check_finite(source, file)
        series |= _series(_in_order(source, file), file)
    joints = _complete(series, file)
    series = {key: value for key, value in series.items() if key[0] in joints}
    period = _period(series, joints, file)
    _leave_out_slow(series, period, file)
    stretches = _common(series, file)
    segments = []
    for start, end in stretches:
        segment = _segment(series, joints, period, sampling, start, end)
        if segment is not None:
            segments.append(segment)
    if not segments:
        raise InputError(
            f"no stretch of {SHORTEST} samples without a gap in which every joint has command and effort",
            file=file,
        )
    _warn_of_loss(series, joints, period, segments, file)
    log = Log(joints, period, tuple(segments), sampling, file, digest)
    warn_of_units(log)
    return log


def _in_order(source: Source, file: Path) -> Source:
    """Checks that stamps increase; rows that repeat the one before are left out."""
    steps = np.diff(source.time)
    back = np.flatnonzero(steps < 0)
    if len(back):
        i = int(back[0])
        raise InputError(
            f"{source.at(i + 1)}: goes back from {source.time[i]:.9g} s; stamps must "
            "increase: cut the log there",
            file=file,
        )
    twice = np.flatnonzero(steps == 0)
    if len(twice) == 0:
        return source
    for values in source.values.values():
        old, new = values[twice], values[twice + 1]
        differ = np.flatnonzero(~((old == new) | (np.isnan(old) & np.isnan(new))))
        if len(differ):
            i = int(twice[differ[0]])
            raise InputError(
                f"{source.at(i + 1)}: the same time as the {source.label} before, with other values; stamps "
                "must increase (or have too few digits)",
                file=file,
            )
    warnings.warn(
        f"{file}: {len(twice)} repeated rows left out, the first at {source.at(int(twice[0]) + 1)}",
        InputWarning,
        stacklevel=2,
    )
    keep = np.concatenate([[True], steps > 0])
    kept = {key: array[keep] for key, array in source.values.items()}
    return Source(source.label, source.rows[keep], source.time[keep], kept)


def _series(source: Source, file: Path) -> dict[Key, _Series]:
    """The samples there are; NaN is none."""
    found: dict[Key, _Series] = {}
    periods: dict[bytes, float] = {}
    for key, values in source.values.items():
        there = ~np.isnan(values)
        if not there.any():
            continue
        time = source.time[there]
        token = there.tobytes()
        if token not in periods:
            periods[token] = _own_period(time)
        found[key] = _Series(time, values[there], periods[token])
    return found


def _own_period(time: Floats) -> float:
    """Median step, refined by counting periods over all steps without a gap: the mean period [s]."""
    steps = np.diff(time)
    if len(steps) == 0:
        return 0.0
    period = float(np.median(steps))
    near = steps[steps < GAP * period]
    counts = np.maximum(np.rint(near / period), 1)
    return float(near.sum() / counts.sum())


def _complete(series: dict[Key, _Series], file: Path) -> tuple[str, ...]:
    """Joints with torque, command and motion, in the order of the file."""
    joints = tuple(dict.fromkeys(joint for joint, _ in series))
    lacking: dict[str, list[str]] = {}
    for joint in joints:
        missing = tuple(name for name in REQUIRED if (joint, name) not in series)
        if not any((joint, name) in series for name in ("position", "velocity")):
            missing += ("position or velocity",)
        if missing:
            lacking.setdefault(" and ".join(missing), []).append(joint)
    complete = tuple(joint for joint in joints if not any(joint in names for names in lacking.values()))
    said = "; ".join(f"{', '.join(names)}: no {what}" for what, names in lacking.items())
    if not complete:
        raise InputError(
            f"no joint has command (torque sent), effort (torque sensed) and position or velocity: "
            f"{said or 'no samples'}",
            file=file,
        )
    if lacking:
        warnings.warn(f"{file}: joints left out: {said}", InputWarning, stacklevel=3)
    return complete


def _period(series: dict[Key, _Series], joints: Sequence[str], file: Path) -> float:
    """Of the sensed torque [s]."""
    efforts = {joint: series[joint, "effort"] for joint in joints}
    first = efforts[joints[0]]
    if len(first.time) < SHORTEST:
        raise InputError(
            f"has {len(first.time)} torque sample{'s' if len(first.time) > 1 else ''}; {SHORTEST} are the "
            "least, some 10 s of motion are useful",
            file=file,
            joint=joints[0],
        )
    low, high = PERIODS
    if not low <= first.period <= high:
        raise InputError(
            f"must be {low:g} to {high:g} s; check the unit: stamps are in s",
            file=file,
            quantity="median step of time [s]",
            value=first.period,
        )
    for joint, effort in efforts.items():
        if abs(effort.period - first.period) > 0.01 * first.period:
            raise InputError(
                f"its torque comes every {effort.period:.4g} s, that of {joints[0]} every "
                f"{first.period:.4g} s; log joints at one rate",
                file=file,
                joint=joint,
            )
    steps = np.diff(first.time) / first.period
    steps = steps[steps < GAP]
    share = float(np.mean(np.abs(steps - np.maximum(np.rint(steps), 1)) > JITTER))
    if share > IRREGULAR:
        raise InputError(
            f"{100 * share:.0f} % of the steps between torque samples are off by more than {JITTER:g} "
            f"periods of {first.period:.4g} s (at most {100 * IRREGULAR:.0f} % may be); log at a fixed rate, "
            "with the robot's own stamps",
            file=file,
        )
    return first.period


def _leave_out_slow(series: dict[Key, _Series], period: float, file: Path) -> None:
    """Refuses a slow command and leaves out slow positions: interpolated, they would be made up."""
    for (joint, quantity), one in list(series.items()):
        if one.period <= SLOWER * period:
            continue
        said = f"{quantity} comes every {one.period:.4g} s, the torque every {period:.4g} s"
        if quantity == "command" and (len(one.time) < 2 or one.period > GAP * period):
            raise InputError(f"{said}; log every command", file=file, joint=joint)
        if quantity not in OPTIONAL:
            continue
        del series[joint, quantity]
        if not any((joint, name) in series for name in ("position", "velocity")):
            raise InputError(f"{said}; log it as often", file=file, joint=joint)
        warnings.warn(f"{file}: joint {joint!r}: {said}: left out", InputWarning, stacklevel=3)


def _common(series: dict[Key, _Series], file: Path) -> Floats:
    """Stretches in which every series has samples, (k, 2) [s]."""
    common = np.array([[-np.inf, np.inf]])
    for (_, quantity), one in series.items():
        other = one.stretches(held=quantity == "command")
        cut = [
            (max(a, c), min(b, d))
            for a, b in common
            for c, d in other[np.searchsorted(other[:, 1], a) : np.searchsorted(other[:, 0], b, "right")]
            if max(a, c) < min(b, d)
        ]
        if not cut:
            raise InputError(
                "commands and states do not overlap in time; are their stamps from one clock?", file=file
            )
        common = np.array(cut)
    return common


def _segment(
    series: dict[Key, _Series],
    joints: Sequence[str],
    period: float,
    sampling: Sampling,
    start: float,
    end: float,
) -> Segment | None:
    """The samples between two times on a grid, or None if they are too few."""
    stamps = series[joints[0], "effort"].time
    stamps = stamps[(stamps >= start - 1e-9) & (stamps <= end + 1e-9)]
    if len(stamps) < SHORTEST:
        return None
    grid = stamps[0] + period * np.arange(int((stamps[-1] - stamps[0]) / period + 1e-3) + 1)
    # The line of least squares through stamps that sit on a grid removes their rounding.
    if len(grid) == len(stamps):
        grid += np.mean(stamps - grid)
    arrays = {}
    for quantity in ("command", "effort", *OPTIONAL):
        known = {j: series[name, quantity] for j, name in enumerate(joints) if (name, quantity) in series}
        if not known:
            continue
        arrays[quantity] = np.full((len(grid), len(joints)), np.nan)
        for j, one in known.items():
            if quantity == "command":
                arrays[quantity][:, j] = _held(one, grid, period, ahead=True)
            elif quantity == "effort" and sampling == "average":
                arrays[quantity][:, j] = _held(one, grid, period, ahead=False)
            else:
                arrays[quantity][:, j] = _interpolated(one, grid, period)
    torque = arrays.pop("effort")
    return Segment(grid, arrays.pop("command"), torque, **arrays)


def _on_grid(series: _Series, grid: Floats, period: float) -> Floats | None:
    """The samples as they are, if each point of the grid has one."""
    nearest = np.searchsorted(series.time, grid - period / 2)
    if nearest[-1] >= len(series.time) or (np.diff(nearest) != 1).any():
        return None
    off = np.abs(series.time[nearest] - grid)
    return series.value[nearest] if off.max() <= EXACT * period else None


def _interpolated(series: _Series, grid: Floats, period: float) -> Floats:
    exact = _on_grid(series, grid, period)
    return np.interp(grid, series.time, series.value) if exact is None else exact


def _held(series: _Series, grid: Floats, period: float, *, ahead: bool) -> Floats:
    """Mean over the period after (`ahead`) or before each point of the grid of a piecewise constant signal.

    A command lasts from its stamp to the next; an averaged torque stands for the time since the last stamp.
    """
    exact = _on_grid(series, grid, period)
    if exact is not None:
        return exact
    time, value = series.time, series.value
    if ahead:
        edges = np.append(time, time[-1] + series.period)
    else:
        edges = np.insert(time, 0, time[0] - series.period)
    integral = np.concatenate([[0.0], np.cumsum(value * np.diff(edges))])
    low, high = (grid, grid + period) if ahead else (grid - period, grid)
    low, high = np.clip(low, edges[0], edges[-1]), np.clip(high, edges[0], edges[-1])
    inside = np.maximum(high - low, 1e-12)
    return np.asarray((np.interp(high, edges, integral) - np.interp(low, edges, integral)) / inside)


def _warn_of_loss(
    series: dict[Key, _Series], joints: Sequence[str], period: float, segments: Sequence[Segment], file: Path
) -> None:
    """Says what was split, left out, or moved to the grid."""
    stamps = series[joints[0], "effort"].time
    kept = period * sum(len(segment.time) for segment in segments)
    whole = float(stamps[-1] - stamps[0]) + period
    if len(segments) > 1 or kept < 0.98 * whole:
        ends = ", ".join(f"{s.time[0]:.4g} to {s.time[-1]:.4g} s" for s in segments[:4])
        more = f" and {len(segments) - 4} more" if len(segments) > 4 else ""
        warnings.warn(
            f"{file}: gaps of more than {GAP:g} periods: {kept:.3g} of {whole:.3g} s are used, {ends}{more}",
            InputWarning,
            stacklevel=3,
        )
    steps = np.diff(stamps) / period
    steps = steps[steps < GAP]
    jitter = float(np.std(steps - np.rint(steps)))
    if jitter > EXACT:
        warnings.warn(
            f"{file}: time stamps jitter by {100 * jitter:.0f} % of a period (RMS); resampled at "
            f"{1 / period:.4g} Hz, which adds to the uncertainty",
            InputWarning,
            stacklevel=3,
        )
