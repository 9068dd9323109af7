"""Faults that begin and end while an arm runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

import dashpot._native as _native
from dashpot.arm.plant import Plant
from dashpot.errors import InputError
from dashpot.simulation.faults import Fault
from dashpot.simulation.script import FAULT_DTYPE, fault_records, fault_rows
from dashpot.simulation.trajectory import Trajectory


class Failing:
    """The script of an arm's faults, of which any may begin or end at the coming tick."""

    def __init__(self, script: _native.Faults, joints: Sequence[str], path: Trajectory, seed: int) -> None:
        """For a run's native faults, its controlled joints, its trajectory and seed."""
        self._script, self._joints, self._path, self._seed = script, joints, path, seed
        self._ended: dict[int, bool] = {}  # place in the script -> whether it may be used again
        self._streams = 0

    def begin(self, fault: Fault, plant: Plant, tick: int) -> list[int]:
        """Lets something fail from a tick on; returns its places in the script, for `end`.

        Raises:
            InputError: The fault does not fit the arm, or too many act at once.
        """
        now = replace(fault, start=0.0, end=float("inf"))
        rows = [
            (kind, drive, tick, last, value, damping)
            for kind, drive, _, last, value, damping in fault_rows(now, plant, self._joints, self._path)
        ]
        free = [place for place, ended in self._ended.items() if ended]
        places = [*free, *range(len(self._ended), _native.MAX_FAULTS)][: len(rows)]
        if len(places) < len(rows):
            most = _native.MAX_FAULTS
            raise InputError(f"at most {most} at a time, counting each joint", quantity="faults")
        for place, record in zip(places, fault_records(rows, self._seed, self._streams), strict=True):
            self._script.put(place, record.reshape(1).view(np.uint8))
            self._ended[place] = False
        self._streams += len(rows)
        return places

    def end(self, places: Sequence[int]) -> None:
        """Ends what `begin` has begun."""
        for place in places:
            self._script.put(place, np.zeros(1, FAULT_DTYPE).view(np.uint8))  # first = last: acts never
            self._ended[place] = True
