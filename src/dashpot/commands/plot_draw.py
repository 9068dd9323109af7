"""Pictures of ``dashpot plot``: an overview of all joints, and one picture per joint."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from string import ascii_uppercase
from typing import Any

import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from dashpot.control.supervisor import STATES
from dashpot.logs.messages import Level
from dashpot.logs.samples import Samples, Series
from dashpot.support.arrays import Floats
from dashpot.support.plots import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY,
    VERMILLION,
    Figure,
    new_figure,
)

DEGREES = 180 / math.pi
POINTS = 3000  # drawn of a line: the largest and smallest of every stretch
MOST = 16  # events with a letter
PER_INCH, LINE = 14.0, 0.165  # characters of the small print; its lines [in]
COLOURS = (BLUE, VERMILLION, GREEN, BLACK, ORANGE, PURPLE, SKY)
DASHES: tuple[Any, ...] = ("-", (0, (6, 2)), (0, (2, 1.2)), (0, (6, 1.5, 1, 1.5)))
LEVEL_COLOUR: dict[Level, str] = {"info": GREY, "warning": ORANGE, "error": VERMILLION}
LEVEL_DASH: dict[Level, Any] = {"info": ":", "warning": (0, (5, 2)), "error": "-"}
STORED: tuple[tuple[str, str, str, Any, float], ...] = (
    ("energy_kinetic", "kinetic, rotor", BLUE, "-", 1.2),
    ("energy_potential", "potential, transmission", GREEN, (0, (2, 1.2)), 1.2),
    ("energy_virtual", "virtual, law", VERMILLION, (0, (6, 2)), 1.2),
)
WORK: tuple[tuple[str, str, str, Any, float], ...] = (
    ("energy_motor", "by motor", BLACK, "-", 1.2),
    ("energy_port", "into link", BLUE, (0, (6, 2)), 1.2),
    ("energy_dissipated", "lost in rotor", PURPLE, (0, (2, 1.2)), 1.4),
)
ARM = (("stored, all joints [J]", STORED), ("work, all joints [J]", WORK))
STATE_TINT = {1: (ORANGE, ""), 2: (SKY, "//"), 3: (VERMILLION, "xx")}


@dataclass(frozen=True)
class Event:
    """Something that happened, with its letter."""

    letter: str
    time: float
    level: Level
    text: str


@dataclass(frozen=True)
class _Line:
    """A line in a panel: what it is called, its samples, and how it is drawn."""

    label: str
    series: Series
    column: int | None
    colour: str
    dash: Any = "-"
    width: float = 1.2
    scale: float = 1.0

    @property
    def values(self) -> Floats:
        values = self.series.values if self.column is None else self.series.values[:, self.column]
        return np.asarray(self.scale * values)


def lettered(samples: Samples) -> list[Event]:
    """The log's messages with letters: all while they are few, else the gravest, earliest first."""
    order = {"error": 0, "warning": 1, "info": 2}
    kept = sorted(samples.happenings, key=lambda one: (order[one.level], one.time))[:MOST]
    kept.sort(key=lambda one: one.time)
    return [Event(ascii_uppercase[i], one.time, one.level, one.text) for i, one in enumerate(kept)]


def error_of(samples: Samples) -> Series | None:
    """Reference minus measured angle [deg]; the reference as of the last sample before."""
    reference, position = samples.series.get("reference"), samples.series.get("position")
    if reference is None or position is None or not len(reference.time):
        return None
    at = np.searchsorted(reference.time, position.time + 1e-9, "right") - 1
    known = reference.values[np.maximum(at, 0)]
    known = np.where((at >= 0)[:, None], known, np.nan)
    return Series(position.time, DEGREES * (known - position.values))


def draw_joint(samples: Samples, joint: str) -> Figure:
    """One joint: torque, tracking error or angle, speed, energy stored and work done, as far as logged."""
    j = samples.joints.index(joint)
    panels: list[tuple[str, list[_Line]]] = [
        (
            "torque [N m]",
            [
                *_lines(samples, j, (("torque", "sensed", VERMILLION, "-", 0.9),)),
                *_lines(samples, j, (("command", "command", BLUE, (0, (5, 1.5)), 1.1),)),
            ],
        )
    ]
    error = error_of(samples)
    if error is not None and np.isfinite(error.values[:, j]).any():
        panels.append(("tracking error [deg]", [_Line("reference - position", error, j, BLUE)]))
    else:
        lines = _lines(samples, j, (("position", "position", BLUE, "-", 1.2),), DEGREES)
        panels.append(("position [deg]", lines))
    speed = (("velocity", "rotor", BLUE, "-", 1.1), ("link_velocity", "link", GREY, (0, (4, 2)), 0.9))
    panels.append(("speed [deg/s]", _lines(samples, j, speed, DEGREES)))
    panels += [("stored [J]", _lines(samples, j, STORED)), ("work [J]", _lines(samples, j, WORK))]
    panels = [(label, lines) for label, lines in panels if lines]
    height = 1.0 + 1.75 * len(panels) + LINE * len(_said(samples, round(PER_INCH * 9.0)))
    figure, axes = new_figure(len(panels), 1, 9.0, height, sharex=True)
    for axis, (label, lines) in zip(axes[:, 0], panels, strict=True):
        _panel(axis, label, lines)
        axis.legend(loc="center left", bbox_to_anchor=(1.005, 0.5), fontsize=8.5, handlelength=2.6)
    _finish(figure, axes[:, :1], samples, f"{joint}, {samples.file.name}", below=axes[-1, 0])
    return figure


def draw_overview(samples: Samples) -> Figure:
    """All joints in each panel, and the energy of the arm."""
    panels: list[tuple[str, list[_Line]]] = []
    error = error_of(samples)
    derived: dict[str, Series] = dict(samples.series)
    if error is not None:
        derived["error"] = error
    for label, name, scale in (
        ("sensed torque [N m]", "torque", 1.0),
        ("torque command [N m]", "command", 1.0),
        ("tracking error [deg]", "error", 1.0),
        ("position [deg]", "position", DEGREES),
        ("speed [deg/s]", "velocity", DEGREES),
    ):
        one = derived.get(name)
        if one is None or (name == "position" and error is not None):
            continue
        lines = []
        for j, joint in enumerate(samples.joints):
            if np.isfinite(one.values[:, j]).any():
                colour, dash = _look(j)
                lines.append(_Line(joint, one, j, colour, dash, 1.0, scale))
        if lines:
            panels.append((label, lines))
    energy = [(label, lines) for label, named in ARM if (lines := _sums(samples, named))]
    columns = 1 if len(panels) + len(energy) < 4 else 2
    rows = math.ceil((len(panels) + len(energy)) / columns)
    width = 5.6 * columns + 1.4
    height = 1.3 + 2.35 * rows + LINE * len(_said(samples, round(PER_INCH * width)))
    figure, axes = new_figure(rows, columns, width, height, sharex=True)
    places = [axes[i % rows, i // rows] for i in range(rows * columns)]
    for axis, (label, lines) in zip(places, panels, strict=False):
        _panel(axis, label, lines)
    used = len(panels)
    for label, lines in energy:
        _panel(places[used], label, lines)
        places[used].legend(loc="best", fontsize=8.5, handlelength=2.6)
        used += 1
    for axis in places[used:]:
        axis.set_axis_off()
    joints = {line.label: line for _, lines in panels for line in lines}
    handles = [_handle(joints[joint]) for joint in samples.joints if joint in joints]
    legend = figure.legend(
        handles=handles, loc="outside right upper", fontsize=8.5, handlelength=2.6, title="joint"
    )
    for text in legend.get_texts():
        text.set_parse_math(False)
    for column in range(columns):
        last = max(i for i in range(rows) if column * rows + i < used)
        axes[last, column].set_xlabel("time [s]")
        axes[last, column].tick_params(labelbottom=True)
    drawn = np.array([axes[0, column] for column in range(columns)]).reshape(1, -1)
    _finish(figure, drawn, samples, samples.file.name, all_axes=places[:used])
    return figure


def _sums(samples: Samples, named: Sequence[tuple[str, str, str, Any, float]]) -> list[_Line]:
    """Sums over the joints, of those that have the quantity at all."""
    lines = []
    for name, label, colour, dash, width in named:
        if (series := samples.series.get(name)) is None:
            continue
        there = np.isfinite(series.values).any(axis=1)
        total = np.where(there, np.nansum(series.values, axis=1), np.nan)
        if there.any():
            lines.append(_Line(label, Series(series.time, total), None, colour, dash, width))
    return lines


def _look(j: int) -> tuple[str, Any]:
    """Colour and dash of a joint: never two alike for 28 joints."""
    n = len(COLOURS)
    return COLOURS[j % n], DASHES[(j % n % 2 + 2 * (j // n) + j // (2 * n)) % len(DASHES)]


def _lines(
    samples: Samples, j: int, named: Sequence[tuple[str, str, str, Any, float]], scale: float = 1.0
) -> list[_Line]:
    return [
        _Line(label, samples.series[name], j, colour, dash, width, scale)
        for name, label, colour, dash, width in named
        if name in samples.series and np.isfinite(samples.series[name].values[:, j]).any()
    ]


def _handle(line: _Line) -> Any:
    return Line2D([], [], color=line.colour, ls=line.dash, lw=1.6, label=line.label)


def _panel(axis: Any, label: str, lines: Sequence[_Line]) -> None:
    for line in lines:
        time, values = thin(line.series.time, line.values)
        axis.plot(time, values, color=line.colour, ls=line.dash, lw=line.width, label=line.label)
    axis.set_ylabel(label)
    axis.ticklabel_format(axis="y", useOffset=False, scilimits=(-4, 5))
    axis.margins(x=0.01)


def thin(time: Floats, values: Floats, points: int = POINTS) -> tuple[Floats, Floats]:
    """Smallest and largest value of every stretch, in their order, where there are too many to draw.

    Args:
        time: (t,).
        values: (t,); a stretch without numbers stays a gap.
        points: About as many are kept.
    """
    if len(time) <= 2 * points:
        return time, values
    width = math.ceil(2 * len(time) / points)
    rows = np.pad(values, (0, -len(values) % width), constant_values=np.nan).reshape(-1, width)
    low = np.where(np.isnan(rows), np.inf, rows).argmin(1)
    high = np.where(np.isnan(rows), -np.inf, rows).argmax(1)
    index = np.unique(np.stack([low, high], 1) + width * np.arange(len(rows))[:, None])
    return time[index], values[index]


def _finish(
    figure: Figure,
    top: Any,
    samples: Samples,
    title: str,
    *,
    below: Any = None,
    all_axes: Sequence[Any] | None = None,
) -> None:
    """Events, the supervisor's state, the title, and what the letters mean."""
    start, end = samples.span
    events = [event for event in lettered(samples) if start <= event.time <= end]
    axes = list(top.ravel()) if below is not None else list(all_axes or ())
    for axis in axes:
        axis.set_xlim(start - 0.01 * (end - start), end + 0.01 * (end - start))
        for event in events:
            axis.axvline(event.time, color=LEVEL_COLOUR[event.level], ls=LEVEL_DASH[event.level], lw=1.0)
    tints = _tint(axes, samples)
    for axis in top[0]:
        _letters(axis, events, start, end)
    if below is not None:
        below.set_xlabel("time [s]")
    said = figure.suptitle(title, fontweight="bold")
    said.set_parse_math(False)
    lines = _said(samples, round(PER_INCH * figure.get_figwidth()))
    if lines or tints:
        handles: list[Any] = [*tints]
        legend = figure.legend(
            handles=handles or [Patch(alpha=0)],
            labels=None if handles else [""],
            loc="outside lower left",
            ncols=max(1, len(handles)),
            fontsize=8.5,
            title="\n".join(lines) or None,
            title_fontsize=8.5,
            alignment="left",
        )
        legend.get_title().set_parse_math(False)


def _said(samples: Samples, width: int) -> list[str]:
    """What the letters mean, in lines of at most ``width`` characters."""
    events = lettered(samples)
    lines = []
    for event in events:
        text = f"{event.letter}  {event.time:.3f} s  {textwrap.shorten(event.text, 2 * width - 30)}"
        lines += textwrap.wrap(text, width, subsequent_indent="     ")
    if len(samples.happenings) > len(events):
        lines.append(f"and {len(samples.happenings) - len(events)} more")
    return lines


def _tint(axes: Sequence[Any], samples: Samples) -> list[Patch]:
    """Tints the times at which the supervisor was not tracking; a patch for each state that occurs."""
    series = samples.series.get("supervisor")
    if series is None:
        return []
    state = series.values.astype(int)
    edges = np.flatnonzero(np.diff(state, prepend=state[0] - 1))
    patches: dict[int, Patch] = {}
    for i, first in enumerate(edges):
        look = STATE_TINT.get(int(state[first]))
        if look is None:
            continue
        stop = series.time[edges[i + 1]] if i + 1 < len(edges) else series.time[-1]
        colour, hatch = look
        for axis in axes:
            axis.axvspan(series.time[first], stop, facecolor=colour, alpha=0.13, lw=0, zorder=0)
            axis.axvspan(
                series.time[first], stop, fc="none", ec=colour, alpha=0.25, hatch=hatch, lw=0, zorder=0
            )
        patches[int(state[first])] = Patch(
            facecolor=(*to_rgb(colour), 0.2),
            edgecolor=(*to_rgb(colour), 0.6),
            hatch=hatch,
            lw=0,
            label=f"supervisor: {STATES[state[first]].replace('_', ' ')}",
        )
    return [patches[key] for key in sorted(patches)]


def _letters(axis: Any, events: Sequence[Event], start: float, end: float) -> None:
    """Letters above the axes; those of events that are close share a place."""
    groups: list[list[Event]] = []
    for event in events:
        if groups and event.time - groups[-1][0].time < 0.035 * (end - start):
            groups[-1].append(event)
        else:
            groups.append([event])
    for group in groups:
        first, last = group[0].letter, group[-1].letter
        text = first if len(group) == 1 else f"{first}{',' if len(group) == 2 else '-'}{last}"
        axis.annotate(
            text,
            (group[0].time, 1.0),
            xycoords=axis.get_xaxis_transform(),
            xytext=(0, 2),
            textcoords="offset points",
            ha="center",
            va="bottom",
            fontsize=8.5,
            fontweight="bold",
            annotation_clip=False,
        )
