"""A small TOML writer and the rule every message to a user obeys, shared by the tests of files."""

from __future__ import annotations

import json
import math
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import hypothesis
import pytest
import scipy.linalg  # noqa: F401 - loads the library whose threads are limited
from threadpoolctl import threadpool_limits

from dashpot.errors import InputError

threadpool_limits(1, user_api="blas")  # the tests run in parallel; threads of small matrices only wait

hypothesis.settings.register_profile("shared", deadline=None)  # the machine has other things to do as well
hypothesis.settings.load_profile("shared")


if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # a shell's background jobs, and what they start
    signal.signal(signal.SIGINT, signal.default_int_handler)


def toml(value: Any) -> str:
    """A TOML value."""
    match value:
        case bool():
            return str(value).lower()
        case int():
            return str(value) if abs(value) < 10**4000 else hex(value)
        case float():
            return "nan" if math.isnan(value) else repr(value)
        case str():
            return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
        case list():
            return f"[{', '.join(map(toml, value))}]"
    return f"{{ {', '.join(f'{toml(key)} = {toml(item)}' for key, item in value.items())} }}"


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    """Writes a TOML file: a dict with a list of joints, text, or bytes."""

    def write(content: dict[str, Any] | str | bytes, name: str = "given.toml") -> Path:
        path = tmp_path / name
        if isinstance(content, dict):
            content = "\n".join(f"{toml(key)} = {toml(item)}" for key, item in content.items())
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write


@pytest.fixture
def refused(write: Callable[..., Path]) -> Callable[..., str]:
    """Loads a bad file; checks that one line names the file, and returns the rest of that line."""

    def refused(load: Callable[[Path], object], content: dict[str, Any] | str | bytes | Path) -> str:
        path = content if isinstance(content, Path) else write(content)
        with pytest.raises(InputError) as caught:
            load(path)
        message = str(caught.value)
        assert len(message.splitlines()) == 1
        assert message.isprintable()
        assert message.startswith(f"{path}: ")
        assert len(message) - len(str(path)) < 400
        return message.removeprefix(f"{path}: ")

    return refused
