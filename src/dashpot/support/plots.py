"""Plot style: Okabe-Ito colours, a second channel (marker or dash) beside colour, PNG and PDF."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

BLACK, GREEN = "#000000", "#009E73"
BLUE, VERMILLION, PURPLE, GREY = "#0072B2", "#D55E00", "#CC79A7", "#7A7A7A"
ORANGE, SKY = "#E69F00", "#56B4E9"

ROOM = 0.94  # of a figure's width, for a legend over all of it

STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.5,
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "figure.titlesize": 11,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#E4E4E4",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "legend.frameon": False,
    "lines.linewidth": 1.4,
    "savefig.dpi": 160,
    "pdf.fonttype": 42,
}


def new_figure(
    rows: int,
    columns: int,
    width: float,
    height: float,
    *,
    layout: str | None = "constrained",
    **options: Any,
) -> tuple[Figure, Any]:
    """A figure in the house style and its axes, always a 2-d array; sizes in inches."""
    mpl.rcParams.update(STYLE)
    return plt.subplots(rows, columns, figsize=(width, height), squeeze=False, layout=layout, **options)


@contextmanager
def _any_names() -> Iterator[None]:
    """Names given by the user may have letters that the font lacks."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from font")
        yield


def top_legend(figure: Figure, lines: Mapping[str, Any], title: str | None = None) -> None:
    """A legend above all axes, label to handle, in as many columns as the figure is wide enough for."""
    for columns in range(len(lines), 0, -1):
        legend = figure.legend(
            lines.values(),
            lines.keys(),
            title=title,
            loc="outside upper center",
            ncols=columns,
            fontsize=9,
            title_fontsize=11,
        )
        legend.get_title().set_parse_math(False)
        with _any_names():
            width = legend.get_window_extent(figure.canvas.get_renderer()).width  # type: ignore[attr-defined]
        if width <= ROOM * figure.get_figwidth() * figure.dpi or columns == 1:
            return
        legend.remove()


def save(figure: Figure, path: Path, *, pdf: bool = True) -> list[Path]:
    """Writes ``path`` as PNG, and as PDF unless told not to, and closes the figure; returns the paths."""
    paths = [path.with_suffix(".png"), path.with_suffix(".pdf")]
    with _any_names():
        figure.savefig(paths[0])
        if pdf:
            figure.savefig(paths[1], metadata={"CreationDate": None})
    plt.close(figure)
    return paths[: 1 + pdf]


__all__ = [
    "BLACK",
    "BLUE",
    "GREEN",
    "GREY",
    "ORANGE",
    "PURPLE",
    "SKY",
    "VERMILLION",
    "Figure",
    "new_figure",
    "save",
    "top_legend",
]
