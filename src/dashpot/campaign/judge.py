"""Verdicts on a dataset: which requirements hold, for what share of the scenarios, and the worst of them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaincinv

from dashpot.campaign.requirements import Requirement
from dashpot.campaign.scenario import OK
from dashpot.campaign.spec import Spec
from dashpot.support.arrays import Floats

WORST = 3  # scenarios named per requirement
ASSURED = 0.95  # confidence of the assured share


@dataclass(frozen=True)
class Case:
    """One scenario and joint.

    Attributes:
        index: Of the scenario.
        joint: Name; "" of a measure per run.
        value: [SI]; NaN where the scenario diverged or could not be run.
    """

    index: int
    joint: str
    value: float


@dataclass(frozen=True)
class Verdict:
    """One requirement judged.

    Attributes:
        requirement: What was required.
        judged: Scenarios it applies to.
        kept: Share of them that keep it, of the joint where it is least [-].
        joint: That joint; "" of a measure per run.
        quantile: The measure at the required quantile of that joint [SI].
        assured: Lower end of the share's 95 % confidence interval, were scenarios drawn independently [-].
        worst: Worst cases, worst first.
        holds: Whether it is met; not, where nothing could be judged.
    """

    requirement: Requirement
    judged: int
    kept: float
    joint: str
    quantile: float
    assured: float
    worst: tuple[Case, ...]
    holds: bool


def judge(spec: Spec, dataset: Any) -> list[Verdict]:
    """Judges every requirement over the scenarios that are done."""
    return [_judge(requirement, spec, dataset) for requirement in spec.requirements]


def passed(spec: Spec, dataset: Any) -> NDArray[np.bool_]:
    """Scenarios that are done and keep every bound that applies to them, (scenarios,)."""
    status = dataset["status"].values.ravel()
    good = status == OK
    for requirement in spec.requirements:
        values, broken, applies = _broken(requirement, spec, dataset)
        good &= ~(broken & applies).any(1)
        del values
    return np.asarray(good)


def _broken(
    requirement: Requirement, spec: Spec, dataset: Any
) -> tuple[Floats, NDArray[np.bool_], NDArray[np.bool_]]:
    """The measure, where it breaks the bound, and where it is judged, (scenarios, joints) each."""
    data = dataset[requirement.measure]
    if requirement.joint is not None:
        data = data.sel(joint=[requirement.joint])
    status = dataset["status"].values.ravel()
    values = data.values.reshape(status.size, -1).astype(float)
    lost = status[:, None] > OK
    broken = lost | (values > requirement.high) | (values < requirement.low)
    if requirement.among:
        broken |= ~np.isin(values, requirement.among) & ~np.isnan(values)
    applies = (lost | (status[:, None] == OK) & ~np.isnan(values)) & selected(requirement, spec, dataset)[
        :, None
    ]
    return np.where(lost, np.nan, values), broken, applies


def selected(requirement: Requirement, spec: Spec, dataset: Any) -> NDArray[np.bool_]:
    """Scenarios that ``where`` selects, (scenarios,)."""
    chosen = np.ones(spec.size, bool)
    for name, value in requirement.where:
        along = dataset[spec.axis(name).label]
        found = along.isin(list(value)) if isinstance(value, tuple) else along == value
        chosen &= found.broadcast_like(dataset["status"]).transpose(*spec.dims).values.ravel()
    return chosen


def _judge(requirement: Requirement, spec: Spec, dataset: Any) -> Verdict:
    values, broken, applies = _broken(requirement, spec, dataset)
    single = "joint" not in dataset[requirement.measure].dims
    names = [""] if single else [requirement.joint] if requirement.joint else list(dataset["joint"].values)
    counts = applies.sum(0)
    if not counts.any():
        return Verdict(requirement, 0, math.nan, "", math.nan, math.nan, (), False)
    share = np.where(counts > 0, 1 - (broken & applies).sum(0) / np.maximum(counts, 1), 1.0)
    upwards = math.isfinite(requirement.high)
    badness = np.where(np.isnan(values), np.inf, values if upwards else -values)
    if upwards and math.isfinite(requirement.low):
        badness = np.maximum(values - requirement.high, requirement.low - values)
        badness = np.where(np.isnan(values), np.inf, badness)
    if requirement.among:
        badness = broken.astype(float)
    badness = np.where(applies, badness, -np.inf)
    # The worst joint keeps it least often; of equals, the one that comes closest to breaking it.
    j = int(np.lexsort((-badness.max(0), share))[0])
    order = np.argsort(-badness, axis=None, kind="stable")[:WORST]
    worst = [np.unravel_index(int(i), badness.shape) for i in order]
    cases = tuple(Case(int(i), str(names[k]), float(values[i, k])) for i, k in worst if applies[i, k])
    column = np.sort(badness[applies[:, j], j])
    at = column[min(math.ceil(requirement.quantile * len(column)) - 1, len(column) - 1)]
    quantile = float(at if upwards else -at)
    if requirement.among or (upwards and math.isfinite(requirement.low)):
        quantile = math.nan  # of these there is no single one
    kept = int(counts[j] - (broken & applies)[:, j].sum())
    assured = float(betaincinv(kept, counts[j] - kept + 1, 1 - ASSURED)) if kept else 0.0
    holds = bool((share >= requirement.quantile - 1e-12).all())
    return Verdict(
        requirement, int(counts.max()), float(share[j]), str(names[j]), quantile, assured, cases, holds
    )
