"""The design of a whole arm, as a user asks for it: search, proofs, pictures and report."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from measure import SETS, Rows

ASKED = ["fr3", "track", "--payload", "3", "--offset", "0", "0", "0.1"]


def design(rows: Rows) -> None:
    """Wall clock of the command, alone on the machine, processes and imports included."""
    seconds = np.zeros(SETS)
    for i in range(SETS):
        with tempfile.TemporaryDirectory() as folder:
            begin = time.perf_counter()
            command = [Path(sys.executable).with_name("dashpot"), "design", *ASKED, "--out", f"{folder}/out"]
            subprocess.run(command, check=True, capture_output=True)
            seconds[i] = time.perf_counter() - begin
    rows.section(f"dashpot design {' '.join(ASKED)}", "wall clock, all cores")
    rows.add("design_arm", "7 joints: search, proofs, pictures, report", seconds, "s", most=20)
