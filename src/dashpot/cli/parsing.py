"""One command's arguments: read by tyro, refused in one line."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Annotated, Any, Union, get_args, get_origin, get_type_hints

import tyro

from dashpot.cli.help import options, page, shown_as, usage
from dashpot.errors import InputError

_VALUE = re.compile(r": '(.*)'$")  # at the end of what float() and int() say


def parse_command(name: str, kind: type[Any], typed: Sequence[str]) -> Any:
    """The command with what was typed behind its name; ``--help`` prints its page and ends.

    Raises:
        InputError: Something is missing, unknown or no number.
    """
    if any(word in ("-h", "--help") for word in typed):
        print(page(name, kind))
        raise SystemExit(0)
    with _refusing(name, kind, typed):
        return tyro.cli(kind, prog=f"dashpot {name}", args=list(typed))


def print_completion(commands: dict[str, type[Any]], shell: str) -> None:
    """Prints the script that completes all commands in a shell."""
    choices = tuple(Annotated[kind, tyro.conf.subcommand(name)] for name, kind in commands.items())
    every: Any = Union[choices]  # noqa: UP007
    tyro.cli(every, prog="dashpot", args=["--tyro-print-completion", shell])


def _refusing(name: str, kind: type[Any], typed: Sequence[str]) -> AbstractContextManager[Any]:
    """Turns tyro's boxes, of up to thirty lines, into errors of one line.

    The hook is no part of tyro's public interface: where it is not there, or is other than we know it, tyro
    prints its own.
    """
    try:
        from tyro._errors import on_parse_error
    except ImportError:
        return nullcontext()

    def refuse(event: Any) -> None:
        try:
            error = _error(event, name, kind, typed)
        except (AttributeError, KeyError, TypeError):
            return
        if error is not None:
            raise error

    return on_parse_error(refuse)


def _error(event: Any, name: str, kind: type[Any], typed: Sequence[str]) -> InputError | None:
    known, more = options(kind), f"dashpot {name} --help says more"
    for word in typed:  # first: behind it nothing is read as it was meant
        flag = word.partition("=")[0]
        if word.startswith("--") and word != "--" and flag.replace("_", "-") not in known:
            near = difflib.get_close_matches(flag, known, 1)
            meant = f"did you mean {near[0]}?" if near else f"dashpot {name} --help lists them"
            return InputError(f"no such option; {meant}", quantity=flag)
    match type(event).__name__:
        case "UnrecognizedArgs":
            first = event.tokens[0]
            for word in typed:  # --json=3
                if word.startswith("--") and word.endswith(f"={first}"):
                    return InputError("takes no value", quantity=word.partition("=")[0], value=first)
            return InputError(f"is one word too many; usage: {usage(name, kind)}", quantity=first)
        case "MissingArgs":
            lacking = [shown_as(kind, one.arg.field.intern_name) for one in event.missing_arguments]
            verb = "is" if len(lacking) == 1 else "are"
            return InputError(f"{verb} missing; usage: {usage(name, kind)}", quantity=_list(lacking, "and"))
        case "InvalidChoice":
            choices = _list([choice for choice in event.choices if choice != "None"], "or")
            key = shown_as(kind, event.argument.field.intern_name)
            return InputError(f"must be {choices}", quantity=key, value=event.value)
        case "BadValue":
            count = event.argument.lowered.nargs
            rule = "needs a value" if count in (None, 1) else f"needs {count} values"
            return InputError(f"{rule}; {more}", quantity=shown_as(kind, event.argument.field.intern_name))
        case "InstantiationFailure":
            field, found = event.argument.field.intern_name, _VALUE.search(event.message)
            rule = _rule(get_type_hints(kind)[field]) or event.message
            value = found[1] if found else None
            return InputError(f"{rule}; {more}", quantity=shown_as(kind, field), value=value)
    return None


def _rule(hint: Any) -> str:
    """What numbers must be, in words; "" for other types."""
    inner = [part for part in get_args(hint) if part is not type(None)]
    if hint in (int, float):
        return "must be a whole number" if hint is int else "must be a number"
    if get_origin(hint) is tuple and inner[0] in (int, float):
        count = "" if inner[-1] is Ellipsis else f"{len(inner)} "
        return f"must be {count}{'whole ' if inner[0] is int else ''}numbers"
    return _rule(inner[0]) if len(inner) == 1 else ""


def _list(words: Iterable[str], between: str) -> str:
    *first, last = words
    return f"{', '.join(first)} {between} {last}" if first else last
