"""The process of a simulated arm (`dashpot.hardware.sim`): ``python -m dashpot.hardware.arm SOCKET``.

It gets its scenario from standard input and outlives whoever controls it: that is what its watchdog is for.
"""

from __future__ import annotations

import gc
import os
import pickle
import signal
import sys
from contextlib import suppress
from dataclasses import replace

import dashpot._native as _native
from dashpot.hardware.sim import LinkSettings
from dashpot.simulation.loop import Loop
from dashpot.simulation.simulate import Scenario
from dashpot.simulation.trajectory import hold

CALM = 7.0  # [s] for the brakes to close and the links to stop ringing, before anybody listens
LISTEN = 10.0  # [s] at rest, after that, that are simulated at a time until somebody takes the arm over


def _link(file: int, settings: LinkSettings, period: float, listening: bool) -> _native.Link:
    after = max(1, round(settings.after / period))
    quiet = round(CALM / period) if listening else 0
    means = settings.answer, settings.watchdog, after, quiet
    return _native.Link(file, settings.realtime, listening, period, *means)


def _at_rest(scenario: Scenario) -> Scenario:
    """The arm in the equilibrium it starts from, with its brakes closed and nothing happening to it."""
    period, path = scenario.trajectory.period, scenario.trajectory
    ticks = hold(path.position[0], CALM + LISTEN, period)
    if path.torque is not None:
        ticks = replace(ticks, torque=path.torque[:1].repeat(len(ticks.position), 0))
    first = [replace(event, time=0.0) for event in scenario.events if event.time == path.start]
    return replace(scenario, trajectory=ticks, events=first, external=None, faults=(), payload_changes=())


def run(file: int, scenario: Scenario, settings: LinkSettings) -> None:
    """Listens until the arm is taken over, then runs the motion to its end, and writes what happened."""
    period = scenario.trajectory.period
    link = _link(file, settings, period, False)
    motion = Loop(scenario, link)
    while True:
        waiting = _link(file, settings, period, True)
        Loop(_at_rest(scenario), waiting).advance()
        if waiting.started or waiting.stopped or waiting.gone:
            break
    if not waiting.started:
        return
    motion.advance()
    if settings.record is not None:
        recording = motion.recording()
        recording.settings["watchdog_at"] = link.tripped_at
        recording.settings["stopped"] = link.stopped
        try:
            recording.save(settings.record)
        except OSError as error:
            raise SystemExit(f"dashpot: {settings.record}: cannot be written: {error.strerror}") from None


def main() -> None:
    """Entry point."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        scenario, settings = pickle.load(sys.stdin.buffer)
    except (EOFError, pickle.UnpicklingError):  # whoever wanted an arm is gone
        return
    gc.disable()
    with suppress(OSError):  # a robot's own computer is punctual; here it is if permitted
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(85))
    run(int(sys.argv[1]), scenario, settings)


if __name__ == "__main__":
    main()
