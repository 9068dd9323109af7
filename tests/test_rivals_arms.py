"""Rivals on whole arms: the measures, the scenarios, and that document, evidence and simulation agree."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dashpot.certify.certificate import certify_joint
from dashpot.control.controller import load_controller
from dashpot.control.rivals.tracking import PD
from dashpot.simulation.recording import Recording
from dashpot.simulation.simulate import Scenario, run
from dashpot.simulation.trajectory import hold
from dashpot.studies import rivals_arms as study
from dashpot.studies import rivals_arms_cases as cases
from dashpot.studies import rivals_arms_designed as designs
from dashpot.studies import rivals_arms_measures as measures
from dashpot.studies.rivals_arms_parts import Parts
from dashpot.studies.rivals_arms_tables import document, draw
from dashpot.studies.rivals_bench import BENCH
from dashpot.studies.rivals_tuning import ENTRIES

DOCS = Path(__file__).parents[1] / "docs"
K807, FR3, FAST, HEAVY = cases.ARMS


@pytest.fixture(scope="module")
def evidence():
    return json.loads((DOCS / "evidence" / "rivals-arms.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def found(evidence):
    return study.Found.of(evidence)


# --- measures -------------------------------------------------------------------------------------


def test_a_stop_time_is_that_of_the_last_crossing():
    period = 1e-3
    time = period * np.arange(3000)
    decay = np.exp(-time / 0.2)
    swings = np.exp(-time / 0.2) * np.cos(2 * np.pi * 5 * time)
    slow = 0.06 + 0 * time
    slow[1000:] = 0.9 * measures.STILL  # 30 % of its first speed, but it stands still
    speeds = np.stack([0.7 * decay, -3 * decay, swings, np.full_like(time, 0.3), 0.01 * decay, slow], axis=1)
    found = measures.stop_time(speeds, period)
    exact = 0.2 * math.log(1 / measures.STOPPED)
    np.testing.assert_allclose(found[:2], exact, atol=1.001 * period)
    assert exact - 0.1 <= found[2] <= exact + period  # one half swing of 5 Hz before at the most
    assert math.isinf(found[3])
    assert math.isnan(found[4])
    assert found[5] == pytest.approx(1.0)


def test_a_brake_that_creeps_drifts_for_five_seconds():
    """A link that goes on at a constant speed: all measures in closed form."""
    laws = tuple(PD(name, kp=10.0, kd=1.0) for name in K807.joints)
    config = replace(load_controller("k807-wrist"), joints=laws, file=None)
    scenario = cases.stop(K807, config, K807.payloads[0], 1)
    path, n = scenario.trajectory, len(cases.robot(K807).joints)
    since = (path.time - cases.LOST)[:, None]
    assert since[-1, 0] == pytest.approx(measures.FIRST + measures.DRIFT, abs=1e-9)
    speed = np.where(since < 0.5, 0.3, 0.016)
    angle = np.cumsum(speed, axis=0) * path.period
    flat = np.zeros((len(path.time), n))
    torque = np.where(since < 0, 7.0, 3.0)  # what was before the loss does not count
    seen = measures.stopping(None)(
        scenario,
        Recording(
            cases.robot(K807).joints,
            path.time,
            path.position,
            **dict.fromkeys(("position", "velocity", "torque", "sample", "command"), flat),
            link_position=angle + flat,
            link_velocity=speed + flat,
            in_effect=-torque + flat,
            status=np.zeros(len(path.time), np.int32),
        ),
    )
    limits = [drive.torque_limit for drive in cases.robot(K807).drives[4:]]
    np.testing.assert_allclose(seen["stop_time"], 0.5, atol=1e-9)
    np.testing.assert_allclose(seen["stop_angle"], 0.3 * 0.5 + 0.016 * 0.5, atol=0.3 * path.period)
    np.testing.assert_allclose(seen["drift"], 0.016 * measures.DRIFT, rtol=1e-9)
    np.testing.assert_allclose(seen["peak_torque"], [3.0 / limit for limit in limits])


def test_percentiles_count_what_never_stops():
    assert measures.spread(np.array([1.0, 2.0, math.inf])) == [2.0, None]
    assert measures.spread(np.array([math.nan, 3.0])) == [3.0, 3.0]
    assert measures.spread(np.array([math.nan])) == [None, None]
    seen = [{"x": [1.0, math.nan]}, {"x": [math.nan, math.nan]}, {"x": [2.0, 5.0]}, {"x": [0.0, 4.0]}]
    assert measures.summary(seen, ["x"]) == {"x": [4.0, 5.0]}


def test_gains_scale_with_the_drive():
    """A sampled damper and spring reach their limits at m/h and m/h^2."""
    for bench in (bench for arm in (K807, FR3, FAST) for bench in cases.benches(arm).values()):
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


def test_all_brakes_take_over_from_the_same_motion(found):
    mover = study.chosen(FR3, study.TRACKERS[0], found)
    before = []
    for rival in (study.BRAKES[1], study.BRAKES[4], study.BRAKES[-2], study.BRAKES[-1]):
        config = cases.braking(study.chosen(FR3, rival, found), mover)
        scenario = cases.stop(FR3, config, 1.5, 5, rival.fault)
        short = scenario.trajectory.until(cases.LOST + 0.1)
        seen = run(replace(scenario, trajectory=short))
        before.append(seen.link_position[seen.time < cases.LOST - 1e-9])
        after = seen.link_position[-1]
    assert np.abs(np.diff(before[0], axis=0)).max() / short.period > 0.1  # it moves
    for other in before[1:]:
        np.testing.assert_array_equal(before[0], other)
    assert np.abs(after - before[0][-1]).max() > 1e-3


# --- evidence -------------------------------------------------------------------------------------


def test_the_figure_is_drawn_from_the_evidence(evidence, tmp_path):
    draw(evidence, tmp_path / "figure.png")
    assert (tmp_path / "figure.png").stat().st_size > 10_000
    assert (DOCS / "images" / "rivals-arms.png").is_file()


def test_every_rival_is_there_and_had_the_same_budget(evidence):
    names = [(row["arm"], row["name"]) for row in evidence["brakes"]]
    assert names == [(arm.name, rival.name) for arm in cases.ARMS for rival in study.BRAKES]
    names = [(row["arm"], row["name"]) for row in evidence["trackers"]]
    assert names == [(arm.name, rival.name) for arm in (K807, FR3, FAST) for rival in study.TRACKERS]
    shares = {arm.name: arm.share for arm in cases.ARMS}
    for part, seeds in (("brakes", "seeds_per_payload"), ("trackers", "tracker_seeds_per_payload")):
        for row in evidence[part]:
            if "refused" not in row:
                assert row["scenarios"] == 3 * (evidence[seeds] // shares[row["arm"]])
    assert all(row["scenarios"] >= 500 for row in evidence["brakes"] if row["arm"] in ("k807", "fr3"))
    for entry in ENTRIES:
        key = f"{'brake' if entry.brake else 'tracker'} {entry.law}"
        for kinds in evidence["tuning"].values():
            for kind in kinds.values():
                assert kind["laws"][key]["sets"] == max(1, evidence["budget"] * len(entry.tuned))


@pytest.mark.parametrize(
    ("arm", "name"),
    [(FR3, "virtual passive, designed"), (FAST, "shorted windings"), (HEAVY, "rotor observer")],
)
def test_a_stop_is_found_again(evidence, found, arm, name):
    """The first run of a row, simulated anew."""
    rival = next(rival for rival in study.BRAKES if rival.name == name)
    row = next(row for row in evidence["brakes"] if (row["arm"], row["name"]) == (arm.name, name))
    mover = study.chosen(arm, study.TRACKERS[0], found)
    config = cases.braking(study.chosen(arm, rival, found), mover)
    scenario = cases.stop(arm, config, arm.payloads[0], evidence["seed"], rival.fault)
    agrees(measures.stopping(rival.fault)(scenario, run(scenario)), row["first"])


@pytest.mark.parametrize("name", ["PD + wrong load model", "virtual passive, bundled"])
def test_a_motion_is_found_again(evidence, found, name):
    rival = next(rival for rival in study.TRACKERS if rival.name == name)
    row = next(row for row in evidence["trackers"] if (row["arm"], row["name"]) == ("fr3", name))
    config = study.chosen(FR3, rival, found)
    scenario = cases.track(FR3, config, FR3.payloads[0], evidence["seed"])
    agrees(measures.tracking(scenario, run(scenario)), row["first"])


def agrees(seen, expected):
    for key, values in measures.rounded(seen).items():
        agree(values, expected[key])


def agree(values, expected):
    for value, known in zip(values, expected, strict=True):
        assert (value is None) == (known is None)
        if value is not None:
            assert value == pytest.approx(known, rel=0.02, abs=1e-5)


def test_verdicts_are_those_of_the_certificate(evidence, found):
    """Of two rows on the k807's wrist, one each way."""
    rows = {row["name"]: row["certified"] for row in evidence["brakes"] if row["arm"] == "k807"}
    for name, verdict in (("off", True), ("static torque feedback", rows["static torque feedback"])):
        rival = next(rival for rival in study.BRAKES if rival.name == name)
        config = study.chosen(K807, rival, found)
        assert study.certified(K807, [config], True, Parts(None)) == [verdict]
        assert rows[name] == verdict


def test_designs_are_told_what_the_tuning_is_told(evidence, found):
    for arm in (K807, FR3, FAST):
        for duty in designs.DUTIES:
            spec, design = designs.wishes(arm, duty), evidence["designs"][arm.name][duty]
            assert tuple(design["joints"]) == spec.joints == arm.joints
            for kind, bench in cases.benches(arm).items():
                told = evidence["tuning"][arm.name][kind]["bench"]
                for joint in arm.types[kind]:
                    assert spec.own[joint] == design["own"][joint]
                    assert spec.own[joint] == {
                        "inertia": told["inertia"] + told["heaviest"],
                        "load": bench.load,
                    }


def test_a_design_is_certified_or_refused_with_its_reasons(evidence, found):
    rows = [row for part in ("brakes", "trackers") for row in evidence[part] if "designed" in row["name"]]
    assert len(rows) == 7
    text = (DOCS / "rivals.md").read_text(encoding="utf-8")
    for row in rows:
        if "refused" in row:
            assert all("; ".join(lines) in text for lines in row["refused"].values())
        else:
            assert row["certified"] in (True, None)
    rival = next(rival for rival in study.BRAKES if rival.duty)
    config = study.chosen(K807, rival, found)
    drive = replace(cases.robot(K807).drives[5], name="joint", servo=None)
    law = replace(config.joints[1], name="joint")
    assert certify_joint(drive, law, replace(config, joints=(law,))).certified


# --- the study itself -----------------------------------------------------------------------------


def test_a_stopped_study_goes_on_where_it_was(evidence, found, tmp_path, monkeypatch):
    """One motion of three rows, whose first run is that of the evidence; then again with a part missing."""
    rows = {"brakes": study.BRAKES[:2], "trackers": study.TRACKERS[:1]}
    size = {"found": found, "arms": (K807,), **rows}
    seed = evidence["seed"]
    first = study.study(1, 1, 1, seed, parts=Parts(tmp_path), **size)
    for part, rivals in rows.items():
        for row, rival in zip(first[part], rivals, strict=True):
            known = next(row for row in evidence[part] if (row["arm"], row["name"]) == ("k807", rival.name))
            assert row["scenarios"] == 3
            assert (row["certified"], row["oscillates"]) == (known["certified"], known["oscillates"])
            for key, values in row["first"].items():
                agree(values, known["first"][key])
    ran = []
    run_many = study.run_many
    monkeypatch.setattr(study, "run_many", lambda all, **how: (ran.extend(all), run_many(all, **how))[1])
    monkeypatch.setattr(study, "each", lambda *_: pytest.fail("the certificates were kept"))
    (lost,) = tmp_path.glob("k807-brake-shorted-windings-2-kg-*.json")
    lost.write_text(lost.read_text()[:-20])  # half a file is none
    again = study.study(1, 1, 1, seed, parts=Parts(tmp_path), **size)
    assert len(ran) == 1
    assert json.dumps(again) == json.dumps(first)
    draw(first, tmp_path / "figure.png")
    assert "shorted windings" in document(first)


def test_parts_are_made_anew_where_what_they_hang_on_has_changed(tmp_path):
    model = tmp_path / "model"
    model.write_text("one")
    made = []

    def make(parts, inputs):
        return parts.made("some, thing", inputs, lambda: made.append(inputs) or [math.inf, len(made)])

    assert make(Parts(tmp_path / "parts", model), {"kp": 1.0}) == [math.inf, 1]
    assert make(Parts(tmp_path / "parts", model), {"kp": 1.0}) == [math.inf, 1]
    assert make(Parts(tmp_path / "parts", model), {"kp": 2.0}) == [math.inf, 2]
    model.write_text("two")
    assert make(Parts(tmp_path / "parts", model), {"kp": 2.0}) == [math.inf, 3]
    assert make(Parts(None), {"kp": 2.0}) == [math.inf, 4]
    assert [path.name for path in (tmp_path / "parts").iterdir()] == ["some-thing.json"]
