"""Identified drives, written into a robot file: comments, order and everything else in it stay.

Each quantity's interval becomes a value and a relative half-width, such that ``value (1 +- uncertainty)``
covers the interval: that is the box `dashpot certify` covers. Where they come from stands beside them, as a
comment and as the table ``identified``.
"""

from __future__ import annotations

import datetime
import math
import os
import re
import secrets
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import AoT, InlineTable, Table

import dashpot
from dashpot.arm.drive import UNCERTAIN
from dashpot.arm.robot import Robot
from dashpot.errors import InputError
from dashpot.identify.estimate import DriveEstimate, Estimate
from dashpot.logs.log import Log
from dashpot.support.tables import read_toml

LEAST_LATENCY = 1e-5  # [s], written where the interval ends just above zero: less is none

CONFIDENCE = 0.95
DIGITS = 6  # of a value
MARK = "# identified"  # how the comment of a joint begins
NEARLY_ONE = 0.999  # largest relative half-width; 1 would let an inertia be zero
LARGEST_GAIN_ERROR = 0.5  # a drive may have
AS_THEY_ARE = ("stribeck_friction", "stribeck_velocity", "torque_bias", "torque_scale_error")


@dataclass(frozen=True)
class Provenance:
    """Where identified values come from.

    Attributes:
        log: Name of the log file.
        sha256: Its digest; ``""`` for a log made in memory.
        date: ISO 8601.
        seconds: Of the log [s].
    """

    log: str
    sha256: str
    date: str
    seconds: float

    @classmethod
    def of(cls, log: Log) -> Provenance:
        """That of a log, today (UTC)."""
        today = datetime.datetime.now(datetime.UTC).date().isoformat()
        return cls(log.file.name if log.file else "in memory", log.digest, today, log.duration)


def box(estimate: Estimate) -> tuple[float, float]:
    """A value and a relative half-width [-] below 1 that cover the interval of a quantity not below zero.

    The value is the estimate's own unless the interval reaches so far that the half-width would not be below
    1; then it is the interval's middle.
    """
    low, high = max(estimate.low, 0.0), max(estimate.high, 0.0)
    value = _rounded(estimate.value)
    if high == 0:
        return 0.0, 0.0
    if value > 0:
        half = _up(max(high - value, value - low, 0.0) / value)
        if half < NEARLY_ONE:
            return value, half
    value = max((low + high) / 2, high / (1 + NEARLY_ONE))
    return value, min(_up(max(high - value, value - low) / value), NEARLY_ONE)


def new_values(estimate: DriveEstimate) -> tuple[dict[str, float], dict[str, float]]:
    """Keys of a `Drive` and of its ``uncertainty`` with what was identified; the rest is not in them."""
    values: dict[str, float] = {}
    uncertainty: dict[str, float] = {}
    for key, found in estimate.values.items():
        if key in UNCERTAIN:
            values[key], uncertainty[key] = box(found)
        elif key in AS_THEY_ARE:
            values[key] = _rounded(found.value)
    friction = values.get("stribeck_friction", 0.0)
    if 0 < friction <= values.get("coulomb_friction", 0.0):  # rounding, or an interval's middle
        values["stribeck_friction"] = 0.0
        values.pop("stribeck_velocity", None)
    scale = estimate.values.get("torque_scale_error")
    if scale is not None:
        # What the certificate must cover, unless the user corrects the scale.
        values["torque_gain_error"] = _up(max(abs(scale.low), abs(scale.high)))
    latency = estimate.values.get("latency")
    if latency is not None:
        values["command_latency"] = _up(max(latency.high, LEAST_LATENCY)) if latency.high > 0 else 0.0
    return values, uncertainty


def too_wide(estimate: DriveEstimate) -> str:
    """Why the scale's interval cannot be written, or nothing."""
    error = new_values(estimate)[0].get("torque_gain_error", 0.0)
    if error <= LARGEST_GAIN_ERROR:
        return ""
    return f"torque_gain_error would be {error:.2g}, more than the {LARGEST_GAIN_ERROR:g} a drive may have"


def updated(
    text: str, robot: Robot, estimates: Sequence[DriveEstimate], provenance: Provenance, model: str | None
) -> str:
    """The text of a robot file with identified values in place of the old ones.

    Args:
        text: The file as it is.
        robot: What it says.
        estimates: Of some of its joints; quantities that were refused keep their old value and uncertainty.
        provenance: Of all of them.
        model: New path of the model file; None: as it is.

    Raises:
        InputError: The file is laid out in a way that cannot be changed.
    """
    try:
        document = tomlkit.parse(text)
    except TOMLKitError as error:
        raise InputError(f"cannot be changed: {error}", file=robot.file) from None
    if model is not None and "model" in document:
        document["model"] = model
    tables: Any = document["joint"]
    comments: dict[int, list[str]] = {}
    for estimate in estimates:
        index = robot.index(estimate.joint)
        values, uncertainty = new_values(estimate)
        if not values or too_wide(estimate):
            continue
        table = tables[index]
        for key, value in values.items():
            table[key] = value
        if uncertainty:
            if isinstance(table.get("uncertainty"), Table):  # [joint.uncertainty]
                table["uncertainty"].update(uncertainty)
            else:
                table["uncertainty"] = _inline({**table.get("uncertainty", {}), **uncertainty})
        quantities = [key for key in estimate.values if key != "latency"]
        if "command_latency" in values:
            quantities.append("command_latency")
        if "torque_gain_error" in values:
            quantities.append("torque_gain_error")
        samples = estimate.fit.samples if estimate.fit is not None else 0
        record: dict[str, Any] = {
            "log": provenance.log,
            "sha256": provenance.sha256,
            "date": provenance.date,
            "dashpot": dashpot.__version__,
            "samples": samples,
            "confidence": CONFIDENCE,
            "quantities": sorted(quantities),
        }
        inline = isinstance(table, InlineTable)
        fresh: Any = tomlkit.inline_table() if inline else tomlkit.table()
        for key, entry in record.items():
            fresh[key] = entry
        if "identified" in table:
            del table["identified"]
        if not inline:
            fresh.add(tomlkit.nl())  # before the next joint
        table["identified"] = fresh
        comments[index] = [
            f"{MARK} from {_plain(provenance.log)} on {provenance.date}, what `quantities` below lists; "
            f"uncertainty covers the {100 * CONFIDENCE:.0f} % intervals"
        ]
    out = tomlkit.dumps(document)
    return _with_comments(out, comments) if isinstance(tables, AoT) else out


def _inline(values: Mapping[str, float]) -> Any:
    """An inline table with spaces inside its braces, as people write it."""
    inside = ", ".join(f"{key} = {float(value)!r}" for key, value in values.items())
    return tomlkit.parse(f"x = {{ {inside} }}")["x"]


def _plain(text: str) -> str:
    return "".join(c if c.isprintable() else "?" for c in text)


def _with_comments(text: str, comments: Mapping[int, list[str]]) -> str:
    """Puts comments below the ``[[joint]]`` lines, in place of those of an earlier identification."""
    newline = "\r\n" if "\r\n" in text else "\n"
    lines: list[str] = []
    index, below = -1, False
    for line in text.splitlines():
        if re.match(r"\s*\[\[\s*[\"']?joint[\"']?\s*\]\]", line):
            index += 1
            lines += [line, *comments.get(index, [])]
            below = index in comments
            continue
        if below and line.lstrip().startswith(MARK):
            continue
        below = False
        lines.append(line)
    return newline.join(lines) + newline


def write_back(
    robot: Robot, estimates: Sequence[DriveEstimate], log: Log, path: Path, *, place: Path | None = None
) -> Path:
    """Writes a robot file with the identified drives in it; it is there whole and loads again, or not at all.

    A model file that a bundled robot names is copied next to it; others are named relative to the new place.

    Args:
        robot: Read from a file.
        estimates: Of some of its joints.
        log: They come from.
        path: File to write; may be the robot's own.
        place: Folder in which the file will stand in the end, if that is not where it is written.

    Raises:
        InputError: Robot was not read from a file, or the new file would not load.
    """
    if robot.file is None:
        raise InputError("was not read from a file, so none can be changed", quantity="robot")
    text = robot.file.read_bytes().decode("utf-8")
    model = _model_path(robot, path, place)
    new = updated(text, robot, estimates, Provenance.of(log), model)
    temporary = path.with_name(f".{secrets.token_hex(4)}.{path.name}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_bytes(new.encode("utf-8"))
        _check(temporary, robot, estimates, path)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
    return path


def bundled(robot: Robot) -> bool:
    """Whether a robot is part of the package, whose files are not to be changed."""
    folder = Path(dashpot.__file__).resolve().parent / "robots"
    return robot.file is not None and robot.file.resolve().parent == folder


def _model_path(robot: Robot, path: Path, place: Path | None) -> str | None:
    """What ``model`` must say in the new file; None where nothing changes."""
    assert robot.file is not None
    target = (place or path.parent).resolve()
    if robot.model is None or robot.file.resolve().parent == target:
        return None
    if bundled(robot) and robot.model.is_file():
        path.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(robot.model, path.parent / robot.model.name)
        return robot.model.name
    try:
        return Path(os.path.relpath(robot.model.resolve(), target)).as_posix()
    except ValueError:  # another drive of Windows
        return robot.model.resolve().as_posix()


def _check(temporary: Path, robot: Robot, estimates: Sequence[DriveEstimate], path: Path) -> None:
    """Loads what was written: what was identified is new, everything else as before."""
    try:
        again = Robot.load(temporary)
    except InputError as error:
        raise InputError(
            f"the identified values do not make a valid robot: {error.rule}",
            file=path,
            joint=error.joint,
            quantity=error.quantity,
            value=error.value,
        ) from None
    if again.joints != robot.joints:
        raise InputError("its joints would change; is its layout unusual?", file=path)
    assert robot.file is not None
    old, new = read_toml(robot.file)["joint"], read_toml(temporary)["joint"]
    known = {estimate.joint: new_values(estimate) for estimate in estimates if not too_wide(estimate)}
    for before, after in zip(old, new, strict=True):
        values, uncertainty = known.get(before["name"], ({}, {}))
        wanted = {**before, **values}
        if uncertainty:
            wanted["uncertainty"] = {**before.get("uncertainty", {}), **uncertainty}
        for table in (wanted, after):
            table.pop("identified", None)
        if wanted != after:
            raise InputError(
                "its values would not be as identified; is its layout unusual?",
                file=path,
                joint=before["name"],
            )


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")


def _up(value: float) -> float:
    """Rounded up to three significant digits, so that an interval stays covered."""
    if value <= 0 or not math.isfinite(value):
        return max(value, 0.0)
    step = 10.0 ** (math.floor(math.log10(value)) - 2)
    return float(f"{math.ceil(value / step - 1e-9) * step:.3g}")
