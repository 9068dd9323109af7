"""Exported controllers on an emulated Cortex-M7: equal to Python to the bit; the published figures hold."""

import json
from pathlib import Path

import numpy as np
import pytest

from dashpot.studies import cortex
from dashpot.studies.export import cases
from dashpot.studies.export_cases import bundled, differing, in_python, script

DOCS = Path(__file__).parent.parent / "docs"
EVIDENCE = json.loads((DOCS / "evidence" / "export.json").read_text())["cases"]
emulated = pytest.mark.skipif(bool(cortex.available()), reason=cortex.available())


def evidence(export):
    return next(
        row
        for row in EVIDENCE
        if (row["controller"], row["latency"], row["supervised"])
        == (export.name, export.config.latency, export.settings is not None)
    )


@emulated
@pytest.mark.parametrize("supervised", [False, True])
def test_equal_on_a_cortex_m7(supervised, tmp_path):
    """Other compiler, other processor, same bits; sizes and instructions are those of the evidence."""
    export = bundled("fr3", "fr3", supervised=supervised)
    n = len(export.blocks)
    image = cortex.build(export, tmp_path)
    board = cortex.Board(image)
    assert board.call("start") == 0
    rows = script(export, 1_000, seed=0)
    assert differing(board.run(rows, n), in_python(export, rows)) == 0
    size, said = cortex.size(tmp_path, export), evidence(export)["cortex_m7"]
    assert size.variables == 0 == said["variable_bytes"]
    # another version of the compiler may choose a little differently
    assert size.code == pytest.approx(said["code_bytes"], rel=0.15)
    assert size.constants == pytest.approx(said["constant_bytes"], rel=0.15)
    counts = cortex.instructions(image, script(export, 5_000, seed=0)[:10], n)
    assert said["instructions"]["least"] * 0.85 <= min(counts)
    assert max(counts) <= said["instructions"]["most"] * 1.15


@emulated
def test_contraction_is_kept_out_on_the_target(tmp_path):
    """clang fuses by default; the pragma keeps it out; =fast overrules it, and the check says so."""
    export = bundled("fr3", "fr3")
    guarded = cortex.Board(cortex.build(export, tmp_path, flags=("-O2", "-ffp-contract=on")))
    assert guarded.call("start") == 0
    overruled = cortex.Board(cortex.build(export, tmp_path, flags=("-O2", "-ffp-contract=fast")))
    assert overruled.call("start") != 0


@pytest.mark.filterwarnings("ignore::dashpot.errors.InputWarning")
def test_the_evidence_is_complete_and_clean():
    assert len(EVIDENCE) == len(cases())
    for export, scripts in cases():
        row = evidence(export)
        assert row["joints"] == len(export.blocks)
        host = row["host"]
        assert host["ticks"] * row["joints"] >= 1_000_000
        assert host["ticks"] >= 50_000 * scripts
        assert (
            host["differing"]
            == host["sanitized_differing"]
            == host["contraction_asked_for"]["differing"]
            == 0
        )
        for target in ("cortex_m7", "cortex_m4f"):
            if target in row:
                assert (row[target]["check"], row[target]["differing"], row[target]["variable_bytes"]) == (
                    0,
                    0,
                    0,
                )
        assert ("cortex_m4f" in row) == (export.name == "fr3")
    assert any(row["host"]["guard_removed"] == "found by the check" for row in EVIDENCE)


def test_scripts_hold_what_can_happen():
    """The scripts that prove equality contain every action and every kind of broken number."""
    for supervised in (False, True):
        rows = script(bundled("fr3", "fr3", supervised=supervised), 20_000, seed=0)
        assert set(rows[:, 0]) == ({0, 1, 2, 3, 4, 5, 7, 8} if supervised else {0, 1, 2, 3, 4, 5, 6})
        inputs = rows[:, 7:56]
        assert np.isnan(inputs).any()
        assert np.isposinf(inputs).any()
        assert np.isneginf(inputs).any()
        assert (np.abs(inputs[np.isfinite(inputs)]) > 1e300).any()
        assert (np.signbit(inputs) & (inputs == 0)).any()
        assert np.array_equal(
            rows, script(bundled("fr3", "fr3", supervised=supervised), 20_000, seed=0), equal_nan=True
        )
