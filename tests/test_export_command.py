"""``dashpot export``: what it writes, what it says, and the programs of docs/export.md."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from dashpot.cli import main
from dashpot.export.compiler import compiler

DOCUMENT = Path(__file__).parent.parent / "docs" / "export.md"
ROBOT = """
name = "bench"
[[joint]]
name = "joint1"
rotor_inertia = 0.05
viscous_friction = 0.6
stiffness = 6e3
damping = 0.7
torque_limit = 40.0
"""
CONTROLLER = """
period = 0.005
[[joint]]
name = "joint1"
R = 3.0
D = 3.0
"""


@pytest.fixture
def files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "100")
    (tmp_path / "robot.toml").write_text(ROBOT)
    (tmp_path / "my brake.toml").write_text(CONTROLLER)
    return tmp_path


def run(capsys, *arguments):
    with pytest.raises(SystemExit) as caught:
        main(["export", *arguments])
    said = capsys.readouterr()
    return caught.value.code, said.out, said.err


@pytest.mark.skipif(compiler() is None, reason="needs a C compiler")
def test_what_is_printed_is_true(files, capsys):
    """The certified pair is there, and the printed command compiles it."""
    code, out, err = run(capsys, "robot.toml", "my brake.toml", "--to", "c", "--supervised")
    assert (code, err) == (0, "")
    assert "\ncertified\n" in out
    assert "no model" in out
    assert len(out.splitlines()) < 14
    command = re.search(r"cc -std=c99 -O2 -c \S+", out)[0]
    subprocess.run(command.replace("cc ", f"{compiler()[0]} ", 1).split(), check=True)
    assert "CERTIFIED" in (files / "out/export/my_brake.h").read_text()


def test_an_uncertified_export_says_so(files, capsys):
    code, out, _ = run(
        capsys, "robot.toml", "my brake.toml", "--to", "fmu", "--without-certificate", "--sources-only"
    )
    assert code == 1
    assert "not certified: no certificate was asked for" in out
    assert "no binary" in out
    assert (files / "out/export/my_brake.fmu").exists()


@pytest.mark.parametrize(
    ("arguments", "rule"),
    [
        (["--to", "c", "--name", "int"], "--name = 'int': already means something in C"),
        (["--to", "c", "--name", "Brake"], "--name = 'Brake': must be 1 to 40 lower-case"),
        (["--to", "c", "--out", "."], "holds robot.toml"),
    ],
)
def test_bad_input_is_one_line(files, capsys, arguments, rule):
    code, out, err = run(capsys, "robot.toml", "my brake.toml", *arguments)
    assert (code, out) == (2, "")
    assert rule in err
    assert len(err.splitlines()) == 1
    assert not (files / "out").exists()


@pytest.mark.skipif(compiler() is None, reason="needs a C compiler")
def test_a_failing_compiler_leaves_nothing(files, capsys, monkeypatch):
    monkeypatch.setenv("CC", "false")
    code, _, err = run(capsys, "robot.toml", "my brake.toml", "--to", "fmu", "--without-certificate")
    assert code == 2
    assert "CC = 'false': the C compiler failed" in err
    assert not (files / "out").exists()


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", DOCUMENT.read_text(), re.DOTALL)


@pytest.mark.skipif(compiler() is None, reason="needs a C compiler")
def test_the_documents_programs_run(files, capsys):
    """The C programs and the FMPy program of docs/export.md, on what its commands write."""
    pytest.importorskip("fmpy", reason="needs fmpy: pip install 'dashpot[test]'")
    main_c, wrapper = blocks("c")
    assert run(capsys, "fr3", "fr3", "--to", "c", "--supervised", "--without-certificate")[0] == 1
    (files / "main.c").write_text(main_c)
    (files / "fr3_simulink.c").write_text(wrapper)
    strict = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Iout/export", "out/export/fr3.c"]
    subprocess.run([*compiler(), *strict, "main.c", "-o", "main"], check=True)
    done = subprocess.run(["./main"], capture_output=True, text=True, check=True)
    shown = re.search(r"```\n(tick.*?)```", DOCUMENT.read_text(), re.DOTALL)[1]
    assert done.stdout == shown
    subprocess.run([*compiler(), *strict, "-c", "fr3_simulink.c"], check=True)
    assert run(capsys, "fr3", "fr3", "--to", "fmu", "--without-certificate")[0] == 1
    (program,) = blocks("python")
    (files / "program.py").write_text(program)
    done = subprocess.run([sys.executable, "program.py"], capture_output=True, text=True, check=True)
    shown = re.search(r"```\n(\[.*?)```", DOCUMENT.read_text(), re.DOTALL)[1]
    assert done.stdout == shown
