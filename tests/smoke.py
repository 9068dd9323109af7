"""What every installation of dashpot must do, with its core dependencies alone: `python smoke.py [--bare]`.

Needs an installed dashpot and nothing else, no file of the repository and no package for tests. With --bare
it insists that no extra is installed, so that every command that needs one is seen refusing.
"""

from __future__ import annotations

import contextlib
import importlib
import importlib.metadata
import importlib.util
import io
import os
import pkgutil
import platform
import struct
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import dashpot

EXTRAS = {
    "campaign": ("distributed", "xarray", "zarr"),
    "franka": ("pylibfranka",),
    "logs": ("lz4", "pyarrow", "zstandard"),
    "studio": ("trimesh", "viser"),
}
TESTS_ONLY = ("elftools", "fmpy", "hypothesis", "pinocchio", "playwright", "pytest", "sympy", "unicorn")
HEAVY = ("numpy", "scipy", "mujoco", "matplotlib", "rich", "tyro", "importlib.metadata", "dashpot._native")
FIRST_RESPONSE = 0.5  # [s] of processor time for `dashpot --help`


def missing(package: str) -> bool:
    """Whether a package is not installed."""
    return importlib.util.find_spec(package) is None


def command(*arguments: object) -> subprocess.CompletedProcess[str]:
    """Runs ``dashpot`` as installed for this interpreter."""
    program = Path(sys.executable).parent / "dashpot"
    return subprocess.run([program, *map(str, arguments)], capture_output=True, text=True, check=False)


def refused(extra: str, *arguments: object) -> None:
    """Where an extra is missing, a command names it in one line and does not start; in this process."""
    from dashpot.cli import main as dashpot_command

    if all(not missing(package) for package in EXTRAS[extra]):
        return
    said, status = io.StringIO(), None
    try:
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
            dashpot_command(list(map(str, arguments)))
    except SystemExit as end:
        status = end.code
    assert status == 2, (arguments, status, said.getvalue())
    lines = said.getvalue().splitlines()
    assert len(lines) == 1, (arguments, lines)
    assert lines[0].startswith("dashpot: error: "), lines
    assert f"pip install 'dashpot[{extra}]'" in lines[0], lines


def packed_log(path: Path, compression: bytes) -> Path:
    """An MCAP log of one chunk, compressed in a way that takes a package to read."""
    chunk = struct.pack("<QQQI", 0, 0, 1, 0) + struct.pack("<I", len(compression)) + compression
    chunk += struct.pack("<Q", 1) + b"\0"
    path.write_bytes(b"\x89MCAP0\r\n" + struct.pack("<BQ", 6, len(chunk)) + chunk)
    return path


def check_import_is_light(_: Path) -> None:
    """Nothing heavy is imported before it is used."""
    code = f"import sys, dashpot; print(*(name for name in {HEAVY} if name in sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "\n", done.stdout


def check_help_is_fast(_: Path) -> None:
    """The least of a few trials, in processor time: the machine may have other things to do."""
    took: list[float] = []
    while not took or (min(took) >= FIRST_RESPONSE and len(took) < 8):
        start = os.times()
        done = command("--help")
        end = os.times()
        assert done.returncode == 0, done.stderr
        assert "simulate" in done.stdout
        took.append(end.children_user - start.children_user + end.children_system - start.children_system)
    assert min(took) < FIRST_RESPONSE, took


def check_public_names(_: Path) -> None:
    """All there, and the version is that of the installed package."""
    assert all(getattr(dashpot, name) is not None for name in dashpot.__all__)
    assert dashpot.__version__ == importlib.metadata.version("dashpot")
    assert {"__version__", *dashpot.__all__} <= set(dir(dashpot))


def check_modules(_: Path) -> None:
    """Every module is imported with the core dependencies, or lacks a package of an extra."""
    extras = {package for packages in EXTRAS.values() for package in packages}
    for found in pkgutil.walk_packages(dashpot.__path__, "dashpot."):
        try:
            importlib.import_module(found.name)
        except ModuleNotFoundError as error:
            if error.name not in extras:
                raise


def check_certify(_: Path) -> None:
    """One bundled pair is certified, and one is not."""
    assert command("certify", "fr3", "fr3", "--json").returncode == 0
    assert command("certify", "k807", "k807-resonant", "--json").returncode == 1


def check_simulate(folder: Path) -> None:
    """A short run of the paper's arm, with its recording and picture."""
    import numpy as np

    done = command("simulate", "k807", "k807-wrist", "--duration", 0.2, "--out", folder / "run")
    assert done.returncode == 0, done.stderr
    with np.load(folder / "run" / "recording.npz") as recording:
        assert len(recording["time"]) > 100
        assert all(np.isfinite(recording[name]).all() for name in ("torque", "position", "link_position"))
    assert (folder / "run" / "simulate.png").stat().st_size > 10_000


def widths_of_this_machine() -> set[int]:
    """Lanes that the processor's registers have, as the kernel says."""
    info = Path("/proc/cpuinfo")
    flags = set(info.read_text().split()) if platform.machine() == "x86_64" and info.is_file() else set()
    return {2} | ({4} if "avx2" in flags else set()) | ({8} if {"avx512f", "avx512dq"} <= flags else set())


def check_lanes(_: Path) -> None:
    """The vectorised engine: every width of this machine, equal bits, and MuJoCo's motion."""
    import numpy as np

    from dashpot import Controller, Payload, Robot, Scenario, build, load_controller, multisine, run
    from dashpot.lanes import WIDTHS, run_lanes

    assert set(WIDTHS) == widths_of_this_machine(), WIDTHS
    robot, config = Robot.load("fr3"), load_controller("fr3")
    scenarios = [
        Scenario(
            build(robot, config.period, [Payload(mass, 0.1)]),
            Controller.from_config(config, robot.drives),
            multisine(robot.home, 0.05, config.period, seed, amplitude=0.1, lead_in=0.05),
        )
        for seed, mass in enumerate((0.0, 1.0, 2.0))
    ]
    reference = [run(scenario).link_position for scenario in scenarios]
    first = [recording.link_position for recording in run_lanes(scenarios, width=2)]
    for width in WIDTHS:
        found = [recording.link_position for recording in run_lanes(scenarios, width=width)]
        assert all(map(np.array_equal, found, first)), width
    assert np.abs(np.array(first) - np.array(reference)).max() < 1e-11


def check_export(folder: Path) -> None:
    """C and FMU: the core's text travels in the native module."""
    arguments = ("export", "fr3", "fr3", "--without-certificate")
    done = command(*arguments, "--to", "c", "--out", folder / "c")
    assert done.returncode == 1, done.stderr
    assert "fr3_step" in (folder / "c" / "fr3.c").read_text()
    done = command(*arguments, "--to", "fmu", "--sources-only", "--out", folder / "fmu")
    assert done.returncode == 1, done.stderr
    assert (folder / "fmu" / "fr3.fmu").read_bytes()[:2] == b"PK"


def check_extras(folder: Path) -> None:
    """What needs an extra says which."""
    (folder / "log.parquet").write_bytes(b"PAR1")
    simulate = ("simulate", "k807", "k807-wrist", "--out", folder / "never", "--log")
    identify = ("identify", "--robot", "k807", "--out", folder / "never")
    refused("studio", "studio")
    refused("campaign", "campaign", "--preset", "readiness", "--robot", "fr3", "--controller", "fr3")
    refused("campaign", "report", folder / "none.zarr")
    refused("campaign", "replay", folder / "none.zarr", 0)
    refused("franka", "run", "fr3", "fr3", "--via", "franka", "--host", "127.0.0.1", "--check")
    refused("logs", *simulate, folder / "never.parquet")
    refused("logs", *simulate, folder / "never.mcap")
    refused("logs", "plot", packed_log(folder / "zstd.mcap", b"zstd"))
    for log in (folder / "log.parquet", folder / "zstd.mcap", packed_log(folder / "lz4.mcap", b"lz4")):
        refused("logs", *identify, log)
    assert not list(folder.glob("never*"))


CHECKS: Sequence[Callable[[Path], None]] = (
    check_import_is_light,
    check_help_is_fast,
    check_public_names,
    check_modules,
    check_certify,
    check_simulate,
    check_lanes,
    check_export,
    check_extras,
)


def main() -> None:
    """Runs all checks; an AssertionError names the first that fails."""
    if "--bare" in sys.argv[1:]:
        packages = {*TESTS_ONLY, *(package for packages in EXTRAS.values() for package in packages)}
        assert not (found := [package for package in sorted(packages) if not missing(package)]), found
    place = Path(dashpot.__file__).parent
    print(f"dashpot {dashpot.__version__} at {place}, Python {platform.python_version()}")
    with tempfile.TemporaryDirectory() as name:
        os.chdir(name)  # so that no package is found in the folder that it is started from
        for check in CHECKS:
            before = os.times()
            check(Path(name))
            after = os.times()
            took = sum(after[:4]) - sum(before[:4])
            print(f"{check.__name__.removeprefix('check_'):16} {took:5.1f} s", flush=True)


if __name__ == "__main__":
    main()
