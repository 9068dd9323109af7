"""``dashpot export``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from dashpot.arm.robot import Robot
from dashpot.certify.certificate import Certificate, certify_arm
from dashpot.commands.shared import check_place, progress, verdict
from dashpot.control.controller import Controller, ControllerConfig, load_controller
from dashpot.errors import InputError
from dashpot.export.c import Export as Exported
from dashpot.export.compiler import compiler
from dashpot.export.fmu import write_fmu
from dashpot.export.names import c_name
from dashpot.export.summary import verdict as stated
from dashpot.support.output import whole_folder
from dashpot.support.waiting import waiting

if TYPE_CHECKING:
    from dashpot.cli.deploy import Export


def export(options: Export) -> int:
    """``dashpot export``; returns the exit status: 1 unless every joint is certified."""
    for key, given in (("--fmi", options.fmi), ("--sources-only", options.sources_only)):
        if given and options.to == "c":
            raise InputError("is for --to fmu", quantity=key, value=given)
    robot, config = Robot.load(options.robot), load_controller(options.controller)
    name = c_name(options.controller, options.name)
    check_place(options.out, [robot.file, config.file])
    Controller.from_config(config, robot.drives)  # its complaints before minutes are spent
    certificate = None if options.without_certificate else _certificate(robot, config)
    settings = config.supervisor if options.supervised else None
    made = Exported(name, robot, config, certificate, settings, _ranges(robot, config) if settings else None)
    compiled = None
    with whole_folder(options.out) as folder:
        if options.to == "c":
            (folder / f"{name}.c").write_text(made.source(), encoding="ascii")
            (folder / f"{name}.h").write_text(made.header(), encoding="ascii")
        else:
            binary = not options.sources_only and compiler() is not None
            with waiting("compiling" if binary else "writing"):
                version: Literal[2, 3] = 2 if options.fmi == "2" else 3
                compiled = write_fmu(made, folder / f"{name}.fmu", version, binary=binary)
    _show(made, options, compiled)
    return 0 if certificate is not None and certificate.certified else 1


def _certificate(robot: Robot, config: ControllerConfig) -> Certificate:
    with progress("certifying", len(config.joints)) as advance:
        return certify_arm(robot, config, advance)


def _ranges(robot: Robot, config: ControllerConfig) -> dict[str, tuple[float, float]] | None:
    """The joints' ranges where the robot has a model; the supervisor checks encoders against them."""
    if robot.model is None:
        return None
    from dashpot.arm.plant import build
    from dashpot.simulation.prepare import encoder_ranges

    return encoder_ranges(build(robot, config.period))


def _show(made: Exported, options: Export, compiled: str | None) -> None:
    """What was written, whether it is certified, and how to use it."""
    console = Console()
    what = f"{made.robot.name} under {Path(options.controller).name}"
    kind = "C99" if options.to == "c" else f"FMI {options.fmi or '3'}.0 co-simulation"
    console.print(
        f"[bold]{escape(what)}[/] as {kind}{', supervised' if made.settings else ''}", highlight=False
    )
    good = made.certificate is not None and made.certificate.certified
    said, _, why = stated(made.certificate).partition(":")
    console.print(verdict(good, said.lower()) + (f":{escape(why)}" if why else ""), highlight=False)
    if made.settings is not None and made.limits is None:
        console.print("[yellow]no model: angles are not checked against the joints' ranges[/]")
    console.print()
    table = Table.grid(padding=(0, 3))
    table.add_column(style="dim", no_wrap=True)
    table.add_column(overflow="fold")
    for label, text in (_use_c if options.to == "c" else _use_fmu)(made, options, compiled):
        table.add_row(label, escape(text))
    console.print(table, highlight=False)


def _use_c(made: Exported, options: Export, _: str | None) -> list[tuple[str, str]]:
    name, files = made.name, [options.out / f"{made.name}.{ending}" for ending in "ch"]
    size = sum(file.stat().st_size for file in files) / 1024
    memory = f"{made.state_bytes} bytes of state"
    memory += " and the supervisor's" if made.settings else ""
    rows = [
        ("written", f"{files[0]} and {files[1].name}, {size:.0f} KiB of text"),
        ("memory", f"{memory}; {len(made.blocks)} x {made.blocks.itemsize} bytes of constants"),
        ("compile", f"cc -std=c99 -O2 -c {files[0]}"),
    ]
    if made.settings is None:
        rows += [("state", f"{name}_controller c;"), ("once", f"{name}_init(&c);")]
        rows += [(f"every {made.config.period * 1e3:g} ms", f"status = {name}_step(&c, in, out);")]
    else:
        state = f"{name}_controller c; {name}_supervisor s;"
        rows += [("state", state), ("once", f"{name}_init(&c); {name}_supervisor_init(&s);")]
        call = f"status = {name}_supervise(&s, &c, in, torque_age, encoder_age, out);"
        rows += [(f"every {made.config.period * 1e3:g} ms", call)]
    return [*rows, ("on a new target", f"{name}_check(&c) is 0 where every bit is as here")]


def _use_fmu(made: Exported, options: Export, compiled: str | None) -> list[tuple[str, str]]:
    file = options.out / f"{made.name}.fmu"
    binary = f"binary for {compiled}" if compiled else "no binary: the importing tool compiles the sources"
    return [
        ("written", f"{file}, {file.stat().st_size / 1024:.0f} KiB: sources, {binary}"),
        ("ticks", f"every {made.config.period * 1e3:g} ms, whatever the communication steps"),
        ("simulate", f"python -m fmpy simulate {file} --show-plot"),
    ]
