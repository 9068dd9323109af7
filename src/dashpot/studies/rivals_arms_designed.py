"""What `dashpot design` makes of the arms of `dashpot.studies.rivals_arms`, told what the tuning is told."""

from __future__ import annotations

from typing import Any

from dashpot.control.laws import to_table
from dashpot.design.design import design_arm
from dashpot.design.spec import Spec
from dashpot.design.words import conflict_lines
from dashpot.studies.rivals_arms_cases import Arm, benches, bundled, robot
from dashpot.support.workers import cores

LOAD_ERROR = 0.05  # [rad]; without a limit `track` at 200 Hz is certified, but too soft to be a tracker
DUTIES: dict[str, tuple[str, dict[str, float]]] = {
    "brake": ("brake", {}),
    "tracker": ("track", {"load_error": LOAD_ERROR}),
}
"""Duty -> preset, and the wishes that are added to its own."""


def wishes(arm: Arm, duty: str) -> Spec:
    """What is wished for: the preset, at home, with the means of the bundled controller.

    Every joint is told the heaviest inertia and the largest load on which laws for its drive type are tuned.

    Args:
        arm: The arm; a balanced one carries its own weight.
        duty: "brake" or "tracker".
    """
    means, (preset, more) = bundled(arm), DUTIES[duty]
    own = {
        joint: {"inertia": bench.inertia + bench.heaviest, "load": bench.load}
        for kind, bench in benches(arm).items()
        for joint in arm.types[kind]
    }
    return Spec.load(preset).changed(
        payload=arm.payloads[-1],
        offset=(arm.offset, 0.0, 0.0),
        joints=arm.joints,
        own=own,
        pose="home",
        gravity_compensated=arm.balanced,
        period=means.period,
        latency=means.latency,
        sampling=means.sampling,
        form=means.form,
        **more,
    )


def designed(arm: Arm, duty: str) -> dict[str, Any]:
    """Designs an arm; for JSON: gains, margin and prediction per joint, or why one has none."""
    spec = wishes(arm, duty)
    joints: dict[str, Any] = {}
    for joint in design_arm(robot(arm), spec, workers=cores()).joints:
        if joint.found is None:
            joints[joint.name] = {"refused": conflict_lines(joint)}
        else:
            joints[joint.name] = {
                "law": to_table(joint.found.gains.joint(joint.name)),
                "margin": float(f"{joint.found.margin:.3g}"),
                "predicted": {name: float(f"{value:.4g}") for name, value in joint.predicted.items()},
            }
    return {"preset": spec.preset, "wishes": dict(spec.wishes), "own": dict(spec.own), "joints": joints}
