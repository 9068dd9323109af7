"""The arm on the desk: ``simulate``, ``studio``, ``campaign``, ``report``, ``replay``, ``reproduce``."""

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
    PerCore,
    RobotFile,
)
from dashpot.support.waiting import waiting


@dataclass
class Simulate:
    """Simulate an arm under a controller, your own or bundled ones.

    Example: dashpot simulate k807 k807-wrist --payload 2 --fault encoder_frozen:joint6@2 --supervise
    """

    robot: RobotFile
    controller: ControllerFile
    payload: Mass = 0.0
    """Mass on the flange [kg]."""
    offset: Offset = (0.0,)
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
    fault: Faults = ()
    """Something that fails, e.g. encoder_lost:joint5@2 or torque_bias@2-3=4; may be given several times.
    docs/faults.md lists the kinds; times in s."""
    payload_at: PayloadChanges = ()
    """From this time on [s] the flange carries this mass [kg] at the same offset, 0: it has let go; may be
    given several times."""
    supervise: Flag = False
    """Run the supervisor around the controller, as on a robot: it checks every signal, brakes without
    encoders or without torque sensors, and closes the mechanical brakes last (docs/supervisor.md)."""
    gravity_compensation: Flag = True
    """The robot does not carry its own weight, though its file says that it does (docs/model.md): the
    controller has to."""
    seed: Number = 0
    """Seed of motion, sensor noise and dropped samples."""
    out: Folder = Path("out/simulate")
    """Folder for recording.npz and simulate.png; replaced as a whole."""
    log: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="(default: none)")] = None
    """Also write what the robot would have logged, for dashpot identify and plot: .csv, .parquet, or .mcap,
    which also holds the controller's states, energy and what happened."""

    def run(self) -> int:
        """Runs the command."""
        with waiting("starting"):
            from dashpot.commands.simulate import simulate

        return simulate(self)


@dataclass
class Studio:
    """Open the studio: a live arm in the browser, its controller, its certificate and its faults.

    Example: dashpot studio fr3 --payload 2

    Needs viser: `make studio` in a checkout, else dashpot doctor says how to get it. Works offline.
    """

    robot: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="ROBOT")] = "k807"
    """Robot TOML, or k807, fr3, iiwa14."""
    controller: Annotated[
        tyro.conf.Positional[str | None],
        tyro.conf.arg(metavar="CONTROLLER", help_behavior_hint="(default: that of the bundled robot)"),
    ] = None
    """Controller TOML, or k807-wrist, k807-resonant, fr3, iiwa14."""
    payload: Mass = 0.0
    """Mass on the flange to begin with [kg]."""
    offset: Offset = (0.0,)
    """Its centre in the flange frame [m]: one number along x, or three."""
    supervise: Flag = True
    """Begin without the supervisor in charge."""
    host: Annotated[str, tyro.conf.arg(metavar="ADDRESS")] = "127.0.0.1"
    """Address to listen at; others than this machine's own let others use the studio."""
    port: Annotated[int, tyro.conf.arg(metavar="NUMBER")] = 8080
    """Port; where it is taken, the next free one."""
    seed: Number = 0
    """Seed of sensor noise and motions."""
    run_for: Annotated[
        float | None, tyro.conf.arg(metavar="SECONDS", help_behavior_hint="(default: until Ctrl-C)")
    ] = None
    """End after this time [s], and print every 10 s what it costs."""

    def run(self) -> int:
        """Runs the command."""
        with waiting("starting"):
            from dashpot.commands.studio import studio

        return studio(self)


@dataclass
class Campaign:
    """Run a campaign of scenarios over payloads, poses, gains, drive errors, faults and seeds.

    Example: dashpot campaign --preset readiness --robot fr3 --controller fr3

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
    workers: PerCore = None
    """Local processes."""
    scheduler: Annotated[
        str | None, tyro.conf.arg(metavar="ADDRESS", help_behavior_hint="(default: local processes)")
    ] = None
    """Run on the Dask cluster of this scheduler, e.g. tcp://10.0.0.1:8786."""
    out: Annotated[Path, tyro.conf.arg(metavar="DATASET")] = Path("out/campaign.zarr")
    """Zarr folder for the results, an xarray Dataset; an unfinished one of the same campaign is continued."""

    def run(self) -> int:
        """Runs the command."""
        with waiting("starting"):
            from dashpot.commands.campaign import campaign

        return campaign(self)


@dataclass
class Report:
    """Judge a campaign against its requirements: verdicts, worst cases and pictures on one HTML page.

    Example: dashpot report out/campaign.zarr

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
        with waiting("starting"):
            from dashpot.commands.report import report

        return report(self)


@dataclass
class Replay:
    """Run one scenario of a campaign again, bit for bit, with the picture and recording of dashpot simulate.

    Example: dashpot replay out/campaign.zarr 17

    Exit status: 0 the measures are those of the dataset, 1 they differ or the simulation diverges, 2 bad
    input.
    """

    dataset: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DATASET")]
    """What dashpot campaign wrote."""
    index: Annotated[tyro.conf.Positional[int], tyro.conf.arg(metavar="INDEX")]
    """Index of the scenario."""
    out: Folder = Path("out/replay")
    """Folder for recording.npz and simulate.png; replaced as a whole."""

    def run(self) -> int:
        """Runs the command."""
        with waiting("starting"):
            from dashpot.commands.campaign import replay

        return replay(self)


@dataclass
class Reproduce:
    """Reproduce the paper's Figs. 4, 5 and 6 on a simulated arm, with a report and verdicts.

    Example: dashpot reproduce --seeds 10 --out out/paper
    """

    out: Folder = Path("out/paper")
    """Folder for figures, report.html and results.json; replaced as a whole."""
    seeds: Annotated[int, tyro.conf.arg(metavar="NUMBER")] = 10
    """Trajectories and noise streams per condition."""
    threads: PerCore = None
    """Threads."""

    def run(self) -> int:
        """Runs the command."""
        with waiting("starting"):
            from dashpot.commands.reproduce import reproduce

        return reproduce(self.out, self.seeds, self.threads)
