"""Names an exported controller may have in C."""

from __future__ import annotations

import re
from pathlib import Path

from dashpot.errors import InputError

LONGEST = 40
TAKEN = frozenset(
    (  # noqa: SIM905
        "auto break case char const continue default do double else enum extern float for goto if inline int "
        "long register restrict return short signed sizeof static struct switch typedef union unsigned void "
        "volatile while dp fmi2 fmi3 main"
    ).split()
)


def c_name(controller: str | Path, name: str | None = None) -> str:
    """The prefix of everything an export defines: as asked for, or from the controller's file name.

    >>> c_name("gains/k807-wrist.toml")
    'k807_wrist'

    Args:
        controller: File or bundled name of the controller.
        name: What the user wants, or None.

    Raises:
        InputError: The name is no lower-case C identifier of at most 40 letters, or means something in C.
    """
    if name is None:
        made = re.sub(r"[^a-z0-9]+", "_", Path(controller).stem.lower()).strip("_")[:LONGEST].strip("_")
        made = made if made[:1].isalpha() else f"controller_{made}".rstrip("_")[:LONGEST]
        return f"{made}_controller" if made in TAKEN else made
    if not re.fullmatch(rf"[a-z][a-z0-9_]{{0,{LONGEST - 1}}}", name):
        rule = f"must be 1 to {LONGEST} lower-case letters, digits and underscores, a letter first"
        raise InputError(rule, quantity="--name", value=name)
    if name in TAKEN:
        raise InputError("already means something in C; choose another", quantity="--name", value=name)
    return name
