"""The readiness gate: what its scenarios are, and a seeded part of it on the fr3."""

from __future__ import annotations

import math
from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest

from dashpot.arm.payload import Payload
from dashpot.arm.plant import build
from dashpot.campaign.judge import judge
from dashpot.campaign.measures import MEASURES
from dashpot.campaign.scenario import OK, Campaign
from dashpot.campaign.spec import Spec
from dashpot.campaign.store import create, open_dataset
from dashpot.campaign.together import LANES, run_together
from dashpot.control.supervisor import STATES, SupervisorSettings
from dashpot.simulation.faults import NAMES, Fault
from dashpot.simulation.simulate import PayloadChange, run
from dashpot.studies.readiness import evidence

PRESET = (files("dashpot") / "campaign" / "presets" / "readiness.toml").read_text()
SEED = 5


@pytest.fixture(scope="module")
def campaign():
    return Campaign(Spec.load("readiness"))


def fault_of(campaign, index):
    value = campaign.values(index).get("fault")
    return value if isinstance(value, str) else value["name"]


def indices_of(campaign, name):
    spec = campaign.spec
    at = spec.axis("fault").labels.index(name)
    return np.arange(spec.size).reshape(spec.shape).take(at, spec.dims.index("fault")).ravel()


def test_every_kind_of_fault_and_both_changes_of_payload_are_in_it(campaign):
    scripts = campaign.scripts.values()
    assert {fault.kind for script in scripts for fault in script.faults} == set(NAMES)
    masses = [row["mass"] for script in scripts for row in script.loads]
    assert min(masses) == 0 < max(masses)
    assert campaign.spec.size >= 10_000


def test_every_fault_has_a_required_end_state(campaign):
    wanted = [r for r in campaign.spec.requirements if r.measure == "supervisor_state"]
    named = [name for r in wanted for name in dict(r.where)["fault"]]
    assert sorted(named) == sorted(campaign.spec.axis("fault").labels)  # each once


def test_a_scenario_is_the_one_made_by_hand(campaign):
    index = int(indices_of(campaign, "payload lost")[130])
    made, values = campaign.scenario(index), campaign.values(index)
    load = Payload(values["payload"], values["offset"])
    errors = {key: values[f"drive.{key}"] for key in ("coulomb_friction", "rotor_inertia")}
    assert all(0.92 <= factor <= 1.08 for factors in errors.values() for factor in factors)
    drives = campaign.robot.drives
    robot = campaign.robot.with_drives(
        {
            drive.name: {key: getattr(drive, key) * errors[key][j] for key in errors}
            for j, drive in enumerate(drives)
        }
    )
    plant = build(robot, made.controller.period, [load] if load.mass else [])
    by_hand = replace(
        made,
        plant=plant,
        payload_changes=[PayloadChange(0.8, None)],
        faults=[],
        supervisor=SupervisorSettings(stop_time=0.5, friction_margin=0.1, bias_limit=0.0017),
    )
    np.testing.assert_array_equal(run(made).link_position, run(by_hand).link_position)
    first = campaign.scenario(int(indices_of(campaign, "encoder and torque lost")[0]))
    assert first.faults == (
        Fault("encoder_lost", 0.8, joint="joint1"),
        Fault("torque_nan", 0.8, joint="joint7"),
    )


def test_the_measures_are_what_the_recording_says(campaign):
    rng = np.random.default_rng(SEED)
    for name in ("encoder_lost last", "torque_nan all", "none"):
        index = int(rng.choice(indices_of(campaign, name)))
        setting = campaign.setting(index)
        scenario = campaign.assemble(setting)
        recording = run(scenario)
        found = campaign.measure(setting, scenario, recording)
        said = recording.settings["supervisor"]
        assert STATES[int(found["supervisor_state"])] == said["state"]
        assert found["brake_closed"] == said["apply_brake"]
        if name == "none":
            assert math.isnan(found["time_to_decision"])
            assert math.isnan(found["stopped"])
            continue
        assert found["time_to_decision"] == pytest.approx(said["decisions"][0]["time"] - 0.8)
        # the encoder of joint 1 is sound in both: its own samples say whether it rests
        moved = np.abs(recording.position[-1, 0] - recording.position[-51, 0]) / 0.05
        assert found["stopped"] <= (moved < 0.02 + 1e-3)
        jump = np.abs(np.diff(recording.command, axis=0)).max(0)
        np.testing.assert_allclose(found["rate_share"], jump / 1.0)  # 1000 N m/s at 1 kHz


def test_one_scenario_of_every_fault_ends_as_documented(campaign, tmp_path):
    rng, spec = np.random.default_rng(SEED), campaign.spec
    create(tmp_path / "gate.zarr", campaign)
    with open_dataset(tmp_path / "gate.zarr") as dataset:
        dataset = dataset.load()
    indices = [int(rng.choice(indices_of(campaign, name))) for name in spec.axis("fault").labels]
    for index, outcome in zip(indices, run_together(campaign, indices), strict=True):
        assert outcome.status == OK, outcome.reason
        assert outcome.engine == LANES
        at = np.unravel_index(index, spec.shape)
        dataset["status"].values[at] = outcome.status
        for measure in MEASURES:
            dataset[measure].values[at] = outcome.measures[measure]
    hard = ("not_finite", "torque_share", "rate_share", "oscillated", "supervisor_state", "time_to_decision")
    for verdict in judge(spec, dataset):
        if verdict.requirement.measure in hard:
            assert verdict.holds, (verdict.requirement.words, verdict.worst)


def test_the_evidence_counts_what_was_run_and_goes_on_where_it_was_stopped(tmp_path):
    small = PRESET
    for old, new in (
        ("pose = { random = 10 }", 'pose = ["home"]'),
        ("points = 12", "points = 2"),
        ("payload = [0.0, 1.5, 3.0]", "payload = [0.0]"),
        ("duration = 2.0", "duration = 0.9"),
    ):
        assert small.count(old) == 1
        small = small.replace(old, new)
    spec = Spec.parse(small.replace("seed = 1 ", "chunk = 7\nseed = 1 "), None)
    part = evidence(spec, tmp_path / "part.zarr", 8, workers=0)
    assert (part["scenarios"], part["of"]) == (14, 56)
    more = evidence(spec, tmp_path / "part.zarr", 21, workers=0)
    assert more["scenarios"] == 21
    for said in (part, more):
        counts = said["faults"].values()
        assert sum(row["scenarios"] for row in counts) == said["scenarios"] - said["lost"]
        assert all(sum(row["end"].values()) == row["scenarios"] for row in counts)
        assert said["passed"] == sum(row["passed"] for row in counts)
