"""Table and picture of ``dashpot excite``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.padding import Padding

from dashpot.commands.shared import new_table
from dashpot.excite import Excitation, JointMotion, Limits
from dashpot.excite.promise import CERTAIN_SCALE
from dashpot.support.plots import BLACK, BLUE, GREEN, GREY, VERMILLION, Figure, new_figure, top_legend

if TYPE_CHECKING:
    from dashpot.cli.identify import Excite

WIDE = 0.25  # relative half-width that is marked
TOLD = {
    "rotor_inertia": "m",
    "viscous_friction": "v",
    "coulomb_friction": "tau_c",
    "torque_scale_error": "scale",
}


def show(found: Excitation, limits: Limits, options: Excite) -> None:
    """Prints what the motion asks of each joint, what it promises, and what to do next."""
    console = Console()
    path = found.trajectory
    title = f"{found.robot.name}: {len(path.position) * path.period:.3g} s within {limits.speed:g} rad/s, "
    title += f"{limits.amplitude:g} rad of home, {100 * limits.torque_share:.0f} % of torque"
    table = new_table(title)
    for name in ("from to [rad]", "[rad/s]", "torque", *(f"{short} ±" for short in TOLD.values())):
        table.add_column(escape(name), justify="right", no_wrap=True)
    for joint in found.joints:
        row = ["at rest", "-"]
        if joint.promise is not None:
            row = [f"{joint.low:.2f} {joint.high:.2f}", f"{joint.speed:.2f}"]
        table.add_row(
            escape(joint.name), *row, f"{100 * joint.share:.0f} %", *(_width(joint, key) for key in TOLD)
        )
    console.print(table)
    heaviest = max(options.payload, default=0.0)
    console.print(
        "largest motor torque over its limit; half-widths of the 95 % intervals that dashpot identify gives "
        f"on this motion with {heaviest:g} kg, friction and sensors as in the robot file but twice the noise "
        "(m inertia, v viscous and tau_c Coulomb friction, scale of the torque sensor)",
        highlight=False,
        style="dim",
    )
    _refusals(console, found, options)
    console.print()
    console.print(
        "[yellow]self-collision and surroundings are not checked: look at the motion in simulation first[/]",
        highlight=False,
    )
    motion = options.out / "motion.csv"
    controller = escape(options.controller or "CONTROLLER")
    load = ""
    if heaviest > 0:
        load = f" --payload {heaviest:g} --offset {' '.join(f'{x:g}' for x in options.offset)}"
    console.print(f"seed {options.seed}; open {escape(str(options.out / 'motion.png'))}", highlight=False)
    console.print(
        f"next: dashpot simulate {escape(options.robot)} {controller}{load} --motion {escape(str(motion))} "
        "--log log.csv",
        highlight=False,
        soft_wrap=True,
    )


def _refusals(console: Console, found: Excitation, options: Excite) -> None:
    """What identify will or may refuse on this motion, and what would do instead."""
    together: dict[tuple[str, str, bool], list[str]] = {}
    for joint in found.joints:
        told = joint.promise
        if told is None or told.certain:
            continue
        if told.kept:
            reason = "told if the motion is followed exactly; vibration and sticking may hide so small a load"
            key = "may refuse", reason, True
        else:
            key = "will refuse", told.refused[0].reason, told.scale_needed
        together.setdefault(key, []).append(joint.name)
    for (verdict, reason, scale), joints in together.items():
        ways = ["a larger --amplitude, --speed or --duration"]
        if not options.payload:
            ways = ["a payload off the axis (--payload 1 --offset 0.1), here and on the robot", *ways]
        if scale:
            ways.append("the sensor's scale error given: dashpot identify --scale 0")
        console.print()
        console.print(
            f"[yellow]{escape(', '.join(joints))}[/]: dashpot identify {verdict} it"
            f"{'; the widths above are those with --scale 0' if verdict == 'will refuse' and scale else ''}",
            highlight=False,
        )
        for line in (reason, f"what would do: {'; or '.join(ways)}"):
            console.print(Padding(escape(line), (0, 0, 0, 2), expand=False), highlight=False)


def _width(joint: JointMotion, quantity: str) -> str:
    if joint.promise is None:
        return "-"
    value = joint.promise.half_widths.get(quantity)
    if value is None:
        asked = any(quantity in refusal.quantities for refusal in joint.promise.refused)
        return "[yellow]refused[/]" if asked else "-"
    text = f"{100 * value:.2g} %"
    limit = CERTAIN_SCALE if quantity == "torque_scale_error" else WIDE
    return f"[yellow]{text}[/]" if value > limit or joint.promise.scale_needed else text


def draw(found: Excitation, limits: Limits) -> Figure:
    """Position, speed and motor torque of every joint that moves against its limits."""
    moving = [j for j, joint in enumerate(found.joints) if joint.promise is not None]
    n = len(moving)
    figure, axes = new_figure(3, n, max(5.0, 2.3 * n + 0.6), 6.2, sharex=True)
    path = found.trajectory
    time = path.time - path.time[0]
    for place, j in enumerate(moving):
        joint, drive = found.joints[j], found.robot.drives[j]
        column = axes[:, place]
        column[0].plot(time, np.degrees(path.position[:, j]), color=BLUE, lw=1.0, label="position")
        _limits(column[0], np.degrees([joint.lower, joint.upper]))
        column[1].plot(time, path.velocity[:, j], color=GREEN, lw=0.8, label="speed")
        _limits(column[1], (-limits.speed, limits.speed))
        column[2].plot(found.torque_time, found.torque[:, j], color=VERMILLION, lw=0.8, label="motor torque")
        share = limits.torque_share * drive.torque_limit
        _limits(column[2], (-share, share))
        column[2].axhline(0, color=GREY, lw=0.6)
        column[0].set_title(joint.name, parse_math=False)
        column[2].set_xlabel("time [s]")
    for row, label in enumerate(("position [deg]", "speed [rad/s]", "motor torque [N m]")):
        axes[row, 0].set_ylabel(label)
    lines = [axes[row, 0].get_lines()[0] for row in range(3)] + [axes[0, 0].get_lines()[1]]
    names = ("position", "speed", "motor torque, worst payload", "limit")
    top_legend(figure, dict(zip(names, lines, strict=True)), f"{found.robot.name}: motion for identification")
    return figure


def _limits(axis: Any, values: Any) -> None:
    for value in values:
        axis.axhline(value, color=BLACK, lw=0.9, ls="--")
