"""The certificate's "no" as something one can run: a passive load that oscillates on the joint."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from dashpot.arm.drive import Drive
from dashpot.certify.joint import SPEED, SampledJoint
from dashpot.certify.loads import GROWS, Load, loops, oscillation, radii
from dashpot.certify.threads import one_thread
from dashpot.support.arrays import Floats
from dashpot.support.numbers import significant

INERTIAS = (  # of the rotor's, 9 % apart, narrower than known windows; far-fetched ones last
    np.geomspace(1e-2, 1e3, 134),
    np.geomspace(1e-5, 1e6, 290),
)
COARSE = np.geomspace(1e-3, 1e3, 60)
SPRINGS = np.geomspace(1e-4, 1e2, 10)  # of the transmission's stiffness
MASSES, LENGTHS = np.geomspace(0.05, 50, 16), np.geomspace(0.03, 1.5, 10)  # [kg], [m]
STARTS = 4
CLEAR = 0.3  # growth per cycle, in logarithms, that shows best
FAR = 0.3  # what a load of another size than the rotor costs, per logarithm
NEAR = 0.5  # how far a climb may go from its start, in logarithms


@dataclass(frozen=True)
class Counterexample:
    """A passive load that oscillates.

    Attributes:
        load: What hangs on the joint, link inertia included.
        frequency: [Hz], as seen at the ticks.
        growth: Rate of the amplitude [1/s].
    """

    load: Load
    frequency: float
    growth: float

    def __str__(self) -> str:
        if self.frequency < 1e-6:
            return f"{self.load} runs away, time constant {1 / self.growth:.3g} s"
        return f"{self.load} oscillates at {self.frequency:.3g} Hz, growing {_rate(self.growth)}"


def _rate(growth: float) -> str:
    doubling = np.log(2) / growth
    return f"twofold in {significant(doubling, 2)} s" if doubling < 1000 else f"by {growth:.1g}/s"


@one_thread
def counterexample(joint: SampledJoint, drive: Drive) -> Counterexample | None:
    """Searches for a load that oscillates: an inertia, else a pendulum, else an inertia on a spring.

    Args:
        joint: The sampled joint.
        drive: Its drive: no load is lighter than `link_inertia`, or has less friction than `link_friction`.

    Returns:
        A load of the first family that has one, or None.
    """
    least, friction = drive.link_inertia, drive.link_friction
    for some in INERTIAS:
        inertia = np.unique(np.maximum(some * drive.rotor_inertia, least))
        found = _worst(joint, inertia, np.zeros_like(inertia), friction)
        if found is not None:
            return _named(joint, "inertia", *found, friction)
    mass, length = (grid.ravel() for grid in np.meshgrid(MASSES, LENGTHS))
    heavy = mass * length**2 >= least
    pendulums = [Load.pendulum(*pair) for pair in zip(mass[heavy], length[heavy], strict=True)]
    inertia, stiffness = (
        np.array([getattr(load, key) for load in pendulums]) for key in ("inertia", "stiffness")
    )
    found = _worst(joint, inertia, stiffness, friction)
    if found is not None:
        return _named(joint, "pendulum", *found, friction)
    coarse = np.unique(np.maximum(COARSE * drive.rotor_inertia, least))
    inertia, stiffness = (grid.ravel() for grid in np.meshgrid(coarse, SPRINGS * drive.stiffness))
    found = _worst(joint, inertia, stiffness, friction)
    if found is not None:
        return _named(joint, "inertia and spring", *found, friction)
    rates = _largest(joint, inertia, stiffness, friction)
    best = np.argsort(rates)[::-1][:STARTS]
    tried = [_steeper(joint, (inertia[i], stiffness[i]), least, friction) for i in best]
    for pair in tried:
        if radii(joint, np.array([pair[0]]), np.array([pair[1]]), friction)[0] > 1 + GROWS:
            return _named(joint, "inertia and spring", *pair, friction)
    return None


def _largest(joint: SampledJoint, inertia: Floats, stiffness: Floats, friction: float) -> Floats:
    """Largest modulus of the loop with each load, (k,), the free turning of the whole left out."""
    values = np.linalg.eigvals(loops(joint, inertia, stiffness, friction))
    return np.asarray(np.where(np.abs(values - 1) < 1e-6, 0.0, np.abs(values)).max(-1))


def _worst(
    joint: SampledJoint, inertia: Floats, stiffness: Floats, friction: float
) -> tuple[float, float] | None:
    """The load that shows it best: growing clearly from cycle to cycle, its inertia near the rotor's."""
    if not len(inertia):
        return None
    values = np.linalg.eigvals(loops(joint, inertia, stiffness, friction))
    values = values[np.arange(len(values)), np.abs(values).argmax(-1)]
    grows = np.abs(values) > 1 + GROWS
    if not grows.any():
        return None
    per_cycle = np.log(np.abs(values)) * 2 * np.pi / np.maximum(np.abs(np.angle(values)), 1e-9)
    far = np.abs(np.log(inertia * joint.flow[SPEED, -1]))  # of the rotor's: the motor moves it by 1 / m
    with np.errstate(divide="ignore", invalid="ignore"):
        score = np.where(grows, -np.abs(np.log(per_cycle / CLEAR)) - FAR * far, -np.inf)
    i = int(score.argmax())
    return float(inertia[i]), float(stiffness[i])


def _steeper(
    joint: SampledJoint, start: tuple[float, float], least: float, friction: float
) -> tuple[float, float]:
    """Climbs from a load to one that grows faster."""

    def load(x: Floats) -> tuple[float, float]:
        inertia = max(start[0] * float(np.exp(np.clip(x[0], -NEAR, NEAR))), least)
        return inertia, start[1] * float(np.exp(np.clip(x[1], -NEAR, NEAR)))

    def slowness(x: Floats) -> float:
        inertia, stiffness = load(x)
        return -float(_largest(joint, np.array([inertia]), np.array([stiffness]), friction)[0])

    simplex = np.array([[0.0, 0.0], [0.1, 0.0], [0.0, 0.1]])
    options = {"maxfev": 60, "initial_simplex": simplex, "xatol": 1e-3, "fatol": 1e-12}
    return load(minimize(slowness, np.zeros(2), method="Nelder-Mead", options=options).x)


def _named(
    joint: SampledJoint, kind: str, inertia: float, stiffness: float, friction: float
) -> Counterexample:
    load = Load(kind, inertia, stiffness)
    motion = oscillation(joint, load, friction)
    return Counterexample(load, motion.frequency, motion.growth)
