"""CPU time of an MCAP log of seven joints at 1 kHz, all topics."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np
from measure import Rows, interleave

from dashpot.logs.mcapwriter import INTERVAL, McapWriter
from dashpot.logs.messages import COLUMNS, JOINT_STATE, JOINT_STATE_DEFINITION, SCALARS
from dashpot.support.arrays import Floats

JOINTS = [f"fr3_joint{i}" for i in range(1, 8)]
RATE, BLOCK, SECONDS = 1000, 50, 4.0
STATES = ("position", "velocity", "torque")
INTEGERS = ("supervisor", "mode", "status")


def signals() -> tuple[np.ndarray, dict[str, Floats]]:
    """Stamps [ns], and columns as they look on a robot: smooth motion, noisy torque."""
    ticks = round(SECONDS * RATE)
    rng = np.random.default_rng(0)
    stamps = 1_700_000_000_000_000_000 + 1_000_000 * np.arange(ticks)
    phase = 2 * np.pi * np.arange(ticks)[:, None] / RATE * rng.uniform(0.2, 1, len(JOINTS))
    columns = {}
    for i, name in enumerate(COLUMNS):
        if name in INTEGERS:
            columns[name] = np.full(ticks if name in SCALARS else phase.shape, 1 + (name == "mode"))
        else:
            columns[name] = np.sin(phase + i)
            if name in ("torque", "command", "velocity"):
                columns[name] += 0.05 * rng.standard_normal(phase.shape)
    return stamps, columns


def log(rows: Rows) -> None:
    """Writes some seconds of a log, its chunks as often as in real time."""
    stamps, columns = signals()
    every = round(INTERVAL * RATE)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.mcap"

        def write(names: tuple[str, ...]) -> float:
            begin = time.process_time()
            with McapWriter(path, JOINTS, period=1 / RATE) as writer:
                for start in range(0, len(stamps), BLOCK):
                    part = slice(start, start + BLOCK)
                    writer.write(stamps[part], {name: columns[name][part] for name in names})
                    if start % every == 0:
                        writer.flush()
            return (time.process_time() - begin) / SECONDS

        def message_by_message() -> float:
            begin = time.process_time()
            with path.open("wb") as stream:
                writer = mcap_ros2.writer.Writer(stream)
                schema = writer.register_msgdef(JOINT_STATE, JOINT_STATE_DEFINITION)
                for i, stamp in enumerate(stamps.tolist()):
                    header = {"stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9}, "frame_id": ""}
                    position, velocity, effort = (columns[name][i].tolist() for name in STATES)
                    message = {
                        "header": header,
                        "name": JOINTS,
                        "position": position,
                        "velocity": velocity,
                        "effort": effort,
                    }
                    writer.write_message("/joint_states", schema, message, stamp, stamp, i)
                writer.finish()
            return (time.process_time() - begin) / SECONDS

        functions = {"all": lambda: write(COLUMNS), "states": lambda: write(STATES)}
        try:
            import mcap_ros2.writer
        except ImportError:
            pass
        else:
            functions["messages"] = message_by_message
        best = interleave(functions, 2)
        write(COLUMNS)
        size = path.stat().st_size / SECONDS / 1e6
    rows.section("MCAP log of 7 joints at 1 kHz", "CPU time of all threads over time logged")
    note = f"{size:.2g} MB/s"
    rows.add("log_all", f"all {len(COLUMNS)} columns, 6 topics", 100 * best["all"], "%", most=5.0, note=note)
    rows.add("log_states", "/joint_states alone", 100 * best["states"], "%")
    if "messages" in best:
        ratio = float(np.median(best["messages"] / best["states"]))
        rows.add(
            "log_messages",
            "the same by mcap-ros2-support",
            100 * best["messages"],
            "%",
            note=f"({ratio:.3g} x)",
        )
