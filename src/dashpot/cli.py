"""The ``dashpot`` command."""

from __future__ import annotations

import sys
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from dashpot.errors import DashpotError, InputWarning


@dataclass
class Reproduce:
    """Reproduce the paper's Figs. 4, 5 and 6 on a simulated arm, with a report and verdicts."""

    out: Path = Path("out/paper")
    """Folder for figures, report.html and results.json; replaced as a whole."""
    seeds: int = 10
    """Trajectories and noise streams per condition."""
    threads: int | None = None
    """Threads (default: one per core)."""

    def run(self) -> int:
        """Runs the command."""
        from dashpot import commands

        return commands.reproduce(self.out, self.seeds, self.threads)


@dataclass
class Simulate:
    """Simulate an arm under a controller: your own files or bundled ones by name."""

    robot: tyro.conf.Positional[str]
    """Robot TOML, or k807, fr3, iiwa14."""
    controller: tyro.conf.Positional[str]
    """Controller TOML, or k807-wrist, k807-resonant, fr3, iiwa14."""
    payload: float = 0.0
    """Mass on the flange [kg]."""
    offset: float = 0.0
    """Its distance from the flange along the flange's x axis [m]."""
    motion: Literal["multisine", "hold"] = "multisine"
    """Random motion of all joints around home, or rest at home."""
    amplitude: float = 0.3
    """Of the motion, per joint [rad]."""
    duration: float = 6.0
    """Of the motion, after 1 s at rest [s]."""
    release: float | None = None
    """Remove the position loop's offset at this time [s]: from then on the torque sensors alone brake."""
    bypass: tuple[str, ...] = ()
    """Joints whose virtual passive control is bypassed: their position loop acts alone."""
    seed: int = 0
    """Seed of motion and sensor noise."""
    out: Path = Path("out/simulate")
    """Folder for recording.npz and simulate.png; replaced as a whole."""

    def run(self) -> int:
        """Runs the command."""
        from dashpot import commands

        return commands.simulate(self)


Command = (
    Annotated[Reproduce, tyro.conf.subcommand("reproduce")]
    | Annotated[Simulate, tyro.conf.subcommand("simulate")]
)


def _show_warning(message: Warning | str, category: type[Warning], *_: object, **__: object) -> None:
    label = "warning" if issubclass(category, InputWarning) else category.__name__
    print(f"dashpot: {label}: {message}", file=sys.stderr)


def main(arguments: list[str] | None = None) -> None:
    """Entry point; exits 0 on success, 1 where a verdict fails, 2 on bad input, 130 on Ctrl-C."""
    warnings.showwarning = _show_warning
    command = tyro.cli(
        Command,
        prog="dashpot",
        description="Virtual passive control for torque-sensed robot joints.",
        args=arguments,
    )
    try:
        status = command.run()
    except DashpotError as error:
        print(f"dashpot: error: {error}", file=sys.stderr)
        status = 2
    except KeyboardInterrupt:
        print("dashpot: stopped", file=sys.stderr)
        status = 130
    sys.exit(status)


if __name__ == "__main__":
    main()
