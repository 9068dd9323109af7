"""``dashpot franka-server``."""

from __future__ import annotations

import os
import signal
import threading
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape

from dashpot.arm.robot import Robot
from dashpot.commands.payload import payload_of
from dashpot.commands.shared import bare_table, check_file_place, of_flags
from dashpot.commands.simulate_faults import of_faults, read_changes, read_faults
from dashpot.errors import InputError
from dashpot.hardware.franka_server.arm import Arm
from dashpot.hardware.franka_server.limits import FR3
from dashpot.hardware.franka_server.server import Server
from dashpot.simulation.engine import quiet_engine
from dashpot.support.limits import check_seed

if TYPE_CHECKING:
    from dashpot.cli.deploy import FrankaServer

PRIORITY = 60  # of the real-time scheduler, where it may be had


def franka_server(options: FrankaServer) -> int:
    """``dashpot franka-server``; returns the exit status: 0 also where a client was stopped by a reflex."""
    if options.robot == "panda":
        raise InputError(
            "no such arm: the Panda's system speaks version 5 of the protocol, which pylibfranka does not; "
            "its torque limits are the FR3's, 87 and 12 N m",
            quantity="--robot",
            value=options.robot,
        )
    if options.log is not None and options.log.suffix != ".npz":
        raise InputError("must end in .npz", quantity="--log", value=str(options.log))
    if options.log is not None:
        check_file_place(options.log, "--log")
    check_seed(options.seed)
    quiet_engine()
    payload = payload_of(options.payload, options.offset)
    robot = Robot.load(options.robot)
    console = Console(highlight=False, soft_wrap=True)
    with of_faults(), of_flags({"friction compensation [-]": "--friction"}):
        arm = Arm(
            robot,
            payload,
            faults=read_faults(options.fault, robot),
            payload_changes=read_changes(options.payload_at, payload),
            seed=options.seed,
            friction=options.friction,
            record=options.log is not None,
        )

    def say(line: str) -> None:
        console.print(escape(line))

    server = Server(
        arm, FR3, host=options.host, lock_step=options.lock_step, enforce=not options.forgiving, say=say
    )
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: server.stop())
    # In lock-step it answers whatever is asked at once: with priority over its client it would starve it.
    pace = "in lock-step with its client" if options.lock_step else f"at 1 kHz{_hurry()}"
    host, port = server.address
    load = f"{options.payload:g} kg" if options.payload else "nothing"
    say(f"{arm.robot.name} with {load} on its flange, listening at {host}:{port}, {pace}; Ctrl-C ends")
    try:
        server.serve()
    finally:
        _show(console, server)
        if options.log is not None:
            if server.tally.motions:
                recording = arm.recording()
                recording.settings["reflexes"] = list(server.tally.reflexes)
                say(f"what was true since the first motion: {recording.save(options.log)}")
            else:
                say(f"no motion: {options.log} not written")
    return 0


def _hurry() -> str:
    """Asks for real-time scheduling; says so where it is refused."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except (AttributeError, OSError):
        return " without real-time priority, which this user may not have"
    return ""


def _show(console: Console, server: Server) -> None:
    tally = server.tally
    table = bare_table("served")
    for name in ("motions", "cycles", "lost packets", "most in a row", "server late"):
        table.add_column(name, justify="right")
    table.add_column("reflexes", overflow="fold")
    share = f" ({100 * tally.lost / tally.cycles:.2g} %)" if tally.lost else ""
    cells = (tally.motions, tally.cycles, f"{tally.lost}{share}", tally.longest, tally.late)
    table.add_row(*(str(cell) for cell in cells), escape("; ".join(tally.reflexes)) or "none")
    console.print(table)
