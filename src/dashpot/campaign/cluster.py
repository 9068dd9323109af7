"""A Dask cluster that runs the chunks of a campaign."""

from __future__ import annotations

import logging
import re
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from dashpot.campaign.scenario import Campaign
from dashpot.campaign.store import Block
from dashpot.errors import DashpotError, InputError
from dashpot.support.installing import install

AHEAD = 2  # chunks per worker that wait for it
CONNECT = 15  # [s] to reach a scheduler
GREETING = 2**20  # [bytes] that a scheduler's first message, which begins with its length, is shorter than
ADDRESS = re.compile(r"(?:tcp|tls)://(\[[0-9a-fA-F:.]+\]|[^\s/:\[\]]+):([0-9]{1,5})")


def check_address(scheduler: str) -> tuple[str, int]:
    """Host and port of a scheduler's address.

    Raises:
        InputError: It is none.
    """
    found = ADDRESS.fullmatch(scheduler)
    if not found or not 0 < int(found[2]) < 2**16:
        rule = "must be tcp://HOST:PORT or tls://HOST:PORT, e.g. tcp://10.0.0.1:8786"
        raise InputError(rule, quantity="--scheduler", value=scheduler)
    return found[1].strip("[]"), int(found[2])


@contextmanager
def connected(scheduler: str) -> Iterator[Any]:
    """A client of the cluster of a scheduler that answers and has workers.

    Raises:
        InputError: Nobody answers at this address in time, or no Dask scheduler, or it has no workers.
        DashpotError: The package is not installed.
    """
    place = check_address(scheduler)
    try:
        import distributed
    except ImportError:
        raise DashpotError(f"--scheduler needs distributed: {install('campaign')}") from None

    def refuse(rule: str) -> InputError:
        return InputError(rule, quantity="--scheduler", value=scheduler)

    try:  # by hand first: distributed tries for half a minute, and waits for good for who is no scheduler
        with socket.create_connection(place, CONNECT) as line:
            greeting = b"" if scheduler.startswith("tls") else line.recv(8)
    except TimeoutError:
        raise refuse(f"no Dask scheduler answers within {CONNECT} s") from None
    except OSError as error:
        raise refuse(f"nobody answers: {error.strerror or error}") from None
    if not scheduler.startswith("tls") and not 0 < int.from_bytes(greeting, "little") < GREETING:
        raise refuse("who answers is no Dask scheduler")
    log = logging.getLogger("distributed")
    level = log.level
    log.setLevel(logging.CRITICAL)  # what it logs of a failure is its stack
    try:
        cluster: Any = distributed
        client = cluster.Client(scheduler, timeout=CONNECT, set_as_default=False)
    except (OSError, ValueError, TimeoutError):
        raise refuse(f"no Dask scheduler answers within {CONNECT} s") from None
    finally:
        log.setLevel(level)
    with client:
        if not client.nthreads():
            raise refuse("has no workers")
        yield client


def on_cluster(
    client: Any, campaign: Campaign, todo: list[int], run: Callable[[Campaign, int], Block]
) -> Iterator[Block]:
    """Runs chunks and gives them as they are done.

    Raises:
        DashpotError: A chunk was lost.
    """
    import distributed

    cluster: Any = distributed
    rest = iter(todo)

    def submit() -> Any:
        for chunk in rest:
            key = f"dashpot-{campaign.digest[:12]}-{chunk}"
            return client.submit(run, campaign, chunk, key=key, pure=False)
        return None

    threads = max(1, sum(client.nthreads().values()))
    first = [future for _ in range(AHEAD * threads) if (future := submit()) is not None]
    waiting = cluster.as_completed(first, loop=client.loop)
    for future in waiting:
        try:
            block: Block = future.result()
        except Exception as error:  # whatever a cluster raises
            raise DashpotError(
                f"{client.scheduler.address}: a chunk was lost: {type(error).__name__}: {error}; what is "
                "done is kept: run the same command again"
            ) from None
        future.release()
        if (more := submit()) is not None:
            waiting.add(more)
        yield block
