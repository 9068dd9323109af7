"""What ``dashpot campaign`` prints: plan, progress, verdicts, failed scenarios."""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from dashpot.campaign.axes import Axis
from dashpot.campaign.judge import Case, Verdict
from dashpot.campaign.measures import MEASURES
from dashpot.campaign.requirements import Requirement
from dashpot.campaign.scenario import OK, Campaign
from dashpot.campaign.spec import Spec
from dashpot.campaign.store import Block
from dashpot.commands.shared import bare_table

LISTED = 10  # failed scenarios that are named
WIDTH = 110  # of tables that go to a file


class _Rate(ProgressColumn):
    """Scenarios per second."""

    def render(self, task: Task) -> Text:
        speed = task.finished_speed or task.speed
        return Text("" if speed is None else f"{speed:.3g}/s", style="progress.data.speed")


@contextmanager
def progress_bar(total: int, done: int) -> Iterator[Callable[[Block], None]]:
    """A bar on standard error, where that is a terminal; what it gives is called with every chunk."""
    columns = (TextColumn("scenarios"), BarColumn(), MofNCompleteColumn(), _Rate(), TimeRemainingColumn())
    failed = TextColumn("[red]{task.fields[failed]}[/]")
    console = Console(stderr=True)
    with Progress(*columns, failed, console=console, disable=not console.is_terminal, transient=True) as bar:
        task, lost = bar.add_task("", total=total, completed=done, failed=""), 0

        def advance(block: Block) -> None:
            nonlocal lost
            lost += int((block.status != OK).sum())
            bar.update(task, advance=len(block.status), failed=f"{lost} failed" if lost else "")

        yield advance


def console() -> Console:
    """Standard output; wide enough for tables where it is no terminal."""
    plain = Console()
    return plain if plain.is_terminal else Console(width=WIDTH)


def axis_words(axis: Axis) -> str:
    """An axis' values in short."""
    if axis.sampled:
        kind = "log-uniform" if axis.log else "uniform"
        return f"{axis.low:g} to {axis.high:g}, {kind}{', each joint its own' if axis.each_joint else ''}"
    labels = [value if isinstance(value, str) else f"{value:g}" for value in axis.labels]
    shown = labels if len(labels) <= 6 else [*labels[:3], "...", labels[-1]]
    return f"{len(labels)}: {', '.join(shown)}" if len(labels) > 1 else labels[0]


def show_plan(campaign: Campaign, out: Path, done: int) -> None:
    """Prints the axes."""
    spec = campaign.spec
    table = bare_table(f"{campaign.robot.name}: {spec.size} scenarios")
    for name in ("axis", "unit", "values"):
        table.add_column(name)
    for axis in spec.axes:
        table.add_row(escape(axis.name), axis.unit if axis.unit != "-" else "", escape(axis_words(axis)))
    screen = console()
    screen.print(table)
    if spec.sampled:
        kind = "Sobol" if spec.sample == "sobol" else "Latin hypercube"
        grid = math.prod(len(axis.values) for axis in spec.grid)
        with_grid = f" for each of {grid} grid points" if grid > 1 else ""
        points = "1 point" if spec.count == 1 else f"{spec.count} points"
        screen.print(f"{kind} of {points}, seed {spec.seed}{with_grid}", style="dim", highlight=False)
    if done:
        screen.print(f"{done} are done already in {escape(str(out))}", highlight=False)
    screen.print()


def amount(requirement: Requirement, value: float) -> str:
    """A measured value in the unit of its requirement."""
    if math.isnan(value):
        return "-"
    if math.isinf(value):
        return "never" if MEASURES[requirement.measure].unit == "s" else "-"
    return f"{value * requirement.factor:.3g}" + ("" if requirement.unit == "-" else f" {requirement.unit}")


def case_words(requirement: Requirement, case: Case) -> str:
    """A worst case in short."""
    value = "failed" if math.isnan(case.value) else amount(requirement, case.value)
    return f"#{case.index}{f' {case.joint}' if case.joint else ''}: {value}"


def show_results(
    spec: Spec, dataset: Any, verdicts: Sequence[Verdict], out: Path, *, reported: bool = False
) -> None:
    """Prints verdicts, failed scenarios and what to run next: no report where that has just been made."""
    screen = console()
    if verdicts:
        table = bare_table("Requirements")
        for name in ("", "requirement", "kept", "worst"):
            table.add_column(
                name, justify="right" if name == "kept" else "left", no_wrap=name in ("", "kept")
            )
        for verdict in verdicts:
            word = "[green]met[/]" if verdict.holds else "[red]not met[/]"
            kept = f"{100 * verdict.kept:.4g} %" if verdict.judged else "nothing to judge"
            worst = case_words(verdict.requirement, verdict.worst[0]) if verdict.worst else "-"
            table.add_row(word, escape(verdict.requirement.words), kept, escape(worst))
        screen.print(table)
        screen.print(
            "kept: share of the scenarios, of the joint where it is least", style="dim", highlight=False
        )
        screen.print()
    status = dataset["status"].values.ravel()
    lost = np.flatnonzero(status > OK)
    place = shlex.quote(str(out))
    if len(lost):
        reasons = dataset["reason"].values.ravel()
        seeds = _seeds(spec, dataset)
        screen.print(f"[red]{len(lost)} of {spec.size} scenarios failed[/]", highlight=False)
        for i in lost[:LISTED]:
            screen.print(
                f"  #{i}, seed {seeds[i]}: {escape(str(reasons[i]))}", highlight=False, soft_wrap=True
            )
        if len(lost) > LISTED:
            screen.print(
                f"  and {len(lost) - LISTED} more: status and reason in the dataset", highlight=False
            )
    first = lost[0] if len(lost) else next((v.worst[0].index for v in verdicts if not v.holds and v.worst), 0)
    following = [] if reported else [f"dashpot report {place}"]
    for i, command in enumerate([*following, f"dashpot replay {place} {first}"]):
        screen.print(f"{'      ' if i else 'next: '}{command}", highlight=False, soft_wrap=True)


def show_supervisor(campaign: Campaign) -> None:
    """Prints which settings of the supervisor were tried, where the controller's file says others."""
    tried = campaign.spec.supervisor or {}
    for name, config in campaign.configs.items():
        if any(getattr(config.supervisor, key) != value for key, value in tried.items()):
            words = ", ".join(f"{key} = {_setting(value)}" for key, value in tried.items())
            file = escape(str(name))
            console().print(
                f"Tried with supervisor = {{ {words} }}; it holds for {file} with the same under "
                "\\[supervisor].",
                style="dim",
                highlight=False,
                soft_wrap=True,
            )


def _setting(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else f"{value:g}"


def show_replay(values: Mapping[str, Any], done: bool, differ: Sequence[str]) -> None:
    """Prints what a scenario was about, and whether the dataset holds the same bits."""
    screen = console()
    about = ", ".join(f"{name} = {_short(value)}" for name, value in values.items())
    screen.print(escape(about), style="dim", highlight=False)
    if differ:
        screen.print(f"[red]differs from the dataset[/] in {', '.join(differ)}", highlight=False)
    elif done:
        screen.print("every measure has the same bits as in the dataset", highlight=False)
    else:
        screen.print("the campaign has not run it yet", highlight=False)


def _short(value: Any) -> str:
    if isinstance(value, list):
        return f"[{', '.join(f'{part:.4g}' for part in value)}]"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _seeds(spec: Spec, dataset: Any) -> Any:
    """Noise seed of every scenario."""
    if not spec.has("seed"):
        return np.zeros(spec.size, int)
    return dataset["seed"].broadcast_like(dataset["status"]).transpose(*spec.dims).values.ravel()
