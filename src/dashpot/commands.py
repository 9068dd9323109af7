"""What the commands of `dashpot.cli` do; imported only when one runs."""

from __future__ import annotations

import math
import threading
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
from dashpot.plots import BLACK, BLUE, GREY, VERMILLION, Figure, new_figure, save
from dashpot.recording import Recording
from dashpot.robot import MAX_ANGLE, Robot
from dashpot.sampled import Floats
from dashpot.simulate import Event, Scenario, run
from dashpot.trajectory import Trajectory, hold, multisine
from dashpot.vibration import CORNER, WINDOW, vibration

if TYPE_CHECKING:
    from dashpot.cli import Simulate
    from dashpot.studies.relations import Relation

FIGURES = {
    "fig4": "Fig. 4: tracking",
    "fig5": "Fig. 5: energy dissipation",
    "fig6": "Fig. 6: the two instabilities",
}
LEAD_IN = 1.0  # [s] at rest before a motion
OVER_NOISE, OF_LIMIT = 10.0, 0.02  # torque RMS that counts as oscillation: of the sensor noise, of the limit
SLOWED = 0.05  # of its speed at release: a braked joint
AT_REST = 0.1  # [deg/s] too slow to brake
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
    """One row per relation: the value of the joint or payload nearest to failing, the range of them all."""
    table = Table(
        title=f"The paper's relations, {seeds} seeds each",
        title_justify="left",
        box=SIMPLE_HEAD,
        pad_edge=False,
    )
    table.add_column("relation", no_wrap=True)
    for name in ("limit", "value", "over seeds"):
        table.add_column(name, justify="right", no_wrap=True)
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
            f"{mark} {escape(text)}",
            f"{'>=' if least else '<='} {group[0].limit:g}",
            f"{worst:.2g}",
            f"{min(r.lowest for r in group):.2g}..{max(r.highest for r in group):.2g}",
        )
    return table


def simulate(options: Simulate) -> int:
    """``dashpot simulate``; returns the exit status: 1 if the simulation diverged."""
    _check(options)
    _quiet_engine()
    robot, config = Robot.load(options.robot), load_controller(options.controller)
    controller = Controller.from_config(config, robot.drives)
    payload = Payload(options.payload, _offset(options))
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
            "offset_m": payload.position.tolist(),
        }
        recording.save(folder / "recording.npz")
        save(_draw(recording, controller, options), folder / "simulate")
    _print(recording, robot, controller, plant, options)
    return 1 if recording.diverged_at is not None else 0


def _check(options: Simulate) -> None:
    offset = _offset(options)
    if not np.isfinite(offset).all():
        raise InputError("must be finite", quantity="--offset [m]", value=offset)
    for key, unit, low, high in (
        ("payload", "kg", 0.0, math.inf),
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


def _offset(options: Simulate) -> float | tuple[float, float, float]:
    """As `Payload` takes it."""
    match options.offset:
        case (x,):
            return x
        case (x, y, z):
            return x, y, z
    raise InputError("must be one number or three", quantity="--offset [m]", value=options.offset)


def _title(recording: Recording, options: Simulate) -> str:
    """Robot, controller and load."""
    title = f"{recording.settings['robot']} under {Path(options.controller).name}, "
    if options.payload == 0:
        return title + "no payload"
    at = ", ".join(f"{part:g}" for part in options.offset)
    return f"{title}payload {options.payload:g} kg at {f'({at})' if len(options.offset) > 1 else at} m"


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
    table = _table(escape(_title(recording, options)))
    for name in ("joint", "control"):
        table.add_column(name, no_wrap=name != "joint")
    for name in ("error [deg]", "dev.", "torque [N m]", "of limit", "vibration [N m]"):
        table.add_column(escape(name), justify="right", no_wrap=True)
    before = np.isfinite(recording.position).all(1)
    if options.release is not None:
        before &= recording.time < options.release - 1e-9
    shown = before & (recording.time >= 0)
    error = np.degrees((recording.reference - recording.position)[shown])
    torque = np.abs(recording.in_effect[before])
    found = None
    if recording.diverged_at is None:
        found = vibration(recording.sample[before], controller.period)
    oscillating = []
    for j, drive in enumerate(robot.drives):
        kind = "servo" if drive.name not in controller.joints else "VPC"
        kind = "bypassed" if _bypassed(drive.name, options) else kind
        largest, used, shaken = "-", "-", "-"
        if len(torque):
            share = torque[:, j].max() / drive.torque_limit
            largest = f"{torque[:, j].max():.2f}"
            used = (
                f"[{'red' if share >= 1 else 'yellow' if share > 0.8 else 'default'}]{100 * share:.0f} %[/]"
            )
        if found is not None:
            rms, frequency = found[0][j], found[1][j]
            shaken = f"{rms:.2f}"
            if rms > max(OVER_NOISE * drive.torque_noise, OF_LIMIT * drive.torque_limit):
                shaken = f"[yellow]{shaken}[/]"
                oscillating.append(
                    f"{escape(drive.name)} oscillates: {rms:.3g} N m RMS at {frequency:.3g} Hz"
                )
        table.add_row(
            escape(drive.name),
            kind,
            f"{error[:, j].mean():.3f}" if len(error) else "-",
            f"{error[:, j].std():.3f}" if len(error) else "-",
            largest,
            used,
            shaken,
        )
    console.print(table)
    when = "" if options.release is None else f", all before the release at {options.release:g} s"
    console.print(
        f"mean error, its standard deviation, largest torque, RMS of sensed torque above {CORNER:g} Hz in "
        f"the last {WINDOW:g} s{when}",
        highlight=False,
        style="dim",
    )
    if options.release is not None:
        console.print()
        console.print(_release_table(recording, controller, options.release))
    console.print()
    console.print(plant.step_said, highlight=False, style="dim")
    for line in oscillating:
        console.print(f"[yellow]{line}[/]", highlight=False)
    if recording.diverged_at is not None:
        console.print(
            f"[bold red]diverged[/] at {recording.diverged_at:.3f} s: the loop is unstable with this payload",
            highlight=False,
        )
    elif (recording.status & TORQUE_LIMITED).any():
        share = 100 * ((recording.status & TORQUE_LIMITED) != 0).mean()
        console.print(f"[yellow]torque limit reached[/] in {share:.1f} % of the ticks", highlight=False)
    console.print(f"seed {options.seed}; open {escape(str(options.out / 'simulate.png'))}", highlight=False)


def _table(title: str) -> Table:
    return Table(
        title=title,
        title_justify="left",
        box=SIMPLE_HEAD,
        show_edge=False,
        pad_edge=False,
        collapse_padding=True,
    )


def _bypassed(joint: str, options: Simulate) -> bool:
    return joint in options.bypass or "all" in options.bypass


def _release_table(recording: Recording, controller: Controller, release: float) -> Table:
    """How each released joint slowed down, and how far it moved until then and from then to the end."""
    table = _table(f"After the release at {release:g} s")
    table.add_column("joint")
    percent = f"{100 * SLOWED:g} %"
    for name in ("speed [deg/s]", f"below {percent} after [s]", "moved [deg]", "then, to the end [deg]"):
        table.add_column(escape(name), justify="right", no_wrap=True)
    after = (recording.time >= release - 1e-9) & np.isfinite(recording.link_position).all(1)
    time = recording.time[after] - release
    for name in controller.joints:
        j = recording.joints.index(name)
        angle = np.degrees(recording.link_position[after, j])
        speed = np.abs(np.degrees(recording.link_velocity[after, j]))
        if len(time) == 0:
            table.add_row(escape(name), *4 * "-")
            continue
        slow = np.flatnonzero(speed < SLOWED * speed[0])
        if speed[0] < AT_REST:
            took, moved, then = "at rest", "-", f"{angle[-1] - angle[0]:.2f}"
        elif len(slow) == 0:
            took, moved, then = "never", f"{angle[-1] - angle[0]:.2f}", "-"
        else:
            at = slow[0]
            took, moved, then = (
                f"{time[at]:.3f}",
                f"{angle[at] - angle[0]:.2f}",
                f"{angle[-1] - angle[at]:.2f}",
            )
        table.add_row(escape(name), f"{speed[0]:.2f}", took, moved, then)
    return table


def _draw(recording: Recording, controller: Controller, options: Simulate) -> Figure:
    """Position against reference and sensed torque of each controlled joint, up to four side by side."""
    shown = [recording.joints.index(name) for name in controller.joints]
    blocks = math.ceil(len(shown) / 4)
    columns = math.ceil(len(shown) / blocks)
    figure, axes = new_figure(2 * blocks, columns, max(5.0, 2.8 * columns), 0.9 + 4.2 * blocks, sharex=True)
    for i in range(blocks * columns):
        block, column = divmod(i, columns)
        above, below = axes[2 * block : 2 * block + 2, column]
        if i >= len(shown):
            above.remove()
            below.remove()
            continue
        j = shown[i]
        reference, link = (
            np.degrees(array[:, j]) for array in (recording.reference, recording.link_position)
        )
        above.plot(recording.time, reference, "--", color=GREY, lw=1.2, label="reference")
        above.plot(recording.time, link, color=BLUE, label="link")
        below.plot(recording.time, recording.sample[:, j], color=VERMILLION, lw=0.9, label="sensed torque")
        above.set_title(recording.joints[j], parse_math=False)
        for axis, data in ((above, (reference, link)), (below, (recording.sample[:, j],))):
            _show_at_least(axis, 1.0, np.concatenate(data))
            if options.release is not None:
                axis.axvline(options.release, color=BLACK, ls=":", lw=1.0, label="release")
        below.set_xlabel("time [s]")
        below.tick_params(labelbottom=True)
        if column == 0:
            above.set_ylabel("position [deg]")
            below.set_ylabel("sensed torque [N m]")
    lines = {line.get_label(): line for axis in (axes[0, 0], axes[1, 0]) for line in axis.get_lines()}
    legend = figure.legend(
        lines.values(),
        lines.keys(),
        title=_title(recording, options),
        loc="outside upper center",
        ncols=len(lines),
        fontsize=9,
        title_fontsize=11,
    )
    legend.get_title().set_parse_math(False)
    return figure


def _show_at_least(axis: Any, span: float, data: Floats) -> None:
    """Keeps noise from filling the axis, and ticks free of a common offset or factor."""
    axis.ticklabel_format(axis="y", useOffset=False, scilimits=(-9, 9))
    data = data[np.isfinite(data)]
    if len(data) and np.ptp(data) < span:
        middle = (data.min() + data.max()) / 2
        axis.set_ylim(middle - 0.55 * span, middle + 0.55 * span)
