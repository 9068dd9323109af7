"""On a terminal: something moves while a command works; on a pipe: nothing but results."""

from __future__ import annotations

import os
import pty
import re
import subprocess
import sys

import numpy as np
import pytest

from dashpot import Controller, Robot, Scenario, build, load_controller, multisine, run
from dashpot.cli.overview import STAGES
from dashpot.simulation.trace import run_traced

COLOURS = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")


def on_terminal(code, cwd, columns=80):
    """What a Python program shows on a terminal of its own, and its exit status."""
    ours, theirs = pty.openpty()
    env = {**os.environ, "TERM": "xterm-256color", "COLUMNS": str(columns)}
    process = subprocess.Popen(
        [sys.executable, "-c", code], stdin=theirs, stdout=theirs, stderr=theirs, cwd=cwd, env=env
    )
    os.close(theirs)
    shown = b""
    while True:
        try:
            part = os.read(ours, 65536)
        except OSError:  # Linux: the other side is closed
            break
        if not part:
            break
        shown += part
    os.close(ours)
    return shown.decode(), process.wait()


def command(*arguments):
    return f"from dashpot.cli import main; main({[str(argument) for argument in arguments]!r})"


def test_a_wait_is_said_and_leaves_the_line_empty(tmp_path):
    code = (
        "import time, sys\nfrom dashpot.support.waiting import waiting, above\n"
        "with waiting('drawing'):\n    time.sleep(0.9)\n"
        "    with above():\n        print('warned', file=sys.stderr)\n    time.sleep(0.3)\n"
        "print('result')\n"
        "with waiting('shortly'):\n    pass\n"
        "with waiting('listening', still=True):\n    pass\n"
    )
    shown, status = on_terminal(code, tmp_path)
    assert status == 0
    lines = shown.split("\r\n")
    assert [line.rpartition("\x1b[2K")[2] for line in lines] == ["warned", "result", ""]
    assert len(set(re.findall("(.) drawing", shown))) > 2  # it turns
    assert "shortly" not in shown
    assert shown.count("listening") == 1


def test_a_pipe_and_a_dumb_terminal_show_no_wait(tmp_path):
    code = "import time\nfrom dashpot.support.waiting import waiting\nwith waiting('a'):\n    time.sleep(0.7)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)
    assert (done.stdout, done.stderr) == (b"", b"")
    assert on_terminal("import os; os.environ['TERM'] = 'dumb'\n" + code, tmp_path) == ("", 0)


def test_a_simulation_shows_how_far_it_has_come(tmp_path):
    shown, status = on_terminal(command("simulate", "k807", "k807-wrist", "--duration", 20), tmp_path)
    assert status == 0
    times = [float(found) for found in re.findall(r"([\d.]+) of 21 s", COLOURS.sub("", shown))]
    assert times == sorted(times)
    assert times[-1] > 0
    result = shown.rpartition("\x1b[2K")[2]
    assert COLOURS.sub("", result).splitlines()[0].startswith("k807 under k807-wrist")


def test_words_about_progress_change_no_bit():
    robot, config = Robot.load("k807"), load_controller("k807-wrist")
    path = multisine(robot.home, 1.5, config.period, 3)
    scenario = Scenario(build(robot, config.period), Controller.from_config(config, robot.drives), path)
    plain, told = run(scenario), []
    again, traced = run(scenario, told.append), run_traced(scenario, told.append)[0]
    np.testing.assert_array_equal(plain.sample, again.sample)
    np.testing.assert_array_equal(plain.sample, traced.sample)
    assert max(told) == pytest.approx(len(plain.time) * config.period)


def test_headings_are_bold_on_a_terminal_and_the_page_is_the_same(tmp_path):
    shown, _ = on_terminal(command("--help"), tmp_path)
    for heading in (*STAGES, "To begin with"):
        assert f"\x1b[1m{heading}\x1b[0m\r\n" in shown
    words = [sys.executable, "-c", command("--help")]
    environment = {**os.environ, "COLUMNS": "80"}
    done = subprocess.run(words, capture_output=True, text=True, env=environment)
    assert COLOURS.sub("", shown).replace("\r\n", "\n") == done.stdout


@pytest.mark.parametrize(
    ("typed", "said"),
    [("doctor", "dashpot works here"), ("export k807 k807-wrist --to c", "not certified")],
)
def test_a_last_word_has_one_style(tmp_path, typed, said):
    shown, status = on_terminal(command(*typed.split()), tmp_path)
    assert f"\x1b[1;{31 if status else 32}m{said}\x1b[0m" in shown
