"""Where the energy is: in the arm, in the virtual masses, and how much has been taken out.

The balance is exact but for the engine's step: what the arm's energy has lost, and what was put in by hand,
has been taken out by friction and by the motors, less what the virtual masses and springs still hold.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dashpot.control.controller import JointGains
from dashpot.control.sampled import VirtualPassive
from dashpot.studio.live import LiveArm
from dashpot.support.arrays import Floats


@dataclass(frozen=True)
class Energy:
    """At one time, all [J].

    Attributes:
        kinetic: Of links and rotors.
        potential: Of gravity and springs, from where the account began.
        virtual: Stored by the virtual rotors and springs of Eqs. (20)-(21).
        taken: Taken out since the account began by friction and by the motors, less what `virtual` has
            gained.
    """

    kinetic: float
    potential: float
    virtual: float
    taken: float

    def row(self) -> tuple[float, float, float, float]:
        """In that order."""
        return self.kinetic, self.potential, self.virtual, self.taken


class Account:
    """Keeps the balance of one arm."""

    def __init__(self, arm: LiveArm) -> None:
        self._given = 0.0
        kinetic, self._zero = arm.energy()
        self._start = kinetic + self._zero
        self._virtual = stored(arm)

    def restate(self, before: tuple[float, float], after: tuple[float, float]) -> None:
        """Another load was hung on: energies jumped, and nothing was taken out by that."""
        self._zero += after[1] - before[1]
        self._start += sum(after) - sum(before)

    def after(self, arm: LiveArm) -> Energy:
        """The balance after a window."""
        self._given += arm.window.work
        kinetic, potential = arm.energy()
        virtual = stored(arm)
        lost = self._start - (kinetic + potential) + self._given
        return Energy(kinetic, potential - self._zero, virtual, lost - (virtual - self._virtual))


def stored(arm: LiveArm) -> float:
    """S = 1/2 R m (q' + xc')^2 + 1/2 K xc^2 of all active joints under the virtual passive law [J]."""
    total, window = 0.0, arm.window
    speed, torque = window.last("velocity"), window.last("in_effect")
    sample = window.last("sample")
    error = window.reference[-1] - window.last("position")
    for i, law in enumerate(arm.config.joints):
        j = arm.robot.index(law.name)
        if not isinstance(law, JointGains) or arm.mode(law.name)[0] != "active" or arm.state == "safe":
            continue
        model = VirtualPassive(law.R, law.D, law.K, *law.model(arm.robot.drives[j]))
        offset = law.kp * error[j] - law.kd * speed[j] if arm.mode(law.name)[1] else 0.0
        state = arm.law_state(i)
        xc, rate = virtual_state(
            model, arm.config.form, arm.config.period, state, sample[j] + offset, torque[j]
        )
        value = 0.5 * model.R * model.m * (speed[j] + rate) ** 2 + 0.5 * model.K * xc**2
        total += float(np.nan_to_num(value))
    return total


def virtual_state(
    law: VirtualPassive, form: str, period: float, state: Floats, sample: float, torque: float
) -> tuple[float, float]:
    """xc [rad] and xc' [rad/s] of a block's state; the implicit form keeps half a step of the input apart."""
    A, B, _ = law.continuous()
    n = len(B)
    x = np.array(state[:n])
    if form == "implicit":
        x += np.linalg.solve(np.eye(n) - period / 2 * A, B) * (period / 2) * (sample - torque)
    return (0.0, float(x[0])) if n == 1 else (float(x[0]), float(x[1]))
