"""What the commands of `dashpot.cli` do; imported only when one runs."""

from __future__ import annotations

import math
import threading
import warnings
from typing import TYPE_CHECKING

import mujoco
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
from dashpot.robot import MAX_ANGLE, Robot
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
MAX_TICKS = 1_000_000  # of one recording: about 1 GB of memory for seven joints


def reproduce(out: Path, seeds: int, threads: int | None) -> int:
    """``dashpot reproduce``; returns the exit status: 1 if a relation fails."""
    from dashpot.studies.paper import reproduce as run_study

    if threads is not None and threads < 1:
        raise InputError("must be at least 1", quantity="--threads", value=threads)
    _quiet_engine()
    relations, results = run_study(out, seeds, threads)
    console = Console()
    console.print(_relations_table(relations, seeds))
    failed = sum(not relation.holds for relation in relations)
    verdict = "[green]every relation holds[/]" if not failed else f"[bold red]{failed} relations fail[/]"
    console.print(
        f"{verdict} ({results['seconds']:.0f} s); open {escape(str(out / 'report.html'))}", highlight=False
    )
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
    _check(options)
    _quiet_engine()
    robot, config = Robot.load(options.robot), load_controller(options.controller)
    controller = Controller.from_config(config, robot.drives)
    payload = Payload(options.payload, options.offset)
    plant = build(robot, config.period, [payload] if payload.mass > 0 else [])
    path = _path(options, robot, config.period)
    _warn_of_range(plant, path, options)
    _warn_of_saturation(plant, path, payload)
    events = [Event(path.start, joint, "mode", "bypass") for joint in options.bypass]
    if options.release is not None:
        if not path.time[0] <= options.release <= path.time[-1]:  # also catches NaN
            raise InputError(
                f"must be within the motion, {path.time[0]:g} to {path.time[-1]:g} s",
                quantity="--release [s]",
                value=options.release,
            )
        events.append(Event(options.release, "all", "position_loop", False))
    with whole_folder(options.out) as folder:
        recording = _run(Scenario(plant, controller, path, events, seed=options.seed))
        recording.settings |= {
            "controller": str(options.controller),
            "payload_kg": options.payload,
            "offset_m": options.offset,
        }
        recording.save(folder / "recording.npz")
        save(_draw(recording, controller, options), folder / "simulate")
    _print(recording, robot, controller, plant, options)
    return 1 if recording.diverged_at is not None else 0


def _check(options: Simulate) -> None:
    for key, unit, low, high in (
        ("payload", "kg", 0.0, math.inf),
        ("offset", "m", -math.inf, math.inf),
        ("amplitude", "rad", 0.0, MAX_ANGLE),
        ("duration", "s", 0.0, math.inf),
        ("seed", "-", 0.0, math.inf),
    ):
        value = getattr(options, key)
        rule = ""
        if isinstance(value, float) and not math.isfinite(value):
            rule = "must be finite"
        elif value < low or (key == "duration" and value == 0):
            rule = "must be positive" if key == "duration" else "must not be negative"
        elif value > high:
            rule = f"must be at most {high:.4g} {unit}; check the unit"
        if rule:
            raise InputError(rule, quantity=f"--{key} [{unit}]", value=value)


def _quiet_engine() -> None:
    """Keeps MuJoCo from writing MUJOCO_LOG.TXT into the current folder; a divergence is reported anyway."""
    mujoco.set_mju_user_warning(lambda _: None)


def _run(scenario: Scenario) -> Recording:
    """`run` on a thread of its own: Ctrl-C need not wait for the native loop."""
    done: list[Recording] = []
    failed: list[BaseException] = []

    def work() -> None:
        try:
            done.append(run(scenario))
        except BaseException as error:
            failed.append(error)

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    thread.join()
    if failed:
        raise failed[0]
    return done[0]


def _path(options: Simulate, robot: Robot, period: float) -> Trajectory:
    if options.duration > MAX_TICKS * period:
        raise InputError(
            f"must be at most {MAX_TICKS * period:g} s, {MAX_TICKS} ticks of {period:g} s",
            quantity="--duration [s]",
            value=options.duration,
        )
    if options.motion == "hold":
        return hold(robot.home, options.duration, period)
    return multisine(
        robot.home, options.duration, period, options.seed, amplitude=options.amplitude, lead_in=LEAD_IN
    )


def _warn_of_range(plant: Plant, path: Trajectory, options: Simulate) -> None:
    """Warns of joints whose reference leaves the range in the model."""
    for drive, record, q in zip(plant.robot.drives, plant.drives, path.position.T, strict=True):
        lower, upper = float(record["stop_lower"]), float(record["stop_upper"])
        if q.min() < lower or q.max() > upper:
            message = InputError(
                f"runs into a stop: the motion covers {q.min():.3g} to {q.max():.3g} rad, the joint may "
                f"move from {lower:.4g} to {upper:.4g} rad; lower it or change home",
                file=plant.robot.file,
                joint=drive.name,
                quantity="--amplitude [rad]",
                value=options.amplitude,
            )
            warnings.warn(str(message), InputWarning, stacklevel=2)


def _warn_of_saturation(plant: Plant, path: Trajectory, payload: Payload) -> None:
    """Warns of joints whose motor cannot hold the load somewhere along the path."""
    some = path.position[:: max(1, len(path.position) // 50)]
    load = np.abs([plant.load_torque(q) for q in some]).max(0)
    for drive, torque in zip(plant.robot.drives, load, strict=True):
        if torque > drive.torque_limit:
            if payload.mass > 0:
                rule, quantity, value = "saturates the motor: holding it", "payload [kg]", payload.mass
                advice = f", torque_limit is {drive.torque_limit:g} N m; use a lighter payload"
            else:
                rule, quantity, value = (
                    "too low: the arm's own weight",
                    "torque_limit [N m]",
                    drive.torque_limit,
                )
                advice = "; check the masses in the model"
            message = InputError(
                f"{rule} takes up to {torque:.3g} N m{advice} or a pose that carries less",
                file=plant.robot.file,
                joint=drive.name,
                quantity=quantity,
                value=value,
            )
            warnings.warn(str(message), InputWarning, stacklevel=2)


def _print(
    recording: Recording, robot: Robot, controller: Controller, plant: Plant, options: Simulate
) -> None:
    console = Console()
    table = Table(
        title=escape(f"{robot.name} under {options.controller}, payload {options.payload:g} kg"),
        title_justify="left",
    )
    for name in (
        "joint",
        "control",
        "mean error [deg]",
        "deviation [deg]",
        "largest torque [N m]",
        "of limit",
    ):
        text = name in ("joint", "control")
        table.add_column(name, justify="left" if text else "right", no_wrap=text)
    shown = (recording.time >= 0) & np.isfinite(recording.position).all(1)
    if options.release is not None:
        shown &= recording.time < options.release
    error = np.degrees((recording.reference - recording.position)[shown])
    for j, drive in enumerate(robot.drives):
        kind = "servo" if drive.name not in controller.joints else "VPC"
        kind = "bypassed" if drive.name in options.bypass or "all" in options.bypass else kind
        torque = np.nanmax(np.abs(recording.in_effect[:, j]))
        used = torque / drive.torque_limit
        table.add_row(
            escape(drive.name),
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
    console.print(f"seed {options.seed}; open {escape(str(options.out / 'simulate.png'))}", highlight=False)


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
        axis[0].set_title(recording.joints[j], parse_math=False)
        axis[1].set_xlabel("time [s]")
        if options.release is not None:
            for one in axis:
                one.axvline(options.release, color=GREY, lw=0.8)
    axes[0, 0].set_ylabel("position [deg]")
    axes[1, 0].set_ylabel("sensed torque [N m]")
    axes[0, 0].legend(fontsize=8)
    figure.suptitle(
        f"{recording.settings['robot']} under {options.controller}, payload {options.payload:g} kg",
        parse_math=False,
    )
    return figure
