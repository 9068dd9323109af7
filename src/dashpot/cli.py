"""The ``dashpot`` command."""

from __future__ import annotations

import os
import signal
import sys
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from dashpot.errors import DashpotError, InputWarning


@dataclass
class Reproduce:
    """Reproduce the paper's Figs. 4, 5 and 6 on a simulated arm, with a report and verdicts."""

    out: Annotated[Path, tyro.conf.arg(metavar="FOLDER")] = Path("out/paper")
    """Folder for figures, report.html and results.json; replaced as a whole."""
    seeds: Annotated[int, tyro.conf.arg(metavar="NUMBER")] = 10
    """Trajectories and noise streams per condition."""
    threads: Annotated[
        int | None, tyro.conf.arg(metavar="NUMBER", help_behavior_hint="(default: one per core)")
    ] = None
    """Threads."""

    def run(self) -> int:
        """Runs the command."""
        from dashpot.commands.reproduce import reproduce

        return reproduce(self.out, self.seeds, self.threads)


@dataclass
class Simulate:
    """Simulate an arm under a controller: your own files or bundled ones by name."""

    robot: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="ROBOT")]
    """Robot TOML, or k807, fr3, iiwa14."""
    controller: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="CONTROLLER")]
    """Controller TOML, or k807-wrist, k807-resonant, fr3, iiwa14."""
    payload: Annotated[float, tyro.conf.arg(metavar="KG")] = 0.0
    """Mass on the flange [kg]."""
    offset: Annotated[tuple[float, ...], tyro.conf.arg(metavar="X [Y Z]")] = (0.0,)
    """Its centre in the flange frame [m]: one number along x, or three. At the k807's home pose the
    flange's x axis points up."""
    motion: Annotated[str, tyro.conf.arg(metavar="multisine|hold|FILE")] = "multisine"
    """Random motion of all joints around home, rest at home, or a CSV file with columns time [s],
    <joint>/position [rad] and, if known, <joint>/velocity and <joint>/acceleration, as of dashpot excite."""
    amplitude: Annotated[float, tyro.conf.arg(metavar="RAD")] = 0.3
    """Of the multisine, per joint [rad]."""
    duration: Annotated[
        float | None, tyro.conf.arg(metavar="SECONDS", help_behavior_hint="(default: 6, or the whole file)")
    ] = None
    """Of the motion, after 1 s at rest [s]."""
    release: Annotated[
        float | None, tyro.conf.arg(metavar="SECONDS", help_behavior_hint="(default: never)")
    ] = None
    """Remove the position loop's offset at this time [s]: from then on the torque sensors alone brake."""
    bypass: Annotated[
        tuple[str, ...], tyro.conf.arg(metavar="JOINT [JOINT ...]", help_behavior_hint="(default: none)")
    ] = ()
    """Joints whose virtual passive control is bypassed: their position loop acts alone."""
    tap: Annotated[float, tyro.conf.arg(metavar="N_M")] = 0.0
    """Knock the last link at time 0 with this torque for about 10 ms [N m]."""
    fault: Annotated[
        tuple[str, ...],
        tyro.conf.UseAppendAction,
        tyro.conf.arg(metavar="KIND[:JOINT]@START[-END][=VALUE]", help_behavior_hint="(default: none)"),
    ] = ()
    """Something that fails, e.g. encoder_lost:joint5@2 or torque_bias@2-3=4; may be given several times.
    docs/faults.md lists the kinds; times in s."""
    payload_at: Annotated[
        tuple[str, ...],
        tyro.conf.UseAppendAction,
        tyro.conf.arg(metavar="TIME=KG", help_behavior_hint="(default: never)"),
    ] = ()
    """From this time on [s] the flange carries this mass [kg] at the same offset, 0: it has let go; may be
    given several times."""
    supervise: bool = False
    """Run the supervisor around the controller, as on a robot: it checks every signal, brakes without
    encoders or without torque sensors, and closes the mechanical brakes last (docs/supervisor.md)."""
    gravity_compensation: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Switch on the robot's own gravity compensation, as its file says that it has (docs/model.md): it then
    carries its own weight, and the controller what is left."""
    seed: Annotated[int, tyro.conf.arg(metavar="NUMBER")] = 0
    """Seed of motion, sensor noise and dropped samples."""
    out: Annotated[Path, tyro.conf.arg(metavar="FOLDER")] = Path("out/simulate")
    """Folder for recording.npz and simulate.png; replaced as a whole."""
    log: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: none)")] = None
    """Also write what the robot would have logged, for dashpot identify and plot: .csv, .parquet, or .mcap,
    which also holds the controller's states, energy and what happened."""

    def run(self) -> int:
        """Runs the command."""
        from dashpot.commands.simulate import simulate

        return simulate(self)


@dataclass
class Run:
    """Run a controller on a robot, in real time and under the supervisor (docs/hardware.md).

    Limits, rates, certificate, samples and sensor bias are checked first, and no torque is sent unless all is
    well. However it ends, with Ctrl-C too, the arm is braked to rest and its mechanical brakes close.

    Exit status: 0 the motion is over (or all checks pass), 1 a check fails, or the supervisor, the robot or
        its
    adapter ended the run, 2 bad input, 130 stopped by Ctrl-C, 143 by SIGTERM.
    """

    robot: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="ROBOT")]
    """Robot TOML, or k807, fr3, iiwa14."""
    controller: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="CONTROLLER")]
    """Controller TOML, or k807-wrist, k807-resonant, fr3, iiwa14."""
    via: Annotated[str, tyro.conf.arg(metavar="sim|franka|MODULE:CLASS")] = "sim"
    """The link: a simulated arm in a process of its own, a Franka robot, or your adapter, called with host
    and robot (examples/own_hardware.py)."""
    host: Annotated[str, tyro.conf.arg(metavar="ADDRESS", help_behavior_hint="(default: none)")] = ""
    """Of the robot."""
    check: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Check everything and send no torque."""
    certificate: Annotated[
        Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: certify now)")
    ] = None
    """certificate.json of dashpot certify, of exactly these coefficients and drives."""
    uncertified: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
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
    payload: Annotated[float, tyro.conf.arg(metavar="KG")] = 0.0
    """Mass on the flange [kg]: sensor bias is what its weight and the arm's do not explain."""
    offset: Annotated[tuple[float, ...], tyro.conf.arg(metavar="X [Y Z]")] = (0.0,)
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
    lock_step: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """sim: the arm waits for every torque; same bits every time, those of dashpot simulate --supervise."""
    fault: Annotated[
        tuple[str, ...],
        tyro.conf.UseAppendAction,
        tyro.conf.arg(metavar="KIND[:JOINT]@START[-END][=VALUE]", help_behavior_hint="(default: none)"),
    ] = ()
    """sim: something that fails, as in dashpot simulate; may be given several times."""
    payload_at: Annotated[
        tuple[str, ...],
        tyro.conf.UseAppendAction,
        tyro.conf.arg(metavar="TIME=KG", help_behavior_hint="(default: never)"),
    ] = ()
    """sim: from this time on [s] the flange carries this mass [kg]; may be given several times."""
    seed: Annotated[int, tyro.conf.arg(metavar="NUMBER")] = 0
    """sim: of sensor noise and dropped samples."""
    record: Annotated[
        Path | None, tyro.conf.arg(metavar="FILE.npz", help_behavior_hint="(default: none)")
    ] = None
    """sim: what the arm did, written by its own process once it is at rest, even if this one is killed."""

    def run(self) -> int:
        """Runs the command."""
        from dashpot.commands.run import run

        return run(self)


@dataclass
class Certify:
    """Certify that no payload, pose or contact can make the joints oscillate; exit status 0 only then.

    Needs the drives only, no model of the arm.
    """

    robot: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="ROBOT")]
    """Robot TOML, or k807, fr3, iiwa14."""
    controller: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="CONTROLLER")]
    """Controller TOML, or k807-wrist, k807-resonant, fr3, iiwa14."""
    json: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Print the verdicts as JSON and draw nothing unless a folder is given."""
    out: Annotated[
        Path | None, tyro.conf.arg(metavar="FOLDER", help_behavior_hint="(default: out/certify)")
    ] = None
    """Folder for a picture per joint, certificate.json and a test bench for every load that oscillates."""

    def run(self) -> int:
        """Runs the command."""
        from dashpot.commands.certify import certify

        return certify(self)


@dataclass
class Map:
    """Map the certificate over R and D around a controller's gains."""

    robot: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="ROBOT")]
    """Robot TOML, or k807, fr3, iiwa14."""
    controller: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="CONTROLLER")]
    """Controller TOML, or k807-wrist, k807-resonant, fr3, iiwa14."""
    joint: Annotated[
        tuple[str, ...], tyro.conf.arg(metavar="JOINT [JOINT ...]", help_behavior_hint="(default: all)")
    ] = ()
    """Joints to map."""
    points: Annotated[int, tyro.conf.arg(metavar="NUMBER")] = 200
    """Values of R and of D, three decades of each."""
    out: Annotated[Path, tyro.conf.arg(metavar="FOLDER")] = Path("out/map")
    """Folder for a picture and the numbers (.npz) per joint; replaced as a whole."""

    def run(self) -> int:
        """Runs the command."""
        from dashpot.commands.certify import map_gains

        return map_gains(self)


@dataclass
class Design:
    """Design gains from what is wanted of the joints, certified over the whole uncertainty of the drives.

    Example: dashpot design fr3 track --payload 3 --stop-time 0.05 --error-ratio 0.15

    Presets: brake stops as short as possible, without position loop; track makes the error under load small;
    gentle does so with less torque, more damping and more margin. Flags replace what the specification says.
    Exit status: 0 every joint has certified gains, 1 wishes conflict (it says which, and what would help), 2
    bad input.
    """

    robot: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="ROBOT")]
    """Robot TOML, or k807, fr3, iiwa14."""
    spec: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="SPEC")] = "track"
    """Specification TOML, or brake, track, gentle."""
    joint: Annotated[
        tuple[str, ...] | None,
        tyro.conf.arg(metavar="JOINT [JOINT ...]", help_behavior_hint="(default: all)"),
    ] = None
    """Joints to design; the others stay under the robot's own position loop."""
    payload: Annotated[
        float | None, tyro.conf.arg(metavar="KG", help_behavior_hint="(default: as in SPEC, else 0)")
    ] = None
    """Largest payload on the flange [kg]."""
    offset: Annotated[
        tuple[float, ...] | None,
        tyro.conf.arg(metavar="X [Y Z]", help_behavior_hint="(default: as in SPEC, else 0)"),
    ] = None
    """Its centre in the flange frame [m]: one number along x, or three."""
    pose: Annotated[
        Literal["worst", "home"] | None,
        tyro.conf.arg(metavar="worst|home", help_behavior_hint="(default: as in SPEC, else worst)"),
    ] = None
    """Poses whose inertia and load count: all over the joints' ranges, or home."""
    gravity_compensated: Annotated[
        Literal["yes", "no"] | None,
        tyro.conf.arg(metavar="yes|no", help_behavior_hint="(default: as in SPEC, else yes)"),
    ] = None
    """The robot carries its own weight, so that only the payload's is a load."""
    minimise: Annotated[
        Literal[
            "travel",
            "stop_time",
            "creep",
            "load_error",
            "error_ratio",
            "noise",
            "authority",
            "damping_ratio",
        ]
        | None,
        tyro.conf.arg(metavar="QUANTITY", help_behavior_hint="(default: as in SPEC)"),
    ] = None
    """What to make as small as possible within the limits (damping_ratio: large): travel, stop_time, creep,
    load_error, error_ratio, noise, authority or damping_ratio."""
    stop_time: Annotated[
        float | None, tyro.conf.arg(metavar="SECONDS", help_behavior_hint="(default: as in SPEC)")
    ] = None
    """Longest time to stop once the encoder is lost [s]."""
    travel: Annotated[
        float | None, tyro.conf.arg(metavar="RAD", help_behavior_hint="(default: as in SPEC)")
    ] = None
    """Farthest way in 5 s after losing the encoder, the payload pulling on [rad]."""
    creep: Annotated[
        float | None, tyro.conf.arg(metavar="RAD/S", help_behavior_hint="(default: as in SPEC)")
    ] = None
    """Fastest sag of the released joint under the payload [rad/s]; 0: friction must hold it."""
    load_error: Annotated[
        float | None, tyro.conf.arg(metavar="RAD", help_behavior_hint="(default: as in SPEC)")
    ] = None
    """Largest position error under the payload [rad]."""
    error_ratio: Annotated[
        float | None, tyro.conf.arg(metavar="SHARE", help_behavior_hint="(default: as in SPEC)")
    ] = None
    """Largest error under load over that of the position loop alone [-]."""
    noise: Annotated[
        float | None, tyro.conf.arg(metavar="SHARE", help_behavior_hint="(default: as in SPEC)")
    ] = None
    """Largest RMS of the torque command from sensor noise, over the torque limit [-]."""
    authority: Annotated[
        float | None, tyro.conf.arg(metavar="SHARE", help_behavior_hint="(default: as in SPEC)")
    ] = None
    """Largest share of the torque limit that may be asked for [-]."""
    damping_ratio: Annotated[
        float | None, tyro.conf.arg(metavar="RATIO", help_behavior_hint="(default: as in SPEC)")
    ] = None
    """Least damping ratio of the position loop [-]."""
    margin: Annotated[
        float | None, tyro.conf.arg(metavar="SHARE", help_behavior_hint="(default: as in SPEC)")
    ] = None
    """Least passivity index over the whole uncertainty, over that of the drive alone [-]."""
    speed: Annotated[
        float | None, tyro.conf.arg(metavar="RAD/S", help_behavior_hint="(default: as in SPEC, else 0.5)")
    ] = None
    """Joint speed from which it must stop [rad/s]."""
    residual_speed: Annotated[
        float | None, tyro.conf.arg(metavar="SHARE", help_behavior_hint="(default: as in SPEC, else 0.05)")
    ] = None
    """Share of it below which a joint has stopped [-]."""
    jump: Annotated[
        float | None, tyro.conf.arg(metavar="RAD", help_behavior_hint="(default: as in SPEC, else 0.02)")
    ] = None
    """Position error whose correction must keep within the authority [rad]."""
    period: Annotated[
        float | None, tyro.conf.arg(metavar="SECONDS", help_behavior_hint="(default: as in SPEC, else 0.001)")
    ] = None
    """Sample period of the controller [s]."""
    latency: Annotated[
        int | None,
        tyro.conf.arg(
            metavar="SAMPLES", help_behavior_hint="(default: as in SPEC, else as identified, or 0)"
        ),
    ] = None
    """Whole samples from computing a torque to its taking effect."""
    latency_max: Annotated[
        int | None,
        tyro.conf.arg(metavar="SAMPLES", help_behavior_hint="(default: as in SPEC, else the latency)"),
    ] = None
    """The longest it may be; the certificate covers all up to it."""
    sampling: Annotated[
        Literal["average", "point"] | None,
        tyro.conf.arg(
            metavar="average|point",
            help_behavior_hint="(default: as in SPEC, else point where every drive filters its sensor)",
        ),
    ] = None
    """Torque samples are means over the last period, or the latest value."""
    form: Annotated[
        Literal["implicit", "explicit"] | None,
        tyro.conf.arg(metavar="implicit|explicit", help_behavior_hint="(default: as in SPEC, else implicit)"),
    ] = None
    """Discretisation of the law."""
    workers: Annotated[
        int | None, tyro.conf.arg(metavar="NUMBER", help_behavior_hint="(default: one per core)")
    ] = None
    """Processes that share the joints."""
    json: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Print the result as JSON; the folder is written all the same."""
    out: Annotated[Path, tyro.conf.arg(metavar="FOLDER")] = Path("out/design")
    """Folder for controller.toml, spec.toml, report.html, design.json and a picture per joint; replaced as a
    whole."""

    def run(self) -> int:
        """Runs the command."""
        from dashpot.commands.design import design

        return design(self)


@dataclass
class Export:
    """Export a controller as C99 or as an FMU: equal to the one in Python to the bit, with its certificate.

    Example: dashpot export fr3 fr3 --to c --supervised

    The certificate of exactly these coefficients is computed and goes into the file. Exit status: 0 written
    and certified, 1 written but NOT CERTIFIED, 2 bad input. docs/export.md has complete programs.
    """

    robot: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="ROBOT")]
    """Robot TOML, or k807, fr3, iiwa14."""
    controller: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="CONTROLLER")]
    """Controller TOML, or k807-wrist, k807-resonant, fr3, iiwa14."""
    to: Annotated[Literal["c", "fmu"], tyro.conf.arg(metavar="c|fmu")]
    """c: a pair NAME.c, NAME.h for any C99 compiler, freestanding. fmu: NAME.fmu for co-simulation."""
    fmi: Annotated[Literal["2", "3"], tyro.conf.arg(metavar="2|3")] = "3"
    """Version of FMI: 3 (arrays) or 2 (scalars)."""
    supervised: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Export the runtime supervisor too, with thresholds from the drives and the model's joint ranges."""
    name: Annotated[
        str | None, tyro.conf.arg(metavar="NAME", help_behavior_hint="(default: the controller's file name)")
    ] = None
    """Prefix of everything defined, so that several exports link into one program."""
    sources_only: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Leave the binary out of an FMU; the importing tool compiles it."""
    without_certificate: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Do not certify; the file says NOT CERTIFIED, and the exit status is 1."""
    out: Annotated[Path, tyro.conf.arg(metavar="FOLDER")] = Path("out/export")
    """Folder for the files; replaced as a whole."""

    def run(self) -> int:
        """Runs the command."""
        from dashpot.commands.export import export

        return export(self)


@dataclass
class Excite:
    """Make a safe motion that tells the drives' inertia and friction apart; log it, then dashpot identify.

    Self-collision and surroundings are not checked: look at the motion in simulation first.
    """

    robot: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="ROBOT")]
    """Robot TOML with a model, or k807, fr3, iiwa14."""
    controller: Annotated[
        str | None, tyro.conf.arg(metavar="CONTROLLER", help_behavior_hint="(default: 5 ms)")
    ] = None
    """Controller that will run the motion: its period is taken."""
    payload: Annotated[
        tuple[float, ...], tyro.conf.arg(metavar="KG [KG ...]", help_behavior_hint="(default: none)")
    ] = ()
    """Masses on the flange, one at a time, with which torques must stay within limits [kg]."""
    offset: Annotated[tuple[float, ...], tyro.conf.arg(metavar="X [Y Z]")] = (0.0,)
    """Their centre in the flange frame [m]: one number along x, or three."""
    joints: Annotated[
        tuple[str, ...], tyro.conf.arg(metavar="JOINT [JOINT ...]", help_behavior_hint="(default: all)")
    ] = ()
    """Joints that move; the others rest at home."""
    duration: Annotated[float, tyro.conf.arg(metavar="SECONDS")] = 45.0
    """Of the motion [s]."""
    amplitude: Annotated[float, tyro.conf.arg(metavar="RAD")] = 0.4
    """Farthest from home [rad]; stops of the model are kept 0.1 rad away besides."""
    speed: Annotated[float, tyro.conf.arg(metavar="RAD/S")] = 0.5
    """Fastest joint speed [rad/s]."""
    torque_share: Annotated[float, tyro.conf.arg(metavar="SHARE")] = 0.6
    """Largest motor torque, as a share of each drive's torque_limit."""
    seed: Annotated[int, tyro.conf.arg(metavar="NUMBER")] = 0
    """Seed of the search for a motion."""
    out: Annotated[Path, tyro.conf.arg(metavar="FOLDER")] = Path("out/excite")
    """Folder for motion.csv and a picture; replaced as a whole."""

    def run(self) -> int:
        """Runs the command."""
        from dashpot.commands.excite import excite

        return excite(self)


@dataclass
class Plot:
    """Draw a log: torque, command, tracking error, speed, energy and what happened, for every joint.

    Reads logs of dashpot and of any robot; what a log lacks is left out. Columns and topics: docs/logs.md.
    """

    log: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="LOG")]
    """Log: .mcap, also one that a crash has cut off, .csv, .parquet, or recording.npz of dashpot simulate."""
    joint: Annotated[
        tuple[str, ...], tyro.conf.arg(metavar="JOINT [JOINT ...]", help_behavior_hint="(default: all)")
    ] = ()
    """Joints to draw."""
    window: Annotated[
        tuple[float, float] | None, tyro.conf.arg(metavar="FROM TO", help_behavior_hint="(default: all)")
    ] = None
    """Stretch of time to draw [s], as on the time axis."""
    states: Annotated[str, tyro.conf.arg(metavar="TOPIC")] = "/joint_states"
    """Topic (MCAP, PlotJuggler) of position, velocity and sensed torque."""
    commands: Annotated[str, tyro.conf.arg(metavar="TOPIC")] = "/joint_command"
    """Topic of the torque command and the references."""
    links: Annotated[str, tyro.conf.arg(metavar="TOPIC")] = "/link_states"
    """Topic of the link side."""
    pdf: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Also write PDF files."""
    out: Annotated[Path, tyro.conf.arg(metavar="FOLDER")] = Path("out/plot")
    """Folder for overview.png and a picture per joint; replaced as a whole."""

    def run(self) -> int:
        """Runs the command."""
        from dashpot.commands.plot import plot

        return plot(self)


@dataclass
class Identify:
    """Identify inertia, friction, torque sensor, latency and transmission of the drives from a log.

    Everything is SI and on the link side of the gear; docs/logs.md lists columns and topics. Exit status: 0
    everything identified, 1 something is refused (it says what, why, and which motion would do), 2 bad input.
    """

    log: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="LOG")]
    """Log: .csv, .parquet or .mcap, with time [s] and per joint command [N m], effort (sensed) [N m],
    position [rad], velocity [rad/s] and, if measured, link_position [rad]."""
    robot: Annotated[str, tyro.conf.arg(metavar="ROBOT")]
    """Robot TOML, or k807, fr3, iiwa14: what is known so far."""
    joint: Annotated[
        tuple[str, ...], tyro.conf.arg(metavar="JOINT [JOINT ...]", help_behavior_hint="(default: all)")
    ] = ()
    """Joints to identify."""
    scale: Annotated[
        float | None, tyro.conf.arg(metavar="ERROR", help_behavior_hint="(default: estimated)")
    ] = None
    """Relative scale error of the torque sensors [-], where it is known: 0.01 reads 1 % too much."""
    sampling: Annotated[
        Literal["average", "point"] | None,
        tyro.conf.arg(help_behavior_hint="(default: what the log says, else point)"),
    ] = None
    """Torque samples are means over the last period, or the latest value."""
    states: Annotated[str, tyro.conf.arg(metavar="TOPIC")] = "/joint_states"
    """Topic (MCAP, PlotJuggler) of position, velocity and sensed torque."""
    commands: Annotated[str, tyro.conf.arg(metavar="TOPIC")] = "/joint_command"
    """Topic of the torque command."""
    links: Annotated[str, tyro.conf.arg(metavar="TOPIC")] = "/link_states"
    """Topic of the link-side position."""
    json: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Print the results as JSON."""
    in_place: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Also write the result over ROBOT itself."""
    out: Annotated[Path, tyro.conf.arg(metavar="FOLDER")] = Path("out/identify")
    """Folder for the new robot TOML, a picture per joint and identify.json; replaced as a whole."""

    def run(self) -> int:
        """Runs the command."""
        from dashpot.commands.identify import identify

        return identify(self)


@dataclass
class Campaign:
    """Run a campaign of scenarios over payloads, poses, gains, drive errors, faults and seeds.

    SPEC (TOML, docs/campaigns.md) names the axes, how they are combined and what is required. The same
    command continues after a stop or a kill. Exit status: 0 every requirement is met, 1 one is not or a
    scenario failed, 2 bad input.
    """

    spec: Annotated[
        tyro.conf.Positional[Path | None],
        tyro.conf.arg(metavar="SPEC", help_behavior_hint="(or --preset)"),
    ] = None
    """Specification TOML."""
    preset: Annotated[
        Literal["readiness"] | None, tyro.conf.arg(metavar="readiness", help_behavior_hint="(default: none)")
    ] = None
    """A bundled specification instead: readiness is faults x payloads x poses."""
    robot: Annotated[
        str | None, tyro.conf.arg(metavar="ROBOT", help_behavior_hint="(default: as in SPEC)")
    ] = None
    """Robot TOML, or k807, fr3, iiwa14."""
    controller: Annotated[
        tuple[str, ...],
        tyro.conf.arg(metavar="CONTROLLER [CONTROLLER ...]", help_behavior_hint="(default: as in SPEC)"),
    ] = ()
    """Controller TOML, or k807-wrist, k807-resonant, fr3, iiwa14; several are an axis."""
    workers: Annotated[
        int | None, tyro.conf.arg(metavar="NUMBER", help_behavior_hint="(default: one per core)")
    ] = None
    """Local processes."""
    scheduler: Annotated[
        str | None, tyro.conf.arg(metavar="ADDRESS", help_behavior_hint="(default: local processes)")
    ] = None
    """Run on the Dask cluster of this scheduler, e.g. tcp://10.0.0.1:8786."""
    out: Annotated[Path, tyro.conf.arg(metavar="DATASET")] = Path("out/campaign.zarr")
    """Zarr folder for the results, an xarray Dataset; an unfinished one of the same campaign is continued."""

    def run(self) -> int:
        """Runs the command."""
        from dashpot.commands.campaign import campaign

        return campaign(self)


@dataclass
class Replay:
    """Run one scenario of a campaign again, bit for bit, with the picture and recording of dashpot simulate.

    Exit status: 0 the measures are those of the dataset, 1 they differ or the simulation diverges, 2 bad
    input.
    """

    dataset: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DATASET")]
    """What dashpot campaign wrote."""
    index: Annotated[tyro.conf.Positional[int], tyro.conf.arg(metavar="INDEX")]
    """Index of the scenario."""
    out: Annotated[Path, tyro.conf.arg(metavar="FOLDER")] = Path("out/replay")
    """Folder for recording.npz and simulate.png; replaced as a whole."""

    def run(self) -> int:
        """Runs the command."""
        from dashpot.commands.campaign import replay

        return replay(self)


@dataclass
class Report:
    """Judge a campaign against its requirements: verdicts, worst cases and pictures on one HTML page.

    Exit status: 0 every requirement is met, 1 one is not, or scenarios failed or are missing, 2 bad input.
    """

    dataset: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DATASET")]
    """What dashpot campaign wrote."""
    out: Annotated[
        Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: DATASET with .html)")
    ] = None
    """The page."""

    def run(self) -> int:
        """Runs the command."""
        from dashpot.commands.report import report

        return report(self)


@dataclass
class FrankaServer:
    """Serve a simulated Franka Research 3 to libfranka and pylibfranka programs, with true torque sensors.

    The arm has elastic joints, friction and a payload; tau_J is what passes through each transmission. It
    takes torque control and stops with the robot's own reflexes. Connect to its address as to the robot
    (docs/franka.md). Ctrl-C or SIGTERM ends it.
    """

    robot: Annotated[str, tyro.conf.arg(metavar="ROBOT")] = "fr3"
    """Robot TOML of seven joints, or fr3."""
    payload: Annotated[float, tyro.conf.arg(metavar="KG")] = 0.0
    """Mass on the flange [kg] that the robot does not know of; what a client declares (set_load) it
    carries."""
    offset: Annotated[tuple[float, ...], tyro.conf.arg(metavar="X [Y Z]")] = (0.0,)
    """Its centre in the flange frame [m]: one number along x, or three."""
    payload_at: Annotated[
        tuple[str, ...],
        tyro.conf.UseAppendAction,
        tyro.conf.arg(metavar="TIME=KG", help_behavior_hint="(default: never)"),
    ] = ()
    """From this time on [s] the flange carries this mass [kg] at the same offset, 0: it has let go; may be
    given several times. Times count from the start of the first motion."""
    fault: Annotated[
        tuple[str, ...],
        tyro.conf.UseAppendAction,
        tyro.conf.arg(metavar="KIND[:JOINT]@START[-END][=VALUE]", help_behavior_hint="(default: none)"),
    ] = ()
    """Something that fails, e.g. encoder_frozen:joint4@2; may be given several times. docs/faults.md lists
    the kinds; times in s, as above."""
    friction: Annotated[float, tyro.conf.arg(metavar="SHARE")] = 0.2
    """Share of the drives' friction that the robot compensates [-]."""
    host: Annotated[str, tyro.conf.arg(metavar="ADDRESS")] = "127.0.0.1"
    """Address to listen at, port 1337; 127.0.0.2 and so on serve a second robot on the same machine."""
    lock_step: bool = False
    """A millisecond passes when the client has answered, not on the clock: what runs once, repeats bit by
    bit."""
    forgiving: bool = False
    """Count lost packets, but do not stop the robot for 20 in a row."""
    seed: Annotated[int, tyro.conf.arg(metavar="NUMBER")] = 0
    """Seed of sensor noise and dropped samples."""
    log: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: none)")] = None
    """Write what was true, from the first motion on, when the server ends: a recording, .npz."""

    def run(self) -> int:
        """Runs the command."""
        from dashpot.commands.franka_server import franka_server

        return franka_server(self)


@dataclass
class Studio:
    """Open the studio: a live arm in the browser, its controller, its certificate and its faults.

    Needs viser: `make studio` in a checkout, else pip install 'dashpot[studio]'. Works offline.
    """

    robot: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="ROBOT")] = "k807"
    """Robot TOML, or k807, fr3, iiwa14."""
    controller: Annotated[
        tyro.conf.Positional[str | None],
        tyro.conf.arg(metavar="CONTROLLER", help_behavior_hint="(default: that of the bundled robot)"),
    ] = None
    """Controller TOML, or k807-wrist, k807-resonant, fr3, iiwa14."""
    payload: Annotated[float, tyro.conf.arg(metavar="KG")] = 0.0
    """Mass on the flange to begin with [kg]."""
    offset: Annotated[tuple[float, ...], tyro.conf.arg(metavar="X [Y Z]")] = (0.0,)
    """Its centre in the flange frame [m]: one number along x, or three."""
    supervise: bool = True
    """Whether the supervisor is in charge to begin with."""
    host: Annotated[str, tyro.conf.arg(metavar="ADDRESS")] = "127.0.0.1"
    """Address to listen at; others than this machine's own let others use the studio."""
    port: Annotated[int, tyro.conf.arg(metavar="NUMBER")] = 8080
    """Port; where it is taken, the next free one."""
    seed: Annotated[int, tyro.conf.arg(metavar="NUMBER")] = 0
    """Seed of sensor noise and motions."""
    run_for: Annotated[
        float | None, tyro.conf.arg(metavar="SECONDS", help_behavior_hint="(default: until Ctrl-C)")
    ] = None
    """End after this time [s], and print every 10 s what it costs."""

    def run(self) -> int:
        """Runs the command."""
        from dashpot.commands.studio import studio

        return studio(self)


Command = (
    Annotated[Reproduce, tyro.conf.subcommand("reproduce")]
    | Annotated[Certify, tyro.conf.subcommand("certify")]
    | Annotated[Map, tyro.conf.subcommand("map")]
    | Annotated[Design, tyro.conf.subcommand("design")]
    | Annotated[Simulate, tyro.conf.subcommand("simulate")]
    | Annotated[Plot, tyro.conf.subcommand("plot")]
    | Annotated[Export, tyro.conf.subcommand("export")]
    | Annotated[Run, tyro.conf.subcommand("run")]
    | Annotated[FrankaServer, tyro.conf.subcommand("franka-server")]
    | Annotated[Excite, tyro.conf.subcommand("excite")]
    | Annotated[Identify, tyro.conf.subcommand("identify")]
    | Annotated[Campaign, tyro.conf.subcommand("campaign")]
    | Annotated[Replay, tyro.conf.subcommand("replay")]
    | Annotated[Report, tyro.conf.subcommand("report")]
    | Annotated[Studio, tyro.conf.subcommand("studio")]
)


def _show_warning(message: Warning | str, category: type[Warning], *_: object, **__: object) -> None:
    label = "warning" if issubclass(category, InputWarning) else category.__name__
    print(f"dashpot: {label}: {message}", file=sys.stderr)


class _Terminated(KeyboardInterrupt):
    """SIGTERM or SIGHUP: its number."""


def _terminate(number: int, _: object) -> None:
    raise _Terminated(number)


@contextmanager
def _tidy_stop() -> Iterator[None]:
    """Lets SIGTERM and a closed terminal stop the command as Ctrl-C does: unfinished output is removed."""
    signals = [number for name in ("SIGTERM", "SIGHUP") if (number := getattr(signal, name, None))]
    if threading.current_thread() is not threading.main_thread():
        signals = []
    taken = [number for number in signals if signal.getsignal(number) is signal.SIG_DFL]
    for number in taken:
        signal.signal(number, _terminate)
    after: signal.Handlers = signal.SIG_DFL
    try:
        yield
    except KeyboardInterrupt:  # on its way out: a second one, as `timeout` sends, changes nothing any more
        after = signal.SIG_IGN
        if signals and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            taken.append(signal.SIGINT)
        raise
    finally:
        for number in taken:
            signal.signal(number, after)


def main(arguments: list[str] | None = None) -> None:
    """Entry point; exits 0 on success, 1 where a verdict is no or the simulation diverges, 2 on bad input.

    Ctrl-C exits 130, SIGTERM 143, SIGHUP 129.
    """
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # a terminal without a character shows "?" for it
            stream.reconfigure(errors="replace")
    with warnings.catch_warnings():
        warnings.simplefilter("always", InputWarning)
        warnings.showwarning = _show_warning
        try:
            command = tyro.cli(
                Command,
                prog="dashpot",
                description="Virtual passive control for torque-sensed robot joints.",
                args=arguments,
            )
            with _tidy_stop():
                status = command.run()
        except DashpotError as error:
            status = _fail(str(error))
        except BrokenPipeError:  # the reader of our output has left: `dashpot ... | head`
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            status = 141
        except OSError as error:
            status = _fail(": ".join(str(part) for part in (error.filename, error.strerror or error) if part))
        except MemoryError:
            status = _fail("out of memory; ask for a shorter motion or fewer threads")
        except KeyboardInterrupt as stop:
            print("dashpot: stopped", file=sys.stderr)
            status = 128 + stop.args[0] if isinstance(stop, _Terminated) else 130
            _leave_if_running(status)
    sys.exit(status)


def _leave_if_running(status: int) -> None:
    """Ends the process at once where the native loop still runs, under which no memory may be freed, or where
    a pool of processes does not end.
    """
    from dashpot.commands import NATIVE_LOOP
    from dashpot.workers import is_manager

    if any(thread.name == NATIVE_LOOP or is_manager(thread) for thread in threading.enumerate()):
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


def _fail(message: str) -> int:
    print(f"dashpot: error: {message}", file=sys.stderr)
    return 2


if __name__ == "__main__":
    main()
