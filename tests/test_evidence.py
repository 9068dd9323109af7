"""A part of every study, made again from its seed, is what docs/evidence holds.

Where these fail, a change of the code has changed results: run the study's ``make`` target again, look at
what is different, and commit it with the change. The others are in tests/test_soundness.py (certify.json),
test_rivals_arms.py, test_export_cortex.py, test_studies.py (reproduce.json), test_franka.py, and
test_lanes.py, which asks of every run what lanes-*.json found of many. Only times (bench.json, studio.json,
and the last rows of franka.json) are not made again.
"""

import json
import warnings
from dataclasses import asdict

import numpy as np
import pytest

from dashpot.arm.robot import Robot
from dashpot.campaign.scenario import OK, Campaign
from dashpot.campaign.spec import Spec
from dashpot.campaign.store import create, open_dataset
from dashpot.campaign.together import run_together
from dashpot.control.controller import JointGains, load_controller
from dashpot.control.laws import law_from_table
from dashpot.design.design import design_arm
from dashpot.errors import InputWarning
from dashpot.paper.instability import describe_resonance
from dashpot.paper.setup import setup
from dashpot.studies import (
    choices,
    designs,
    designs_arms,
    designs_proof,
    identification,
    identification_arms,
    readiness,
    rivals_tuning,
)
from dashpot.studies.designs_necessary import Corner, Inequalities
from dashpot.studies.numbers import DOCS, Keys

ROUNDED = 1e-6  # relative: what another compiler or processor may change


def evidence(name):
    return json.loads((DOCS / "evidence" / name).read_text("utf-8"), object_hook=Keys)


def close(value, relative):
    """What is measured may differ by so much; counts, names and verdicts may not."""
    parts = value if isinstance(value, list) else [value]
    return pytest.approx(value, rel=relative) if any(isinstance(p, float) for p in parts) else value


def test_resonant_gains_grow_and_decay_as_recorded():
    said = evidence("fig6.json")
    found = describe_resonance(setup(), tuple(JointGains(**gains) for gains in said.gains))
    assert found["growth_per_s"] == pytest.approx(dict(said.growth_per_s), rel=ROUNDED)
    assert found["frequency_hz"] == pytest.approx(said.frequency_hz, rel=ROUNDED)


def test_a_design_and_its_simulation():
    row = evidence("design-predictions.json").held_by_friction[0]
    found = designs.predicted(0, row.drive, row.preset)
    assert found.keys() == row.keys()
    for name, value in row.items():
        assert found[name] == close(value, 1e-3), name


def test_a_search_finds_nothing_that_the_long_one_did_not():
    which = ("fr3", "joint7", "brake")
    cases = evidence("design-brute.json").cases
    case = next(case for case in cases if (case.robot, case.joint, case.preset) == which)
    found = designs.brute(*which, 2000)
    assert found["feasible"] == case.feasible
    assert found["gain"] <= case.gain + 1e-9
    assert found["within_limits"] / 2000 == pytest.approx(case.within_limits / case.points, abs=0.03)


def test_a_wrist_is_designed_again():
    arms = evidence("design-arms.json").arms
    said = next(arm for arm in arms if arm.robot == "k807" and arm.period == 0.001)
    robot, hand = Robot.load("k807"), load_controller(designs_arms.HAND["k807"])
    shares = said.asked_over_hand_picked, said.error_asked_over_hand_picked
    design = design_arm(robot, designs_arms.wanted(robot, hand, *shares, period=0.001), workers=1)
    for found, gains in zip(design.config.joints, said.gains, strict=True):
        assert vars(found) == {name: close(value, 1e-3) for name, value in gains.items()}


def test_a_joint_is_designed_again_with_other_means():
    row = evidence("choices.json").designs[1]
    found = choices.designed(row.flags)
    assert found["gains"] == {name: close(value, 1e-3) for name, value in row.gains.items()}
    assert {key: found[key] for key in found if key != "gains"} == {k: row[k] for k in row if k != "gains"}


def test_a_bundled_arm_is_identified_again(tmp_path, monkeypatch):
    """By the three commands that a user types."""
    monkeypatch.chdir(tmp_path)
    row = evidence("identify-arms.json").arms[-1]
    found = identification_arms.arm(row.robot, row.controller, row.payload, row.offset)
    for name in identification_arms.COMPARED:
        assert found[name] == {key: close(value, 1e-3) for key, value in row[name].items()}, name
    assert found["damping_refused"] == row.damping_refused


def test_the_refusal_at_200_hz_is_proven_again():
    said = evidence("design-proof.json")
    duty, wishes = designs_proof.asked()
    given = Inequalities.of(Corner.of(duty), *designs_proof.FEW)
    found = designs_proof.both(given, designs_proof.Bounds.of(duty, wishes))
    for name, row in said.proof.items():
        assert found[name]["proven"]
        assert found[name]["open"] == row.open == 0
        # Where a piece is cut may hang on a bit.
        assert found[name]["pieces"] == pytest.approx(row.pieces, rel=0.01)


@pytest.mark.parametrize("kind", ["standstill", "one way", "creeping", "dead torque sensor"])
def test_a_blind_log_is_refused_for_the_same_reason(kind):
    said = evidence("identify.json")
    _, _, missing, refused = identification.judge_blind(said.seed, kind, 0)
    assert missing == []
    assert next(iter(refused.values())) == said.blind_logs.kinds[kind].says


@pytest.mark.parametrize("number", [3, 17])
def test_a_drive_is_identified_again(number):
    said = evidence("identify.json")
    found, row = identification.judge(said.seed, number), said.random_drives.each[number]
    assert identification.held(found) == (row.held, row.given)
    for name, value in row.estimates.items():
        assert found.found[name][0] == pytest.approx(value, rel=1e-4), name


@pytest.mark.parametrize("name", ["encoder_lost all", "torque_scale"])
def test_every_scenario_of_a_fault_ends_again_as_recorded(name, tmp_path):
    """360 of the 10,080 scenarios of the readiness campaign."""
    campaign = Campaign(Spec.load("readiness"))
    spec = campaign.spec
    at = spec.axis("fault").labels.index(name)
    indices = np.arange(spec.size).reshape(spec.shape).take(at, spec.dims.index("fault")).ravel()
    create(tmp_path / "gate.zarr", campaign)
    with open_dataset(tmp_path / "gate.zarr") as opened:
        dataset = opened.load()
    outcomes = run_together(campaign, [int(index) for index in indices])
    for index, outcome in zip(indices, outcomes, strict=True):
        place = np.unravel_index(index, spec.shape)
        assert outcome.status == OK
        dataset["status"].values[place] = outcome.status
        for measure, value in outcome.measures.items():
            dataset[measure].values[place] = value
    found, row = readiness.summary(spec, dataset)["faults"][name], evidence("readiness.json").faults[name]
    assert found.keys() == row.keys()
    for key, value in row.items():
        assert found[key] == close(value, 1e-3), key


@pytest.mark.parametrize("law", ["virtual_passive", "rotor_observer", "disturbance_observer"])
def test_a_tuned_law_does_again_what_it_did(law):
    said = next(row for row in evidence("rivals.json").laws if row.law == law)
    entry = next(e for e in rivals_tuning.ENTRIES if e.law == law and e.brake == (said["as"] == "brake"))
    table = {"name": "joint", "law": law, **said.not_tuned, **said.tuned}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        found = asdict(rivals_tuning.judge(entry, [law_from_table(table)])[0])
    for name, value in found.items():
        assert value == pytest.approx(said[name], rel=1e-4), name
