"""Picture of an identified joint: torque measured and predicted, what is left, and the intervals."""

from __future__ import annotations

from typing import Any

import numpy as np

from dashpot.arm.drive import Drive
from dashpot.commands.identify_view import NAMES, digits, old_value
from dashpot.identify import DriveEstimate, Fit
from dashpot.logs.log import Log
from dashpot.support.plots import BLACK, BLUE, GREY, VERMILLION, Figure, new_figure

STRETCH = 6.0  # [s] shown
WIDEST = 60.0  # [%] beyond which an old value is an arrow at the edge


def draw(estimate: DriveEstimate, drive: Drive, log: Log) -> Figure:
    """One joint's picture.

    Raises:
        ValueError: The joint has no fit.
    """
    if estimate.fit is None:
        raise ValueError(f"joint {estimate.joint!r} has no fit")
    figure, axes = new_figure(2, 2, 11.0, 5.4, width_ratios=(1.25, 1), height_ratios=(1.7, 1))
    _torque(axes[0, 0], axes[1, 0], estimate.fit)
    axes[0, 1].remove()
    axes[1, 1].remove()
    _intervals(figure.add_subplot(axes[0, 1].get_gridspec()[:, 1]), estimate, drive, log)
    name = log.file.name if log.file else "log"
    figure.suptitle(f"{estimate.joint} from {name}", parse_math=False)
    return figure


def _telling(fit: Fit) -> Any:
    """A mask of the stretch in which the motor torque changes most."""
    if fit.time[-1] - fit.time[0] <= STRETCH:
        return np.ones(len(fit.time), bool)
    starts = np.arange(fit.time[0], fit.time[-1] - STRETCH, STRETCH / 4)
    masks = [(fit.time >= start) & (fit.time < start + STRETCH) for start in starts]
    return max(masks, key=lambda mask: float(np.std(fit.measured[mask])) if mask.sum() > 2 else 0.0)


def _torque(above: Any, below: Any, fit: Fit) -> None:
    shown = _telling(fit)
    time = fit.time[shown]
    steps = np.diff(time)
    gap = np.flatnonzero(steps > 5 * np.median(steps)) + 1 if len(time) > 2 else np.zeros(0, int)

    def line(values: Any) -> Any:
        return np.insert(values[shown].astype(float), gap, np.nan)

    t = np.insert(time, gap, np.nan)
    above.plot(t, line(fit.measured), color=BLUE, lw=2.2, alpha=0.55, label="motor torque, commanded")
    above.plot(t, line(fit.predicted), color=BLACK, lw=0.9, ls="--", label="predicted from sensor and motion")
    above.set_ylabel("torque [N m]")
    above.set_title("Motor torque")
    above.legend(loc="upper center", bbox_to_anchor=(0.5, -0.02), ncols=2, fontsize=8)
    above.tick_params(labelbottom=False)
    below.plot(t, line(fit.residual), color=GREY, lw=0.7)
    used = np.where(line(fit.used) > 0.5, line(fit.residual), np.nan)
    below.plot(t, used, color=VERMILLION, lw=0.9)
    below.axhline(0, color=BLACK, lw=0.6)
    below.set_ylabel("residual [N m]")
    below.set_xlabel("time [s]")
    below.set_title(
        f"Left over: {fit.residual_std:.2g} N m RMS where used (red), {fit.samples} samples", fontsize=9
    )


def _scale(key: str, value: float, drive: Drive, log: Log) -> tuple[float, str]:
    """What one per cent on the axis is, in the quantity's unit, and how a row says so."""
    if key == "torque_scale_error":
        return 0.01, ""
    if key == "torque_bias":
        return drive.torque_limit / 100, "of limit"
    if key == "latency":
        return log.period / 100, "of a period"
    return abs(value) / 100, ""


def _intervals(axis: Any, estimate: DriveEstimate, drive: Drive, log: Log) -> None:
    """Each quantity's interval about its estimate, with the value of the robot file."""
    rows = [key for key in NAMES if key in estimate.values]
    spans: dict[str, tuple[float, float, float | None]] = {}
    for key in rows:
        found, old = estimate.values[key], old_value(drive, key)
        unit, _ = _scale(key, found.value, drive, log)
        unit = unit or 1.0
        spans[key] = (
            (found.low - found.value) / unit,
            (found.high - found.value) / unit,
            None if old is None else (old - found.value) / unit,
        )
    reach = [1.0]
    for low, high, was in spans.values():
        reach += [min(abs(end), 4 * WIDEST) for end in (low, high)]
        reach += [] if was is None else [min(abs(was), WIDEST)]
    edge = 1.15 * max(reach)
    for i, (key, (low, high, was)) in enumerate(spans.items()):
        y = len(rows) - i
        found = estimate.values[key]
        axis.plot([low, high], [y, y], color=BLUE, lw=3.5, solid_capstyle="butt", label="95 % interval")
        axis.plot([0], [y], "|", color=BLACK, ms=11, mew=1.6)
        if was is not None:
            if abs(was) <= edge:
                axis.plot([was], [y], "D", color=VERMILLION, ms=5, label="robot file")
            else:
                axis.plot([np.sign(was) * edge * 0.985], [y], ">" if was > 0 else "<", color=VERMILLION, ms=6)
        value, interval = digits(found)
        symbol = "" if found.unit == "-" else f" {found.unit}".replace("^2", "²")
        note = _scale(key, found.value, drive, log)[1]
        name = NAMES[key] + (f" (% {note})" if note else "")
        axis.text(-edge, y + 0.22, name, fontsize=8.5, va="bottom", weight="bold")
        axis.text(
            edge,
            y + 0.22,
            f"{value}  ({interval.replace(' ', ' to ')}){symbol}",
            fontsize=8,
            va="bottom",
            ha="right",
        )
    axis.set_yticks([])
    axis.spines["left"].set_visible(False)
    axis.set_ylim(0.4, len(rows) + 0.9)
    axis.set_xlim(-edge, edge)
    axis.axvline(0, color=BLACK, lw=0.6)
    axis.set_xlabel("deviation from the estimate [%]")
    lines = {line.get_label(): line for line in axis.get_lines() if not line.get_label().startswith("_")}
    axis.legend(
        lines.values(), lines.keys(), loc="upper center", bbox_to_anchor=(0.5, 1.09), ncols=2, fontsize=8
    )
