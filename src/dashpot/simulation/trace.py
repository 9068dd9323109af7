"""What the controller does inside a simulated run, tick by tick."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dashpot.control.sampled import NX
from dashpot.simulation.loop import PIECE, Loop
from dashpot.simulation.recording import Recording
from dashpot.simulation.simulate import Scenario
from dashpot.support.arrays import Floats


@dataclass(frozen=True)
class Trace:
    """After each tick; joint order is the robot's. Joints without a controller are off, with states 0.

    Attributes:
        supervisor: (ticks,) index into `dashpot.control.supervisor.STATES`; 0 without a supervisor.
        mode: (ticks, n) index into `dashpot.control.controller.MODES`.
        status: (ticks, n) status bits of `dashpot.control.controller`.
        x: (ticks, n, NX) block states.
    """

    supervisor: Floats
    mode: Floats
    status: Floats
    x: Floats


def run_traced(
    scenario: Scenario, advance: Callable[[float], None] = lambda time: None
) -> tuple[Recording, Trace]:
    """`dashpot.simulation.simulate.run`, stopped after each tick to look at the controller: the same bits,
    no faster.

    Args:
        scenario: What to run.
        advance: Told now and then how far it has come [s].

    Raises:
        InputError: As `dashpot.simulation.simulate.run`.
    """
    loop = Loop(scenario)
    joints, ticks = scenario.plant.robot.joints, loop.ticks
    controlled = scenario.controller.joints if scenario.controller else ()
    places = [(i, joints.index(name)) for i, name in enumerate(controlled)]
    shape = (ticks, len(joints))
    trace = Trace(np.zeros(ticks), np.zeros(shape), np.zeros(shape), np.zeros((*shape, NX)))
    for tick in range(ticks):
        loop.advance(tick + 1)
        if tick % PIECE == 0:
            advance(tick * scenario.trajectory.period)
        if loop.guard is not None:
            trace.supervisor[tick] = loop.guard.state
        for i, j in places:
            assert loop.core is not None
            mode, _, _, _, status, x = loop.core.joint_state(i)
            trace.mode[tick, j], trace.status[tick, j] = mode, status
            trace.x[tick, j, : len(x)] = x
        if loop.diverged is not None:
            break
    return loop.recording(), trace
