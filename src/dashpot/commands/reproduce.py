"""``dashpot reproduce``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from dashpot.commands.shared import bare_table, verdict

if TYPE_CHECKING:
    from dashpot.paper.relations import Relation

from dashpot.simulation.engine import quiet_engine
from dashpot.support.limits import check_workers
from dashpot.support.waiting import waiting

FIGURES = {
    "fig4": "Fig. 4: tracking",
    "fig5": "Fig. 5: energy dissipation",
    "fig6": "Fig. 6: the two instabilities",
}


def reproduce(out: Path, seeds: int, threads: int | None) -> int:
    """``dashpot reproduce``; returns the exit status: 1 if a relation fails."""
    with waiting("starting"):
        from dashpot.paper.reproduction import reproduce as run_study

    check_workers(threads, "--threads")
    quiet_engine()
    relations, results = run_study(out, seeds, threads)
    console = Console()
    console.print(_relations_table(relations, seeds))
    console.print(_caption(relations), highlight=False, style="dim")
    console.print()
    failed = sum(not relation.holds for relation in relations)
    said = verdict(not failed, f"{failed} relations fail" if failed else "every relation holds")
    console.print(
        f"{said} ({results['seconds']:.0f} s); open {escape(str(out / 'report.html'))}", highlight=False
    )
    return 1 if failed else 0


def _caption(relations: list[Relation]) -> str:
    """How the values of each figure were put together."""
    together: dict[str, list[str]] = {}
    for figure, title in FIGURES.items():
        for judged in dict.fromkeys(one.judged for one in relations if one.figure == figure):
            together.setdefault(judged, []).append(title.partition(":")[0])
    parts = (f"the {judged} in {' and '.join(figures)}" for judged, figures in together.items())
    return f"value: of the joint or payload nearest to its limit; {', '.join(parts)}"


def _relations_table(relations: list[Relation], seeds: int) -> Table:
    """One row per relation: the value of the joint or payload nearest to failing, the range of them all."""
    table = bare_table(f"The paper's relations, {seeds} seeds each")
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
        mark = "[green]✓[/]" if all(relation.holds for relation in group) else "[red]✗[/]"
        table.add_row(
            f"{mark} {escape(text)}",
            f"{'>=' if least else '<='} {group[0].limit:g}",
            f"{worst:.2g}",
            f"{min(r.lowest for r in group):.2g}..{max(r.highest for r in group):.2g}",
        )
    return table
