"""The MCAP log of a simulated run: all that a robot would have logged, and what only a simulator knows."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from dashpot.arm.robot import Robot
from dashpot.control.controller import MODES, ControllerConfig
from dashpot.control.energy import EnergyMeter
from dashpot.control.sampled import NX
from dashpot.control.supervisor import STATES
from dashpot.logs.atomic import replaced
from dashpot.logs.log import Log
from dashpot.logs.mcapwriter import NANO, McapWriter
from dashpot.logs.messages import START, Level
from dashpot.simulation.recording import Recording
from dashpot.simulation.trace import Trace
from dashpot.simulation.trajectory import Trajectory
from dashpot.support.arrays import Floats

LAST_LAW = STATES.index("torque_brake")  # the last state in which the law computes the torque


def write_run(
    path: Path,
    log: Log,
    recording: Recording,
    trace: Trace,
    robot: Robot,
    config: ControllerConfig,
    trajectory: Trajectory,
) -> None:
    """Writes the log of a run, `dashpot.logs.log.from_recording`, with references, controller and energy.

    Stamps count from the first tick; the metadata say what time the simulator called it. An interrupted
    write leaves no file.
    """
    segment = log.segments[0]
    t = len(segment.time)
    assert segment.position is not None
    assert segment.velocity is not None
    assert segment.link_position is not None
    # A recording has the torque of the coming period, a log that of the period before; a servo's changes
    # within a period, and its command is the mean.
    servo = np.array([name not in (law.name for law in config.joints) for name in log.joints])
    asked = np.where(servo, segment.command, recording.in_effect[:t])
    in_effect = np.vstack([np.full((1, len(log.joints)), np.nan), asked[:-1]])
    states = {f"x{i}": trace.x[:t, :, i] for i in range(NX)}
    acting = (trace.mode[:t] == MODES.index("active")) & (trace.supervisor[:t, None] <= LAST_LAW)
    columns: dict[str, Floats] = {
        "position": segment.position,
        "velocity": segment.velocity,
        "torque": segment.torque,
        "reference": recording.reference[:t],
        "reference_velocity": trajectory.velocity[:t],
        "command": segment.command,
        "in_effect": in_effect,
        "link_position": segment.link_position,
        "link_velocity": recording.link_velocity[:t],
        "link_torque": recording.torque[:t],
        "supervisor": trace.supervisor[:t],
        "mode": trace.mode[:t],
        "status": trace.status[:t],
        **states,
    }
    columns |= EnergyMeter(robot.drives, config).update(
        segment.torque, segment.position, segment.velocity, in_effect, states, acting
    )
    start = float(recording.time[0])
    metadata = {
        key: value if isinstance(value, str) else json.dumps(value)
        for key, value in recording.settings.items()
    }
    metadata |= {"sampling": log.sampling, START: repr(start)}
    with (
        replaced(path) as temporary,
        McapWriter(temporary, log.joints, period=log.period, metadata=metadata) as writer,
    ):
        writer.write(np.rint(segment.time * NANO).astype(np.int64), columns)
        for time, level, text in happenings(recording.settings):
            writer.message(round((time - start) * NANO), level, text)


def happenings(settings: dict[str, Any]) -> list[tuple[float, Level, str]]:
    """What a recording's settings say has happened: (time [s], level, text), in order of time."""
    found: list[tuple[float, Level, str]] = []
    for fault in settings.get("faults", ()):
        joint = "" if fault["joint"] == "all" else f"{fault['joint']}: "
        said = f"simulated fault: {joint}{fault['kind'].replace('_', ' ')}"
        found.append((fault["start"], "info", said))
        if "end" in fault:
            found.append((fault["end"], "info", f"{said} ends"))
    for change in settings.get("payload_changes", ()):
        found.append((change["time"], "info", f"the flange now carries {change['mass']:g} kg"))
    if "release" in settings:
        found.append((settings["release"], "info", "the position loop is taken off: the law alone brakes"))
    for decision in settings.get("supervisor", {}).get("decisions", ()):
        joint = f"{decision['joint']}: " if decision["joint"] else ""
        said = f"{joint}{decision['words']}"
        if decision["unit"]:
            unit = decision["unit"]
            said += f" ({decision['value']:.4g} {unit}, limit {decision['threshold']:.4g})"
        said += f": {decision['before']} -> {decision['after']}".replace("_", " ")
        found.append((decision["time"], "error" if decision["after"] == "safe" else "warning", said))
    return sorted(found, key=lambda one: one[0])
