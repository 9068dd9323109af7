"""What is installed: ``doctor``, ``completion``."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import Annotated, Literal

import tyro

from dashpot.cli.arguments import Flag
from dashpot.support.waiting import waiting


@dataclass
class Doctor:
    """Say what works on this machine, and what every missing part is needed for.

    Example: dashpot doctor

    Looks at the packages of the core and of every extra, at the processor, the compiler and the real-time
    rights, and simulates an arm on both engines. Exit status: 0 the core works, 1 it does not; what is
    missing of an extra changes neither.
    """

    json: Flag = False
    """Print the findings as JSON."""

    def run(self) -> int:
        """Runs the command."""
        with waiting("starting"):
            from dashpot.commands.doctor import doctor

        return doctor(self)


@dataclass
class Completion:
    """Print a script that completes commands and options in a shell.

    Example: dashpot completion bash > ~/.local/share/bash-completion/completions/dashpot

    zsh: dashpot completion zsh > a file _dashpot in a folder of $fpath. tcsh: source what it prints.
    """

    shell: Annotated[tyro.conf.Positional[Literal["bash", "zsh", "tcsh"]], tyro.conf.arg(metavar="SHELL")]
    """bash, zsh or tcsh."""

    def run(self) -> int:
        """Runs the command."""
        from dashpot.cli.overview import COMMANDS
        from dashpot.cli.parsing import print_completion

        with suppress(SystemExit):
            print_completion(COMMANDS, self.shell)
        return 0
