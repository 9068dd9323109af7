"""Tables of ``dashpot design``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from dashpot.arm.robot import Robot
from dashpot.commands.shared import new_table, verdict
from dashpot.design.design import Design, JointDesign
from dashpot.design.quantities import (
    GAINS,
    QUANTITIES,
    binding_text,
    predicted_text,
)
from dashpot.design.words import assumptions, conflict_lines, sinking
from dashpot.support.numbers import significant

if TYPE_CHECKING:
    from dashpot.cli.design import Design as Options
    from dashpot.design.candidates import Duty

COLUMNS = ("stop_time", "travel", "hold", "creep", "load_error", "error_ratio", "noise", "damping_ratio")
"""Of the table of predictions; authority is in the report."""
SLIGHT = 0.01  # [N m] of weight


def show(result: Design, needed: Sequence[Duty], robot: Robot, options: Options) -> None:
    """Prints gains, predictions, conflicts, assumptions and what to run next."""
    console = Console()
    done = [joint for joint in result.joints if joint.found is not None]
    if done:
        console.print(_gains(result, done))
        console.print()
        console.print(_predictions(result, done))
        console.print(
            "predicted with the drive as stated; limits are kept with the weakest torque channel it states "
            "(report). margin: worst index over that of the drive alone",
            highlight=False,
            style="dim",
        )
        console.print()
    if note := sinking(result):
        console.print(f"[yellow]{escape(note)}[/]", highlight=False)
        console.print()
    for joint in result.joints:
        if joint.conflict is not None:
            console.print(
                f"[red]{escape(joint.name)}[/]: {escape(conflict_lines(joint)[0])}", highlight=False
            )
            for line in conflict_lines(joint)[1:]:
                console.print(f"  {escape(line)}", highlight=False)
    if not result.feasible:
        console.print()
    console.print(f"Assumed: {escape(assumptions(result, needed[0]))}.", highlight=False, style="dim")
    if result.spec.gravity_compensated and sinks(robot, needed[0].period):
        console.print(
            f"That it carries its own weight is not in {escape(str(robot.file))} (gravity_compensation = "
            "true), which dashpot simulate goes by. If it does not: --gravity-compensated no",
            highlight=False,
            style="dim",
            soft_wrap=True,
        )
    console.print()
    _end(console, result, robot, options)


def sinks(robot: Robot, period: float) -> bool:
    """Whether the arm weighs on its joints, at home, and does not say that it carries that itself."""
    if robot.model is None or robot.gravity_compensation:
        return False
    from dashpot.arm.plant import build

    return bool(np.abs(build(robot, period).load_torque(np.array(robot.home))).max() > SLIGHT)


def _end(console: Console, result: Design, robot: Robot, options: Options) -> None:
    out = options.out
    if not result.feasible:
        failed = sum(joint.found is None for joint in result.joints)
        console.print(
            f"{verdict(False, 'no design')}: {failed} of {len(result.joints)} joints have no certified "
            "gains; no controller is written",
            highlight=False,
        )
        console.print(f"open {escape(str(out / 'report.html'))}", highlight=False)
        return
    console.print(verdict(True, "every joint certified"), highlight=False)
    name, controller = escape(options.robot), escape(str(out / "controller.toml"))
    commands = [f"open {escape(str(out / 'report.html'))}", f"dashpot certify {name} {controller}"]
    designed = {joint.name for joint in result.joints}
    bare = [drive.name for drive in robot.drives if drive.servo is None and drive.name not in designed]
    if robot.model is not None and not bare:
        spec, load = result.spec, ""
        if spec.payload > 0:
            load = f" --payload {spec.payload:g}"
            if any(spec.offset):
                load += " --offset " + " ".join(f"{part:g}" for part in spec.offset)
        release = " --release 3" if spec.loop else ""
        commands.append(f"dashpot simulate {name} {controller}{load}{release}")
    for command in commands:
        console.print(command, highlight=False, soft_wrap=True)
    if bare:
        rule = f"not yet to be simulated: {', '.join(bare)} without a controller or a servo; design them, too"
        console.print(escape(rule), highlight=False, soft_wrap=True)


def _gains(result: Design, done: Sequence[JointDesign]) -> Table:
    spec = result.spec
    table = new_table(f"{result.robot}: gains ({spec.preset if spec.file is None else spec.file.name})")
    for name in (*GAINS, "margin"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("limited by")
    for joint in done:
        assert joint.found is not None
        gains = joint.found.gains.joint(joint.name)
        names = [
            binding_text(name, joint.wishes.limits, joint.wishes.margin).replace(" of limit", "")
            for name in joint.found.binding
        ]
        table.add_row(
            escape(joint.name),
            *(f"{getattr(gains, name):g}" for name in GAINS),
            significant(joint.found.margin, 2),
            escape(", ".join(names)) or "nothing: best there is",
        )
    return table


def _predictions(result: Design, done: Sequence[JointDesign]) -> Table:
    columns = [name for name in COLUMNS if name in done[0].predicted]
    if not any(joint.predicted["creep"] for joint in done):
        columns.remove("creep")
    table = new_table("predicted")
    for name in columns:
        quantity = QUANTITIES[name]
        unit = quantity.unit.replace("% of limit", "%")
        table.add_column(escape(f"{quantity.head}\n[{unit or '-'}]"), justify="right", no_wrap=True)
    for joint in done:
        table.add_row(escape(joint.name), *(predicted_text(joint, name) for name in columns))
    return table
