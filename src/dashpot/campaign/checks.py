"""What is checked of a campaign before anything runs: joints, and every axis at its ends."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from dashpot.campaign.blame import of_axis, plain
from dashpot.campaign.script import PLACES
from dashpot.errors import InputError
from dashpot.simulation.prepare import check

if TYPE_CHECKING:
    from dashpot.campaign.scenario import Campaign


def check_campaign(campaign: Campaign) -> None:
    """Checks joints, and every axis at its ends.

    Raises:
        DashpotError: A value is not valid, or a scenario there cannot be built.
    """
    spec, base = campaign.spec, campaign.values(0)
    _check_joints(campaign)
    try:
        _probe(campaign, base)
    except InputError:
        _probe(campaign, {})
        tried: dict[str, Any] = {}
        for axis in spec.axes:  # one by one, to name the one that does it
            tried[axis.name] = base[axis.name]
            with of_axis(spec.file, axis, base[axis.name]):
                _probe(campaign, tried)
        raise
    for axis in spec.axes:
        for end in axis.ends():
            value = (end,) * len(campaign.robot.joints) if axis.each_joint else end
            with of_axis(spec.file, axis, end):
                _probe(campaign, {**base, axis.name: value})


def _probe(campaign: Campaign, values: Mapping[str, Any]) -> None:
    scenario, spec = campaign.assemble(campaign.setting(0, values)), campaign.spec
    last = scenario.trajectory.time[-1]
    if spec.release is not None and not 0 <= spec.release < last:
        rule = f"must be within the motion, 0 to {last:g} s"
        raise InputError(rule, file=spec.file, quantity="release [s]", value=plain(spec.release))
    check(scenario)


def _check_joints(campaign: Campaign) -> None:
    """Joints are those of the robot, wherever the specification names one."""
    spec, known = campaign.spec, campaign.robot.joints

    def refuse(quantity: str, value: str | None = None, more: str = "") -> InputError:
        rule = f"no such joint; {campaign.robot.name} has {', '.join(known)}{more}"
        return InputError(rule, file=spec.file, quantity=quantity, value=value)

    for axis in spec.axes:
        kind, *joint = axis.name.split(".")[:-1] or [""]
        if joint and ".".join(joint) not in known:
            raise refuse(f"axes.{kind}.{'.'.join(joint)}")
    for requirement in spec.requirements:
        if requirement.joint is not None and requirement.joint not in known:
            raise refuse(f"requirements.{requirement.name}.joint", requirement.joint)
    for script in campaign.scripts.values():
        for fault in script.faults:
            if fault.joint not in (*known, *PLACES, "all"):
                raise refuse("axes.fault.joint", fault.joint, f"; or {', '.join(PLACES)}")
