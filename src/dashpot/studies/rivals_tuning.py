"""One tuning procedure for every law on one joint: the same budget, the same motions, the same limits.

``python -m dashpot.studies.rivals_tuning`` prints what it finds as JSON. For every law `BUDGET` sets of
numbers are simulated: the first of a scrambled Sobol sequence in their logarithms, the rest around the best
so far, in a box that is halved from round to round. Each is judged on the same joint (joint 2 of the bundled
fr3, friction and sensor noise included) with no, half and the largest payload, of which the worst counts:

- brakes: the link's way in 5 s after the encoder is lost in even motion, under the payload's load: to and fro
  in the first second, and how far it creeps in the other four [rad];
- position controllers: RMS error over a random motion plus mean error at rest, both under that load [rad].

The limits are the same for all: torque command within `AUTHORITY` of the drive's, its noise at rest within
`NOISE` of that, and every oscillation with any of the payloads damped by `DAMPING` (half of what the drive
alone has), exactly computed on the sampled joint. A set that breaks one ranks behind all that do not. No
certificate is asked for; whether there is one is reported. The virtual passive law takes part, as brake and
as position controller, under the same rule.
"""

from __future__ import annotations

import argparse
import json
import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from scipy.stats import qmc

from dashpot.certify.certificate import certify_joint
from dashpot.certify.joint import sampled_joint
from dashpot.certify.loads import loops
from dashpot.control.controller import Controller, Law, joint_block
from dashpot.control.laws import law_from_table
from dashpot.control.sampled import without_encoder
from dashpot.errors import InputWarning
from dashpot.simulation.recording import Recording
from dashpot.simulation.simulate import Event, Scenario, run_many
from dashpot.simulation.trajectory import Trajectory, hold, multisine
from dashpot.studies.rivals_bench import BENCH, SCALES, Bench
from dashpot.support.arrays import Floats

BUDGET, GLOBAL, ROUNDS = 400, 256, 6
SEED = 1
PAYLOADS: Mapping[str, float] = {"none": 0.0, "half": 0.5, "largest": 1.0}
SPEED, RUN_UP, WATCH = 0.5, 0.7, 5.0  # [rad/s] before the loss, [s] until it, [s] after it
MOVER = 20.0  # [rad/s] of the loop that moves a brake's joint until then
MOTION, REST, QUIET = 4.0, 1.5, 0.5  # [s] of the random motion, of the rest, of its end
AUTHORITY, NOISE, DAMPING = 0.9, 0.01, 0.02
ASSUMED = 0.5  # of the largest payload, in the load model of pd_gravity: wrong for two of the three
BROKEN = 1e3  # [rad], where sets that break a limit begin
Range = tuple[float, float]


@dataclass(frozen=True)
class Entry:
    """A law that takes part.

    Attributes:
        law: Its name in a controller file.
        brake: Judged as a brake, or as a position controller.
        tuned: Lowest and highest value of every number that is tuned; "slack" stands for 1 - gain.
        fixed: Numbers that are not.
    """

    law: str
    brake: bool
    tuned: Mapping[str, Range]
    fixed: Mapping[str, float]

    def at(self, point: Floats, bench: Bench = BENCH) -> Law:
        """The law at a point of the unit cube, its ranges scaled to the drive (`Bench.scale`)."""
        values = dict(self.fixed)
        for (key, (low, high)), share in zip(self.tuned.items(), point, strict=True):
            value = float(f"{bench.scale(SCALES.get(key, 0)) * low * (high / low) ** share:.4g}")
            values.update({"gain": 1 - value} if key == "slack" else {key: value})
        return law_from_table({"name": "joint", "law": self.law, **values})


KP, KD = (50.0, 5e4), (0.5, 500.0)
ENTRIES = (
    Entry("virtual_passive", True, {"R": (0.5, 100), "D": (1, 500)}, {"K": 0.0}),
    Entry("off", True, {}, {}),
    Entry("static_feedback", True, {"slack": (1e-3, 1)}, {}),
    Entry("rotor_observer", True, {"damping": (0.1, 200)}, {}),
    Entry("latched_torque", True, {}, {}),
    Entry("encoder_damping", True, {"damping": (1, 1000)}, {}),
    Entry("virtual_passive", False, {"R": (0.5, 100), "D": (1, 500), "kp": (5, 5e3), "kd": (0.1, 100)}, {}),
    Entry("pd", False, {"kp": KP, "kd": KD}, {}),
    Entry("pd_scaled", False, {"kp": (5, 5e3), "kd": (0.05, 50)}, {"R": 10.0}),
    Entry("pid", False, {"kp": KP, "kd": KD, "ki": (10, 1e6)}, {}),
    Entry("pd_gravity", False, {"kp": KP, "kd": KD}, {}),
    Entry("disturbance_observer", False, {"kp": KP, "kd": KD, "cutoff": (0.05, 50)}, {}),
    Entry("torque_feedback", False, {"kp": KP, "kd": KD, "slack": (1e-3, 1)}, {}),
    Entry("inertia_shaping", False, {"kp": KP, "kd": KD, "ratio": (0.05, 20)}, {}),
)


@dataclass(frozen=True)
class Judged:
    """What one set of numbers did, the worst payload counting.

    Attributes:
        value: The objective [rad]; from `BROKEN` on where a limit is broken.
        parts: Objective per payload [rad].
        authority: Largest command over the torque limit [-].
        noise: Its standard deviation at rest over the torque limit [-].
        damping: Least damping ratio of an oscillation [-].
    """

    value: float
    parts: Mapping[str, float]
    authority: float
    noise: float
    damping: float


def scenarios(
    entry: Entry, law: Law, bench: Bench = BENCH, mover: Mapping[str, float] | None = None
) -> list[Scenario]:
    """The runs on which a law is judged: per payload the stop, or motion and rest.

    A brake's joint is moved by the position loop ``mover`` (kp, kd); None: at `MOVER`, critically damped.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        if entry.brake:  # the same loop moves the joint until the encoder is lost
            total = bench.inertia + bench.heaviest + bench.drive.rotor_inertia
            loop: dict[str, Any] = {"kp": total * MOVER**2, "kd": 2 * total * MOVER}
            law = replace(law, **(loop if mover is None else dict(mover)))
        controller = Controller.from_config(bench.config(law), [bench.drive])
    made = []
    for share in PAYLOADS.values():
        period = bench.period
        for path in (_even(period),) if entry.brake else (_motion(period), hold([0.0], REST, period)):
            if entry.law == "pd_gravity":  # the load pulls by -load: the torque that holds it is +load
                path = replace(path, torque=np.full_like(path.position, ASSUMED * bench.load))
            pull = np.full((len(path.position), 1), -share * bench.load)
            events = _loss(law) if entry.brake else []
            made.append(Scenario(bench.plant(share), controller, path, events, pull, SEED))
    return made


@cache
def _even(period: float) -> Trajectory:
    time = period * np.arange(round((RUN_UP + WATCH) / period))
    share = np.clip(time / (RUN_UP / 2), 0, 1)
    speed = SPEED * share**2 * (3 - 2 * share)
    angle = np.cumsum(speed) * period
    return Trajectory(period, angle[:, None], speed[:, None], np.gradient(speed, period)[:, None])


@cache
def _motion(period: float) -> Trajectory:
    return multisine([0.0], MOTION, period, SEED, amplitude=0.3, lead_in=0.0)


def _loss(law: Law) -> list[Event]:
    events = [Event(0.0, "joint", "mode", "bypass"), Event(RUN_UP, "joint", "mode", "active")]
    events += [Event(RUN_UP, "joint", "warm_start")] * law.warm
    return events + [Event(RUN_UP, "joint", "position_loop", False)] * (not law.keeps_encoder)


def _seen(scenario: Scenario, found: Recording) -> tuple[float, float, float]:
    """Objective [rad], largest command and its noise [N m] of one run."""
    if found.diverged_at is not None:
        return BROKEN, math.inf, math.inf
    time, command, last = found.time, found.command[:, 0], found.time > found.time[-1] - QUIET
    slope = np.polynomial.Polynomial.fit(time[last], command[last], 1)
    noise = float((command[last] - slope(time[last])).std())
    if scenario.events:
        after = found.link_position[time >= RUN_UP - 1e-9, 0]
        first = round(1 / scenario.trajectory.period)
        way = float(np.abs(np.diff(after[: first + 1])).sum() + abs(after[-1] - after[first]))
        return way, float(np.abs(command[time > RUN_UP]).max()), noise
    error = (found.link_position - found.reference)[:, 0]
    if np.ptp(found.reference) > 0:
        return float(np.sqrt(np.mean(error[time > 1] ** 2))), float(np.abs(command).max()), 0.0
    return float(abs(error[last].mean())), 0.0, noise


def least_damping(law: Law, brake: bool, bench: Bench = BENCH) -> float:
    """Least damping ratio of an oscillation of the sampled joint with any of the payloads [-]."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        block = joint_block(law, bench.drive, bench.config(law))
    block = without_encoder(block) if brake and not law.keeps_encoder else block
    inertias = np.array([bench.inertia + share * bench.heaviest for share in PAYLOADS.values()])
    joint = sampled_joint(bench.drive, block, bench.sampling, bench.period)
    values = np.linalg.eigvals(loops(joint, inertias, 0 * inertias)).astype(complex).ravel()
    s = np.log(values[(np.abs(values) > 1e-6) & (np.abs(values - 1) > 1e-7)])
    ratio = np.where(np.abs(s.imag) > 1e-4, -s.real / np.abs(s), np.where(s.real > 1e-7, -1.0, 1.0))
    return float(ratio.min())


def judge(
    entry: Entry, laws: list[Law], bench: Bench = BENCH, mover: Mapping[str, float] | None = None
) -> list[Judged]:
    """Simulates and judges laws of one entry."""
    every = [scenarios(entry, law, bench, mover) for law in laws]
    found: list[Any] = run_many([one for some in every for one in some], reduce=_seen)
    size, limit, judged = len(every[0]), bench.drive.torque_limit, []
    own = size // len(PAYLOADS)
    for i, law in enumerate(laws):
        mine = found[i * size : (i + 1) * size]
        parts = {
            name: sum(part[0] for part in mine[j * own : (j + 1) * own]) for j, name in enumerate(PAYLOADS)
        }
        used, noise = max(part[1] for part in mine) / limit, max(part[2] for part in mine) / limit
        damping = least_damping(law, entry.brake, bench)
        broken = max(used / AUTHORITY - 1, noise / NOISE - 1, DAMPING - damping, 0.0)
        value = max(parts.values()) if broken == 0 else BROKEN * (1 + min(broken, BROKEN))
        judged.append(Judged(value, parts, used, noise, damping))
    return judged


def tune(
    entry: Entry,
    budget: int = BUDGET,
    seed: int = SEED,
    progress: Callable[[str], None] | None = None,
    bench: Bench = BENCH,
    mover: Mapping[str, float] | None = None,
) -> tuple[Law, Judged, int]:
    """The best of `budget` sets of numbers, how it was judged, and how many kept the limits."""
    axes = len(entry.tuned)
    if not axes:
        law = entry.at(np.zeros(0), bench)
        result = judge(entry, [law], bench, mover)[0]
        return law, result, int(result.value < BROKEN)
    sobol = qmc.Sobol(axes, scramble=True, seed=seed)
    first = min(GLOBAL, 1 << max(1, (budget * GLOBAL // BUDGET).bit_length() - 1))
    points, judged = sobol.random(first), []
    judged = judge(entry, [entry.at(point, bench) for point in points], bench, mover)
    width, left = 0.25, budget - first
    for turn in range(ROUNDS):
        some = left // (ROUNDS - turn)
        left -= some
        best = points[int(np.argmin([one.value for one in judged]))]
        around = np.clip(best + width * (2 * sobol.random(some) - 1), 0, 1)
        judged += judge(entry, [entry.at(point, bench) for point in around], bench, mover)
        points, width = np.concatenate([points, around]), width / 2
        if progress is not None:
            progress(f"{entry.law}: {len(points)} of {budget}")
    best_of = int(np.argmin([one.value for one in judged]))
    return entry.at(points[best_of], bench), judged[best_of], sum(one.value < BROKEN for one in judged)


def study(budget: int = BUDGET, seed: int = SEED, entries: tuple[Entry, ...] = ENTRIES) -> dict[str, Any]:
    """Tunes every law; for JSON."""
    rows = []
    for entry in entries:
        law, found, feasible = tune(entry, budget, seed)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", InputWarning)
            verdict = certify_joint(BENCH.drive, law, BENCH.config(law))
        rows.append(
            {
                "law": entry.law,
                "as": "brake" if entry.brake else "position",
                "tuned": {key: getattr(law, "gain" if key == "slack" else key) for key in entry.tuned},
                "not_tuned": dict(entry.fixed),
                "sets": budget if entry.tuned else 1,
                "sets_within_limits": feasible,
                "certified": verdict.certified,
                **asdict(found),
            }
        )
    limits = {"authority": AUTHORITY, "noise": NOISE, "damping_ratio": DAMPING}
    return {"budget": budget, "seed": seed, "limits": limits, "laws": rows}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Tunes every law on one joint with one budget.")
    parser.add_argument("--budget", type=int, default=BUDGET)
    parser.add_argument("--seed", type=int, default=SEED)
    options = parser.parse_args()
    print(json.dumps(study(options.budget, options.seed), indent=2))
