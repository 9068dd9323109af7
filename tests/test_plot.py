"""``dashpot plot``: what it draws of which file, that nothing is clipped, and its refusals."""

from __future__ import annotations

import matplotlib.image
import matplotlib.pyplot as plt
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dashpot.cli import main
from dashpot.commands.plot_draw import draw_joint, draw_overview, lettered, thin
from dashpot.errors import InputError
from dashpot.logs.mcapwriter import McapWriter
from dashpot.logs.messages import COLUMNS, SCALARS
from dashpot.logs.samples import Happening, Samples, Series, read_samples
from dashpot.simulation.recording import CHANNELS, Recording

MS = 1_000_000


def example(path, columns=COLUMNS, joints=("shoulder", "joint $2$_[x]", "j3"), t=400, events=4):
    """A log of smooth signals, in which the supervisor gets worse and messages come in clusters."""
    time = 1e-3 * np.arange(t)
    phase = 9 * time[:, None] + np.arange(len(joints))
    given = {}
    for i, name in enumerate(columns):
        if name in SCALARS:
            given[name] = np.repeat(np.arange(4), -(-t // 4))[:t]
        else:
            given[name] = np.abs(np.sin(phase + i)) if name in ("mode", "status") else np.sin(phase + i)
    with McapWriter(path, joints, period=1e-3) as log:
        log.write(MS * np.arange(t), given)
        for i in range(events):
            words = "shoulder: something that takes many words to say, " * (1 + i % 3)
            log.message((100 + i * i) * MS, ("info", "warning", "error")[i % 3], words)
    return path


def dashpot(capsys, monkeypatch, tmp_path, *words):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as ended:
        main([*map(str, words)])
    out = capsys.readouterr()
    return ended.value.code, out.out, out.err


def test_every_column_of_a_log_of_ours_is_read(tmp_path):
    samples = read_samples(example(tmp_path / "log.mcap"))
    assert set(samples.series) == set(COLUMNS)
    assert samples.span == (0.0, pytest.approx(0.399))
    assert [one.level for one in samples.happenings] == ["info", "warning", "error", "info"]


def test_overview_and_a_picture_per_joint(tmp_path, capsys, monkeypatch):
    example(tmp_path / "log.mcap", joints=("shoulder", "joint $2$_[x]"), t=100)
    status, out, err = dashpot(capsys, monkeypatch, tmp_path, "plot", "log.mcap")
    assert (status, err) == (0, "")
    assert sorted(p.name for p in (tmp_path / "out/plot").glob("*.png")) == [
        "joint_2___x_.png",
        "overview.png",
        "shoulder.png",
    ]
    assert matplotlib.image.imread(tmp_path / "out/plot/overview.png").std() > 0.05
    for said in ("log.mcap: 0 to 0.099 s, 1000 Hz", "What happened", "open out/plot/overview.png"):
        assert said in out


def test_a_log_of_another_robot_needs_joint_states_only(tmp_path, capsys, monkeypatch):
    example(tmp_path / "log.mcap", ("torque",), events=0)
    status, out, err = dashpot(
        capsys, monkeypatch, tmp_path, "plot", "log.mcap", "--joint", "j3", "--window", "0.1", "0.2", "--pdf"
    )
    assert (status, err) == (0, "")
    assert "0.1 to 0.2 s" in out
    assert "shoulder" not in out
    assert {p.name for p in (tmp_path / "out/plot").iterdir()} >= {"j3.png", "j3.pdf", "overview.pdf"}


def test_tables_and_recordings(tmp_path, capsys, monkeypatch):
    t = np.arange(100) * 0.01
    rows = "\n".join(f"{x},{np.sin(x)},,{np.cos(x)}" for x in t)
    (tmp_path / "log.csv").write_text(f"time,a/effort,a/position,b/velocity\n{rows}\n")
    samples = read_samples(tmp_path / "log.csv")
    assert (samples.joints, set(samples.series)) == (("a", "b"), {"torque", "velocity"})
    np.testing.assert_array_equal(samples.series["torque"].values[:, 0], np.sin(t))
    arrays = {name: np.full((100, 2), float(i)) for i, name in enumerate(CHANNELS)}
    decision = {"time": 0.4, "joint": "a", "words": "it lies", "unit": "", "before": "track", "after": "safe"}
    recording = Recording(
        ("a", "b"),
        t - 0.3,
        np.zeros((100, 2)),
        **arrays,
        status=np.zeros(100, np.int32),
        settings={
            "supervisor": {"decisions": [decision]},
            "faults": [{"kind": "brownout", "joint": "all", "start": 0.1}],
        },
    )
    recording.save(tmp_path / "recording.npz")
    samples = read_samples(tmp_path / "recording.npz")
    assert samples.span == pytest.approx((-0.3, 0.69))
    assert [(one.level, one.text) for one in samples.happenings] == [
        ("info", "simulated fault: brownout"),
        ("error", "a: it lies: track -> safe"),
    ]
    status, out, _ = dashpot(capsys, monkeypatch, tmp_path, "plot", "recording.npz")
    assert status == 0
    assert "a: it lies: track -> safe" in out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("none.mcap",), "none.mcap: no such file"),
        (("log.bag",), "a log ends in .csv, .parquet, .mcap, .npz"),
        (("log.mcap", "--joint", "elbow"), "no such joint in the log; it has shoulder, joint $2$_[x], j3"),
        (("log.mcap", "--window", "5", "9"), "must be two times within the log, 0 to 0.399 s"),
        (("log.mcap", "--window", "0.2", "0.1"), "must be two times within the log"),
        (("log.mcap", "--states", "/arm"), "has no joint states on /arm; its topics: /joint_states, /rosout"),
        (("log.mcap", "--out", "."), "holds log.mcap, which is read; choose another folder"),
    ],
)
def test_refusals_are_one_line(tmp_path, capsys, monkeypatch, words, said):
    example(tmp_path / "log.mcap", ("torque",), t=400, events=0)
    status, out, err = dashpot(capsys, monkeypatch, tmp_path, "plot", *words)
    assert (status, out) == (2, "")
    assert said in err
    assert len(err.splitlines()) == 1


def texts(figure):
    """All but the labels of ticks, of which matplotlib keeps some that it does not draw."""
    found = [*figure.texts]
    legends = [*figure.legends, *(axis.get_legend() for axis in figure.axes if axis.get_legend())]
    for legend in legends:
        found += [legend.get_title(), *legend.get_texts()]
    for axis in figure.axes:
        found += [axis.xaxis.label, axis.yaxis.label, axis.title, *axis.texts]
    return [text for text in found if text.get_visible() and text.get_text().strip()]


@pytest.mark.parametrize(("count", "events"), [(1, 0), (7, 4), (12, 30)])
def test_no_text_is_clipped_and_no_legend_covers_another(tmp_path, events, count):
    joints = tuple(f"panda_joint{i + 1}" for i in range(count))
    samples = read_samples(example(tmp_path / "log.mcap", joints=joints, events=events))
    for figure in (draw_overview(samples), draw_joint(samples, joints[-1])):
        figure.canvas.draw()
        renderer = figure.canvas.get_renderer()
        page = figure.bbox.padded(0.5)
        for text in texts(figure):
            box = text.get_window_extent(renderer)
            assert page.x0 <= box.x0 <= box.x1 <= page.x1, text.get_text()
            assert page.y0 <= box.y0 <= box.y1 <= page.y1, text.get_text()
        axes = [axis.get_window_extent(renderer) for axis in figure.axes]
        for legend in figure.legends:
            box = legend.get_window_extent(renderer)
            assert not any(box.overlaps(axis) for axis in axes)
        plt.close(figure)


def test_the_gravest_messages_get_the_letters():
    said = [Happening(float(i), "info", str(i)) for i in range(30)]
    said += [Happening(40.0, "error", "bad"), Happening(35.0, "warning", "odd")]
    kept = lettered(Samples(("a",), {}, tuple(said)))
    assert len(kept) == 16
    assert [event.text for event in kept[-2:]] == ["odd", "bad"]
    assert [event.letter for event in kept] == list("ABCDEFGHIJKLMNOP")


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 3000), st.integers(2, 200), st.integers(0, 2**32 - 1))
def test_thinning_keeps_extremes_order_and_gaps(t, points, seed):
    rng = np.random.default_rng(seed)
    values = rng.normal(size=t)
    values[rng.random(t) < 0.1] = np.nan
    time = np.arange(t) * 0.5
    x, y = thin(time, values, points)
    assert len(x) == len(y) <= 2 * points + 2
    assert (np.diff(x) > 0).all()
    np.testing.assert_array_equal(y, values[(x / 0.5).astype(int)])
    if np.isfinite(values).any():
        assert (np.nanmax(y), np.nanmin(y)) == (np.nanmax(values), np.nanmin(values))


def test_a_window_outside_is_refused_in_any_time(tmp_path):
    samples = Samples(("a",), {"torque": Series(np.arange(3.0), np.zeros((3, 1)))})
    with pytest.raises(InputError, match="must be two times within the log, 0 to 2 s"):
        samples.between(3, 4)
