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
    motion: Literal["multisine", "hold"] = "multisine"
    """Random motion of all joints around home, or rest at home."""
    amplitude: Annotated[float, tyro.conf.arg(metavar="RAD")] = 0.3
    """Of the motion, per joint [rad]."""
    duration: Annotated[float, tyro.conf.arg(metavar="SECONDS")] = 6.0
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
    seed: Annotated[int, tyro.conf.arg(metavar="NUMBER")] = 0
    """Seed of motion and sensor noise."""
    out: Annotated[Path, tyro.conf.arg(metavar="FOLDER")] = Path("out/simulate")
    """Folder for recording.npz and simulate.png; replaced as a whole."""

    def run(self) -> int:
        """Runs the command."""
        from dashpot.commands.simulate import simulate

        return simulate(self)


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


Command = (
    Annotated[Reproduce, tyro.conf.subcommand("reproduce")]
    | Annotated[Certify, tyro.conf.subcommand("certify")]
    | Annotated[Map, tyro.conf.subcommand("map")]
    | Annotated[Simulate, tyro.conf.subcommand("simulate")]
)


def _show_warning(message: Warning | str, category: type[Warning], *_: object, **__: object) -> None:
    label = "warning" if issubclass(category, InputWarning) else category.__name__
    print(f"dashpot: {label}: {message}", file=sys.stderr)


class _Terminated(KeyboardInterrupt):
    """SIGTERM or SIGHUP."""


def _terminate(*_: object) -> None:
    raise _Terminated


@contextmanager
def _tidy_stop() -> Iterator[None]:
    """Lets SIGTERM and a closed terminal stop the command as Ctrl-C does: unfinished output is removed."""
    signals = [number for name in ("SIGTERM", "SIGHUP") if (number := getattr(signal, name, None))]
    if threading.current_thread() is not threading.main_thread():
        signals = []
    taken = [number for number in signals if signal.getsignal(number) is signal.SIG_DFL]
    for number in taken:
        signal.signal(number, _terminate)
    try:
        yield
    finally:
        for number in taken:
            signal.signal(number, signal.SIG_DFL)


def main(arguments: list[str] | None = None) -> None:
    """Entry point; exits 0 on success, 1 where a verdict is no or the simulation diverges, 2 on bad input.

    Ctrl-C exits 130, SIGTERM 143.
    """
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # a terminal without a character shows "?" for it
            stream.reconfigure(errors="replace")
    with warnings.catch_warnings():
        warnings.simplefilter("always", InputWarning)
        warnings.showwarning = _show_warning
        command = tyro.cli(
            Command,
            prog="dashpot",
            description="Virtual passive control for torque-sensed robot joints.",
            args=arguments,
        )
        try:
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
            status = 143 if isinstance(stop, _Terminated) else 130
            _leave_if_running(status)
    sys.exit(status)


def _leave_if_running(status: int) -> None:
    """Ends the process at once where the native loop still runs: its memory must not be freed under it."""
    from dashpot.commands import NATIVE_LOOP

    if any(thread.name == NATIVE_LOOP for thread in threading.enumerate()):
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


def _fail(message: str) -> int:
    print(f"dashpot: error: {message}", file=sys.stderr)
    return 2


if __name__ == "__main__":
    main()
