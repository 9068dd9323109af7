"""Tables and picture of ``dashpot simulate``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from dashpot.arm.plant import Plant
from dashpot.arm.robot import Robot
from dashpot.commands.shared import bare_table, verdict
from dashpot.commands.simulate_faults import Mark, draw_marks, legend_entries, listed
from dashpot.control.controller import TORQUE_LIMITED, Controller
from dashpot.simulation.recording import Recording
from dashpot.simulation.vibration import CORNER, WINDOW, vibration
from dashpot.support.arrays import Floats
from dashpot.support.plots import BLACK, BLUE, GREY, VERMILLION, Figure, new_figure, top_legend

if TYPE_CHECKING:
    from dashpot.cli.simulate import Simulate


OVER_NOISE, OF_LIMIT = 10.0, 0.02  # torque RMS that counts as oscillation: of the sensor noise, of the limit
SLOWED = 0.05  # of its speed at release: a braked joint
AT_REST = 0.1  # [deg/s] too slow to brake


def title(recording: Recording, options: Simulate) -> str:
    """Robot, controller and load."""
    title = f"{recording.settings['robot']} under {Path(options.controller).name}, "
    if options.payload == 0:
        return title + "no payload"
    at = ", ".join(f"{part:g}" for part in options.offset)
    return f"{title}payload {options.payload:g} kg at {f'({at})' if len(options.offset) > 1 else at} m"


def show(
    recording: Recording,
    robot: Robot,
    controller: Controller,
    plant: Plant,
    options: Simulate,
    found_marks: Sequence[Mark] = (),
) -> None:
    """Prints the table per joint, the release and the faults if there were any, and where the picture is."""
    console = Console()
    table = bare_table(title(recording, options))
    for name in ("joint", "control"):
        table.add_column(name, no_wrap=name != "joint")
    for name in ("error [deg]", "dev.", "torque [N m]", "of limit", "vibration [N m]"):
        table.add_column(escape(name), justify="right", no_wrap=True)
    before = np.isfinite(recording.link_position).all(1)
    until, when = options.release, f"the release at {options.release or 0:g} s"
    stop = stopped_at(recording)
    if stop is not None and (until is None or stop < until):
        until, when = stop, f"the supervisor stops the arm at {stop:.4g} s"
    if until is not None:  # then nobody follows the reference any more
        before &= recording.time < until - 1e-9
    shown = before & (recording.time >= 0)
    # What a faulty sensor says is no measure of what the arm did.
    angle = recording.link_position if options.fault else recording.position
    sensed = recording.torque if options.fault else recording.sample
    error = np.degrees((recording.reference - angle)[shown])
    torque = np.abs(recording.in_effect[before])
    found = None
    if recording.diverged_at is None:
        found = vibration(sensed[before], controller.period)
    oscillating = []
    for j, drive in enumerate(robot.drives):
        kind = "servo"
        if drive.name in controller.joints:
            kind = controller.laws[controller.index(drive.name)]
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
    when = "" if until is None else f", all before {when}"
    of, which = ("mean error of the link", "true") if options.fault else ("mean error", "sensed")
    console.print(
        f"{of}, its standard deviation, largest torque, RMS of {which} torque above {CORNER:g} Hz in "
        f"the last {WINDOW:g} s{when}",
        highlight=False,
        style="dim",
    )
    if options.release is not None:
        console.print()
        console.print(_release_table(recording, controller, options.release))
    if found_marks:
        console.print()
        console.print(listed(found_marks))
    console.print()
    said, step = plant.step_said, recording.settings["timestep"]
    if isinstance(step, float) and step != plant.timestep:
        said = f"physics step {step * 1e6:.1f} us, as a payload on the way needs it"
    console.print(said, highlight=False, style="dim")
    for line in oscillating:
        console.print(f"[yellow]{line}[/]", highlight=False)
    if recording.diverged_at is not None:
        console.print(
            f"{verdict(False, 'diverged')} at {recording.diverged_at:.3f} s: "
            "the loop is unstable with this payload",
            highlight=False,
        )
    elif (recording.status & TORQUE_LIMITED).any():
        share = 100 * ((recording.status & TORQUE_LIMITED) != 0).mean()
        console.print(f"[yellow]torque limit reached[/] in {share:.1f} % of the ticks", highlight=False)
    console.print(f"seed {options.seed}; open {escape(str(options.out / 'simulate.png'))}", highlight=False)
    if options.log is not None:
        # A CSV file cannot say how its torque was sampled.
        said = "" if options.log.suffix.lower() != ".csv" else f" --sampling {controller.sampling}"
        console.print(
            f"next: dashpot identify {escape(str(options.log))} --robot {escape(options.robot)}{said}",
            highlight=False,
            soft_wrap=True,
        )
        console.print(
            f"      ({escape(options.robot)} is what was simulated; --robot takes the file to be checked)",
            highlight=False,
            soft_wrap=True,
            style="dim",
        )


def stopped_at(recording: Recording) -> float | None:
    """When the supervisor first left the reference, to brake or to close the brakes [s]; None: never."""
    told: Any = recording.settings.get("supervisor", {})
    times = [
        float(decision["time"]) for decision in told.get("decisions", ()) if decision["before"] == "track"
    ]
    return min(times, default=None)


def _bypassed(joint: str, options: Simulate) -> bool:
    return joint in options.bypass or "all" in options.bypass


def _release_table(recording: Recording, controller: Controller, release: float) -> Table:
    """How each released joint slowed down, and how far it moved until then and from then to the end."""
    table = bare_table(f"After the release at {release:g} s")
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


def draw(
    recording: Recording, controller: Controller, options: Simulate, found_marks: Sequence[Mark] = ()
) -> Figure:
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
            draw_marks(axis, found_marks, recording.joints[j], recording.time[-1], axis is above)
        below.set_xlabel("time [s]")
        below.tick_params(labelbottom=True)
        if column == 0:
            above.set_ylabel("position [deg]")
            below.set_ylabel("sensed torque [N m]")
    lines: dict[Any, Any] = {
        line.get_label(): line
        for axis in (axes[0, 0], axes[1, 0])
        for line in axis.get_lines()
        if not str(line.get_label()).startswith("_")
    }
    lines |= legend_entries(found_marks)
    top_legend(figure, lines, title(recording, options))
    return figure


def _show_at_least(axis: Any, span: float, data: Floats) -> None:
    """Keeps noise from filling the axis, and ticks free of a common offset or factor."""
    axis.ticklabel_format(axis="y", useOffset=False, scilimits=(-9, 9))
    data = data[np.isfinite(data)]
    if len(data) and np.ptp(data) < span:
        middle = (data.min() + data.max()) / 2
        axis.set_ylim(middle - 0.55 * span, middle + 0.55 * span)
