"""From a robot to its drives: ``excite``, ``plot``, ``identify``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from dashpot.cli.arguments import Flag, Folder, Joints, Number, Offset
from dashpot.support.waiting import waiting


@dataclass
class Excite:
    """Make a safe motion that tells the drives' inertia and friction apart; log it, then dashpot identify.

    Example: dashpot excite fr3 --controller fr3 --payload 1 --offset 0.1

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
    offset: Offset = (0.0,)
    """Their centre in the flange frame [m]: one number along x, or three."""
    joints: Joints = ()
    """Joints that move; the others rest at home."""
    duration: Annotated[float, tyro.conf.arg(metavar="SECONDS")] = 45.0
    """Of the motion [s]."""
    amplitude: Annotated[float, tyro.conf.arg(metavar="RAD")] = 0.4
    """Farthest from home [rad]; stops of the model are kept 0.1 rad away besides."""
    speed: Annotated[float, tyro.conf.arg(metavar="RAD/S")] = 0.5
    """Fastest joint speed [rad/s]."""
    torque_share: Annotated[float, tyro.conf.arg(metavar="SHARE")] = 0.6
    """Largest motor torque, as a share of each drive's torque_limit."""
    seed: Number = 0
    """Seed of the search for a motion."""
    out: Folder = Path("out/excite")
    """Folder for motion.csv and a picture; replaced as a whole."""

    def run(self) -> int:
        """Runs the command."""
        with waiting("starting"):
            from dashpot.commands.excite import excite

        return excite(self)


@dataclass
class Plot:
    """Draw a log: torque, command, tracking error, speed, energy and what happened, for every joint.

    Example: dashpot plot run.mcap --window 0 5

    Reads logs of dashpot and of any robot; what a log lacks is left out. Columns and topics: docs/logs.md.
    """

    log: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="LOG")]
    """Log: .mcap, also one that a crash has cut off, .csv, .parquet, or recording.npz of dashpot simulate."""
    joint: Joints = ()
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
    pdf: Flag = False
    """Also write PDF files."""
    out: Folder = Path("out/plot")
    """Folder for overview.png and a picture per joint; replaced as a whole."""

    def run(self) -> int:
        """Runs the command."""
        with waiting("starting"):
            from dashpot.commands.plot import plot

        return plot(self)


@dataclass
class Identify:
    """Identify inertia, friction, torque sensor, latency and transmission of the drives from a log.

    Example: dashpot identify log.csv --robot fr3

    Everything is SI and on the link side of the gear; docs/logs.md lists columns and topics. Exit status: 0
    inertia and friction of every joint are identified, 1 those of a joint are refused (it says why, and which
    motion would do), 2 bad input.
    """

    log: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="LOG")]
    """Log: .csv, .parquet or .mcap, with time [s] and per joint command [N m], effort (sensed) [N m],
    position [rad], velocity [rad/s] and, if measured, link_position [rad]."""
    robot: Annotated[str, tyro.conf.arg(metavar="ROBOT")]
    """Robot TOML, or k807, fr3, iiwa14: what is known so far."""
    joint: Joints = ()
    """Joints to identify."""
    scale: Annotated[
        float | None, tyro.conf.arg(metavar="ERROR", help_behavior_hint="(default: estimated)")
    ] = None
    """Relative scale error of the torque sensors [-], where it is known: 0.01 reads 1 % too much."""
    sampling: Annotated[
        Literal["average", "point"] | None,
        tyro.conf.arg(metavar="average|point", help_behavior_hint="(default: what the log says, else point)"),
    ] = None
    """Torque samples are means over the last period, or the latest value."""
    states: Annotated[str, tyro.conf.arg(metavar="TOPIC")] = "/joint_states"
    """Topic (MCAP, PlotJuggler) of position, velocity and sensed torque."""
    commands: Annotated[str, tyro.conf.arg(metavar="TOPIC")] = "/joint_command"
    """Topic of the torque command."""
    links: Annotated[str, tyro.conf.arg(metavar="TOPIC")] = "/link_states"
    """Topic of the link-side position."""
    json: Flag = False
    """Print the results as JSON."""
    in_place: Flag = False
    """Also write the result over ROBOT itself."""
    out: Folder = Path("out/identify")
    """Folder for the new robot TOML, a picture per joint and identify.json; replaced as a whole."""

    def run(self) -> int:
        """Runs the command."""
        with waiting("starting"):
            from dashpot.commands.identify import identify

        return identify(self)
