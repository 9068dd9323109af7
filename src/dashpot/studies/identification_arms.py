"""The bundled arms identified as a user would: ``excite``, ``simulate --log``, ``identify``.

``python -m dashpot.studies.identification_arms`` prints the result as JSON, ``make evidence-identify`` keeps
it in docs/evidence.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dashpot.arm.robot import Robot
from dashpot.cli import main as dashpot
from dashpot.control.controller import load_controller
from dashpot.errors import DashpotError

ARMS = (
    ("fr3", "fr3", 1.0, 0.1),
    ("iiwa14", "iiwa14", 2.0, 0.1),
    ("k807", "k807-wrist", 3.0, 0.15),
)
"""Robot, controller, payload [kg], its offset off the last axis [m]."""
COMPARED = {"rotor_inertia": "rotor inertia", "viscous_friction": "viscous friction"}
COMPARED |= {"coulomb_friction": "Coulomb friction"}


def typed(*words: str) -> None:
    """Types ``dashpot ...`` and throws away what it prints.

    Raises:
        DashpotError: It did not end well.
    """
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        try:
            dashpot(list(words))
            status: object = 0
        except SystemExit as end:
            status = end.code
    if status:
        raise DashpotError(f"dashpot {' '.join(words)}: exit status {status}\n{said.getvalue()}")


def arm(robot: str, controller: str, payload: float, offset: float) -> dict[str, Any]:
    """One arm: per quantity the largest error, median half-width, and joints outside their interval."""
    load = ["--payload", f"{payload:g}", "--offset", f"{offset:g}"]
    typed("excite", robot, "--controller", controller, *load)
    typed("simulate", robot, controller, *load, "--motion", "out/excite/motion.csv", "--log", "log.csv")
    sampling = load_controller(controller).sampling
    typed("identify", "log.csv", "--robot", robot, "--sampling", sampling)
    found = {j["name"]: j for j in json.loads(Path("out/identify/identify.json").read_text())["joints"]}
    drives = Robot.load(robot).drives
    row: dict[str, Any] = {"robot": robot, "controller": controller, "payload": payload, "offset": offset}
    for name in COMPARED:
        truth = np.array([getattr(drive, name) for drive in drives])
        values = [found[drive.name]["values"].get(name) for drive in drives]
        if None in values:
            raise DashpotError(f"{robot}: {name} was refused")
        value, low, high = (np.array([v[key] for v in values]) for key in ("value", "low", "high"))
        outside = (truth < low) | (high < truth)
        row[name] = {
            "largest_error": float(np.abs(value / truth - 1).max()),
            "median_half_width": float(np.median((high - low) / 2 / truth)),
            "outside": [drive.name for drive, out in zip(drives, outside, strict=True) if out],
        }
    row["joints"] = len(drives)
    row["damping_refused"] = [d.name for d in drives if "damping" not in found[d.name]["values"]]
    return row


def table(rows: Sequence[dict[str, Any]]) -> list[str]:
    """The rows of the table in docs/identify.md."""
    lines = [f"| arm, controller, payload | {' | '.join(COMPARED.values())} |", "|" + "---|" * 4]
    for row in rows:
        parts = [
            f"{100 * row[name]['largest_error']:.2g} % ({100 * row[name]['median_half_width']:.2g} %)"
            for name in COMPARED
        ]
        what = f"{row['robot']}, {row['controller']}, {row['payload']:g} kg at {row['offset']:g} m"
        lines.append(f"| {what} | {' | '.join(parts)} |")
    return lines


def main() -> None:
    """Prints the study as JSON."""
    rows = []
    for robot, controller, payload, offset in ARMS:
        with tempfile.TemporaryDirectory() as folder:
            before = Path.cwd()
            os.chdir(folder)
            try:
                rows.append(arm(robot, controller, payload, offset))
            finally:
                os.chdir(before)
    print(json.dumps({"command": "python -m dashpot.studies.identification_arms", "arms": rows}, indent=1))


if __name__ == "__main__":
    main()
