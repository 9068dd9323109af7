"""Limits of what several commands are asked for: seeds, processes and threads."""

from __future__ import annotations

from dashpot.errors import InputError

MOST_SEED = 2**31 - 1
"""Largest seed anywhere, so that what one command was given suits every other."""
MOST_WORKERS = 1024


def check_seed(seed: int, quantity: str = "--seed", *, file: object = None) -> None:
    """Checks a seed of random numbers.

    Raises:
        InputError: Not a whole number from 0 to `MOST_SEED`.
    """
    if type(seed) is not int or not 0 <= seed <= MOST_SEED:
        rule = f"must be a whole number, 0 to {MOST_SEED}"
        raise InputError(rule, file=file, quantity=quantity, value=seed)


def check_workers(workers: int | None, quantity: str = "--workers") -> None:
    """Checks how many processes or threads are asked for; None: one per core.

    Raises:
        InputError: None at all, or more than any machine has cores.
    """
    if workers is not None and not 1 <= workers <= MOST_WORKERS:
        raise InputError(f"must be 1 to {MOST_WORKERS}", quantity=quantity, value=workers)
