"""Pictures of a certificate: the plane of R and D, and the window of loads that oscillate."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dashpot.arm.drive import Drive
from dashpot.certify.box import Box, at
from dashpot.certify.certificate import JointCertificate, block_of
from dashpot.certify.exact import at_rest, unfit
from dashpot.certify.index import settled
from dashpot.certify.joint import Scales, holds_torque, sampled_joint
from dashpot.certify.loads import loops
from dashpot.certify.map import IndexMap, index_map
from dashpot.certify.threads import one_thread
from dashpot.control.controller import ControllerConfig, JointGains, Law
from dashpot.control.sampled import VirtualPassive, empty_block, virtual_passive_block
from dashpot.support.arrays import Floats
from dashpot.support.numbers import significant
from dashpot.support.plots import BLACK, BLUE, VERMILLION, Figure, new_figure

DECADES = 1.5  # of gains shown on each side of the current ones
LOADS = np.geomspace(1e-2, 1e3, 240)  # inertias of the window, relative to the rotor's
LOWEST, INTERVALS = 1e-4, 16  # [rad per period] least angle, sub-intervals of the surplus over frequency
SLOWEST = 1e-4  # [rad per period] below which a mode is no oscillation


def gain_map(
    drive: Drive,
    gains: JointGains,
    config: ControllerConfig,
    points: int,
    *,
    there: Drive | None = None,
    scales: Scales | None = None,
    tried: int = 22,
) -> IndexMap:
    """Map around a joint's gains.

    Args:
        drive: The nominal drive, on which the law rests.
        gains: The current gains.
        config: Their controller.
        points: Of R and of D.
        there: The actual drive; None: the nominal one.
        scales: Of the signal path; None: nominal.
        tried: See `index_map`.
    """
    m, v = gains.model(drive)
    latency = config.latency

    def block(R: float, D: float) -> NDArray[np.void]:
        made = virtual_passive_block(VirtualPassive(R, D, gains.K, m, v), config.period, config.form)
        made["latency"] = latency
        return made

    spread = np.logspace(-DECADES, DECADES, points)
    return index_map(
        there or drive,
        block,
        (gains.kp, gains.kd),
        config.sampling,
        config.period,
        gains.R * spread,
        gains.D * spread,
        scales=scales or Scales(),
        tried=tried,
    )


def draw_map(found: IndexMap, drive: Drive, gains: JointGains, config: ControllerConfig) -> Figure:
    """The map alone."""
    figure, axes = new_figure(1, 1, 6.6, 5.4)
    _map(axes[0, 0], found, gains, figure)
    axes[0, 0].set_title(f"{drive.name}: {gains.text}, {config.form} form", parse_math=False)
    return figure


def draw(joint: JointCertificate, drive: Drive, law: Law, config: ControllerConfig, points: int) -> Figure:
    """The map with the current point, or the port's damping over frequency; and that with every inertia."""
    figure, axes = new_figure(1, 2, 11.0, 4.6, width_ratios=(1.15, 1))
    if isinstance(law, JointGains):
        _plane(axes[0, 0], joint, drive, law, config, points, figure)
        axes[0, 0].set_title(f"{law.text}, {config.form} form")
    else:
        _surplus(axes[0, 0], joint, drive, law, config)
        constant = holds_torque(block_of(drive, law, config))
        text = law.text + (", around the torque it holds" if constant else "")
        axes[0, 0].set_title(text, parse_math=False)
    _window(axes[0, 1], joint, drive, law, config)
    verdict = "certified" if joint.certified else "not certified"
    figure.suptitle(
        f"{joint.name}: {verdict}, index {_number(joint.nominal.value)} nominal, "
        f"{_number(joint.box.worst.value)} at worst",
        parse_math=False,
    )
    return figure


def _plane(
    axis: Any,
    joint: JointCertificate,
    drive: Drive,
    gains: JointGains,
    config: ControllerConfig,
    points: int,
    figure: Figure,
) -> None:
    found = gain_map(drive, gains, config, points)
    there, scales = at(drive, joint.box.point)
    worst = None
    if (
        scales.latency == config.latency
        and joint.box.point != Box.of(drive, block_of(drive, gains, config)).centre
    ):
        worst = gain_map(
            drive, gains, config, points, there=there, scales=replace(scales, latency=None), tried=0
        )
    _map(axis, found, gains, figure, worst)


def _number(value: float) -> str:
    return f"{significant(value, 2)} N m s/rad" if np.isfinite(value) else "unstable"


def _map(
    axis: Any, found: IndexMap, gains: JointGains, figure: Figure, worst: IndexMap | None = None
) -> None:
    """Regions of the plane; colour is backed by hatching and line style."""
    axis.set(xscale="log", yscale="log", xlabel="R [-]", ylabel="D [N m s/rad]")
    axis.grid(False)
    axis.set_facecolor("#E9E9E9")
    index = np.where(found.index >= 0, found.index, np.nan)
    if np.isfinite(index).any() and np.nanmax(index) > 0:
        shade = axis.pcolormesh(
            found.R,
            found.D,
            np.ma.masked_invalid(index),
            cmap="Blues",
            vmin=-0.35 * np.nanmax(index),
            vmax=1.15 * np.nanmax(index),
            shading="nearest",
            rasterized=True,
        )
        bar = figure.colorbar(
            shade, ax=axis, pad=0.02, aspect=30, boundaries=np.linspace(0, np.nanmax(index), 64)
        )
        bar.set_label("certified: index [N m s/rad]")
        bar.locator = _few()
        bar.update_ticks()
    _boundary(axis, found, "-", 1.6)
    shaky = _upsampled(found)
    if shaky.any():
        with _hatched():
            axis.contourf(found.R, found.D, shaky, levels=[0.5, 1.5], colors="none", hatches=["////"])
    handles = _legend(found, worst)
    if worst is not None:
        _boundary(axis, worst, "--", 1.3)
    axis.plot(gains.R, gains.D, "*", ms=15, mfc="white", mec=BLACK, mew=1.3, zorder=5)
    axis.set_xlim(found.R[0], found.R[-1])
    axis.set_ylim(found.D[0], found.D[-1])
    axis.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=2, fontsize=8.5)


def _bounded(found: IndexMap) -> bool:
    """Whether there is anything between certified and not to draw."""
    return bool((found.index >= 0).any() and (found.index < 0).any())


def _boundary(axis: Any, found: IndexMap, dash: str, width: float) -> None:
    """Where the index is zero; between gains its logarithm is interpolated, it varies over decades."""
    finite = found.index[np.isfinite(found.index)]
    if not _bounded(found):
        return
    small = 0.02 * finite.max() + 1e-12
    value = np.arcsinh(np.maximum(found.index, finite.min()) / small)
    axis.contour(found.R, found.D, value, levels=[0], colors=BLACK, linewidths=width, linestyles=dash)


def _upsampled(found: IndexMap) -> Floats:
    """Whether a load oscillates, at every gain: that of the nearest gain at which loads were tried."""
    rows, columns = found.coarse
    nearest = [
        np.abs(np.subtract.outer(np.arange(size), tried)).argmin(1)
        for size, tried in zip(found.index.shape, (rows, columns), strict=True)
    ]
    return np.where(found.index < 0, found.oscillates[np.ix_(*nearest)], 0.0)


def _few() -> Any:
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(5)


def _hatched() -> Any:
    import matplotlib as mpl

    return mpl.rc_context({"hatch.color": VERMILLION, "hatch.linewidth": 0.6})


def _legend(found: IndexMap, worst: IndexMap | None) -> list[Any]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    with _hatched():
        handles: list[Any] = [
            Line2D([], [], marker="*", ls="", ms=12, mfc="white", mec=BLACK, label="this controller"),
            Patch(fc="#E9E9E9", ec="none", label="not certified"),
        ]
        if _bounded(found):
            handles.append(Line2D([], [], color=BLACK, lw=1.6, label="boundary, nominal drive"))
        if found.oscillates.any():
            handles.append(Patch(fc="#E9E9E9", ec=VERMILLION, hatch="////", label="an inertia oscillates"))
    if worst is not None and _bounded(worst):
        handles.append(Line2D([], [], color=BLACK, lw=1.3, ls="--", label="boundary, worst point found"))
    return handles


Curve = tuple[str, Drive, Scales, str, str]


def _curves(joint: JointCertificate, drive: Drive, config: ControllerConfig) -> list[Curve]:
    """Label, drive, signal path, colour and dash of the nominal joint and of its worst point."""
    curves = [("nominal drive", drive, Scales(), BLUE, "-")]
    there, scales = at(drive, joint.box.point)
    if there != replace(drive, uncertainty={}) or scales != Scales(latency=config.latency):
        curves.append(("worst point of the box", there, scales, VERMILLION, "--"))
    return curves


def _surplus(axis: Any, joint: JointCertificate, drive: Drive, law: Law, config: ControllerConfig) -> None:
    """Damping the port shows over frequency: below zero it gives out energy."""
    block = block_of(drive, law, config)
    block = empty_block() if holds_torque(block) else block
    angles = np.geomspace(LOWEST, np.pi, 400)
    frequency = angles / (2 * np.pi * config.period)
    lowest, highest = 0.0, drive.damping
    for label, actual, path, colour, dash in _curves(joint, drive, config):
        found = sampled_joint(actual, block, config.sampling, config.period, path)
        rest = at_rest(found)
        reason = unfit(rest)
        if reason:
            axis.plot([], [], dash, color=colour, label=f"{label}: unstable, link held")
            continue
        damping = settled(found, rest, INTERVALS).least_damping(angles) + actual.link_friction
        axis.plot(frequency, damping, dash, color=colour, label=label)
        lowest, highest = min(lowest, float(damping.min())), max(highest, float(damping.max()))
    linear = max(drive.damping, 1e-3 * max(highest, -lowest))
    axis.set_xscale("log")
    if max(highest, -lowest) > 10 * linear:
        axis.set_yscale("symlog", linthresh=linear)
    bottom = 2 * lowest if lowest < -linear else lowest - 0.3 * linear
    axis.axhspan(bottom, 0, color=VERMILLION, alpha=0.12, lw=0)
    axis.axhline(0, color=BLACK, lw=0.8)
    axis.text(
        0.02, 0.02, "gives out energy", transform=axis.transAxes, color=VERMILLION, va="bottom", fontsize=9
    )
    axis.set(xlabel="frequency of the motion at the port [Hz]", ylabel="damping at the port [N m s/rad]")
    axis.set_xlim(frequency[0], frequency[-1])
    axis.set_ylim(bottom, 1.5 * highest)
    axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=2, fontsize=8.5)


def _window(axis: Any, joint: JointCertificate, drive: Drive, law: Law, config: ControllerConfig) -> None:
    """Damping ratio of the least damped oscillation against the load's inertia."""
    block = block_of(drive, law, config)
    inertias = np.maximum(LOADS * drive.rotor_inertia, drive.link_inertia)
    lowest = highest = 0.0
    for label, actual, path, colour, dash in _curves(joint, drive, config):
        ratio, _ = damping_ratio(actual, block, config, inertias, path)
        axis.plot(inertias, ratio, dash, color=colour, label=label)
        if np.isfinite(ratio).any():
            lowest, highest = min(lowest, float(np.nanmin(ratio))), max(highest, float(np.nanmax(ratio)))
    bottom = min(-0.1, 1.15 * max(lowest, -1.0))
    axis.axhspan(bottom, 0, color=VERMILLION, alpha=0.12, lw=0)
    axis.axhline(0, color=BLACK, lw=0.8)
    axis.text(0.02, 0.02, "oscillates", transform=axis.transAxes, color=VERMILLION, va="bottom", fontsize=9)
    axis.set(xscale="log", xlabel=r"inertia on the joint [kg m$^2$]", ylabel="damping ratio [-]")
    axis.set_xlim(inertias[0], inertias[-1])
    axis.set_ylim(bottom, min(1.02, max(0.2, 1.15 * highest)))
    axis.set_title("Least damped oscillation with a free load")
    axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=2, fontsize=8.5)
    if joint.counterexample is not None and joint.counterexample.load.stiffness == 0:
        load = joint.counterexample
        across = np.log(load.load.inertia / inertias[0]) / np.log(inertias[-1] / inertias[0])
        axis.plot(load.load.inertia, 0, "v", color=BLACK, ms=7, zorder=5)
        axis.annotate(
            f"{load.load.inertia:.2g} kg m$^2$: {load.frequency:.3g} Hz",
            (load.load.inertia, 0),
            (0, 10),
            textcoords="offset points",
            ha="left" if across < 0.25 else "right" if across > 0.75 else "center",
            fontsize=8.5,
        )


@one_thread
def damping_ratio(
    drive: Drive, block: NDArray[np.void], config: ControllerConfig, inertias: Floats, scales: Scales
) -> tuple[Floats, Floats]:
    """Damping ratio and frequency [Hz] of the least damped oscillation with each inertia, (k,) each."""
    joint = sampled_joint(drive, block, config.sampling, config.period, scales)
    values = np.linalg.eigvals(loops(joint, inertias, np.zeros_like(inertias), drive.link_friction))
    with np.errstate(divide="ignore", invalid="ignore"):
        s = np.log(values.astype(complex))
        ratio = np.where(np.abs(s.imag) > SLOWEST, -s.real / np.abs(s), np.inf)
    least = ratio.argmin(-1)
    rows = np.arange(len(inertias))
    found = ratio[rows, least]
    frequency = np.abs(s.imag[rows, least]) / (2 * np.pi * config.period)
    return np.where(np.isfinite(found), found, np.nan), frequency
