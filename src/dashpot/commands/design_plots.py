"""Picture of a joint's design: the trade-off, the stop, and where the gains lie in what is certified."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dashpot.certify.threads import one_thread
from dashpot.control.sampled import BLOCK_DTYPE, TORQUE, empty_block
from dashpot.design import candidates as quantity
from dashpot.design.candidates import Gains
from dashpot.design.design import JointDesign
from dashpot.design.motion import move
from dashpot.design.prover import Prover
from dashpot.design.quantities import QUANTITIES, binding_text
from dashpot.design.wishes import AT_LEAST
from dashpot.support.arrays import Floats
from dashpot.support.numbers import significant
from dashpot.support.plots import BLACK, BLUE, GREEN, GREY, PURPLE, VERMILLION, Figure, new_figure

LABEL, LINE = 34.0, 13.5  # [points] below an axis for its labels, and for a line of its legend
ORANGE, SKY = "#E69F00", "#56B4E9"
DECADES = 1.0  # of R and D shown on each side of the design
COARSE, HALVINGS = 9, 2  # gains per axis tested at first, and how often the edge is then refined
SILENT = 1e-12  # torque feedback that is none; `move` wants controllers that hear the torque
EDGE = 1e-3  # logarithm by which a limit may seem broken by rounding
NONE = 1e-9  # in units of people: a quantity that is zero but for rounding
NO_LOAD = 1e-9  # [N m]
LIMITS: dict[str, tuple[str, Any]] = {
    "authority": (VERMILLION, "--"),
    "error_ratio": (GREEN, ":"),
    "noise": (PURPLE, "-."),
    "damping_ratio": (BLUE, (0, (6, 1.5, 1, 1.5, 1, 1.5))),
    "load_error": (GREY, (0, (7, 2))),
    "creep": (ORANGE, (0, (1, 1))),
    "stop_time": (ORANGE, "-."),
    "travel": (SKY, "--"),
}
"""Limits drawn as lines over R and D: colour and dash."""
BEST, GOOD, NOT = "#BBD9EE", "#E6F1F8", "#EBEBEB"
STAR: dict[str, Any] = {
    "marker": "*",
    "ms": 15,
    "mfc": "white",
    "mec": BLACK,
    "mew": 1.3,
    "ls": "",
    "zorder": 6,
}


@one_thread
def draw(joint: JointDesign) -> Figure:
    """The picture of a joint that has gains."""
    assert joint.found is not None
    figure, axes = new_figure(1, 3, 12.0, 4.7, layout=None, width_ratios=(1, 1, 1.05))
    _trade_off(axes[0, 0], joint)
    _stop(axes[0, 1], joint)
    _plane(axes[0, 2], joint)
    gains = joint.found.gains.joint(joint.name)
    loop = f", kp = {gains.kp:g} N m/rad, kd = {gains.kd:g} N m s/rad" if gains.kp or gains.kd else ""
    figure.suptitle(
        f"{joint.name}: R = {gains.R:g}, D = {gains.D:g} N m s/rad, K = {gains.K:g} N m/rad{loop}",
        parse_math=False,
        fontweight="bold",
    )
    _lay_out(figure)
    return figure


def _lay_out(figure: Figure) -> None:
    """Panels in fixed places, legends below their labels; a layout engine takes a second for the same."""
    height = 72 * figure.get_figheight()
    rows = max(math.ceil(len(legend.get_texts()) / 2) for legend in _legends(figure))
    bottom, top = LABEL + LINE * rows + 8, height - 46
    figure.subplots_adjust(0.055, bottom / height, 0.985, top / height, wspace=0.22)
    for legend in _legends(figure):
        legend.set_bbox_to_anchor((0.5, -LABEL / (top - bottom)), transform=legend.axes.transAxes)


def _legends(figure: Figure) -> list[Any]:
    found = (axis.get_legend() for axis in figure.axes)
    return [legend for legend in found if legend is not None]


def _axis_label(name: str) -> str:
    unit = QUANTITIES[name].unit or "-"
    return f"{QUANTITIES[name].label} [{unit}]"


def _below(axis: Any, handles: list[Any] | None = None) -> None:
    options: dict[str, Any] = {} if handles is None else {"handles": handles}
    axis.legend(
        loc="upper center",
        ncols=2,
        fontsize=8,
        handlelength=1.6,
        columnspacing=1.0,
        handletextpad=0.5,
        **options,
    )


def _trade_off(axis: Any, joint: JointDesign) -> None:
    """Wish against the second quantity, of everything certified that the search looked at closer."""
    curve = joint.trade_off
    assert curve is not None
    wish, other = QUANTITIES[joint.wishes.minimise], QUANTITIES[curve.against]
    axis.set_title("What the wish costs (weakest torque channel)")
    axis.set(xlabel=_axis_label(curve.against), ylabel=_axis_label(joint.wishes.minimise))
    everything = np.abs(np.asarray(curve.all)) * [wish.factor, other.factor]
    front = np.stack([np.abs(curve.wish) * wish.factor, curve.other * other.factor], axis=1)
    usable = np.isfinite(everything).all(1) & (everything > NONE).all(1)
    if not usable.any():
        text = (
            "No payload acts about this axis,\nso that there is no error to trade.\n"
            "Gains are chosen as for a small load."
            if joint.duty.load < NO_LOAD
            else "Nothing to trade: one of both is zero."
        )
        axis.text(0.5, 0.5, text, transform=axis.transAxes, ha="center", va="center", color=GREY)
        axis.set(xticks=[], yticks=[])
        return
    axis.set(xscale="log", yscale="log")
    axis.plot(
        everything[usable, 1],
        everything[usable, 0],
        "o",
        color=GREY,
        ms=4,
        alpha=0.45,
        label="passed the quick tests",
        mew=0,
    )
    front = front[np.isfinite(front).all(1) & (front > NONE).all(1)]
    front = front[np.argsort(front[:, 1])]
    if len(front) > 1:
        axis.step(
            front[:, 1], front[:, 0], where="post", color=BLUE, lw=1.6, label="none better in both", zorder=3
        )
        axis.plot(front[:, 1], front[:, 0], "o", color=BLUE, ms=4.5, zorder=4)
    axis.plot(everything[0, 1], everything[0, 0], **STAR, label="this design")
    for name, line in ((joint.wishes.minimise, axis.axhline), (curve.against, axis.axvline)):
        limit = joint.wishes.limits.get(name)
        if limit is not None:
            line(
                limit * QUANTITIES[name].factor,
                color=VERMILLION,
                ls="--",
                lw=1.2,
                label=f"limit: {QUANTITIES[name].label}",
            )
    _roomy(axis)
    _below(axis)


def _roomy(axis: Any) -> None:
    """At least a decade on both axes, and ticks that can be read."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    for low, high, set_limits, side in (
        (*axis.get_xlim(), axis.set_xlim, axis.xaxis),
        (*axis.get_ylim(), axis.set_ylim, axis.yaxis),
    ):
        middle, half = math.sqrt(low * high), max(math.sqrt(high / low) * 1.08, math.sqrt(10))
        set_limits(middle / half, middle * half)
        few = half > 10**1.5
        side.set_major_locator(LogLocator(subs=(1.0,) if few else (1.0, 2.0, 5.0), numticks=12))
        side.set_major_formatter(FuncFormatter(lambda number, _: f"{number:g}"))
        side.set_minor_formatter(NullFormatter())


def _stop(axis: Any, joint: JointDesign) -> None:
    """Speed of the link once the encoder is lost."""
    assert joint.found is not None
    duty, gains = joint.duty, joint.found.gains
    stop = joint.predicted["stop_time"]
    duration = min(max(2.5 * stop, 40 * duty.period), quantity.STOP_HORIZON)
    brake = duty.blocks(gains, brake=True)
    free = np.empty(1, BLOCK_DTYPE)
    free[0] = empty_block()
    free["D"][:, TORQUE] = SILENT
    free["torque_limit"], free["rate_limit"], free["latency"] = duty.drive.torque_limit, np.inf, duty.latency
    curves = [("no controller, friction alone", free, duty.loaded, 0.0, GREY, ":")]
    if duty.loaded > 1.02 * duty.inertia:
        curves.append(("link alone", brake, duty.inertia, 0.0, GREEN, "--"))
    curves.append(("largest inertia", brake, duty.loaded, 0.0, BLUE, "-"))
    if duty.load > NO_LOAD:
        curves.append(("the same, the load pulling on", brake, duty.loaded, duty.load, VERMILLION, "-."))
    lowest, highest = 0.0, duty.speed
    for label, block, inertia, load, colour, dash in curves:
        found = move(
            duty.drive,
            block,
            duty.sampling,
            duty.period,
            inertia,
            speed=duty.speed,
            duration=duration,
            load=load,
        )
        speed = found.speed[:, 0]
        if block is brake:
            lowest, highest = min(lowest, float(speed.min())), max(highest, float(speed.max()))
        axis.plot(1e3 * found.time, speed, dash, color=colour, lw=1.6, label=label)
    band = duty.residual * duty.speed
    axis.axhspan(
        -band, band, color="#E4E4E4", lw=0, zorder=0, label=f"stopped: below {100 * duty.residual:g} %"
    )
    # A load that drags the joint along leaves the picture.
    axis.set_ylim(
        max(min(1.15 * lowest, -0.12 * duty.speed), -duty.speed), min(1.12 * highest, 1.6 * duty.speed)
    )
    axis.set_xlim(0, 1e3 * duration)
    if stop < duration:
        axis.plot(1e3 * stop, 0.0, "v", color=BLACK, ms=7, zorder=5)
        axis.annotate(
            f"stopped after {significant(1e3 * stop)} ms",
            (1e3 * stop, band),
            (1e3 * stop, 0.3 * duty.speed),
            ha="left",
            fontsize=9,
            arrowprops={"arrowstyle": "-", "color": BLACK, "lw": 0.8},
        )
    axis.set(xlabel="time since the encoder was lost [ms]", ylabel="link speed [rad/s]")
    axis.set_title("The stop, on torque alone")
    _below(axis)


def _plane(axis: Any, joint: JointDesign) -> None:
    """R and D around the design: what is certified, and where limits end."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch
    from matplotlib.patheffects import withTickedStroke

    assert joint.found is not None
    gains = joint.found.gains
    count = 2**HALVINGS * (COARSE - 1) + 1
    spread = np.logspace(-DECADES, DECADES, count)
    R, D = float(gains.R[0]) * spread, float(gains.D[0]) * spread
    good = certified(joint, R, D)
    axis.set(xscale="log", yscale="log", xlabel="R [-]", ylabel="D [N m s/rad]")
    axis.set_facecolor(NOT)
    axis.grid(False)
    handles: list[Any] = [Line2D([], [], **{**STAR, "ms": 12}, label="this design")]
    field = _smooth(good.astype(float))
    lines = _limits(joint, R[::2], D[::2])
    kept = np.minimum.reduce([field[::2, ::2] - 0.5, *(EDGE - level for _, level in lines)])
    axis.contourf(R, D, field, levels=[0.5, 2], colors=[GOOD])
    axis.contourf(R[::2], D[::2], kept, levels=[0.0, 1e9], colors=[BEST])
    if field.min() < 0.5 < field.max():
        axis.contour(R, D, field, levels=[0.5], colors=BLACK, linewidths=1.4)
    if lines:
        handles.append(Patch(fc=BEST, ec="none", label="certified, every limit kept"))
    handles.append(Patch(fc=GOOD if lines else BEST, ec=BLACK, label="certified with margin"))
    handles.append(Patch(fc=NOT, ec="none", label="not certified"))
    for name, level in lines:
        if level.min() < 0 < level.max():
            colour, dash = LIMITS[name]
            border = axis.contour(
                R[::2], D[::2], level, levels=[0.0], colors=colour, linestyles=[dash], linewidths=1.5
            )
            border.set(path_effects=[withTickedStroke(angle=60, spacing=9, length=0.55)])
            text = binding_text(name, joint.wishes.limits, joint.wishes.margin)
            handles.append(Line2D([], [], color=colour, ls=dash, lw=1.5, label=text))
    axis.plot(gains.R, gains.D, **STAR)
    axis.set_xlim(R[0], R[-1])
    axis.set_ylim(D[0], D[-1])
    _ticks(axis)
    axis.set_title(
        "Around it, " + ("kp, kd and K as they are" if gains.kp[0] or gains.kd[0] else "K as it is")
    )
    _below(axis, handles)


def _limits(joint: JointDesign, R: Floats, D: Floats) -> list[tuple[str, Floats]]:
    """Logarithm of every quantity over its limit, positive where it is broken, (len(D), len(R)) each."""
    assert joint.found is not None
    gains, duty, limits = joint.found.gains, joint.duty, joint.wishes.limits
    weak = replace(duty, torque_gain=1 - duty.drive.torque_gain_error)  # as limits are judged
    r, d = np.meshgrid(R, D)
    grid = _like(gains, r.ravel(), d.ravel())
    found = []
    for name in LIMITS:
        if name in limits and name in joint.predicted:
            values = np.clip(getattr(quantity, name)(weak, grid).reshape(r.shape), 1e-9, 1e9)
            level = np.log(values / max(limits[name], 1e-9))
            found.append((name, -level if name in AT_LEAST else level))
    return found


def _ticks(axis: Any) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    for side in (axis.xaxis, axis.yaxis):
        side.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=12))
        side.set_major_formatter(FuncFormatter(lambda number, _: f"{number:g}"))
        side.set_minor_formatter(NullFormatter())


def _smooth(field: Floats) -> Floats:
    from scipy.ndimage import gaussian_filter

    return np.asarray(gaussian_filter(field, 0.8, mode="nearest"))


def _like(gains: Gains, R: Floats, D: Floats) -> Gains:
    """Candidates with other R and D, (k,) each."""
    same = np.ones(len(R))
    return Gains(R, D, float(gains.K[0]) * same, float(gains.kp[0]) * same, float(gains.kd[0]) * same)


@one_thread
def certified(joint: JointDesign, R: Floats, D: Floats) -> NDArray[np.bool_]:
    """Whether gains pass the tests that refused candidates of the search, with margin, (len(D), len(R)).

    A coarse grid is tested, then what lies between grid points that differ.
    """
    assert joint.found is not None
    duty, gains, margin = joint.duty, joint.found.gains, joint.wishes.margin
    loop = bool(gains.kp[0] or gains.kd[0])
    provers = []
    for brake in (False, True) if loop else (True,):
        prover = Prover(duty, duty.blocks(gains, brake=brake)[0], margin)
        prover.expect(joint.found.refusals[brake])
        provers.append((brake, prover))

    def test(where: NDArray[np.int64]) -> NDArray[np.bool_]:
        some = _like(gains, R[where[:, 1]], D[where[:, 0]])
        passed = np.ones(len(where), bool)
        for brake, prover in provers:
            blocks = duty.blocks(some, brake=brake)
            for i in np.flatnonzero(passed):
                passed[i] = prover.passes(blocks[i], "quick")
        return passed

    step = 2**HALVINGS
    good = np.zeros((len(D), len(R)), bool)
    where = np.argwhere(np.ones((COARSE, COARSE), bool))
    good[::step, ::step] = test(where * step).reshape(COARSE, COARSE)
    while step > 1:
        half = step // 2
        coarse = good[::step, ::step]
        finer = np.kron(coarse, np.ones((2, 2), bool))[:-1, :-1]
        neighbours = np.stack(
            [finer, np.roll(finer, -1, 0), np.roll(finer, -1, 1), np.roll(finer, (-1, -1), (0, 1))]
        )
        mixed = neighbours.any(0) & ~neighbours.all(0)
        mixed |= np.roll(mixed, 1, 0) | np.roll(mixed, 1, 1)
        mixed[::2, ::2] = False
        found = finer.copy()
        cells = np.argwhere(mixed)
        found[mixed] = test(cells * half)
        good[::half, ::half] = found
        step = half
    return good
