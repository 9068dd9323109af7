"""What several commands share: names of files, a progress bar, a table, a check of where output goes."""

from __future__ import annotations

import re
import tempfile
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from dashpot.errors import InputError

if TYPE_CHECKING:
    from dashpot.arm.robot import Robot


def file_names(joints: Sequence[str]) -> dict[str, str]:
    """Names of joints without what a file system may refuse, each once."""
    names: dict[str, str] = {}
    for joint in joints:
        name = plain = re.sub(r"[^\w.-]+", "_", joint).strip(".") or "joint"
        number = 2
        while name.lower() in (taken.lower() for taken in names.values()):
            name, number = f"{plain}-{number}", number + 1
        names[joint] = name
    return names


@contextmanager
def of_flags(names: Mapping[str, str]) -> Iterator[None]:
    """Calls a quantity that is refused below what its flag is called.

    Args:
        names: Quantity -> flag, each with its unit.
    """
    try:
        yield
    except InputError as error:
        flag = names.get(error.quantity or "")
        if flag is None:
            raise
        raise InputError(error.rule, quantity=flag, value=error.value) from None


def check_joints(names: Iterable[str], robot: Robot, flag: str) -> None:
    """Checks that joints behind a flag are the robot's.

    Raises:
        InputError: One is not.
    """
    for name in names:
        if name not in robot.joints:
            rule = f"no such joint; {robot.name} has {', '.join(robot.joints)}"
            raise InputError(rule, quantity=flag, value=name)


def check_file_place(path: Path, flag: str, made: Path | None = None) -> None:
    """Checks that a file can be written where it shall be, before anything is done for it.

    Args:
        path: The file.
        flag: That names it.
        made: Folder that will be made, with those above it; None: none will.

    Raises:
        InputError: It cannot.
    """
    if path.is_dir():
        raise InputError("is a folder", quantity=flag, value=str(path))
    folder = path.resolve().parent
    if made is not None and (folder.is_relative_to(made.resolve()) or made.resolve().is_relative_to(folder)):
        return
    try:
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        rule = f"is in no folder that can be written: {error.strerror or error}"
        raise InputError(rule, quantity=flag, value=str(path)) from None


@contextmanager
def progress(label: str, steps: int) -> Iterator[Callable[[], None]]:
    """A bar on standard error where that is a terminal; calling what it gives advances it by one step."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console, disable=not console.is_terminal, transient=True) as bar:
        task = bar.add_task(label, total=steps)
        yield lambda: bar.advance(task)


@contextmanager
def clock(label: str, seconds: float) -> Iterator[Callable[[float], None]]:
    """A bar over simulated time [s] as `progress`; what it gives is told how far it has come."""
    so_far = TextColumn("{task.completed:.1f} of {task.total:.4g} s")
    columns = (TextColumn("{task.description}"), BarColumn(), so_far, TimeRemainingColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console, disable=not console.is_terminal, transient=True) as bar:
        task = bar.add_task(label, total=seconds)
        yield lambda time: bar.update(task, completed=time)


def verdict(good: bool, words: str) -> str:
    """A command's last word, in bold; what it is about follows it plain. Verdicts within tables are not."""
    return f"[bold {'green' if good else 'red'}]{words}[/]"


def print_command(console: Console, command: str) -> None:
    """Prints a command to be copied, dim: on a terminal it goes on below between its words, as a shell reads
    it, and elsewhere it is one line.
    """
    lines = [command]
    if console.is_terminal:
        lines = textwrap.wrap(command, console.width - 6, break_long_words=False, break_on_hyphens=False)
    text = " \\\n      ".join(lines)
    console.print(f"    {escape(text)}", highlight=False, soft_wrap=True, style="dim")


def bare_table(title: str) -> Table:
    """A table in the house style, without columns."""
    return Table(
        title=escape(title),
        title_justify="left",
        box=SIMPLE_HEAD,
        show_edge=False,
        pad_edge=False,
        collapse_padding=True,
    )


def new_table(title: str) -> Table:
    """A table in the house style, with its first column, the joint."""
    table = bare_table(title)
    table.add_column("joint")
    return table


def check_place(out: Path, read: Iterable[Path | None]) -> None:
    """Checks that a folder about to be replaced holds nothing that is read.

    Raises:
        InputError: It does.
    """
    place = out.resolve()
    for given in read:
        if given is not None and Path(given).resolve().is_relative_to(place):
            raise InputError(
                f"holds {given}, which is read; choose another folder", quantity="--out", value=str(out)
            )
