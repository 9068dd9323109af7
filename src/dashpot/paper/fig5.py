"""Fig. 5: joint 7 when its position offset is removed in mid-swing, and the pull test after it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dashpot.control.law import hold_torque, static_R
from dashpot.paper.relations import Relation, judge
from dashpot.paper.setup import AMPLITUDE, PAYLOADS, PERIOD, RELEASE, setup
from dashpot.simulation.recording import Recording
from dashpot.simulation.simulate import Event, Scenario, run_many
from dashpot.simulation.trajectory import multisine
from dashpot.support.arrays import Floats
from dashpot.support.plots import BLUE, GREEN, GREY, VERMILLION, Figure, new_figure

JOINT = "joint7"
SLOWED = 0.05  # of the speed at release
WITHIN = 0.3  # [s]
WATCHED = 3.0  # [s] after that
PULL_FROM, PULL_RATE, PULL_TIME = 7.0, 6.0, 4.0  # [s], [N m/s], [s] at most
FOLLOW = 0.3  # [s], how long it is still pulled after it yields
EASE = 2.0  # [s], over which the pull is lowered: the joint is let go, not dropped
REST = 2.0  # [s], watched after that
YIELD = np.radians(0.5)  # far above the elastic deflection at the threshold
DURATION = PULL_FROM + PULL_TIME + FOLLOW + EASE + REST


@dataclass(frozen=True)
class Fig5:
    """What joint 7 did, per payload and seed.

    Attributes:
        speed: Link speed at release, (payloads, seeds) [rad/s].
        slowed_after: Time until below 5 % of it, (payloads, seeds) [s].
        settled_after: Time after which it stays below, within 3 s, (payloads, seeds) [s].
        drift: Largest motion from 0.3 s to 3.3 s after release, (payloads, seeds) [rad].
        drift_all: The same with the offset removed on the whole wrist, (payloads, seeds) [rad].
        free_end: Distance from the nearest stop, without VPC at the end, (payloads, seeds) [rad].
        threshold: Torque transmitted when the pulled joint yields, (payloads, seeds) [N m]; NaN: it did not.
        pulled: How far it was pulled, (payloads, seeds) [rad].
        after_pull: Motion while the pull is lowered and 2 s after, (payloads, seeds) [rad].
        hold: (1+R) tau_c, and what holds where K = 0: the same with R a/D in place of R [N m].
        time: (ticks,) [s].
        braked: Link angle with VPC for the first seed, (payloads, ticks) [rad].
        free: The same without, up to the pull.
        pull: External torque of the pull, (payloads, ticks) [N m].
        stops: (2,) [rad].
    """

    speed: Floats
    slowed_after: Floats
    settled_after: Floats
    drift: Floats
    drift_all: Floats
    free_end: Floats
    threshold: Floats
    pulled: Floats
    after_pull: Floats
    hold: tuple[float, float]
    time: Floats
    braked: Floats
    free: Floats
    pull: Floats
    stops: Floats

    @property
    def seeds(self) -> int:
        """Number of seeds."""
        return int(self.speed.shape[1])


def pull_profile(time: Floats, until: float) -> Floats:
    """A torque that lifts the beam, growing until a time, then lowered over `EASE`, (ticks,) [N m]."""
    peak = PULL_RATE * (until - PULL_FROM)
    return -np.interp(time, [PULL_FROM, until, until + EASE], [0.0, peak, 0.0])


def run(seeds: int = 10, threads: int | None = None) -> Fig5:
    """Runs every payload and seed: released, pulled until it yields, let go; wrist released; without VPC."""
    s = setup()
    controller = s.controller()
    j = s.robot.index(JOINT)
    release = Event(RELEASE, JOINT, "position_loop", False)
    paths = [
        multisine(s.robot.home, DURATION, PERIOD, seed, amplitude=AMPLITUDE, peak_speed_at={j: RELEASE})
        for seed in range(seeds)
    ]
    start = paths[0].start

    def scenario(lb: int, seed: int, *events: Event, until: float | None = None) -> Scenario:
        if until is None:
            short = paths[seed].until(PULL_FROM)
            return Scenario(s.plants[lb], controller, short, events, seed=seed)
        external = np.zeros_like(paths[seed].position)
        external[:, j] = pull_profile(paths[seed].time, until)
        return Scenario(s.plants[lb], controller, paths[seed], events, external=external, seed=seed)

    def go(label: str, scenarios: list[Scenario]) -> list[Recording]:
        done = run_many(scenarios, threads=threads, progress=f"Fig. 5: {label}")
        return [r for r in done if isinstance(r, Recording)]

    cases = [(lb, seed) for lb in PAYLOADS for seed in range(seeds)]
    end = PULL_FROM + PULL_TIME
    pulled = go("brake and pull", [scenario(lb, seed, release, until=end) for lb, seed in cases])
    yields = [_yield_tick(recording, j) for recording in pulled]
    let_go = [end if k is None else float(pulled[0].time[k]) + FOLLOW for k in yields]
    stays = go(
        "let go", [scenario(lb, seed, release, until=t) for (lb, seed), t in zip(cases, let_go, strict=True)]
    )
    everywhere = Event(RELEASE, "all", "position_loop", False)
    wrist = go("whole wrist released", [scenario(lb, seed, everywhere) for lb, seed in cases])
    bypass = Event(start, JOINT, "mode", "bypass")
    free = go("without VPC", [scenario(lb, seed, bypass, release) for lb, seed in cases])

    drives = s.plants[0].drives
    stops = np.array([drives["stop_lower"][j], drives["stop_upper"][j]])
    rows = []
    for k, recording in enumerate(stays):
        row = _brake(recording, j)
        row["drift_all"] = _brake(wrist[k], j)["drift"]
        row["free_end"] = float(np.abs(free[k].link_position[-1, j] - stops).min())
        at = yields[k]
        row["threshold"] = np.nan if at is None else float(np.abs(pulled[k].torque[at, j]))
        angle, time = recording.link_position[:, j], recording.time
        begin, after = np.searchsorted(time, [PULL_FROM, let_go[k]])
        rest = int(np.searchsorted(time, let_go[k] + EASE + REST))
        row["pulled"] = float(np.abs(angle[after] - angle[begin]))
        row["after_pull"] = float(np.abs(angle[after:rest] - angle[after]).max())
        rows.append(row)
    columns = {name: np.array([row[name] for row in rows]).reshape(len(PAYLOADS), seeds) for name in rows[0]}
    drive, gains = s.robot.drives[j], s.config.gains[-1]
    short = float(static_R(gains.R, gains.D, 0.0, drive.viscous_friction))
    first = range(0, len(cases), seeds)
    return Fig5(
        **columns,
        hold=(
            float(hold_torque(drive.coulomb_friction, gains.R)),
            float(hold_torque(drive.coulomb_friction, short)),
        ),
        time=stays[0].time,
        braked=np.array([stays[k].link_position[:, j] for k in first]),
        free=np.array([free[k].link_position[:, j] for k in first]),
        pull=np.array([pull_profile(stays[0].time, let_go[k]) for k in first]),
        stops=stops,
    )


def _yield_tick(recording: Recording, j: int) -> int | None:
    """Tick at which the pulled joint has moved by `YIELD`."""
    begin = int(np.searchsorted(recording.time, PULL_FROM))
    angle = recording.link_position[begin:, j]
    moved = np.flatnonzero(np.abs(angle - angle[0]) > YIELD)
    return begin + int(moved[0]) if len(moved) else None


def _brake(recording: Recording, j: int) -> dict[str, float]:
    """How fast the joint slowed down and how far it then moved."""
    t, angle = recording.time, recording.link_position[:, j]
    speed = np.abs(recording.link_velocity[:, j])
    at = int(np.searchsorted(t, RELEASE - 1e-9))
    judged = (t > RELEASE + WITHIN) & (t <= RELEASE + WITHIN + WATCHED)
    slow = np.flatnonzero(speed[at:] < SLOWED * speed[at])
    fast = np.flatnonzero(speed[at : at + round(WATCHED / PERIOD)] >= SLOWED * speed[at])
    return {
        "speed": float(speed[at]),
        "slowed_after": float(slow[0] * PERIOD) if len(slow) else np.inf,
        "settled_after": float((fast[-1] + 1) * PERIOD),
        "drift": float(np.abs(angle[judged] - angle[judged][0]).max()),
    }


def relations(result: Fig5) -> list[Relation]:
    """Braking, holding, running to the stop without VPC, yielding and staying, for each payload."""
    found = []
    degrees = np.degrees
    for p, lb in enumerate(PAYLOADS):
        for text, values, limit in (
            ("time to 5 % of its speed [s]", result.slowed_after[p], WITHIN),
            ("motion in the next 3 s [deg]", degrees(result.drift[p]), 3),
            ("the same, joints 5-7 released [deg]", degrees(result.drift_all[p]), 3),
            ("distance from its stop without VPC [deg]", degrees(result.free_end[p]), 2),
            ("|yield torque / (1+R a/D) tau_c - 1|", abs(result.threshold[p] / result.hold[1] - 1), 0.25),
            ("motion once the pull is lowered [deg]", degrees(result.after_pull[p]), 3),
        ):
            found.append(judge("fig5", f"{JOINT}, {lb} lb", text, values, "at most", limit))
        ratio = result.threshold[p] / result.hold[0]
        found.append(judge("fig5", f"{JOINT}, {lb} lb", "yield torque / (1+R) tau_c", ratio, "at least", 1))
    return found


def numbers(result: Fig5) -> dict[str, Any]:
    """payload -> statistics over seeds, and the holding torques [N m]."""
    table: dict[str, Any] = {
        "hold_torque_Nm": {"(1+R) tau_c": result.hold[0], "(1+R a/D) tau_c": result.hold[1]},
        "payloads": {},
    }
    for p, lb in enumerate(PAYLOADS):
        table["payloads"][f"{lb} lb"] = {
            JOINT: {
                "speed_at_release_rad_s": result.speed[p].tolist(),
                "slowed_after_s": result.slowed_after[p].tolist(),
                "settled_after_s": result.settled_after[p].tolist(),
                "drift_rad": result.drift[p].tolist(),
                "drift_whole_wrist_released_rad": result.drift_all[p].tolist(),
                "without_vpc_distance_from_stop_rad": result.free_end[p].tolist(),
                "yield_torque_Nm": result.threshold[p].tolist(),
                "pulled_rad": result.pulled[p].tolist(),
                "motion_after_pull_rad": result.after_pull[p].tolist(),
            }
        }
    return table


def draw(result: Fig5) -> Figure:
    """Position of joint 7 with and without VPC, and the pull."""
    figure, axes = new_figure(1, 2, 9.6, 3.9, width_ratios=(3, 2))
    left, right = axes[0]
    styles = ((BLUE, "-"), (GREEN, "--"), (VERMILLION, "-."))
    shown = (result.time >= 0) & (result.time < PULL_FROM)
    for stop in np.degrees(result.stops):
        left.axhline(stop, color=GREY, lw=0.8, ls=":")
    left.text(0.05, np.degrees(result.stops[1]) - 3, "joint stop", color=GREY, va="top")
    left.axvline(RELEASE, color=GREY, lw=0.8)
    left.text(RELEASE - 0.08, -55, "position offset\nremoved", color=GREY, ha="right", va="center")
    for p, lb in enumerate(PAYLOADS):
        color, dash = styles[p]
        time = result.time[shown]
        left.plot(
            time, np.degrees(result.braked[p, shown]), dash, color=color, lw=2, label=f"{lb} lb with VPC"
        )
        released = time >= RELEASE
        left.plot(
            time[released],
            np.degrees(result.free[p, shown[: result.free.shape[1]]][released]),
            dash,
            color=color,
            lw=0.9,
            label=f"{lb} lb without",
        )
    left.set_xlabel("time [s]")
    left.set_ylabel("joint 7 [deg]")
    left.set_ylim(-75, 130)
    left.legend(loc="upper left", bbox_to_anchor=(0.0, 0.9), fontsize=8.5)
    left.set_title("released in mid-swing")
    late = result.time >= PULL_FROM - 0.5
    for p, lb in enumerate(PAYLOADS):
        color, dash = styles[p]
        angle = np.degrees(result.braked[p, late])
        right.plot(result.time[late], angle - angle[0], dash, color=color, lw=1.8, label=f"{lb} lb")
    right.set_xlabel("time [s]")
    right.set_ylabel("joint 7, moved by the pull [deg]")
    right.set_title("then pulled and let go")
    torque = right.twinx()
    for p in range(len(PAYLOADS)):
        torque.plot(result.time[late], -result.pull[p, late], styles[p][1], color=GREY, lw=0.9)
    torque.set_ylabel("external torque, lifting [N m]", color=GREY)
    torque.grid(False)
    torque.spines["right"].set_visible(True)
    torque.tick_params(colors=GREY)
    for (_, dash), lb in zip(styles, PAYLOADS, strict=True):
        right.plot([], [], dash, color=GREY, lw=0.9, label=f"torque, {lb} lb")
    right.legend(loc="upper right", bbox_to_anchor=(1.02, 1.02), fontsize=8.5)
    figure.suptitle("Fig. 5  Energy dissipation: joint 7 brakes from its torque sensor alone (first seed)")
    return figure
