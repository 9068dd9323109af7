"""One joint on a test bench: a load hung on it, as files that `dashpot simulate` runs."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from dashpot.arm.drive import Drive, InnerLoop, Servo
from dashpot.certify.box import DRIVE
from dashpot.certify.counterexample import Counterexample
from dashpot.certify.loads import GRAVITY, Load
from dashpot.control.controller import ControllerConfig, JointGains, Law
from dashpot.simulation.recording import Recording
from dashpot.simulation.trajectory import Trajectory, hold
from dashpot.support.arrays import Floats

POINT_MASS = 1e-9  # share of a pendulum's inertia that is about its own centre; the engine wants some
KNOCK = 0.01  # [s]
HOT = 0.5  # of the torque limit, where watching ends
KNOCKS = (0.02, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2)  # of the torque limit, estimated from above
CYCLES, SAMPLED, LONGEST = 8, 32, 120.0  # watched; samples of a cycle; [s]
FEWEST, MODES = 12, 6  # samples, modes


def write(
    folder: Path,
    load: Load,
    drive: Drive,
    law: Law,
    config: ControllerConfig,
    point: Mapping[str, float] | None = None,
) -> tuple[Path, Path]:
    """Writes robot.toml, bench.xml and controller.toml for one joint with a load.

    Args:
        folder: Made where it is not there.
        load: Its stiffness becomes a weight below the axis: M g r, the same for small angles.
        drive: The joint's drive.
        law: Its law.
        config: The controller they belong to.
        point: Values to simulate instead of the nominal ones, as in `dashpot.certify.box.POINTS`; the law
            keeps resting on the nominal drive.

    Returns:
        Paths of the robot and of the controller file.
    """
    folder.mkdir(parents=True, exist_ok=True)
    point = point or {}
    changes: dict[str, Any] = {name: point[name] for name in DRIVE if name in point}
    actual = replace(drive, servo=None, uncertainty={}, **changes)
    scale, extra = (
        point.get("torque_gain", 1.0) - 1,
        int(point.get("latency", config.latency)) - config.latency,
    )
    actual = replace(
        actual, torque_scale_error=scale, torque_latency=drive.torque_latency + extra * config.period
    )
    position = point.get("position_gain", 1.0)
    model, robot, controller = (folder / name for name in ("bench.xml", "robot.toml", "controller.toml"))
    model.write_text(_mjcf(drive.name, load), encoding="utf-8")
    robot.write_text(
        f'# One joint with a load: {load}\nname = "bench"\nmodel = "bench.xml"\nhome = [0.0]\n\n'
        f"[[joint]]\n{_toml(actual)}",
        encoding="utf-8",
    )
    law = law.stated(drive).scaled_position(position)
    controller.write_text(
        f'period = {config.period!r}\nlatency = {config.latency}\nsampling = "{config.sampling}"\n'
        f'form = "{config.form}"\n\n[[joint]]\n{_toml(law)}',
        encoding="utf-8",
    )
    return robot, controller


def _toml(record: Drive | Law) -> str:
    lines = []
    for f in fields(record):
        value = getattr(record, f.name)
        if f.name == "identified" or value is None or value == f.default:
            continue
        if isinstance(value, Mapping) and not value:
            continue
        if isinstance(value, InnerLoop | Servo):
            inner = ", ".join(
                f"{key} = {number!r}" for key, number in vars(value).items() if math.isfinite(number)
            )
            lines.append(f"{f.name} = {{ {inner} }}")
        elif isinstance(value, str):
            lines.append(f"{f.name} = {json.dumps(value, ensure_ascii=False)}")  # a TOML string as well
            if f.name == "name" and isinstance(record, Law) and record.law != JointGains.law:
                lines.append(f'law = "{record.law}"')
        else:
            lines.append(f"{f.name} = {value if isinstance(value, int) else float(value)!r}")
    return "\n".join(lines) + "\n"


def _mjcf(joint: str, load: Load) -> str:
    """A body on one horizontal hinge with the load's inertia about it and its weight below it."""
    if load.stiffness == 0:
        mass, reach, own = min(max(load.inertia / 0.01, 0.01), 100.0), 0.0, load.inertia
    elif load.kind == "pendulum":
        mass, reach = load.payload
        own = load.inertia * POINT_MASS
    else:
        reach = GRAVITY * load.inertia / (2 * load.stiffness)
        mass, own = load.stiffness / (GRAVITY * reach), load.inertia / 2
    mass, reach, own = float(mass), float(reach), float(own)
    shown = min(max(reach, 0.02), 1.0)
    return f"""<mujoco model="bench">
  <compiler angle="radian"/>
  <option gravity="0 0 -{GRAVITY!r}"/>
  <worldbody>
    <body name="load">
      <joint name={quoteattr(joint, {chr(10): "&#10;"})} type="hinge" axis="0 1 0"/>
      <inertial pos="0 0 {-reach!r}" mass="{mass!r}" diaginertia="{own!r} {own!r} {own!r}"/>
      <geom type="capsule" fromto="0 0 0 0 0 {-shown!r}" size="0.01" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
</mujoco>
"""


def tap(path: Trajectory, joints: int, torque: float) -> Floats:
    """External torque (ticks, joints) that knocks the last link for `KNOCK` seconds from time 0 on [N m]."""
    external = np.zeros((len(path.position), joints))
    first = max(0, round(-path.start / path.period))
    external[first : first + max(1, round(KNOCK / path.period)), -1] = torque
    return external


@dataclass(frozen=True)
class Replay:
    """What a predicted oscillation did in the nonlinear simulator.

    Attributes:
        frequency: [Hz], of the strongest oscillation before anything saturates.
        growth: Rate of its amplitude [1/s].
        recording: The run.
    """

    frequency: float
    growth: float
    recording: Recording


def replay(robot: Path, controller: Path, expected: Counterexample, steps: int = 1) -> Replay:
    """Knocks the load of a written bench and watches the oscillation before anything saturates.

    Friction, limits and sensor noise act. Friction damps a small oscillation more than a large one: where it
    does not grow to half the torque limit, a harder knock follows, up to the last of `KNOCKS`.

    Args:
        robot: As `write` wrote it.
        controller: As `write` wrote it.
        expected: What was predicted.
        steps: Of the engine per period, at least. Its half-step shifts count where a law all but cancels the
            rotor and lives from the delay that is left.
    """
    from dashpot.arm.plant import build
    from dashpot.arm.robot import Robot
    from dashpot.control.controller import Controller
    from dashpot.simulation.simulate import Scenario, run

    arm, config = Robot.load(robot), ControllerConfig.load(controller)
    drive, load, period = arm.drives[0], expected.load, config.period
    omega = 2 * math.pi * expected.frequency
    # Torque per speed: of the load, swinging; of the transmission, at the knock.
    swinging = abs(load.inertia * omega - load.stiffness / omega)
    stiff = max(swinging, math.sqrt(drive.stiffness * drive.rotor_inertia))
    path = hold([0.0], min(max(3 * CYCLES / expected.frequency, 8 / expected.growth), LONGEST), period)
    plant = build(arm, period / steps)
    every = max(1, round(1 / (expected.frequency * period * SAMPLED)))
    room = HOT * math.exp(-CYCLES * expected.growth / expected.frequency)
    for share in (room, *KNOCKS):
        if share < room:
            continue
        speed = share * drive.torque_limit / stiff
        external = tap(path, 1, load.inertia * speed / (max(1, round(KNOCK / period)) * period))
        recording = run(Scenario(plant, Controller.from_config(config, arm.drives), path, external=external))
        hot = np.flatnonzero(~(np.abs(recording.command[:, 0]) < HOT * drive.torque_limit))
        last = int(hot[0]) if len(hot) else len(path.position)
        first = max(round(KNOCK / period) + 1, last - math.ceil(CYCLES / (expected.frequency * period)))
        frequency, rate = strongest(recording.torque[first:last:every, 0], period * every)
        if len(hot) and rate > 0:  # it grew, and friction did not stop it
            break
    return Replay(frequency, rate, recording)


def strongest(signal: Floats, period: float) -> tuple[float, float]:
    """Frequency [Hz] and growth rate [1/s] of the strongest oscillation in a signal, (ticks,).

    Matrix pencil of a few modes: exact for a sum of growing or decaying oscillations. (nan, nan) for fewer
    than `FEWEST` samples.
    """
    if len(signal) < FEWEST or not np.isfinite(signal).all() or not signal.any():
        return math.nan, math.nan
    hankel = np.lib.stride_tricks.sliding_window_view(signal, len(signal) // 3)
    left, sizes, _ = np.linalg.svd(hankel.T, full_matrices=False)
    order = max(2, min(MODES, int((sizes > 1e-4 * sizes[0]).sum())))
    basis = left[:, :order]
    roots = np.linalg.eigvals(np.linalg.lstsq(basis[:-1], basis[1:], rcond=None)[0]).astype(complex)
    roots = roots[np.abs(roots) > 1e-6]
    powers = roots[None, :] ** np.arange(len(signal))[:, None]
    amplitudes = np.linalg.lstsq(powers, signal.astype(complex), rcond=None)[0]
    energy = (np.abs(powers * amplitudes) ** 2).sum(0) * (np.abs(np.angle(roots)) > 1e-3)
    best = roots[energy.argmax()]
    return float(abs(np.angle(best)) / (2 * np.pi * period)), float(np.log(abs(best)) / period)


def suggested_tap(drive: Drive, expected: Counterexample) -> float:
    """A knock that shows an oscillation without reaching the torque limit at once [N m]."""
    inertia, omega = expected.load.inertia, 2 * math.pi * max(expected.frequency, 1e-3)
    lightest = min(inertia * omega, math.sqrt(drive.stiffness * drive.rotor_inertia))
    return 0.05 * drive.torque_limit / lightest * inertia / KNOCK


def hidden(drive: Drive, law: Law, expected: Counterexample) -> bool:
    """Whether Coulomb friction may take out more than an oscillation gains, up to the torque limit.

    Prediction and certificate are without it. As the law shows it, 1 + R times as large under the virtual
    passive one, it takes (2/pi) (1 + R) tau_c |q'| on average, where the oscillation gains growth J q'^2.
    """
    if drive.coulomb_friction == 0:
        return False
    balance = 2 / math.pi * law.friction_factor(drive) * drive.coulomb_friction
    torque = 0.5 * drive.torque_limit  # J omega q'
    return balance > expected.growth * torque / (2 * math.pi * max(expected.frequency, 1e-3))
