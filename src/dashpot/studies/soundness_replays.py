"""Replays of the certificate's verdicts in the nonlinear simulator, for `dashpot.studies.soundness`.

Coulomb friction, torque limit and stops act there, which the certificate's linear law leaves out.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dashpot.arm.plant import build
from dashpot.arm.robot import Robot
from dashpot.certify.counterexample import Counterexample, counterexample
from dashpot.certify.loads import GRAVITY, Load
from dashpot.certify.testbench import KNOCK, replay, tap, write
from dashpot.control.controller import TORQUE_LIMITED, Controller, ControllerConfig
from dashpot.simulation.simulate import Scenario, run
from dashpot.simulation.trajectory import hold
from dashpot.studies.soundness import CERTIFIED, REFUTED, Verdict
from dashpot.studies.soundness_cases import Case, case
from dashpot.support.arrays import Floats

PAYLOADS = (0.0, 0.5, 1.0, 2.0, 5.0, 10.0, 15.0, 20.0)  # [kg]
ARM, LINK = 0.3, 0.01  # [m] to the payload; [kg m^2] of the link alone
DURATION = 4.0  # [s]
STOP = 1.0  # [rad], either side
LIGHT, HARD = 5.0, 200.0  # torque that a knock would send through a clamped rotor's transmission [N m]
HARDER = 6  # doublings until the controller's torque is limited
REPLAYS = 10
COUNTED = ("runs", "bounded", "diverged", "torque_limited", "met_a_stop")
PER_CYCLE, TICKS = 1.0, 4.0  # a resolved oscillation: growth per cycle below, ticks per cycle at least
CLOSE = 0.05  # frequency, relative


def hung(payload: float) -> Load:
    """A payload [kg] at the end of the arm, with the link's own inertia."""
    if payload == 0:
        return Load("inertia", LINK)
    return Load("pendulum", payload * ARM**2 + LINK, payload * GRAVITY * ARM)


@dataclass(frozen=True)
class Knocked:
    """What a certified joint did after a knock.

    Attributes:
        payload: [kg].
        torque: Of the knock [N m].
        ratio: Largest of torque and link velocity, each peak to peak: last quarter over first.
        diverged: Whether the simulation blew up.
        limited: Whether the torque limit acted.
        moved: How far the link went [rad].
        stopped: Whether the link met a stop.
    """

    payload: float
    torque: float
    ratio: float
    diverged: bool
    limited: bool
    moved: float
    stopped: bool

    @property
    def bounded(self) -> bool:
        """Whether it calmed down, or at least did not get livelier."""
        return not self.diverged and self.ratio <= 1.0


def knocked(it: Case, payload: float, hard: bool) -> Knocked:
    """Knocks a certified joint with a payload; hard: until its torque is limited."""
    load, period = hung(payload), it.config.period
    with tempfile.TemporaryDirectory() as folder:
        files = write(Path(folder), load, it.drive, it.gains, it.config)
        model = Path(folder) / "bench.xml"
        hinge = 'type="hinge"'
        text = model.read_text(encoding="utf-8")
        assert text.count(hinge) == 1
        model.write_text(
            text.replace(hinge, f'{hinge} limited="true" range="{-STOP} {STOP}"'), encoding="utf-8"
        )
        arm, config = Robot.load(files[0]), ControllerConfig.load(files[1])
        plant, controller = build(arm, period), Controller.from_config(config, arm.drives)
    path = hold([0.0], DURATION, period)
    through = HARD if hard else LIGHT
    # A link of this speed meets the transmission with at most this torque.
    speed = through / math.sqrt(it.drive.stiffness * min(load.inertia, it.drive.rotor_inertia))
    torque = load.inertia * speed / (max(1, round(KNOCK / period)) * period)
    for _ in range(HARDER if hard else 1):
        recording = run(Scenario(plant, controller, path, external=tap(path, 1, torque)))
        limited = bool((recording.status & TORQUE_LIMITED).any())
        if limited:
            break
        torque *= 2
    else:
        torque /= 2
    return Knocked(
        payload,
        torque,
        max(_ratio(recording.torque[:, 0]), _ratio(recording.link_velocity[:, 0])),
        recording.diverged_at is not None,
        limited,
        float(np.nanmax(np.abs(recording.link_position))),
        bool((np.abs(recording.link_position) > STOP).any()),
    )


def _ratio(signal: Floats) -> float:
    quarter = len(signal) // 4
    return float(np.ptp(signal[-quarter:]) / np.ptp(signal[:quarter]))


def certified_replays(it: Case, payloads: Sequence[float] = PAYLOADS) -> dict[str, Any]:
    """All payloads on a certified joint, knocked lightly and hard, for JSON."""
    runs = [knocked(it, payload, hard) for payload in payloads for hard in (False, True)]
    return {
        "number": it.number,
        "runs": len(runs),
        "bounded": sum(r.bounded for r in runs),
        "diverged": sum(r.diverged for r in runs),
        "torque_limited": sum(r.limited for r in runs),
        "met_a_stop": sum(r.stopped for r in runs),
        "moved_least_rad": min(r.moved for r in runs),
        "largest_ratio": max(r.ratio for r in runs),
        "not_bounded": [vars(r) for r in runs if not r.bounded],
    }


def resolved(found: Counterexample, period: float) -> bool:
    """Whether an oscillation is slow enough, and grows slowly enough, to have a frequency at the ticks."""
    return 0 < found.growth < PER_CYCLE * found.frequency and TICKS * found.frequency * period <= 1


def refuted_replay(it: Case) -> dict[str, Any]:
    """Predicted oscillation of a refuted joint against the simulated one, for JSON."""
    found = counterexample(it.joint(), it.drive)
    assert found is not None
    row: dict[str, Any] = {
        "number": it.number,
        "load": str(found.load),
        "ticks_per_cycle": round(1 / (found.frequency * it.config.period), 1),
        "predicted_hz": found.frequency,
        "predicted_growth_per_s": found.growth,
    }
    with tempfile.TemporaryDirectory() as folder:
        seen = replay(*write(Path(folder), found.load, it.drive, it.gains, it.config), found)
    relative = seen.frequency / found.frequency - 1
    return row | {
        "measured_hz": seen.frequency,
        "measured_growth_per_s": seen.growth,
        "relative": relative,
        "confirmed": abs(relative) <= CLOSE and seen.growth > 0,
    }


def chosen(seed: int, verdicts: Sequence[Verdict]) -> tuple[list[int], list[int]]:
    """Numbers of the first certified joints (average sampling) and the first with a resolved oscillation."""
    calm, wild = [], []
    for verdict in verdicts:
        config, found = case(seed, verdict.number).config, verdict.counterexample
        if verdict.kind == CERTIFIED and config.sampling == "average":
            calm.append(verdict.number)
        if verdict.kind == REFUTED and found and resolved(found, config.period):
            wild.append(verdict.number)
    return calm[:REPLAYS], wild[:REPLAYS]


def replayed(seed: int, task: tuple[str, int]) -> dict[str, Any]:
    """Row of the table for one joint: (verdict, number)."""
    it = case(seed, task[1])
    return certified_replays(it) if task[0] == CERTIFIED else refuted_replay(it)


def summary(calm: list[dict[str, Any]], wild: list[dict[str, Any]]) -> dict[str, Any]:
    """Counts and tables, for JSON."""
    return {
        "certified": {
            "joints": len(calm),
            "payloads_kg": list(PAYLOADS),
            **{key: sum(row[key] for row in calm) for key in COUNTED},
            "largest_ratio": max((row["largest_ratio"] for row in calm), default=None),
            "table": calm,
        },
        "refuted": {
            "joints": len(wild),
            "confirmed": sum(row["confirmed"] for row in wild),
            "largest_relative_error": max((abs(row["relative"]) for row in wild), default=None),
            "table": wild,
        },
    }
