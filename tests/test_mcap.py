"""MCAP logs: what independent readers make of them, kills, cuts and damage, and other people's files."""

from __future__ import annotations

import io
import os
import signal
import struct
import subprocess
import sys
import time
import warnings
from contextlib import suppress
from pathlib import Path

import mcap.reader
import mcap.stream_reader
import mcap.writer
import mcap_ros2.decoder
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.exceptions import EndOfFile
from mcap.records import Message
from rosbags.highlevel import AnyReader

from dashpot.errors import InputError, InputWarning
from dashpot.logs import read_log
from dashpot.logs.cdr import joint_message
from dashpot.logs.mcapreader import scan
from dashpot.logs.mcapwriter import INTERVAL, McapWriter
from dashpot.logs.messages import (
    COLUMNS,
    JOINT_STATE,
    JOINT_STATE_DEFINITION,
    SCALARS,
    TOPICS,
)
from dashpot.logs.samples import read_samples

MS = 1_000_000
SMALL = ("supervisor", "mode", "status")  # uint8
NAMES = st.lists(
    st.text(st.characters(exclude_categories=("Cs",), exclude_characters="\0"), min_size=1, max_size=12),
    min_size=1,
    max_size=5,
    unique=True,
)


def columns_of(names, t, n, seed=0):
    """Any doubles, NaN and infinities included, and any uint8."""
    rng = np.random.default_rng(seed)
    found = {}
    for name in names:
        shape = (t,) if name in SCALARS else (t, n)
        if name in SMALL:
            found[name] = rng.integers(0, 256, shape)
        else:
            found[name] = rng.integers(0, 2**64, shape, np.uint64).view(float)
    return found


def same_bits(a, b):
    assert np.asarray(a, float).tobytes() == np.asarray(b, float).tobytes()


def expected(columns, joints):
    """Topic -> fields -> rows, and names."""
    for topic in TOPICS:
        fields = {f.name: columns[f.column] for f in topic.fields if f.column in columns}
        if fields:
            yield topic, fields, list(joints)


def check_against(columns, joints, stamps, decoded):
    """`decoded`: topic -> [(log time, message)], by whatever reader."""
    assert set(decoded) == {topic.name for topic, _, _ in expected(columns, joints)}
    for topic, fields, names in expected(columns, joints):
        rows = decoded[topic.name]
        assert len(rows) == len(stamps)
        for i, (logged, message) in enumerate(rows):
            assert logged == stamps[i]
            assert (message.header.stamp.sec, message.header.stamp.nanosec) == divmod(int(stamps[i]), 10**9)
            assert list(message.name) == names
            for item in topic.fields:
                value = getattr(message, item.name)
                if item.name not in fields:
                    assert item.scalar or len(value) == 0
                else:
                    same_bits(list(value) if isinstance(value, bytes) else value, fields[item.name][i])


def by_rosbags(path):
    found = {}
    with AnyReader([path]) as reader:
        for connection, logged, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            found.setdefault(connection.topic, []).append((logged, message))
    return found


def by_mcap(path):
    found = {}
    with path.open("rb") as stream:
        factories = [mcap_ros2.decoder.DecoderFactory()]
        reader = mcap.reader.make_reader(stream, validate_crcs=True, decoder_factories=factories)
        for _, channel, message, decoded in reader.iter_decoded_messages():
            found.setdefault(channel.topic, []).append((message.log_time, decoded))
    return found


def streamed(data):
    """Log times on /joint_states that the official stream reader gets out of a file that may be cut."""
    times, channels = [], {}
    try:
        for record in mcap.stream_reader.StreamReader(io.BytesIO(data)).records:
            if hasattr(record, "topic"):
                channels[record.id] = record.topic
            elif isinstance(record, Message) and channels[record.channel_id] == "/joint_states":
                times.append(record.log_time)
    except Exception:  # whatever it raises at the end of what is there
        pass
    return times


@settings(max_examples=12, deadline=None)
@given(
    NAMES,
    st.lists(st.sampled_from(COLUMNS), min_size=1, max_size=8, unique=True),
    st.lists(st.integers(0, 9), min_size=1, max_size=4),
    st.integers(0, 2**31 * 10**9 - 10**9),
    st.integers(0, 2**32 - 1),
)
def test_independent_readers_decode_every_bit(tmp_path_factory, joints, names, blocks, begin, seed):
    path = tmp_path_factory.mktemp("log") / "log.mcap"
    t = sum(blocks)
    stamps = begin + 7 * MS * np.arange(t)
    columns = columns_of(names, t, len(joints), seed)
    with McapWriter(path, joints, period=7e-3) as writer:
        at = 0
        for size in blocks:
            part = slice(at, at + size)
            writer.write(stamps[part], {name: values[part] for name, values in columns.items()})
            if seed % 2:
                writer.flush()
            at += size
    if t == 0:
        return
    check_against(columns, joints, stamps, by_mcap(path))
    check_against(columns, joints, stamps, by_rosbags(path))


def test_the_index_says_what_is_there(tmp_path):
    """Statistics, chunk and message indexes: a reader that seeks finds exactly a window's messages."""
    path = tmp_path / "log.mcap"
    stamps = MS * np.arange(600)
    columns = columns_of(("torque", "command"), 600, 2)
    with McapWriter(path, ("a", "b"), period=1e-3, metadata={"sampling": "average"}) as writer:
        for start in range(0, 600, 100):
            part = slice(start, start + 100)
            writer.write(stamps[part], {name: values[part] for name, values in columns.items()})
            writer.flush()
        writer.message(5 * MS, "warning", "joint a: übel")
    with path.open("rb") as stream:
        reader = mcap.reader.make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert (summary.statistics.message_count, summary.statistics.chunk_count) == (1201, 7)
        assert (summary.statistics.message_start_time, summary.statistics.message_end_time) == (0, 599 * MS)
        window = reader.iter_messages(["/joint_states"], starting_at=250 * MS, ending_before=260 * MS)
        assert [m.log_time for _, _, m in window] == [MS * i for i in range(250, 260)]
        (metadata,) = reader.iter_metadata()
        assert metadata.metadata == {"period": "0.001", "sampling": "average"}
    (log,) = by_rosbags(path)["/rosout"]
    assert (log[1].level, log[1].name, log[1].msg) == (30, "dashpot", "joint a: übel")
    (one,) = read_samples(path).happenings
    assert (one.time, one.level, one.text) == (0.005, "warning", "joint a: übel")


CHILD = """
import sys, time, numpy as np
from dashpot.logs.mcapwriter import McapWriter
log = McapWriter(sys.argv[1], ["a", "b"], period=1e-3)
for start in range(0, 10**9, 50):
    n = np.arange(start, start + 50)
    value = np.stack([n, -n], 1) * 1.0
    log.write(n * 1_000_000, {"torque": value, "position": value, "command": value})
    print(start + 49, flush=True)
    if start == int(sys.argv[2]):
        time.sleep(60)
    time.sleep(0.05)
"""


@pytest.mark.parametrize("last", [250, 10**9], ids=["idle", "busy"])
def test_what_is_a_second_old_survives_a_kill(tmp_path, last):
    """kill -9 of a process that writes in real time, and of one that has stopped writing without a flush."""
    path = tmp_path / "log.mcap"
    child = subprocess.Popen(
        [sys.executable, "-c", CHILD, str(path), str(last)], stdout=subprocess.PIPE, text=True
    )
    try:
        written = []
        assert child.stdout is not None
        for line in child.stdout:
            written.append((time.monotonic(), int(line)))
            if written[-1][1] >= min(last, 1300) + 49:
                break
        if last == 250:
            time.sleep(1.0)
        killed = time.monotonic()
    finally:
        child.send_signal(signal.SIGKILL)
        child.wait()
        child.stdout.close()
    due = max(tick for at, tick in written if at <= killed - 1.0)
    with pytest.warns(InputWarning, match="was cut off"):
        torque = read_samples(path).series["torque"]
    ticks = np.arange(len(torque.time))
    assert len(ticks) > due
    np.testing.assert_array_equal(torque.values, np.stack([ticks, -ticks], 1))
    np.testing.assert_allclose(torque.time, ticks * 1e-3, atol=1e-12)
    assert streamed(path.read_bytes()) == (ticks * MS).tolist()
    with pytest.warns(InputWarning):
        assert len(read_log(path, sampling="point").segments[0].time) == len(ticks)


def chunked(path, chunks=4, rows=3):
    """A small file of several chunks: its bytes, and how many samples are whole at each length."""
    with McapWriter(path, ("a",), period=1e-3) as writer:
        ends = [(0, 0)]
        for i in range(chunks):
            value = np.arange(rows)[:, None] * 1.0 + i
            writer.write(MS * (i * rows + np.arange(rows)), {"torque": value, "position": value})
            writer.flush()
            with path.open("rb") as stream, suppress(EndOfFile, struct.error):
                for record in mcap.stream_reader.StreamReader(stream, emit_chunks=True).records:
                    if type(record).__name__ == "Chunk":
                        end = stream.tell()
            ends.append((end, (i + 1) * rows))
    data = path.read_bytes()
    return data, lambda size: max(samples for end, samples in ends if end <= size)


def test_a_file_cut_at_any_byte_gives_every_whole_chunk(tmp_path):
    data, whole = chunked(tmp_path / "whole.mcap")
    path = tmp_path / "cut.mcap"
    most = 0
    path.write_bytes(data)
    for size in range(len(data) - 1, 0, -1):
        os.truncate(path, size)
        content = None
        with suppress(InputError):
            content = scan(path)
        if content is None:
            assert whole(size) == 0
            continue
        found = content.topics.get("/joint_states")
        times = found.logged if found else []
        assert times == [MS * i for i in range(whole(size))]
        most = max(most, len(times))
        if size % 7 == 0:
            assert times == streamed(data[:size])
    assert most == 12


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_reading_a_damaged_file_ends_in_one_line_or_in_samples(tmp_path_factory, data):
    folder = tmp_path_factory.getbasetemp() / "damage"
    folder.mkdir(exist_ok=True)
    whole, _ = chunked(folder / "whole.mcap")
    bad = bytearray(whole)
    for _ in range(data.draw(st.integers(1, 8))):
        bad[data.draw(st.integers(0, len(bad) - 1))] = data.draw(st.integers(0, 255))
    path = folder / "bad.mcap"
    path.write_bytes(bad[: data.draw(st.integers(1, len(bad)))])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with suppress(InputError):
            assert read_samples(path).series


def test_a_damaged_chunk_is_left_out_and_said(tmp_path):
    path = tmp_path / "log.mcap"
    data, _ = chunked(path)
    with path.open("rb") as stream:
        index = mcap.reader.make_reader(stream).get_summary().chunk_indexes[1]
    bad = bytearray(data)
    bad[index.chunk_start_offset + 60] ^= 0xFF
    path.write_bytes(bad)
    with pytest.warns(InputWarning, match="1 damaged records left out"):
        torque = read_samples(path).series["torque"]
    np.testing.assert_array_equal(np.rint(torque.time * 1e3), [0, 1, 2, 6, 7, 8, 9, 10, 11])


@pytest.mark.parametrize("compression", list(mcap.writer.CompressionType))
@pytest.mark.parametrize("chunks", [True, False])
def test_files_of_other_writers(tmp_path, compression, chunks):
    """Any compression, no chunks, joints in changing order, arrays left empty, and topics we do not know."""
    path = tmp_path / "other.mcap"
    topic = TOPICS[0]
    rng = np.random.default_rng(3)
    values = rng.normal(size=(90, 2))
    with path.open("wb") as stream:
        writer = mcap.writer.Writer(stream, compression=compression, use_chunking=chunks, chunk_size=2000)
        writer.start("ros2", "another")
        schema = writer.register_schema(JOINT_STATE, "ros2msg", JOINT_STATE_DEFINITION.encode())
        channel = writer.register_channel("/arm/states", "cdr", schema)
        other = writer.register_channel("/other", "json", 0)
        for i in range(90):
            flip = i % 3 == 1
            names = ("b", "a") if flip else ("a", "b")
            cdr = joint_message(topic, names, ("torque",))
            raw = bytearray(cdr.data)
            raw[4:12] = np.array([1_700_000_000, i * MS], "<u4").tobytes()
            _, offset = cdr.gaps["torque"]
            raw[offset : offset + 16] = values[i, :: -1 if flip else 1].tobytes()
            writer.add_message(channel, i, bytes(raw), i)
            writer.add_message(other, i, b"{}", i)
        writer.finish()
    from dashpot.logs import Topics

    samples = read_samples(path, Topics(states="/arm/states"))
    assert (samples.joints, set(samples.series)) == (("a", "b"), {"torque"})
    same_bits(samples.series["torque"].values, values)
    np.testing.assert_allclose(samples.series["torque"].time, 1e-3 * np.arange(90), atol=1e-12)
    with pytest.raises(
        InputError, match=r"no joint states on /joint_states; its topics: /arm/states, /other"
    ):
        read_samples(path)


def writer_at(path, **options):
    return McapWriter(path, ("a", "b"), period=1e-3, **options)


def test_what_does_not_fit_is_refused_and_the_log_goes_on(tmp_path):
    path = tmp_path / "log.mcap"
    one, stamps = np.ones((3, 2)), MS * np.arange(3)
    with writer_at(path) as log:
        for bad, said in (
            ({"torqe": one}, "must be among position, velocity, torque"),
            ({}, "column = 'none': must be among"),
            ({"torque": one[:, :1]}, r"torque.shape = \(3, 1\): must have shape \(3, 2\)"),
        ):
            with pytest.raises(InputError, match=said):
                log.write(stamps, bad)
        log.write(stamps, {"torque": one})
        with pytest.raises(InputError, match="must be those of the first call: torque"):
            log.write(stamps, {"torque": one, "command": one})
        with pytest.raises(InputError, match=r"time_ns \[ns\] = -1: must be 0 to 2\^31 s"):
            log.write(stamps - 1, {"torque": one})
        with pytest.raises(InputError, match="must be one of info, warning, error"):
            log.message(0, "loud", "x")  # type: ignore[arg-type]
        log.write(stamps + 3 * MS, {"torque": one})
    assert len(by_rosbags(path)["/joint_states"]) == 6
    with pytest.raises(InputError, match="is closed"):
        log.write(stamps, {"torque": one})
    log.close()


def test_places_that_cannot_be_written(tmp_path):
    with pytest.raises(InputError, match="cannot be written: Is a directory"):
        writer_at(tmp_path)
    with pytest.raises(InputError, match="must be names, each once"):
        McapWriter(tmp_path / "x.mcap", ("a", "a"), period=1e-3)
    assert not (tmp_path / "x.mcap").exists()
    if Path("/dev/full").exists():
        with pytest.raises(InputError, match="cannot be written: No space left on device"):
            writer_at("/dev/full")


def test_a_disk_that_fills_up_is_said_by_the_next_call(tmp_path, monkeypatch):
    log = writer_at(tmp_path / "log.mcap")
    full = Path("/dev/full")
    if not full.exists():
        pytest.skip("there is no /dev/full to fill up")
    with full.open("wb", buffering=0) as disk:
        log.write(MS * np.arange(3), {"torque": np.ones((3, 2))})
        with log._lock:
            log._file._file.close()
            monkeypatch.setattr(log._file, "_file", disk)
        log.write(MS * np.arange(3, 6), {"torque": np.ones((3, 2))})
        time.sleep(2 * INTERVAL)
        with pytest.raises(OSError, match="No space left"):
            log.write(MS * np.arange(3), {"torque": np.ones((3, 2))})
        with pytest.raises(OSError, match="No space left"):
            log.close()
