"""From drives to certified gains: ``design``, ``certify``, ``map``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from dashpot.cli.arguments import ControllerFile, Flag, Folder, Joints, PerCore, RobotFile
from dashpot.support.waiting import waiting


@dataclass
class Design:
    """Design gains from what is wanted of the joints, certified over the whole uncertainty of the drives.

    Example: dashpot design fr3 track --payload 3 --stop-time 0.05 --error-ratio 0.15

    Presets: brake stops as short as possible, without position loop; track makes the error under load small;
    gentle does so with less torque, more damping and more margin. Flags replace what the specification says.
    Exit status: 0 every joint has certified gains, 1 wishes conflict (it says which, and what would help), 2
    bad input.
    """

    robot: RobotFile
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
    workers: PerCore = None
    """Processes that share the joints."""
    json: Flag = False
    """Print the result as JSON; the folder is written all the same."""
    out: Folder = Path("out/design")
    """Folder for controller.toml, spec.toml, report.html, design.json and a picture per joint; replaced as a
    whole."""

    def run(self) -> int:
        """Runs the command."""
        with waiting("starting"):
            from dashpot.commands.design import design

        return design(self)


@dataclass
class Certify:
    """Certify that no payload, pose or contact can make the joints oscillate.

    Example: dashpot certify fr3 fr3

    Needs the drives only, no model of the arm. Exit status: 0 all are certified, 1 not, 2 bad input.
    """

    robot: RobotFile
    controller: ControllerFile
    json: Flag = False
    """Print the verdicts as JSON and draw nothing unless a folder is given."""
    out: Annotated[
        Path | None, tyro.conf.arg(metavar="FOLDER", help_behavior_hint="(default: out/certify)")
    ] = None
    """Folder for a picture per joint, certificate.json and a test bench for every load that oscillates."""

    def run(self) -> int:
        """Runs the command."""
        with waiting("starting"):
            from dashpot.commands.certify import certify

        return certify(self)


@dataclass
class Map:
    """Map the certificate over R and D around a controller's gains.

    Example: dashpot map k807 k807-wrist --joint joint7 --points 100
    """

    robot: RobotFile
    controller: ControllerFile
    joint: Joints = ()
    """Joints to map."""
    points: Annotated[int, tyro.conf.arg(metavar="NUMBER")] = 200
    """Values of R and of D, three decades of each."""
    out: Folder = Path("out/map")
    """Folder for a picture and the numbers (.npz) per joint; replaced as a whole."""

    def run(self) -> int:
        """Runs the command."""
        with waiting("starting"):
            from dashpot.commands.certify import map_gains

        return map_gains(self)
