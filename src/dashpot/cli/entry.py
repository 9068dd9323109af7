"""Entry point of the ``dashpot`` command: what is typed, how it ends, and how it is stopped."""

from __future__ import annotations

import difflib
import io
import os
import signal
import sys
import threading
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from dashpot.cli.overview import COMMANDS, overview
from dashpot.cli.parsing import parse_command
from dashpot.errors import DashpotError, InputError, InputWarning
from dashpot.support.waiting import above


def parse(arguments: Sequence[str]) -> Any:
    """The command that was typed; what needs no command is answered here, and ends."""
    if not arguments or arguments[0] in ("-h", "--help"):
        print(overview(bold=sys.stdout.isatty() and os.environ.get("TERM") != "dumb"))
        sys.exit(0 if arguments else 2)
    if arguments[0] == "--version":
        from dashpot import __version__

        print(f"dashpot {__version__}")
        sys.exit(0)
    name = arguments[0]
    if name not in COMMANDS:
        near = difflib.get_close_matches(name, COMMANDS, 1)
        meant = f"did you mean {near[0]}?" if near else "dashpot --help lists them"
        raise InputError(f"no such command; {meant}", quantity="command", value=name)
    return parse_command(name, COMMANDS[name], arguments[1:])


def _show_warning(message: Warning | str, category: type[Warning], *_: object, **__: object) -> None:
    label = "warning" if issubclass(category, InputWarning) else category.__name__
    with above():
        print(f"dashpot: {label}: {message}", file=sys.stderr)


class _Terminated(KeyboardInterrupt):
    """SIGTERM or SIGHUP: its number."""


def _terminate(number: int, _: object) -> None:
    raise _Terminated(number)


@contextmanager
def _tidy_stop() -> Iterator[None]:
    """Lets SIGTERM and a closed terminal stop the command as Ctrl-C does: unfinished output is removed."""
    signals = [number for name in ("SIGTERM", "SIGHUP") if (number := getattr(signal, name, None))]
    if threading.current_thread() is not threading.main_thread():
        signals = []
    taken = [number for number in signals if signal.getsignal(number) is signal.SIG_DFL]
    for number in taken:
        signal.signal(number, _terminate)
    after: signal.Handlers = signal.SIG_DFL
    try:
        yield
    except KeyboardInterrupt:  # on its way out: a second one, as `timeout` sends, changes nothing any more
        after = signal.SIG_IGN
        if signals and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            taken.append(signal.SIGINT)
        raise
    finally:
        for number in taken:
            signal.signal(number, after)


def main(arguments: list[str] | None = None) -> None:
    """Entry point; exits 0 on success, 1 where a verdict is no or the simulation diverges, 2 on bad input.

    Ctrl-C exits 130, SIGTERM 143, SIGHUP 129.
    """
    if sys.stdout is None:  # closed
        sys.stdout = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # a terminal without a character shows "?" for it
            stream.reconfigure(errors="replace")
    with warnings.catch_warnings():
        warnings.simplefilter("always", InputWarning)
        warnings.showwarning = _show_warning
        try:
            status = _run(sys.argv[1:] if arguments is None else arguments)
            sys.stdout.flush()  # here, where what goes wrong with it can be said
        except DashpotError as error:
            status = _fail(str(error))
        except BrokenPipeError:  # the reader of our output has left: `dashpot ... | head`
            _leave_output()
            status = 141
        except OSError as error:
            what = "standard output could not be written" if _output_fails() else error.filename
            status = _fail(": ".join(str(part) for part in (what, error.strerror or error) if part))
        except MemoryError:
            status = _fail("out of memory; ask for a shorter motion or fewer threads")
        except KeyboardInterrupt as stop:
            print("dashpot: stopped", file=sys.stderr)
            status = 128 + stop.args[0] if isinstance(stop, _Terminated) else 130
            _leave_if_running(status)
    sys.exit(status)


def _run(arguments: Sequence[str]) -> Any:
    """Runs what was typed; gives the exit status."""
    try:
        command = parse(arguments)
        with _tidy_stop():
            return command.run()
    except SystemExit as end:
        if isinstance(end.__context__, BrokenPipeError):  # rich would have it end with 1, "the answer is no"
            raise BrokenPipeError from None
        return end.code


def _output_fails() -> bool:
    """Whether what is still to be written to standard output cannot be; then nothing more goes there."""
    try:
        sys.stdout.flush()
        os.write(sys.stdout.fileno(), b"")  # where nothing is kept to be written
    except io.UnsupportedOperation:
        return False
    except OSError:
        _leave_output()
        return True
    return False


def _leave_output() -> None:
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _leave_if_running(status: int) -> None:
    """Ends the process at once where the native loop still runs, under which no memory may be freed, or where
    a pool of processes does not end.
    """
    from dashpot.support.workers import NATIVE_LOOP, is_manager

    if any(thread.name == NATIVE_LOOP or is_manager(thread) for thread in threading.enumerate()):
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


def _fail(message: str) -> int:
    print(f"dashpot: error: {message}", file=sys.stderr)
    return 2
