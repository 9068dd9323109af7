"""Sentences about a design: what was assumed, and which wishes conflict."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from dashpot.design.conflicts import Shortfall
from dashpot.design.design import Design, JointDesign
from dashpot.design.quantities import QUANTITIES, in_si, limit_text
from dashpot.support.numbers import significant

if TYPE_CHECKING:
    from dashpot.design.candidates import Duty


def assumptions(result: Design, first: Duty) -> str:
    """What the design rests on, in one sentence without its end."""
    spec = result.spec
    parts = [
        f"a sample every {1e3 * first.period:.4g} ms",
        "torque averaged over the period" if first.sampling == "average" else "torque sampled at the tick",
        _latency(first),
        f"{first.form} form",
        _payload(result),
        f"stops from {spec.speed:g} rad/s to {100 * spec.residual_speed:g} % of it",
    ]
    carried = [
        f"{joint.name} {significant(joint.duty.inertia, 2)} to {significant(joint.duty.loaded, 2)} kg m^2"
        + (f", {significant(joint.duty.load, 2)} N m" if joint.duty.load > 1e-9 else "")
        for joint in result.joints
    ]
    where = "at home" if spec.pose == "home" else "over the joints' ranges"
    return f"{', '.join(parts)}. Carried {where}: {'; '.join(carried)}"


def _latency(duty: Duty) -> str:
    if duty.latency_max == 0:
        return "no latency"
    if duty.latency_max == duty.latency:
        return f"{duty.latency} sample{'s' if duty.latency > 1 else ''} of latency"
    return f"{duty.latency} to {duty.latency_max} samples of latency"


def _payload(result: Design) -> str:
    spec = result.spec
    weight = ", the arm's own weight counts as load"
    if spec.gravity_compensated:
        weight = ", the robot carries its own weight"
    if spec.payload == 0:
        return f"no payload{weight}"
    where = f" at ({', '.join(f'{part:g}' for part in spec.offset)}) m" if any(spec.offset) else ""
    return f"payload {spec.payload:g} kg{where} on the flange{weight}"


def sinking(result: Design) -> str:
    """Which joints the load moves once their encoder is lost, in a sentence; empty: none."""
    speeds = {joint.name: joint.assured["creep"] for joint in result.joints if joint.found is not None}
    creeping = [
        f"{name} at up to {QUANTITIES['creep'].text(speed)}" for name, speed in speeds.items() if speed > 0
    ]
    if not creeping:
        return ""
    return (
        f"Once the encoder is lost the load moves {_listed(creeping)}: brakes, or a limit on creep "
        "(--creep 0), keep it up."
    )


def conflict_lines(joint: JointDesign) -> list[str]:
    """Why a joint has no gains, and what would help: a headline and sentences."""
    conflict, limits = joint.conflict, joint.wishes.limits
    assert conflict is not None
    if conflict.reason:
        return [f"no gains can help: {conflict.reason}"]
    lines: list[str] = []
    if not conflict.wishes:
        lines.append(f"nothing is certified with margin {joint.wishes.margin:g}, whatever the other wishes")
    elif len(conflict.wishes) == 1:
        (name,) = conflict.wishes
        lines.append(f"no certified gains reach {limit_text(name, limits[name])}")
    else:
        names = [limit_text(name, limits[name]) for name in conflict.wishes]
        lines.append(f"no certified gains keep together: {_listed(names)}")
    for shortfall in conflict.shortfalls:
        lines.append(_shortfall(shortfall, alone=len(conflict.wishes) == 1))
    if conflict.change:
        lines.append(f"cheapest change that helps: {_spoken(conflict.change)}")
        if conflict.tried:
            lines.append(f"not enough: {'; '.join(conflict.tried)}")
    elif conflict.tried:
        lines.append(f"no change tried helps: {'; '.join(conflict.tried)}")
    return lines


def _shortfall(shortfall: Shortfall, alone: bool) -> str:
    name = shortfall.name
    quantity = QUANTITIES[name]
    wanted = f"{shortfall.wanted * quantity.factor:.3g} {quantity.unit}".rstrip()
    if shortfall.possible is None:
        return f"{quantity.label}: {wanted} wanted; more of it is not enough, other wishes conflict too"
    possible = f"{quantity.text(shortfall.possible)}{in_si(name, shortfall.possible)}"
    rest = "" if alone else ", all other wishes kept"
    return f"{quantity.label}: {wanted} wanted, {possible} possible{rest}"


def _spoken(text: str) -> str:
    for name, quantity in QUANTITIES.items():
        text = text.replace(name, quantity.label)
    return text


def _listed(parts: Sequence[str]) -> str:
    return ", ".join(parts[:-1]) + f" and {parts[-1]}" if len(parts) > 1 else parts[0]
