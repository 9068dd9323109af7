"""An arm: a MJCF or URDF model and the drives of its joints."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from dashpot.arm.drive import Drive
from dashpot.errors import InputError
from dashpot.support.tables import as_float, check_keys, read_toml

BUNDLED = ("k807", "fr3", "iiwa14")
MAX_ANGLE = 4 * np.pi  # two turns; more is degrees


@dataclass(frozen=True)
class Robot:
    """A torque-sensed arm.

    Attributes:
        name: Its name.
        drives: One per joint, base to tip.
        model: MJCF or URDF file, or None where only the drives are known.
        flange: Site of the model that payloads hang on; None: the frame of the last joint's body.
        home: Working pose, (n,) [rad].
        gravity_compensation: Whether the robot itself adds the torque that holds its bare links to every
            command, as the FR3 does. Scenarios say whether it is switched on.
        file: The TOML it was read from.
    """

    name: str
    drives: tuple[Drive, ...]
    model: Path | None = None
    flange: str | None = None
    home: tuple[float, ...] = ()
    gravity_compensation: bool = False
    file: Path | None = None

    def __post_init__(self) -> None:
        names = self.joints
        if not names:
            raise InputError("a robot needs at least one [[joint]]", file=self.file)
        for name in names:
            if names.count(name) > 1:
                raise InputError("is listed twice", file=self.file, joint=name)
        if not self.home:
            object.__setattr__(self, "home", (0.0,) * len(names))
        if len(self.home) != len(names) or not np.isfinite(self.home).all():
            raise InputError(
                f"must be {len(names)} finite angle{'s' if len(names) > 1 else ''} [rad], one per joint",
                file=self.file,
                quantity="home",
                value=list(self.home),
            )
        for name, angle in zip(names, self.home, strict=True):
            if abs(angle) > MAX_ANGLE:
                raise InputError(
                    f"must be within {MAX_ANGLE:.4g} rad; check the unit",
                    file=self.file,
                    joint=name,
                    quantity="home [rad]",
                    value=angle,
                )

    @cached_property
    def joints(self) -> tuple[str, ...]:
        """Joint names, base to tip."""
        return tuple(drive.name for drive in self.drives)

    @classmethod
    def load(cls, source: str | Path) -> Robot:
        """Reads a robot TOML, or a bundled arm by name (`BUNDLED`).

        Args:
            source: Path of a TOML file (docs/files.md), or "k807", "fr3", "iiwa14".

        Raises:
            InputError: Naming file, joint, key, value and rule.
        """
        if str(source) in BUNDLED:
            path = Path(str(files("dashpot") / "robots" / f"{source}.toml"))
        else:
            path = Path(source)
            if not os.path.exists(path) and path.suffix != ".toml":
                raise InputError(
                    f"neither a file nor a bundled robot ({', '.join(BUNDLED)})", quantity=str(source)
                )
        table = read_toml(path)
        known = {"name", "model", "flange", "home", "gravity_compensation", "joint"}
        check_keys(table, known, {"name", "joint"}, file=path)
        for key in ("name", "model", "flange"):
            if not isinstance(table.get(key, ""), str):
                raise InputError("must be a string", file=path, quantity=key, value=table[key])
        entries, home = table["joint"], table.get("home", [])
        carries = table.get("gravity_compensation", False)
        if type(carries) is not bool:
            raise InputError(
                "must be true or false", file=path, quantity="gravity_compensation", value=carries
            )
        if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
            raise InputError("must be [[joint]] tables", file=path, quantity="joint")
        if not isinstance(home, list) or not all(type(q) in (int, float) for q in home):
            raise InputError("must be a list of angles [rad]", file=path, quantity="home", value=home)
        return cls(
            name=table["name"],
            drives=tuple(Drive.from_table(entry, file=path) for entry in entries),
            model=path.parent / table["model"] if "model" in table else None,
            flange=table.get("flange"),
            home=tuple(as_float(q) for q in home),
            gravity_compensation=carries,
            file=path,
        )

    def index(self, joint: str) -> int:
        """Position of a joint, base to tip.

        Raises:
            InputError: The robot has no such joint.
        """
        if joint not in self.joints:
            raise InputError(f"no such joint; it has {', '.join(self.joints)}", file=self.file, joint=joint)
        return self.joints.index(joint)

    def with_drives(self, changes: Mapping[str, Mapping[str, Any]]) -> Robot:
        """A copy with some drive values replaced: ``{"joint5": {"coulomb_friction": 0.5}}``.

        Raises:
            InputError: An unknown joint or an invalid value.
        """
        drives = list(self.drives)
        for joint, values in changes.items():
            i = self.index(joint)
            check_keys(values, {f.name for f in fields(Drive)} - {"name"}, set(), file=self.file, joint=joint)
            drives[i] = replace(drives[i], **values)
        return replace(self, drives=tuple(drives))
