"""Every example does what its first lines say, and prints something."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
EXAMPLES = sorted((ROOT / "examples").glob("[0-9]*"))


def commands(path):
    """The commands that stand at its beginning, or Python with it."""
    head = re.match(r'(/\*.*?\*/|""".*?""")', path.read_text(), re.S)[0]
    found = re.findall(r"(?:^[ *]*|: )((?:dashpot|cc|python|\./)\S* .*?|\./\w+)(?:  #.*| \*/)?$", head, re.M)
    return found or [f"python examples/{path.name}"]


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda p: p.name)
def test_example_runs(path, tmp_path):
    for name in ("examples", "native"):
        (tmp_path / name).symlink_to(ROOT / name)
    here = {**os.environ, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    said = ""
    for command in commands(path):
        done = subprocess.run(command, shell=True, cwd=tmp_path, capture_output=True, text=True, env=here)
        assert done.returncode == 0, f"{command}: {done.stdout}{done.stderr}"
        assert done.stderr == ""
        said = done.stdout
    assert said.count("\n") >= 3


def test_examples_are_numbered_and_short():
    numbers = [int(path.name[:2]) for path in EXAMPLES]
    assert numbers == list(range(1, len(EXAMPLES) + 1))
    for path in (ROOT / "examples").iterdir():
        assert len(path.read_text().splitlines()) < 60, path.name


def test_the_program_of_the_readme_runs(tmp_path):
    text = (ROOT / "README.md").read_text()
    program = re.search(r"```python\n(.*?)```", text, re.S)[1]
    assert len(program.splitlines()) <= 10
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines()[0] == "True"
