"""The controller core's own text, made special: one arm, its coefficients as constants, names of its own.

What is exported is the text that was compiled into `dashpot._native`, so that simulated, certified and
exported controllers are one program. A few passages, each found exactly once, are replaced: coefficients and
settings become constants of the file, which leaves state alone in the structs. No arithmetic is touched.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator
from typing import NamedTuple

import dashpot._native as _native


class Texts(NamedTuple):
    """Parts of an exported pair of files, still with the core's names.

    Attributes:
        header: Constants, structs of state and prototypes.
        records: Structs of the coefficients, for the source file.
        code: The functions.
    """

    header: str
    records: str
    code: str


def core_texts(joints: int, latency: int) -> Texts:
    """The controller's text for a number of joints and a longest latency [ticks]."""
    header = _body(_native.SOURCES["dashpot_core.h"])
    header = _once(
        header,
        "enum { DP_MAX_JOINTS = 16, DP_NX = 4, DP_NW = 8, DP_MAX_LATENCY = 16 };",
        f"enum {{ DP_JOINTS = {joints}, DP_NX = 4, DP_NW = 8, DP_MAX_LATENCY = {max(1, latency)} }};",
    )
    header, block = _cut(header, r"/\* Coefficients of one joint;.*?\} dp_block;\n\n")
    header = _once(header, "    int n;\n    dp_block block[DP_MAX_JOINTS];\n", "")
    header, _ = _cut(header, r"/\* Copies n blocks .*?int dp_init\([^;]*;\n\n")
    header = _once(
        header,
        "/* Clears the state, keeps modes. */",
        "/* To be called first: all joints active, position loop on, zero torque. */\n"
        "void dp_init(dp_controller *c);\n\n/* Clears the state, keeps modes. */",
    )
    code, _ = _cut(_included(_native.SOURCES["dashpot_core.c"]), r"int dp_init\(.*?^\}\n\n")
    code = _once(
        code,
        "void dp_reset(dp_controller *c)\n",
        "void dp_init(dp_controller *c)\n{\n"
        "    for (int j = 0; j < DP_JOINTS; j++) {\n"
        "        c->state[j].mode = DP_MODE_ACTIVE;\n"
        "        c->state[j].position_loop = 1;\n    }\n"
        "    dp_reset(c);\n}\n\nvoid dp_reset(dp_controller *c)\n",
    )
    return Texts(*(_constants(text) for text in (header, block, code)))


def supervisor_texts() -> Texts:
    """The supervisor's text; it needs that of the controller."""
    header = _body(_native.SOURCES["dashpot_supervisor.h"])
    header, watch = _cut(header, r"/\* What is known of one joint;.*?\} dp_watch;\n\n")
    header, rules = _cut(header, r"typedef struct \{\n    double period; .*?\} dp_rules;\n\n")
    header = _once(header, "    int n, state;\n", "    int state;\n")
    header = _once(header, "    dp_rules rules;\n    dp_watch watch[DP_MAX_JOINTS];\n", "")
    header, _ = _cut(header, r"/\* Copies the settings\..*?int dp_supervisor_init\([^;]*;\n\n")
    header = _once(
        header,
        "/* Back to TRACK with every",
        "/* To be called first, after dp_init. */\nvoid dp_supervisor_init(dp_supervisor *s);\n\n"
        "/* Back to TRACK with every",
    )
    code, _ = _cut(_included(_native.SOURCES["dashpot_supervisor.c"]), r"int dp_supervisor_init\(.*?^\}\n\n")
    for shared in (r"static int finite\(double x\) \{[^}]*\}\n\n", r"static double clamp\(.*?^\}\n\n"):
        code, text = _cut(code, shared)
        if text not in _native.SOURCES["dashpot_core.c"]:
            raise RuntimeError(f"core and supervisor disagree about {text.split('(')[0]}")
    code = _once(
        code,
        "void dp_supervisor_reset(",
        "void dp_supervisor_init(dp_supervisor *s)\n{\n    *s = (dp_supervisor){0};\n}\n\n"
        "void dp_supervisor_reset(",
    )
    return Texts(*(_constants(text) for text in (header, watch + rules, code)))


def renamed(text: str, prefix: str) -> str:
    """The text with ``dp_`` and ``DP_`` replaced, lines that hang under a bracket moved along."""
    lines: list[str] = []
    hangs: tuple[int, int] | None = None  # column of the bracket before and after
    for line in text.split("\n"):
        new = re.sub(r"\bdp_", f"{prefix}_", line)
        new = re.sub(r"\bDP_", f"{prefix.upper()}_", new)
        indent = len(line) - len(line.lstrip(" "))
        if hangs is not None and indent == hangs[0] + 1:
            new = " " * (hangs[1] + 1) + new.lstrip(" ")
        else:
            hangs = None
        old_open, new_open = _open_bracket(line), _open_bracket(new)
        if old_open is not None and new_open is not None:
            hangs = old_open, new_open
        lines.append(new)
    return "\n".join(_aligned(text.split("\n"), lines))


def _aligned(old: list[str], new: list[str]) -> Iterator[str]:
    """The new lines, trailing comments of neighbours that were in one column in one column again."""

    def column(line: str) -> tuple[int, int] | None:
        found = re.search(r"(?<=\S) +(?=/\*)", line)
        return found.span() if found else None

    for _, group in itertools.groupby(range(len(old)), key=lambda i: (column(old[i]) or (0, 0))[1]):
        members = list(group)
        places = [column(new[i]) for i in members]
        width = max((place[0] + 1 for place in places if place), default=0)
        for i, place in zip(members, places, strict=True):
            line = new[i]
            yield line if place is None else f"{line[: place[0]]:{width}}{line[place[1] :]}"


def _open_bracket(line: str) -> int | None:
    """Column of the last bracket that a line opens and does not close."""
    opened = []
    for column, letter in enumerate(line):
        if letter == "(":
            opened.append(column)
        elif letter == ")" and opened:
            opened.pop()
    return opened[-1] if opened else None


def _constants(text: str) -> str:
    for field, constant in (
        (r"[cs]->n\b", "DP_JOINTS"),
        (r"\bc->block\[", "BLOCKS["),
        (r"\bs->watch\[", "WATCH["),
        (r"\bs->rules\b", "RULES"),
        (r"\bDP_MAX_JOINTS\b", "DP_JOINTS"),
    ):
        text = re.sub(field, constant, text)
    return text


def _body(header: str) -> str:
    found = re.search(r'extern "C" \{\n#endif\n\n(.*)#ifdef __cplusplus\n\}', header, re.DOTALL)
    if found is None:
        raise RuntimeError("a header of the core has another form")
    return found[1]


def _included(code: str) -> str:
    return re.sub(r'#include "[^"]*"\n\n', "", code)


def _once(text: str, old: str, new: str) -> str:
    if text.count(old) != 1:
        raise RuntimeError(f"the core's text has {text.count(old)} of {old!r}, not one")
    return text.replace(old, new)


def _cut(text: str, pattern: str) -> tuple[str, str]:
    """The text without the one passage that fits, and that passage."""
    found = list(re.finditer(pattern, text, re.DOTALL | re.MULTILINE))
    if len(found) != 1:
        raise RuntimeError(f"the core's text has {len(found)} of {pattern!r}, not one")
    return text[: found[0].start()] + text[found[0].end() :], found[0][0]
