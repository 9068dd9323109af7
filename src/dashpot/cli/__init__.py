"""The ``dashpot`` command: what can be typed. `dashpot.commands` does it, and is imported only then."""

from dashpot.cli.entry import main

__all__ = ["main"]
