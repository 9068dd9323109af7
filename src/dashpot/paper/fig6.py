"""Fig. 6: the paper's two instabilities, found on the linearised arm, shown in simulation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.signal import butter, sosfiltfilt

from dashpot.control.controller import Controller, load_controller
from dashpot.paper.instability import (
    APART,
    PARALLEL,
    HighGain,
    describe_resonance,
    growth,
    poses,
    search_high_gain,
)
from dashpot.paper.relations import Relation, judge
from dashpot.paper.setup import PERIOD, RELEASE, WRIST, Setup, loaded, setup
from dashpot.simulation.linear import closed_loop, linearise
from dashpot.simulation.recording import Recording
from dashpot.simulation.simulate import Event, Scenario, run_many
from dashpot.simulation.trajectory import Trajectory, multisine
from dashpot.support.arrays import Floats
from dashpot.support.plots import BLACK, BLUE, GREEN, GREY, PURPLE, VERMILLION, Figure, new_figure
from dashpot.support.waiting import waiting

DURATION = 5.0  # [s]
SWING = 0.2  # amplitude of the other joints [rad]
STRAIGHT = 1.5  # [s], when joint 6 is nearly straight
TAP_AT, TAP_TIME, TAP_TORQUE = (
    1.25,
    0.1,
    20.0,
)  # [s], [s], [N m]: a half-sine tap on the hand about joint 7's axis
EARLY, LATE, AFTER = (1.5, 2.0), (2.5, 3.0), (3.75, 4.75)  # [s]
FAST, SLOW = 20.0, 2.0  # corners of the high-pass that separates vibration from motion, (a) and (b) [Hz]

APART_CASE, UNTAPPED_CASE = "5 lb, axes apart", "5 lb, not tapped"
CASES: dict[str, tuple[int, tuple[str, ...]]] = {
    "0 lb": (0, ()),
    "5 lb": (5, ()),
    "10 lb": (10, ()),
    "5 lb, joint 5 bypassed": (5, ("joint5",)),
    "5 lb, joint 7 bypassed": (5, ("joint7",)),
    "5 lb, joint 6 bypassed": (5, ("joint6",)),
    APART_CASE: (5, ()),
    UNTAPPED_CASE: (5, ()),
}
"""Resonance runs: payload [lb] and bypassed joints."""
HIGH_CASES = {"high gains, 0 lb": (0, True), "high gains, 10 lb": (10, True), "lower gains, 0 lb": (0, False)}
"""High-gain runs: payload [lb] and whether the gains are high."""


@dataclass(frozen=True)
class Fig6:
    """Vibration of the sensed torque.

    Attributes:
        high: What the high-gain search found.
        high_rms: Case -> RMS of that joint's torque above 20 Hz, (seeds,) [N m].
        resonant: What the linearised arm says of the resonant gains.
        rms: Case -> RMS above 2 Hz, (seeds, windows early/late/after, joints 5-7) [N m].
        window: Payloads [lb] and growth rates [1/s] of the linearised arm, (2, n).
        time: (ticks,) [s].
        high_traces: Case -> torque samples of the high-gain joint, first seed, (ticks,) [N m].
        traces: Case -> torque samples of joints 5 and 7, first seed, (ticks, 2) [N m].
    """

    high: HighGain
    high_rms: dict[str, Floats]
    resonant: dict[str, Any]
    rms: dict[str, Floats]
    window: Floats
    time: Floats
    high_traces: dict[str, Floats]
    traces: dict[str, Floats]


def towards_parallel(s: Setup, seed: int, end: float = PARALLEL) -> Trajectory:
    """A random motion in which joint 6 goes from `APART` to an angle [rad], nearly straight by default."""
    base = multisine(s.robot.home, DURATION, PERIOD, seed, amplitude=SWING)
    j = s.robot.index("joint6")
    u = np.clip(base.time / STRAIGHT, 0, 1)
    share = [
        u**3 * (10 - 15 * u + 6 * u**2),
        30 * u**2 * (1 - u) ** 2 / STRAIGHT,
        60 * u * (1 - u) * (1 - 2 * u) / STRAIGHT**2,
    ]
    way = end - APART
    position, velocity, acceleration = base.position.copy(), base.velocity.copy(), base.acceleration.copy()
    position[:, j] = APART + way * share[0]
    velocity[:, j], acceleration[:, j] = way * share[1], way * share[2]
    return Trajectory(PERIOD, position, velocity, acceleration, base.start)


def vibration(recording: Recording, joints: list[int], corner: float, window: tuple[float, float]) -> Floats:
    """RMS of the sensed torque above a corner [Hz] in a time window [s], (joints,) [N m]."""
    filtered = sosfiltfilt(
        butter(4, corner, "high", fs=1 / PERIOD, output="sos"), recording.sample[:, joints], axis=0
    )
    inside = (recording.time >= window[0]) & (recording.time < window[1])
    rms: Floats = np.sqrt((filtered[inside] ** 2).mean(0))
    return rms


def run(seeds: int = 10, threads: int | None = None) -> Fig6:
    """Searches the high gains, checks the resonant ones when linearised, simulates every case and seed."""
    s = setup()
    with waiting("Fig. 6: looking for gains"):
        high = search_high_gain()
    controllers = {True: s.controller(high.high, "explicit"), False: s.controller(high.low, "explicit")}
    resonant = load_controller("k807-resonant")
    controller = s.controller(resonant.gains)
    j = s.robot.index(high.joint)

    scenarios = []
    for seed in range(seeds):
        path = multisine(s.robot.home, 3.0, PERIOD, seed, amplitude=SWING)
        scenarios += [
            Scenario(s.plants[lb], controllers[is_high], path, seed=seed, label=case)
            for case, (lb, is_high) in HIGH_CASES.items()
        ]
    fast = _collect(scenarios, threads, "Fig. 6: high gains")
    high_rms = {
        case: np.array([vibration(r, [j], FAST, (1.0, 3.0))[0] for r in runs]) for case, runs in fast.items()
    }

    scenarios = []
    for seed in range(seeds):
        scenarios += [_resonance(s, controller, seed, case) for case in CASES]
    slow = _collect(scenarios, threads, "Fig. 6: resonance")
    wrist = [s.robot.index(name) for name in WRIST]
    rms = {
        case: np.array([[vibration(r, wrist, SLOW, w) for w in (EARLY, LATE, AFTER)] for r in slow[case]])
        for case in CASES
    }
    with waiting("Fig. 6: the linearised arm"):
        described, window = describe_resonance(s, resonant.gains), _window(s, controller)
    return Fig6(
        high,
        high_rms,
        described,
        rms,
        window,
        slow["5 lb"][0].time,
        {case: runs[0].sample[:, j] for case, runs in fast.items()},
        {case: slow[case][0].sample[:, [wrist[0], wrist[2]]] for case in list(CASES)[:6]},
    )


def tap(time: Floats) -> Floats:
    """The tap, (ticks,) [N m]."""
    phase = np.clip((time - TAP_AT) / TAP_TIME, 0, 1)
    return TAP_TORQUE * np.sin(np.pi * phase)


def _resonance(s: Setup, controller: Controller, seed: int, case: str) -> Scenario:
    lb, bypassed = CASES[case]
    path = towards_parallel(s, seed, APART if case == APART_CASE else PARALLEL)
    events = [Event(path.start, name, "mode", "bypass") for name in bypassed]
    events.append(Event(RELEASE, "all", "position_loop", False))
    external = np.zeros_like(path.position)
    if case != UNTAPPED_CASE:
        external[:, s.robot.index("joint7")] = tap(path.time)
    return Scenario(s.plants[lb], controller, path, events, external=external, seed=seed, label=case)


def _collect(scenarios: list[Scenario], threads: int | None, label: str) -> dict[str, list[Recording]]:
    """Runs scenarios and sorts the recordings by label, in the order of the seeds."""
    done: dict[str, list[Recording]] = {}
    for scenario, recording in zip(
        scenarios, run_many(scenarios, threads=threads, progress=label), strict=True
    ):
        assert isinstance(recording, Recording)
        done.setdefault(scenario.label, []).append(recording)
    return done


def _window(s: Setup, controller: Controller) -> Floats:
    """Growth rate of the linearised arm over the payload, axes nearly parallel."""
    pounds = np.linspace(0, 12, 25)
    pose = poses(s)["parallel"][0]
    rates = []
    for lb in pounds:
        arm = linearise(loaded(s.robot, float(lb)), WRIST, pose, PERIOD, s.config.sampling)
        rates.append(float(growth(closed_loop(arm, controller.blocks))[0]))
    return np.array([pounds, rates])


def relations(result: Fig6) -> list[Relation]:
    """Every observation of the paper's two instabilities."""
    high, name = result.high_rms, result.high.joint
    loud = high["high gains, 0 lb"]
    early, late, after = 0, 1, 2
    rolls = {"joint5": 0, "joint7": 2}
    both = list(rolls.values())
    five, without6 = result.rms["5 lb"], result.rms["5 lb, joint 6 bypassed"]

    def share(case: str) -> Floats:
        ratio: Floats = (result.rms[case][:, late] / five[:, late])[:, both].max(1)
        return ratio

    found = [
        judge("fig6", name, f"(a) high gains, 0 lb: > {FAST:.0f} Hz [N m]", loud, "at least", 1),
        judge("fig6", name, "(a) at 10 lb / at 0 lb", high["high gains, 10 lb"] / loud, "at most", 0.2),
        judge("fig6", name, "(a) lower gains / high gains", high["lower gains, 0 lb"] / loud, "at most", 0.2),
    ]
    for joint, j in rolls.items():
        grown, still = five[:, late, j] / five[:, early, j], without6[:, late, j] / without6[:, early, j]
        found += [
            judge("fig6", joint, "(b) 5 lb: vibration [N m]", five[:, late, j], "at least", 1.5),
            judge("fig6", joint, "(b) 5 lb: grows in 1 s by a factor", grown, "at least", 1.2),
            judge("fig6", joint, "(b) 5 lb, joint 6 bypassed: grows by", still, "at least", 1.2),
        ]
    pair = "joints 5, 7"

    def left(case: str) -> Floats:
        ratio: Floats = (result.rms[case][:, late] / result.rms[case][:, early])[:, both].max(1)
        return ratio

    gone = (five[:, after] / five[:, late])[:, both].max(1)
    bypassed = [share(f"5 lb, joint {n} bypassed") for n in (5, 7)]
    return [
        *found,
        judge("fig6", pair, "(b) 0 lb: vibration / at 5 lb", share("0 lb"), "at most", 0.3),
        judge("fig6", pair, "(b) 10 lb: vibration / at 5 lb", share("10 lb"), "at most", 0.6),
        judge("fig6", pair, "(b) 10 lb: left 1 s after the tap", left("10 lb"), "at most", 0.8),
        judge("fig6", pair, "(b) axes apart, 5 lb: left 1 s after", left(APART_CASE), "at most", 0.8),
        judge("fig6", pair, "(b) joint 5 bypassed / not", bypassed[0], "at most", 0.3),
        judge("fig6", pair, "(b) joint 7 bypassed / not", bypassed[1], "at most", 0.3),
        judge("fig6", pair, "(b) offset removed: after / before", gone, "at most", 0.3),
    ]


def numbers(result: Fig6) -> dict[str, Any]:
    """Gains, growth rates and vibration over seeds."""
    high = result.high
    return {
        "a": {
            "joint": high.joint,
            "gains": {
                kind: {g.name: {"R": g.R, "D": g.D, "K": g.K, "kp": g.kp, "kd": g.kd} for g in gains}
                for kind, gains in (("high", high.high), ("low", high.low))
            },
            "growth_per_s": {f"{lb} lb": rate for lb, rate in high.growth.items()},
            "growth_low_gains_per_s": {f"{lb} lb": rate for lb, rate in high.growth_low.items()},
            "frequency_hz": high.frequency,
            "vibration_rms_Nm": {case: values.tolist() for case, values in result.high_rms.items()},
        },
        "b": {
            **result.resonant,
            "windows_s": {"early": EARLY, "late": LATE, "after": AFTER},
            "vibration_rms_Nm": {
                case: {
                    name: {w: values[:, k, j].tolist() for k, w in enumerate(("early", "late", "after"))}
                    for j, name in enumerate(WRIST)
                }
                for case, values in result.rms.items()
            },
            "tap": {"at_s": TAP_AT, "half_sine_s": TAP_TIME, "torque_Nm": TAP_TORQUE, "joint": "joint7"},
            "growth_over_payload": {
                "lb": result.window[0].tolist(),
                "growth_per_s": result.window[1].tolist(),
            },
        },
    }


def draw(result: Fig6) -> Figure:
    """(a) top row, (b) below: sensed torque against time, first seed."""
    figure, axes = new_figure(3, 3, 9.6, 7.2, sharex="row")
    for axis, (case, torque), color in zip(
        axes[0], result.high_traces.items(), (VERMILLION, BLUE, GREEN), strict=True
    ):
        time = result.time[: len(torque)]
        axis.plot(time, torque, color=color, lw=0.7)
        axis.set_title(f"(a) {case}")
        axis.set_xlim(0, 3)
    axes[0, 0].set_ylabel(f"{result.high.joint}\nsensed torque [N m]")
    _share_range(axes[0])
    for axis, (case, torque) in zip(axes[1:].ravel(), result.traces.items(), strict=True):
        color = {"0 lb": BLUE, "5 lb": GREEN, "10 lb": VERMILLION}.get(case, PURPLE)
        axis.plot(result.time, torque[:, 1], "--", color=BLACK, lw=0.6, label="joint7")
        axis.plot(result.time, torque[:, 0], color=color, lw=1.0, label="joint5")
        axis.axvline(RELEASE, color=GREY, lw=0.8)
        axis.axvline(TAP_AT, color=GREY, lw=0.8, ls=":")
        axis.set_title(f"(b) {case}")
        axis.set_xlim(0, DURATION)
    for axis in axes[1:, 0]:
        axis.set_ylabel("joints 5, 7\nsensed torque [N m]")
    _share_range(axes[1:].ravel())
    for axis in axes[2]:
        axis.set_xlabel("time [s]")
    top = axes[1, 0].get_ylim()[1]
    axes[1, 0].text(RELEASE + 0.05, top, "offset\nremoved", color=GREY, fontsize=8, va="top")
    axes[1, 0].text(TAP_AT - 0.05, top, "tap", color=GREY, fontsize=8, va="top", ha="right")
    axes[1, 1].legend(loc="lower right", fontsize=8)
    figure.suptitle("Fig. 6  (a) one torque loop too strong for a light load   (b) resonance at 5 lb only")
    return figure


def _share_range(axes: Any) -> None:
    low = min(axis.get_ylim()[0] for axis in axes)
    high = max(axis.get_ylim()[1] for axis in axes)
    for axis in axes:
        axis.set_ylim(low, high)


def draw_window(result: Fig6) -> Figure:
    """Growth rate of the resonance over the payload."""
    figure, axes = new_figure(1, 1, 9.6, 3.0)
    axis = axes[0, 0]
    pounds, rates = result.window
    axis.axhline(0, color=GREY, lw=1)
    axis.fill_between(pounds, 0, rates, where=rates > 0, color=VERMILLION, alpha=0.2, interpolate=True)
    axis.plot(pounds, rates, color=BLUE)
    for lb in (0, 5, 10):
        axis.plot(lb, np.interp(lb, pounds, rates), "o", color=BLUE, ms=7, fillstyle="none", mew=1.8)
    axis.set_xlabel("payload [lb]")
    axis.set_ylabel("growth rate [1/s]")
    axis.set_title("(b) on the linearised arm, axes 5 and 7 nearly parallel: the middle weight oscillates")
    return figure
