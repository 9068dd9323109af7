"""The tuning of rivals: one budget, one motion, one rule."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dashpot.control.laws import LAWS
from dashpot.control.rivals.tracking import PD, PDScaled
from dashpot.simulation.simulate import run
from dashpot.studies import rivals_tuning as study

PD_ENTRY = next(entry for entry in study.ENTRIES if entry.law == "pd")


def test_every_law_takes_part_within_its_range():
    assert {entry.law for entry in study.ENTRIES} == set(LAWS)
    for entry in study.ENTRIES:
        for share in (0.0, 0.37, 1.0):
            law = entry.at(np.full(len(entry.tuned), share))
            assert law.law == entry.law
            assert entry.brake == law.brake or entry.law == "virtual_passive"


def test_brakes_do_not_differ_before_the_encoder_is_lost():
    before = {}
    for entry in study.ENTRIES:
        if entry.brake and entry.law in ("virtual_passive", "off", "encoder_damping"):
            law = entry.at(np.full(len(entry.tuned), 0.5))
            found = run(study.scenarios(entry, law)[2])
            before[entry.law] = found.link_position[found.time < study.RUN_UP - 1e-9, 0]
    one = before.pop("off")
    assert np.ptp(one) > 0.1
    for other in before.values():
        np.testing.assert_array_equal(one, other)


def test_the_same_controller_under_two_names_is_judged_alike():
    scaled = next(entry for entry in study.ENTRIES if entry.law == "pd_scaled")
    one = study.judge(PD_ENTRY, [PD("joint", kp=2000.0, kd=60.0)])
    assert study.judge(scaled, [PDScaled("joint", R=8.0, kp=250.0, kd=7.5)]) == one
    assert one[0].value == max(one[0].parts.values()) < study.BROKEN
    assert one[0].parts["none"] < one[0].parts["half"] < one[0].parts["largest"]
    # At rest the load over kp is missing; the motion's error comes on top.
    assert one[0].parts["largest"] > study.BENCH.load / 2000


def test_a_set_beyond_a_limit_ranks_behind_all_within():
    weak, loud = study.judge(PD_ENTRY, [PD("joint", kp=300.0, kd=20.0), PD("joint", kp=300.0, kd=0.0)])
    assert weak.value < study.BROKEN
    assert loud.damping < study.DAMPING
    assert loud.value >= study.BROKEN


def test_tuning_is_replayed_by_its_seed_and_spends_its_budget(monkeypatch):
    spent = []
    judge = study.judge

    def counting(entry, laws, *on):
        spent.append(len(laws))
        return judge(entry, laws, *on)

    monkeypatch.setattr(study, "judge", counting)
    monkeypatch.setattr(study, "PAYLOADS", {"half": 0.5})
    first = study.tune(PD_ENTRY, 10, 3)
    assert sum(spent) == 10
    again = study.tune(PD_ENTRY, 10, 3)
    assert first == again
    assert first[1].value == pytest.approx(judge(PD_ENTRY, [first[0]])[0].value)
    assert study.tune(PD_ENTRY, 10, 4)[0] != first[0]
    alone = study.tune(replace(PD_ENTRY, tuned={}, fixed={"kp": 300.0, "kd": 20.0}), 10, 3)
    assert alone[0] == PD("joint", kp=300.0, kd=20.0)
