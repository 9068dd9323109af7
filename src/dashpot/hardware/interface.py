"""What a robot must offer to be controlled: five calls and three facts (`Hardware`).

An adapter for a robot of your own implements `Hardware`; examples/own_hardware.py does so in less than sixty
lines, docs/hardware.md says what each call must guarantee. SI units, link side of the gear, everywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from dashpot.support.arrays import Floats

Ages = NDArray[np.int32]


@dataclass
class Sample:
    """What the robot says at one tick, filled in place by `Hardware.read`.

    It is made once; an array that is assigned to an attribute is copied into the one there is.

    Attributes:
        time: When the sample was taken, on the robot's clock [s]. Ticks that are missing in it are cycles
            that were lost; the same time twice is no new sample.
        torque: Sensed joint torque tau_s, (n,) [N m], link side, positive as in ``u = m q'' + v q' + f +
            tau_s``; gravity included. NaN: none.
        position: (n,) [rad]; NaN where there is none.
        velocity: (n,) [rad/s].
        in_effect: Torque the motors were asked for over the last period, gravity included, (n,) [N m]; NaN
            where the robot does not say.
        torque_age: Ticks since the torque was measured, (n,); 0: fresh.
        encoder_age: The same of position and velocity.
    """

    time: float
    torque: Floats
    position: Floats
    velocity: Floats
    in_effect: Floats
    torque_age: Ages
    encoder_age: Ages

    def __setattr__(self, name: str, value: object) -> None:
        # The native loop reads the arrays where they are: one that is assigned is copied into them.
        array = self.__dict__.get(name)
        if isinstance(array, np.ndarray):
            array[:] = value
        else:
            super().__setattr__(name, value)

    @classmethod
    def of(cls, joints: Sequence[str]) -> Sample:
        """An empty sample: numbers are NaN, ages zero."""
        n = len(joints)
        return cls(
            np.nan, *(np.full(n, np.nan) for _ in range(4)), *(np.zeros(n, np.int32) for _ in range(2))
        )


@runtime_checkable
class Hardware(Protocol):
    """A robot that takes joint torques. Its calls come from one thread, in this order::

        read ... read                       before start: it only listens (see `read`)
        start, (read, write), (read, write), ..., [apply_brake, (read, write) ...], stop

    Attributes:
        joints: Names, base to tip: the order of every array. All of them are controlled.
        period: Of the robot's cycle [s].
        paced: True: `read` itself waits for the robot's next cycle. False: the loop's clock paces, and
            `read` takes the newest sample there is.
        reason: Why the robot ended the motion, in words; "" while it has not.

    A robot that adds gravity to the torques it is sent says ``carries_weight = True`` (`carries_weight`).
    """

    joints: tuple[str, ...]
    period: float
    paced: bool
    reason: str

    def start(self) -> None:
        """Takes the robot over, torque zero beyond what the robot holds itself with; opens its brakes.

        Raises:
            DashpotError: It cannot; one line that says why and what to do. Any other exception is reported
                alike.
        """

    def read(self, sample: Sample) -> bool:
        """Fills `sample` in place with what the robot says now.

        Before `start` it must work too, without any motion command: the checks of ``dashpot run --check``
        look at the sensors of an arm at rest that way. It must come back after some periods at the latest,
        whatever the robot does: the loop cannot stop a robot while it waits.

        Returns:
            False: the robot ended the motion or the link is lost, and `reason` says why. The loop then calls
            `apply_brake` and `stop`, nothing else.
        """

    def write(self, torque: Floats) -> None:
        """Sends the torques for the coming period, (n,) [N m]: motor torque u, gravity included.

        They are finite and within the torque and rate limits of the controller. The array is used again:
        what is kept of it must be copied.
        """

    def apply_brake(self) -> None:
        """Closes the mechanical brakes, or stops with what the robot has in their place.

        Called once; the loop goes on with `read` and `write` until its torques are zero, 0.1 s by default.
        """

    def stop(self) -> None:
        """Ends the motion: motors off. May be called at any time, more than once, and never raises."""


def carries_weight(hardware: Hardware) -> bool:
    """Whether a robot adds gravity to the torques it is sent, as its attribute ``carries_weight`` says.

    Samples, torques in effect and commands then come without what the robot adds: the drive's balance
    ``u = m q'' + v q' + f + tau_s`` holds for the torque that is commanded.
    """
    return bool(getattr(hardware, "carries_weight", False))
