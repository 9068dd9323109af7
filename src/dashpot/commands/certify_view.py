"""Tables of ``dashpot certify``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from dashpot.arm.drive import Drive
from dashpot.certify.box import DRIVE
from dashpot.certify.certificate import DOCUMENT, STATEMENT, Certificate, JointCertificate
from dashpot.certify.testbench import hidden, suggested_tap
from dashpot.commands.shared import file_names, new_table, print_command, verdict
from dashpot.control.controller import Law
from dashpot.support.numbers import significant

if TYPE_CHECKING:
    from dashpot.cli.design import Certify

SLOWEST = 0.01  # [1/s] growth below which a simulation shows nothing in reasonable time
LEAST_SHOWN = 1e-3  # [Hz]
SHORT = {
    "rotor_inertia": "inertia",
    "viscous_friction": "friction",
    "stiffness": "stiffness",
    "damping": "damping",
}


def show(
    certificate: Certificate, pairs: list[tuple[Drive, Law]], options: Certify, out: Path | None
) -> None:
    """Prints verdicts, worst points, loads that oscillate, and what the certificate rests on."""
    console = Console()
    console.print(_table(certificate, options))
    console.print(
        "index: surplus of damping at the joint's port; worst: over the stated uncertainty, proven positive "
        "where certified; margin: worst index over that of the bare drive; as brake: without position loop",
        highlight=False,
        style="dim",
    )
    console.print()
    together: dict[str, list[str]] = {}  # joints with the same worst point
    for joint, (drive, _) in zip(certificate.joints, pairs, strict=True):
        where = point_text(joint.box.point, drive)
        if joint.certified or joint.nominal.passive:
            together.setdefault(where, []).append(escape(joint.name))
    for where, alike in together.items():
        console.print(f"{', '.join(alike)}: worst {where}", highlight=False)
    files = file_names([joint.name for joint in certificate.joints])
    alike_in: dict[tuple[str, ...], list[str]] = {}  # joints of which the same is to be said
    for joint, (drive, gains) in zip(certificate.joints, pairs, strict=True):
        if not joint.certified:
            alike_in.setdefault(_reasons(joint, drive, gains), []).append(joint.name)
    for joint, (drive, gains) in zip(certificate.joints, pairs, strict=True):
        same = [] if joint.certified else alike_in[_reasons(joint, drive, gains)]
        if same and same[0] == joint.name:
            _explain(console, same, joint, drive, gains, None if out is None else out / files[joint.name])
    if certificate.others:
        names = ", ".join(escape(name) for name in certificate.others)
        console.print(f"{names}: left to the robot's own position loop, taken to be passive", highlight=False)
    console.print()
    if certificate.certified:
        console.print(verdict(True, "certified"), highlight=False)
    else:
        failed = sum(not joint.certified for joint in certificate.joints)
        console.print(
            f"{verdict(False, 'not certified')}: {failed} of {len(certificate.joints)} joints",
            highlight=False,
        )
    if certificate.certified:
        console.print(STATEMENT, highlight=False, style="dim")
    else:
        console.print(f"What a certificate says and assumes: {DOCUMENT}", highlight=False, style="dim")
    if out is not None:
        pictures = out / f"{files[certificate.joints[0].name]}.png"
        more = " and so on" if len(certificate.joints) > 1 else ""
        console.print(f"open {escape(str(pictures))}{more}", highlight=False)


def _table(certificate: Certificate, options: Certify) -> Table:
    table = new_table(f"{certificate.robot} under {Path(options.controller).name}: index in N m s/rad")
    for name in ("index", "worst", "margin", "at [Hz]"):
        table.add_column(escape(name), justify="right", no_wrap=True)
    table.add_column("verdict", no_wrap=True)
    braked = any(joint.brake is not None for joint in certificate.joints)
    if braked:
        table.add_column("as brake", no_wrap=True)
        table.add_column("worst", justify="right", no_wrap=True)
    for joint in certificate.joints:
        shown = joint.box.worst if joint.nominal.passive else joint.nominal
        row = [
            escape(joint.name),
            number(joint.nominal.value),
            number(joint.box.worst.value),
            f"{significant(joint.margin, 2)} x" if math.isfinite(joint.margin) else "-",
            _frequency(shown.frequency) if math.isfinite(shown.value) else "-",
            "[green]certified[/]" if joint.certified else "[red]no[/]",
        ]
        if braked:
            brake = joint.brake
            if brake is None:
                row += ["-", "-"]
            else:
                proven = "[green]certified[/]" if brake.proven else "[red]no[/]"
                row += [proven, number(brake.worst.value)]
        table.add_row(*row)
    return table


def _reasons(joint: JointCertificate, drive: Drive, gains: Law) -> tuple[str, ...]:
    """All that is said of a joint that is not certified."""
    load = joint.counterexample
    if load is None:
        return (joint.reason,)
    return joint.reason, str(load), str(joint.nominal.passive), str(hidden(drive, gains, load))


def _explain(
    console: Console,
    names: list[str],
    joint: JointCertificate,
    drive: Drive,
    gains: Law,
    bench: Path | None,
) -> None:
    """Why joints are not certified, of which the first stands for all."""
    console.print(f"[red]{escape(', '.join(names))}[/]: {escape(joint.reason)}", highlight=False)
    load = joint.counterexample
    if load is None:
        console.print(
            "  of inertias, pendulums and inertias on springs none was found that oscillates", highlight=False
        )
        return
    console.print(
        f"  {escape(str(load))}" + (", at the worst point" if joint.nominal.passive else ""), highlight=False
    )
    if bench is not None and load.growth < SLOWEST:
        console.print("  too slow to see in the simulator", highlight=False, style="dim")
    elif bench is not None:
        how, tap = "", f"{suggested_tap(drive, load):.2g}"
        if hidden(drive, gains, load):
            how = " (without Coulomb friction, which hides growth this slow)"
        console.print(f"  see it{how}:", highlight=False, style="dim")
        files = f"{bench / 'robot.toml'} {bench / 'controller.toml'}"
        print_command(console, f"dashpot simulate {files} --motion hold --tap {float(tap):g}")


def number(value: float) -> str:
    """An index for people."""
    if not math.isfinite(value):
        return "unstable"
    return significant(value)


def _frequency(value: float) -> str:
    return f"{value:.3g}" if value >= LEAST_SHOWN else f"< {LEAST_SHOWN:g}"


def point_text(point: Mapping[str, float], drive: Drive) -> str:
    """A point of the box as departures from nominal: "inertia -15 %, torque gain +1 %"."""
    parts = []
    for name in DRIVE:
        nominal = getattr(drive, name)
        change = 100 * (point[name] / nominal - 1) if nominal else 0.0
        if abs(change) >= 0.05:
            parts.append(f"{SHORT[name]} {change:+.3g} %")
    for name in ("torque_gain", "position_gain"):
        change = 100 * (point[name] - 1)
        if abs(change) >= 0.005:
            parts.append(f"{name.replace('_', ' ')} {change:+.2g} %")
    parts.append(f"latency {point['latency']:g}")
    return "at nominal values, " + parts[0] if len(parts) == 1 else "at " + ", ".join(parts)
