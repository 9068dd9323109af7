"""Log files: round trips, merging, resampling that keeps integrals, and refusals that say where."""

from __future__ import annotations

import hashlib
import re
import warnings
from contextlib import suppress

import mcap_ros2.writer
import numpy as np
import pytest

from dashpot.errors import InputError, InputWarning
from dashpot.logs import Topics, read_log, write_log
from dashpot.logs.log import Log, Segment
from dashpot.logs.mcapwriter import NANO
from dashpot.logs.messages import JOINT_STATE, JOINT_STATE_DEFINITION

H = 0.002
USUAL = Topics()


def example(ticks=400, joints=("joint1", "wrist / [1]"), **without):
    """A log of smooth motion and of torques that are different numbers everywhere."""
    rng = np.random.default_rng(1)
    time = H * np.arange(ticks)
    phase = np.arange(len(joints))
    q = np.sin(2 * time[:, None] + phase)
    arrays = {"position": q, "velocity": 2 * np.cos(2 * time[:, None] + phase), "link_position": q - 1e-3}
    arrays |= without
    noise = rng.normal(size=(2, ticks, len(joints)))
    return Log(tuple(joints), H, (Segment(time, *noise, **arrays),), "point")


def same(one, other, tolerance=0.0):
    assert one.joints == other.joints
    assert one.period == pytest.approx(other.period, rel=1e-9)
    for a, b in zip(one.segments, other.segments, strict=True):
        for name in ("command", "torque", "position", "velocity", "link_position"):
            x, y = getattr(a, name), getattr(b, name)
            assert (x is None) == (y is None)
            if x is not None:
                np.testing.assert_allclose(x, y, atol=tolerance, rtol=0)
        np.testing.assert_allclose(a.time, b.time, atol=1e-9)


def quiet(path, **options):
    """Reads a log that must not give a warning, but for the sampling that CSV cannot state."""
    return read_log(path, sampling=options.pop("sampling", "point"), **options)


def csv(path, time, columns, separator=","):
    names = separator.join(["time", *columns])
    rows = [
        separator.join("" if isinstance(x, float) and np.isnan(x) else repr(x) for x in row)
        for row in zip(
            *[
                list(map(lambda x: x if isinstance(x, int | str) else float(x), c))
                for c in (time, *columns.values())
            ],
            strict=True,
        )
    ]
    path.write_text("\n".join([names, *rows]) + "\n")
    return path


def minimal(n=200, h=0.005):
    t = h * np.arange(n)
    return t, {
        "j/command": np.cos(t),
        "j/effort": np.sin(t),
        "j/position": np.sin(t),
        "j/velocity": np.cos(t),
    }


@pytest.mark.parametrize("suffix", ["csv", "parquet", "mcap"])
def test_every_format_gives_back_the_same_log(tmp_path, suffix):
    log = example()
    path = write_log(log, tmp_path / f"log.{suffix}")
    back = quiet(path)
    same(log, back)
    assert back.digest == hashlib.sha256(path.read_bytes()).hexdigest()
    assert back.file == path
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("suffix", ["parquet", "mcap"])
def test_binary_logs_say_how_torque_was_sampled_and_an_option_overrules(tmp_path, suffix):
    log = example()
    path = write_log(Log(log.joints, H, log.segments, "average"), tmp_path / f"log.{suffix}")
    assert read_log(path).sampling == "average"
    assert read_log(path, sampling="point").sampling == "point"


def test_csv_does_not_say_how_torque_was_sampled(tmp_path):
    path = write_log(example(), tmp_path / "log.csv")
    with pytest.warns(InputWarning, match="does not say how torque is sampled; taken as point"):
        assert read_log(path).sampling == "point"


def test_quantities_that_some_joints_lack(tmp_path):
    log = example()
    link = log.segments[0].link_position.copy()
    link[:, 0] = np.nan
    log = example(link_position=link)
    for suffix in ("csv", "mcap"):
        back = quiet(write_log(log, tmp_path / f"log.{suffix}"))
        assert back.only("joint1").segments[0].link_position is None
        np.testing.assert_array_equal(back.only("wrist / [1]").segments[0].link_position, link[:, 1:])
    log = example(velocity=None, link_position=None)
    assert quiet(write_log(log, tmp_path / "less.parquet")).segments[0].velocity is None


def test_plotjuggler_names_separators_and_its_empty_cells(tmp_path):
    """Topics with stamps of their own share a file: a cell is empty where the other topic has its row."""
    t, given = minimal(300)
    late = t + 0.001
    rows = sorted(
        [(x, "state", i) for i, x in enumerate(t)] + [(x, "command", i) for i, x in enumerate(late)]
    )
    path = tmp_path / "export.csv"
    lines = ["__time;/joint_states/arm/j1/position;/joint_states/arm/j1/effort;/joint_command/arm/j1/effort"]
    for x, kind, i in rows:
        if kind == "state":
            lines.append(f"{x:.17g};{given['j/position'][i]:.17g};{given['j/effort'][i]:.17g};")
        else:
            lines.append(f"{x:.17g};;;{given['j/command'][i]:.17g}")
    path.write_text("\n".join(lines) + "\n")
    log = quiet(path)
    assert log.joints == ("arm/j1",)
    assert log.period == pytest.approx(0.005)
    segment = log.segments[0]
    # Over [t, t + h) the old command holds for 1 ms, the new one for 4 ms.
    k = np.rint(segment.time / 0.005).astype(int)
    inside = slice(5, -5)
    expected = (0.001 * given["j/command"][k - 1] + 0.004 * given["j/command"][k]) / 0.005
    np.testing.assert_allclose(segment.command[inside, 0], expected[inside], atol=1e-9)
    np.testing.assert_array_equal(segment.torque[:, 0], given["j/effort"][k])


@pytest.mark.parametrize(
    ("scale", "origin"), [(1e9, 0), (1e6, 0), (1e9, 1_700_000_000 * 10**9), (1e6, 1_700_000_000 * 10**6)]
)
def test_nano_and_microseconds_are_recognised(tmp_path, scale, origin):
    t, columns = minimal()
    stamps = [origin + round(x * scale) for x in t]
    log = quiet(csv(tmp_path / "log.csv", stamps, columns))
    assert log.period == pytest.approx(0.005, rel=1e-6)
    assert len(log.segments[0].time) == 200


def test_milliseconds_are_refused_not_guessed(tmp_path):
    t, columns = minimal()
    path = csv(tmp_path / "log.csv", t * 1000, columns)
    with pytest.raises(InputError, match=r"time \[s\]: steps by 5: seconds or milliseconds\? give it in s"):
        quiet(path)


def test_jitter_keeps_the_integral_of_the_command_and_the_shape_of_measurements(tmp_path):
    rng = np.random.default_rng(2)
    t, _ = minimal(2000, 0.005)
    stamps = t + rng.uniform(-0.0006, 0.0006, len(t))
    command = rng.normal(size=len(t))
    columns = {
        "j/command": command,
        "j/effort": np.sin(3 * stamps),
        "j/position": np.sin(stamps),
        "j/velocity": np.cos(stamps),
    }
    path = csv(tmp_path / "log.csv", stamps, columns)
    with pytest.warns(InputWarning, match=r"stamps jitter by \d+ % of a period"):
        log = quiet(path)
    segment = log.segments[0]
    assert len(log.segments) == 1
    np.testing.assert_allclose(np.diff(segment.time), log.period, rtol=1e-9)
    np.testing.assert_allclose(segment.torque[:, 0], np.sin(3 * segment.time), atol=2e-4)
    # Each held command counts for as long as it was in effect.
    inner = segment.time[-2]
    held = np.diff(np.append(stamps, stamps[-1] + 0.005))
    whole = np.sum(
        command * np.clip(np.minimum(stamps + held, inner) - np.maximum(stamps, segment.time[0]), 0, None)
    )
    assert log.period * segment.command[:-2, 0].sum() == pytest.approx(whole, abs=1e-9)


def test_averages_keep_their_integral_under_jitter(tmp_path):
    """An averaged torque stands for the time since the last stamp."""
    rng = np.random.default_rng(5)
    t, columns = minimal(1000, 0.005)
    stamps = t + rng.uniform(-0.0006, 0.0006, len(t))
    edges = np.insert(stamps, 0, stamps[0] - 0.005)
    columns["j/effort"] = -np.diff(np.cos(20 * edges)) / 20 / np.diff(edges)  # exact means of sin 20 t
    columns["j/position"], columns["j/velocity"] = np.sin(stamps), np.cos(stamps)
    path = csv(tmp_path / "log.csv", stamps, columns)
    with pytest.warns(InputWarning, match="jitter"):
        log = quiet(path, sampling="average")
    g = log.segments[0].time
    exact = (np.cos(20 * (g - log.period)) - np.cos(20 * g)) / 20 / log.period
    np.testing.assert_allclose(log.segments[0].torque[2:-2, 0], exact[2:-2], atol=0.01)
    # What is wrong in one sample is made good by the next: the integral does not drift.
    drift = log.period * np.cumsum(log.segments[0].torque[2:-2, 0] - exact[2:-2])
    assert np.abs(drift).max() < 1e-4


def test_gaps_split_and_a_missing_sample_does_not(tmp_path):
    t, columns = minimal(600)
    keep = np.ones(600, bool)
    keep[100] = False  # one sample
    keep[300:340] = False  # 0.2 s
    path = csv(tmp_path / "log.csv", t[keep], {key: c[keep] for key, c in columns.items()})
    with pytest.warns(InputWarning, match=r"gaps of more than 2.5 periods: 2\.8 of 3 s are used"):
        log = quiet(path)
    assert [len(s.time) for s in log.segments] == [300, 260]
    np.testing.assert_allclose(log.segments[1].time[0], t[340])
    np.testing.assert_allclose(log.segments[0].position[100, 0], np.sin(t[100]), atol=1e-5)


def test_a_run_of_nan_in_one_column_splits_too(tmp_path):
    t, columns = minimal(600)
    columns["j/velocity"][200:260] = np.nan
    path = csv(tmp_path / "log.csv", t, columns)
    with pytest.warns(InputWarning, match="gaps"):
        log = quiet(path)
    assert [len(s.time) for s in log.segments] == [200, 340]
    assert all(np.isfinite(s.velocity).all() for s in log.segments)


def test_repeated_rows_are_left_out_and_contradicting_ones_refused(tmp_path):
    t, columns = minimal(300)
    twice = np.insert(np.arange(300), 50, 49)
    path = csv(tmp_path / "log.csv", t[twice], {key: c[twice] for key, c in columns.items()})
    with pytest.warns(InputWarning, match="1 repeated rows left out, the first at line 52"):
        assert len(quiet(path).segments[0].time) == 300
    values = {key: c[twice].copy() for key, c in columns.items()}
    values["j/effort"][50] += 1
    path = csv(tmp_path / "log.csv", t[twice], values)
    with pytest.raises(InputError, match=r"line 52, time 0.245 s: the same time as the line before"):
        quiet(path)


def test_time_that_goes_back_is_refused_with_its_line(tmp_path):
    t, columns = minimal(300)
    t = t.copy()
    t[120] = t[100]
    with pytest.raises(InputError, match=r"log.csv: line 122, time 0.5 s: goes back from 0.595 s"):
        quiet(csv(tmp_path / "log.csv", t, columns))


def test_irregular_sampling_is_refused(tmp_path):
    _, columns = minimal(400)
    t = np.cumsum(np.random.default_rng(3).exponential(0.005, 400))
    with pytest.raises(InputError, match=r"% of the steps between torque samples are off"):
        quiet(csv(tmp_path / "log.csv", t, columns))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"j/position": 180 / np.pi}, "position looks like degrees beside velocity in rad/s"),
        ({"j/velocity": 180 / np.pi}, "velocity looks like degrees per second"),
        ({"j/velocity": -1}, "opposite signs"),
        ({"j/velocity": 100.0, "j/position": 100.0}, "exceeds two turns"),
        ({"j/velocity": 3.0}, "the rate of position is 0.33"),
        ({"j/effort": 1000.0}, "command and effort differ 0.00"),
    ],
)
def test_units_that_look_wrong_are_said(tmp_path, change, said):
    t, columns = minimal(1200)
    for key, factor in change.items():
        columns[key] = factor * columns[key]
    with pytest.warns(InputWarning, match=said):
        quiet(csv(tmp_path / "log.csv", t, columns))


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("", "is empty"),
        ("\n\n", "line 1: must be a header"),
        ("1,2,3\n4,5,6\n", "line 1: must be a header, .* not numbers"),
        ("time,j/command,j/effort,j/position\n", "has a header but no rows"),
        (
            "time,j/command,j/effort,j/position\n0,1,2,3\n",
            r"joint 'j': has 1 torque sample; 50 are the least",
        ),
        (
            "time,j/command,j/effort,j/position\n0,1,2,3\n0.1,1,x,3\n",
            r"j/effort = 'x': line 3: must be a number",
        ),
        ("time;j/effort\n0;1,5\n", r"line 2: must be a number; decimals take a point"),
        ("time,j/command,j/effort,j/position\n0,1,2\n", "line 2: has 3 cells, the header 4"),
        ("time,j/command,j/effort,j/position\n0,1,inf,3\n", r"joint 'j': effort \[N m\] = inf: line 2"),
        ("time,j/command,j/effort,j/position\n,1,2,3\n", "line 2: every row needs a time"),
        (
            "stamp,j/command\n0,1\n",
            "has no column of time, one of time, __time, timestamp; its columns: 'stamp'",
        ),
        ("time,torque\n0,1\n", "has no column of a joint"),
        ("time,j/effort,j/effort\n0,1,1\n", "there are two columns of effort"),
        ("time,j/effort,j/position\n0,1,1\n", "j: no command"),
        (b"\xff\xfe\x00\x01", r"is not text \(UTF-8\)"),
        (b"time,j/effort\n0,\xff\n", r"is not text \(UTF-8\)"),
    ],
)
def test_a_csv_that_is_no_log_is_refused_in_one_line(write, refused, content, said):
    path = write(content, "log.csv")
    assert re.search(said, refused(quiet, path))


def test_other_files_that_are_no_logs(tmp_path, refused):
    assert "a log ends in .csv, .parquet, .mcap" in refused(read_log, tmp_path / "log.bag")
    assert refused(read_log, tmp_path / "none.csv") == "no such file"
    (tmp_path / "folder.csv").mkdir()
    assert "is a folder" in refused(read_log, tmp_path / "folder.csv")


@pytest.mark.parametrize("suffix", ["parquet", "mcap"])  # of a cut MCAP file, see test_mcap.py
def test_damaged_binary_files_are_refused(tmp_path, refused, suffix):
    whole = write_log(example(100), tmp_path / f"log.{suffix}").read_bytes()
    path = tmp_path / f"cut.{suffix}"
    rng = np.random.default_rng(0)
    for size in (1, 10, len(whole) // 2, len(whole) - 9, len(whole) - 1)[: 2 if suffix == "mcap" else 5]:
        path.write_bytes(whole[:size])
        assert "not a whole" in refused(quiet, path)
    for _ in range(30):  # anything may come back but an error from the depths
        bad = bytearray(whole)
        for place in rng.integers(0, len(bad), 20):
            bad[place] = rng.integers(256)
        path.write_bytes(bytes(bad))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with suppress(InputError):
                quiet(path)


def mcap(path, messages, kind=JOINT_STATE, definition=JOINT_STATE_DEFINITION):
    """Writes messages: (topic, stamp [ns], fields)."""
    with path.open("wb") as stream:
        writer = mcap_ros2.writer.Writer(stream)
        schema = writer.register_msgdef(kind, definition)
        for topic, stamp, fields in messages:
            header = {"stamp": {"sec": stamp // NANO, "nanosec": stamp % NANO}, "frame_id": ""}
            message = {"header": header, "name": [], "position": [], "velocity": [], "effort": []}
            writer.write_message(topic, schema, message | fields, log_time=stamp)
        writer.finish()
    return path


def states(order=lambda i: (0, 1), n=120, start=1_700_000_000 * NANO, topics=USUAL):
    """Messages of two joints, whose order may change from message to message."""
    names = np.array(["a", "b"])
    out = []
    for i in range(n):
        stamp, o = start + i * 5_000_000, list(order(i))
        q = np.array([np.sin(0.005 * i), np.cos(0.005 * i)])
        w = np.array([np.cos(0.005 * i), -np.sin(0.005 * i)])
        u = np.array([i, -i], float)
        out.append(
            (
                topics.states,
                stamp,
                {
                    "name": list(names[o]),
                    "position": list(q[o]),
                    "velocity": list(w[o]),
                    "effort": list(u[o] + 0.5),
                },
            )
        )
        out.append((topics.commands, stamp, {"name": list(names[o]), "effort": list(u[o])}))
    return out


def test_mcap_joints_may_change_their_order_and_topics_their_names(tmp_path):
    straight = quiet(mcap(tmp_path / "a.mcap", states()))
    mixed = quiet(mcap(tmp_path / "b.mcap", states(lambda i: (1, 0) if i % 3 == 1 else (0, 1))))
    same(straight, mixed)
    np.testing.assert_array_equal(straight.segments[0].command[:, 1], -np.arange(120.0))
    assert straight.segments[0].time[0] == pytest.approx(0, abs=1e-9)
    topics = Topics("/left/states", "/left/cmd", "/left/link")
    renamed = mcap(tmp_path / "c.mcap", states(topics=topics))
    same(straight, quiet(renamed, topics=topics))
    with pytest.raises(InputError, match=r"has no topic /joint_states; its topics: /left/cmd, /left/states"):
        quiet(renamed)


def test_mcap_messages_without_arrays_joints_or_the_right_type(tmp_path, refused):
    full = states()
    full[60][2]["velocity"] = []  # one message without: a missing sample
    log = quiet(mcap(tmp_path / "log.mcap", full))
    np.testing.assert_allclose(log.segments[0].velocity[30, 0], np.cos(0.15), atol=1e-4)
    full[60][2]["velocity"] = [1.0]
    path = mcap(tmp_path / "log.mcap", full)
    assert "velocity: message 31 of /joint_states: has 2 names but 1 values" in refused(quiet, path)
    path = mcap(tmp_path / "log.mcap", [(t, s, f | {"name": ["a", "a"]}) for t, s, f in states()])
    assert "message 1 of /joint_states: a joint is named twice" in refused(quiet, path)
    path = mcap(tmp_path / "log.mcap", [m for m in states() if m[0] == "/joint_states"])
    assert "has no topic /joint_command" in refused(quiet, path)
    path = mcap(tmp_path / "log.mcap", [], kind="std_msgs/msg/Header")
    assert "has no topic" in refused(quiet, path)
    other = "float64 data\n"
    with path.open("wb") as stream:
        writer = mcap_ros2.writer.Writer(stream)
        schema = writer.register_msgdef("std_msgs/msg/Float64", other)
        for topic in ("/joint_states", "/joint_command"):
            writer.write_message(topic, schema, {"data": 1.0}, log_time=1)
        writer.finish()
    assert "must carry sensor_msgs/msg/JointState, not std_msgs/msg/Float64" in refused(quiet, path)


def test_clocks_that_do_not_overlap_are_refused(tmp_path, refused):
    messages = [(t, s + (10**12 if t == "/joint_command" else 0), f) for t, s, f in states()]
    assert "are their stamps from one clock?" in refused(quiet, mcap(tmp_path / "log.mcap", messages))


def test_joints_without_command_are_left_out_and_said(tmp_path):
    t, columns = minimal()
    columns |= {"finger/position": columns["j/position"], "finger/effort": columns["j/effort"]}
    path = csv(tmp_path / "log.csv", t, columns)
    with pytest.warns(InputWarning, match="joints left out: finger: no command"):
        assert quiet(path).joints == ("j",)


def test_slow_positions_are_left_out_not_made_up(tmp_path):
    t, columns = minimal(400)
    columns["j/link_position"] = np.where(np.arange(400) % 10 == 0, columns["j/position"], np.nan)
    with pytest.warns(
        InputWarning, match="link_position comes every 0.05 s, the torque every 0.005 s: left out"
    ):
        log = quiet(csv(tmp_path / "log.csv", t, columns))
    assert log.segments[0].link_position is None


@pytest.mark.parametrize(("suffix", "package"), [("parquet", "pyarrow"), ("mcap", "zstandard")])
def test_missing_packages_are_named(tmp_path, monkeypatch, suffix, package):
    path = tmp_path / f"log.{suffix}"
    path.write_bytes(b"x")
    monkeypatch.setitem(__import__("sys").modules, package, None)
    with pytest.raises(Exception, match=r"-m pip install .*\[logs\]'$"):
        read_log(path)
