"""``dashpot doctor`` and the pages that explain the command line."""

import contextlib
import importlib.metadata as metadata
import io
import json
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from dashpot.cli import main
from dashpot.cli.entry import parse
from dashpot.cli.overview import COMMANDS, STAGES, overview
from dashpot.commands.doctor import EXTRAS
from dashpot.support.installing import install


def dashpot(*arguments):
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), pytest.raises(SystemExit) as end:
        main(list(arguments))
    return end.value.code, out.getvalue(), err.getvalue()


def findings():
    status, out, _ = dashpot("doctor", "--json")
    told = json.loads(out)
    return status, told["works"], {(one["part"], one["name"]): one for one in told["findings"]}


def test_an_installation_for_tests_has_everything():
    status, works, found = findings()
    assert (status, works) == (0, True)
    assert found["core", "simulation"]["state"] == found["core", "native library"]["state"] == "ok"
    assert {part for part, _ in found} == {"core", *EXTRAS, "export", "run"}
    needed = {one for one in metadata.requires("dashpot") if "extra ==" not in one}
    assert {re.match(r"[\w-]+", one)[0] for one in needed} <= {name for _, name in found}
    for one in found.values():
        assert bool(one["advice"]) == (one["state"] != "ok")


@pytest.mark.parametrize(
    ("package", "version", "status"),
    [("viser", None, 0), ("zarr", "2.18", 0), ("mujoco", "3.2.0", 1), ("scipy", None, 1)],
)
def test_what_is_missing_or_old_is_said_with_its_use(monkeypatch, package, version, status):
    real = metadata.version

    def other(name):
        if name != package:
            return real(name)
        if version is None:
            raise metadata.PackageNotFoundError(name)
        return version

    monkeypatch.setattr(metadata, "version", other)
    ended, works, found = findings()
    part = next(part for part, name in found if name == package)
    one = found[part, package]
    assert (ended, works) == (status, status == 0)
    assert one["state"] == ("broken" if part == "core" else "missing")
    assert (version or "not installed") in one["found"]
    assert install("" if part == "core" else part) in one["advice"]
    assert (("core", "simulation") in found) == works  # not tried on what cannot work
    text = dashpot("doctor")[1]
    assert one["advice"] in text
    assert ("dashpot works here" in text) == works


def test_the_overview_names_every_command_and_keeps_to_the_terminal(monkeypatch):
    for width in (80, 90, 100):
        monkeypatch.setenv("COLUMNS", str(width))
        page = overview()
        assert max(map(len, page.splitlines())) <= width
        for name in COMMANDS:
            assert len(re.findall(rf"^  {name}  ", page, re.M)) == 1
        assert all(stage in page for stage in STAGES)
    assert dashpot("--help")[:2] == (0, overview() + "\n")
    assert dashpot()[0] == 2
    assert dashpot("--version")[:2] == (0, f"dashpot {metadata.version('dashpot')}\n")


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_shows_an_example_that_can_be_typed(name):
    status, text, _ = dashpot(name, "--help")
    assert status == 0
    example = " ".join(re.search(r"Example: dashpot (.+?)\n\s*\n", text.replace("\\\n", ""), re.S)[1].split())
    typed = shlex.split(example.partition(" > ")[0])
    assert typed[0] == name
    assert isinstance(parse(typed), COMMANDS[name])


def test_a_misspelt_command_is_told_which_was_meant():
    assert "did you mean simulate?" in dashpot("simulat", "fr3")[2]
    assert "dashpot --help lists them" in dashpot("qqq")[2]
    assert dashpot("simulat", "fr3")[0] == 2


def test_completion_is_a_script_for_the_shell():
    status, script, _ = dashpot("completion", "bash")
    assert status == 0
    assert subprocess.run(["bash", "-n"], input=script, text=True).returncode == 0
    assert all(f"{name}" in script for name in COMMANDS)
    assert dashpot("completion", "fish")[2] == "dashpot: error: SHELL = 'fish': must be bash, zsh or tcsh\n"


def test_what_is_missing_is_installed_from_where_dashpot_came(monkeypatch, tmp_path):
    words = shlex.split(install("logs"))
    assert words[:4] == [sys.executable, "-m", "pip", "install"]
    assert words[4:] == ["-e", f"{Path(__file__).parents[1]}[logs]"]
    monkeypatch.setattr(
        "dashpot.support.installing.__file__", str(tmp_path / "dashpot/support/installing.py")
    )
    assert shlex.split(install("logs"))[4:] == [
        "dashpot[logs]"
    ]  # a wheel: what it needs, not another dashpot
