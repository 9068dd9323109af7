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

BLOCK = re.compile(r"^```(?P<language>\w*)\n(?P<body>.*?)^```$", re.M | re.S)


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
    """A command as a page shows it, and the lines that follow it with their places in the page.

    A file that the page shows, its name in the first line, is a step, too: ``command`` writes it.
    """

    command: str
    shown: tuple[tuple[int, str], ...] = ()


def steps(text: str) -> Iterator[Step]:
    """The ``$`` lines and files of a page's blocks, in order; a block without ``$`` holds commands only."""
    for block in BLOCK.finditer(text):
        body, place = block["body"], block.start("body")
        if block["language"] not in ("", "console"):
            if named := re.match(r"# ([\w.-]+\.\w+)\n", body):
                yield Step(f"cat > {named[1]} <<'END'\n{body}END")
            continue
        prompts = body.startswith("$ ")
        command, going_on = "", False
        shown: list[tuple[int, str]] = []
        for line in body.splitlines():
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
    """What came of a session: the places of what a command printed again, and what it did not."""

    places: list[tuple[int, int]]
    wrong: list[str]


class Session:
    """A page's commands, typed one after the other in one folder.

    ``before`` is typed first. Commands that match an expression of ``skip`` are not typed; ``typed`` replaces
    parts of others, [part, other]. Of shown lines that match one of ``loose`` numbers are not compared (times
    of this machine). ``...`` stands for lines left out. At last every ``also`` is typed, whose ``prints``
    must be in the page and in what it prints, however the lines break.
    """

    def __init__(
        self, said: dict[str, Any], text: str, root: Path, same: Callable[[str, str, float], bool]
    ) -> None:
        """For what an account says, the page, the repository and what makes two lines the same."""
        self._said, self._text, self._root, self._same = said, text, root, same

    def run(self) -> Typed:
        """Types everything."""
        result = Typed([], [])
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            for command in self._said.get("before", []):
                _said(command, folder, self._root)
            for step in steps(self._text):
                if any(re.search(skip, step.command) for skip in self._said.get("skip", [])):
                    continue
                command = step.command
                for part, other in self._said.get("typed", []):
                    command = command.replace(part, other)
                self._compare(step, _said(command, folder, self._root).splitlines(), result)
            for also in self._said.get("also", []):
                self._quoted(also, " ".join(_said(also["type"], folder, self._root).split()), result)
        return result

    def _compare(self, step: Step, left: list[str], result: Typed) -> None:
        for place, line in step.shown:
            if line.strip() in ("...", ""):
                continue
            loose = any(re.search(expression, line) for expression in self._said.get("loose", []))
            tolerance = float("inf") if loose else float(self._said.get("tolerance", 0.0))
            at = next((i for i, other in enumerate(left) if self._same(line, other, tolerance)), None)
            if at is None:
                printed = "\n    ".join(left)
                result.wrong.append(f"$ {step.command}\n  does not print: {line}\n  but\n    {printed}")
                continue
            del left[: at + 1]
            result.places.append((place, place + len(line)))

    def _quoted(self, also: dict[str, Any], printed: str, result: Typed) -> None:
        for fragment in also["prints"]:
            words = r"\s+".join(re.escape(word) for word in fragment.split())
            found = list(re.finditer(words, self._text))
            result.places += [match.span() for match in found]
            if not found:
                result.wrong.append(f"“{fragment}”: not in the page")
            if not re.search(words, printed):
                result.wrong.append(f"$ {also['type']}\n  does not print: {fragment}\n  but\n    {printed}")
