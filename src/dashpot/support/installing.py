"""How to install what is missing, for the interpreter that runs this, from where dashpot came from."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path


def install(extra: str = "") -> str:
    """The command that installs an extra, or what dashpot itself needs.

    A bare ``pip`` may be that of another interpreter, which has no dashpot and would look for one elsewhere.
    """
    root, extras = Path(__file__).parents[3], f"[{extra}]" if extra else ""
    checkout = (root / "pyproject.toml").is_file() and (root / "src" / "dashpot").is_dir()
    what = f"-e {shlex.quote(f'{root}{extras}')}" if checkout else shlex.quote(f"dashpot{extras}")
    return f"{shlex.quote(sys.executable)} -m pip install {what}"
