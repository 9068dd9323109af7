"""Tables and figure of `dashpot.studies.rivals_arms`, from its JSON."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

BEGIN, END = "<!-- rivals_arms: made by its command -->", "<!-- rivals_arms: end -->"
TITLES = {"k807": "wrist of the k807, 200 Hz", "k807 at 1 kHz": "wrist of the k807, 1 kHz"}
TITLES |= {"fr3": "fr3 with its own weight balanced, 1 kHz"}
TITLES |= {"fr3 with its weight": "fr3 with its own weight, which nothing carries, 1 kHz"}
SHORT = {"k807": "k807 wrist, 200 Hz", "k807 at 1 kHz": "k807 wrist, 1 kHz"}
SHORT |= {"fr3": "fr3, balanced", "fr3 with its weight": "fr3 with its weight"}


def document(result: Mapping[str, Any]) -> str:
    """The part of docs/rivals.md between `BEGIN` and `END`."""
    return "\n".join([BEGIN, *_lines(result), END])


def _lines(result: Mapping[str, Any]) -> Iterator[str]:
    runs = {row["arm"]: row["scenarios"] for row in result["brakes"] if "scenarios" in row}
    most = max(runs.values())
    yield f"Made by `{result['command']}`."
    yield f"{most} runs per brake ({_fewer(runs.values())} on arms shown apart) and"
    tracked = [row["scenarios"] for row in result["trackers"] if "scenarios" in row]
    yield f"{max(tracked)} per tracker ({_fewer(tracked)}), a third of them with each payload."
    yield "Median / 95th percentile of each run's worst joint."
    for arm in runs:
        rows = [row for row in result["brakes"] if row["arm"] == arm]
        for payload in _payloads(rows) if runs[arm] == most else [None]:
            load = "all payloads" if payload is None else f"{payload} kg"
            yield from ("", f"**Brakes, {TITLES[arm]}: {load}**", "")
            yield from _brakes(rows, payload)
        yield from _refusals(rows)
    for arm in dict.fromkeys(row["arm"] for row in result["trackers"]):
        rows = [row for row in result["trackers"] if row["arm"] == arm]
        yield from ("", f"**Trackers, {TITLES[arm]}**", "")
        yield from _trackers(rows)
        yield from _refusals(rows)


def _fewer(runs: Iterable[int]) -> str:
    """The numbers below the largest."""
    numbers = sorted(set(runs))
    return ", ".join(map(str, numbers[:-1])) or "as many"


def _payloads(rows: list[Any]) -> list[str]:
    return next(list(row["payloads"]) for row in rows if "payloads" in row)


def _brakes(rows: list[Any], payload: str | None) -> Iterator[str]:
    head = ["brake", "certified", "stop time [s]", "stop angle [mrad]"]
    yield from _head([*head, "peak torque [% of limit]", "drift in 5 s [mrad]"])
    for row in rows:
        if "refused" in row:
            yield _row([row["name"], "refused", *"----"])
            continue
        seen = row["all"] if payload is None else row["payloads"][payload]
        cells = [_pair(seen["stop_time"], 1.0, "never"), _pair(seen["stop_angle"], 1e3)]
        cells += [_pair(seen["peak_torque"], 100), _pair(seen["drift"], 1e3)]
        yield _row([row["name"], _verdict(row), *cells])


def _trackers(rows: list[Any]) -> Iterator[str]:
    payloads = _payloads(rows)
    head = ["tracker", "certified", *(f"error, {p} kg [mrad]" for p in payloads)]
    yield from _head([*head, "error, 95 % [mrad]", "worst payload [kg]", "noise torque [% of limit]"])
    for row in rows:
        if "refused" in row:
            yield _row([row["name"], "refused", *("-" * (len(payloads) + 3))])
            continue
        cells = [_error(row["payloads"][p], 0) for p in payloads] + [_error(row["all"], 1)]
        cells += [f"{row['worst_payload']:g}", _one(row["noise_torque"], 100, "-")]
        yield _row([row["name"], _verdict(row), *cells])


def _refusals(rows: list[Any]) -> Iterator[str]:
    """Why designs were refused, joints with the same reason together."""
    for row in rows:
        if "refused" in row:
            said: dict[str, list[str]] = {}
            for joint, lines in row["refused"].items():
                said.setdefault("; ".join(lines), []).append(joint)
            for text, joints in said.items():
                yield from ("", f"*{row['name']}*: refused at {', '.join(joints)}: {text}.")


def _error(found: Mapping[str, list[float | None]], which: int) -> str:
    return " ± ".join(_one(found[name][which], 1e3, "diverges") for name in ("error_mean", "error_std"))


def _head(names: list[str]) -> Iterator[str]:
    yield _row(names)
    yield "|" + "---|" * len(names)


def _row(cells: list[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _verdict(row: Mapping[str, Any]) -> str:
    certified, found = row["certified"], row["oscillates"]
    word = "as above" if certified is None else "yes" if certified else "no"
    growing = "" if found is None else f"; {found['frequency']:.3g} Hz grows with {found['payload']:g} kg"
    return word + growing


def _one(value: float | None, scale: float, never: str) -> str:
    if value is None:
        return never
    value *= scale
    return f"{value:.0f}" if value >= 100 else f"{value:.2g}" if value >= 1e-3 else "0"


def _pair(values: list[float | None], scale: float, never: str = "diverges") -> str:
    return " / ".join(_one(value, scale, never) for value in values)


def write_document(result: Mapping[str, Any], docs: Path) -> None:
    """Puts the tables into rivals.md and draws images/rivals-arms.png."""
    path = docs / "rivals.md"
    text = path.read_text(encoding="utf-8")
    before, rest = text.split(BEGIN)
    _, after = rest.split(END)
    path.write_text(before + document(result) + after, encoding="utf-8")
    draw(result, docs / "images" / "rivals-arms.png")


def draw(result: Mapping[str, Any], path: Path) -> None:
    """How far the worst joint gets: 5 to 95 %, 25 to 75 % and median of all runs, per brake and arm."""
    from matplotlib.ticker import FuncFormatter

    from dashpot.support.plots import BLUE, GREY, VERMILLION, new_figure, save

    arms = list(dict.fromkeys(row["arm"] for row in result["brakes"]))
    figure, axes = new_figure(1, len(arms), 12.0, 3.6, sharey=True)
    for axis, arm in zip(axes[0], arms, strict=True):
        rows = [row for row in result["brakes"] if row["arm"] == arm]
        for i, row in enumerate(rows):
            if "refused" in row:
                continue
            low, quarter, median, most, high = (
                math.nan if value is None else math.degrees(value) for value in row["stop_angle_quantiles"]
            )
            ours, bound = row["name"].startswith("virtual"), row["name"].startswith("encoder")
            colour = VERMILLION if ours else GREY if bound else BLUE
            axis.plot([low, high], [i, i], color=colour, lw=1.2, solid_capstyle="butt")
            axis.plot([quarter, most], [i, i], color=colour, lw=6, alpha=0.45, solid_capstyle="butt")
            axis.plot([median], [i], "D" if ours else "s" if bound else "o", color=colour, ms=5)
        axis.set_xscale("log")
        axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_title(SHORT[arm])
        axis.set_xlabel("stop angle of the worst joint [deg]")
        axis.grid(axis="y", visible=False)
    names = [row["name"] for row in result["brakes"] if row["arm"] == arms[0]]
    axes[0][0].set_yticks(range(len(names)), names)
    axes[0][0].set_ylim(len(names) - 0.5, -0.5)
    save(figure, path, pdf=False)
