"""Scenarios of a campaign side by side on the vectorised engine, those that it cannot simulate on MuJoCo."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dashpot.campaign.scenario import DIVERGED, FAILED, OK, Campaign, Setting
from dashpot.errors import DashpotError
from dashpot.lanes.run import LaneRun, launch, unfit
from dashpot.simulation.recording import CHANNELS, Recording
from dashpot.simulation.simulate import Scenario, run

TOGETHER = 128  # scenarios, unless their recordings are long: those of another time step find company, too
MEMORY = 200e6  # [B] of the recordings that are held at a time
MUJOCO, LANES = 1, 2
WRONG = (DashpotError, ArithmeticError, np.linalg.LinAlgError)


@dataclass
class Outcome:
    """What became of a scenario.

    Attributes:
        status: `OK`, `DIVERGED` or `FAILED`.
        reason: Why it is not `OK`.
        measures: `dashpot.campaign.measures`; none where it could not be run.
        engine: `MUJOCO`, `LANES`, or 0.
    """

    status: int = FAILED
    reason: str = ""
    measures: dict[str, Any] = field(default_factory=dict)
    engine: int = 0


def on_lanes(engine: str, scenario: Scenario) -> bool:
    """Whether a scenario runs on the vectorised engine, where a campaign says "auto", "lanes" or "mujoco"."""
    return engine == "lanes" or (engine == "auto" and not unfit(scenario))


def run_one(campaign: Campaign, scenario: Scenario) -> Recording:
    """Runs a scenario as the campaign does, with the same bits."""
    if not on_lanes(campaign.spec.engine, scenario):
        return run(scenario)
    prepared = LaneRun(scenario)
    launch([prepared])
    return prepared.finish()


def run_together(campaign: Campaign, indices: Sequence[int]) -> Iterator[Outcome]:
    """Runs scenarios by index and gives their outcomes in this order, some of them at a time."""
    waiting: list[_Case] = []
    for index in indices:
        waiting.append(_Case(campaign, index))
        if len(waiting) >= min(case.together for case in waiting):
            yield from _finish(waiting)
            waiting = []
    yield from _finish(waiting)


class _Case:
    """One index on its way."""

    def __init__(self, campaign: Campaign, index: int) -> None:
        self.campaign, self.outcome = campaign, Outcome()
        self.prepared: LaneRun | None = None
        self.together = TOGETHER
        try:
            self.setting: Setting = campaign.setting(index)
            self.scenario: Scenario = campaign.assemble(self.setting)
            size = self.scenario.trajectory.position.size * 8 * (len(CHANNELS) + 4)
            self.together = max(1, min(TOGETHER, int(MEMORY / size)))
            if on_lanes(campaign.spec.engine, self.scenario):
                self.prepared = LaneRun(self.scenario, campaign.remembered)
                self.outcome.engine = LANES
            else:
                self.outcome.engine = MUJOCO
        except WRONG as error:
            self.outcome.reason = _said(error)

    def finish(self) -> Outcome:
        """Runs what has not been run, and measures."""
        found = self.outcome
        if found.reason:
            return found
        try:
            recording = run(self.scenario) if self.prepared is None else self.prepared.finish()
            found.measures = self.campaign.measure(self.setting, self.scenario, recording)
        except WRONG as error:
            found.reason = _said(error)
            return found
        found.status = OK
        if recording.diverged_at is not None:
            found.status, found.reason = DIVERGED, f"diverged at {recording.diverged_at:.4g} s"
        return found


def _finish(cases: list[_Case]) -> Iterator[Outcome]:
    launch([case.prepared for case in cases if case.prepared is not None])
    for case in cases:
        yield case.finish()


def _said(error: BaseException) -> str:
    return str(error) or type(error).__name__
