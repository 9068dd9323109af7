"""Fig. 4: tracking error of the wrist with and without virtual passive control, at three payloads."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dashpot.paper.relations import Relation, judge
from dashpot.paper.setup import AMPLITUDE, PAYLOADS, PERIOD, WRIST, setup
from dashpot.simulation.recording import Recording
from dashpot.simulation.simulate import Event, Scenario, run_many
from dashpot.simulation.trajectory import multisine
from dashpot.support.arrays import Floats
from dashpot.support.plots import BLUE, VERMILLION, Figure, new_figure

DURATION = 8.0  # [s]
CONTROLLERS = ("vpc", "pd")


@dataclass(frozen=True)
class Fig4:
    """Mean and standard deviation of the joint error over each trajectory.

    Attributes:
        mean: (seeds, payloads, controllers, wrist joints) [rad], reference minus position.
        deviation: Same shape [rad].
        seeds: Seeds of trajectories and noise.
    """

    mean: Floats
    deviation: Floats
    seeds: tuple[int, ...]


def run(seeds: int = 10, threads: int | None = None) -> Fig4:
    """Runs every seed, payload and controller; seeds are 0, 1, ..."""
    s = setup()
    controller = s.controller()
    scenarios = []
    for seed in range(seeds):
        trajectory = multisine(s.robot.home, DURATION, PERIOD, seed, amplitude=AMPLITUDE)
        bypassed = [Event(trajectory.start, "all", "mode", "bypass")]
        for lb in PAYLOADS:
            for events in ([], bypassed):
                scenarios.append(Scenario(s.plants[lb], controller, trajectory, events, seed=seed))
    wrist = [s.robot.index(name) for name in WRIST]

    def reduce(_: Scenario, recording: Recording) -> Floats:
        error = (recording.reference - recording.position)[recording.time >= 0][:, wrist]
        return np.array([error.mean(0), error.std(0)])

    results = np.array(run_many(scenarios, threads=threads, progress="Fig. 4: tracking", reduce=reduce))
    shaped = results.reshape(seeds, len(PAYLOADS), len(CONTROLLERS), 2, len(WRIST))
    return Fig4(shaped[..., 0, :], shaped[..., 1, :], tuple(range(seeds)))


def relations(result: Fig4) -> list[Relation]:
    """The three relations of the paper's figure, for each wrist joint."""
    found = []
    light, heavy = 0, len(PAYLOADS) - 1
    vpc, pd = 0, 1
    size = np.abs(result.mean)
    for j, name in enumerate(WRIST):
        ratio = result.deviation[:, heavy, :, j] / result.deviation[:, light, :, j]
        pooled = result.deviation[:, heavy, :, j].mean(0) / result.deviation[:, light, :, j].mean(0)
        text = "error deviation, 10 lb / 0 lb, "
        found += [
            judge("fig4", name, text + "PD alone", ratio[:, pd], "at least", 3, together=pooled[pd]),
            judge("fig4", name, text + "VPC", ratio[:, vpc], "at most", 1.5, together=pooled[vpc]),
            judge(
                "fig4",
                name,
                "|mean error| at 10 lb, VPC / PD alone",
                size[:, heavy, vpc, j] / size[:, heavy, pd, j],
                "at most",
                0.5,
                together=size[:, heavy, vpc, j].mean() / size[:, heavy, pd, j].mean(),
            ),
        ]
    return found


def numbers(result: Fig4) -> dict[str, Any]:
    """joint -> payload -> controller -> statistics over seeds [rad]."""
    table: dict[str, Any] = {}
    for j, name in enumerate(WRIST):
        for p, lb in enumerate(PAYLOADS):
            for c, kind in enumerate(CONTROLLERS):
                mean, deviation = result.mean[:, p, c, j], result.deviation[:, p, c, j]
                table.setdefault(name, {}).setdefault(f"{lb} lb", {})[kind] = {
                    "mean_abs_error_rad": float(np.abs(mean).mean()),
                    "deviation_rad": float(deviation.mean()),
                    "mean_error_per_seed_rad": mean.tolist(),
                    "deviation_per_seed_rad": deviation.tolist(),
                    "mean_error_spread_rad": float(mean.std()),
                    "deviation_spread_rad": float(deviation.std()),
                }
    return {"seeds": list(result.seeds), "joints": table}


def draw(result: Fig4) -> Figure:
    """Mean and standard deviation against payload, o with and x without virtual passive control."""
    figure, axes = new_figure(2, len(WRIST), 9.6, 5.4, sharex=True, sharey="row")
    styles = ((BLUE, "o", "with VPC"), (VERMILLION, "x", "PD alone"))
    shift = (-0.25, 0.25)
    for j, name in enumerate(WRIST):
        for row, values in enumerate((np.abs(result.mean), result.deviation)):
            axis = axes[row, j]
            for c, (color, marker, label) in enumerate(styles):
                degrees = np.degrees(values[:, :, c, j])
                x = np.array(PAYLOADS) + shift[c]
                axis.plot(
                    np.broadcast_to(x, degrees.shape).ravel(),
                    degrees.ravel(),
                    marker,
                    color=color,
                    ms=4,
                    alpha=0.3,
                    mew=1,
                    fillstyle="none",
                )
                axis.plot(
                    x, degrees.mean(0), marker + "-", color=color, ms=8, mew=2, fillstyle="none", label=label
                )
            axis.set_xticks(PAYLOADS)
        axes[0, j].set_title(f"{name} ({('roll', 'pitch', 'toolplate roll')[j]})")
        axes[1, j].set_xlabel("payload [lb]")
    for row, values in enumerate((np.abs(result.mean), result.deviation)):
        top = np.degrees(values.max())
        axes[row, 0].set_ylim(-0.04 * top, 1.05 * top)
    axes[0, 0].set_ylabel("|mean error| [deg]")
    axes[1, 0].set_ylabel("standard deviation [deg]")
    axes[0, 0].legend(loc="upper left")
    figure.suptitle(
        f"Fig. 4  Tracking error of the wrist over {len(result.seeds)} trajectories\n"
        "small: each trajectory, large: their mean; x and o are moved apart for sight"
    )
    return figure
