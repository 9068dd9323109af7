"""Pictures of a campaign: how joints stop, error against payload, verdicts over two axes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.ticker import FuncFormatter

from dashpot.campaign.axes import Axis
from dashpot.campaign.scenario import OK
from dashpot.campaign.spec import Spec
from dashpot.support.arrays import Floats
from dashpot.support.plots import BLACK, BLUE, GREEN, GREY, PURPLE, VERMILLION, new_figure, save, top_legend

BINS = 8  # of a sampled payload
ROWS, CELLS = 60, 24  # rows and columns of a matrix at most
STYLES = [(c, d) for d in ("-", "--", ":") for c in (BLUE, VERMILLION, GREEN, PURPLE, BLACK)]
VERDICTS = LinearSegmentedColormap.from_list("verdicts", ["#D55E00", "#F6E3C5", "#009E73"])


@dataclass(frozen=True)
class Picture:
    """A picture for the report.

    Attributes:
        title: Heading.
        caption: What it shows.
        path: PNG.
    """

    title: str
    caption: str
    path: Path


def pictures(spec: Spec, dataset: Any, good: Any, folder: Path) -> list[Picture]:
    """Draws whatever the axes and measures allow."""
    drawers: tuple[Callable[..., Picture | None], ...] = (distribution, against_payload, matrix)
    found = (drawer(spec, dataset, good, folder) for drawer in drawers)
    return [picture for picture in found if picture is not None]


def _columns(dataset: Any, name: str) -> Floats:
    """A measure in degrees where it is an angle, (scenarios, n); NaN where a scenario is not good."""
    values = np.degrees(dataset[name].values) if dataset[name].units == "rad" else dataset[name].values
    values = np.array(values.reshape(-1, dataset.sizes["joint"]), float)
    values[dataset["status"].values.ravel() != OK] = np.nan
    return values


def distribution(spec: Spec, dataset: Any, good: Any, folder: Path) -> Picture | None:
    """Share of the scenarios beyond a stop distance, per joint; without an event, a tracking error."""
    name, what = "stop_angle", "way until it stops"
    values = _columns(dataset, name)
    if not np.isfinite(values).any():
        name, what = "error_max", "largest tracking error"
        values = _columns(dataset, name)
    if not np.isfinite(values).any():
        return None
    figure, axes = new_figure(1, 1, 7.2, 3.9)
    axis = axes[0, 0]
    positive = values[np.isfinite(values) & (values > 0)]
    floor = positive.min() if len(positive) else 1e-6
    for (colour, dash), joint, column in zip(STYLES * 4, dataset["joint"].values, values.T, strict=False):
        column = np.sort(column[np.isfinite(column)])
        if not len(column):
            continue
        beyond = 100 * (1 - np.arange(len(column)) / len(column))
        x = np.maximum(np.append(column, column[-1]), floor)
        axis.step(x, np.append(beyond, 0), where="pre", color=colour, ls=dash, label=str(joint))
    bounds = {need.high for need in spec.requirements if need.measure == name and math.isfinite(need.high)}
    for bound in map(math.degrees, sorted(bounds)):
        axis.axvline(bound, color=GREY, lw=1.2, ls=(0, (4, 2)))
        axis.annotate(
            f"required: {bound:g} deg",
            (bound, 99),
            (-4, 0),
            textcoords="offset points",
            rotation=90,
            ha="right",
            va="top",
            fontsize=8,
            color=GREY,
        )
    axis.set_xscale("log")
    axis.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    axis.set_xlim(left=floor)
    axis.set_ylim(0, 103)
    axis.set_xlabel(f"{what} [deg]")
    axis.set_ylabel("scenarios beyond it [%]")
    axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=8.5)
    path = save(figure, folder / "distribution", pdf=False)[0]
    title = "How far joints move until they stop" if name == "stop_angle" else "Largest tracking errors"
    caption = f"Share of the scenarios in which the {what} exceeds the value on the axis, per joint. " + (
        "It counts from the release or the first fault, to the end where a joint never stops."
        if name == "stop_angle"
        else ""
    )
    return Picture(title, caption, path)


def against_payload(spec: Spec, dataset: Any, good: Any, folder: Path) -> Picture | None:
    """Tracking error over payload: median and the band of 90 % of the scenarios, per joint."""
    if not spec.has("payload") or len(spec.axis("payload").values) == 1:
        return None
    values = _columns(dataset, "error_max")
    if not np.isfinite(values).any():
        return None
    sampled = spec.axis("payload").sampled
    payload = dataset["payload"].broadcast_like(dataset["status"]).transpose(*spec.dims).values.ravel()
    if sampled:
        edges = np.quantile(payload, np.linspace(0, 1, min(BINS, max(spec.count // 4, 1)) + 1))
        group = np.clip(np.searchsorted(edges, payload, side="right") - 1, 0, len(edges) - 2)
    else:
        group = np.searchsorted(np.unique(payload), payload)
    n, count = values.shape[1], int(group.max()) + 1
    at = np.array([payload[group == g].mean() for g in range(count)])
    rows = math.ceil(n / 4)
    columns = math.ceil(n / rows)
    figure, axes = new_figure(rows, columns, max(4.5, 2.5 * columns), 0.6 + 2.3 * rows, sharex=True)
    for j in range(rows * columns):
        axis = axes[j // columns, j % columns]
        if j >= n:
            axis.remove()
            continue
        low, middle, high = np.full((3, count), np.nan)
        for g in range(count):
            some = values[group == g, j]
            some = some[np.isfinite(some)]
            if len(some):
                low[g], middle[g], high[g] = np.quantile(some, (0.05, 0.5, 0.95))
        axis.fill_between(at, low, high, color=BLUE, alpha=0.2, lw=0, label="5 to 95 % of the scenarios")
        axis.plot(at, middle, color=BLUE, marker="o", ms=3.5, label="median")
        axis.set_title(str(dataset["joint"].values[j]), parse_math=False)
        axis.set_ylim(0, 1.08 * np.nanmax(high) if np.isfinite(high).any() else None)
        axis.tick_params(labelbottom=True)
        if j + columns >= n:
            axis.set_xlabel("payload [kg]")
        if j % columns == 0:
            axis.set_ylabel("largest error [deg]")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    top_legend(figure, dict(zip(labels, handles, strict=True)))
    path = save(figure, folder / "payload", pdf=False)[0]
    words = f"in {count} groups of payloads" if sampled else "over all other axes"
    caption = (
        "Largest tracking error per scenario, before the release or first fault: median and the band that "
        f"holds 90 % of the scenarios, {words}."
    )
    return Picture("Error against payload", caption, path)


def matrix(spec: Spec, dataset: Any, good: Any, folder: Path) -> Picture | None:
    """Share of scenarios that keep every bound, over fault and payload or the two longest grid axes."""
    wide = sorted((a for a in spec.grid if 1 < len(a.values) <= ROWS), key=lambda a: -len(a.values))
    first = [a for name in ("fault", "payload") for a in wide if a.name == name]
    ranked = first + [a for a in wide if a not in first]
    if not ranked:
        return None
    down, across = ranked[0], next((a for a in ranked[1:] if len(a.values) <= CELLS), None)
    chosen = [down] if across is None else [down, across]
    done = dataset["status"].values > 0
    keep = tuple(i for i, dim in enumerate(spec.dims) if dim not in [a.label for a in chosen])
    total, kept = done.sum(axis=keep), (good.reshape(spec.shape) & done).sum(axis=keep)
    order = [spec.dims.index(a.label) for a in chosen]
    if across is None:
        total, kept = total[:, None], kept[:, None]
    elif order[0] > order[1]:
        total, kept = total.T, kept.T
    share = np.divide(kept, total, out=np.full(total.shape, np.nan), where=total > 0)
    height, width = share.shape
    figure, axes = new_figure(
        1, 1, max(4.2, 2.6 + 0.75 * width), 1.3 + (0.38 if height < 12 else 0.27) * height
    )
    axis = axes[0, 0]
    axis.grid(False)
    shade = np.where(share < 1, 0.75 * share, 1.0)  # one that is not kept must show among many
    axis.pcolormesh(shade, cmap=VERDICTS, vmin=0, vmax=1, edgecolors="white", linewidth=2)
    axis.invert_yaxis()
    for i in range(height):
        for j in range(width):
            dark = shade[i, j] < 0.2 or shade[i, j] > 0.85
            colour = "white" if dark else BLACK
            axis.text(
                j + 0.5,
                i + 0.5,
                f"{kept[i, j]}/{total[i, j]}",
                ha="center",
                va="center",
                fontsize=8.5,
                color=colour,
            )
    axis.set_xticks(np.arange(width) + 0.5, _labels(across) if across else [""])
    axis.set_yticks(np.arange(height) + 0.5, _labels(down))
    if across is not None:
        axis.set_xlabel(f"{across.name}{f' [{across.unit}]' if across.unit not in ('', '-') else ''}")
    axis.set_ylabel(f"{down.name}{f' [{down.unit}]' if down.unit not in ('', '-') else ''}")
    axis.spines[:].set_visible(False)
    axis.tick_params(length=0)
    path = save(figure, folder / "matrix", pdf=False)[0]
    title = f"Verdicts over {down.name}" + (f" and {across.name}" if across else "")
    kind = "keep every bound of the requirements" if spec.requirements else "run to their end"
    return Picture(title, f"Scenarios that {kind}, of those simulated, over all other axes.", path)


def _labels(axis: Axis) -> list[str]:
    return [value if isinstance(value, str) else f"{value:g}" for value in axis.labels]
