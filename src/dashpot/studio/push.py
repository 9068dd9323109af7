"""A hand that pulls at a link: a soft, damped spring from a point of the arm to a point in space."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

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
