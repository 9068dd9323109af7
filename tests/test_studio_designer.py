"""The designer called from the studio: what it finds is taken over, what it cannot is explained."""

from __future__ import annotations

import math
import multiprocessing
import time
from dataclasses import replace

import pytest

from dashpot.arm.payload import Payload
from dashpot.arm.robot import Robot
from dashpot.certify.certificate import certify_arm
from dashpot.control.controller import load_controller
from dashpot.design.conflicts import Conflict, Shortfall
from dashpot.design.design import Design, JointDesign, duties
from dashpot.errors import DashpotError, InputError
from dashpot.studio.designer import Designer, specification, taken_over

LOAD = Payload(1.0, (0.0, 0.0, 0.1))
PATIENCE = 120.0  # [s]


def designed(robot: Robot, *arguments: object, **limits: float) -> tuple[Design | None, str]:
    found: list[tuple[Design | None, str]] = []
    designer = Designer()
    designer.begin(robot, specification(*arguments, **limits), lambda *got: found.append(got))  # type: ignore[arg-type]
    with pytest.raises(DashpotError, match="under way"):
        designer.begin(robot, specification(*arguments), lambda *got: None)  # type: ignore[arg-type]
    end = time.monotonic() + PATIENCE
    while not found and time.monotonic() < end:
        time.sleep(0.05)
    designer.end()
    return found[0]


def test_its_gains_are_taken_over_and_certified() -> None:
    robot, config = Robot.load("fr3"), load_controller("fr3")
    found, why = designed(robot, config, ("joint7",), LOAD, "gentle")
    assert why == ""
    assert found is not None
    new = taken_over(config, found)
    assert new.joints[:-1] == config.joints[:-1]
    assert new.joints[-1] != config.joints[-1]
    assert new.period == config.period
    verdict = certify_arm(robot, replace(new, joints=new.joints[-1:]))
    assert verdict.certified


def test_a_wish_that_cannot_be_kept_is_explained() -> None:
    robot, config = Robot.load("fr3"), load_controller("fr3")
    spec = specification(config, ("joint7",), LOAD, "track", stop_time=1e-4)
    (duty,) = duties(robot, spec)
    why = Conflict(("stop_time",), (Shortfall("stop_time", 1e-4, 0.02),), "", ())
    failed = JointDesign("joint7", duty, spec.of("joint7"), None, {}, {}, math.inf, None, why, 1, 1)
    with pytest.raises(DashpotError, match=r"joint7: .*stop time.*20.0 ms possible"):
        taken_over(config, Design("fr3", spec, (failed,)))
    with pytest.raises(InputError, match="error_ratio"):
        specification(config, ("joint7",), LOAD, "track", error_ratio=-1.0)


def test_it_ends_at_once() -> None:
    robot, config = Robot.load("fr3"), load_controller("fr3")
    before, said = set(multiprocessing.active_children()), []
    designer = Designer()
    spec = specification(config, robot.joints, LOAD, "track")
    designer.begin(robot, spec, lambda found, why: said.append((found, why)))
    time.sleep(1.0)
    designer.end()
    assert not designer.busy
    assert said == [(None, "")]
    assert set(multiprocessing.active_children()) <= before
