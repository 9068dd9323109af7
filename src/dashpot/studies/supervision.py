"""The supervisor over recorded motions, and its states as a picture.

``python -m dashpot.studies.supervision [PNG]`` draws the picture from the native decision itself.
"""

from __future__ import annotations

import itertools
import sys
from pathlib import Path

import numpy as np

from dashpot.arm.robot import Robot
from dashpot.control.controller import Controller, ControllerConfig
from dashpot.control.supervisor import EVENTS, STATES, Supervisor, SupervisorSettings, next_state
from dashpot.simulation.recording import Recording
from dashpot.simulation.trajectory import Trajectory


def replay(
    recording: Recording,
    config: ControllerConfig | None,
    robot: Robot,
    reference: Trajectory,
    settings: SupervisorSettings | None = None,
    controller: Controller | None = None,
) -> tuple[Supervisor, float]:
    """Shows a recorded run to a supervisor up to its first decision, before which it changes nothing.

    Args:
        recording: Of the controller alone, without events.
        config: The controller's file; None where `controller` is given.
        robot: The arm.
        reference: The run's.
        settings: Of the supervisor.
        controller: In place of config.

    Returns:
        The supervisor as it then is, and the largest part of its limit that the rotor balance reached [-].
    """
    if controller is None:
        assert config is not None
        controller = Controller.from_config(config, robot.drives)
    supervisor = Supervisor(controller, robot.drives, settings)
    index = [robot.index(name) for name in controller.joints]
    inputs, out, worst = controller.inputs, np.zeros(len(index)), 0.0
    for k in range(len(recording.time)):
        inputs.torque[:] = recording.sample[k, index]
        inputs.position[:] = recording.position[k, index]
        inputs.velocity[:] = recording.velocity[k, index]
        inputs.position_ref[:] = reference.position[k, index]
        inputs.velocity_ref[:] = reference.velocity[k, index]
        inputs.acceleration_ref[:] = reference.acceleration[k, index]
        if k:  # the torque that was in effect
            for i, j in enumerate(index):
                x = np.array(controller.core.joint_state(i)[5])
                controller.core.preset(i, x, recording.in_effect[k - 1, j])
        supervisor.step(out)
        if supervisor.state != "track":
            break
        for name in controller.joints:
            seen = supervisor.joint(name)
            worst = max(worst, abs(seen["residual"]) / seen["limit"])
    return supervisor, worst


def transitions() -> dict[tuple[str, str], list[tuple[str, ...]]]:
    """The smallest sets of events that lead from one state to another, read off the native decision."""
    found: dict[tuple[str, str], list[tuple[str, ...]]] = {}
    for state in STATES:
        for size in range(1, len(EVENTS) + 1):
            for events in itertools.combinations(EVENTS, size):
                after = next_state(state, *events)
                known = found.setdefault((state, after), [])
                if after != state and not any(set(less) <= set(events) for less in known):
                    known.append(events)
    return {pair: events for pair, events in found.items() if events}


_PLACE = {"track": (0.0, 1.5), "torque_brake": (5.0, 3.0), "encoder_brake": (5.0, 0.0), "safe": (10.0, 1.5)}
_DOES = {
    "track": ("TRACK", "position loop and law"),
    "torque_brake": ("TORQUE BRAKE", "law alone, warm-started;\nno encoder is read"),
    "encoder_brake": ("ENCODER BRAKE", "damping, then hold;\nno torque sensor is read"),
    "safe": ("SAFE", "torque faded to zero,\nmechanical brake closed"),
}
_WIDE, _HIGH = 2.7, 1.1
_ARROW = {  # ends as (right, up) in half boxes from the centres; centre of the words
    ("track", "torque_brake"): ((0.6, 1), (-1, 0), (1.6, 2.85)),
    ("track", "encoder_brake"): ((0.6, -1), (-1, 0), (1.6, 0.15)),
    ("track", "safe"): ((1, 0), (-1, 0), (3.1, 1.5)),
    ("torque_brake", "encoder_brake"): ((0, -1), (0, 1), (5.95, 1.0)),
    ("torque_brake", "safe"): ((1, 0), (-0.6, 1), (8.65, 3.1)),
    ("encoder_brake", "safe"): ((1, 0), (-0.6, -1), (8.65, -0.1)),
}


def draw(path: Path) -> None:
    """Draws states and transitions as a PNG."""
    from matplotlib.patches import FancyBboxPatch

    from dashpot.support.plots import BLUE, GREEN, GREY, VERMILLION, new_figure, save

    colour = {"track": GREEN, "torque_brake": BLUE, "encoder_brake": BLUE, "safe": VERMILLION}
    figure, axes = new_figure(1, 1, 9.0, 4.0)
    axis = axes[0, 0]
    axis.axis("off")
    axis.set(xlim=(-1.5, 11.5), ylim=(-0.75, 3.75))
    figure.suptitle("States of the supervisor: each worse than the one before, back only by a reset at rest")
    for (before, after), events in transitions().items():
        start, end, where = _ARROW[before, after]
        tail, head = (
            (_PLACE[s][0] + x * _WIDE / 2, _PLACE[s][1] + y * _HIGH / 2)
            for s, (x, y) in ((before, start), (after, end))
        )
        arrow = {"arrowstyle": "-|>", "color": GREY, "shrinkA": 1, "shrinkB": 1}
        axis.annotate("", head, tail, arrowprops=arrow)
        words = "\nor ".join(" and ".join(together) for together in events)
        paper = {"fc": "white", "ec": "none", "pad": 2.0}
        axis.text(*where, words, ha="center", va="center", fontsize=7.5, bbox=paper)
    for state, (x, y) in _PLACE.items():
        corner = (x - _WIDE / 2, y - _HIGH / 2)
        axis.add_patch(
            FancyBboxPatch(
                corner,
                _WIDE,
                _HIGH,
                boxstyle="round,pad=0,rounding_size=0.12",
                fc="white",
                ec=colour[state],
                lw=2,
                zorder=3,
            )
        )
        name, does = _DOES[state]
        axis.text(x, y + 0.3, name, ha="center", va="center", weight="bold", color=colour[state], zorder=4)
        axis.text(x, y - 0.15, does, ha="center", va="center", fontsize=7.5, zorder=4)
    save(figure, path, pdf=False)


if __name__ == "__main__":
    draw(Path(sys.argv[1] if len(sys.argv) > 1 else "docs/images/supervisor.png"))
