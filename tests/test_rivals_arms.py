"""Rivals on whole arms: the measures, the scenarios, and that document, evidence and simulation agree."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dashpot.controller import load_controller
from dashpot.rivals.tracking import PD
from dashpot.simulate import Scenario, run
from dashpot.studies import rivals_arms as study
from dashpot.studies import rivals_arms_cases as cases
from dashpot.studies import rivals_arms_measures as measures
from dashpot.studies.rivals_arms_tables import document, draw
from dashpot.studies.rivals_bench import BENCH
from dashpot.studies.rivals_tuning import ENTRIES
from dashpot.trajectory import hold

DOCS = Path(__file__).parents[1] / "docs"
K807, FR3, HEAVY = cases.ARMS


@pytest.fixture(scope="module")
def evidence():
    return json.loads((DOCS / "evidence" / "rivals-arms.json").read_text(encoding="utf-8"))


# --- measures -------------------------------------------------------------------------------------


def test_a_stop_time_is_that_of_the_last_crossing():
    period = 1e-3
    time = period * np.arange(3000)
    decay = np.exp(-time / 0.2)
    swings = np.exp(-time / 0.2) * np.cos(2 * np.pi * 5 * time)
    speeds = np.stack([0.7 * decay, -3 * decay, swings, np.full_like(time, 0.3), 0.01 * decay], axis=1)
    found = measures.stop_time(speeds, period)
    exact = 0.2 * math.log(1 / measures.STOPPED)
    np.testing.assert_allclose(found[:2], exact, atol=1.001 * period)
    assert exact - 0.1 <= found[2] <= exact + period  # one half swing of 5 Hz before at the most
    assert math.isinf(found[3])
    assert math.isnan(found[4])


def test_percentiles_count_what_never_stops():
    assert measures.spread(np.array([1.0, 2.0, math.inf])) == [2.0, None]
    assert measures.spread(np.array([math.nan, 3.0])) == [3.0, 3.0]
    assert measures.spread(np.array([math.nan])) == [None, None]
    seen = [{"x": [1.0, math.nan]}, {"x": [math.nan, math.nan]}, {"x": [2.0, 5.0]}, {"x": [0.0, 4.0]}]
    assert measures.summary(seen, ["x"]) == {"x": [4.0, 5.0]}


def test_gains_scale_with_the_drive():
    """A sampled damper and spring reach their limits at m/h and m/h^2."""
    for bench in (*cases.benches(K807).values(), *cases.benches(FR3).values()):
        for power in (1, 2, 3):
            limits = [one.drive.rotor_inertia / one.period**power for one in (bench, BENCH)]
            assert bench.scale(power) == pytest.approx(limits[0] / limits[1])
        assert bench.scale(0) == 1
    assert BENCH.scale(2) == 1


# --- scenarios ------------------------------------------------------------------------------------


def test_a_balanced_arm_rests_where_it_is_put():
    """Without its weight only the payload's is held; a run starts without a drop."""
    bare, loaded = cases.plant(FR3, FR3.payloads[0]), cases.plant(FR3, FR3.payloads[-1])
    home = np.asarray(cases.robot(FR3).home)
    ratio = FR3.payloads[-1] / FR3.payloads[0]
    np.testing.assert_allclose(loaded.load_torque(home), ratio * bare.load_torque(home), atol=1e-9)
    own = cases.plant(HEAVY, HEAVY.payloads[0])
    assert np.abs(own.load_torque(home) - bare.load_torque(home)).max() > 20
    laws = tuple(PD(name, kp=2000.0, kd=30.0) for name in FR3.joints)
    config = replace(load_controller("fr3"), joints=laws, file=None)
    found = run(Scenario(loaded, cases.controller(FR3, config), hold(home, 0.2, config.period)))
    assert np.ptp(found.link_position, axis=0).max() < 1e-6
    np.testing.assert_allclose(-found.torque[-1], -found.command[-1], atol=0.2)  # noise is on the sensor


def test_all_brakes_take_over_from_the_same_motion(evidence):
    tuned = evidence["tuning"]
    mover = study.chosen(FR3, study.TRACKERS[0], tuned)
    before = []
    for rival in (study.BRAKES[1], study.BRAKES[4], study.BRAKES[-1]):
        config = cases.braking(study.chosen(FR3, rival, tuned), mover)
        scenario = cases.stop(FR3, config, 1.5, 5, rival.fault)
        short = scenario.trajectory.until(cases.LOST + 0.1)
        found = run(replace(scenario, trajectory=short))
        before.append(found.link_position[found.time < cases.LOST - 1e-9])
        after = found.link_position[-1]
    assert np.abs(np.diff(before[0], axis=0)).max() / short.period > 0.1  # it moves
    for other in before[1:]:
        np.testing.assert_array_equal(before[0], other)
    assert np.abs(after - before[0][-1]).max() > 1e-3


# --- evidence -------------------------------------------------------------------------------------


def test_the_document_shows_what_the_evidence_says(evidence, tmp_path):
    assert document(evidence) in (DOCS / "rivals.md").read_text(encoding="utf-8")
    draw(evidence, tmp_path / "figure.png")
    assert (tmp_path / "figure.png").stat().st_size > 10_000
    assert (DOCS / "images" / "rivals-arms.png").is_file()


def test_every_rival_is_there_and_had_the_same_budget(evidence):
    names = [(row["arm"], row["name"]) for row in evidence["brakes"]]
    assert names == [(arm.name, rival.name) for arm in cases.ARMS for rival in study.BRAKES]
    names = [(row["arm"], row["name"]) for row in evidence["trackers"]]
    assert names == [(arm.name, rival.name) for arm in (K807, FR3) for rival in study.TRACKERS]
    runs = 3 * evidence["seeds_per_payload"]
    assert {row["scenarios"] for row in evidence["brakes"] if row["arm"] != HEAVY.name} == {runs}
    for entry in ENTRIES:
        key = f"{'brake' if entry.brake else 'tracker'} {entry.law}"
        for kinds in evidence["tuning"].values():
            for kind in kinds.values():
                assert kind["laws"][key]["sets"] == max(1, evidence["budget"] * len(entry.tuned))


@pytest.mark.parametrize(
    ("arm", "name"),
    [(FR3, "shorted windings"), (FR3, "virtual passive, tuned"), (HEAVY, "rotor observer"), (K807, "off")],
)
def test_a_stop_is_found_again(evidence, arm, name):
    """The first run of a row, simulated anew."""
    rival = next(rival for rival in study.BRAKES if rival.name == name)
    row = next(row for row in evidence["brakes"] if (row["arm"], row["name"]) == (arm.name, name))
    mover = study.chosen(arm, study.TRACKERS[0], evidence["tuning"])
    config = cases.braking(study.chosen(arm, rival, evidence["tuning"]), mover)
    scenario = cases.stop(arm, config, arm.payloads[0], evidence["seed"], rival.fault)
    agrees(measures.stopping(rival.fault)(scenario, run(scenario)), row["first"])


@pytest.mark.parametrize("name", ["PD + wrong load model", "virtual passive, bundled"])
def test_a_motion_is_found_again(evidence, name):
    rival = next(rival for rival in study.TRACKERS if rival.name == name)
    row = next(row for row in evidence["trackers"] if (row["arm"], row["name"]) == ("fr3", name))
    config = study.chosen(FR3, rival, evidence["tuning"])
    scenario = cases.track(FR3, config, FR3.payloads[0], evidence["seed"])
    agrees(measures.tracking(scenario, run(scenario)), row["first"])


def agrees(seen, expected):
    for key, values in measures.rounded(seen).items():
        for value, known in zip(values, expected[key], strict=True):
            assert (value is None) == (known is None)
            if value is not None:
                assert value == pytest.approx(known, rel=0.02, abs=1e-5)


def test_verdicts_are_those_of_the_certificate(evidence):
    """Of two rows on the k807's wrist, one each way."""
    rows = {row["name"]: row["certified"] for row in evidence["brakes"] if row["arm"] == "k807"}
    for name, verdict in (("off", True), ("static torque feedback", rows["static torque feedback"])):
        rival = next(rival for rival in study.BRAKES if rival.name == name)
        assert study.certified(K807, (rival,), evidence["tuning"], True) == [verdict]
        assert rows[name] == verdict
