"""What is verified before any torque is sent: limits, certificate, and what the sensors say at rest."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import dashpot._native as _native
from dashpot.arm.drive import Drive
from dashpot.certify.digest import digest
from dashpot.control.controller import Controller, ControllerConfig
from dashpot.control.supervisor import SupervisorSettings
from dashpot.errors import DashpotError, InputError
from dashpot.hardware.interface import Hardware, Sample
from dashpot.simulation.trajectory import Trajectory
from dashpot.support.arrays import Floats

NEAR = 0.05  # [rad] from where the arm is to where a motion begins
RATE = 0.01  # relative error of the robot's cycle
LOST = 1e-3  # of the samples
FIRST = 10  # samples that are not looked at: they may have waited for us
NOISE = 1.5  # over what the drive states
ROUNDING = 1e-9


@dataclass(frozen=True)
class Check:
    """One line of the checklist.

    Attributes:
        name: What is checked.
        joint: The joint nearest to its bound, or "".
        value: Seen, with its unit.
        bound: Asked for, with its unit.
        passed: None: cannot be checked, and `bound` says why.
    """

    name: str
    joint: str
    value: str
    bound: str
    passed: bool | None


@dataclass(frozen=True)
class Verdicts:
    """What a certificate says about each joint.

    Attributes:
        joints: Names.
        tracking: Certified, per joint.
        brake: Certified without encoder, per joint.
        margin: Worst index over that of the bare drive [-], per joint; None: none.
        digest: Of what was certified; "": of what runs, it was certified just now.
        file: Where it was read from, or None.
    """

    joints: tuple[str, ...]
    tracking: tuple[bool, ...]
    brake: tuple[bool, ...]
    margin: tuple[float | None, ...]
    digest: str = ""
    file: Path | None = None

    @classmethod
    def load(cls, path: Path) -> Verdicts:
        """Reads the certificate.json of ``dashpot certify``.

        Raises:
            InputError: It is none.
        """
        try:
            table = json.loads(path.read_text(encoding="utf-8"))
            return cls.of(table, str(table["digest"]), path)
        except FileNotFoundError:
            raise InputError("no such file; dashpot certify writes one", file=path) from None
        except (OSError, ValueError, KeyError, TypeError):
            raise InputError(
                "not a certificate with a digest; run dashpot certify again", file=path
            ) from None

    @classmethod
    def of(cls, table: dict[str, Any], about: str = "", file: Path | None = None) -> Verdicts:
        """From `Certificate.table`."""
        rows = table["joints"]
        return cls(
            tuple(str(row["name"]) for row in rows),
            tuple(row["certified"] is True for row in rows),
            tuple(row["brake"] is None or row["brake"]["certified"] is True for row in rows),
            tuple(row["margin"] for row in rows),
            about,
            file,
        )


def before_link(
    drives: Sequence[Drive],
    config: ControllerConfig,
    controller: Controller,
    verdicts: Verdicts | None,
    settings: SupervisorSettings,
    *,
    path: Trajectory | None = None,
    ranges: dict[str, tuple[float, float]] | None = None,
) -> list[Check]:
    """Everything that needs no robot.

    Args:
        drives: Of the controller's joints, in its order.
        config: The controller file.
        controller: What will run.
        verdicts: Of the certificate; None: none is asked for.
        settings: Of the supervisor.
        path: The motion, columns in the controller's order; None: the arm is held where it is.
        ranges: Joint -> range [rad], as far as known.
    """
    names, blocks = controller.joints, controller.blocks
    checks = _certificate(drives, config, controller, verdicts)
    limit = np.array([drive.torque_limit for drive in drives])
    checks.append(_worst("torque limit", names, blocks["torque_limit"], limit, "{:.4g} N m", "{:.4g} N m"))
    rate = np.array([drive.torque_rate_limit for drive in drives])
    asked = blocks["rate_limit"] / controller.period
    checks.append(_worst("torque rate", names, asked, rate, "{:.4g} N m/s", "{:.4g} N m/s"))
    if path is not None:
        checks += _motion(names, path, settings, ranges or {})
    return checks


def _certificate(
    drives: Sequence[Drive], config: ControllerConfig, controller: Controller, verdicts: Verdicts | None
) -> list[Check]:
    if verdicts is None:
        return [Check("certificate", "", "none", "--uncertified", None)]
    about = digest(drives, controller.blocks, config)
    if verdicts.digest not in ("", about):
        seen, wanted = verdicts.digest[:12], about[:12]
        return [Check("certificate", "", f"of {seen}", f"of {wanted}: what runs", False)]
    checks = []
    for name, passed in (("certificate", verdicts.tracking), ("certificate as brake", verdicts.brake)):
        bad = [joint for joint, good in zip(verdicts.joints, passed, strict=True) if not good]
        margins = [(m, j) for m, j in zip(verdicts.margin, verdicts.joints, strict=True) if m is not None]
        least, joint = min(margins, default=(0.0, ""))
        value = f"{len(passed) - len(bad)} of {len(passed)}"
        if margins and not bad and name == "certificate":
            value += f", margin {least:.2g} x"
        checks.append(
            Check(
                name, bad[0] if bad else joint if name == "certificate" else "", value, "all joints", not bad
            )
        )
    return checks


def _worst(name: str, names: Sequence[str], value: Floats, most: Floats, said: str, bound: str) -> Check:
    """The joint whose value is largest compared with what it may be at most."""
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.where(np.isinf(most), np.where(np.isinf(value), 0.0, -1.0), value / most)
    share = np.where(np.isnan(value), np.inf, share)
    j = int(np.argmax(share))
    good = bool(np.all((value <= most * (1 + ROUNDING)) | np.isinf(most)))
    return Check(name, names[j], said.format(value[j]), f"at most {bound.format(most[j])}", good)


def _motion(
    names: Sequence[str],
    path: Trajectory,
    settings: SupervisorSettings,
    ranges: dict[str, tuple[float, float]],
) -> list[Check]:
    checks = []
    if ranges:
        checks.append(_within("motion: angle", names, path.position, ranges))
    speed = np.abs(path.velocity).max(0)
    most = np.full(len(names), settings.speed_limit)
    checks.append(_worst("motion: speed", names, speed, most, "{:.3g} rad/s", "{:.3g} rad/s"))
    return checks


def _within(name: str, names: Sequence[str], angles: Floats, ranges: dict[str, tuple[float, float]]) -> Check:
    """The joint that comes nearest to the end of its range; angles are (ticks, n)."""
    bounds = np.array([ranges.get(joint, (-np.inf, np.inf)) for joint in names])
    low, high = angles.min(0), angles.max(0)
    room = np.minimum(low - bounds[:, 0], bounds[:, 1] - high)
    room = np.where(np.isnan(room), -np.inf, room)
    j = int(np.argmin(room))
    seen = f"{low[j]:.3f} to {high[j]:.3f} rad"
    bound = f"{bounds[j, 0]:.3f} to {bounds[j, 1]:.3f} rad"
    return Check(name, names[j], seen, bound, bool(room[j] >= 0))


@dataclass(frozen=True)
class Heard:
    """Samples of an arm at rest, in the controller's order.

    Attributes:
        time: On the robot's clock, (t,) [s].
        arrival: On the host's, (t,) [s].
        torque: (t, n) [N m].
        position: (t, n) [rad].
        velocity: (t, n) [rad/s].
        age: Largest age of any signal [ticks].
    """

    time: Floats
    arrival: Floats
    torque: Floats
    position: Floats
    velocity: Floats
    age: int


def listen(hardware: Hardware, controller: Controller, samples: int) -> Heard:
    """Reads samples without taking the robot over.

    Raises:
        DashpotError: The robot ends it.
    """
    order = [hardware.joints.index(name) for name in controller.joints]
    sample, n = Sample.of(hardware.joints), len(order)
    time_, arrival = np.zeros(samples), np.zeros(samples)
    signals = np.zeros((3, samples, n))
    age = 0
    begun = time.monotonic_ns()
    for i in range(-FIRST, samples):
        if not hardware.paced:
            _native.sleep_until(begun + round((i + FIRST) * hardware.period * 1e9))
        if not hardware.read(sample):
            raise DashpotError(f"the robot gives no samples: {hardware.reason or 'no reason given'}")
        if i < 0:
            continue
        time_[i], arrival[i] = sample.time, time.monotonic()
        for k, array in enumerate((sample.torque, sample.position, sample.velocity)):
            signals[k, i] = array[order]
        age = max(age, int(sample.torque_age.max()), int(sample.encoder_age.max()))
    torque, position, velocity = signals
    return Heard(time_, arrival, torque, position, velocity, age)


def at_rest(
    heard: Heard,
    drives: Sequence[Drive],
    controller: Controller,
    settings: SupervisorSettings,
    *,
    path: Trajectory | None = None,
    ranges: dict[str, tuple[float, float]] | None = None,
    load: Floats | None = None,
    realtime: bool = True,
) -> list[Check]:
    """What the samples of an arm at rest say.

    Args:
        heard: The samples.
        drives: Of the controller's joints, in its order.
        controller: What will run.
        settings: Of the supervisor.
        path: The motion, columns in the controller's order, or None.
        ranges: Joint -> range [rad], as far as known.
        load: Torque that gravity puts on the joints at the mean position, (n,) [N m]; None: no model says.
        realtime: Whether arrival times mean anything.
    """
    names = controller.joints
    checks = _clock(heard, controller.period, settings, realtime)
    noise = heard.torque.std(0, ddof=1)
    stated = np.array([np.hypot(d.torque_noise, d.torque_resolution / np.sqrt(12)) for d in drives])
    if (stated > 0).all():
        most = NOISE * stated
        checks.append(_worst("torque noise", names, noise, most, "{:.3g} N m", "{:.3g} N m"))
        still = [
            name for name, change in zip(names, np.ptp(heard.torque, axis=0), strict=True) if change == 0
        ]
        value = still[0] if still else "all change"
        checks.append(Check("torque sensors", still[0] if still else "", value, "none repeats", not still))
    else:
        joint = names[int(np.argmin(stated))]
        checks.append(Check("torque noise", joint, f"{noise.max():.3g} N m", "robot file states none", None))
    checks.append(_bias(heard, drives, names, settings, load))
    where = heard.position.mean(0)
    if ranges:
        checks.append(_within("angle", names, heard.position, ranges))
    speed = np.abs(heard.velocity.mean(0))
    most = np.full(len(names), settings.still_speed)
    checks.append(_worst("speed at rest", names, speed, most, "{:.2g} rad/s", "{:.2g} rad/s"))
    if path is not None:
        away = np.abs(path.position[0] - where)
        near = np.full(len(names), NEAR)
        checks.append(_worst("way to the motion", names, away, near, "{:.3f} rad", "{:.3f} rad"))
    return checks


def _clock(heard: Heard, period: float, settings: SupervisorSettings, realtime: bool) -> list[Check]:
    steps = np.diff(heard.time)
    new = steps[steps > 0]
    if len(new) == 0 or not np.isfinite(heard.time).all():
        return [Check("robot's clock", "", "stands", "goes on", False)]
    typical = float(np.median(new))
    lost = int(np.round(new / period - 1).clip(0).sum())
    most = max(1, int(LOST * len(heard.time)))
    checks = [
        Check(
            "robot's cycle",
            "",
            f"{1e3 * typical:.4g} ms",
            f"{1e3 * period:.4g} ms, within {100 * RATE:g} %",
            abs(typical / period - 1) <= RATE,
        ),
        Check(
            "samples lost",
            "",
            f"{lost} of {len(heard.time)}",
            f"at most {most}",
            lost <= most,
        ),
        Check(
            "age of samples",
            "",
            f"{heard.age} ticks",
            f"at most {min(settings.torque_age, settings.encoder_age)} ticks",
            heard.age <= min(settings.torque_age, settings.encoder_age),
        ),
    ]
    if realtime:
        jitter = np.abs(np.diff(heard.arrival) - period)
        late = float(np.quantile(jitter, 0.99))
        said = f"{1e6 * late:.0f} us"
        bound = f"below {1e6 * period:.0f} us"
        checks.insert(1, Check("jitter, 99 %", "", said, bound, late < period))
    return checks


def _bias(
    heard: Heard,
    drives: Sequence[Drive],
    names: Sequence[str],
    settings: SupervisorSettings,
    load: Floats | None,
) -> Check:
    """Mean torque against gravity: what is left is the sensors' bias, or a payload nobody has mentioned."""
    mean = heard.torque.mean(0)
    if load is None:
        j = int(np.argmax(np.abs(mean)))
        return Check("torque bias", names[j], f"{mean[j]:.3g} N m sensed", "robot has no model", None)
    scale = np.array([drive.torque_gain_error for drive in drives])
    most = settings.bias_limit * np.array([drive.torque_limit for drive in drives]) + scale * np.abs(load)
    noise = np.array([drive.torque_noise for drive in drives])
    most += 4 * noise / np.sqrt(len(heard.time))
    return _worst("torque bias", names, np.abs(mean - load), most, "{:.3g} N m", "{:.3g} N m")


__all__ = ["Check", "Heard", "Verdicts", "at_rest", "before_link", "listen"]
