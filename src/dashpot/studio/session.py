"""The studio without its page: an arm that runs in real time, what it is told, and what it shows.

All calls may come from any thread, also while the arm runs; between two windows of about 10 ms each takes
effect at once. `step` runs a window by hand, for tests and for recordings that must be repeatable.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np

from dashpot.control.controller import TORQUE_LIMITED
from dashpot.studio.ring import Past
from dashpot.studio.snapshot import News, Snapshot
from dashpot.studio.told import Told
from dashpot.support.arrays import Floats

LIMITED_FOR = 0.5  # [s] for which a torque limit that was reached is told


class Session(Told):
    """One arm in the studio, and a rival beside it if one is chosen.

    Attributes:
        robot: The arm.
        config: The controller as it is edited.
        arm: What runs.
        rival: The same arm under another controller, or None.
        rival_name: Its name, "" where there is none.
        certifier: Keeps margins and maps.
        ring, rival_ring: The last minute.
        energies: Time and energies of every window, oldest first.
        news: What happened, oldest first.
        carried: Whether robots that can carry their own weight do.
        joint: Name of the joint on show.
        generation: Counts how often the arm was exchanged: what is drawn of it must be drawn anew.
    """

    def snapshot(self) -> Snapshot:
        """The arm now."""
        with self._lock:
            arm, window = self.arm, self.arm.window
            push = None if arm.push is None else (arm.push.force.copy(), arm.push.point(arm.data))
            return Snapshot(
                self.time,
                self.factor,
                self._running,
                arm.state,
                arm.brake_closed,
                window.last("link_position"),
                window.last("link_velocity"),
                np.array(window.reference[-1]),
                window.last("sample"),
                window.last("command"),
                self.energy,
                self.payload.mass,
                tuple(self.faults),
                push,
                bool((self.ring.past(LIMITED_FOR).status & TORQUE_LIMITED).any()),
                arm.diverged is not None,
            )

    def bodies(self) -> list[tuple[Floats, Floats]]:
        """Positions (nbody, 3) [m] and quaternions wxyz (nbody, 4) of the arm, and of the rival."""
        with self._lock:
            return [(np.array(arm.data.xpos), np.array(arm.data.xquat)) for arm in self._arms()]

    def inertia(self, joint: str) -> float:
        """Of all that a joint moves, about its axis, in the present pose with the present load [kg m^2]."""
        with self._lock:
            model, data = self.arm.model, self.arm.data
            mass = np.zeros((model.nv, model.nv))
            mujoco.mj_fullM(model, data, mass)
            dof = int(self.arm.plant.spring_dof[self.robot.index(joint)])
            return float(mass[dof, dof])

    def latest(self, since: float = -math.inf) -> list[News]:
        """What happened since a time on the session's clock [s], oldest first."""
        with self._lock:
            return [news for news in self.news if news.time >= since]

    def energy_since(self, when: float) -> Floats:
        """Time and energies of every window since a time [s], (k, 5)."""
        with self._lock:
            rows = [row for row in self.energies if row[0] >= when]
        return np.array(rows).reshape(-1, 5)

    def past(self, seconds: float | None = None, rival: bool = False) -> Past:
        """The last seconds [s] of the arm or of its rival, at every tick."""
        with self._lock:
            return (self.rival_ring if rival else self.ring).past(seconds)

    def tell(self, text: str, kind: str = "you") -> None:
        """Adds to the news."""
        with self._lock:
            self._tell(text, kind)

    def show(self, joint: str) -> None:
        """Chooses the joint on show.

        Raises:
            InputError: It is not controlled.
        """
        with self._lock:
            self.arm.controller.index(joint)
            self.joint = joint
            self._judge()


__all__ = ["News", "Session", "Snapshot"]
