"""Why nothing fits: which wishes conflict, by how much, and the cheapest change that would make them fit."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from dashpot.certify.index import NO_DAMPING
from dashpot.design.candidates import Duty
from dashpot.design.prover import NO_FRICTION
from dashpot.design.search import JointSearch
from dashpot.design.wishes import NEED_LOOP, Wishes

BRAKED = ("creep", "travel", "stop_time")
"""What a mechanical brake takes over."""
PERIODS = (2, 5, 10)  # times faster sampling


@dataclass(frozen=True)
class Shortfall:
    """A wish that could be had if it asked for less.

    Attributes:
        name: The limit.
        wanted: Its value.
        possible: The best that all others leave, or at least those that conflict with it; None: nothing.
    """

    name: str
    wanted: float
    possible: float | None


@dataclass(frozen=True)
class Conflict:
    """Why a joint has no design.

    Attributes:
        wishes: Limits that cannot be kept together, though any of them could be left out; empty: nothing is
            certified even without limits.
        shortfalls: How far each of them would have to give way, alone.
        change: The cheapest change of the means that helps, in words; empty: none of those tried does.
        tried: Changes that do not help, cheapest first.
        reason: In words, where no gains can help.
    """

    wishes: tuple[str, ...]
    shortfalls: tuple[Shortfall, ...]
    change: str
    tried: tuple[str, ...]
    reason: str = ""


def conflict(duty: Duty, wishes: Wishes, loop: bool) -> Conflict:
    """Analyses a joint for which the search has found nothing."""
    reason = JointSearch(duty, wishes, loop).prover.hopeless
    if reason in (NO_DAMPING, NO_FRICTION):
        return Conflict((), (), "", (), reason)
    if duty.load > (wishes.authority or 1.0) * duty.drive.torque_limit:
        share = duty.load / duty.drive.torque_limit
        reason = (
            f"holding the load takes {duty.load:.3g} N m, {100 * share:.0f} % of the torque limit: a lighter "
            "payload, or more authority"
        )
        return Conflict(
            ("authority",), (Shortfall("authority", wishes.authority or 1.0, None),), "", (), reason
        )
    kept = () if reason else _irreducible(duty, wishes, loop)
    shortfalls = tuple(_shortfall(duty, wishes, loop, name, kept) for name in kept)
    tried: list[str] = []
    for words, other, eased in _changes(duty, wishes):
        if JointSearch(other, eased, loop).run() is not None:
            return Conflict(kept, shortfalls, words, tuple(tried), reason)
        tried.append(words)
    return Conflict(kept, shortfalls, "", tuple(tried), reason)


def _irreducible(duty: Duty, wishes: Wishes, loop: bool) -> tuple[str, ...]:
    """Limits that conflict, from which none can be left out: each is dropped where that changes nothing."""
    names = [name for name in wishes.limits if loop or name not in NEED_LOOP]
    for name in tuple(names):
        rest = [other for other in names if other != name]
        without = wishes.without(*(other for other in wishes.limits if other not in rest))
        if JointSearch(duty, without, loop).run() is None:
            names = rest
    return tuple(names)


def _shortfall(duty: Duty, wishes: Wishes, loop: bool, name: str, named: tuple[str, ...]) -> Shortfall:
    """The best value of one limit while all others are kept, or at least the others that are named."""
    wanted = wishes.limits[name]
    for kept in (tuple(wishes.limits), named):
        rest = wishes.without(*(other for other in wishes.limits if other == name or other not in kept))
        search = JointSearch(duty, rest.changed({"minimise": name, "beside": {}}), loop)
        found = search.run()
        if found is not None:
            return Shortfall(name, wanted, float(search.value(name, found.gains)[0]))
    return Shortfall(name, wanted, None)


def _changes(duty: Duty, wishes: Wishes) -> Iterator[tuple[str, Duty, Wishes]]:
    """Changes of the means, cheapest first."""
    if duty.sampling == "point":
        yield (
            "average the torque over the period instead of sampling it",
            replace(duty, sampling="average"),
            wishes,
        )
    if duty.latency_max > 0:
        yield "a latency of zero samples", replace(duty, latency=0, latency_max=0), wishes
    if any(name in wishes.limits for name in BRAKED):
        yield (
            "a mechanical brake, which makes "
            + ", ".join(name for name in BRAKED if name in wishes.limits)
            + " its own business",
            duty,
            wishes.without(*BRAKED),
        )
    for times in PERIODS:
        period = duty.period / times
        yield (
            f"sampling {times} times as fast, every {1e3 * period:.3g} ms",
            replace(duty, period=period),
            wishes,
        )
        if duty.sampling == "point":
            yield (
                f"the same with the torque averaged ({1e3 * period:.3g} ms)",
                replace(duty, period=period, sampling="average"),
                wishes,
            )
