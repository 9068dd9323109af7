"""Table of ``dashpot identify``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.padding import Padding
from rich.table import Table

from dashpot.arm.drive import Drive
from dashpot.arm.robot import Robot
from dashpot.commands.identify import lacking
from dashpot.commands.shared import file_names, new_table, verdict
from dashpot.identify import DriveEstimate, Estimate
from dashpot.identify.writeback import too_wide
from dashpot.logs.log import Log

if TYPE_CHECKING:
    from dashpot.cli.identify import Identify

NAMES = {
    "rotor_inertia": "rotor inertia",
    "viscous_friction": "viscous friction",
    "coulomb_friction": "Coulomb friction",
    "stribeck_friction": "breakaway friction",
    "stribeck_velocity": "Stribeck velocity",
    "torque_bias": "sensor bias",
    "torque_scale_error": "sensor scale error",
    "latency": "latency",
    "stiffness": "stiffness",
    "damping": "damping",
}


def show(
    estimates: Sequence[DriveEstimate], robot: Robot, log: Log, options: Identify, written: Path | None
) -> None:
    """Prints the values with their intervals, what is refused and why, and what to do next."""
    console = Console()
    console.print(_table(estimates, robot, log, options))
    console.print(
        "interval: 95 %; was: in the robot file (latency: command_latency); all SI, link side of the gear",
        highlight=False,
        style="dim",
    )
    _refusals(console, estimates)
    console.print()
    missing = lacking(estimates)
    if missing:
        console.print(
            f"{verdict(False, 'refused')}: {_list(missing)}: "
            "the log does not tell their inertia and friction",
            highlight=False,
        )
    else:
        rest = ", but for what is refused above" if any(estimate.refused for estimate in estimates) else ""
        console.print(verdict(True, "identified") + rest, highlight=False)
    files = file_names([estimate.joint for estimate in estimates])
    drawn = [files[estimate.joint] for estimate in estimates if estimate.fit is not None]
    if drawn:
        more = " and so on" if len(drawn) > 1 else ""
        console.print(f"open {escape(str(options.out / drawn[0]))}.png{more}", highlight=False)
    if written is not None:
        shown = options.robot if options.in_place else str(written)
        console.print(f"next: dashpot certify {escape(shown)} CONTROLLER", highlight=False, soft_wrap=True)
    else:
        console.print(
            f"nothing to write; a motion that would do: dashpot excite {escape(options.robot)}",
            highlight=False,
        )


def _table(estimates: Sequence[DriveEstimate], robot: Robot, log: Log, options: Identify) -> Table:
    table = new_table(
        f"{robot.name} from {options.log.name}: {log.duration:.3g} s at {1 / log.period:.4g} Hz, "
        f"torque sampled as {log.sampling}"
    )
    table.add_column("quantity")
    for name in ("value", "interval", "was"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("unit", no_wrap=True)
    for estimate in estimates:
        drive = robot.drives[robot.index(estimate.joint)]
        first = escape(estimate.joint)
        refused = {key for refusal in estimate.refused for key in refusal.quantities}
        for key, name in NAMES.items():
            found = estimate.values.get(key)
            if found is None:
                if key in refused:
                    table.add_row(first, name, "[yellow]refused[/]", "", _was(drive, key), "")
                    first = ""
                continue
            value, interval = digits(found)
            table.add_row(
                first, name, value, interval, _was(drive, key), "" if found.unit == "-" else found.unit
            )
            first = ""
        table.add_section()
    return table


def digits(found: Estimate) -> tuple[str, str]:
    """Value and interval with as many digits as the interval is worth."""
    width = found.high - found.low
    if not (math.isfinite(width) and width > 0):
        return f"{found.value:.4g}", f"{found.low:.4g} {found.high:.4g}"
    places = max(0, 1 - math.floor(math.log10(width / 2)))
    if places > 7 or max(abs(found.low), abs(found.high)) >= 1e7:
        return f"{found.value:.3g}", f"{found.low:.3g} {found.high:.3g}"
    # + 0.0 turns a rounded minus zero into zero
    low, value, high = (round(x, places) + 0.0 for x in (found.low, found.value, found.high))
    return f"{value:.{places}f}", f"{low:.{places}f} {high:.{places}f}"


def old_value(drive: Drive, quantity: str) -> float | None:
    """What the robot file says; None where it says nothing."""
    value = drive.command_latency if quantity == "latency" else getattr(drive, quantity)
    if value is None or (quantity.startswith("stribeck") and value == 0):
        return None
    return float(value)


def _was(drive: Drive, quantity: str) -> str:
    value = old_value(drive, quantity)
    return "-" if value is None else f"{value:.4g}"


def _refusals(console: Console, estimates: Sequence[DriveEstimate]) -> None:
    """What is refused and why, joints with the same reason together, and what is not written."""
    together: dict[tuple[str, str, str], list[str]] = {}
    for estimate in estimates:
        for refusal in estimate.refused:
            what = ", ".join(NAMES.get(key, key) for key in refusal.quantities)
            together.setdefault((what, refusal.reason, refusal.motion), []).append(estimate.joint)
    for (what, reason, motion), joints in together.items():
        console.print()
        console.print(f"[yellow]{_list(joints)}[/]: {what} refused", highlight=False)
        for line in (reason, f"what would do: {motion}"):
            console.print(Padding(escape(line), (0, 0, 0, 2), expand=False), highlight=False)
    for estimate in estimates:
        why = too_wide(estimate)
        if why:
            console.print(
                f"[yellow]{escape(estimate.joint)}[/] is not written: {escape(why)}", highlight=False
            )


def _list(joints: Sequence[str] | dict[str, tuple[str, ...]]) -> str:
    return escape(", ".join(joints))
