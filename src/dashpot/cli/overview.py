"""All commands by the stage of the way they belong to, and the page that ``dashpot --help`` prints."""

from __future__ import annotations

import inspect
import shutil
import textwrap
from typing import Any

from dashpot.cli.deploy import Export, FrankaServer, Run
from dashpot.cli.design import Certify, Design, Map
from dashpot.cli.identify import Excite, Identify, Plot
from dashpot.cli.install import Completion, Doctor
from dashpot.cli.simulate import Campaign, Replay, Report, Reproduce, Simulate, Studio

STAGES: dict[str, dict[str, type[Any]]] = {
    "Know the drives": {"excite": Excite, "plot": Plot, "identify": Identify},
    "Find gains and prove them": {"design": Design, "certify": Certify, "map": Map},
    "Try them on a simulated arm": {
        "simulate": Simulate,
        "studio": Studio,
        "campaign": Campaign,
        "report": Report,
        "replay": Replay,
        "reproduce": Reproduce,
    },
    "Go to the robot": {"run": Run, "export": Export, "franka-server": FrankaServer},
    "This installation": {"doctor": Doctor, "completion": Completion},
}
COMMANDS: dict[str, type[Any]] = {name: kind for stage in STAGES.values() for name, kind in stage.items()}
"""Every command by its name."""
_FIRST = """
dashpot simulate fr3 fr3 --payload 2   an arm, its controller, a picture
dashpot certify fr3 fr3                can any load make it oscillate?
dashpot design fr3 track --payload 3   gains of your own, certified
"""
NARROWEST, WIDEST = 80, 100  # characters


def overview(*, bold: bool = False) -> str:
    """The page: every command with a line, by stage; its headings bold for a terminal that knows how."""
    heading = "\x1b[1m{}\x1b[0m" if bold else "{}"
    width = min(max(shutil.get_terminal_size().columns, NARROWEST), WIDEST)
    indent = max(map(len, COMMANDS)) + 4
    lines = ["usage: dashpot COMMAND ... | dashpot COMMAND --help | dashpot --version", ""]
    lines += ["Virtual passive control for torque-sensed robot joints.", ""]
    for stage, commands in STAGES.items():
        lines.append(heading.format(stage))
        for name, kind in commands.items():
            words = textwrap.wrap(summary(kind), width - indent)
            lines.append(f"  {name}".ljust(indent) + words[0])
            lines += [" " * indent + more for more in words[1:]]
        lines.append("")
    lines += [heading.format("To begin with"), *(f"  {line}" for line in _FIRST.strip().splitlines())]
    lines += ["", "ROBOT and CONTROLLER are TOML files or names of bundled ones."]
    lines += ["Exit status: 0 done, 1 the answer is no, 2 bad input. Guides: docs/."]
    return "\n".join(lines)


def summary(kind: type[Any]) -> str:
    """The first sentence of a command's help."""
    return (inspect.getdoc(kind) or "").partition("\n\n")[0].replace("\n", " ").rstrip(".")
