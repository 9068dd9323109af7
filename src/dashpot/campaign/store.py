"""The dataset on disk: Zarr arrays with named dimensions, written chunk by chunk, done markers last.

A chunk counts as done once its part of ``status`` is there. It is written after every other array's part, and
each part is a file that appears whole, so that a killed campaign loses at most the chunks that were being run
or written, and a chunk that is done is never run again.
"""

from __future__ import annotations

import fcntl
import os
import secrets
import shutil
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dashpot.campaign.axes import Axis
from dashpot.campaign.measures import MEASURES
from dashpot.campaign.scenario import Campaign, versions
from dashpot.campaign.spec import Spec
from dashpot.campaign.together import LANES, MUJOCO, run_together
from dashpot.errors import DashpotError, InputError

FORMAT = 2
STATUS_WORDS = "pending ok diverged failed"
COORDINATE_CHUNK = 65536


@dataclass
class Block:
    """Results of a chunk.

    Attributes:
        chunk: Its number.
        status: (scenarios,).
        reason: Why scenarios failed; "" where they did not.
        measures: Name -> (scenarios,) or (scenarios, n).
        engine: `MUJOCO` or `LANES`, (scenarios,).
    """

    chunk: int
    status: np.ndarray[Any, np.dtype[np.uint8]]
    reason: list[str]
    measures: dict[str, Any]
    engine: np.ndarray[Any, np.dtype[np.uint8]]


def run_chunk(campaign: Campaign, chunk: int) -> Block:
    """Runs the scenarios of a chunk, some of them at a time."""
    indices = campaign.spec.chunk_indices(chunk)
    n = len(campaign.robot.joints)
    measures = {
        name: np.full((len(indices), n) if kind.per_joint else len(indices), np.nan)
        for name, kind in MEASURES.items()
    }
    status, engine = np.zeros(len(indices), np.uint8), np.zeros(len(indices), np.uint8)
    reasons = []
    for row, outcome in enumerate(run_together(campaign, indices)):
        status[row], engine[row] = outcome.status, outcome.engine
        reasons.append(outcome.reason)
        for name, value in outcome.measures.items():
            measures[name][row] = value
    return Block(chunk, status, reasons, measures, engine)


class Store:
    """A campaign's dataset, open for writing."""

    def __init__(self, path: Path, campaign: Campaign) -> None:
        import zarr

        self.path, self.spec = path, campaign.spec
        self.arrays = dict(
            zarr.open_group(str(path), mode="r+", zarr_format=3, use_consolidated=False).arrays()
        )
        self._lock = os.open(path, os.O_RDONLY)
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(self._lock)
            raise DashpotError(f"{path}: another campaign is writing to it") from None
        for leftover in path.rglob("*.partial"):  # of writes that a kill cut off
            leftover.unlink(missing_ok=True)

    def close(self) -> None:
        """Lets others write."""
        os.close(self._lock)

    def pending(self) -> list[int]:
        """Chunks that are not done, in order."""
        spec, status = self.spec, self.arrays["status"]
        if not (self.path / "status" / "c").exists():  # nothing written yet
            return list(range(spec.chunks))
        done = np.asarray(status[...])
        return [chunk for chunk in range(spec.chunks) if not done[spec.chunk_region(chunk)].all()]

    def commit(self, block: Block) -> None:
        """Writes a chunk; it is done when this returns."""
        region = self.spec.chunk_region(block.chunk)
        shape = tuple(part.stop - part.start for part in region)
        for name, values in block.measures.items():
            self.arrays[name][region] = values.reshape(*shape, *values.shape[1:])
        if any(block.reason):
            self.arrays["reason"][region] = np.array(block.reason, object).reshape(shape)
        self.arrays["engine"][region] = block.engine.reshape(shape)
        self.arrays["status"][region] = block.status.reshape(shape)


def create(path: Path, campaign: Campaign) -> None:
    """Creates an empty dataset; it appears whole or not at all.

    Raises:
        InputError: The place is taken, or cannot be written.
    """
    place = path.resolve()
    work = place.with_name(f".{place.name}.{secrets.token_hex(4)}.part")
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        try:
            _create(work, campaign)
            if place.is_dir() and not any(place.iterdir()):
                place.rmdir()
            work.rename(place)
        except OSError as error:
            if place.exists():
                raise InputError(
                    "exists and is not a campaign; choose another folder", quantity="--out", value=str(path)
                ) from None
            raise InputError(
                f"cannot be written: {error.strerror or error}", quantity="--out", value=str(path)
            ) from None
    finally:
        shutil.rmtree(work, ignore_errors=True)


def _create(work: Path, campaign: Campaign) -> None:
    import zarr

    spec, joints = campaign.spec, campaign.robot.joints
    group = zarr.create_group(str(work), zarr_format=3, attributes=_attributes(campaign))

    def array(
        name: str,
        dims: tuple[str, ...],
        shape: tuple[int, ...],
        chunks: tuple[int, ...],
        kind: Any,
        fill: Any,
        **attrs: Any,
    ) -> Any:
        return group.create_array(
            name,
            shape=shape,
            chunks=chunks,
            dtype=kind,
            fill_value=fill,
            dimension_names=dims,
            attributes=attrs,
        )

    def coordinate(name: str, dims: tuple[str, ...], values: Any, **attrs: Any) -> None:
        values = np.asarray(values)
        text = values.dtype.kind in "UO"
        chunks = tuple(min(length, COORDINATE_CHUNK) for length in values.shape)
        made = array(
            name, dims, values.shape, chunks, str if text else values.dtype, "" if text else 0, **attrs
        )
        made[...] = values.astype(object) if text else values

    shape, dims, block, n = spec.shape, spec.dims, spec.block, len(joints)
    others = ["scenario"] if dims != ("scenario",) else []
    for name, kind in MEASURES.items():
        attrs = {"units": kind.unit, "long_name": kind.words}
        if kind.per_joint:
            array(name, (*dims, "joint"), (*shape, n), (*block, n), "f8", np.nan, **attrs)
        else:
            array(name, dims, shape, block, "f8", np.nan, **attrs)
    flags = {"flag_values": [0, 1, 2, 3], "flag_meanings": STATUS_WORDS}
    array("status", dims, shape, block, "u1", 0, long_name="what became of the scenario", **flags)
    engines = {"flag_values": [0, MUJOCO, LANES], "flag_meanings": "none mujoco lanes"}
    array("engine", dims, shape, block, "u1", 0, long_name="what simulated the scenario", **engines)
    array("reason", dims, shape, block, str, "", long_name="why the scenario failed")
    coordinate("joint", ("joint",), joints, long_name="joint, base to tip")
    about = "index of the scenario: dashpot replay DATASET INDEX"
    coordinate("scenario", dims, np.arange(spec.size).reshape(shape), long_name=about)
    for axis in spec.grid:
        coordinate(axis.label, (axis.label,), axis.labels, **_about(axis))
        if axis.name == "offset" and axis.named:
            coordinate("offset_xyz", (axis.label, "xyz"), axis.values, **_about(axis))
            others.append("offset_xyz")
    if spec.sampled:
        coordinate("sample", ("sample",), np.arange(spec.count), long_name="point of the sample")
        column = 0
        for axis in spec.sampled:
            width = n if axis.each_joint else 1
            drawn = campaign.sample[:, column : column + width]
            column += width
            values = np.vectorize(axis.at)(drawn)
            along = ("sample", "joint") if axis.each_joint else ("sample",)
            coordinate(axis.label, along, values if axis.each_joint else values[:, 0], **_about(axis))
            others.append(axis.label)
    group.attrs["coordinates"] = " ".join(others)
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore"
        )  # consolidated metadata is not in the Zarr 3 text yet; xarray reads it
        zarr.consolidate_metadata(str(work), zarr_format=3)


def _about(axis: Axis) -> dict[str, str]:
    kind = {"gains": "multiplier of gains", "drive": "drive error of the plant"}.get(
        axis.name.split(".")[0], axis.name
    )
    added = axis.name.startswith("drive.") and axis.unit != "-"
    about = {"long_name": f"{kind}: {axis.name}" if kind != axis.name else kind, "units": axis.unit}
    if axis.name.startswith("drive."):
        about["comment"] = (
            "added to the nominal value"
            if added or axis.name.endswith("error")
            else "times the nominal value"
        )
    return {key: value for key, value in about.items() if value}


def _attributes(campaign: Campaign) -> dict[str, Any]:
    spec = campaign.spec
    return {
        "title": f"dashpot campaign of {campaign.robot.name}",
        "dashpot_campaign": FORMAT,
        "spec": spec.text,
        "spec_file": None if spec.file is None else str(spec.file.absolute()),
        "robot": spec.robot,
        "controllers": list(spec.controllers),
        "scenarios": spec.size,
        "seed": spec.seed,
        "sample": spec.sample or "grid",
        "versions": versions(),
        "sha256": campaign.digests,
        "digest": campaign.digest,
    }


def attributes(path: Path) -> dict[str, Any]:
    """What a dataset says about itself.

    Raises:
        InputError: It is not the dataset of a campaign.
    """
    import zarr

    refusal = InputError("not the dataset of a campaign", file=path)
    if not (path / "zarr.json").is_file():
        raise refusal if path.exists() else InputError("no such dataset", file=path)
    try:
        found = dict(zarr.open_group(str(path), mode="r", zarr_format=3, use_consolidated=False).attrs)
    except (OSError, ValueError, KeyError, TypeError):
        raise refusal from None
    if found.get("dashpot_campaign") != FORMAT:
        raise refusal
    return found


def spec_of(path: Path) -> Spec:
    """The specification inside a dataset."""
    about = attributes(path)
    file = about["spec_file"]
    return Spec.parse(
        about["spec"],
        None if file is None else Path(file),
        robot=about["robot"],
        controller=tuple(about["controllers"]),
    )


def campaign_of(path: Path) -> Campaign:
    """The campaign of a dataset, its files as they were.

    Raises:
        InputError: A file that decides the outcome has changed, or another version is installed.
    """
    about = attributes(path)
    campaign = Campaign(spec_of(path))
    check_same(path, about, campaign)
    return campaign


def check_same(path: Path, about: Mapping[str, Any], campaign: Campaign) -> None:
    """Checks that a dataset is that of a campaign.

    Raises:
        InputError: It is another one; says what differs.
    """
    if about["digest"] == campaign.digest:
        return
    changed = [name for name, digest in campaign.digests.items() if about["sha256"].get(name) != digest]
    changed += [
        f"{n} {v} instead of {about['versions'].get(n)}"
        for n, v in versions().items()
        if about["versions"].get(n) != v
    ]
    what = ", ".join(changed) or "the specification"
    raise InputError(f"was made with other inputs ({what} changed); choose another --out", file=path)


def open_dataset(path: str | Path) -> Any:
    """The dataset as an `xarray.Dataset`, read as it is needed.

    Raises:
        InputError: It is not the dataset of a campaign.
    """
    import xarray

    attributes(Path(path))
    return xarray.open_dataset(str(path), engine="zarr", zarr_format=3, consolidated=True, chunks=None)
