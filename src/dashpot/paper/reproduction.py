"""``dashpot reproduce``: the paper's three experiments, with a report and a verdict on every relation."""

from __future__ import annotations

import json
import math
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import dashpot.paper.fig4 as fig4
import dashpot.paper.fig5 as fig5
import dashpot.paper.fig6 as fig6
from dashpot.errors import InputError
from dashpot.paper.relations import Relation
from dashpot.paper.setup import ASSUMED, PAYLOADS, PERIOD, RELEASE, WRIST, setup
from dashpot.support import report
from dashpot.support.output import whole_folder
from dashpot.support.plots import save
from dashpot.support.waiting import waiting

FEWEST = 2  # seeds; one has no spread
MOST = 1000  # more take hours

LEAD = (
    "Aldridge and Juang, Virtual passive controller for robot systems using joint torque sensors "
    "(NASA TM-110316), on a simulated K-807i class arm: 200 Hz, wrist joints 5 to 7 under virtual passive "
    "control (VPC), 0, 5 and 10 lb at 0.23 m. The absolute values of the paper's plots are not known; "
    "what is checked is the relations they show."
)


def reproduce(
    out: Path, seeds: int = 10, threads: int | None = None
) -> tuple[list[Relation], dict[str, Any]]:
    """Runs the experiments and writes figures, ``report.html`` and ``results.json`` (docs/results.md).

    Args:
        out: Folder, replaced as a whole when everything is done.
        seeds: Number of trajectories and noise streams per condition: seeds 0, 1, ...
        threads: Threads; None: one per core.

    Returns:
        The relations, and what was written to results.json.

    Raises:
        InputError: Too few or too many seeds, or an unusable folder.
    """
    if not FEWEST <= seeds <= MOST:
        raise InputError(f"must be {FEWEST} to {MOST}", quantity="--seeds", value=seeds)
    start = time.perf_counter()
    with whole_folder(out) as folder:
        tracking = fig4.run(seeds, threads)
        braking = fig5.run(seeds, threads)
        unstable = fig6.run(seeds, threads)
        with waiting("drawing"):
            for name, figure in (
                ("fig4", fig4.draw(tracking)),
                ("fig5", fig5.draw(braking)),
                ("fig6", fig6.draw(unstable)),
                ("fig6-window", fig6.draw_window(unstable)),
            ):
                save(figure, folder / name)
        relations = [*fig4.relations(tracking), *fig5.relations(braking), *fig6.relations(unstable)]
        results = {
            "schema": 1,
            "settings": settings(seeds),
            "relations": [relation.to_json() for relation in relations],
            "fig4": fig4.numbers(tracking),
            "fig5": fig5.numbers(braking),
            "fig6": fig6.numbers(unstable),
            "seconds": round(time.perf_counter() - start, 1),
        }
        (folder / "results.json").write_text(json.dumps(_finite(results), indent=1, allow_nan=False) + "\n")
        (folder / "report.html").write_text(_report(folder, relations, results))
    return relations, results


def _finite(value: Any) -> Any:
    """The same with null in place of what JSON cannot hold: a joint that never yielded, or never slowed."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def settings(seeds: int) -> dict[str, Any]:
    """What the experiments rest on: the paper's conditions, our assumptions, the gains."""
    s = setup()
    return {
        "command": f"dashpot reproduce --seeds {seeds}",
        "seeds": list(range(seeds)),
        "robot": s.robot.name,
        "period_s": PERIOD,
        "payloads_lb": list(PAYLOADS),
        "release_s": RELEASE,
        "form": s.config.form,
        "sampling": s.config.sampling,
        "latency_samples": s.config.latency,
        "physics": s.plants[0].step_said,
        "gains": {
            g.name: {k: v for k, v in asdict(g).items() if k != "name" and v is not None}
            for g in s.config.joints
        },
        "assumed": ASSUMED | {"drives": _wrist_drives()},
    }


def _wrist_drives() -> str:
    """The assumed drive of the wrist joints in words, from the robot file."""
    s = setup()
    drive = s.robot.drives[s.robot.index(WRIST[-1])]
    return (
        f"{ASSUMED['drives']}: rotor inertia {drive.rotor_inertia:g} kg m^2, viscous friction "
        f"{drive.viscous_friction:g} N m s/rad, Coulomb friction {drive.coulomb_friction:g} N m, stiffness "
        f"{drive.stiffness:g} N m/rad, damping {drive.damping:g} N m s/rad (k807.toml)"
    )


def _gains_table(results: dict[str, Any]) -> str:
    """Gains of every figure."""
    high = results["fig6"]["a"]["gains"]
    used = {
        "Figs. 4, 5": results["settings"]["gains"],
        "Fig. 6 (a) high": high["high"],
        "Fig. 6 (a) low": high["low"],
        "Fig. 6 (b)": {g["name"]: g for g in results["fig6"]["b"]["gains"]},
    }
    rows = [
        [figure, name, *(f"{values[key]:.3g}" for key in ("R", "D", "K", "kp", "kd"))]
        for figure, joints in used.items()
        for name, values in joints.items()
    ]
    head = ("", "joint", "R [-]", "D [N m s/rad]", "K [N m/rad]", "kp [N m/rad]", "kd [N m s/rad]")
    return report.table(head, rows, numbers=(2, 3, 4, 5, 6))


def _report(folder: Path, relations: list[Relation], results: dict[str, Any]) -> str:
    conditions = results["settings"]
    seeds = len(conditions["seeds"])
    holding = sum(relation.holds for relation in relations)
    sections = [
        (
            "Summary",
            f"<p>{holding} of {len(relations)} relations hold, each over {seeds} seeds.</p>",
        )
    ]
    for key, title, names, text in (
        ("fig4", "Fig. 4: tracking", ["fig4"], "The same PD gains with and without VPC."),
        (
            "fig5",
            "Fig. 5: energy dissipation",
            ["fig5"],
            "The position offset of joint 7 is removed at 3 s. From then on the joint has no position or "
            "velocity feedback. The pull lifts the beam until the joint yields and is then lowered.",
        ),
        (
            "fig6",
            "Fig. 6: the two instabilities",
            ["fig6", "fig6-window"],
            "(a) The explicit form with one joint's gains too high. (b) Gains found on the linearised "
            "sampled arm. The hand is tapped at 1.25 s in every run, because friction keeps a resonance that "
            "starts from noise small; what counts is whether the tap grows or decays.",
        ),
    ):
        rows = [
            [
                relation.subject,
                relation.text,
                f"{relation.value:.3g}",
                f"{relation.sense}\u00a0{relation.limit:g}".replace(" ", "\u00a0"),
                f"{relation.lowest:.3g} ... {relation.highest:.3g}",
                f"{relation.seeds_holding}/{relation.seeds}",
                "mean" if "mean" in relation.judged else "worst seed",
                "holds" if relation.holds else "fails",
            ]
            for relation in relations
            if relation.figure == key
        ]
        head = ("", "relation", "value", "required", "over seeds", "seeds", "judged", "verdict")
        pictures = "".join(report.image(folder / f"{name}.png", title) for name in names)
        sections.append(
            (title, f"<p>{text}</p>{pictures}{report.table(head, rows, numbers=(2, 4, 5), classes=7)}")
        )
    sections.append(
        (
            "Settings",
            _gains_table(results)
            + report.facts(
                {
                    "controller": f"period {PERIOD * 1e3:g} ms, {conditions['form']} form, "
                    f"{conditions['sampling']} sampling, latency {conditions['latency_samples']}; "
                    "Fig. 6 (a): explicit form",
                    "physics": conditions["physics"],
                    "again": conditions["command"],
                }
            ),
        )
    )
    sections.append(("Assumed", report.facts(conditions["assumed"])))
    return report.page("The paper on a simulated arm", LEAD, sections)
