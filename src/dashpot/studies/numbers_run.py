"""Types what the pages show: single commands, and the ``$`` lines of a page with what they print."""

from __future__ import annotations

import functools
import os
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

BLOCK = re.compile(r"^```(?:console)?\n(.*?)^```$", re.M | re.S)


def _environment(root: Path) -> dict[str, str]:
    here = str(Path(sys.executable).parent)
    plain = {"COLUMNS": "130", "NO_COLOR": "1", "TERM": "dumb", "ROOT": str(root)}
    return os.environ | plain | {"PATH": here + os.pathsep + os.environ["PATH"]}


def _said(command: str, folder: Path, root: Path) -> str:
    done = subprocess.run(
        ["bash", "-c", command], cwd=folder, env=_environment(root), capture_output=True, text=True
    )
    return done.stdout + done.stderr


@functools.cache
def printed(command: str, root: Path) -> str:
    """What a command prints, run in an empty folder.

    Raises:
        RuntimeError: it ends with a status other than 0; with what it said.
    """
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run(
            shlex.split(command), cwd=folder, env=_environment(root), capture_output=True, text=True
        )
    if done.returncode:
        raise RuntimeError(f"{command}: exit status {done.returncode}\n{done.stdout}{done.stderr}")
    return done.stdout


@dataclass(frozen=True)
class Step:
    """A command as a page shows it, the lines that follow it, and where these stand in the page."""

    command: str
    shown: tuple[tuple[int, str], ...]


def steps(text: str) -> Iterator[Step]:
    """The ``$`` lines of a page's blocks, in order; a block without any holds commands only, or nothing."""
    for block in BLOCK.finditer(text):
        prompts = block[1].startswith("$ ")
        command, place, going_on = "", block.start(1), False
        shown: list[tuple[int, str]] = []
        for line in block[1].splitlines():
            if going_on:
                command += "\n" + line
            elif line.startswith("$ ") or not prompts:
                if command:
                    yield Step(command, tuple(shown))
                command, shown = line.removeprefix("$ "), []
            else:
                shown.append((place, line))
            going_on = line.endswith("\\")
            place += len(line) + 1
        if command:
            yield Step(command, tuple(shown))


@dataclass
class Typed:
    """What came of a session: the places of lines that a command printed again, and what it did not."""

    places: list[tuple[int, int]]
    wrong: list[str]


def typed(session: dict[str, Any], text: str, root: Path, same: Callable[[str, str, float], bool]) -> Typed:
    """Types a page's commands in one empty folder and compares what they print with what the page shows.

    ``before`` is typed first. Commands that match an expression of ``skip`` are not typed. Of shown lines
    that match one of ``loose`` numbers are not compared (times of this machine). ``...`` stands for lines
    left out.
    """
    result = Typed([], [])
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for command in session.get("before", []):
            _said(command, folder, root)
        for step in steps(text):
            if any(re.search(skip, step.command) for skip in session.get("skip", [])):
                continue
            said = _said(step.command, folder, root).splitlines()
            left = list(said)
            for place, line in step.shown:
                if line.strip() in ("...", ""):
                    continue
                loose = any(re.search(expression, line) for expression in session.get("loose", []))
                tolerance = float("inf") if loose else float(session.get("tolerance", 0.0))
                at = next((i for i, other in enumerate(left) if same(line, other, tolerance)), None)
                if at is None:
                    result.wrong.append(
                        f"$ {step.command}\n    does not print: {line}\n    but " + "\n    ".join(left)
                    )
                    continue
                del left[: at + 1]
                result.places.append((place, place + len(line)))
    return result
