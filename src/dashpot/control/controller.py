"""A controller for an arm: its file, its checks, and the native object that runs it."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

import dashpot._native as _native
from dashpot.arm.drive import Drive
from dashpot.control.jointlaw import JointGains as JointGains
from dashpot.control.jointlaw import Law as Law
from dashpot.control.laws import law_from_table
from dashpot.control.sampled import BLOCK_DTYPE, NX, Form
from dashpot.control.supervisorsettings import SupervisorSettings
from dashpot.errors import InputError
from dashpot.support.arrays import Floats
from dashpot.support.tables import as_float, check_keys, check_numbers, number, read_toml

SLIGHT = 0.1  # samples of latency that are not counted
Sampling = Literal["average", "point"]
Mode = Literal["off", "bypass", "active"]
BUNDLED = ("k807-wrist", "k807-resonant", "fr3", "iiwa14")
"""Names `load_controller` knows."""
MODES: tuple[str, ...] = get_args(Mode)

TORQUE_LIMITED, RATE_LIMITED, NOT_FINITE, BLENDING = 1, 2, 4, 8
"""Bits of the status `Controller.step` returns."""


@dataclass(frozen=True)
class ControllerConfig:
    """A controller file.

    Attributes:
        joints: Laws, one per controlled joint; the others stay under the robot's own position loop.
        period: Sample period [s].
        latency: Whole samples from computing a torque to its taking effect.
        latency_max: The longest it may be, for the certificate; None: `latency`.
        sampling: "average": mean torque over the last period; "point": the latest value.
        form: "explicit" or "implicit" discretisation of Eqs. (20)-(21).
        blend: Time constant over which a change of mode is faded in [s]; 0: at once.
        supervisor: What a supervisor of it may assume.
        file: Where it was read from.
    """

    joints: tuple[Law, ...]
    period: float = number("s", 1e-5, 1.0, typical=(1e-4, 0.02))
    latency: int = 0
    latency_max: int | None = None
    sampling: Sampling = "average"
    form: Form = "implicit"
    blend: float = number("s", 0, 10, default=0.02)
    supervisor: SupervisorSettings = field(default_factory=SupervisorSettings)
    file: Path | None = None

    def __post_init__(self) -> None:
        check_numbers(self, file=self.file)
        if type(self.latency) is not int or not 0 <= self.latency <= _native.MAX_LATENCY:
            raise InputError(
                f"must be a whole number of samples, 0 to {_native.MAX_LATENCY}",
                file=self.file,
                quantity="latency",
                value=self.latency,
            )
        longest = self.latency if self.latency_max is None else self.latency_max
        if type(longest) is not int or not self.latency <= longest <= _native.MAX_LATENCY:
            raise InputError(
                f"must be a whole number of samples, latency ({self.latency}) to {_native.MAX_LATENCY}",
                file=self.file,
                quantity="latency_max",
                value=self.latency_max,
            )
        for key, value, valid in (("sampling", self.sampling, Sampling), ("form", self.form, Form)):
            if value not in get_args(valid):
                options = " or ".join(f'"{o}"' for o in get_args(valid))
                raise InputError(f"must be {options}", file=self.file, quantity=key, value=value)
        names = [joint.name for joint in self.joints]
        if not names:
            raise InputError("a controller needs at least one [[joint]]", file=self.file)
        for name in names:
            if names.count(name) > 1:
                raise InputError("is listed twice", file=self.file, joint=name)

    @property
    def gains(self) -> tuple[JointGains, ...]:
        """Every joint's gains R, D, K, kp and kd.

        Raises:
            InputError: A joint has another law than the virtual passive one.
        """
        return tuple(gains_of(joint, file=self.file) for joint in self.joints)

    @classmethod
    def load(cls, path: str | Path) -> ControllerConfig:
        """Reads a controller TOML (docs/files.md).

        Raises:
            InputError: Naming file, joint, key, value and rule.
        """
        path = Path(path)
        table = read_toml(path)
        check_keys(
            table,
            {"period", "latency", "latency_max", "sampling", "form", "blend", "supervisor", "joint"},
            {"period", "joint"},
            file=path,
        )
        entries = table.pop("joint")
        if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
            raise InputError("must be [[joint]] tables", file=path, quantity="joint")
        joints = tuple(law_from_table(entry, file=path) for entry in entries)
        if type(table["period"]) is int:
            table["period"] = as_float(table["period"])
        table["supervisor"] = SupervisorSettings.from_table(table.get("supervisor", {}), file=path)
        return cls(joints=joints, file=path, **table)


def load_controller(source: str | Path) -> ControllerConfig:
    """Reads a controller TOML, or a bundled one by name (`BUNDLED`).

    Raises:
        InputError: See `ControllerConfig.load`.
    """
    if str(source) in BUNDLED:
        return ControllerConfig.load(Path(str(files("dashpot") / "controllers" / f"{source}.toml")))
    path = Path(source)
    if not os.path.exists(path) and path.suffix != ".toml":
        raise InputError(
            f"neither a file nor a bundled controller ({', '.join(BUNDLED)})", quantity=str(source)
        )
    return ControllerConfig.load(path)


def gains_of(law: Law, *, file: object = None) -> JointGains:
    """The gains R, D, K, kp and kd of a joint.

    Raises:
        InputError: It has another law.
    """
    if not isinstance(law, JointGains):
        raise InputError(
            'has no R and D: this needs law = "virtual_passive"',
            file=file,
            joint=law.name,
            quantity="law",
            value=law.law,
        )
    return law


def joint_block(law: Law, drive: Drive, config: ControllerConfig, *, file: object = None) -> NDArray[np.void]:
    """The coefficient block of one joint, position loop and limits included: `Law.block`."""
    return law.block(drive, config, file=file)


class Inputs(NamedTuple):
    """Views of the controller's input memory, each (n,): write them, then call `Controller.step`."""

    torque: Floats
    position: Floats
    velocity: Floats
    position_ref: Floats
    velocity_ref: Floats
    acceleration_ref: Floats
    torque_ref: Floats


class Controller:
    """Runs the joint blocks: the same native code that simulates and that runs on the robot.

    >>> controller.inputs.torque[:] = sensed          # (n,), N m: interval average or point sample
    >>> status = controller.step(command)             # writes (n,) into your array, allocates nothing

    Attributes:
        blocks: (n,) records of `BLOCK_DTYPE`.
        joints: Names, in the order of the blocks.
        period: Sample period [s].
        sampling: How the torque must be sampled.
        inputs: Views of the input memory.
        step: ``step(out) -> status`` or ``step(inputs (7, n), out (n,)) -> status``: one tick. ``out``
            receives the torque to command now [N m]; the status is an or of `TORQUE_LIMITED`, `RATE_LIMITED`,
            `NOT_FINITE` (that joint holds its last torque) and `BLENDING`.
        core: The native object.
        laws: What each block is, for tables; "block" where only its coefficients were given.
    """

    def __init__(
        self,
        blocks: NDArray[np.void],
        joints: Sequence[str],
        period: float,
        sampling: Sampling = "average",
        laws: Sequence[str] | None = None,
    ) -> None:
        if BLOCK_DTYPE.itemsize != _native.BLOCK_SIZE:
            raise RuntimeError("the native library was built from another version; reinstall dashpot")
        self.blocks = np.ascontiguousarray(blocks, BLOCK_DTYPE)
        if self.blocks.ndim != 1 or not 1 <= len(self.blocks) <= _native.MAX_JOINTS:
            raise InputError(f"a controller takes 1 to {_native.MAX_JOINTS} blocks", value=self.blocks.shape)
        if len(joints) != len(self.blocks):
            raise InputError(f"{len(joints)} joint names for {len(self.blocks)} blocks")
        for name, block in zip(joints, self.blocks, strict=True):
            for key in ("A", "B", "C", "D", "E", "bypass", "warm", "blend"):
                if not np.isfinite(block[key]).all():
                    raise InputError("must be finite", joint=name, quantity=f"coefficient {key}")
            for key, valid, rule in (
                ("torque_limit", block["torque_limit"] >= 0, "must not be negative"),
                ("rate_limit", block["rate_limit"] >= 0, "must not be negative"),
                ("blend", 0 <= block["blend"] < 1, "must be at least 0 and below 1"),
                ("nx", 0 <= block["nx"] <= NX, f"must be 0 to {NX}"),
                (
                    "latency",
                    0 <= block["latency"] <= _native.MAX_LATENCY,
                    f"must be 0 to {_native.MAX_LATENCY}",
                ),
            ):
                if not valid:
                    raise InputError(rule, joint=name, quantity=key, value=block[key].item())
        self.joints = tuple(joints)
        self.laws = tuple(laws) if laws is not None else ("block",) * len(self.joints)
        self.period = period
        self.sampling: Sampling = sampling
        self.core = _native.Core(self.blocks.view(np.uint8))
        self.inputs = Inputs(*self.core.inputs)
        self.step = self.core.step

    @classmethod
    def from_config(cls, config: ControllerConfig, drives: Sequence[Drive]) -> Controller:
        """Builds the blocks of a controller file for an arm's drives.

        Raises:
            InputError: A joint of the controller is not one of the robot.
        """
        by_name = {drive.name: drive for drive in drives}
        for gains in config.joints:
            if gains.name not in by_name:
                raise InputError(
                    f"the robot has no such joint; it has {', '.join(by_name)}",
                    file=config.file,
                    joint=gains.name,
                )
        blocks = [joint_block(g, by_name[g.name], config, file=config.file) for g in config.joints]
        names, laws = [g.name for g in config.joints], [g.label for g in config.joints]
        return cls(np.array(blocks), names, config.period, config.sampling, laws)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickled, and copied, it begins with cleared states and every joint active."""
        return Controller, (self.blocks, self.joints, self.period, self.sampling, self.laws)

    def index(self, joint: str) -> int:
        """Position of a joint among the blocks.

        Raises:
            InputError: The controller has no such joint.
        """
        try:
            return self.joints.index(joint)
        except ValueError:
            raise InputError(
                f"not controlled here; controlled: {', '.join(self.joints)}", joint=joint
            ) from None

    def set_mode(self, joint: str, mode: Mode) -> None:
        """Sets a joint off (zero torque), to bypass (position loop only) or active, faded in over `blend`."""
        if mode not in MODES:
            raise InputError(f"must be one of {', '.join(MODES)}", joint=joint, quantity="mode", value=mode)
        self.core.set_mode(self.index(joint), MODES.index(mode))

    def set_position_loop(self, joint: str, on: bool) -> None:
        """Connects or removes the position loop's torque offset; off, encoder values are not used at all."""
        self.core.set_position_loop(self.index(joint), on)

    def warm_start(self, joint: str, velocity: float) -> None:
        """Sets the law's velocity so that the brake bites at once; a later `set_mode` clears it again.

        For the virtual passive law ``xc' = -velocity``. Laws without a velocity only end a mode's fading.

        Args:
            joint: Name of the joint.
            velocity: Last trusted joint velocity [rad/s].
        """
        if not math.isfinite(velocity):
            raise InputError("must be finite", joint=joint, quantity="velocity [rad/s]", value=velocity)
        self.core.warm_start(self.index(joint), velocity)

    def reset(self) -> None:
        """Clears states, delay lines and torques; modes stay."""
        self.core.reset()

    def state(self, joint: str) -> dict[str, Any]:
        """Mode, torques [N m], status bits and block states of one joint."""
        mode, loop, command, in_effect, status, x = self.core.joint_state(self.index(joint))
        return {
            "mode": MODES[mode],
            "position_loop": loop,
            "command": command,
            "in_effect": in_effect,
            "status": status,
            "x": x,
        }
