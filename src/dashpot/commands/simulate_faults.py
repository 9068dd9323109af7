"""Faults and changes of payload of ``dashpot simulate``: read, listed, marked in the picture."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from string import ascii_uppercase
from typing import Any

from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from rich.markup import escape
from rich.table import Table

from dashpot.arm.payload import Payload
from dashpot.arm.robot import Robot
from dashpot.commands.shared import bare_table, check_joints, of_flags
from dashpot.errors import InputError
from dashpot.simulation.faults import KINDS, NAMES, Fault
from dashpot.simulation.recording import Recording
from dashpot.simulation.simulate import PayloadChange
from dashpot.support.plots import BLACK, GREEN, PURPLE

TINT = 0.13  # opacity of the time a fault lasts


@dataclass(frozen=True)
class Mark:
    """One fault or change of payload as it is shown.

    Attributes:
        letter: In the list and in the picture.
        what: Kind of fault, or "payload".
        joint: Joint name, or "all".
        start: [s].
        end: [s]; infinite for what lasts.
        size: The value with its unit, in words.
        meaning: In words.
    """

    letter: str
    what: str
    joint: str
    start: float
    end: float
    size: str
    meaning: str

    @property
    def decision(self) -> bool:
        """Whether it is one of the supervisor."""
        return self.what.startswith("->")

    @property
    def colour(self) -> str:
        """Of its letter."""
        return GREEN if self.what == "payload" else BLACK if self.decision else PURPLE


def read_faults(texts: Sequence[str], robot: Robot) -> list[Fault]:
    """Reads ``--fault``.

    Raises:
        InputError: See `Fault.from_text`; or the robot has no such joint.
    """
    with of_faults():
        faults = [Fault.from_text(text) for text in texts]
    check_joints((fault.joint for fault in faults if fault.joint != "all"), robot, "--fault joint")
    return faults


@contextmanager
def of_faults() -> Iterator[None]:
    """Names the flag of a fault, or of a change of payload, that is refused below."""
    try:
        yield
    except InputError as error:
        quantity = error.quantity or ""
        if quantity == "payload change [s]":
            quantity = "--payload-at [s]"
        elif quantity.partition(" ")[0] in ("fault", *NAMES):
            quantity = f"--fault {quantity.removeprefix('fault ')}"
        else:
            raise
        raise InputError(error.rule, joint=error.joint, quantity=quantity, value=error.value) from None


def read_changes(texts: Sequence[str], like: Payload) -> list[PayloadChange]:
    """Reads ``--payload-at``; the masses hang where ``like`` does.

    Raises:
        InputError: A text is not TIME=KG, or a mass is not valid.
    """
    changes = []
    for text in texts:
        time, _, mass = text.partition("=")
        try:
            at, kilograms = float(time), float(mass)
        except ValueError:
            raise InputError(
                "must be TIME=KG, in s and kg, e.g. 2=3.5", quantity="--payload-at", value=text
            ) from None
        if not (math.isfinite(kilograms) and kilograms >= 0):
            raise InputError("must be finite and not negative", quantity="--payload-at [kg]", value=kilograms)
        with of_flags({"mass [kg]": "--payload-at [kg]"}):
            load = Payload(kilograms, like.offset) if kilograms > 0 else None
        changes.append(PayloadChange(at, load))
    return changes


def marks(
    robot: Robot, faults: Sequence[Fault], changes: Sequence[PayloadChange], recording: Recording
) -> list[Mark]:
    """Faults, changes and what a supervisor decided in the order of time, each with a letter."""
    found: list[tuple[Any, ...]] = [
        (fault.kind, fault.joint, fault.start, fault.end, _size(fault, robot), KINDS[fault.kind].meaning)
        for fault in faults
    ]
    for change in changes:
        mass = change.payload.mass if change.payload else 0.0
        meaning = "on the flange from then on" if mass else "the flange has let go"
        found.append(("payload", "all", change.time, math.inf, f"{mass:g} kg", meaning))
    found += _decided(recording)
    found.sort(key=lambda mark: mark[2])
    return [Mark(_letter(i), *mark) for i, mark in enumerate(found)]


def _decided(recording: Recording) -> list[tuple[Any, ...]]:
    """A supervisor's decisions; those of several joints at one tick for one reason are one."""
    said: Any = recording.settings.get("supervisor", {"decisions": []})
    groups: dict[tuple[Any, ...], list[dict[str, Any]]] = {}
    for decision in said["decisions"]:
        key = decision["tick"], decision["reason"], decision["after"]
        groups.setdefault(key, []).append(decision)
    rows = []
    for decisions in groups.values():
        first = decisions[0]
        joint = first["joint"] if len(decisions) == 1 and first["joint"] else "all"
        unit = f" {first['unit']}" if first["unit"] else ""
        size = (
            f"{first['value']:.3g} > {first['threshold']:.3g}{unit}" if math.isfinite(first["value"]) else ""
        )
        rows.append((f"-> {first['after']}", joint, first["time"], math.inf, size, first["words"]))
    return rows


def _letter(i: int) -> str:
    """A, B, ... Z, A1, B1, ..."""
    round_, letter = divmod(i, len(ascii_uppercase))
    return ascii_uppercase[letter] + (str(round_) if round_ else "")


def _size(fault: Fault, robot: Robot) -> str:
    kind = KINDS[fault.kind]
    if not kind.quantity:
        return ""
    unit = "" if kind.unit == "-" else f" {kind.unit}"
    if fault.value is None and fault.joint not in robot.joints and kind.default:
        sizes = sorted({fault.size(drive) for drive in robot.drives})
        return f"{sizes[0]:.4g}{unit}" if len(sizes) == 1 else f"{sizes[0]:.4g} to {sizes[-1]:.4g}{unit}"
    drive = robot.drives[robot.index(fault.joint)] if fault.joint != "all" else robot.drives[0]
    return f"{fault.size(drive):.4g}{unit}"


def listed(found: Sequence[Mark]) -> Table:
    """The marks as a table."""
    table = bare_table("What fails, what the flange carries, what the supervisor decides")
    for name in ("", "what", "joint"):
        table.add_column(name, no_wrap=True)
    for name in ("from [s]", "to [s]", "size"):
        table.add_column(escape(name), justify="right", no_wrap=True)
    table.add_column("meaning", style="dim")
    for mark in found:
        joint = "" if mark.what in ("payload", "brownout") else escape(mark.joint)
        end = "" if mark.decision else "end" if math.isinf(mark.end) else f"{mark.end:g}"
        table.add_row(mark.letter, mark.what, joint, f"{mark.start:g}", end, mark.size, mark.meaning)
    return table


def draw_marks(axis: Any, found: Sequence[Mark], joint: str, last: float, letters: bool) -> None:
    """Tints the time of every fault of a joint, and draws a line where the payload changes.

    Args:
        axis: Matplotlib axes over time [s].
        found: All marks.
        joint: The joint shown.
        last: End of the motion [s].
        letters: Whether to write the letters above.
    """
    taken: list[float] = []
    for mark in found:
        if mark.joint not in ("all", joint) and not mark.decision:
            continue
        if mark.what == "payload":
            axis.axvline(mark.start, color=GREEN, ls="-.", lw=1.0)
        elif mark.decision:
            axis.axvline(mark.start, color=BLACK, ls=(0, (4, 2)), lw=1.1)
        else:
            axis.axvspan(mark.start, min(mark.end, last), color=PURPLE, alpha=TINT, lw=0)
            axis.axvline(mark.start, color=PURPLE, lw=0.8)
        if letters:
            close = sum(abs(mark.start - other) < 0.04 * (last - axis.get_xlim()[0]) for other in taken)
            taken.append(mark.start)
            axis.annotate(
                mark.letter,
                (mark.start, 1.0),
                xycoords=axis.get_xaxis_transform(),
                xytext=(2 + 9 * close, -2),
                textcoords="offset points",
                va="top",
                fontsize=8.5,
                fontweight="bold",
                color=mark.colour,
                bbox={"boxstyle": "square,pad=0.05", "fc": "white", "ec": "none", "alpha": 0.7},
            )


def legend_entries(found: Sequence[Mark]) -> dict[str, Any]:
    """Labels and handles that say what the letters mean."""
    entries: dict[str, Any] = {}
    for mark in found:
        words = [f"{mark.letter}: {mark.what.replace('_', ' ')}"]
        if mark.joint != "all":
            words.append(mark.joint)
        if mark.size:
            words.append(mark.size)
        handle: Any = Patch(color=PURPLE, alpha=2 * TINT, lw=0)
        if mark.what == "payload":
            handle = Line2D([], [], color=GREEN, ls="-.", lw=1.0)
        elif mark.decision:
            handle = Line2D([], [], color=BLACK, ls=(0, (4, 2)), lw=1.1)
        entries[", ".join(words)] = handle
    return entries
