"""What ``--help`` of a command prints: tyro's boxes under a usage and a text of ours."""

from __future__ import annotations

import ast
import inspect
import io
import shutil
import sys
import textwrap
from contextlib import redirect_stdout, suppress
from dataclasses import MISSING, Field, field, fields, make_dataclass
from itertools import pairwise
from typing import Annotated, Any, get_args, get_type_hints

import tyro

WIDEST = 100  # characters of running text
_POSITIONAL = get_args(tyro.conf.Positional[str])[1]
_TEXT = "(text)"  # stands for the text in tyro's page


def page(name: str, kind: type[Any]) -> str:
    """The page, as wide as the terminal and in its colours.

    tyro does not wrap the text above its boxes, keeps in them the line breaks of a field's docstring, and
    shows what may be left out as if it must be given.
    """
    said: io.StringIO = _Paper()
    with redirect_stdout(said), suppress(SystemExit):
        tyro.cli(_running(kind), prog="dashpot", args=["--help"], description=_TEXT)
    width = min(shutil.get_terminal_size().columns, WIDEST)
    paragraphs = (inspect.getdoc(kind) or "").split("\n\n")
    text = "\n\n".join(_wrapped(" ".join(part.split()), width) for part in paragraphs)
    return f"usage: {usage(name, kind)}\n\n{text}{said.getvalue().partition(_TEXT)[2].rstrip()}"


def usage(name: str, kind: type[Any]) -> str:
    """What the command needs: ``dashpot identify LOG --robot ROBOT ...``."""
    hints, words = get_type_hints(kind, include_extras=True), [f"dashpot {name}"]
    for one in fields(kind):
        hint, needed = hints[one.name], one.default is MISSING
        if _positional(hint):
            words.append(_metavar(one.name, hint) if needed else f"[{_metavar(one.name, hint)}]")
        elif needed:
            words.append(f"{_option(one)} {_metavar(one.name, hint)}")
    optional = not all(_positional(hints[one.name]) for one in fields(kind))
    return " ".join([*words, *["..."] * optional])


def options(kind: type[Any]) -> list[str]:
    """Every option of a command."""
    hints = get_type_hints(kind, include_extras=True)
    return [_option(one) for one in fields(kind) if not _positional(hints[one.name])]


def shown_as(kind: type[Any], name: str) -> str:
    """A field as a user knows it: ROBOT, --payload."""
    hint = get_type_hints(kind, include_extras=True)[name]
    if _positional(hint):
        return _metavar(name, hint)
    return next(_option(one) for one in fields(kind) if one.name == name)


class _Paper(io.StringIO):
    """Takes tyro's page, with the colours and characters of standard output."""

    def __init__(self) -> None:
        super().__init__()
        self._for = sys.stdout

    @property
    def encoding(self) -> str:  # type: ignore[override]
        return self._for.encoding

    def isatty(self) -> bool:
        return self._for.isatty()


def _option(one: Field[Any]) -> str:
    """A flag that is set to begin with is there to clear it."""
    return ("--no-" if one.default is True else "--") + one.name.replace("_", "-")


def _positional(hint: Any) -> bool:
    return _POSITIONAL in get_args(hint)


def _metavar(name: str, hint: Any) -> str:
    found = [part.metavar for part in get_args(hint) if getattr(part, "metavar", None)]
    return found[-1] if found else name.upper()


def _wrapped(text: str, width: int) -> str:
    """A paragraph; an example stays one that can be copied."""
    if not text.startswith("Example:"):
        return textwrap.fill(text, width, break_long_words=False, break_on_hyphens=False)
    lines = textwrap.wrap(text, width - 2, break_long_words=False, break_on_hyphens=False)
    return " \\\n    ".join(lines)


def _running(kind: type[Any]) -> type[Any]:
    """A command's arguments with their docstrings as running text, optional ones in brackets."""
    hints, said = get_type_hints(kind, include_extras=True), _docstrings(kind)
    made: list[Any] = []
    for one in fields(kind):
        hint, optional = hints[one.name], one.default is not MISSING
        about: Any = {"help": said[one.name]} if one.name in said else {}
        if _positional(hint) and optional:
            about["metavar"] = f"[{_metavar(one.name, hint)}]"
        default = [field(default=one.default)] if optional else []
        made.append((one.name, Annotated[hint, tyro.conf.arg(**about)], *default))
    return make_dataclass(kind.__name__, made)


def _docstrings(kind: type[Any]) -> dict[str, str]:
    """Field -> the string below it in the source."""
    body = ast.parse(inspect.getsource(kind)).body[0]
    assert isinstance(body, ast.ClassDef)
    found = {}
    for before, after in pairwise(body.body):
        if isinstance(before, ast.AnnAssign) and isinstance(before.target, ast.Name):
            match after:
                case ast.Expr(ast.Constant(str() as text)):
                    found[before.target.id] = " ".join(text.split())
    return found
