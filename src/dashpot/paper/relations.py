"""Relations a figure must show, with the spread over seeds beside each verdict."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

Sense = Literal["at least", "at most"]


@dataclass(frozen=True)
class Relation:
    """A measured value against its limit.

    Attributes:
        figure: "fig4", "fig5" or "fig6".
        subject: Joint, payload or both; "" where there is only one.
        text: What is compared, with its unit.
        value: The value judged: over all seeds, see ``judged``.
        sense: "at least" or "at most".
        limit: The limit.
        judged: How the seeds were put together.
        lowest: Smallest value over the seeds.
        highest: Largest value over the seeds.
        seeds: Number of seeds.
        seeds_holding: How many of them meet the limit on their own.
    """

    figure: str
    subject: str
    text: str
    value: float
    sense: Sense
    limit: float
    judged: str
    lowest: float
    highest: float
    seeds: int
    seeds_holding: int

    @property
    def holds(self) -> bool:
        """The verdict."""
        return self.value >= self.limit if self.sense == "at least" else self.value <= self.limit

    def to_json(self) -> dict[str, Any]:
        """All attributes and the verdict."""
        return {**asdict(self), "holds": self.holds}


def judge(
    figure: str,
    subject: str,
    text: str,
    per_seed: ArrayLike,
    sense: Sense,
    limit: float,
    *,
    together: float | None = None,
) -> Relation:
    """Judges one relation.

    Args:
        figure: Its figure.
        subject: Joint or payload.
        text: What is compared.
        per_seed: Value of each seed, (seeds,).
        sense: "at least" or "at most".
        limit: The limit.
        together: Value formed from all seeds; None: the worst seed is judged, so every seed must hold.
    """
    values = np.asarray(per_seed, float)
    holding = values >= limit if sense == "at least" else values <= limit
    worst = values.min() if sense == "at least" else values.max()
    return Relation(
        figure,
        subject,
        text,
        float(worst if together is None else together),
        sense,
        float(limit),
        "worst seed" if together is None else "mean over seeds",
        float(values.min()),
        float(values.max()),
        len(values),
        int(holding.sum()),
    )
