"""The native closed loop of one scenario around MuJoCo's step: how far it has come, what it has recorded."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
from numpy.typing import NDArray

import dashpot._native as _native
from dashpot.simulation.compensation import compensation
from dashpot.simulation.engine import engine
from dashpot.simulation.prepare import Prepared
from dashpot.support.arrays import Floats

if TYPE_CHECKING:
    from dashpot.simulation.simulate import Scenario

Tables = tuple[Floats, Floats | None, Floats, NDArray[np.int32]]
"""Reference, (4, ticks, n); external torque, (ticks, n); record, (channels, ticks, n); status, (ticks,)."""

PIECE = 100  # ticks from one word about how far it has come to the next


def carry(model: Any, before: Any) -> Any:
    """MjData of another model of the same degrees of freedom, in the state of the one before."""
    data = mujoco.MjData(model)
    for name in ("qpos", "qvel", "qacc_warmstart"):
        getattr(data, name)[:] = getattr(before, name)
    data.time = before.time
    mujoco.mj_forward(model, data)
    return data


class Loop(Prepared):
    """One run of a scenario, which may be cut into pieces: `advance` goes on where it stopped."""

    def __init__(self, scenario: Scenario, link: _native.Link | None = None) -> None:
        """Prepares a run; arguments and errors as of `dashpot.simulation.prepare.Prepared`."""
        self._gravity = compensation(scenario, scenario.plant)
        super().__init__(scenario, link, self._gravity)
        self._model, self._data = self._plant.model, mujoco.MjData(self._plant.model)
        self._data.qpos[:] = self._qpos
        mujoco.mj_forward(self._model, self._data)

    def advance(self, until: int | None = None) -> None:
        """Runs up to a tick; None: to the end. Payloads change on the way; a divergence ends it for good."""
        until = self.ticks if until is None else min(until, self.ticks)
        while self.tick < until and self.diverged is None:
            while self._models and self._models[0][0] <= self.tick:
                self._model = self._models.pop(0)[1]
                self._data = carry(self._model, self._data)
            self._advance(min(until, self._models[0][0]) if self._models else until)

    def _advance(self, until: int) -> None:
        tables = (self._reference, self._external, self._record, self._status)
        self._run(until, tables, 0)

    def _run(self, until: int, tables: Tables, origin: int) -> None:
        """Runs up to a tick.

        Args:
            until: Exclusive.
            tables: Reference, external torque, record and status.
            origin: Tick of their first row.
        """
        plant, data, (reference, external, record, status) = self._plant, self._data, tables
        outcome, tick = _native.run(
            self.core,
            self._drives.view(np.uint8),
            self._events.view(np.uint8),
            engine("mj_step"),
            self._model._address,
            data._address,
            data.qpos,
            data.qvel,
            data.qfrc_applied,
            plant.timestep,
            round(self.scenario.trajectory.period / plant.timestep),
            reference.shape[1],
            reference,
            external,
            record,
            status,
            self.faults,
            self.tick,
            until,
            self.guard,
            self._link,
            None if self._gravity is None else self._gravity.native,
            origin,
        )
        self.tick = until
        if outcome:
            self.diverged = tick
