"""Searches the linearised sampled arm for gains that show the paper's two instabilities (Fig. 6).

(a) One joint's torque loop too strong for a light load: it oscillates at 0 lb, is calm at 10 lb.
(b) The position loops and torque loops of the two wrist rolls resonate at 5 lb only, near parallel axes.

Each observation of the paper becomes a growth rate that must be positive or negative; the search maximises
the smallest margin. ``python -m dashpot.paper.instability`` runs it and prints the result as JSON.
"""

from __future__ import annotations

import json
import math
import time
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import differential_evolution

from dashpot.control.controller import JointGains, joint_block
from dashpot.paper.setup import PAYLOADS, PERIOD, WRIST, Setup, setup
from dashpot.simulation.linear import SampledArm, closed_loop, linearise
from dashpot.support.arrays import Floats

PARALLEL = math.radians(-3)  # joint 6 when axes 5 and 7 are close to parallel [rad]
APART = math.radians(-80)  # joint 6 before that: axes nearly at right angles [rad]
SWING = 0.2  # how far the other joints are from home while they are [rad]
GROWTH = 4.0  # how much larger growth must be than decay to count the same: friction eats some of it
LOWEST = 0.5  # [Hz]; slower motions (a slow fall under gravity) are not vibrations
BOUNDS = {"R": (1, 40), "D": (0.5, 60), "K": (0.02, 5), "kp": (15, 250), "kd": (0.3, 8)}
KEYS = tuple(BOUNDS)
SEARCHED = WRIST
SOFTEST = 150.0  # least R kp [N m/rad]: softer joints sag out of the pose under the payload


@dataclass(frozen=True)
class Observation:
    """One thing the paper saw.

    Attributes:
        text: In words.
        payload: [lb].
        grows: Whether the vibration grows.
        pose: "parallel" or "apart".
        bypass: Joints whose virtual passive controller is bypassed.
        position_loop: Whether the position offset is on.
    """

    text: str
    payload: int
    grows: bool
    pose: str = "parallel"
    bypass: tuple[str, ...] = ()
    position_loop: bool = True


RESONANCE = (
    Observation("grows at 5 lb", 5, True),
    Observation("decays at 0 lb", 0, False),
    Observation("decays at 10 lb", 10, False),
    Observation("decays at 5 lb with joint 5 bypassed", 5, False, bypass=("joint5",)),
    Observation("decays at 5 lb with joint 7 bypassed", 5, False, bypass=("joint7",)),
    Observation("grows at 5 lb with joint 6 bypassed", 5, True, bypass=("joint6",)),
    Observation("decays at 5 lb without the position offset", 5, False, position_loop=False),
    Observation("decays at 0 lb before the axes are parallel", 0, False, pose="apart"),
    Observation("decays at 5 lb before the axes are parallel", 5, False, pose="apart"),
    Observation("decays at 10 lb before the axes are parallel", 10, False, pose="apart"),
)
"""What section VII reports of the second instability."""


def poses(s: Setup) -> dict[str, list[Floats]]:
    """Poses (7,) [rad] by name: home, home with axes 5 and 7 apart, and some with them nearly parallel."""
    home = np.array(s.robot.home)
    apart = home.copy()
    apart[s.robot.index("joint6")] = APART
    around = []
    for swing in (0.0, SWING, -SWING):
        pose = home + swing * np.array([0, 1, 0, -1, 1, 0, -1])
        pose[s.robot.index("joint6")] = PARALLEL
        around.append(pose)
    return {"parallel": around, "apart": [apart], "home": [home]}


def arms(s: Setup) -> dict[tuple[str, int], list[SampledArm]]:
    """Linearised arms by (pose name, payload)."""
    return {
        (name, lb): [linearise(s.plants[lb], WRIST, pose, PERIOD, s.config.sampling) for pose in group]
        for name, group in poses(s).items()
        for lb in PAYLOADS
    }


def growth(matrices: Floats, period: float = PERIOD) -> tuple[Floats, Floats]:
    """Growth rate [1/s] and frequency [Hz] of the fastest growing oscillation of each matrix."""
    rates = np.log(np.linalg.eigvals(matrices).astype(complex) + 1e-300) / period
    oscillating = np.abs(rates.imag) > 2 * math.pi * LOWEST
    rank = np.where(oscillating, rates.real, -np.inf).argmax(-1)[..., None]
    chosen = np.take_along_axis(rates, rank, -1)[..., 0]
    return chosen.real, np.abs(chosen.imag) / (2 * math.pi)


def margins(
    linear: dict[tuple[str, int], list[SampledArm]],
    blocks: NDArray[np.void],
    observations: tuple[Observation, ...] = RESONANCE,
) -> Floats:
    """Signed growth rates, (..., observations) [1/s]: positive where an observation is met in every pose."""
    columns = []
    for seen in observations:
        sign = 1 if seen.grows else -1
        rates = [
            sign * growth(closed_loop(arm, blocks, bypass=seen.bypass, position_loop=seen.position_loop))[0]
            for arm in linear[seen.pose, seen.payload]
        ]
        columns.append(np.min(rates, axis=0))
    return np.stack(columns, -1)


def wrist_gains(s: Setup, values: Floats) -> tuple[JointGains, ...]:
    """Gains of the wrist with those of `SEARCHED` from (15,) values, `KEYS` per joint."""
    rows = dict(zip(SEARCHED, np.reshape(values, (len(SEARCHED), len(KEYS))), strict=True))
    return tuple(
        JointGains(g.name, **{k: float(x) for k, x in zip(KEYS, rows[g.name], strict=True)})
        if g.name in rows
        else g
        for g in s.config.gains
    )


def blocks_of(s: Setup, gains: tuple[JointGains, ...]) -> NDArray[np.void]:
    """Coefficient blocks of the wrist, (3,)."""
    drives = [s.robot.drives[s.robot.index(g.name)] for g in gains]
    # The search wanders through gains no one would use; their warnings do not matter.
    quiet = [replace(drive, torque_gain_error=0.0) for drive in drives]
    return np.array([joint_block(g, d, s.config) for g, d in zip(gains, quiet, strict=True)])


def search_resonance(seed: int, generations: int, population: int = 10) -> dict[str, Any]:
    """Differential evolution over the gains of `SEARCHED`, for the largest smallest margin.

    Args:
        seed: Of the search.
        generations: Number of generations.
        population: Members per gain.

    Returns:
        Seed, evaluations, gains, margins by observation [1/s], frequency at 5 lb [Hz].
    """
    s = setup()
    linear = arms(s)
    low, high = (np.log(np.tile([BOUNDS[k][i] for k in KEYS], len(SEARCHED))) for i in (0, 1))
    weights = np.array([GROWTH if seen.grows else 1.0 for seen in RESONANCE])
    evaluations = 0

    def cost(logs: Floats) -> Floats:
        nonlocal evaluations
        candidates = np.exp(np.atleast_2d(logs.T))
        evaluations += len(candidates)
        blocks = np.array([blocks_of(s, wrist_gains(s, c)) for c in candidates])
        table = candidates.reshape(len(candidates), len(SEARCHED), len(KEYS))
        firm = (table[..., KEYS.index("R")] * table[..., KEYS.index("kp")]).min(-1) / SOFTEST
        result: Floats = -(margins(linear, blocks) / weights).min(-1) + 10 * np.maximum(1 - firm, 0)
        return result

    found = differential_evolution(
        cost,
        list(zip(low, high, strict=True)),
        vectorized=True,
        updating="deferred",
        popsize=population,
        maxiter=generations,
        seed=seed,
        polish=False,
        tol=0,
    )
    gains = wrist_gains(s, np.exp(found.x))
    return {
        "seed": seed,
        "generations": generations,
        "evaluations": evaluations,
        **describe_resonance(s, gains),
    }


def describe_resonance(s: Setup, gains: tuple[JointGains, ...]) -> dict[str, Any]:
    """Gains, the margin of each observation [1/s] and the frequency at 5 lb [Hz]."""
    linear = arms(s)
    blocks = blocks_of(s, gains)
    _, frequency = growth(closed_loop(linear["parallel", 5][0], blocks))
    met = margins(linear, blocks)
    return {
        "gains": [{k: v for k, v in asdict(g).items() if v is not None} for g in gains],
        "growth_per_s": {o.text: float(m if o.grows else -m) for o, m in zip(RESONANCE, met, strict=True)},
        "all_met": bool((met > 0).all()),
        "frequency_hz": float(frequency),
    }


@dataclass(frozen=True)
class HighGain:
    """A joint whose torque loop is too strong for a light load.

    Attributes:
        joint: Its name.
        high: Gains of the wrist with that joint's too high.
        low: Gains that cure it.
        growth: Payload [lb] -> growth rate with the high gains [1/s].
        growth_low: The same with the low gains.
        frequency: Of the oscillation at 0 lb [Hz].
        tried: Gain pairs tried.
    """

    joint: str
    high: tuple[JointGains, ...]
    low: tuple[JointGains, ...]
    growth: dict[int, float]
    growth_low: dict[int, float]
    frequency: float
    tried: int


LOW = {"R": 5.0, "D": 3.0, "K": 0.0, "kp": 34.0, "kd": 2.0}
GRID_R = (3, 4, 5, 6, 8, 10, 12, 15, 20)
GRID_D = (2, 3, 4, 5, 6, 8, 10, 12, 15)


def explicit(s: Setup) -> Setup:
    """The experiment with the explicit form, in which strong torque loops lose stability first."""
    return replace(s, config=replace(s.config, form="explicit"))


def search_high_gain(joint: str = "joint5") -> HighGain:
    """Raises R and D of one joint over a grid: most unstable at 0 lb while 5 and 10 lb stay stable."""
    s = explicit(setup())
    linear = arms(s)
    low = tuple(JointGains(name, **LOW) for name in WRIST)
    pairs = [(r, d) for r in GRID_R for d in GRID_D]
    candidates = [
        tuple(replace(g, R=float(r), D=float(d)) if g.name == joint else g for g in low) for r, d in pairs
    ]
    blocks = np.array([blocks_of(s, gains) for gains in candidates])

    def at_home(lb: int, some: NDArray[np.void]) -> tuple[Floats, Floats]:
        return growth(closed_loop(linear["home", lb][0], some))

    rates = np.array([at_home(lb, blocks)[0] for lb in PAYLOADS])
    best = int(np.where((rates[1:] < -1).all(0), rates[0], -np.inf).argmax())
    cured = blocks_of(s, low)
    return HighGain(
        joint,
        candidates[best],
        low,
        {lb: float(rate) for lb, rate in zip(PAYLOADS, rates[:, best], strict=True)},
        {lb: float(at_home(lb, cured)[0]) for lb in PAYLOADS},
        float(at_home(0, blocks[best])[1]),
        len(pairs),
    )


def main() -> None:
    """Runs the search as `make evidence-fig6` does."""
    start = time.perf_counter()
    result = search_resonance(seed=4, generations=170)
    result["seconds"] = round(time.perf_counter() - start, 1)
    result["command"] = "python -m dashpot.paper.instability"
    print(json.dumps(result, indent=2))


if __name__ == "__main__":
    main()
