"""A specification in the user's words: TOML, a preset's name, and changes from the command line."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from dashpot.arm.robot import Robot
from dashpot.control.controller import ControllerConfig, JointGains, Sampling
from dashpot.control.sampled import Form
from dashpot.design.wishes import PRESETS, Wishes
from dashpot.errors import InputError
from dashpot.support.tables import as_float, check_keys, check_numbers, number, read_toml

Pose = Literal["worst", "home"]
DEFAULT_PERIOD = 1e-3
NO_LIMIT = "none"
"""Value of a wish that takes a preset's limit away."""
WISHES = tuple(f.name for f in fields(Wishes))
CARRIED = ("inertia", "load")
"""What a joint's table may state instead of leaving it to the model."""


@dataclass(frozen=True)
class Spec:
    """What is wanted of an arm, and the means.

    Attributes:
        preset: "brake", "track" or "gentle": where wishes come from that are not given.
        wishes: Changes to the preset, as in `Wishes`.
        joints: Joints to design; empty: all.
        own: Changes for single joints, {joint: {wish or "inertia" or "load": value}}.
        payload: Largest payload [kg].
        offset: Its centre in the flange frame [m].
        pose: "worst": inertia and load are the largest over the joints' ranges; "home": at home.
        gravity_compensated: Whether the robot carries its own weight, so that only the payload's is a load.
        period: [s]; None: 1 ms.
        latency: [samples]; None: as identified for the drives, else 0.
        latency_max: [samples]; None: as identified, else `latency`.
        sampling: None: "point" where every drive has a sensor filter, else "average".
        form: Discretisation.
        speed: Joint speed from which a stop is counted [rad/s].
        residual_speed: Share of it below which a joint has stopped [-].
        jump: Position error to which the answer must keep within `authority` [rad].
        file: Where it was read from.
    """

    preset: str = "track"
    wishes: Mapping[str, Any] = field(default_factory=dict)
    joints: tuple[str, ...] = ()
    own: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    payload: float = number("kg", 0, 1e4, typical=(0.01, 500), default=0.0)
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    pose: Pose = "worst"
    gravity_compensated: bool = True
    period: float | None = number("s", 1e-5, 1.0, typical=(1e-4, 0.02), default=None)
    latency: int | None = None
    latency_max: int | None = None
    sampling: Sampling | None = None
    form: Form = "implicit"
    speed: float = number("rad/s", 0, 100, open_low=True, default=0.5)
    residual_speed: float = number("-", 0, 1, open_low=True, default=0.05)
    jump: float = number("rad", 0, 1, open_low=True, default=0.02)
    file: Path | None = None

    def __post_init__(self) -> None:
        check_numbers(self, file=self.file)
        for key, value, valid in (
            ("preset", self.preset, tuple(PRESETS)),
            ("pose", self.pose, get_args(Pose)),
            ("sampling", self.sampling or "point", get_args(Sampling)),
            ("form", self.form, get_args(Form)),
        ):
            if value not in valid:
                options = ", ".join(f'"{option}"' for option in valid)
                raise InputError(f"must be one of {options}", file=self.file, quantity=key, value=value)
        if type(self.gravity_compensated) is not bool:
            raise InputError(
                "must be true or false",
                file=self.file,
                quantity="gravity_compensated",
                value=self.gravity_compensated,
            )
        if len(self.offset) != 3 or not np.isfinite(self.offset).all():
            raise InputError(
                "must be three finite numbers", file=self.file, quantity="offset [m]", value=self.offset
            )
        if self.residual_speed >= 1:
            raise InputError(
                "must be below 1", file=self.file, quantity="residual_speed [-]", value=self.residual_speed
            )
        # The controller's own rules for its means.
        ControllerConfig(
            (JointGains("joint", R=1.0, D=1.0),),
            period=self.period or DEFAULT_PERIOD,
            latency=self.latency or 0,
            latency_max=self.latency_max,
            file=self.file,
        )
        for joint in (None, *self.own):
            self.of(joint)

    def of(self, joint: str | None) -> Wishes:
        """Wish and limits of a joint, or of every joint (None).

        Raises:
            InputError: A wish is unknown or its value not valid.
        """
        own = {key: value for key, value in self.own.get(joint or "", {}).items() if key not in CARRIED}
        values = {
            key: as_float(value) if type(value) is int else None if value == NO_LIMIT else value
            for key, value in {**self.wishes, **own}.items()
        }
        check_keys(values, set(WISHES), set(), file=self.file, joint=joint)
        try:
            return PRESETS[self.preset].changed(values)
        except InputError as error:
            raise InputError(
                error.rule, file=self.file, joint=joint, quantity=error.quantity, value=error.value
            ) from None

    @property
    def loop(self) -> bool:
        """Whether the joints get a position loop."""
        return self.preset != "brake"

    @classmethod
    def load(cls, source: str | Path) -> Spec:
        """Reads a specification TOML, or takes a preset by its name.

        Raises:
            InputError: Naming file, joint, key, value and rule.
        """
        if str(source) in PRESETS:
            return cls(preset=str(source))
        path = Path(source)
        if not os.path.exists(path) and path.suffix != ".toml":
            raise InputError(f"neither a file nor a preset ({', '.join(PRESETS)})", quantity=str(source))
        table = read_toml(path)
        known = {f.name for f in fields(cls)} - {"wishes", "own", "file"}
        check_keys(table, known | set(WISHES) | {"joint"}, set(), file=path)
        entries = table.pop("joint", [])
        if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
            raise InputError("must be [[joint]] tables", file=path, quantity="joint")
        own: dict[str, dict[str, Any]] = {}
        for entry in entries:
            name = entry.pop("name", None)
            if not isinstance(name, str):
                raise InputError("every [[joint]] needs a name", file=path, quantity="name", value=name)
            if name in own:
                raise InputError("is listed twice", file=path, joint=name)
            check_keys(entry, set(WISHES) | set(CARRIED), set(), file=path, joint=name)
            own[name] = entry
        wishes = {key: table.pop(key) for key in WISHES if key in table}
        return cls(wishes=wishes, own=own, file=path, **_typed(table, path))

    def changed(self, **values: Any) -> Spec:
        """A copy with means or wishes replaced; None leaves a value as it is."""
        given = {key: value for key, value in values.items() if value is not None}
        wishes = {key: given.pop(key) for key in WISHES if key in given}
        return replace(self, wishes={**self.wishes, **wishes}, **given)

    def check(self, robot: Robot) -> None:
        """Checks the joints that are named against a robot's.

        Raises:
            InputError: The robot has no such joint.
        """
        for joint in (*self.joints, *self.own):
            if joint not in robot.joints:
                raise InputError(
                    f"the robot has no such joint; it has {', '.join(robot.joints)}",
                    file=self.file,
                    joint=joint,
                )


def _typed(table: Mapping[str, Any], path: Path) -> dict[str, Any]:
    values = dict(table)
    for key, value in values.items():
        if type(value) is int and not key.startswith("latency"):
            values[key] = as_float(value)
    for key in ("joints", "offset"):
        if key in values:
            kind, words = (str, "names") if key == "joints" else ((int, float), "numbers")
            if not isinstance(values[key], Sequence) or not all(
                isinstance(item, kind) and not isinstance(item, bool) for item in values[key]
            ):
                raise InputError(f"must be a list of {words}", file=path, quantity=key, value=values[key])
            values[key] = tuple(values[key])
    if "offset" in values:
        values["offset"] = tuple(as_float(number) for number in values["offset"])
    return values
