"""Torque references that a law "pd_gravity" asks for, along references that are not known beforehand."""

from __future__ import annotations

import numpy as np

from dashpot.arm.payload import Payload
from dashpot.arm.plant import Plant, build
from dashpot.arm.robot import Robot
from dashpot.control.controller import ControllerConfig
from dashpot.control.rivals.tracking import PDGravity
from dashpot.support.arrays import Floats


class Feedforward:
    """Adds the weight of the arm and of the load each law assumes to the torque references."""

    def __init__(self, robot: Robot, config: ControllerConfig) -> None:
        laws = [law for law in config.joints if isinstance(law, PDGravity)]
        self._models: list[tuple[Plant, list[int]]] = []
        for payload, offset in {(law.payload, law.offset) for law in laws}:
            load = [Payload(payload, offset)] if payload > 0 else []
            joints = [robot.index(law.name) for law in laws if (law.payload, law.offset) == (payload, offset)]
            self._models.append((build(robot, config.period, load), joints))

    def added(self, rows: Floats) -> Floats:
        """Rows (4, k, n) with it; between the first and the last it is interpolated."""
        for plant, joints in self._models:
            ends = np.stack([plant.load_torque(rows[0, i])[joints] for i in (0, -1)])
            share = np.linspace(0, 1, rows.shape[1])[:, None]
            rows[3][:, joints] += ends[0] + share * (ends[1] - ends[0])
        return rows
