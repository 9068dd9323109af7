"""The certificate's first guess, in milliseconds: enough to colour a slider while it moves, never a proof.

Two lifted ports on a grid of frequencies give the index that infinitely many sub-intervals would have
(`dashpot.certify.index`); a dip between the frequencies can be missed, so that what looks certified has yet
to be proven. What is refused here would be refused there.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from dashpot.arm.drive import Drive
from dashpot.certify.box import at
from dashpot.certify.certificate import block_of
from dashpot.certify.exact import at_rest, unfit
from dashpot.certify.index import FIRST_INTERVALS, settled
from dashpot.certify.joint import Scales, holds_torque, sampled_joint
from dashpot.certify.threads import one_thread
from dashpot.control.controller import ControllerConfig, Law

GRID = np.concatenate([np.geomspace(1e-4, 0.08, 10), np.linspace(0.1, np.pi, 18)])


@one_thread
def quick_index(
    drive: Drive, block: NDArray[np.void], config: ControllerConfig, scales: Scales | None = None
) -> float:
    """About the passivity index [N m s/rad]; -inf: unstable with its link held, or not to be judged."""
    if holds_torque(block):
        return -np.inf
    joint = sampled_joint(drive, block, config.sampling, config.period, scales or Scales())
    if joint.speed_in_sample:
        return -np.inf
    with np.errstate(all="ignore"):
        try:
            rest = at_rest(joint)
            if unfit(rest):
                return -np.inf
            coarse, fine = (
                settled(joint, rest, N).least_damping(GRID) for N in (FIRST_INTERVALS // 2, FIRST_INTERVALS)
            )
        except (np.linalg.LinAlgError, ValueError):
            return -np.inf
    limit = fine - np.maximum(coarse - fine, 0.0) / 3
    return float(limit.min()) + drive.link_friction


def quick_worst(drive: Drive, law: Law, config: ControllerConfig, point: Mapping[str, float] | None) -> float:
    """The lesser of the index at the nominal drive and at a point of its uncertainty, if one is given."""
    block = block_of(drive, law, config)  # the law rests on the nominal drive
    nominal = quick_index(drive, block, config)
    if point is None or not np.isfinite(nominal):
        return nominal
    there, scales = at(drive, point)
    return min(nominal, quick_index(there, block, config, scales))
