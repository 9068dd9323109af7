"""The rooms of the package and what they import, read from the code, and drawn.

``python -m dashpot.studies.architecture PNG`` draws docs/images/architecture.png.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import dashpot
from dashpot.support.plots import BLUE, GREY, Figure, new_figure, save

NATIVE = "native C and C++"
COMMANDS = "cli, commands"
TOGETHER = {"cli": COMMANDS, "commands": COMMANDS, "errors": "support"}
"""Two halves of one room, and what is no room of its own."""
WIDE = 2.15  # from box to box
HOMES: dict[str, str] = vars(dashpot)["_HOMES"]
"""Public names, and the modules that they are from."""
WORDS = {
    "native C and C++": "controller step, supervisor,\nrunner, faults, vectorised arm",
    "support": "errors, TOML tables,\nfolders, plots, processes",
    "arm": "drives, robot,\npayload, plant",
    "control": "joint laws and rivals,\ncontroller, supervisor",
    "simulation": "scenarios, faults,\ntrajectories, recordings",
    "lanes": "the vectorised arm",
    "certify": "port passivity,\ncounterexamples",
    "logs": "CSV, Parquet, MCAP",
    "paper": "Figs. 4, 5, 6",
    "campaign": "axes, chunks,\nmeasures, verdicts",
    "design": "wishes to gains",
    "export": "C99, FMU",
    "hardware": "real-time loop,\nFranka, simulated robot",
    "identify": "logs to drives",
    "excite": "safe motions",
    "studio": "the arm in the browser",
    COMMANDS: "what can be typed,\nand what it does",
    "studies": "evidence, benchmarks' cases, pictures",
}


def imports(root: Path) -> dict[str, set[str]]:
    """Room -> rooms that its modules import, at once or later; not for types alone."""
    found: dict[str, set[str]] = {NATIVE: set()}
    for path in sorted(root.rglob("*.py")):
        room = _room(path.relative_to(root).with_suffix("").parts)
        if room is None:
            continue
        own = found.setdefault(room, set())
        for name in _imported(ast.parse(path.read_text())):
            parts = name.split(".")
            if parts[0] == "dashpot" and parts[-1] in HOMES and len(parts) == 2:  # public names
                parts = ["dashpot", *HOMES[parts[1]].split(".")]
            if parts[0] == "dashpot" and (other := _room(tuple(parts[1:]))) not in (None, room):
                own.add(str(other))
    return found


def _room(parts: tuple[str, ...]) -> str | None:
    if not parts or parts[0] in ("__init__", "__main__", "__version__"):
        return None  # the list of public names, and the command: they lead to the rooms
    if parts[0] == "_native":
        return NATIVE
    return TOGETHER.get(parts[0], parts[0])


def _imported(tree: ast.AST) -> Iterator[str]:
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        if isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                yield f"{node.module}.{alias.name}"
        elif isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.name
        yield from _imported(node)


def storeys(edges: Mapping[str, set[str]]) -> dict[str, int]:
    """Room -> how many rooms lie one upon the other below it.

    Raises:
        ValueError: Rooms import each other in a circle; says which.
    """
    found: dict[str, int] = {}

    def storey(room: str, path: tuple[str, ...]) -> int:
        if room in path:
            raise ValueError(" -> ".join((*path[path.index(room) :], room)))
        if room not in found:
            below = [storey(other, (*path, room)) for other in sorted(edges.get(room, ()))]
            found[room] = 1 + max(below) if below else 0
        return found[room]

    for room in sorted(edges):
        storey(room, ())
    return found


def reduced(edges: Mapping[str, set[str]]) -> dict[str, set[str]]:
    """The imports that do not follow from others: no room that is reached through another one."""

    def reach(room: str) -> set[str]:
        below = set(edges[room])
        for other in edges[room]:
            below |= reach(other)
        return below

    return {
        room: {o for o in to if not any(o in reach(via) for via in to - {o})} for room, to in edges.items()
    }


def draw(edges: Mapping[str, set[str]]) -> Figure:
    """The rooms, each above what it imports."""
    level = storeys(edges)
    rows: dict[int, list[str]] = {}
    for room, floor in level.items():
        rows.setdefault(floor, []).append(room)
    at: dict[str, tuple[float, float]] = {}
    straight = reduced(edges)
    for floor in sorted(rows):
        # Each above the middle of what it stands on.
        def middle(room: str) -> float:
            below = [at[other][0] for other in sorted(straight[room]) if other in at]
            return sum(below) / len(below) if below else 0.0

        row = sorted(rows[floor], key=lambda room: (middle(room), room))
        for i, room in enumerate(row):
            at[room] = (i - (len(row) - 1) / 2) * WIDE, 1.25 * floor
    figure, axes = new_figure(1, 1, 11.5, 1.05 * len(rows) + 0.4)
    axis = axes[0, 0]
    axis.set_axis_off()
    for room, to in straight.items():
        for other in sorted(to):
            past = level[room] - level[other] > 1
            _arrow(axis, at[room], at[other], len(rows[level[room] - 1]) if past else 0)
    for room, (x, y) in at.items():
        _box(axis, room, x, y)
    width = max(abs(x) for x, _ in at.values()) + 1.1
    axis.set_xlim(-width, width)
    axis.set_ylim(-0.6, max(y for _, y in at.values()) + 0.6)
    return figure


def _arrow(axis: Any, start: tuple[float, float], end: tuple[float, float], passed: int) -> None:
    """From a box to one below it; past a row of so many boxes through the gap that is nearest."""
    if passed:
        shift = 0.5 if passed % 2 else 0.0
        gap = WIDE * (round((start[0] + end[0]) / 2 / WIDE - shift) + shift)
        top, low = start[1] - 0.74, start[1] - 1.76
        axis.plot([start[0], gap, gap], [start[1] - 0.36, top, low], color=GREY, lw=0.8, zorder=1)
        start = gap, low + 0.36
    style = {"arrowstyle": "-|>", "color": GREY, "lw": 0.8, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 9}
    axis.annotate("", (end[0], end[1] + 0.36), (start[0], start[1] - 0.36), arrowprops=style, zorder=1)


def _box(axis: Any, room: str, x: float, y: float) -> None:
    from matplotlib.patches import FancyBboxPatch

    shape = "round,pad=0,rounding_size=0.08"
    axis.add_patch(
        FancyBboxPatch((x - 1.0, y - 0.36), 2.0, 0.72, shape, fc="white", ec=BLUE, lw=1.2, zorder=2)
    )
    axis.text(x, y + 0.17, room, ha="center", va="center", weight="bold", fontsize=9, zorder=3)
    axis.text(x, y - 0.12, WORDS[room], ha="center", va="center", fontsize=6.8, zorder=3, linespacing=1.15)


def main(arguments: list[str] | None = None) -> None:
    """Command line."""
    (target,) = sys.argv[1:] if arguments is None else arguments
    save(draw(imports(Path(dashpot.__file__).parent)), Path(target), pdf=False)


if __name__ == "__main__":
    main()
