"""What the studio costs while somebody looks: `dashpot studio` with a page open in a headless Chromium.

    python -m dashpot.studies.studio_soak > docs/evidence/studio.json

The arm moves about home all the time. Processor time and memory are those of the studio and of the process
that proves its certificates, as the system counts them (/proc), without the browser; how fast the arm runs is
what the studio prints itself.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

from dashpot.errors import DashpotError
from dashpot.studies.visitor import COARSE, Visitor, chromium, until

EVERY = 10.0  # [s] between two looks
WARM = 120.0  # [s] until what is remembered of the last minute is full
LIMITS = {"processor": 0.4, "factor": 0.98, "growth_MB_per_min": 0.5}
TICKS = os.sysconf("SC_CLK_TCK")
PAGE = os.sysconf("SC_PAGE_SIZE")


def cost(pid: int) -> tuple[float, float]:
    """Processor time [s] and resident memory [MB] of a process and its children."""
    spent = resident = 0.0
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            stat = (folder / "stat").read_text().rpartition(")")[2].split()
            if pid in (int(folder.name), int(stat[1])):
                spent += (int(stat[11]) + int(stat[12])) / TICKS
                resident += int((folder / "statm").read_text().split()[1]) * PAGE / 1e6
        except (OSError, IndexError):
            continue  # it has just ended
    return spent, resident


def soak(robot: str, controller: str, seconds: float, rival: str) -> dict[str, Any]:
    """Runs it for some time [s].

    Raises:
        DashpotError: There is no browser, or the studio did not start.
    """
    command = ["studio", robot, controller, "--port", "8380", "--run-for", str(seconds + 120)]
    start = "from dashpot.cli import main; main()"
    with (
        chromium() as browser,
        subprocess.Popen(
            [sys.executable, "-c", start, *command], stdout=subprocess.PIPE, text=True, bufsize=1
        ) as process,
    ):
        try:
            assert process.stdout is not None
            first = process.stdout.readline()
            address = re.search(r"http://\S+", first)
            if address is None:
                raise DashpotError(f"the studio did not start: {first.strip()}")
            said: list[str] = []
            threading.Thread(target=lambda: said.extend(process.stdout or ()), daemon=True).start()
            visitor = Visitor(browser, address.group() + COARSE)
            until(lambda: visitor.has("#dp-state"), "the page")
            if rival:
                visitor.choose("beside it", rival)
            visitor.click("Arm", "[role=tab]")
            visitor.click("Move about home", "button")
            rows = _watch(process.pid, seconds, visitor)
        finally:
            process.terminate()
        factors = [float(x) for line in said for x in re.findall(r"real time x ([\d.]+)", line)]
    return _summary(command, rows, factors[1:], rival)


def _watch(pid: int, seconds: float, visitor: Visitor) -> list[tuple[float, float, float]]:
    """Time since the beginning [s], share of one core since the row before, memory [MB]."""
    begun = last = time.monotonic()
    spent, rows = cost(pid)[0], []
    while (now := time.monotonic()) - begun < seconds:
        visitor.page.wait_for_timeout(1e3 * min(EVERY, seconds - (now - begun)))
        now = time.monotonic()
        total, memory = cost(pid)
        rows.append((now - begun, (total - spent) / (now - last), memory))
        last, spent = now, total
        print(f"{rows[-1][0]:6.0f} s  {100 * rows[-1][1]:4.0f} %  {memory:6.1f} MB", file=sys.stderr)
    return rows


def _summary(
    command: list[str], rows: list[tuple[float, float, float]], factors: list[float], rival: str
) -> dict[str, Any]:
    when, share, memory = np.array(rows).T
    late = when > min(WARM, when[-1] / 2)
    growth = float(np.polyfit(when[late], memory[late], 1)[0] * 60) if late.sum() > 2 else 0.0
    found = {
        "command": "dashpot " + " ".join(command),
        "beside_it": rival,
        "seconds": round(float(when[-1]), 1),
        "processor_mean": round(float(share.mean()), 3),
        "processor_worst_10_s": round(float(share.max()), 3),
        "memory_MB": {"warm": round(float(memory[late][0]), 1), "end": round(float(memory[-1]), 1)},
        "growth_MB_per_min": round(growth, 3),
        "factor": {"mean": round(float(np.mean(factors)), 3), "least": min(factors)} if factors else None,
        "cores": os.cpu_count(),
        "load": os.getloadavg()[2],
        "rows_s_share_MB": [[round(float(x), 3) for x in row] for row in rows],
    }
    found["kept"] = bool(
        share.mean() < LIMITS["processor"]
        and growth < LIMITS["growth_MB_per_min"]
        and (not factors or np.mean(factors) > LIMITS["factor"])
    )
    return found


def main() -> int:
    """``python -m dashpot.studies.studio_soak``; exits 1 where a limit is not kept."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--robot", default="k807")
    parser.add_argument("--controller", default="k807-wrist")
    parser.add_argument("--run-for", type=float, default=600.0, metavar="SECONDS")
    parser.add_argument("--rival", default="", help="name of a controller beside it")
    options = parser.parse_args()
    found = soak(options.robot, options.controller, options.run_for, options.rival)
    print(json.dumps(found, indent=1))
    return 0 if found["kept"] else 1


if __name__ == "__main__":
    raise SystemExit(main())
