"""What a closed-loop run leaves behind: arrays at the control ticks, saved and loaded whole."""

from __future__ import annotations

import json
import os
import zlib
from dataclasses import dataclass, field
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from dashpot.errors import InputError
from dashpot.support.arrays import Floats

CHANNELS = (
    "position",
    "velocity",
    "link_position",
    "link_velocity",
    "torque",
    "sample",
    "command",
    "in_effect",
)
"""Arrays of a `Recording`, in the order of native/dashpot_runner.h."""


@dataclass
class Recording:
    """What happened, at the control ticks. Joint order is the robot's, base to tip.

    Attributes:
        joints: Names, n of them.
        time: (ticks,) [s].
        reference: Position reference, (ticks, n) [rad].
        position: Rotor angle as the position loop reads it, (ticks, n) [rad].
        velocity: Its rate, (ticks, n) [rad/s].
        link_position: Link angle, (ticks, n) [rad].
        link_velocity: (ticks, n) [rad/s].
        torque: Torque transmitted to the link, true, (ticks, n) [N m].
        sample: Torque sample given to the controller, (ticks, n) [N m].
        command: Torque commanded at this tick, (ticks, n) [N m]; a servo joint's last torque.
        in_effect: Torque asked of the drive over the coming period, (ticks, n) [N m].
        status: Or-ed controller statuses, (ticks,).
        diverged_at: Time at which the simulation blew up [s], or None; later rows are NaN.
        settings: What made it: robot, period, time step, seed, label.
    """

    joints: tuple[str, ...]
    time: Floats
    reference: Floats
    position: Floats
    velocity: Floats
    link_position: Floats
    link_velocity: Floats
    torque: Floats
    sample: Floats
    command: Floats
    in_effect: Floats
    status: NDArray[np.int32]
    diverged_at: float | None = None
    settings: dict[str, object] = field(default_factory=dict)

    def save(self, path: str | Path) -> Path:
        """Writes a ``.npz``; an interrupted write leaves no file."""
        path = Path(path)
        arrays = {name: getattr(self, name) for name in ("time", "reference", "status", *CHANNELS)}
        header = {"joints": self.joints, "diverged_at": self.diverged_at, "settings": self.settings}
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
        try:
            with temporary.open("wb") as stream:
                np.savez_compressed(stream, header=np.array(json.dumps(header)), **arrays)
            os.replace(temporary, path)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
        return path

    @classmethod
    def load(cls, path: str | Path) -> Recording:
        """Reads what `save` wrote.

        Raises:
            InputError: The file is missing or not a recording.
        """
        try:
            with Path(path).open("rb") as stream, np.load(stream) as archive:
                header = json.loads(str(archive["header"]))
                arrays = {name: archive[name] for name in ("time", "reference", "status", *CHANNELS)}
            header["joints"] = tuple(header["joints"])
            return cls(**header, **arrays)
        except FileNotFoundError:
            raise InputError("no such file", file=path) from None
        except (OSError, ValueError, KeyError, TypeError, AttributeError, EOFError, BadZipFile, zlib.error):
            raise InputError("not a dashpot recording", file=path) from None
