"""The robot's own gravity compensation in a scenario."""

from __future__ import annotations

from typing import TYPE_CHECKING

import mujoco
import numpy as np

import dashpot._native as _native
from dashpot.arm.plant import Plant, with_payload
from dashpot.errors import InputError
from dashpot.simulation.engine import engine
from dashpot.support.arrays import Floats

if TYPE_CHECKING:
    from dashpot.simulation.simulate import Scenario


class Gravity:
    """A robot's own gravity compensation: what its bare links weigh at the encoders' angles.

    Attributes:
        native: As the native loop wants it.
    """

    def __init__(self, bare: Plant) -> None:
        if bare.model.body_gravcomp.any():
            raise InputError(
                "is in the model already, as gravcomp of bodies; take it out of one of them",
                file=bare.robot.file,
                quantity="gravity_compensation",
            )
        self._model, self._data = bare.model, mujoco.MjData(bare.model)
        mujoco.mj_forward(self._model, self._data)  # at rest; only angles change from here on
        self.native = _native.Gravity(
            engine("mj_kinematics"),
            engine("mj_comPos"),
            engine("mj_rne"),
            self._model._address,
            self._data._address,
            self._data.qpos,
            bare.rotor_qpos,
            bare.rotor_dof,
            self._model.nv,
        )

    def torque(self, position: Floats) -> Floats:
        """That holds the bare arm at rest at rotor angles (n,) [rad]: (n,) [N m]."""
        out = np.empty(len(position))
        self.native.torque(np.ascontiguousarray(position, float), out)
        return out


def compensation(scenario: Scenario, plant: Plant) -> Gravity | None:
    """The robot's own gravity compensation, where the scenario has it switched on."""
    return Gravity(with_payload(plant, None, scenario.trajectory.period)) if scenario.carried else None
