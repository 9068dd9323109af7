"""The schematics of docs/vpc.md: the virtual mechanism behind a joint, and the torque loop.

``python -m dashpot.studies.vpc_pictures [FOLDER]`` draws them and those of `dashpot.studies.vpc_release`.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.patches import Circle, FancyBboxPatch, Rectangle

from dashpot.support.plots import BLACK, BLUE, GREY, VERMILLION, Figure, new_figure, save

REAL, VIRTUAL = "#FFF3E6", "#E8F1FA"  # grounds of what is there and of what is computed
LINE = 1.6


def _canvas(width: float, height: float) -> tuple[Figure, Any]:
    """An empty drawing whose unit is 1/100 inch, and its axes."""
    figure, axes = new_figure(1, 1, width, height, layout=None)
    axis = axes[0, 0]
    axis.set_position((0, 0, 1, 1))
    axis.set(xlim=(0, 100 * width), ylim=(0, 100 * height))
    axis.axis("off")
    return figure, axis


def _line(axis: Any, *points: tuple[float, float], color: str = BLACK, **options: Any) -> None:
    axis.plot(*zip(*points, strict=True), color=color, lw=LINE, solid_capstyle="round", **options)


def _ground(axis: Any, x: float, low: float, high: float, color: str) -> None:
    """A wall with its hatching on the left."""
    _line(axis, (x, low), (x, high), color=color)
    for y in np.arange(low + 6, high + 1, 9):
        axis.plot([x - 8, x], [y - 8, y], color=color, lw=0.8)


def _floor(axis: Any, x: float, y: float, color: str) -> None:
    """A short floor with its hatching below."""
    _line(axis, (x - 16, y), (x + 16, y), color=color)
    for at in np.arange(x - 14, x + 17, 8):
        axis.plot([at - 6, at], [y - 6, y], color=color, lw=0.8)


def _spring(axis: Any, left: float, right: float, y: float, color: str, label: str) -> None:
    lead = (right - left) * 0.2
    at = np.linspace(left + lead, right - lead, 11)
    zigzag = [y + 8 * (-1) ** i if 0 < i < 10 else y for i in range(11)]
    _line(axis, (left, y), *zip(at, zigzag, strict=True), (right, y), color=color)
    axis.text((left + right) / 2, y + 13, label, ha="center", va="bottom", color=color)


def _damper(axis: Any, left: float, right: float, y: float, color: str, label: str) -> None:
    middle = (left + right) / 2
    _line(axis, (left, y), (middle - 12, y), color=color)
    _line(axis, (middle + 12, y + 9), (middle - 12, y + 9), color=color)
    _line(axis, (middle - 12, y + 9), (middle - 12, y - 9), (middle + 12, y - 9), color=color)
    _line(axis, (middle + 3, y - 6), (middle + 3, y + 6), color=color)
    _line(axis, (middle + 3, y), (right, y), color=color)
    axis.text(middle, y - 13, label, ha="center", va="top", color=color)


def _damper_down(axis: Any, x: float, top: float, low: float, color: str, label: str) -> None:
    """A damper that stands on a floor."""
    middle = (top + low) / 2
    _line(axis, (x, low), (x, middle - 9), color=color)
    _line(
        axis, (x - 9, middle + 9), (x - 9, middle - 9), (x + 9, middle - 9), (x + 9, middle + 9), color=color
    )
    _line(axis, (x - 6, middle + 2), (x + 6, middle + 2), color=color)
    _line(axis, (x, middle + 2), (x, top), color=color)
    axis.text(x + 16, middle, label, ha="left", va="center", color=color)


def _inerter(axis: Any, left: float, right: float, y: float, color: str, label: str) -> None:
    middle = (left + right) / 2
    _line(axis, (left, y), (middle - 21, y), color=color)
    _line(axis, (middle + 21, y), (right, y), color=color)
    axis.add_patch(Rectangle((middle - 21, y - 13), 42, 26, fc="white", ec=color, lw=LINE, zorder=3))
    axis.add_patch(Circle((middle, y), 9, fc="none", ec=color, lw=LINE, zorder=4))
    axis.add_patch(Circle((middle, y), 2, fc=color, ec="none", zorder=4))
    axis.text(middle, y + 19, label, ha="center", va="bottom", color=color)


def _mass(axis: Any, x: float, y: float, width: float, height: float, text: str, color: str) -> None:
    axis.add_patch(
        FancyBboxPatch(
            (x - width / 2, y - height / 2),
            width,
            height,
            boxstyle="round,pad=0,rounding_size=4",
            fc="white",
            ec=color,
            lw=2,
            zorder=3,
        )
    )
    axis.text(x, y, text, ha="center", va="center", color=color, zorder=4, linespacing=1.35)


def _panel(
    axis: Any, x: float, y: float, width: float, height: float, color: str, text: str, ink: str
) -> None:
    axis.add_patch(
        FancyBboxPatch(
            (x, y), width, height, boxstyle="round,pad=0,rounding_size=8", fc=color, ec="none", zorder=0
        )
    )
    axis.text(x + 10, y + height - 9, text, ha="left", va="top", color=ink, weight="bold")


def _arrow(axis: Any, start: tuple[float, float], end: tuple[float, float], color: str = BLACK) -> None:
    style = {
        "arrowstyle": "-|>",
        "color": color,
        "lw": LINE,
        "shrinkA": 0,
        "shrinkB": 0,
        "mutation_scale": 13,
    }
    axis.annotate("", end, start, arrowprops=style)


def draw_network() -> Figure:
    """The joint, drawn as if it moved along a line, and the virtual mechanism the motor imitates."""
    figure, axis = _canvas(9.0, 2.7)
    _panel(axis, 12, 12, 416, 246, VIRTUAL, "virtual: computed, and imitated by the motor", BLUE)
    _panel(axis, 440, 12, 448, 246, REAL, "real: motor, transmission, load", BLACK)
    y = 142
    _ground(axis, 52, y - 62, y + 62, BLUE)
    _line(axis, (52, y + 32), (66, y + 32), color=BLUE)
    _line(axis, (52, y - 32), (66, y - 32), color=BLUE)
    _spring(axis, 66, 190, y + 32, BLUE, "spring  $K$")
    _damper(axis, 66, 190, y - 32, BLUE, "dashpot  $D$")
    _line(axis, (190, y + 32), (190, y - 32), color=BLUE)
    _line(axis, (190, y), (212, y), color=BLUE)
    axis.add_patch(Circle((212, y), 4, fc=BLUE, ec="none", zorder=4))
    axis.text(212, y - 13, "$-x_c$", ha="center", va="top", color=BLUE)
    _inerter(axis, 216, 380, y, BLUE, "virtual mass  $R\\,m$")
    _line(axis, (380, y), (462, y), color=BLUE, ls=(0, (4, 2)))
    axis.text(392, y - 10, "motor torque $u$", ha="center", va="top", color=BLUE, fontsize=8.5)
    _mass(axis, 504, y, 84, 62, "rotor  $m$\nangle $\\theta$", BLACK)
    _damper_down(axis, 504, y - 31, y - 92, BLACK, "friction  $v$, $\\tau_c$")
    _floor(axis, 504, y - 92, BLACK)
    _line(axis, (546, y), (562, y))
    _line(axis, (562, y + 24), (562, y - 24))
    _spring(axis, 562, 678, y + 24, BLACK, "stiffness  $k$")
    _damper(axis, 562, 678, y - 24, BLACK, "damping  $c$")
    _line(axis, (678, y + 24), (678, y - 24))
    _line(axis, (678, y), (754, y))
    axis.add_patch(Circle((714, y), 11, fc=VERMILLION, ec="white", lw=1.5, zorder=5))
    axis.text(714, y - 17, "torque\nsensor $\\tau_s$", ha="center", va="top", color=VERMILLION)
    _mass(axis, 816, y, 124, 62, "link, payload,\nrest of the arm,\ncontact", BLACK)
    axis.text(816, y - 40, "never modelled", ha="center", va="top", color=GREY, style="italic")
    return figure


def draw_loop() -> Figure:
    """The torque loop as a block diagram, with the position loop that is cut at release."""
    figure, axis = _canvas(9.0, 3.3)
    _panel(axis, 12, 12, 640, 306, VIRTUAL, "controller, once per period $h$", BLUE)
    _panel(axis, 664, 12, 224, 306, REAL, "joint", BLACK)
    y = 190
    _mass(axis, 776, y, 180, 92, "rotor, friction,\ntransmission,\ntorque sensor, load", BLACK)
    _mass(
        axis,
        286,
        y,
        176,
        72,
        "virtual mass\n$R m \\ddot x_c + D \\dot x_c + K x_c$\n$= R\\,(\\tau - u')$",
        BLUE,
    )
    _mass(axis, 478, y, 124, 72, "$u = (R v + D)\\,\\dot x_c$\n$+\\; K x_c$", BLUE)
    _mass(axis, 602, y, 64, 44, "limits,\nhold", BLUE)
    _arrow(axis, (374, y), (416, y), BLUE)
    axis.text(395, y + 5, "$x_c, \\dot x_c$", ha="center", va="bottom", color=BLUE)
    _arrow(axis, (540, y), (570, y), BLUE)
    _arrow(axis, (634, y), (686, y), BLUE)
    axis.text(658, y + 6, "$u'$", ha="center", va="bottom", color=BLUE)
    # the torque in effect goes back into the virtual mass
    axis.add_patch(Circle((648, y), 3, fc=BLUE, ec="none", zorder=4))
    _line(axis, (648, y), (648, y + 72), (286, y + 72), color=BLUE)
    _arrow(axis, (286, y + 72), (286, y + 36), BLUE)
    axis.text(
        470,
        y + 77,
        "torque in effect over the last period",
        ha="center",
        va="bottom",
        color=BLUE,
        fontsize=8.5,
    )
    # sensed torque
    low = 58
    _line(axis, (776, y - 46), (776, low), (700, low), color=VERMILLION)
    _arrow(axis, (700, low), (566, low), VERMILLION)
    axis.text(784, low + 28, "sensed torque\n$\\tau_s$", ha="left", va="center", color=VERMILLION)
    _mass(axis, 480, low, 172, 40, "mean over the period $h$", BLUE)
    _line(axis, (394, low), (150, low), color=BLUE)
    _arrow(axis, (150, low), (150, y - 13), BLUE)
    axis.add_patch(Circle((150, y), 13, fc="white", ec=BLUE, lw=2, zorder=3))
    axis.text(150, y, "+", ha="center", va="center", color=BLUE, weight="bold", fontsize=13, zorder=4)
    _arrow(axis, (163, y), (198, y), BLUE)
    axis.text(180, y + 6, "$\\tau$", ha="center", va="bottom", color=BLUE)
    # position loop and its switch
    top = y + 72
    _mass(axis, 78, top, 104, 46, "position loop\n$k_p$, $k_d$", GREY)
    _line(axis, (130, top), (150, top), (150, y + 56), color=GREY)
    _line(axis, (150, y + 56), (162, y + 41), color=VERMILLION)
    _arrow(axis, (150, y + 38), (150, y + 13), GREY)
    axis.text(139, y + 29, "cut at\nrelease", ha="right", va="center", color=VERMILLION, fontsize=8.5)
    _line(axis, (700, y - 46), (700, y - 66), color=GREY, ls=(0, (4, 2)))
    _line(axis, (700, y - 66), (40, y - 66), (40, top - 26), color=GREY, ls=(0, (4, 2)))
    _arrow(axis, (40, top - 28), (40, top - 23), GREY)
    axis.text(
        420,
        y - 62,
        "encoder: needed by the position loop alone",
        ha="center",
        va="bottom",
        color=GREY,
        fontsize=8.5,
    )
    return figure


def main(folder: Path) -> None:
    """Draws all pictures of docs/vpc.md into a folder."""
    from dashpot.studies.vpc_release import draw_port, draw_release

    for name, draw in (
        ("vpc-network", draw_network),
        ("vpc-loop", draw_loop),
        ("vpc-release", draw_release),
        ("vpc-port", draw_port),
    ):
        save(draw(), folder / name, pdf=False)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "docs/images"))
