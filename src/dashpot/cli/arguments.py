"""Arguments that commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

ROBOTS = "Robot TOML, or k807, fr3, iiwa14."
CONTROLLERS = "Controller TOML, or k807-wrist, k807-resonant, fr3, iiwa14."

RobotFile = Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="ROBOT", help=ROBOTS)]
ControllerFile = Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="CONTROLLER", help=CONTROLLERS)]
Folder = Annotated[Path, tyro.conf.arg(metavar="FOLDER")]
Flag = Annotated[bool, tyro.conf.FlagCreatePairsOff, tyro.conf.arg(help_behavior_hint="")]
Number = Annotated[int, tyro.conf.arg(metavar="NUMBER")]
PerCore = Annotated[int | None, tyro.conf.arg(metavar="NUMBER", help_behavior_hint="(default: one per core)")]
Mass = Annotated[float, tyro.conf.arg(metavar="KG")]
Offset = Annotated[tuple[float, ...], tyro.conf.arg(metavar="X [Y Z]")]
Joints = Annotated[
    tuple[str, ...], tyro.conf.arg(metavar="JOINT [JOINT ...]", help_behavior_hint="(default: all)")
]
Faults = Annotated[
    tuple[str, ...],
    tyro.conf.UseAppendAction,
    tyro.conf.arg(metavar="KIND[:JOINT]@START[-END][=VALUE]", help_behavior_hint="(default: none)"),
]
PayloadChanges = Annotated[
    tuple[str, ...],
    tyro.conf.UseAppendAction,
    tyro.conf.arg(metavar="TIME=KG", help_behavior_hint="(default: never)"),
]
