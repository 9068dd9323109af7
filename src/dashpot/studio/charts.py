"""The charts: the last seconds of the joint on show, and of its rival; and where the energy is."""

from __future__ import annotations

from typing import Any

import numpy as np
import viser

from dashpot.studio import markup
from dashpot.studio.markup import BLUE, GREEN, ORANGE, VERMILLION
from dashpot.studio.ring import Past, envelope
from dashpot.studio.session import Session
from dashpot.support.arrays import Floats

SECONDS = 10.0  # shown
BINS = 90  # 180 points a line
HEIGHT = 118  # [px]
LABEL = 16  # [px] more where the axis has a name
PURPLE = "#9A4E7B"
CHARTS = (
    ("torque", "Sensed torque", "N m", 0.05),
    ("error", "Tracking error", "deg", 0.02),
    ("speed", "Speed", "deg/s", 0.05),
)
"""Name, title, unit, and the least that the axis spans: the browser writes three decimals, and a shorter one
would read 0, 0, -0.
"""
LEAST_ENERGY = 0.02  # [J]
UNSEEN: Any = {"label": "range", "stroke": "transparent", "width": 0, "points": {"show": False}}
ENERGY = (
    ("kinetic", BLUE, ()),
    ("potential", GREEN, (8, 4)),
    ("virtual", VERMILLION, (3, 3)),
    ("taken out", PURPLE, (10, 3, 2, 3)),
)


class Charts:
    """Four charts, one below the other."""

    def __init__(self, server: viser.ViserServer) -> None:
        gui = server.gui
        self._legends, self._plots = [], []
        empty = np.zeros(2)
        for _ in CHARTS:
            self._legends.append(gui.add_html(""))
            self._plots.append(
                gui.add_uplot(
                    (empty, empty, empty, empty, empty),
                    (
                        {},
                        UNSEEN,
                        {"label": "supervisor", "stroke": ORANGE, "width": 1, "points": {"show": False}},
                        {
                            "label": "beside it", "stroke": VERMILLION, "width": 1.5, "dash": (6, 4),
                            "points": {"show": False},
                        },
                        {"label": "this", "stroke": BLUE, "width": 2, "points": {"show": False}},
                    ),
                    **_options(),
                )
            )  # fmt: skip
        legend = [
            (name, colour, ("solid", "dashed", "dotted", "dashed")[k])
            for k, (name, colour, _) in enumerate(ENERGY)
        ]
        gui.add_html(markup.legend("Energy", "J", legend))
        series: tuple[Any, ...] = (
            {},
            UNSEEN,
            *(
                {"label": name, "stroke": colour, "width": 1.5, "dash": dash, "points": {"show": False}}
                for name, colour, dash in ENERGY
            ),
        )
        self._energy = gui.add_uplot((empty,) * 6, series, **_options("time [s]"))

    def label(self, session: Session) -> None:
        """Writes the titles: the joint on show and the rival."""
        for place, (_, title, unit, _) in zip(self._legends, CHARTS, strict=True):
            entries = [("this", BLUE, "solid")]
            if session.rival_name:
                entries.append((session.rival_name, VERMILLION, "dashed"))
            text = markup.legend(f"{title}, {session.joint}", unit, entries)
            if place.content != text:
                place.content = text

    def draw(self, session: Session) -> None:
        """Draws the last seconds."""
        past = session.past(SECONDS)
        if len(past.time) < 4:
            return
        j = session.robot.index(session.joint)
        other = session.past(SECONDS, rival=True) if session.rival is not None else None
        mine = np.nan_to_num(_lines(past, j))  # a sensor that says nothing is drawn as zero
        rows, shown = envelope(mine, BINS)
        time = past.time[rows]
        beside = shown.copy()  # hidden behind it; a number that is none would leave the chart without a range
        if other is not None and len(other.time) > 3:
            theirs = mine.copy()
            count = min(len(other.time), len(mine))
            theirs[-count:] = _lines(other, j)[-count:]
            beside = np.where(np.isfinite(found := envelope(theirs, BINS)[1]), found, shown)
        marks = [news.time for news in session.latest(time[0]) if news.kind == "supervisor"]
        for k, plot in enumerate(self._plots):
            spikes = shown[:, k].copy()
            for when in marks:  # a line from the curve to the top
                spikes[min(int(np.searchsorted(time, when)), len(time) - 1)] = shown[:, k].max()
            span = least_span(np.stack([shown[:, k], beside[:, k]]), CHARTS[k][3])
            plot.data = (time, span, spikes, beside[:, k], shown[:, k])
        energy = session.energy_since(time[0])
        if len(energy) > 3:
            rows, values = envelope(energy[:, 1:], BINS)
            self._energy.data = (energy[rows, 0], least_span(values.T, LEAST_ENERGY), *values.T)


def least_span(lines: Floats, least: float) -> Floats:
    """A line (k,) that is not seen and has the axis of lines (m, k) span at least so much."""
    low, high = float(lines.min()), float(lines.max())
    middle, half = (low + high) / 2, max(high - low, least) / 2
    found = np.full(lines.shape[1], middle)
    found[0], found[-1] = middle - half, middle + half
    return found


def _lines(past: Past, j: int) -> Floats:
    """Sensed torque [N m], tracking error and speed of the link [deg, deg/s], (k, 3)."""
    error = np.degrees(past.reference[:, j] - past.channel("link_position")[:, j])
    return np.stack(
        [past.channel("sample")[:, j], error, np.degrees(past.channel("link_velocity")[:, j])], axis=1
    )


def _options(label: str = "") -> dict[str, Any]:
    axis: dict[str, Any] = {
        "size": 22,
        "font": "11px system-ui",
        "grid": {"stroke": "#E8E8E8", "width": 1},
        "ticks": {"size": 3},
    }
    return {
        "scales": {"x": {"time": False}, "y": {"auto": True}},
        "axes": (
            {**axis, "label": label, "labelSize": LABEL, "labelFont": "11px system-ui"} if label else axis,
            {**axis, "size": 46, "space": 22},
        ),
        "legend": {"show": False},
        "cursor": {"show": False},
        "height": HEIGHT + (LABEL if label else 0),
        "padding": (8, 10, 0, 0),
    }
