"""Hands on the links: one that pulls, a soft, damped spring to a point in space, and one that knocks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from dashpot.support.arrays import Floats

STIFFNESS, DAMPING = 150.0, 12.0  # [N/m], [N s/m]
STRONGEST = 60.0  # [N]


@dataclass
class Push:
    """Pulls a point of a body towards a target.

    Attributes:
        body: Index of the body in the model.
        local: The point in the body's frame, (3,) [m].
        target: In the world, (3,) [m]; moved while the hand moves.
        force: Last force, (3,) [N].
        given: Whether the force is fixed, whatever the target.
    """

    body: int
    local: Floats
    target: Floats
    force: Floats
    given: bool = False

    @classmethod
    def at(cls, data: Any, body: int, point: Floats) -> Push:
        """Takes hold of a body at a point of the world (3,) [m]."""
        local = data.xmat[body].reshape(3, 3).T @ (np.asarray(point, float) - data.xpos[body])
        return cls(body, local, np.array(point, float), np.zeros(3))

    def same(self, force: Floats) -> Push:
        """The same force (3,) [N] at the same place of another arm of the same model."""
        return Push(self.body, self.local, self.target, np.array(force), given=True)

    def point(self, data: Any) -> Floats:
        """Where it takes hold now, in the world (3,) [m]."""
        return np.asarray(data.xpos[self.body] + data.xmat[self.body].reshape(3, 3) @ self.local)

    def torque(self, model: Any, data: Any) -> Floats:
        """The force's torque on every degree of freedom, (nv,) [N m]; remembers the force."""
        where = self.point(data)
        jacobian = np.zeros((3, model.nv))
        mujoco.mj_jac(model, data, jacobian, None, where, self.body)
        if self.given:
            return np.asarray(jacobian.T @ self.force)
        force = STIFFNESS * (self.target - where) - DAMPING * (jacobian @ data.qvel)
        size = float(np.linalg.norm(force))
        self.force = force * min(1.0, STRONGEST / size) if size > 0 else force
        return np.asarray(jacobian.T @ self.force)


class Taps:
    """Knocks on the links: external torques for some ticks each."""

    def __init__(self) -> None:
        self._given: list[tuple[int, int, int, float]] = []

    def give(self, tick: int, ticks: int, joint: int, torque: float) -> None:
        """A torque [N m] on a link for some ticks from one on."""
        self._given.append((tick, tick + ticks, joint, torque))

    def torque(self, ticks: NDArray[np.int64], n: int) -> Floats | None:
        """On the n links at some ticks, (ticks, n) [N m]; None: no hand is there."""
        self._given = [tap for tap in self._given if tap[1] > ticks[0]]
        if not self._given:
            return None
        external = np.zeros((len(ticks), n))
        for first, last, joint, torque in self._given:
            external[(ticks >= first) & (ticks < last), joint] += torque
        return external
