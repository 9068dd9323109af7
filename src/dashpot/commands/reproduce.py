"""``dashpot reproduce``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

if TYPE_CHECKING:
    from dashpot.paper.relations import Relation

from dashpot.simulation.engine import quiet_engine
from dashpot.support.limits import check_workers

FIGURES = {
    "fig4": "Fig. 4: tracking",
    "fig5": "Fig. 5: energy dissipation",
    "fig6": "Fig. 6: the two instabilities",
}


def reproduce(out: Path, seeds: int, threads: int | None) -> int:
    """``dashpot reproduce``; returns the exit status: 1 if a relation fails."""
    from dashpot.paper.reproduction import reproduce as run_study

    check_workers(threads, "--threads")
    quiet_engine()
    relations, results = run_study(out, seeds, threads)
    console = Console()
    console.print(_relations_table(relations, seeds))
    failed = sum(not relation.holds for relation in relations)
    verdict = "[green]every relation holds[/]" if not failed else f"[bold red]{failed} relations fail[/]"
    console.print(
        f"{verdict} ({results['seconds']:.0f} s); open {escape(str(out / 'report.html'))}", highlight=False
    )
    return 1 if failed else 0


def _relations_table(relations: list[Relation], seeds: int) -> Table:
    """One row per relation: the value of the joint or payload nearest to failing, the range of them all."""
    table = Table(
        title=f"The paper's relations, {seeds} seeds each",
        title_justify="left",
        box=SIMPLE_HEAD,
        pad_edge=False,
    )
    table.add_column("relation", no_wrap=True)
    for name in ("limit", "value", "over seeds"):
        table.add_column(name, justify="right", no_wrap=True)
    groups: dict[tuple[str, str], list[Relation]] = {}
    for relation in relations:
        groups.setdefault((relation.figure, relation.text), []).append(relation)
    figure = ""
    for (this, text), group in groups.items():
        if this != figure:
            table.add_row(f"[bold]{FIGURES[this]}[/]")
            figure = this
        least = group[0].sense == "at least"
        worst = (min if least else max)(relation.value for relation in group)
        mark = "[green]✓[/]" if all(relation.holds for relation in group) else "[bold red]✗[/]"
        table.add_row(
            f"{mark} {escape(text)}",
            f"{'>=' if least else '<='} {group[0].limit:g}",
            f"{worst:.2g}",
            f"{min(r.lowest for r in group):.2g}..{max(r.highest for r in group):.2g}",
        )
    return table
