"""Checklist and report of ``dashpot run``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.markup import escape

from dashpot.commands.shared import bare_table, verdict
from dashpot.control.controller import Controller
from dashpot.hardware.checks import Check
from dashpot.hardware.realtime import Measure
from dashpot.hardware.runtime import Outcome

if TYPE_CHECKING:
    from dashpot.cli.deploy import Run

VERDICTS = {True: "[green]pass[/]", False: "[red]fail[/]", None: "[yellow]not checked[/]"}
ENDS = {
    "done": verdict(True, "done"),
    "stopped": "[bold]stopped[/]",
    "supervisor": "[bold yellow]stopped by the supervisor[/]",
    "robot": verdict(False, "ended by the robot"),
    "failed": verdict(False, "failed"),
}
BEST = (0.5, 0.99, 0.999)  # quantiles of the jitter


def show_checks(checks: Sequence[Check], options: Run) -> None:
    """Prints the checklist and its verdict."""
    console = Console()
    where = f" at {options.host}" if options.host else ""
    table = bare_table(
        f"{Path(options.robot).name} under {Path(options.controller).name}, via {options.via}{where}"
    )
    for name in ("check", "joint"):
        table.add_column(name, no_wrap=True)
    for name in ("value", "asked for"):
        table.add_column(name)
    table.add_column("verdict", no_wrap=True)
    for check in checks:
        row = (check.name, check.joint, check.value, check.bound)
        table.add_row(*(escape(text) for text in row), VERDICTS[check.passed])
    console.print(table)
    console.print("the joint named is the one nearest to its bound", highlight=False, style="dim")
    failed = [check.name for check in checks if check.passed is False]
    if failed or options.check:
        console.print()
    if failed:
        console.print(
            f"{verdict(False, 'no torque is sent')}: {len(failed)} of {len(checks)} checks fail",
            highlight=False,
        )
        if any(name.startswith("certificate") for name in failed):
            console.print(
                f"look at it: dashpot certify {escape(options.robot)} {escape(options.controller)}; "
                "run without a certificate: --uncertified",
                highlight=False,
                soft_wrap=True,
                style="dim",
            )
    elif options.check:
        console.print(f"{verdict(True, 'ready')}: no torque was sent", highlight=False)


def show_measures(console: Console, measures: Sequence[Measure]) -> None:
    """Prints what the operating system granted, one line each."""
    for measure in measures:
        colour = "green" if measure.granted else "yellow"
        console.print(f"[{colour}]{measure.name}[/]: {escape(measure.said)}", highlight=False, soft_wrap=True)


def quantiles(jitter: NDArray[np.int64]) -> list[float]:
    """Upper bounds of the quantiles `BEST` of a histogram with bins of 1 us [us]; NaN: it is empty."""
    total = jitter.sum()
    if total == 0:
        return [float("nan")] * len(BEST)
    reached = np.cumsum(jitter) / total
    return [float(np.searchsorted(reached, share) + 1) for share in BEST]


def show_outcome(outcome: Outcome, controller: Controller, options: Run) -> None:
    """Prints how the run ended, what the supervisor decided, and how punctual the loop was."""
    console = Console()
    console.print()
    if outcome.measures:
        show_measures(console, outcome.measures)
        console.print()
    if outcome.decisions:
        table = bare_table("What the supervisor decided")
        table.add_column("at [s]".replace("[", r"\["), justify="right")
        for name in ("joint", "from", "to"):
            table.add_column(name, no_wrap=True)
        table.add_column("why")
        for decision in outcome.decisions:
            size = (
                f" ({decision.value:.3g} {decision.unit}, limit {decision.threshold:.3g})"
                if decision.unit
                else ""
            )
            table.add_row(
                f"{decision.time:.3f}",
                escape(decision.joint or "all"),
                decision.before.replace("_", " "),
                decision.after.replace("_", " "),
                escape(decision.words + size),
            )
        console.print(table)
        console.print()
    statistics: dict[str, Any] = outcome.statistics
    cycles = statistics["cycles"]
    said = f"{cycles} cycles of {1e3 * controller.period:g} ms, {statistics['late']} late"
    if statistics["late"]:
        said += f" ({statistics['lost']} ticks lost, {statistics['longest']} at once)"
    if not options.lock_step and cycles > 1:
        half, most, nearly = quantiles(statistics["jitter"])
        said += f"; jitter 50 % {half:.0f} us, 99 % {most:.0f} us, 99.9 % {nearly:.0f} us"
        said += f", most {1e6 * statistics['jitter_most']:.0f} us"
    said += f"; native cycle {1e6 * statistics['step_mean']:.2g} us"
    console.print(said, highlight=False, style="dim", soft_wrap=True)
    rest = ""
    if outcome.end in ("done", "stopped", "supervisor") and outcome.state == "safe":
        rest = "; braked to rest, " if outcome.braked else "; "
        rest += "motors off, mechanical brakes closed"
    elif outcome.end != "done":
        rest = "; motors off, mechanical brakes told to close"
    reason = f": {escape(outcome.reason)}" if outcome.reason and outcome.end != "done" else ""
    console.print(f"{ENDS[outcome.end]}{reason}{rest}", highlight=False, soft_wrap=True)
    for problem in outcome.problems:
        console.print(f"[red]while stopping[/]: {escape(problem)}", highlight=False, soft_wrap=True)
    if options.log is not None and options.log.exists():
        console.print(f"log: {escape(str(options.log))}", highlight=False, soft_wrap=True)
