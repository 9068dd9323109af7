"""What the studio says of an arm: its state at one time, and what happened."""

from __future__ import annotations

from dataclasses import dataclass

from dashpot.studio.energy import Energy
from dashpot.support.arrays import Floats


@dataclass(frozen=True)
class News:
    """Something that happened.

    Attributes:
        time: On the session's clock [s].
        text: In one line.
        kind: "you": somebody did it here; "supervisor": it decided; "scene": told by one; "trouble".
    """

    time: float
    text: str
    kind: str = "you"


@dataclass(frozen=True)
class Snapshot:
    """The arm at one time; arrays (n,), base to tip.

    Attributes:
        time: On the session's clock [s].
        factor: Simulated time over time that has passed, over the last seconds [-].
        running: Whether it runs.
        state: The supervisor's.
        brake_closed: Whether the mechanical brakes are closed by the supervisor.
        position: Link angles [rad].
        velocity: Of the links [rad/s].
        reference: [rad].
        torque: Sensed [N m].
        command: [N m].
        energy: Of the arm.
        payload: On the flange [kg].
        faults: Names of what fails.
        push: Force of the hand [N], (3,), and where it acts [m], (3,); None: there is none.
        limited: Whether a torque limit was reached within the last half second.
        diverged: Whether the simulation blew up.
    """

    time: float
    factor: float
    running: bool
    state: str
    brake_closed: bool
    position: Floats
    velocity: Floats
    reference: Floats
    torque: Floats
    command: Floats
    energy: Energy
    payload: float
    faults: tuple[str, ...]
    push: tuple[Floats, Floats] | None
    limited: bool
    diverged: bool


__all__ = ["News", "Snapshot"]
