"""No certified gains are as good as the hand-picked ones: a proof for one joint, by cutting into pieces.

Two wishes, error ratio and load error, confine the gains ``p = (1, x, mu, kp, kd)`` to a cone with five
edges. What a certified design obeys are quadratic and linear forms in p
(`dashpot.studies.designs_necessary`). On a cone with edges ``p_a`` a form is negative if all ``p_a' M p_b``
are. So one inequality that fails refutes a cone; one that is not refuted is cut in two, across its longest
edge or its range of K/a.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dashpot.arm.robot import Robot
from dashpot.certify.certificate import certify_joint
from dashpot.certify.threads import one_thread
from dashpot.control.controller import load_controller
from dashpot.design import candidates as quantity
from dashpot.design.candidates import Duty, Gains
from dashpot.design.design import duties
from dashpot.design.wishes import Wishes
from dashpot.studies.designs_arms import AS_GOOD, HAND, wanted
from dashpot.studies.designs_necessary import (
    KD,
    KP,
    MU,
    ONE,
    SLACK,
    Corner,
    Inequalities,
    X,
    creeping,
    entries,
    unstable,
)
from dashpot.support.arrays import Floats

JOINT = "joint6"
WISHES = ("error_ratio", "load_error")
FEW = (0.85, 0.93), (-1.2, -2.0)  # shares of half the sample rate, and real z, that suffice
BATCH = 2000  # cones looked at side by side
MOST = 40_000  # cones after which a proof is given up
SHARES = (2.0, 3.0, 4.0)  # of both wishes
LOAD_ERRORS = (50.0, 100.0, 110.0)  # the same of the load error alone
"""Times what the hand-picked gains do: nothing certified is shown to exist there, as far as it goes."""
INSTEAD = {
    "hardly any torque feedback": (0.0478, 9.45, 0.0, 10_100.0, 24.0),
    "twelve times the error ratio": (1.714, 1.345, 0.0, 51.98, 5.752),
    "error ratio alone": (6.423, 0.5444, 0.0, 0.3061, 0.2719),
}
"""R, D, K, kp, kd that are certified. The last two came from the search, asked for nothing else."""


@dataclass(frozen=True)
class Bounds:
    """Two wishes as bounds on gains, nominal static gain 1/y: ``y <= most``, ``kp >= least + slope y``.

    Attributes:
        most: [-].
        least: [N m/rad].
        slope: [N m/rad].
    """

    most: float
    least: float
    slope: float

    @classmethod
    def of(cls, duty: Duty, wishes: Wishes) -> Bounds:
        """From the limits on error ratio and load error, kept with the weakest torque channel."""
        assert wishes.error_ratio is not None
        assert wishes.load_error is not None
        error, friction = duty.drive.torque_gain_error, duty.drive.coulomb_friction
        # The assured 1/g is (y + error)/(1 - error).
        slope = (duty.load + friction) / (1 - error) / wishes.load_error
        most = (1 - error) * wishes.error_ratio - error
        return cls(most, friction / wishes.load_error + slope * error, slope)

    def edges(self, corner: Corner, *, sprung: bool) -> Floats:
        """The cone of all gains within them, (5, 5): for K = 0 y = x, for K > 0 y = x + mu v/m."""
        most = self.least + self.slope * self.most
        p = np.zeros((5, 5))
        p[0, [ONE, KP]] = 1.0, self.least
        p[1, [ONE, X, KP]] = 1.0, self.most, most
        if sprung:
            p[2, [ONE, MU, KP]] = 1.0, self.most / corner.rate, most
        else:
            p[2, MU] = corner.period / 2
        p[3, KP], p[4, KD] = most, corner.v
        return p


def coordinates(duty: Duty, gains: Gains) -> tuple[Floats, Floats]:
    """p (k, 5) and K/a (k,) [1/s] of gains."""
    drive = duty.drive
    a = gains.R * drive.viscous_friction + gains.D
    p = np.stack([np.ones(len(a)), gains.D / (gains.R * a), drive.rotor_inertia / a, gains.kp, gains.kd], 1)
    return p, gains.K / a


@one_thread
def refute(given: Inequalities, bounds: Bounds, *, sprung: bool, most: int = MOST) -> dict[str, Any]:
    """Cuts the cone of all gains within the bounds until every piece is refuted.

    Args:
        given: What certified designs obey.
        bounds: What is wanted.
        sprung: Whether K > 0.
        most: Pieces after which it is given up.

    Returns:
        "proven", "pieces", "cuts" on the longest way to one, "open" pieces, and how many were refuted by
        what: "unstable", "creeping", "passivity" ({frequency [Hz]: pieces}).
    """
    corner = given.corner
    edges = bounds.edges(corner, sprung=sprung)
    scale = edges.max(0)
    cones, shares = (edges / (edges / scale).sum(1, keepdims=True))[None], np.array([[0.0, 1.0]])
    cuts, longest, pieces = np.zeros(1, int), 0, 0
    by = {"unstable": 0, "creeping": 0}
    at = np.zeros(len(given.omega), int)
    while len(cones) and pieces + len(cones) < most:
        now, cones = cones[-BATCH:], cones[:-BATCH]
        share, shares = shares[-BATCH:], shares[:-BATCH]
        done, cuts = cuts[-BATCH:], cuts[:-BATCH]
        with np.errstate(divide="ignore"):
            kappa = share / (1 - share) / corner.period if sprung else None
        grows = unstable(given, now, kappa)
        slow = ~grows & (False if sprung else creeping(given, now))
        upper, middle, size = entries(given, now, kappa)
        failing = upper.max((-1, -2)) / size
        rows, best = np.arange(len(now)), failing.argmin(1)
        active = ~grows & ~slow & (failing[rows, best] < -SLACK)
        by["unstable"] += int(grows.sum())
        by["creeping"] += int(slow.sum())
        np.add.at(at, best[active], 1)
        left = ~(grows | slow | active)
        pieces += int((~left).sum())
        longest = max(longest, int(done.max()))
        # Where most of what is missing comes from the range of K/a, that is cut.
        nearly = middle[rows, best].max((-1, -2)) / size[rows, best]
        blurred = (failing[rows, best] > 2 * np.maximum(nearly, 0.0)) & sprung
        halves = _halves(now[left], scale, blurred[left])
        cones = np.concatenate([cones, *halves])
        low, high = share[left].copy(), share[left].copy()
        low[blurred[left], 1] = high[blurred[left], 0] = share[left & blurred].mean(1)
        shares = np.concatenate([shares, low, high])
        cuts = np.concatenate([cuts, np.tile(done[left] + 1, 2)])
    hertz = given.omega / (2 * np.pi)
    by_passivity = {f"{f:.3g}": int(count) for f, count in zip(hertz, at, strict=True) if count}
    found = {"proven": not len(cones), "pieces": pieces, "cuts": longest, "open": len(cones)}
    return found | {"refuted_by": {**by, "passivity_hz": by_passivity}}


def _halves(cones: Floats, scale: Floats, whole: NDArray[np.bool_]) -> tuple[Floats, Floats]:
    """Cones (k, 5, 5) cut across their longest edge, but for those that are to stay whole."""
    one, other = cones.copy(), cones.copy()
    apart = cones / scale
    lengths = np.linalg.norm(apart[:, :, None] - apart[:, None], axis=-1).reshape(-1, 25)
    i, j = np.divmod(lengths.argmax(1), 5)
    which = np.flatnonzero(~whole)
    middle = (cones[which, i[which]] + cones[which, j[which]]) / 2
    one[which, i[which]], other[which, j[which]] = middle, middle
    return one, other


def asked(share: float = AS_GOOD) -> tuple[Duty, Wishes]:
    """The joint's duty, and a share of what its hand-picked gains do as limits."""
    robot = Robot.load("k807")
    spec = wanted(robot, load_controller(HAND["k807"]), share)
    duty = next(duty for duty in duties(robot, spec) if duty.drive.name == JOINT)
    return duty, spec.of(JOINT)


def both(given: Inequalities, bounds: Bounds) -> dict[str, dict[str, Any]]:
    """The proof without and with a virtual spring."""
    return {name: refute(given, bounds, sprung=name == "K > 0") for name in ("K = 0", "K > 0")}


def _reach(given: Inequalities, duty: Duty, steps: Iterator[tuple[float, Wishes]]) -> list[dict[str, Any]]:
    """How far wishes can be eased until the proof is given up."""
    rows = []
    for share, wishes in steps:
        found = both(given, Bounds.of(duty, wishes))
        rows.append({"share": share, **{n: [f["proven"], f["pieces"]] for n, f in found.items()}})
        if not all(f["proven"] for f in found.values()):
            break
    return rows


def _certified(duty: Duty, gains: Gains) -> dict[str, Any]:
    """What gains do, and whether they are certified."""
    joint = gains.joint(JOINT)
    verdict = certify_joint(duty.drive, joint, duty.config((joint,)))
    weak = replace(duty, torque_gain=1 - duty.drive.torque_gain_error)
    return {
        "gains": {name: getattr(joint, name) for name in ("R", "D", "K", "kp", "kd")},
        "certified": bool(verdict.certified and verdict.brake and verdict.brake.proven),
        "error_ratio": float(quantity.error_ratio(weak, gains)[0]),
        "load_error": float(quantity.load_error(weak, gains)[0]),
    }


def proof() -> dict[str, Any]:
    """The proof, how far it reaches, and what can be had instead."""
    duty, wishes = asked()
    own = asked(1.0)[1]
    corner = Corner.of(duty)
    many = Inequalities.of(corner)
    eased = ((share, asked(share)[1]) for share in SHARES)
    alone = (
        (share, wishes.changed({"load_error": share * (own.load_error or 0.0)})) for share in LOAD_ERRORS
    )
    return {
        "joint": JOINT,
        "asked": {name: wishes.limits[name] for name in WISHES},
        "corner": vars(corner),
        "inequalities": {"half_sample_rate": FEW[0], "z": FEW[1], "creeping": True},
        "proof": both(Inequalities.of(corner, *FEW), Bounds.of(duty, wishes)),
        "inequalities_below": len(many.omega) + len(many.beyond) + 1,
        "share_of_both": _reach(many, duty, eased),
        "share_of_load_error": _reach(many, duty, alone),
        "instead": {
            name: _certified(duty, Gains(*(np.array([value]) for value in values)))
            for name, values in INSTEAD.items()
        },
    }
