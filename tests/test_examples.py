"""Every example runs and prints something."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
EXAMPLES = sorted((ROOT / "examples").glob("[0-9]*"))


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda p: p.name)
def test_example_runs(path, tmp_path):
    if path.suffix == ".c":
        program = tmp_path / "example"
        core = ROOT / "native" / "dashpot_core.c"
        subprocess.run(
            ["cc", "-std=c99", "-Werror", "-Wall", f"-I{ROOT / 'native'}", path, core, "-o", program],
            check=True,
        )
        command = [program]
    else:
        command = [sys.executable, path]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout.count("\n") >= 3
    assert done.stderr == ""
