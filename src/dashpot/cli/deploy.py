"""To the robot: ``run``, ``export``, ``franka-server``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from dashpot.cli.arguments import (
    ControllerFile,
    Faults,
    Flag,
    Folder,
    Mass,
    Number,
    Offset,
    PayloadChanges,
    RobotFile,
)
from dashpot.support.waiting import waiting


@dataclass
class Run:
    """Run a controller on a robot, in real time and under the supervisor (docs/hardware.md).

    Example: dashpot run fr3 fr3 --duration 5 --log run.mcap

    Limits, rates, certificate, samples and sensor bias are checked first, and no torque is sent unless all is
    well. However it ends, with Ctrl-C too, the arm is braked to rest and its mechanical brakes close.

    Exit status: 0 the motion is over (or all checks pass), 1 a check fails, or the supervisor, the robot or
        its
    adapter ended the run, 2 bad input, 130 stopped by Ctrl-C, 143 by SIGTERM.
    """

    robot: RobotFile
    controller: ControllerFile
    via: Annotated[str, tyro.conf.arg(metavar="sim|franka|MODULE:CLASS")] = "sim"
    """The link: a simulated arm in a process of its own, a Franka robot, or your adapter, called with host
    and robot (examples/own_hardware.py)."""
    host: Annotated[str, tyro.conf.arg(metavar="ADDRESS", help_behavior_hint="(default: none)")] = ""
    """Of the robot."""
    check: Flag = False
    """Check everything and send no torque."""
    certificate: Annotated[
        Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: certify now)")
    ] = None
    """certificate.json of dashpot certify, of exactly these coefficients and drives."""
    uncertified: Flag = False
    """Run though nobody has shown that no load makes the joints oscillate."""
    motion: Annotated[str, tyro.conf.arg(metavar="hold|FILE")] = "hold"
    """Hold the arm where it is, or follow a CSV file as of dashpot simulate, after 1 s at rest."""
    duration: Annotated[
        float | None,
        tyro.conf.arg(
            metavar="SECONDS", help_behavior_hint="(default: the whole file; until Ctrl-C, 10 with sim)"
        ),
    ] = None
    """Of the motion, after 1 s at rest, or of the hold [s]; the stop comes on top."""
    payload: Mass = 0.0
    """Mass on the flange [kg]: sensor bias is what its weight and the arm's do not explain."""
    offset: Offset = (0.0,)
    """Its centre in the flange frame [m]: one number along x, or three."""
    samples: Annotated[int, tyro.conf.arg(metavar="NUMBER")] = 500
    """Samples of the arm at rest that are looked at first."""
    log: Annotated[Path | None, tyro.conf.arg(metavar="FILE.mcap", help_behavior_hint="(default: none)")] = (
        None
    )
    """Everything measured, commanded and decided, at every tick."""
    priority: Annotated[int, tyro.conf.arg(metavar="NUMBER")] = 80
    """Real-time priority asked for, 1 to 99; 0: none."""
    cpu: Annotated[int | None, tyro.conf.arg(metavar="NUMBER", help_behavior_hint="(default: any)")] = None
    """Processor the loop stays on."""
    lock_step: Flag = False
    """sim: the arm waits for every torque; same bits every time, those of dashpot simulate --supervise."""
    fault: Faults = ()
    """sim: something that fails, as in dashpot simulate; may be given several times."""
    payload_at: PayloadChanges = ()
    """sim: from this time on [s] the flange carries this mass [kg]; may be given several times."""
    seed: Number = 0
    """sim: of sensor noise and dropped samples."""
    record: Annotated[
        Path | None, tyro.conf.arg(metavar="FILE.npz", help_behavior_hint="(default: none)")
    ] = None
    """sim: what the arm did, written by its own process once it is at rest, even if this one is killed."""

    def run(self) -> int:
        """Runs the command."""
        with waiting("starting"):
            from dashpot.commands.run import run

        return run(self)


@dataclass
class Export:
    """Export a controller as C99 or as an FMU: equal to the one in Python to the bit, with its certificate.

    Example: dashpot export fr3 fr3 --to c --supervised

    The certificate of exactly these coefficients is computed and goes into the file. Exit status: 0 written
    and certified, 1 written but not certified, 2 bad input. docs/export.md has complete programs.
    """

    robot: RobotFile
    controller: ControllerFile
    to: Annotated[Literal["c", "fmu"], tyro.conf.arg(metavar="c|fmu")]
    """c: a pair NAME.c, NAME.h for any C99 compiler, freestanding. fmu: NAME.fmu for co-simulation."""
    fmi: Annotated[
        Literal["2", "3"] | None, tyro.conf.arg(metavar="2|3", help_behavior_hint="(default: 3)")
    ] = None
    """Version of FMI of an FMU: 3 (arrays) or 2 (scalars)."""
    supervised: Flag = False
    """Export the runtime supervisor too, with thresholds from the drives and the model's joint ranges."""
    name: Annotated[
        str | None, tyro.conf.arg(metavar="NAME", help_behavior_hint="(default: the controller's file name)")
    ] = None
    """Prefix of everything defined, so that several exports link into one program."""
    sources_only: Flag = False
    """Leave the binary out of an FMU; the importing tool compiles it."""
    without_certificate: Flag = False
    """Do not certify; the file says NOT CERTIFIED, and the exit status is 1."""
    out: Folder = Path("out/export")
    """Folder for the files; replaced as a whole."""

    def run(self) -> int:
        """Runs the command."""
        with waiting("starting"):
            from dashpot.commands.export import export

        return export(self)


@dataclass
class FrankaServer:
    """Serve a simulated Franka Research 3 to libfranka and pylibfranka programs, with true torque sensors.

    Example: dashpot franka-server --payload 2 --offset 0 0 0.1

    The arm has elastic joints, friction and a payload; tau_J is what passes through each transmission. It
    takes torque control and stops with the robot's own reflexes. Connect to its address as to the robot
    (docs/franka.md). Ctrl-C or SIGTERM ends it.
    """

    robot: Annotated[str, tyro.conf.arg(metavar="ROBOT")] = "fr3"
    """Robot TOML of seven joints, or fr3."""
    payload: Mass = 0.0
    """Mass on the flange [kg] that the robot does not know of; what a client declares (set_load) it
    carries."""
    offset: Offset = (0.0,)
    """Its centre in the flange frame [m]: one number along x, or three."""
    payload_at: PayloadChanges = ()
    """From this time on [s] the flange carries this mass [kg] at the same offset, 0: it has let go; may be
    given several times. Times count from the start of the first motion."""
    fault: Faults = ()
    """Something that fails, e.g. encoder_frozen:joint4@2; may be given several times. docs/faults.md lists
    the kinds; times in s, as above."""
    friction: Annotated[float, tyro.conf.arg(metavar="SHARE")] = 0.2
    """Share of the drives' friction that the robot compensates [-]."""
    host: Annotated[str, tyro.conf.arg(metavar="ADDRESS")] = "127.0.0.1"
    """Address to listen at, port 1337; 127.0.0.2 and so on serve a second robot on the same machine."""
    lock_step: Flag = False
    """A millisecond passes when the client has answered, not on the clock: what runs once, repeats bit by
    bit."""
    forgiving: Flag = False
    """Count lost packets, but do not stop the robot for 20 in a row."""
    seed: Number = 0
    """Seed of sensor noise and dropped samples."""
    log: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: none)")] = None
    """Write what was true, from the first motion on, when the server ends: a recording, .npz."""

    def run(self) -> int:
        """Runs the command."""
        with waiting("starting"):
            from dashpot.commands.franka_server import franka_server

        return franka_server(self)
