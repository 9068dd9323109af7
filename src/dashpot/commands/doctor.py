"""``dashpot doctor``: what works on this machine, and what every missing part is needed for."""

from __future__ import annotations

import importlib.metadata as metadata
import json
import platform
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Literal

from packaging.requirements import Requirement
from rich.console import Console
from rich.markup import escape

from dashpot.commands.shared import bare_table, verdict
from dashpot.support.installing import install
from dashpot.support.waiting import waiting

if TYPE_CHECKING:
    from dashpot.cli.install import Doctor

State = Literal["ok", "missing", "broken", "could be better"]
COLOURS: dict[State, str] = {"ok": "green", "missing": "yellow", "broken": "red", "could be better": "yellow"}
EXTRAS = {
    "campaign": "dashpot campaign, replay and report need",
    "logs": "Parquet and MCAP logs (identify, plot, run --log) need",
    "studio": "dashpot studio needs",
    "franka": "dashpot run --via franka needs",
}
"""What needs the extras for users."""
SECONDS = 0.2  # of the arm that is simulated
PRIORITY = 80  # as of dashpot run
SAME = 1e-9  # [rad] between the engines


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at.

    Attributes:
        part: "core", or what it belongs to.
        name: Of the thing.
        state: What is the matter with it.
        found: What there is.
        advice: What it is needed for, and how to get it; "" where nothing is to be done.
    """

    part: str
    name: str
    state: State
    found: str
    advice: str = ""


def doctor(options: Doctor) -> int:
    """Prints the findings; arguments as of the command."""
    with waiting("looking"):
        found = [*core(), *extras(), *tools(), *realtime()]
        if all(one.state == "ok" for one in found if one.part == "core"):
            found.insert(sum(one.part == "core" for one in found), works())
    sound = all(one.state == "ok" for one in found if one.part == "core")
    if options.json:
        print(json.dumps({"works": sound, "findings": [asdict(one) for one in found]}, indent=1))
        return 0 if sound else 1
    console = Console(highlight=False)
    table = bare_table(f"dashpot {metadata.version('dashpot')}, {sys.prefix}")
    for column in ("for", "what", "", "found"):
        table.add_column(column, overflow="fold")
    part = ""
    for one in found:
        table.add_row(
            escape(one.part) if one.part != part else "",
            escape(one.name),
            f"[{COLOURS[one.state]}]{one.state}[/]",
            escape(one.found),
        )
        part = one.part
    console.print(table)
    console.print()
    together: dict[tuple[str, State, str], list[str]] = {}  # what is mended by the same command
    for one in found:
        if one.advice:
            together.setdefault((one.part, one.state, one.advice), []).append(one.name)
    for (part, state, advice), names in together.items():
        what = escape(f"{part} ({', '.join(names)})")
        console.print(f"[{COLOURS[state]}]{what}[/]: {escape(advice)}", soft_wrap=True)
    if together:
        console.print()
    if sound:
        console.print(verdict(True, "dashpot works here"))
    else:
        console.print(f"{verdict(False, 'dashpot does not work here')}: see what is broken above")
    return 0 if sound else 1


def core() -> Iterator[Finding]:
    """Python, the native library, and the packages that everything needs, of the versions asked for."""
    system = f"{platform.python_version()}, {platform.machine()} {platform.system()}"
    yield Finding("core", "Python", "ok", system)
    try:
        import dashpot._native as native
        from dashpot.support.workers import cores
    except ImportError as error:
        advice = (
            "install dashpot again, from where it came: a wheel of this Python and machine, or its sources"
        )
        yield Finding("core", "native library", "broken", str(error), advice)
    else:
        vectors = ", ".join(native.LANES.values())
        yield Finding("core", "native library", "ok", f"vectors: {vectors}; {cores()} cores")
    for one in _asked():
        if "extra" not in str(one.marker) and (one.marker is None or one.marker.evaluate()):
            yield _package("core", one, "broken", install())


def extras() -> Iterator[Finding]:
    """Packages of the extras."""
    for extra, use in EXTRAS.items():
        for one in _asked():
            rule, found, _ = str(one.marker).replace("'", '"').partition(f'extra == "{extra}"')
            if one.marker is None or not found:
                continue
            if one.marker.evaluate({"extra": extra}):
                yield _package(extra, one, "missing", f"{use} it: {install(extra)}")
            else:
                rule = rule.removesuffix(" and ").strip()
                yield Finding(extra, one.name, "missing", "not for this Python or machine", f"{use} {rule}")


def _asked() -> list[Requirement]:
    return [Requirement(text) for text in metadata.requires("dashpot") or []]


def _package(part: str, asked: Requirement, lack: State, advice: str) -> Finding:
    try:
        version = metadata.version(asked.name)
    except metadata.PackageNotFoundError:
        return Finding(part, asked.name, lack, f"not installed; needs {_bounds(asked)}", advice)
    if asked.specifier.contains(version, prereleases=True):
        return Finding(part, asked.name, "ok", version)
    return Finding(part, asked.name, lack, f"{version}; needs {_bounds(asked)}", advice)


def _bounds(asked: Requirement) -> str:
    """Lowest version first."""
    return ", ".join(sorted(map(str, asked.specifier), reverse=True))


def tools() -> Iterator[Finding]:
    """The compiler."""
    from dashpot.export.compiler import compiler

    found = compiler()
    if found is None:
        advice = "export --to fmu needs one for the binary (else --sources-only): install gcc or clang"
        yield Finding("export", "C compiler", "missing", "neither CC, cc, gcc nor clang", advice)
    else:
        yield Finding("export", "C compiler", "ok", " ".join(found))


def realtime() -> Iterator[Finding]:
    """What the operating system grants a control loop: asked for, and given back."""
    if platform.system() != "Linux":
        yield Finding(
            "run", "real time", "missing", platform.system(), "dashpot run keeps time on Linux only"
        )
        return
    from dashpot.hardware.realtime import undisturbed

    with undisturbed(PRIORITY) as measures:
        found = list(measures)
    for one in found:
        short, _, advice = one.said.partition(": ")
        if one.granted:
            yield Finding("run", one.name, "ok", one.said)
        else:
            yield Finding("run", one.name, "could be better", short, advice)


def works() -> Finding:
    """A short simulation of a bundled arm on both engines."""
    import numpy as np

    from dashpot import Controller, Robot, Scenario, build, hold, load_controller, run
    from dashpot.lanes import run_lanes

    try:
        robot, config = Robot.load("k807"), load_controller("k807-wrist")
        plant = build(robot, config.period, [])
        scenario = Scenario(
            plant, Controller.from_config(config, robot.drives), hold(robot.home, SECONDS, config.period)
        )
        first, second = run(scenario), run_lanes([scenario])[0]
    except Exception as error:  # whatever is the matter, it is said
        return Finding(
            "core", "simulation", "broken", f"{type(error).__name__}: {error}", "please report this"
        )
    apart = float(np.abs(first.link_position - second.link_position).max())
    if not apart <= SAME:
        return Finding(
            "core", "simulation", "broken", f"the engines differ by {apart:.2g} rad", "please report this"
        )
    return Finding("core", "simulation", "ok", f"k807, {SECONDS:g} s: both engines agree to {apart:.1g} rad")
