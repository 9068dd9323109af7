"""What an exported file says about itself: where it comes from, and what is proven of it."""

from __future__ import annotations

import hashlib
import math
import re
import textwrap
from collections.abc import Iterator
from pathlib import Path

from dashpot import __version__
from dashpot.arm.robot import Robot
from dashpot.certify.box import Box
from dashpot.certify.certificate import STATEMENT, Certificate, paired
from dashpot.control.controller import Controller, ControllerConfig

WIDTH = 100
SIZES = ("rotor_inertia", "viscous_friction", "stiffness", "damping", "torque_gain", "position_gain")
HEADS = ("inertia", "friction", "stiffness", "damping", "torque gain", "position gain", "latency")
UNITS = ("kg m^2", "N m s/rad", "N m/rad", "N m s/rad", "-", "-", "ticks")


def verdict(certificate: Certificate | None) -> str:
    """Certified or not, in one line."""
    if certificate is None:
        return "NOT CERTIFIED: no certificate was asked for"
    if certificate.certified:
        return "CERTIFIED"
    reasons: dict[str, list[str]] = {}
    for joint in certificate.joints:
        if not joint.certified:
            reasons.setdefault(joint.reason, []).append(joint.name)
    said = (f"{', '.join(names)}: {reason}" for reason, names in reasons.items())
    return f"NOT CERTIFIED: {'; '.join(said)}"


def digest(file: Path | None) -> str:
    """SHA-256 of a file, or what there is to say without one."""
    return "made in memory" if file is None else f"SHA-256 {hashlib.sha256(file.read_bytes()).hexdigest()}"


def lines(
    robot: Robot, config: ControllerConfig, controller: Controller, certificate: Certificate | None
) -> Iterator[str]:
    """The comment, line by line, without its marks."""
    yield f"Joint controller of the arm {robot.name}, written by dashpot {__version__}."
    yield ""
    yield from textwrap.wrap(verdict(certificate), WIDTH)
    if certificate is not None and certificate.certified:
        yield from textwrap.wrap(STATEMENT, WIDTH)
    if certificate is not None:
        yield ""
        yield from _table(controller, certificate)
        yield ""
        yield from _boxes(robot, config, controller)
    yield ""
    longest = config.latency if config.latency_max is None else config.latency_max
    yield f"period       {config.period!r} s"
    yield f"sampling     {config.sampling} of the sensed torque"
    yield f"latency      {config.latency} ticks from computing a torque to its taking effect, most {longest}"
    yield f"form         {config.form}"
    yield f"blend        {config.blend!r} s"
    for what, file in (("controller", config.file), ("robot", robot.file)):
        yield f"{what:12} {'' if file is None else plain(file.name) + ', '}{digest(file)}"
    yield f"joints       {', '.join(plain(name) for name in controller.joints)}"
    yield "units        SI, on the link side of the gear"


def _table(controller: Controller, certificate: Certificate) -> Iterator[str]:
    """Index and margin of every joint, as `dashpot certify` prints them."""
    found = {joint.name: joint for joint in certificate.joints}
    wide = max(5, *(len(plain(name)) for name in controller.joints))
    yield f"{'joint':{wide}}  {'index':>8} {'worst':>8} {'margin':>8}  verdict    as brake"
    for name in controller.joints:
        joint = found[name]
        brake = "-" if joint.brake is None else ("certified" if joint.brake.proven else "NOT CERTIFIED")
        yield (
            f"{plain(name):{wide}}  {_number(joint.nominal.value)} {_number(joint.box.worst.value)} "
            f"{_number(joint.margin)}  {'certified ' if joint.certified else 'NO        '} {brake}"
        )
    yield "index, worst: surplus of damping at the port, nominal and over the box below, N m s/rad;"
    yield "margin: worst over that of the bare drive; as brake: with the position loop off"


def _boxes(robot: Robot, config: ControllerConfig, controller: Controller) -> Iterator[str]:
    """The box of drive values a verdict holds for."""
    drives = {drive.name: drive for drive, _ in paired(robot, config)}
    wide = max(5, *(len(plain(name)) for name in controller.joints))
    rows: list[tuple[str, ...]] = [("box", *HEADS), ("", *UNITS)]
    for name, block in zip(controller.joints, controller.blocks, strict=True):
        ranges = Box.of(drives[name], block, config.latency_max).ranges
        rows.append((plain(name), *(_span(*ranges[key]) for key in (*SIZES, "latency"))))
    widths = [max(len(row[i]) for row in rows) for i in range(len(HEADS) + 1)]
    for first, *others in rows:
        yield f"{first:{wide}}  " + "  ".join(f"{x:>{w}}" for x, w in zip(others, widths[1:], strict=True))


def _span(low: float, high: float) -> str:
    return f"{low:.4g}" if low == high else f"{low:.4g}..{high:.4g}"


def _number(value: float) -> str:
    return f"{value:8.3g}" if math.isfinite(value) else "       -"


def plain(text: str) -> str:
    """Text that can end no comment, on one line, in the characters of every compiler."""
    kept = "".join(c if c.isascii() and c.isprintable() else "_" for c in text).replace("\\", "_")
    return re.sub(r"\?(?=\?)|\*(?=/)|/(?=\*)", r"\g<0> ", kept)
