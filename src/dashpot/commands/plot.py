"""``dashpot plot``."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console
from rich.markup import escape

from dashpot.commands.plot_draw import draw_joint, draw_overview, error_of, lettered
from dashpot.commands.shared import bare_table, check_place, file_names, new_table, progress
from dashpot.logs import Topics
from dashpot.logs.samples import Samples, read_samples
from dashpot.support.arrays import Floats
from dashpot.support.output import whole_folder
from dashpot.support.plots import save
from dashpot.support.waiting import waiting

if TYPE_CHECKING:
    from dashpot.cli.identify import Plot


def plot(options: Plot) -> int:
    """``dashpot plot``; returns the exit status."""
    check_place(options.out, [options.log])
    with waiting("reading the log"):
        samples = read_samples(options.log, Topics(options.states, options.commands, options.links))
    if options.joint:
        samples = samples.only(options.joint)
    if options.window is not None:
        samples = samples.between(*options.window)
    names = file_names(("overview", *samples.joints))
    pictures = 1 + len(samples.joints)
    with progress("drawing", pictures) as advance, whole_folder(options.out) as folder:
        save(draw_overview(samples), folder / "overview", pdf=options.pdf)
        advance()
        for joint in samples.joints:
            save(draw_joint(samples, joint), folder / names[joint], pdf=options.pdf)
            advance()
    _show(samples, options)
    return 0


def _show(samples: Samples, options: Plot) -> None:
    console = Console()
    start, end = samples.span
    time = next(iter(samples.series.values())).time
    rate = (
        f", {(len(time) - 1) / (time[-1] - time[0]):.4g} Hz" if len(time) > 1 and time[-1] > time[0] else ""
    )
    table = new_table(f"{samples.file.name}: {start:.4g} to {end:.4g} s{rate}")
    for name in ("torque [N m]", "command [N m]", "error [deg]", "speed [deg/s]"):
        table.add_column(escape(name), justify="right", no_wrap=True)
    torque, command, speed = (_column(samples, name) for name in ("torque", "command", "velocity"))
    found = error_of(samples)
    error = None if found is None else found.values
    for j, joint in enumerate(samples.joints):
        table.add_row(
            escape(joint),
            _largest(torque, j, "{:.2f}"),
            _largest(command, j, "{:.2f}"),
            _rms(error, j, "{:.3f}"),
            _largest(speed, j, "{:.1f}", 180 / np.pi),
        )
    console.print(table)
    console.print(
        "largest sensed torque, command and speed; RMS tracking error", style="dim", highlight=False
    )
    events = lettered(samples)
    if events:
        console.print()
        said = bare_table("What happened")
        said.add_column("")
        said.add_column(escape("time [s]"), justify="right", no_wrap=True)
        said.add_column("message")
        for event in events:
            style = {"info": "", "warning": "yellow", "error": "red"}[event.level]
            said.add_row(event.letter, f"{event.time:.3f}", escape(event.text), style=style)
        console.print(said)
        if len(samples.happenings) > len(events):
            console.print(f"and {len(samples.happenings) - len(events)} more", style="dim", highlight=False)
    console.print()
    console.print(f"open {escape(str(options.out / 'overview.png'))}", highlight=False, soft_wrap=True)


def _column(samples: Samples, name: str) -> Floats | None:
    return samples.series[name].values if name in samples.series else None


def _largest(values: Floats | None, j: int, form: str, scale: float = 1.0) -> str:
    if values is None or np.isnan(values[:, j]).all():
        return "-"
    return form.format(scale * float(np.nanmax(np.abs(values[:, j]))))


def _rms(values: Floats | None, j: int, form: str) -> str:
    if values is None or np.isnan(values[:, j]).all():
        return "-"
    return form.format(float(np.sqrt(np.nanmean(values[:, j] ** 2))))
