"""The paper's three experiments as guided scenes, told in two sentences each, and live afterwards.

No supervisor is in charge in them: it would stop the arm before what they show.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from dashpot.arm.payload import Payload
from dashpot.arm.robot import Robot
from dashpot.control.controller import load_controller
from dashpot.paper.fig6 import TAP_AT, TAP_TIME, TAP_TORQUE, towards_parallel
from dashpot.paper.setup import AMPLITUDE, BEAM_MASS, OFFSET, PERIOD, POUND, RELEASE, Setup, on_beam
from dashpot.simulation.trajectory import multisine
from dashpot.studio.choices import rival_of
from dashpot.studio.references import Play, Wander
from dashpot.studio.session import Session

SEED = 0
LONG = 60.0  # [s] of motion that is prepared
PULL_FROM, PULL_RATE, PULL_TIME = 7.0, 6.0, 2.5  # [s], [N m/s], [s]: the hand that pulls at the braked beam
RESONANT_SEED = 1


@dataclass(frozen=True)
class GuidedScene:
    """One experiment.

    Attributes:
        title: On its button.
        words: Two sentences.
        begin: Sets it up; the session runs on from there.
        joint: On show.
        duration: After which nothing more happens by itself [s].
    """

    title: str
    words: str
    begin: Callable[[Session], None]
    joint: str
    duration: float


def play(scene: GuidedScene, session: Session) -> None:
    """Begins a scene; the page shows its words."""
    scene.begin(session)
    session.show(scene.joint)
    session.tell(scene.title, "scene")


def _tracking(session: Session) -> None:
    robot = Robot.load("k807")
    home = np.array(robot.home)
    amplitude = np.full(len(home), AMPLITUDE)
    session.load(
        robot, load_controller("k807-wrist"), _weight(10), (_beam(),),
        lambda _: Wander.of(home, amplitude, PERIOD, SEED), SEED, False,
    )  # fmt: skip
    session.set_rival("PD, same kp and kd")
    session.tell(
        "10 lb on the hand, joints 5-7 under virtual passive control, and PD alone beside it", "scene"
    )
    session.at(12.0, lambda: session.set_payload(0.0))


def _braking(session: Session) -> None:
    robot, config = Robot.load("k807"), load_controller("k807-wrist")
    j = robot.index("joint7")
    path = multisine(
        robot.home, LONG, PERIOD, SEED, amplitude=AMPLITUDE, peak_speed_at={j: RELEASE}, lead_in=0.0
    )
    session.load(robot, config, _weight(10), (_beam(),), lambda _: Play(path), SEED, False)
    session.set_rival("law bypassed", rival_of("PD, same kp and kd", config, robot))

    def cut() -> None:
        session.set_position_loop("joint7", False)
        session.tell("position loop of joint 7 removed: it brakes from its torque sensor alone", "scene")

    def pull() -> None:
        steps = int(PULL_TIME / 0.1)
        for k in range(steps):
            session.at(PULL_FROM + 0.1 * k, partial(_hand, session, j, -PULL_RATE * 0.1 * (k + 1)))
        session.tell(
            "a hand lifts the beam: it yields above (1 + R a/D) tau_c and stays where it is left", "scene"
        )

    session.at(RELEASE, cut)
    session.at(PULL_FROM, pull)


def _resonance(session: Session) -> None:
    robot, config = Robot.load("k807"), load_controller("k807-resonant")
    gains = Setup(robot, config, {})
    path = towards_parallel(gains, RESONANT_SEED)
    keep = round(-path.start / path.period)
    path = replace(
        path,
        position=path.position[keep:],
        velocity=path.velocity[keep:],
        acceleration=path.acceleration[keep:],
        start=0.0,
    )
    session.load(robot, config, _weight(5), (_beam(),), lambda _: Play(path), RESONANT_SEED, False)

    def tap() -> None:
        # A half sine, in the ten steps of its duration.
        for k in range(10):
            size = TAP_TORQUE * float(np.sin(np.pi * (k + 0.5) / 10))
            session.at(
                TAP_AT + 0.1 * TAP_TIME * k, partial(_hand, session, robot.index("joint7"), size, 0.01)
            )
        session.tell(
            "the hand is tapped; at 5 lb, axes 5 and 7 nearly parallel, the wrist keeps swinging", "scene"
        )

    def cut() -> None:
        session.set_position_loop("all", False)
        session.tell("position loops removed: the oscillation dies out", "scene")

    session.at(TAP_AT, tap)
    session.at(RELEASE + 1.0, cut)


def _hand(session: Session, joint: int, torque: float, duration: float = 0.1) -> None:
    for arm in [session.arm] if session.rival is None else [session.arm, session.rival]:
        arm.tap(joint, torque, duration)


def _weight(pounds: float) -> Payload:
    return Payload(pounds * POUND, on_beam(OFFSET))


def _beam() -> Payload:
    return Payload(BEAM_MASS, on_beam(OFFSET / 2), length=OFFSET)


SCENES = (
    GuidedScene(
        "1 · Tracking with a load (Fig. 4)",
        "Both arms follow the same motion with 10 lb on the hand and the same kp and kd; the solid one adds "
        "virtual passive control to its wrist, and hardly sags. At 12 s the load is gone, and only the other "
        "one jumps.",
        _tracking,
        "joint6",
        15.0,
    ),
    GuidedScene(
        "2 · Braking without an encoder (Fig. 5)",
        "At 3 s the position loop of joint 7 is removed in mid-swing: the torque sensor alone brings it to "
        "rest, while without virtual passive control (the ghost) it falls to its stop. At 7 s a hand lifts "
        "the beam: it yields above a threshold and stays where it is left.",
        _braking,
        "joint7",
        11.0,
    ),
    GuidedScene(
        "3 · Resonance at one load only (Fig. 6)",
        "These gains are not certified: at 5 lb a tap makes joints 5 and 7 oscillate, at 0 and 10 lb it does "
        "not. At 4 s the position loops are removed and the oscillation dies out.",
        _resonance,
        "joint5",
        6.0,
    ),
)
