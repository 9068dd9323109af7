"""A campaign's specification: TOML in, checked axes, means and requirements out."""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from dashpot.campaign.axes import NO_FAULT, Axis, distinct, parse_axes
from dashpot.campaign.requirements import Requirement, parse_requirements
from dashpot.control.supervisorsettings import SupervisorSettings
from dashpot.errors import InputError
from dashpot.support.arrays import Floats
from dashpot.support.limits import check_seed
from dashpot.support.tables import as_float, check_keys, check_numbers, number

PRESETS = ("readiness",)
SAMPLES = ("latin_hypercube", "sobol")
ENGINES = ("auto", "lanes", "mujoco")
MOST = 10_000_000  # scenarios; each is named by an index that a person types
CHUNK = 256  # scenarios at most that one worker runs before they are kept: writing takes as long as six
CHUNKS = 32  # a small campaign is cut into this many, so that every core has work
KEYS = {
    *("robot", "controller", "motion", "duration", "lead_in", "amplitude", "release", "tap", "supervisor"),
    *("gravity_compensation", "engine"),
    *("sample", "count", "seed", "chunk", "axes", "poses", "requirements"),
}


@dataclass(frozen=True)
class Spec:
    """What to vary, how, and what is required of the outcome.

    Attributes:
        robot: File or bundled name.
        controllers: Files or bundled names; several are the axis "controller".
        axes: Slowest first.
        motion: "multisine", "hold" or a CSV file.
        duration: Of the motion after the lead-in [s]; None: 6 s, or the whole file.
        lead_in: At rest before it [s].
        amplitude: Of the multisine [rad], where it is no axis.
        release: Time at which the position loop's offset is removed [s], or None.
        tap: Knock on the last link at time 0 [N m].
        supervisor: One runs in every scenario, with these settings in place of those in the
            controller's file; None: none does.
        gravity_compensation: Whether the robot's own is on, where its file says that it has one.
        engine: "lanes", the vectorised arm; "mujoco"; or "auto": the first where it can simulate the arm.
        sample: "latin_hypercube", "sobol", or None: no axis is sampled.
        count: Points of the sample.
        seed: Of the sample and of random poses.
        chunk: Scenarios that are run and kept together; None: 256, fewer in small campaigns.
        poses: Named poses, {name: (n,) [rad]}.
        pose_margin: Distance of random poses from the stops [rad]; None: amplitude + 0.1 rad.
        requirements: What `dashpot report` judges.
        text: The TOML.
        file: Where it was read from.
    """

    robot: str
    controllers: tuple[str, ...]
    axes: tuple[Axis, ...] = ()
    motion: str = "multisine"
    duration: float | None = number("s", 0, 1e5, open_low=True, default=None)
    lead_in: float = number("s", 0, 1e3, default=1.0)
    amplitude: float = number("rad", 0, 4 * math.pi, default=0.3)
    release: float | None = number("s", -1e3, 1e5, default=None)
    tap: float = number("N m", -1e5, 1e5, default=0.0)
    supervisor: Mapping[str, Any] | None = None
    gravity_compensation: bool = True
    engine: str = "auto"
    sample: str | None = None
    count: int = 0
    seed: int = 0
    chunk: int | None = None
    poses: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    pose_margin: float | None = number("rad", 0, 4 * math.pi, default=None)
    requirements: tuple[Requirement, ...] = ()
    text: str = ""
    file: Path | None = None

    def __post_init__(self) -> None:
        check_numbers(self, file=self.file)
        sampled = [axis.name for axis in self.axes if axis.sampled]
        if self.sample is not None and self.sample not in SAMPLES:
            raise self._refuse(f"must be one of {', '.join(SAMPLES)}", "sample", self.sample)
        if sampled and self.sample is None:
            raise self._refuse(
                f'a range needs sample = "{SAMPLES[0]}" or "{SAMPLES[1]}" and a count, or points of its own',
                f"axes.{sampled[0]}",
            )
        if sampled and (type(self.count) is not int or not 1 <= self.count <= MOST):
            raise self._refuse(f"must be 1 to {MOST} points of the sample", "count", self.count)
        if type(self.gravity_compensation) is not bool:
            raise self._refuse("must be true or false", "gravity_compensation", self.gravity_compensation)
        if self.engine not in ENGINES:
            raise self._refuse(f"must be one of {', '.join(ENGINES)}", "engine", self.engine)
        check_seed(self.seed, "seed", file=self.file)
        if self.chunk is not None and (type(self.chunk) is not int or not 1 <= self.chunk <= 10_000):
            raise self._refuse("must be 1 to 10000 scenarios", "chunk", self.chunk)
        if self.size > MOST:
            raise self._refuse(f"{self.size} scenarios, at most {MOST} are run", "axes")
        if self.motion != "multisine":
            inert = [a.name for a in self.axes if a.name in ("amplitude", "trajectory")]
            inert += [a.name for a in self.axes if a.name == "pose" and self.motion != "hold"]
            if inert:
                raise self._refuse(f"has no effect on motion = {self.motion!r}", f"axes.{inert[0]}")
        for name in self.axis("pose").values if self.has("pose") else ():
            if (
                name != "home"
                and name not in self.poses
                and not (self.random_poses and name.startswith("random"))
            ):
                known = ", ".join(("home", *self.poses))
                raise self._refuse(f"no such pose; known: {known}; others in [poses]", "axes.pose", name)
        for requirement in self.requirements:
            for axis, value in requirement.where:
                if not self.has(axis):
                    raise self._refuse(
                        "no such axis in [axes]", f"requirements.{requirement.name}.where", axis
                    )
                for one in value if isinstance(value, tuple) else (value,):
                    if not self.axis(axis).sampled and one not in self.axis(axis).labels:
                        shown = ", ".join(map(str, self.axis(axis).labels))
                        raise self._refuse(
                            f"not on this axis: {shown}", f"requirements.{requirement.name}.where", one
                        )

        # Last: whoever is about to add the range is told what else is wrong.
        if self.sample is not None and not sampled:
            raise self._refuse("no axis is a range to sample, {low = ..., high = ...}", "sample", self.sample)
        if not sampled and self.count:
            raise self._refuse("is for samples only", "count", self.count)

    def _refuse(self, rule: str, quantity: str, value: object = None) -> InputError:
        return InputError(rule, file=self.file, quantity=quantity, value=value)

    @property
    def random_poses(self) -> bool:
        """Whether the poses are random ones."""
        return self.has("pose") and self.axis("pose").values[0] == "random0" and "random0" not in self.poses

    def has(self, name: str) -> bool:
        """Whether an axis is there."""
        return any(axis.name == name for axis in self.axes)

    def axis(self, name: str) -> Axis:
        """An axis by name."""
        return next(axis for axis in self.axes if axis.name == name)

    @property
    def grid(self) -> tuple[Axis, ...]:
        """Axes with lists of values, slowest first."""
        return tuple(axis for axis in self.axes if not axis.sampled)

    @property
    def sampled(self) -> tuple[Axis, ...]:
        """Axes with ranges that the sample fills."""
        return tuple(axis for axis in self.axes if axis.sampled)

    @property
    def dims(self) -> tuple[str, ...]:
        """Dimensions of the scenarios: "sample" first if there is one, then the grid axes."""
        names = (("sample",) if self.sampled else ()) + tuple(axis.label for axis in self.grid)
        return names or ("scenario",)

    @property
    def shape(self) -> tuple[int, ...]:
        """Lengths of `dims`."""
        lengths = ((self.count,) if self.sampled else ()) + tuple(len(axis.values) for axis in self.grid)
        return lengths or (1,)

    @property
    def size(self) -> int:
        """Number of scenarios."""
        return math.prod(self.shape)

    @cached_property
    def block(self) -> tuple[int, ...]:
        """Shape of a chunk over `dims`: whole fast axes, a part of one, single slow ones."""
        left = self.chunk or min(max(self.size // CHUNKS, 1), CHUNK)
        block = []
        for length in reversed(self.shape):
            part = min(length, max(left, 1))
            left = left // length if part == length else 0
            block.append(part)
        return tuple(reversed(block))

    @property
    def chunks(self) -> int:
        """Number of chunks."""
        return math.prod(self._chunk_grid)

    @property
    def _chunk_grid(self) -> tuple[int, ...]:
        return tuple(-(-length // part) for length, part in zip(self.shape, self.block, strict=True))

    def chunk_region(self, chunk: int) -> tuple[slice, ...]:
        """Where a chunk lies in arrays over `dims`."""
        at = np.unravel_index(chunk, self._chunk_grid)
        return tuple(
            slice(int(i) * part, min((int(i) + 1) * part, length))
            for i, part, length in zip(at, self.block, self.shape, strict=True)
        )

    def chunk_indices(self, chunk: int) -> range:
        """Indices of a chunk's scenarios: they are consecutive."""
        region = self.chunk_region(chunk)
        first = int(np.ravel_multi_index([part.start for part in region], self.shape))
        return range(first, first + math.prod(part.stop - part.start for part in region))

    def points(self, joints: int) -> Floats:
        """The sample in the unit cube, (count, dimensions); axes in order, n columns where per joint."""
        from scipy.stats import qmc

        width = sum(joints if axis.each_joint else 1 for axis in self.sampled)
        rng = np.random.default_rng(self.seed)
        if self.sample == "sobol":
            exponent = max(0, math.ceil(math.log2(self.count)))  # only powers of two are balanced: cut one
            drawn = qmc.Sobol(width, rng=rng).random_base2(exponent)[: self.count]
        else:
            drawn = qmc.LatinHypercube(width, rng=rng).random(self.count)
        return np.asarray(drawn)

    @property
    def resolved(self) -> str:
        """Everything that decides the scenarios, as JSON: equal text, equal scenarios."""
        keep = {
            name: getattr(self, name) for name in self.__dataclass_fields__ if name not in ("text", "file")
        }
        keep |= {"requirements": None, "block": self.block}
        return json.dumps(keep, default=lambda item: item.__dict__, sort_keys=True)

    @classmethod
    def load(cls, source: str | Path, *, robot: str | None = None, controller: tuple[str, ...] = ()) -> Spec:
        """Reads a specification TOML, or a preset by its name.

        Args:
            source: File, or a name in `PRESETS`.
            robot: Replaces the file's; a path is absolute or relative to the specification.
            controller: Likewise.

        Raises:
            InputError: Naming file, key, value and rule.
        """
        preset = str(source) in PRESETS
        path = (
            Path(str(files("dashpot") / "campaign" / "presets" / f"{source}.toml"))
            if preset
            else Path(source)
        )
        if not path.exists() and path.suffix != ".toml":
            raise InputError(f"neither a file nor a preset ({', '.join(PRESETS)})", quantity=str(source))
        try:
            text = path.read_text(encoding="utf-8")
        except FileNotFoundError:
            raise InputError("no such file", file=path) from None
        except OSError as error:
            raise InputError(f"cannot be read: {error.strerror}", file=path) from None
        except UnicodeDecodeError as error:
            raise InputError(f"not valid TOML: {error}", file=path) from None
        return cls.parse(text, path, robot=robot, controller=controller)

    @classmethod
    def parse(
        cls, text: str, file: Path | None, *, robot: str | None = None, controller: tuple[str, ...] = ()
    ) -> Spec:
        """Reads a specification from its text; paths in it are relative to the file.

        Raises:
            InputError: Naming file, key, value and rule.
        """
        try:
            table = tomllib.loads(text)
        except (ValueError, RecursionError) as error:
            raise InputError(f"not valid TOML: {error}", file=file) from None
        if robot is not None:
            table["robot"] = robot
        if controller:
            table["controller"] = list(controller)
        check_keys(table, KEYS, {"robot", "controller"}, file=file)
        for key in ("axes", "poses", "requirements"):
            if not isinstance(table.get(key, {}), dict):
                raise InputError(f"must be a table, [{key}]", file=file, quantity=key, value=table[key])
        given = dict(table.pop("axes", {}))
        controllers = table.pop("controller")
        if "controller" in given:
            raise InputError(
                "belongs above [axes]: controller = [...]", file=file, quantity="axes.controller"
            )
        if isinstance(controllers, list) and len(controllers) > 1:
            given["controller"] = controllers
        names = tuple(controllers) if isinstance(controllers, list) else (controllers,)
        for key, values, entry in (
            ("robot", (table["robot"],), table["robot"]),
            ("controller", names, controllers),
        ):
            if not values or not all(isinstance(value, str) and value for value in values):
                raise InputError("must be a file or a bundled name", file=file, quantity=key, value=entry)
        for key in ("motion", "sample", "engine"):
            if not isinstance(table.get(key, ""), str):
                raise InputError("must be a text", file=file, quantity=key, value=table[key])
        pose = given.get("pose")
        margin = pose.get("margin") if isinstance(pose, dict) else None
        for key in ("duration", "lead_in", "amplitude", "release", "tap"):
            if type(table.get(key)) is int:
                table[key] = as_float(table[key])
        return cls(
            controllers=distinct(names, "controller", file),
            axes=parse_axes(given, file),
            poses=_poses(table.pop("poses", {}), file),
            pose_margin=as_float(margin) if type(margin) is int else margin,
            requirements=parse_requirements(table.pop("requirements", {}), file),
            text=text,
            file=file,
            supervisor=_supervisor(table.pop("supervisor", False), file),
            **table,
        )

    def path(self, name: str) -> Path:
        """A file named in the specification, relative to it."""
        return Path(name) if self.file is None else self.file.parent / name


def _supervisor(entry: Any, file: object) -> Mapping[str, Any] | None:
    """True, false, or a table of settings: what differs from the controller's own."""
    if isinstance(entry, bool):
        return {} if entry else None
    if not isinstance(entry, Mapping):
        raise InputError(
            "must be true, false or a table of settings", file=file, quantity="supervisor", value=entry
        )
    settings = SupervisorSettings.from_table(entry, file=file)
    return {key: getattr(settings, key) for key in entry}


def _poses(table: Mapping[str, Any], file: object) -> dict[str, tuple[float, ...]]:
    poses = {}
    for name, angles in table.items():
        if not isinstance(angles, list) or not all(type(angle) in (int, float) for angle in angles):
            raise InputError(
                "must be a list of angles [rad]", file=file, quantity=f"poses.{name}", value=angles
            )
        poses[name] = tuple(as_float(angle) for angle in angles)
    return poses


__all__ = ["NO_FAULT", "PRESETS", "Spec"]
