"""What is done to a controller when the encoders are lost, and before: one list of events for every law."""

from __future__ import annotations

from collections.abc import Collection

from dashpot.control.controller import ControllerConfig
from dashpot.control.jointlaw import Law
from dashpot.simulation.simulate import Event


def tracking_events(config: ControllerConfig, start: float, skip: Collection[str] = ()) -> list[Event]:
    """Puts every brake that has a position loop under that loop; without one it brakes from the start.

    Args:
        config: The controller.
        start: Time of the first tick [s].
        skip: Joints left as they are.
    """
    return [
        Event(start, law.name, "mode", "bypass")
        for law in config.joints
        if law.name not in skip and _tracks_first(law)
    ]


def release_events(config: ControllerConfig, time: float, skip: Collection[str] = ()) -> list[Event]:
    """Takes the encoder away: brakes engage, warm started where their law has a velocity; loops are cut.

    A law that keeps its encoder (an upper bound) keeps it.

    Args:
        config: The controller.
        time: [s].
        skip: Joints whose brake does not engage; their position loop is cut all the same.
    """
    events = []
    for law in config.joints:
        if law.name not in skip and _tracks_first(law):
            events.append(Event(time, law.name, "mode", "active"))
            if law.warm:
                events.append(Event(time, law.name, "warm_start"))
        if not law.keeps_encoder:
            events.append(Event(time, law.name, "position_loop", False))
    return events


def _tracks_first(law: Law) -> bool:
    return law.brake and any(getattr(law, key, 0.0) for key in ("kp", "kd"))
