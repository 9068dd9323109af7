"""The certificate's "no" as something one can run: a passive load that oscillates on the joint."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from dashpot.certify.joint import SampledJoint
from dashpot.certify.loads import GROWS, Load, loops, oscillation, radii
from dashpot.drive import Drive
from dashpot.sampled import Floats

INERTIAS = (  # of the rotor's, 9 % apart, narrower than known windows; far-fetched ones last
    np.geomspace(1e-2, 1e3, 134),
    np.geomspace(1e-5, 1e6, 290),
)
COARSE = np.geomspace(1e-3, 1e3, 60)
SPRINGS = np.geomspace(1e-4, 1e2, 10)  # of the transmission's stiffness
MASSES, LENGTHS = np.geomspace(0.05, 50, 16), np.geomspace(0.03, 1.5, 10)  # [kg], [m]
STARTS = 4
FAR = 0.5  # how far a search may go from its start, in logarithms


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
    return f"twofold in {doubling:.2g} s" if doubling < 1000 else f"by {growth:.1g}/s"


def counterexample(joint: SampledJoint, drive: Drive) -> Counterexample | None:
    """Searches for a load that oscillates: an inertia, else a pendulum, else an inertia on a spring.

    Args:
        joint: The sampled joint.
        drive: Its drive: no load is lighter than `link_inertia`, or has less friction than `link_friction`.

    Returns:
        The fastest growing load of the first family that has one, or None.
    """
    least, friction = drive.link_inertia, drive.link_friction
    for some in INERTIAS:
        inertia = np.unique(np.maximum(some * drive.rotor_inertia, least))
        found = _worst(joint, inertia, np.zeros_like(inertia), friction)
        if found is not None:
            return _named(joint, "inertia", *_steeper(joint, found, least, friction, spring=False), friction)
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
    rates = _largest(joint, inertia, stiffness, friction)
    best = np.argsort(rates)[::-1][:STARTS]
    tried = [_steeper(joint, (inertia[i], stiffness[i]), least, friction, spring=True) for i in best]
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
    if not len(inertia):
        return None
    rates = _largest(joint, inertia, stiffness, friction)
    i = int(rates.argmax())
    return (float(inertia[i]), float(stiffness[i])) if rates[i] > 1 + GROWS else None


def _steeper(
    joint: SampledJoint, start: tuple[float, float], least: float, friction: float, *, spring: bool
) -> tuple[float, float]:
    """Climbs from a load to one that grows faster."""

    def load(x: Floats) -> tuple[float, float]:
        inertia = max(start[0] * float(np.exp(np.clip(x[0], -FAR, FAR))), least)
        return inertia, start[1] * float(np.exp(np.clip(x[1], -FAR, FAR))) if spring else start[1]

    def slowness(x: Floats) -> float:
        inertia, stiffness = load(x)
        return -float(_largest(joint, np.array([inertia]), np.array([stiffness]), friction)[0])

    size = 2 if spring else 1
    simplex = np.vstack([np.zeros(size), 0.1 * np.eye(size)])
    options = {"maxfev": 60, "initial_simplex": simplex, "xatol": 1e-3, "fatol": 1e-12}
    return load(minimize(slowness, np.zeros(size), method="Nelder-Mead", options=options).x)


def _named(
    joint: SampledJoint, kind: str, inertia: float, stiffness: float, friction: float
) -> Counterexample:
    load = Load(kind, inertia, stiffness)
    motion = oscillation(joint, load, friction)
    return Counterexample(load, motion.frequency, motion.growth)
