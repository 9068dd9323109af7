"""Random scripts for an exported controller, and both ways of running them: in Python, and compiled.

A script holds what a robot can do to a controller: inputs of all sizes, some of them not finite, changes of
mode and of the position loop, warm starts, presets, torques decided elsewhere; and under a supervisor, late
samples and stops asked for. Every torque, status and state must come out the same, bit for bit.
"""

from __future__ import annotations

import math
import subprocess
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import dashpot._native as _native
from dashpot.arm.drive import Drive
from dashpot.arm.robot import Robot
from dashpot.control.controller import ControllerConfig, Law, load_controller
from dashpot.control.jointlaw import JointGains
from dashpot.control.laws import LAWS
from dashpot.control.sampled import NX
from dashpot.control.supervisorsettings import SupervisorSettings
from dashpot.export.c import Export
from dashpot.export.compiler import compiler
from dashpot.support.arrays import Floats

NONE, MODE, LOOP, WARM, PRESET, RESET, ISSUE, STOP, SUPERVISOR_RESET = range(9)  # as in export_drive.c
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic")
SANITIZED = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g")
BUNDLED = (("k807", "k807-wrist"), ("k807", "k807-resonant"), ("fr3", "fr3"), ("iiwa14", "iiwa14"))


def bundled(robot: str, controller: str, *, supervised: bool = False) -> Export:
    """A bundled controller, without the certificate, which costs time and changes no arithmetic."""
    arm, settings = Robot.load(robot), SupervisorSettings() if supervised else None
    return Export(controller.replace("-", "_"), arm, load_controller(controller), None, settings)


def all_laws(latency: int = 0, form: Any = "implicit", *, supervised: bool = False) -> Export:
    """Every law there is, each on a joint of its own, one of them limited in torque rate."""
    laws: list[Law] = []
    for i, kind in enumerate(LAWS.values()):
        numbers: dict[str, float] = {"R": 3.0, "D": 2.5, "K": 0.5} if kind is JointGains else {}
        known = {
            key: 20.0 if key == "kp" else 2.0
            for key in ("kp", "kd", "ki")
            if key in kind.__dataclass_fields__
        }
        laws.append(_made(kind, f"joint{i}", known | numbers))
    drives = tuple(
        Drive(
            name=law.name,
            rotor_inertia=0.05,
            viscous_friction=0.6,
            stiffness=6e3,
            damping=0.7,
            torque_limit=20.0 + 5 * i,
            coulomb_friction=0.5,
            torque_noise=0.02,
            torque_rate_limit=math.inf if i % 3 else 2e3,
        )
        for i, law in enumerate(laws)
    )
    config = ControllerConfig(joints=tuple(laws), period=0.005, latency=latency, form=form)
    settings = SupervisorSettings() if supervised else None
    return Export("laws", Robot("bench", drives), config, None, settings)


def _made(kind: type[Law], name: str, numbers: dict[str, float]) -> Law:
    """A law with these numbers, and a half for whatever else it must be told."""
    from dataclasses import MISSING, fields

    for field in fields(kind):
        if field.name != "name" and field.default is MISSING and field.default_factory is MISSING:
            numbers.setdefault(field.name, 0.5)
    return kind(name, **numbers)


def script(export: Export, ticks: int, seed: int) -> Floats:
    """A random script, (ticks, width) as `export_drive.c` reads it."""
    rng = np.random.default_rng(seed)
    n, supervised = len(export.blocks), export.settings is not None
    rows = np.zeros((ticks, 7 + (9 if supervised else 7) * n))
    actions = [MODE, LOOP, WARM, PRESET, RESET]
    actions += [STOP, SUPERVISOR_RESET] if supervised else [ISSUE]
    rows[:, 0] = np.where(rng.random(ticks) < 0.05, rng.choice(actions, ticks), NONE)
    rows[:, 1] = rng.integers(-1, n + 1, ticks)  # joints that do not exist too
    mode, loop = rng.integers(-1, 4, ticks), rng.integers(0, 2, ticks)
    wild = rng.normal(size=ticks) * 10.0 ** rng.integers(-3, 3, ticks)
    wild[rng.random(ticks) < 0.1] = np.nan
    rows[:, 2] = np.select(
        [rows[:, 0] == MODE, rows[:, 0] == LOOP, rows[:, 0] == STOP],
        [mode, loop, rng.integers(0, 4, ticks)],
        wild,
    )
    rows[:, 3:7] = rng.normal(size=(ticks, NX))
    sizes = np.repeat([5.0, 0.02, 0.3, 0.02, 0.3, 1.0, 2.0], n)
    calm = np.cumsum(
        rng.normal(size=(ticks, 7 * n)) * 1e-4, axis=0
    )  # what a supervisor lets pass, in stretches
    loud = rng.normal(size=(ticks, 7 * n)) * 10.0 ** rng.integers(-2, 2, (ticks, 1))
    quiet = (np.arange(ticks) // 200 % 2 == 0)[:, None]
    inputs = sizes * np.where(quiet, np.mod(calm + 1, 2) - 1, loud)
    broken = rng.random(inputs.shape) < np.where(quiet, 0, 2e-3)
    inputs[broken] = rng.choice([np.nan, np.inf, -np.inf, 1e308, -1e308, 5e-324, -0.0], int(broken.sum()))
    rows[:, 7 : 7 + 7 * n] = inputs
    if supervised:
        rows[:, 7 + 7 * n :] = np.where(
            rng.random((ticks, 2 * n)) < 1e-3, rng.integers(-1, 6, (ticks, 2 * n)), 0
        )
        resets = np.arange(ticks) % 400 == 399
        rows[resets, 0] = SUPERVISOR_RESET
    return rows


def in_python(export: Export, rows: Floats) -> Floats:
    """Runs a script on the controller of Python: (ticks, n + 2) torques, status, supervisor's state."""
    n = len(export.blocks)
    core = export.controller.core
    guard = None
    if export.rules is not None and export.watch is not None:
        guard = _native.Guard(core, export.rules.reshape(1).view(np.uint8), export.watch.view(np.uint8))
    _fresh(core)
    result = np.zeros((len(rows), n + 2))
    out = np.zeros(n)
    actions = rows[:, :3]
    inputs = np.ascontiguousarray(rows[:, 7 : 7 + 7 * n]).reshape(-1, 7, n)
    for tick, (action, at, value) in enumerate(actions.tolist()):
        joint = int(at)
        if action and (0 <= joint < n or action in (RESET, ISSUE, STOP, SUPERVISOR_RESET)):
            _act(core, guard, int(action), joint, value, rows[tick, 3:7])
        if guard is not None:
            core.inputs[:] = inputs[tick]
            ages = rows[tick, 7 + 7 * n :].astype(np.int32)
            guard.torque_age[:], guard.encoder_age[:] = ages[:n], ages[n:]
            result[tick, n] = guard.step(out)
            result[tick, n + 1] = guard.state + 4 * guard.apply_brake
        elif action == ISSUE:
            result[tick, n] = core.issue(np.ascontiguousarray(inputs[tick, 0]), out)
        else:
            result[tick, n] = core.step(inputs[tick], out)
        result[tick, :n] = out
    return result


def _fresh(core: _native.Core) -> None:
    core.reset()
    for j in range(core.n):
        core.set_mode(j, 2)
        core.set_position_loop(j, True)
    core.reset()


def _act(
    core: _native.Core, guard: _native.Guard | None, action: int, joint: int, value: float, x: Floats
) -> None:
    if action == MODE:
        core.set_mode(joint, int(value))
    elif action == LOOP:
        core.set_position_loop(joint, bool(value))
    elif action == WARM:
        core.warm_start(joint, value)
    elif action == PRESET:
        core.preset(joint, x.copy(), value)
    elif action == RESET:
        core.reset()
    elif guard is not None and action == STOP:
        guard.stop(int(value))
    elif guard is not None and action == SUPERVISOR_RESET:
        guard.reset()


def write_sources(export: Export, folder: Path) -> list[str]:
    """Writes the exported pair and the program that runs scripts; gives the arguments to compile them."""
    (folder / f"{export.name}.c").write_text(export.source(), encoding="ascii")
    (folder / f"{export.name}.h").write_text(export.header(), encoding="ascii")
    drive = folder / "export_drive.c"
    drive.write_text(
        (files("dashpot") / "studies" / "export_drive.c").read_text(encoding="ascii"), encoding="ascii"
    )
    defined = [f"-DNAME={export.name}", f"-DUPPER={export.name.upper()}", f'-DHEADER="{export.name}.h"']
    defined += ["-DSUPERVISED"] if export.settings is not None else []
    return [f"-I{folder}", *defined]


def build(export: Export, folder: Path, flags: Sequence[str] = ("-O2",), name: str = "program") -> Path:
    """Compiles an export with the host's compiler, every warning an error.

    Raises:
        subprocess.CalledProcessError: It does not compile.
    """
    arguments = write_sources(export, folder)
    program, command = folder / name, compiler() or ["cc"]
    sources = [str(folder / f"{export.name}.c"), str(folder / "export_drive.c")]
    subprocess.run(
        [*command, *STRICT, *flags, "-DHOST", *arguments, *sources, "-o", str(program)],
        check=True,
        capture_output=True,
    )
    return program


def compiled(program: Path, export: Export, rows: Floats) -> Floats | None:
    """Runs a script on a program of `build`; None where the export's own check finds this build to differ."""
    done = subprocess.run([program], input=rows.tobytes(), capture_output=True, check=False)
    if done.returncode == 1 and not done.stderr:
        return None
    if done.returncode:
        raise RuntimeError(done.stderr.decode(errors="replace"))
    return np.frombuffer(done.stdout).reshape(-1, len(export.blocks) + 2)


def differing(a: Floats, b: Floats) -> int:
    """Ticks at which any bit differs, signs of zeros included."""
    bits: NDArray[np.bool_] = np.ascontiguousarray(a).view(np.uint64) != np.ascontiguousarray(b).view(
        np.uint64
    )
    return int(bits.any(axis=1).sum())
