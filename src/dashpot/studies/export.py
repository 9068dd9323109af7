"""Whether exported controllers are equal to the one in Python, on the host and on an emulated Cortex-M.

    make evidence-export

Prints JSON for docs/evidence/export.json; docs/export.md has its figures, the tests repeat a part.
"""

from __future__ import annotations

import json
import subprocess
import sys
import warnings
from collections.abc import Iterable, Mapping
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

from dashpot.errors import InputWarning
from dashpot.export.c import Export
from dashpot.studies import cortex, export_cases
from dashpot.studies.export_cases import (
    BUNDLED,
    all_laws,
    build,
    bundled,
    compiled,
    differing,
    in_python,
    script,
)

SAMPLES = 1_000_000  # of single joints, at least, per controller
AT_ONCE = 50_000  # ticks of a script
COUNTED = 100  # ticks of which the instructions are counted
FUSED = ("-O3", "-march=native", "-ffp-contract=fast")
GUARD = '#pragma GCC optimize("fp-contract=off")'


def cases() -> list[tuple[Export, int]]:
    """Exports, and how many scripts of `AT_ONCE` ticks make at least `SAMPLES` of each."""
    exports = [
        all_laws(),
        all_laws(3, "explicit"),
        all_laws(2, supervised=True),
        *(bundled(*names) for names in BUNDLED),
        bundled("fr3", "fr3", supervised=True),
    ]
    return [(export, -(-SAMPLES // (AT_ONCE * len(export.blocks)))) for export in exports]


def on_host(export: Export, scripts: int, ticks: int, first_seed: int = 0) -> dict[str, Any]:
    """Compares the host's builds with Python, tick by tick: optimised, and under sanitizers."""
    found: dict[str, Any] = {"ticks": 0, "differing": 0, "sanitized_ticks": 0, "sanitized_differing": 0}
    with TemporaryDirectory() as name:
        plain = build(export, Path(name))
        watched = build(export, Path(name), ("-O1", *export_cases.SANITIZED), "sanitized")
        for seed in range(first_seed, first_seed + scripts):
            rows = script(export, ticks, seed)
            expected = in_python(export, rows)
            found["ticks"] += ticks
            found["differing"] += _differing(expected, compiled(plain, export, rows))
            if seed == first_seed:
                part = rows[: ticks // 5]
                found["sanitized_ticks"] = len(part)
                found["sanitized_differing"] = _differing(
                    expected[: len(part)], compiled(watched, export, part)
                )
        rows, expected = rows[: ticks // 5], expected[: ticks // 5]
        fused = compiled(build(export, Path(name), FUSED, "fused"), export, rows)
        found["contraction_asked_for"] = {"ticks": len(rows), "differing": _differing(expected, fused)}
        found["guard_removed"] = unguarded(export, Path(name))
    return found


def unguarded(export: Export, folder: Path) -> str:
    """What the export's own check says where the pragma is taken out and contraction asked for."""
    arguments = export_cases.write_sources(export, folder)
    source = folder / f"{export.name}.c"
    text = source.read_text(encoding="ascii")
    if GUARD not in text:
        raise RuntimeError("the guard against contraction has another form")
    source.write_text(text.replace(GUARD, ""), encoding="ascii")
    program = folder / "unguarded"
    subprocess.run(
        [
            "cc",
            "-std=gnu99",
            *FUSED,
            "-DHOST",
            *arguments,
            str(source),
            str(folder / "export_drive.c"),
            "-o",
            program,
        ],
        check=True,
    )
    return (
        "found by the check" if compiled(program, export, script(export, 1, 0)) is None else "no difference"
    )


def on_target(export: Export, core: str, ticks: int, seed: int = 0) -> dict[str, Any]:
    """The same on an emulated Cortex-M, with sizes and instructions per tick."""
    joints = len(export.blocks)
    with TemporaryDirectory() as name:
        image = cortex.build(export, Path(name), core)
        size = cortex.size(Path(name), export)
        board = cortex.Board(image)
        checked = board.call("start")
        rows = script(export, ticks, seed)
        different = differing(in_python(export, rows), board.run(rows, joints))
        counts = cortex.instructions(image, rows[: min(COUNTED, ticks)], joints)
    return {
        "check": checked,
        "ticks": ticks,
        "differing": different,
        "code_bytes": size.code,
        "constant_bytes": size.constants,
        "variable_bytes": size.variables,
        "instructions": {"least": min(counts), "median": median(counts), "most": max(counts)},
    }


def _differing(expected: Any, found: Any) -> int:
    return len(expected) if found is None or len(found) != len(expected) else differing(expected, found)


def table(rows: Iterable[Mapping[str, Any]]) -> list[str]:
    """The lines of the tables of docs/export.md, made from the evidence."""
    equal, sizes = [], []
    for row in rows:
        host, board = row["host"], row["cortex_m7"]
        name = "all 13 laws" if row["controller"] == "laws" else f"`{row['controller']}`"
        name += f", latency {row['latency']}" if row["latency"] else ""
        name += ", supervised" if row["supervised"] else ""
        n = row["joints"]
        counts = [n * x for x in (host["ticks"], host["sanitized_ticks"], board["ticks"])]
        wrong = host["differing"] + host["sanitized_differing"] + board["differing"]
        equal.append(f"| {name} | {n} | {counts[0]:,} | {counts[1]:,} | {counts[2]:,} | {wrong} |")
        for core, label in (("cortex_m7", "M7"), ("cortex_m4f", "M4F")):
            if core in row:
                said, steps = row[core], row[core]["instructions"]
                size = f"{said['code_bytes'] / 1024:.1f} | {said['constant_bytes'] / 1024:.1f}"
                each = f"{steps['least']:,} | {steps['median']:,.0f} | {steps['most']:,}"
                sizes.append(f"| {name} | {n} | {label} | {size} | {each} |")
    return equal + sizes


def main() -> None:
    """Prints the evidence as JSON."""
    warnings.simplefilter("ignore", InputWarning)
    rows = []
    for export, scripts in cases():
        config = export.config
        row: dict[str, Any] = {
            "controller": export.name,
            "joints": len(export.blocks),
            "latency": config.latency,
            "form": config.form,
            "supervised": export.settings is not None,
            "state_bytes": export.state_bytes,
            "host": on_host(export, scripts, AT_ONCE),
            "cortex_m7": on_target(export, "m7", 5_000),
        }
        if export.name == "fr3":
            row["cortex_m4f"] = on_target(export, "m4f", 500)
        rows.append(row)
        print(f"{len(rows)} of {len(cases())}", file=sys.stderr)
    print(json.dumps({"seeds": "0, 1, ... per script", "cases": rows}, indent=1))


if __name__ == "__main__":
    main()
