"""The report page of ``dashpot design``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from dashpot.design.design import Design, JointDesign
from dashpot.design.quantities import GAINS, QUANTITIES, binding_text, in_si, predicted_text
from dashpot.design.wishes import AT_LEAST
from dashpot.design.words import assumptions, conflict_lines, sinking
from dashpot.support.numbers import significant
from dashpot.support.report import image, page, table

if TYPE_CHECKING:
    from dashpot.cli.design import Design as Options
    from dashpot.design.candidates import Duty

SUMMARY = ("stop_time", "travel", "hold", "load_error", "error_ratio", "noise")


def report(
    result: Design, needed: Sequence[Duty], options: Options, folder: Path, files: Mapping[str, str]
) -> str:
    """The page; pictures are taken from a folder."""
    failed = [joint.name for joint in result.joints if joint.found is None]
    if failed:
        lead = (
            f"No design: {', '.join(failed)} {'has' if len(failed) == 1 else 'have'} no certified gains that "
            "keep every limit, so that no controller is written. Below: which wishes conflict, by how much, "
            "and the cheapest change found that would help."
        )
    else:
        lead = (
            "Every joint is certified: no passive payload, pose or contact makes it oscillate, anywhere in "
            "the uncertainty that the robot file states, with its position loop and as brake."
        )
    sections = [("Overview", _overview(result, options))]
    for joint in result.joints:
        html = _failed(joint) if joint.found is None else _joint(joint, folder / f"{files[joint.name]}.png")
        sections.append((joint.name, html))
    sections += [("Assumed", _assumed(result, needed)), ("What the quantities mean", _meanings())]
    return page(f"{result.robot}: design of its joints", lead, sections)


def _overview(result: Design, options: Options) -> str:
    gains, predictions = [], []
    names = [name for name in SUMMARY if result.spec.loop or name != "load_error"]
    for joint in result.joints:
        found = joint.found
        if found is None:
            gains.append([joint.name, "fails", *("-" for _ in GAINS), "-"])
            continue
        values = found.gains.joint(joint.name)
        gains.append(
            [
                joint.name,
                "holds",
                *(f"{getattr(values, name):g}" for name in GAINS),
                significant(found.margin, 2),
            ]
        )
        predictions.append([joint.name, *(predicted_text(joint, name) for name in names)])
    head = ["joint", "certified", *(f"{name} [{unit}]" for name, unit in GAINS.items()), "margin"]
    html = table(head, gains, numbers=range(2, len(head)), classes=1)
    html = html.replace('"holds">holds<', '"holds">yes<').replace('"fails">fails<', '"fails">no<')
    if predictions:
        head = ["joint", *(_head(name) for name in names)]
        html += table(head, predictions, numbers=range(1, len(head)))
    if note := sinking(result):
        html += f'<p class="fails" style="white-space: normal">{escape(note)}</p>'
    if not result.feasible:
        return html
    check = f"dashpot certify {options.robot} {options.out / 'controller.toml'}"
    return (
        html
        + f"<p>The gains stand in <code>controller.toml</code>; <code>{escape(check)}</code> certifies them "
        "again. <code>spec.toml</code> is the specification in full.</p>"
    )


def _head(name: str) -> str:
    quantity = QUANTITIES[name]
    return f"{quantity.head} [{quantity.unit.replace(' of limit', '')}]" if quantity.unit else quantity.head


def _joint(joint: JointDesign, picture: Path) -> str:
    found, limits, wish = joint.found, joint.wishes.limits, joint.wishes.minimise
    assert found is not None
    rows = []
    for name in joint.predicted:
        limit = limits.get(name)
        kept = "-"
        if limit is not None:
            sense = "at least" if name in AT_LEAST else "at most"
            kept = f"{sense} {limit * QUANTITIES[name].factor:.3g}{in_si(name, limit)}"
        label = QUANTITIES[name].label + (" (wished for)" if name == wish else "")
        unit = QUANTITIES[name].unit
        values = predicted_text(joint, name), QUANTITIES[name].shown(joint.assured[name])
        rows.append(
            [f"{label} [{unit}]" if unit else label, *values, kept, "yes" if name in found.binding else ""]
        )
    rows.append(
        [
            "margin",
            "",
            significant(found.margin),
            f"at least {joint.wishes.margin:g}",
            "yes" if "certificate" in found.binding else "",
        ]
    )
    head = ["", "predicted", "with the weakest torque channel", "limit", "binds"]
    duty = joint.duty
    return (
        f"<p>{escape(_binding_sentence(joint))} It carries {significant(duty.inertia)} kg m² alone and "
        f"up to {significant(duty.loaded)} kg m² and {significant(duty.load)} N m with the payload; its "
        f"torque limit is {duty.drive.torque_limit:g} N m.</p>"
        + table(head, rows, numbers=(1, 2, 3))
        + image(
            picture,
            f"{joint.name}: trade-off between {QUANTITIES[wish].label} and its price, the predicted stop, "
            "and the certified gains around the design",
        )
    )


def _binding_sentence(joint: JointDesign) -> str:
    found, wish = joint.found, QUANTITIES[joint.wishes.minimise].label
    assert found is not None
    verb = "larger" if joint.wishes.minimise in AT_LEAST else "smaller"
    if not found.binding:
        return f"Nothing binds: no gains nearby have a {verb} {wish} and what counts beside it."
    names = [binding_text(name, joint.wishes.limits, joint.wishes.margin) for name in found.binding]
    listed = ", ".join(names[:-1]) + f" and {names[-1]}" if len(names) > 1 else names[0]
    return f"A {verb} {wish} is refused by: {listed}."


def _failed(joint: JointDesign) -> str:
    lines = conflict_lines(joint)
    items = "".join(f"<li>{escape(_sentence(line))}</li>" for line in lines[1:])
    return f'<p class="fails" style="white-space: normal">{escape(_sentence(lines[0]))}</p>' + (
        f"<ul>{items}</ul>" if items else ""
    )


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:] + ("" if text.endswith(".") else ".")


def _assumed(result: Design, needed: Sequence[Duty]) -> str:
    return (
        f"<p>{escape(_sentence(assumptions(result, needed[0])))}</p><p>Values under "
        "&ldquo;predicted&rdquo; are for the drive as the robot file states it. Limits are kept by those "
        "with the weakest torque channel it states (<code>torque_gain_error</code>).</p>"
    )


def _meanings() -> str:
    rows = [[quantity.label, quantity.unit or "-", quantity.meaning] for quantity in QUANTITIES.values()]
    symbols = (
        "<p>R, D and K are the virtual passive controller's heaviness, damping and stiffness, kp and kd the "
        "position loop's gains. v and tau_c are the drive's viscous and Coulomb friction, tau_g the load's "
        "largest torque.</p>"
    )
    return symbols + table(["quantity", "unit", "what it is"], rows)
