"""The certificate against loads that could prove it wrong: a seeded part of the study, and its record."""

import json
from pathlib import Path

import pytest

from dashpot.certify.loads import Load, radii
from dashpot.studies.soundness import (
    CERTIFIED,
    REFUSED,
    REFUTED,
    box_summary,
    judge,
    judge_box,
    scan,
    summary,
)
from dashpot.studies.soundness_cases import case, loads
from dashpot.studies.soundness_checks import precise_radius, single_frequency
from dashpot.studies.soundness_replays import (
    certified_replays,
    chosen,
    hung,
    refuted_replay,
)

EVIDENCE = Path(__file__).parent.parent / "docs" / "evidence" / "certify.json"
SEED = 7


@pytest.fixture(scope="module")
def verdicts():
    return [
        judge(SEED, number) for number in range(2000, 2060)
    ]  # beyond those that are searched, too: quicker


def test_no_load_tried_makes_a_certified_joint_oscillate(verdicts):
    found = summary(verdicts)["soundness"]
    assert found["exceptions"] == 0
    assert found["certified"] > 15
    assert found["with_position_loop_certified"] > 3


def test_most_refused_joints_have_a_load_that_oscillates(verdicts):
    found = summary(verdicts)["tightness"]
    assert found["refused"] > 15
    assert found["share"] > 0.8


def test_proven_boxes_hold_inside(verdicts):
    certified = [v.number for v in verdicts if v.kind == CERTIFIED]
    found = box_summary([judge_box(SEED, number, samples=20) for number in certified[:5]])
    assert found["exceptions"] == 0
    assert found["proven"] >= 3
    assert found["worst_missed_by_5_percent"] == 0


def test_replays_agree_with_the_verdicts(verdicts):
    calm, wild = chosen(SEED, verdicts)
    row = certified_replays(case(SEED, calm[0]), payloads=(0.0, 20.0))
    assert row["bounded"] == row["runs"] == 4
    assert row["torque_limited"] > 0
    assert refuted_replay(case(SEED, wild[0]))["confirmed"]


def test_a_joint_follows_from_its_number_alone():
    assert case(3, 5) == case(3, 5)
    assert case(3, 5).drive != case(3, 6).drive
    assert case(3, 5).drive != case(4, 5).drive


def test_a_wrong_verdict_would_be_noticed(verdicts):
    """The scan finds the oscillations of joints that the certificate refuses."""
    refuted = [case(SEED, v.number) for v in verdicts if v.kind == REFUTED][:4]
    assert sum(bool(scan(it.joint(), it.drive).unstable) for it in refuted) >= 3


def test_growth_in_60_digits_agrees_with_eigenvalues():
    for number in range(3):
        joint, drive = case(SEED, number).joint(), case(SEED, number).drive
        inertia, stiffness = (values[::211] for values in loads(drive))
        for j, k, radius in zip(inertia, stiffness, radii(joint, inertia, stiffness), strict=True):
            assert precise_radius(joint, j, k) == pytest.approx(radius, rel=1e-8)


def test_the_index_is_about_more_motions_than_those_of_one_frequency():
    it = next(case(SEED, n) for n in range(60) if case(SEED, n).index().passive)
    single = single_frequency(it.joint(), 10.0)
    assert single >= 0.99 * it.index().value


def test_payloads_hang_at_the_end_of_the_arm_with_the_link():
    assert hung(0.0) == Load("inertia", 0.01)
    assert hung(2.0).inertia == pytest.approx(2 * 0.09 + 0.01)
    assert hung(2.0).stiffness == pytest.approx(2 * 9.81 * 0.3)


def test_record_of_the_full_study():
    record = json.loads(EVIDENCE.read_text())
    assert record["soundness"]["joints"] == 10_000
    assert record["soundness"]["exceptions"] == record["boxes"]["exceptions"] == 0
    assert record["tightness"]["share"] >= 0.8
    certified = record["replays"]["certified"]
    assert certified["bounded"] == certified["runs"] > 0
    assert certified["torque_limited"] > 0
    assert record["replays"]["refuted"]["confirmed"] == record["replays"]["refuted"]["joints"] == 10
    for number in (0, 1, 16, 51, 97):
        index = case(record["seed"], number).index()
        recorded = record["verdicts"][number]
        assert index.passive == (recorded == CERTIFIED)
        assert index.decided
        assert recorded in (CERTIFIED, REFUTED, REFUSED)
