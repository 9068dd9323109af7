"""What the commands of `dashpot.cli` do; imported only when one runs."""

from __future__ import annotations

import math
import warnings
from typing import TYPE_CHECKING

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from dashpot.controller import TORQUE_LIMITED, Controller, load_controller
from dashpot.errors import InputError, InputWarning
from dashpot.output import whole_folder
from dashpot.payload import Payload
from dashpot.plant import Plant, build
from dashpot.plots import BLUE, GREY, VERMILLION, Figure, new_figure, save
from dashpot.recording import Recording
from dashpot.robot import Robot
from dashpot.simulate import Event, Scenario, run
from dashpot.trajectory import Trajectory, hold, multisine

if TYPE_CHECKING:
    from pathlib import Path

    from dashpot.cli import Simulate
    from dashpot.studies.relations import Relation

FIGURES = {
    "fig4": "Fig. 4: tracking",
    "fig5": "Fig. 5: energy dissipation",
    "fig6": "Fig. 6: the two instabilities",
}
LEAD_IN = 1.0  # [s] at rest before a motion


def reproduce(out: Path, seeds: int, threads: int | None) -> int:
    """``dashpot reproduce``; returns the exit status: 1 if a relation fails."""
    from dashpot.studies.paper import reproduce as run_study

    if threads is not None and threads < 1:
        raise InputError("must be at least 1", quantity="--threads", value=threads)
    relations, results = run_study(out, seeds, threads)
    console = Console()
    console.print(_relations_table(relations, seeds))
    failed = sum(not relation.holds for relation in relations)
    verdict = "[green]every relation holds[/]" if not failed else f"[bold red]{failed} relations fail[/]"
    console.print(f"{verdict} ({results['seconds']:.0f} s); open {out / 'report.html'}", highlight=False)
    return 1 if failed else 0


def _relations_table(relations: list[Relation], seeds: int) -> Table:
    """One row per relation, over its joints and payloads: the value nearest to failing."""
    table = Table(
        title=f"The paper's relations, {seeds} seeds each",
        title_justify="left",
        box=SIMPLE_HEAD,
        pad_edge=False,
    )
    table.add_column("relation", no_wrap=True)
    table.add_column("required", justify="right", no_wrap=True)
    table.add_column("worst", justify="right", no_wrap=True)
    groups: dict[tuple[str, str], list[Relation]] = {}
    for relation in relations:
        groups.setdefault((relation.figure, relation.text), []).append(relation)
    figure = ""
    for (this, text), group in groups.items():
        if this != figure:
            table.add_row(f"[bold]{FIGURES[this]}[/]")
            figure = this
        least = group[0].sense == "at least"
        worst = (min if least else max)(relation.value for relation in group)
        mark = "[green]✓[/]" if all(relation.holds for relation in group) else "[bold red]✗[/]"
        table.add_row(
            f"{mark} {escape(text)}", f"{'>=' if least else '<='} {group[0].limit:g}", f"{worst:.3g}"
        )
    return table


def simulate(options: Simulate) -> int:
    """``dashpot simulate``; returns the exit status: 1 if the simulation diverged."""
    robot, config = Robot.load(options.robot), load_controller(options.controller)
    controller = Controller.from_config(config, robot.drives)
    payload = _payload(options)
    plant = build(robot, config.period, [payload] if payload.mass > 0 else [])
    path = _path(options, robot, config.period)
    _warn_of_saturation(plant, path, payload)
    events = [Event(path.start, joint, "mode", "bypass") for joint in options.bypass]
    if options.release is not None:
        events.append(Event(options.release, "all", "position_loop", False))
    with whole_folder(options.out) as folder:
        recording = run(Scenario(plant, controller, path, events, seed=options.seed))
        recording.settings |= {
            "controller": str(options.controller),
            "payload_kg": options.payload,
            "offset_m": options.offset,
        }
        recording.save(folder / "recording.npz")
        save(_draw(recording, controller, options), folder / "simulate")
    _print(recording, robot, controller, plant, options)
    return 1 if recording.diverged_at is not None else 0


def _payload(options: Simulate) -> Payload:
    for key in ("payload", "offset", "amplitude", "duration"):
        value = getattr(options, key)
        if not math.isfinite(value) or (key != "offset" and value < 0):
            raise InputError("must be finite and not negative", quantity=f"--{key}", value=value)
    return Payload(options.payload, options.offset)


def _path(options: Simulate, robot: Robot, period: float) -> Trajectory:
    if options.motion == "hold":
        return hold(robot.home, options.duration, period)
    return multisine(
        robot.home, options.duration, period, options.seed, amplitude=options.amplitude, lead_in=LEAD_IN
    )


def _warn_of_saturation(plant: Plant, path: Trajectory, payload: Payload) -> None:
    """Warns of joints whose motor cannot hold the load somewhere along the path."""
    some = path.position[:: max(1, len(path.position) // 50)]
    load = np.abs([plant.load_torque(q) for q in some]).max(0)
    for drive, torque in zip(plant.robot.drives, load, strict=True):
        if torque > drive.torque_limit:
            message = InputError(
                f"saturates the motor: holding it takes up to {torque:.3g} N m, torque_limit is "
                f"{drive.torque_limit:g} N m; use a lighter payload or a pose that carries less",
                file=plant.robot.file,
                joint=drive.name,
                quantity="payload [kg]",
                value=payload.mass,
            )
            warnings.warn(str(message), InputWarning, stacklevel=2)


def _print(
    recording: Recording, robot: Robot, controller: Controller, plant: Plant, options: Simulate
) -> None:
    console = Console()
    table = Table(
        title=f"{robot.name} under {options.controller}, payload {options.payload:g} kg", title_justify="left"
    )
    for name in (
        "joint",
        "control",
        "mean error [deg]",
        "deviation [deg]",
        "largest torque [N m]",
        "of limit",
    ):
        table.add_column(name, justify="left" if name in ("joint", "control") else "right")
    shown = (recording.time >= 0) & np.isfinite(recording.position).all(1)
    if options.release is not None:
        shown &= recording.time < options.release
    error = np.degrees((recording.reference - recording.position)[shown])
    for j, drive in enumerate(robot.drives):
        kind = "robot's servo" if drive.name not in controller.joints else "VPC"
        kind = "bypassed" if drive.name in options.bypass or "all" in options.bypass else kind
        torque = np.nanmax(np.abs(recording.in_effect[:, j]))
        used = torque / drive.torque_limit
        table.add_row(
            drive.name,
            kind,
            f"{error[:, j].mean():.3f}" if len(error) else "-",
            f"{error[:, j].std():.3f}" if len(error) else "-",
            f"{torque:.2f}",
            f"[{'red' if used >= 1 else 'yellow' if used > 0.8 else 'default'}]{100 * used:.0f} %[/]",
        )
    console.print(table)
    console.print(plant.step_said, highlight=False, style="dim")
    if recording.diverged_at is not None:
        console.print(
            f"[bold red]diverged[/] at {recording.diverged_at:.3f} s: the loop is unstable with this payload",
            highlight=False,
        )
    elif (recording.status & TORQUE_LIMITED).any():
        share = 100 * ((recording.status & TORQUE_LIMITED) != 0).mean()
        console.print(f"[yellow]torque limit reached[/] in {share:.1f} % of the ticks", highlight=False)
    console.print(f"seed {options.seed}; open {options.out / 'simulate.png'}", highlight=False)


def _draw(recording: Recording, controller: Controller, options: Simulate) -> Figure:
    """Position against reference and sensed torque, one column per controlled joint."""
    columns = [recording.joints.index(name) for name in controller.joints]
    figure, axes = new_figure(2, len(columns), max(4.0, 2.1 * len(columns)), 4.6, sharex=True)
    for axis, j in zip(axes.T, columns, strict=True):
        axis[0].plot(
            recording.time, np.degrees(recording.reference[:, j]), "--", color=GREY, lw=1.2, label="reference"
        )
        axis[0].plot(recording.time, np.degrees(recording.link_position[:, j]), color=BLUE, label="link")
        axis[1].plot(recording.time, recording.sample[:, j], color=VERMILLION, lw=0.9)
        axis[0].set_title(recording.joints[j])
        axis[1].set_xlabel("time [s]")
        if options.release is not None:
            for one in axis:
                one.axvline(options.release, color=GREY, lw=0.8)
    axes[0, 0].set_ylabel("position [deg]")
    axes[1, 0].set_ylabel("sensed torque [N m]")
    axes[0, 0].legend(fontsize=8)
    figure.suptitle(
        f"{recording.settings['robot']} under {options.controller}, payload {options.payload:g} kg"
    )
    return figure
