"""Pieces of the page as HTML and SVG: text that is read, so names and units are those of the command line.

Colours are Okabe and Ito's, and never the only sign: certified is blue with a tick, refused is vermillion with a cross.
"""

from __future__ import annotations

import base64
import html
import struct
import zlib
from collections import OrderedDict
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dashpot.certify.certificate import ASSUMED
from dashpot.certify.map import IndexMap
from dashpot.studio.margins import Margin, Plane
from dashpot.studio.snapshot import Snapshot
from dashpot.support.arrays import Floats

BLUE, VERMILLION, GREEN, GREY, ORANGE = "#0072B2", "#D55E00", "#009E73", "#7A7A7A", "#B87500"
SIGN = {"certified": ("✓", BLUE), "checking": ("…", GREY), "not certified": ("✗", VERMILLION)}
STATE = {
    "track": ("tracking", BLUE),
    "torque_brake": ("torque brake", ORANGE),
    "encoder_brake": ("encoder brake", ORANGE),
    "safe": ("safe", VERMILLION),
}
FONT = "font:12px/1.35 system-ui,sans-serif;color:#222"


def escaped(text: str) -> str:
    """Text that may stand in HTML."""
    return html.escape(text)


def block(inner: str, pad: str = "0 12px") -> str:
    """A paragraph of the panel."""
    return f'<div style="{FONT};padding:{pad}">{inner}</div>'


def trouble(text: str) -> str:
    """A message beside a field; "" takes no room."""
    if not text:
        return ""
    return block(
        f'<div role="alert" class="dp-trouble" style="border-left:3px solid {VERMILLION};padding:3px 8px;background:#FFF4ED">'
        f"{escaped(text)}</div>",
        "2px 12px",
    )


def remark(text: str) -> str:
    """Beside a field, what is worth knowing of what was taken; "" takes no room."""
    if not text:
        return ""
    inner = (
        f'<div class="dp-remark" style="border-left:3px solid {ORANGE};padding:3px 8px">{escaped(text)}</div>'
    )
    return block(inner, "2px 12px")


def margins(rows: Sequence[Margin], chosen: str, modes: dict[str, str]) -> str:
    """A bar per joint: the worst damping its port shows, over what the drive shows alone."""
    most = max([1.0, *(row.share for row in rows if np.isfinite(row.share))])
    lines = []
    for row in rows:
        sign, colour = SIGN[row.verdict]
        width = 100 * min(max(row.share / most, 0.0), 1.0) if np.isfinite(row.share) else 0
        bar = (
            f'<div style="height:9px;width:{max(width, 3):.0f}%;background:{colour};'
            + ("opacity:.45;" if row.verdict == "checking" else "")
            + '"></div>'
        )
        number = _short(row.index)
        weight = "600" if row.joint == chosen else "400"
        mode = modes.get(row.joint, "")
        lines.append(
            f'<tr style="font-weight:{weight}" data-joint="{escaped(row.joint)}" data-verdict="{row.verdict}">'
            f'<td style="padding-right:8px">{escaped(row.joint)}{" · " + mode if mode else ""}</td>'
            f'<td style="width:50%;background:#EEF0F1;vertical-align:middle;padding:0">{bar}</td>'
            f'<td style="text-align:right;padding-left:8px">{number}</td>'
            f'<td style="color:{colour};padding-left:8px;white-space:nowrap">{sign} {row.verdict}</td></tr>'
        )
    shown = next((row for row in rows if row.joint == chosen), None)
    words = f'<div style="margin-top:3px">{escaped(shown.words)}</div>' if shown else ""
    return block(
        '<div style="display:flex;justify-content:space-between"><b>Certificate</b>'
        '<span style="color:#666">margin [N m s/rad]</span></div>'
        f'<table style="width:100%;border-collapse:collapse">{"".join(lines)}</table>{words}'
        f'<div style="color:#666;font-size:11px">{escaped(ASSUMED)}</div>'
    )


def status(now: Snapshot, supervised: bool, runs: str) -> str:
    """The lines on top: state and time; what runs, with its load; whether torque is short."""
    state, brake, factor, running, time = now.state, now.brake_closed, now.factor, now.running, now.time
    limited = (
        f'<span id="dp-limited" style="color:{VERMILLION};white-space:nowrap;font-weight:600">'
        "at its torque limit</span>"
        if now.limited
        else ""
    )
    word, colour = STATE[state] if supervised else ("no supervisor", GREY)
    pace = f"real time × {factor:.2f}" if running else "paused"
    closed = ", brakes closed" if brake else ""
    return block(
        f'<div style="display:flex;justify-content:space-between;align-items:center;gap:10px">'
        f'<span id="dp-state" data-state="{state}" style="background:{colour};color:#fff;border-radius:3px;'
        f'padding:1px 8px;font-weight:600;white-space:nowrap">{word}{closed}</span>'
        f'<span style="white-space:nowrap">{time:.1f} s · {pace}</span></div>'
        f'<div style="display:flex;justify-content:space-between;gap:10px;margin-top:3px">'
        f'<span id="dp-runs" style="overflow:hidden;text-overflow:ellipsis;white-space:nowrap" '
        f'title="{escaped(runs)}">{escaped(runs)}, {now.payload:.2f} kg</span>{limited}</div>',
        "0 12px 8px",
    )


def legend(title: str, unit: str, entries: Sequence[tuple[str, str, str]]) -> str:
    """A chart's title with its lines: (label, colour, "solid" or "dashed" or "dotted")."""
    keys = "".join(
        f'<span style="margin-left:10px;white-space:nowrap"><span style="display:inline-block;width:18px;'
        f'border-top:2px {style} {colour};vertical-align:middle;margin-right:3px"></span>{escaped(label)}</span>'
        for label, colour, style in entries
    )
    return block(
        f'<div style="display:flex;flex-wrap:wrap;justify-content:space-between"><span><b>{escaped(title)}</b> '
        f'[{escaped(unit)}]</span><span style="color:#444">{keys}</span></div>',
        "0 8px 0 12px",
    )


def news(lines: Sequence[tuple[float, str, str]]) -> str:
    """What happened, newest first."""
    colours = {"supervisor": ORANGE, "trouble": VERMILLION, "scene": BLUE}
    rows = "".join(
        f'<tr><td style="color:#777;padding-right:8px;vertical-align:top;white-space:nowrap">{when:.2f} s</td>'
        f'<td style="color:{colours.get(kind, "#222")}">{escaped(text)}</td></tr>'
        for when, text, kind in lines
    )
    return block(f'<table style="border-collapse:collapse">{rows}</table>')


def plane(shown: Plane, joint: str, width: int = 330, now: float = np.nan) -> str:
    """The map of R and D with the current point, and the window over load inertia, as SVG.

    Args:
        shown: What is known.
        joint: Its name.
        width: [px].
        now: Inertia that the joint moves now [kg m^2]; NaN: none is marked.
    """
    return block(_map(shown, joint, width) + _window(shown, width, now), "0 8px")


LEFT, BOTTOM, HEIGHT = 44, 30, 150  # [px] of the map
_backdrops: OrderedDict[tuple[int, int], tuple[IndexMap, str]] = OrderedDict()  # of the last maps drawn


def _map(shown: Plane, joint: str, width: int) -> str:
    found = shown.found
    if found is None:
        words = "no map: this law has no R and D" if np.isnan(shown.R) else "the map is being computed"
        return f'<div style="height:40px;color:#666;padding:8px 4px">{words}</div>'
    w, h = width - LEFT - 8, HEIGHT - BOTTOM - 8
    px, py = (float(part[0]) for part in _places(found, np.array([shown.R]), np.array([shown.D]), w, h))
    px, py = min(max(px, LEFT), LEFT + w), min(max(py, 8), 8 + h)
    at = int(np.abs(np.log(found.D / shown.D)).argmin()), int(np.abs(np.log(found.R / shown.R)).argmin())
    inside = "certified" if found.index[at] >= 0 else "not certified"
    key = id(found), width
    if key not in _backdrops:  # the same while a slider moves
        _backdrops[key] = found, _backdrop(found, w, h)
        while len(_backdrops) > 8:
            _backdrops.popitem(last=False)
    return (
        f'<svg id="dp-map" data-inside="{inside}" width="{width}" height="{HEIGHT}" role="img" '
        f'aria-label="{escaped(joint)}: map of R and D, the point is {inside}" font-size="11" fill="#222">'
        f"{_backdrops[key][1]}"
        f'<circle id="dp-now" cx="{px:.1f}" cy="{py:.1f}" r="6" fill="#fff" stroke="#000" stroke-width="2"/>'
        f'<circle cx="{px:.1f}" cy="{py:.1f}" r="1.5"/></svg>'
        '<div style="display:flex;gap:9px;color:#444;margin:0 0 4px 12px;white-space:nowrap">'
        '<span><span style="display:inline-block;width:11px;height:11px;background:#6baed6"></span> certified</span>'
        '<span><span style="display:inline-block;width:11px;height:11px;background:#e9e9e9;border:1px solid #bbb">'
        "</span> not certified</span>"
        f'<span style="color:{VERMILLION}"><span style="display:inline-block;width:11px;height:11px;background:'
        f'repeating-linear-gradient(45deg,{VERMILLION} 0 1.5px,#e9e9e9 1.5px 4px)"></span> oscillates</span>'
        "<span>◉ now</span></div>"
    )


def _places(found: IndexMap, R: Floats, D: Floats, w: int, h: int) -> tuple[Floats, Floats]:
    """Pixels of gains in a map of w by h."""
    x0, x1 = np.log10(found.R[[0, -1]])
    y0, y1 = np.log10(found.D[[0, -1]])
    return LEFT + w * (np.log10(R) - x0) / (x1 - x0), 8 + h * (1 - (np.log10(D) - y0) / (y1 - y0))


def _backdrop(found: IndexMap, w: int, h: int) -> str:
    """The map without the point: shades of the margin, hatching where loads oscillate, and axes."""
    top = max(float(found.index.max()), 1e-9)
    share = np.clip(found.index / top, 0, 1)[..., None]
    image = np.where(found.index[..., None] >= 0, (1 - share) * [222, 235, 247] + share * [66, 146, 198], 233)
    rows, columns = found.coarse
    x, y = _places(found, found.R[columns], found.D[rows], w, h)
    x, y = np.clip(_edges(x), LEFT, LEFT + w), np.clip(_edges(y), 8, 8 + h)
    hatched = "".join(  # a cell reaches half way to its neighbours
        f"M{x[j]:.1f},{y[i]:.1f}H{x[j + 1]:.1f}V{y[i + 1]:.1f}H{x[j]:.1f}Z"
        for i, j in np.argwhere(found.oscillates)
    )
    R, D = _ticks(found.R[0], found.R[-1]), _ticks(found.D[0], found.D[-1])
    across, up = (
        _places(found, np.array(R), found.D[:1], w, h)[0],
        _places(found, found.R[:1], np.array(D), w, h)[1],
    )
    ticks = "".join(
        f'<text x="{at:.0f}" y="{HEIGHT - BOTTOM + 13}" text-anchor="middle">{v:g}</text>'
        f'<line x1="{at:.0f}" x2="{at:.0f}" y1="{8 + h}" y2="{8 + h + 3}" stroke="#444"/>'
        for at, v in zip(across, R, strict=True)
    ) + "".join(
        f'<text x="{LEFT - 5}" y="{at + 4:.0f}" text-anchor="end">{v:g}</text>'
        f'<line x1="{LEFT - 3}" x2="{LEFT}" y1="{at:.0f}" y2="{at:.0f}" stroke="#444"/>'
        for at, v in zip(up, D, strict=True)
    )
    return (
        '<defs><pattern id="dp-hatch" width="6" height="6" patternUnits="userSpaceOnUse" '
        f'patternTransform="rotate(45)"><line x1="0" y1="0" x2="0" y2="6" stroke="{VERMILLION}" stroke-width="1.4"/>'
        "</pattern></defs>"
        f'<image x="{LEFT}" y="8" width="{w}" height="{h}" preserveAspectRatio="none" '
        f'style="image-rendering:pixelated" href="{_png(image[::-1].astype(np.uint8))}"/>'
        f'<path d="{hatched}" fill="url(#dp-hatch)"/>'
        f'<rect x="{LEFT}" y="8" width="{w}" height="{h}" fill="none" stroke="#999"/>{ticks}'
        f'<text x="{LEFT + w / 2:.0f}" y="{HEIGHT - 6}" text-anchor="middle">R [-]</text>'
        f'<text transform="translate(11,{8 + h / 2:.0f}) rotate(-90)" text-anchor="middle">D [N m s/rad]</text>'
    )


def _edges(places: Floats) -> Floats:
    """Borders of the cells around places in order, (k + 1,)."""
    middle = (places[1:] + places[:-1]) / 2
    return np.concatenate([[2 * places[0] - middle[0]], middle, [2 * places[-1] - middle[-1]]])


def _window(shown: Plane, width: int, now: float) -> str:
    left, bottom, height = 44, 30, 100
    w, h = width - left - 8, height - bottom - 8
    ratio = shown.damping
    good = np.isfinite(ratio)
    if not good.any():
        return ""
    low, high = min(-0.1, float(np.nanmin(ratio))), min(1.0, max(0.2, float(np.nanmax(ratio))))
    low = max(low, -0.6)
    x0, x1 = np.log10(shown.inertia[[0, -1]])
    xs = left + w * (np.log10(shown.inertia) - x0) / (x1 - x0)
    ys = 8 + h * (1 - (np.clip(ratio, low, high) - low) / (high - low))
    zero = 8 + h * (1 - (0 - low) / (high - low))
    pieces, path = [], ""
    for px, py, fine in zip(xs, ys, good, strict=True):
        if fine:
            path += f"{'L' if path else 'M'}{px:.1f},{py:.1f}"
        elif path:
            pieces.append(path)
            path = ""
    pieces.append(path)
    line = "".join(f'<path d="{p}" fill="none" stroke="{BLUE}" stroke-width="2"/>' for p in pieces if p)
    bad = good & (ratio < 0)
    words = "no load that is an inertia alone oscillates"
    if bad.any():
        worst = int(np.nanargmin(ratio))
        words = (
            f"an inertia alone oscillates with {shown.inertia[bad][0]:.2g} to {shown.inertia[bad][-1]:.2g} kg m², worst at "
            f"{shown.frequency[worst]:.2g} Hz"
        )
    mark = ""
    if np.isfinite(now) and shown.inertia[0] <= now <= shown.inertia[-1]:
        at = round(left + w * (np.log10(now) - x0) / (x1 - x0))
        end, dx = ("end", -3) if at > left + 0.85 * w else ("start", 3)
        mark = (
            f'<line id="dp-inertia" x1="{at}" x2="{at}" y1="8" y2="{8 + h}" stroke="#000" stroke-width="1"/>'
            f'<text x="{at + dx}" y="18" text-anchor="{end}">now</text>'
        )
    ticks = "".join(
        f'<text x="{left + w * (np.log10(v) - x0) / (x1 - x0):.0f}" y="{8 + h + 13}" text-anchor="middle">{v:g}</text>'
        for v in _ticks(shown.inertia[0], shown.inertia[-1])
    )
    return (
        f'<svg width="{width}" height="{height}" role="img" aria-label="{words}" font-size="11" fill="#222">'
        f'<rect x="{left}" y="{zero:.1f}" width="{w}" height="{max(8 + h - zero, 0):.1f}" fill="{VERMILLION}" '
        f'opacity="0.14"/><line x1="{left}" x2="{left + w}" y1="{zero:.1f}" y2="{zero:.1f}" stroke="#444"/>{line}'
        f'<rect x="{left}" y="8" width="{w}" height="{h}" fill="none" stroke="#999"/>{mark}'
        f'<text x="{left - 5}" y="{zero + 4:.0f}" text-anchor="end">0</text>'
        f'<text x="{left - 5}" y="16" text-anchor="end">{high:.2g}</text>{ticks}'
        f'<text x="{left + w / 2:.0f}" y="{height - 5}" text-anchor="middle">load inertia [kg m²]</text>'
        f'<text transform="translate(11,{8 + h / 2:.0f}) rotate(-90)" text-anchor="middle">damping [-]</text></svg>'
        f'<div style="margin-left:44px;color:{VERMILLION if bad.any() else "#444"}">{words}</div>'
    )


def _short(value: float) -> str:
    """A number in few letters, -inf too."""
    if not np.isfinite(value):
        return "−∞"
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:.2g}"


def _ticks(low: float, high: float) -> list[float]:
    decades = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    return [10.0**k for k in decades if low <= 10.0**k <= high]


def _png(pixels: NDArray[np.uint8]) -> str:
    """An RGB image (rows, columns, 3) as a data URI."""
    rows, columns, _ = pixels.shape

    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    raw = b"".join(b"\0" + row.tobytes() for row in np.ascontiguousarray(pixels))
    header = struct.pack(">IIBBBBB", columns, rows, 8, 2, 0, 0, 0)
    data = (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + chunk(b"IDAT", zlib.compress(raw))
        + chunk(b"IEND", b"")
    )
    return "data:image/png;base64," + base64.b64encode(data).decode()


__all__ = ["block", "escaped", "legend", "margins", "news", "plane", "remark", "status", "trouble"]
