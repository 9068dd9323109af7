"""``dashpot report``: a campaign's dataset as one self-contained page."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console

from dashpot.campaign.judge import Verdict, judge, passed
from dashpot.campaign.measures import MEASURES
from dashpot.campaign.scenario import OK
from dashpot.campaign.spec import Spec
from dashpot.campaign.store import attributes, open_dataset, spec_of
from dashpot.commands.campaign import needs_campaign_extra, replay_command
from dashpot.commands.campaign_view import amount, axis_words, case_words, show_results
from dashpot.commands.report_plots import Picture, pictures
from dashpot.commands.shared import check_file_place
from dashpot.errors import InputError
from dashpot.logs.atomic import replaced
from dashpot.support.report import facts, image, page, table
from dashpot.support.waiting import waiting

if TYPE_CHECKING:
    from dashpot.cli.simulate import Report

LISTED = 20  # failed scenarios that are named


def report(options: Report) -> int:
    """``dashpot report``; returns the exit status: 1 if a requirement is not met or a scenario is missing."""
    needs_campaign_extra()
    out = options.out or options.dataset.with_suffix(".html")
    if out.is_dir() or out.resolve().is_relative_to(options.dataset.resolve()):
        raise InputError("must be a file outside the dataset", quantity="--out", value=str(out))
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _unwritable(out, error) from None
    check_file_place(out, "--out")
    about, spec = attributes(options.dataset), spec_of(options.dataset)
    with open_dataset(options.dataset) as dataset, tempfile.TemporaryDirectory() as folder:
        with waiting("drawing"):
            verdicts = judge(spec, dataset)
            good = passed(spec, dataset)
            drawn = pictures(spec, dataset, good, Path(folder))
        status = dataset["status"].values.ravel()
        html = _page(spec, about, dataset, verdicts, good, drawn, options.dataset)
        try:
            with replaced(out) as work:
                work.write_text(html, encoding="utf-8")
        except OSError as error:
            raise _unwritable(out, error) from None
        show_results(spec, dataset, verdicts, options.dataset, reported=True)
    Console().print(f"open {out}", highlight=False, markup=False, soft_wrap=True)
    return 0 if (status == OK).all() and all(verdict.holds for verdict in verdicts) else 1


def _unwritable(out: Path, error: OSError) -> InputError:
    return InputError(f"cannot be written: {error.strerror or error}", quantity="--out", value=str(out))


def _page(
    spec: Spec,
    about: dict[str, Any],
    dataset: Any,
    verdicts: Sequence[Verdict],
    good: Any,
    drawn: Sequence[Picture],
    place: Path,
) -> str:
    status = dataset["status"].values.ravel()
    done, met = int((status > 0).sum()), sum(verdict.holds for verdict in verdicts)
    lead = f"{met} of {len(verdicts)} requirements are met" if verdicts else "Nothing is required"
    lead += f", over {done:,} simulated scenarios; {int(good.sum()):,} of them keep every bound."
    if done < spec.size:
        lead += f" The campaign is not finished: {spec.size - done:,} of {spec.size:,} scenarios are missing."
    sections = []
    if verdicts:
        sections += [
            ("Requirements", _requirements(spec, verdicts)),
            ("Worst cases", _worst(verdicts, place)),
        ]
    if (status > OK).any():
        sections.append(("Failed scenarios", _failed(dataset, status, place)))
    sections += [
        (picture.title, f"<p>{escape(picture.caption)}</p>{image(picture.path, picture.title)}")
        for picture in drawn
    ]
    sections += [
        ("What was varied", _varied(spec)),
        ("What the measures mean", _meanings()),
        ("Provenance", _provenance(about)),
    ]
    return page(
        f"{about['title'].removeprefix('dashpot campaign of ')}: campaign of {spec.size:,} scenarios",
        lead,
        sections,
    )


def _requirements(spec: Spec, verdicts: Sequence[Verdict]) -> str:
    rows = []
    for verdict in verdicts:
        need = verdict.requirement
        judged = verdict.judged > 0
        rows.append(
            [
                need.words,
                "holds" if verdict.holds else "fails",
                f"{100 * verdict.kept:.4g} %" if judged else "nothing to judge",
                verdict.joint or "all",
                amount(need, verdict.quantile) if judged else "-",
                f"{verdict.judged:,}",
                *([f"{100 * verdict.assured:.3g} %" if judged else "-"] if spec.sampled else []),
            ]
        )
    head = ["requirement", "verdict", "kept", "joint", "at the quantile", "scenarios"]
    note = "Kept is the share of the scenarios in which the bound is kept, of the joint where it is least."
    if spec.sampled:
        head.append("assured")
        note += (
            " Assured is the least share that is plausible at 95 % (Clopper-Pearson), were the scenarios "
            "drawn independently from the stated distributions; they fill them more evenly."
        )
    html = table(head, rows, numbers=(2, 4, 5, 6), classes=1)
    html = html.replace('"holds">holds<', '"holds">met<').replace('"fails">fails<', '"fails">not met<')
    return html + f"<p>{escape(note)}</p>"


def _worst(verdicts: Sequence[Verdict], place: Path) -> str:
    broken = [(v, case) for v in verdicts for case in v.worst if not v.requirement.allows(case.value)]
    rows = [
        [
            verdict.requirement.measure,
            case_words(verdict.requirement, case),
            "not kept" if (verdict, case) in broken else "kept",
            replay_command(place, case.index),
        ]
        for verdict, case in broken + [(verdict, verdict.worst[0]) for verdict in verdicts if _close(verdict)]
    ]
    if not rows:
        return "<p>Every scenario keeps every bound by the widest margin there is.</p>"
    html = table(["measure", "scenario and joint", "bound", "to see it"], rows)
    for *_, command in rows:
        html = html.replace(f"<td>{escape(command)}</td>", f"<td><code>{escape(command)}</code></td>")
    return html


def _close(verdict: Verdict) -> bool:
    """Whether its worst case says something although every scenario keeps the bound: not that of a count."""
    need = verdict.requirement
    if verdict.kept < 1 or not verdict.worst or need.among:
        return False
    return verdict.worst[0].value not in (need.low, need.high)


def _failed(dataset: Any, status: Any, place: Path) -> str:
    lost = np.flatnonzero(status > OK)
    reasons = dataset["reason"].values.ravel()
    rows = [[f"#{i}", str(reasons[i]), replay_command(place, int(i))] for i in lost[:LISTED]]
    more = f"<p>And {len(lost) - LISTED} more.</p>" if len(lost) > LISTED else ""
    return table(["scenario", "reason", "to see it"], rows) + more


def _varied(spec: Spec) -> str:
    rows = [[axis.name, axis.unit if axis.unit != "-" else "", axis_words(axis)] for axis in spec.axes]
    fixed = {"motion": spec.motion, "release": "never" if spec.release is None else f"{spec.release:g} s"}
    if spec.motion == "multisine" and not spec.has("amplitude"):
        fixed["amplitude"] = f"{spec.amplitude:g} rad"
    if spec.sampled:
        fixed["sample"] = f"{(spec.sample or '').replace('_', ' ')}, {spec.count} points, seed {spec.seed}"
    return table(["axis", "unit", "values"], rows) + facts(fixed)


def _meanings() -> str:
    return table(
        ["measure", "unit", "what it is"], [[name, kind.unit, kind.words] for name, kind in MEASURES.items()]
    )


def _provenance(about: dict[str, Any]) -> str:
    rows = {name: version for name, version in about["versions"].items()}
    rows |= {f"{name} (SHA-256)": digest for name, digest in about["sha256"].items()}
    spec = f'<pre style="overflow-x: auto"><code>{escape(about["spec"])}</code></pre>'
    return facts(rows) + f"<p>The specification:</p>{spec}"
