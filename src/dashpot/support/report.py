"""Self-contained HTML pages: everything inline, nothing fetched."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

STYLE = """
:root { --ink: #1c2126; --soft: #5d6670; --line: #e3e6ea; --good: #00795a; --bad: #b84a00; }
* { box-sizing: border-box; }
body { font: 16px/1.55 system-ui, sans-serif; color: var(--ink); margin: 0 auto; max-width: 68rem;
       padding: 2rem 1.25rem 4rem; }
h1 { font-size: 1.9rem; line-height: 1.2; margin: 0 0 .3rem; }
h2 { margin: 2.6rem 0 .6rem; font-size: 1.3rem; border-top: 1px solid var(--line); padding-top: 1.2rem; }
p.lead { color: var(--soft); margin: 0 0 1.5rem; max-width: 46rem; }
img { display: block; max-width: 100%; height: auto; margin: .6rem 0; }
table { border-collapse: collapse; width: 100%; font-size: .9rem; margin: .8rem 0; }
th, td { text-align: left; padding: .38rem .6rem; border-bottom: 1px solid var(--line); vertical-align: top; }
th { color: var(--soft); font-weight: 600; white-space: nowrap; }
td:last-child code { white-space: nowrap; }
th.number, td.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
.holds { color: var(--good); font-weight: 600; white-space: nowrap; }
.fails { color: var(--bad); font-weight: 600; white-space: nowrap; }
.wide { overflow-x: auto; }
code { background: #f3f5f7; padding: .1em .35em; border-radius: .25em; font-size: .92em; }
@media print { body { max-width: none; } h2 { break-after: avoid; } img { break-inside: avoid; } }
"""


def image(path: Path, text: str) -> str:
    """An inline PNG with its alternative text."""
    data = base64.b64encode(path.read_bytes()).decode()
    return f'<img alt="{escape(text)}" src="data:image/png;base64,{data}">'


def table(
    head: Sequence[str],
    rows: Sequence[Sequence[str]],
    *,
    numbers: Sequence[int] = (),
    classes: int | None = None,
) -> str:
    """A table of text cells.

    Args:
        head: Column titles.
        rows: Cells, escaped here.
        numbers: Columns to align as numbers.
        classes: Column whose cells get the class "holds" or "fails", by their first word.
    """

    def cell(i: int, text: str) -> str:
        kind = "number" if i in numbers else text.split()[0] if i == classes else ""
        return f'<td class="{kind}">{escape(text)}</td>' if kind else f"<td>{escape(text)}</td>"

    top = "".join(
        f'<th class="number">{escape(title)}</th>' if i in numbers else f"<th>{escape(title)}</th>"
        for i, title in enumerate(head)
    )
    body = "".join(f"<tr>{''.join(cell(i, c) for i, c in enumerate(row))}</tr>" for row in rows)
    return f'<div class="wide"><table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>'


def facts(values: Mapping[str, str]) -> str:
    """A two-column table of names and facts."""
    return table(("", ""), list(values.items())).replace("<thead><tr><th></th><th></th></tr></thead>", "")


def page(title: str, lead: str, sections: Sequence[tuple[str, str]]) -> str:
    """A whole page.

    Args:
        title: Heading.
        lead: Text under it.
        sections: (heading, HTML) pairs.
    """
    body = "".join(f"<section><h2>{escape(heading)}</h2>{html}</section>" for heading, html in sections)
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{STYLE}</style></head><body>"
        f'<h1>{escape(title)}</h1><p class="lead">{escape(lead)}</p>{body}</body></html>\n'
    )
