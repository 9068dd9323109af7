"""The bundled arms with designed gains against the hand-picked ones, at payloads the design never saw."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from dashpot.certify.certificate import certify_arm
from dashpot.controller import Controller, ControllerConfig, load_controller
from dashpot.design import candidates as quantity
from dashpot.design.candidates import Gains
from dashpot.design.design import Design, design_arm, duties
from dashpot.design.search import JointSearch
from dashpot.design.spec import NO_LIMIT, Spec
from dashpot.design.workers import cores
from dashpot.errors import InputWarning
from dashpot.payload import Payload
from dashpot.plant import build
from dashpot.robot import Robot
from dashpot.simulate import Event, Scenario, run
from dashpot.trajectory import multisine

DESIGNED_FOR = 3.0  # [kg]
UNSEEN = (0.0, 0.7, 1.9, 4.0)  # [kg]; the last is more than was designed for
OFFSET = {"k807": (0.23, 0.0, 0.0), "fr3": (0.1, 0.0, 0.0), "iiwa14": (0.1, 0.0, 0.0)}  # [m]
HAND = {"k807": "k807-wrist", "fr3": "fr3", "iiwa14": "iiwa14"}
MOTION, RELEASED, WATCHED = 6.0, 4.0, 2.0  # [s]; when the encoders are taken away, and how long is watched
SEEDS = (0, 1, 2)


def wanted(robot: Robot, hand: ControllerConfig, **means: Any) -> Spec:
    """At least as stiff and as quick to stop as the hand-picked gains, joint by joint."""
    names = tuple(joint.name for joint in hand.joints)
    spec = Spec.load("track").changed(
        payload=DESIGNED_FOR,
        offset=OFFSET[robot.name],
        joints=names,
        pose="home",
        gravity_compensated=False,
        period=hand.period,
        sampling=hand.sampling,
        margin=0.05,
    )
    spec = replace(spec, wishes={**spec.wishes, "damping_ratio": 0.3, "authority": None}).changed(**means)
    own: dict[str, dict[str, float]] = {}
    for duty, joint in zip(duties(robot, spec), hand.joints, strict=True):
        gains = Gains.from_joint(joint)
        judged = JointSearch(duty, spec.of(duty.drive.name), True).assured
        values = {
            "stop_time": float(quantity.stop_time(judged, gains)[0]),
            "travel": float(quantity.travel(judged, gains)[0]),
            "error_ratio": float(quantity.error_ratio(judged, gains)[0]),
        }
        if duty.load > 1e-6:
            values["load_error"] = float(quantity.load_error(judged, gains)[0])
        own[joint.name] = values
    return replace(spec, own=own)


def simulated(
    robot: Robot, config: ControllerConfig, period: float, payload: float, seed: int
) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """RMS tracking error before, path of the links after the encoders are taken away, (n,) each [rad]."""
    weights = [Payload(payload, OFFSET[robot.name])] if payload > 0 else []
    plant = build(robot, period, weights)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        controller = Controller.from_config(config, robot.drives)
    path = multisine(robot.home, MOTION, period, seed, amplitude=0.25)
    events = [Event(RELEASED, "all", "position_loop", False), Event(RELEASED, "all", "warm_start")]
    recording = run(Scenario(plant, controller, path, events, seed=seed))
    if recording.diverged_at is not None:
        return np.full(len(robot.drives), math.inf), np.full(len(robot.drives), math.inf)
    chosen = [robot.index(joint.name) for joint in config.joints]
    before = (recording.time > 1) & (recording.time < RELEASED)
    after = (recording.time >= RELEASED) & (recording.time < RELEASED + WATCHED)
    error = (recording.position - recording.reference)[before][:, chosen]
    travel = np.abs(recording.link_velocity[after][:, chosen]).sum(0) * period
    return np.sqrt((error**2).mean(0)), travel


def compared(
    robot: Robot, hand: ControllerConfig, design: Design, payloads: Sequence[float], seeds: Sequence[int]
) -> dict[str, Any]:
    """Designed over hand-picked, per joint, in simulation: the median over seeds, the worst over payloads."""
    error, travel = [], []
    for payload in payloads:
        rows = []
        for seed in seeds:
            theirs = simulated(robot, hand, hand.period, payload, seed)
            ours = simulated(robot, design.config, design.config.period, payload, seed)
            rows.append([ours[0] / theirs[0], ours[1] / theirs[1]])
        ratios = np.median(rows, axis=0)
        error.append(ratios[0])
        travel.append(ratios[1])
    return {
        "payloads_kg": list(payloads),
        "tracking_error_over_hand_picked": np.max(error, 0).round(3).tolist(),
        "travel_after_release_over_hand_picked": np.max(travel, 0).round(3).tolist(),
        "per_payload": {
            f"{payload:g}": {"error": e.round(3).tolist(), "travel": t.round(3).tolist()}
            for payload, e, t in zip(payloads, error, travel, strict=True)
        },
    }


def arm(name: str, **means: Any) -> dict[str, Any]:
    """Designs one arm to be no worse than its hand-picked gains, and simulates both."""
    robot, hand = Robot.load(name), load_controller(HAND[name])
    spec = wanted(robot, hand, **means)
    design = design_arm(robot, spec, workers=cores())
    before = certify_arm(robot, hand)
    row: dict[str, Any] = {
        "robot": name,
        "period": spec.period,
        "hand_picked_certified": [joint.certified for joint in before.joints],
        "feasible": [joint.found is not None for joint in design.joints],
    }
    if not design.feasible:
        row["conflicts"] = {
            joint.name: {
                "wishes": list(joint.conflict.wishes),
                "shortfalls": [[s.name, s.wanted, s.possible] for s in joint.conflict.shortfalls],
                "change": joint.conflict.change,
            }
            for joint in design.joints
            if joint.conflict is not None
        }
        return row
    after = certify_arm(robot, design.config)
    row |= {
        "certified": [joint.certified and bool(joint.brake and joint.brake.proven) for joint in after.joints],
        "margin": [round(joint.found.margin, 3) for joint in design.joints if joint.found is not None],
        "gains": [vars(joint) for joint in design.config.joints],
        **compared(robot, hand, design, UNSEEN, SEEDS),
    }
    return row


def arms() -> list[dict[str, Any]]:
    """The three arms; the k807 at the paper's 200 Hz and at 1 kHz.

    The fr3's hand-picked gains let two joints creep under its weight; so may the designed ones.
    """
    return [arm("k807"), arm("k807", period=0.001), arm("fr3", creep=NO_LIMIT), arm("iiwa14")]
