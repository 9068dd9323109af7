"""Runs the chunks of a campaign on local processes or a Dask cluster; this process writes the results."""

from __future__ import annotations

import gc
import multiprocessing
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from typing import Any

from dashpot.campaign.cluster import AHEAD, on_cluster
from dashpot.campaign.scenario import Campaign
from dashpot.campaign.store import Block, Store, run_chunk
from dashpot.errors import DashpotError
from dashpot.support.workers import cores, deaf_to_interrupts, pool_of

_HERE: dict[str, Campaign] = {}
"""Campaigns of this process, by digest: what they have built serves the next chunk."""


def execute(
    campaign: Campaign,
    store: Store,
    *,
    workers: int | None = None,
    client: Any = None,
    advance: Callable[[Block], None] = lambda _: None,
    chunks: Sequence[int] | None = None,
) -> None:
    """Runs every chunk that is not done and writes it.

    Args:
        campaign: What to run.
        store: Where results go; written by this process only.
        workers: Local processes; 0: run here; None: one per core.
        client: Of a Dask cluster (`dashpot.campaign.cluster`), which then runs the chunks.
        advance: Called with every chunk written.
        chunks: Only these, in this order; None: all.

    Raises:
        DashpotError: Workers were lost; what is done is kept.
    """
    todo = store.pending()
    if chunks is not None:
        waiting = set(todo)
        todo = [chunk for chunk in chunks if chunk in waiting]
    if client is not None:
        results = on_cluster(client, campaign, todo, chunk_of)
    elif workers == 0:
        results = (run_chunk(campaign, chunk) for chunk in todo)
    else:
        results = _local(campaign, todo, min(workers or cores(), max(len(todo), 1)))
    for block in results:
        store.commit(block)
        advance(block)


def chunk_of(campaign: Campaign, chunk: int) -> Block:
    """`run_chunk` in a worker: the first campaign of a digest that comes by is kept."""
    if campaign.digest not in _HERE:
        _HERE.clear()
        _prepare()
    return run_chunk(_HERE.setdefault(campaign.digest, campaign), chunk)


def _prepare() -> None:
    from threadpoolctl import threadpool_limits

    from dashpot.simulation.engine import quiet_engine

    threadpool_limits(1, user_api="blas")  # every core has a scenario of its own
    gc.freeze()  # modules stay; looking through them again and again takes a fiftieth of the time
    quiet_engine()
    parent = multiprocessing.parent_process()
    if parent is not None:  # nothing goes on where the parent was killed

        def follow() -> None:
            parent.join()
            os._exit(1)

        threading.Thread(target=follow, daemon=True).start()


def _local(campaign: Campaign, todo: list[int], workers: int) -> Iterator[Block]:
    with pool_of(workers) as pool:
        waiting: set[Future[Block]] = set()
        rest = iter(todo)
        try:
            while True:
                with deaf_to_interrupts():
                    for chunk in rest:
                        waiting.add(pool.submit(chunk_of, campaign, chunk))
                        if len(waiting) >= AHEAD * workers:
                            break
                if not waiting:
                    return
                done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
                for future in done:
                    yield future.result()
        except BrokenProcessPool:
            raise DashpotError(
                "a worker process was ended from outside, perhaps for want of memory; what is done "
                "is kept: run the same command again, perhaps with fewer --workers"
            ) from None
