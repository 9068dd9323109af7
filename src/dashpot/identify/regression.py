"""Instrumental variables with intervals that hold for correlated errors.

Two-stage least squares: regressors X are projected on instruments Z that are correlated with the motion but
not with the errors of X; ``theta = (X^' X)^-1 X^' y`` with X^ the projection. The covariance is the sandwich
with the long-run variance of the scores, estimated from their lowest cosine transforms (Lazarus, Lewis, Stock
and Watson, J. Bus. Econ. Stat. 36, 2018): no assumption on noise colour or variance, Student quantiles for
few of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh, qr
from scipy.stats import t as student

from dashpot.support.arrays import Floats

CONFIDENCE = 0.95
WHITE = 1e-12  # added to the noise of the scaled columns, some of which have none
TINY = 1e-100  # rms of a column that is nothing
RANK = 1e-9  # singular value over the largest, columns scaled, below which a direction does not exist
# First-stage F below which a direction's estimate is biased by weak instruments (Staiger, Stock 1997).
STRENGTH = 10.0
COSINES = (8, 48)  # fewest and most cosine transforms; 0.41 n^(2/3) of n independent windows in between


@dataclass(frozen=True)
class Regression:
    """A solution.

    Attributes:
        theta: (p,) estimates.
        cov: (p, p) their covariance.
        influence: (w, p) what each window adds to the error of theta.
        residual: (w,).
        dof: Degrees of freedom of the covariance.
        unseen: (p, d) directions of theta that the instruments do not show; of the order of 1 in torque.
    """

    theta: Floats
    cov: Floats
    influence: Floats
    residual: Floats
    dof: int
    unseen: Floats

    @property
    def quantile(self) -> float:
        """Half-width of an interval over its standard error."""
        return float(student.ppf(0.5 + CONFIDENCE / 2, self.dof))


def cosines(independent: float) -> int:
    """How many cosine transforms a number of independent windows is good for."""
    return int(min(max(0.41 * max(independent, 0.0) ** (2 / 3), COSINES[0]), COSINES[1]))


def long_run(influence: Floats, count: int) -> Floats:
    """Covariance (p, p) of the sum of a correlated series (w, p), from its lowest cosine transforms."""
    windows = len(influence)
    phase = math.pi * (np.arange(windows) + 0.5) / windows
    basis = np.cos(np.outer(np.arange(1, count + 1), phase)) * math.sqrt(2.0)
    parts = basis @ influence
    return np.asarray(parts.T @ parts / count)


def project(X: Floats, Z: Floats) -> Floats:
    """Projection of X (w, p) on the span of Z (w, k)."""
    scale = np.sqrt((Z * Z).mean(0))
    Z = Z[:, scale > 0] / scale[scale > 0]
    Q, R, _ = qr(Z, mode="economic", pivoting=True)
    size = np.abs(np.diag(R))
    Q = Q[:, size > RANK * size[0]]
    return np.asarray(Q @ (Q.T @ X))


def two_stage(y: Floats, X: Floats, Z: Floats, independent: float) -> Regression:
    """Solves ``y = X theta + error`` with instruments Z.

    Args:
        y: (w,).
        X: (w, p).
        Z: (w, k), k >= p.
        independent: Number of independent windows among the w.
    """
    scale = np.sqrt((X * X).mean(0))
    scale[scale < TINY] = 1.0
    X = X / scale
    fitted = project(X, Z)
    _, size, right = np.linalg.svd(fitted, full_matrices=False)
    keep = size > RANK * size[0] if size[0] > 0 else np.zeros(len(size), bool)
    weak = np.column_stack([right[~keep].T, weakest(X, fitted, Z.shape[1], independent)])
    inverse = (right[keep].T / size[keep] ** 2) @ right[keep]
    theta = inverse @ (fitted.T @ y)
    residual = y - X @ theta
    influence = (fitted * residual[:, None]) @ inverse
    count = cosines(independent)
    spare = len(y) / max(len(y) - X.shape[1], 1)
    cov = long_run(influence, count) * spare
    return Regression(
        theta / scale, cov / np.outer(scale, scale), influence / scale, residual, count, weak / scale[:, None]
    )


def weakest(X: Floats, fitted: Floats, instruments: int, independent: float) -> Floats:
    """Directions (p, d), of unit length, in which the fitted X is no more than instruments make of noise.

    The first stage leaves ``X - fitted``; as noise it would put `instruments` times its long-run variance
    into the fitted part. The ratio is the first-stage F (Cragg and Donald 1993), with windows counted where
    independent.
    """
    noise = (X - fitted).T @ (X - fitted) / len(X) + WHITE * np.eye(X.shape[1])
    strength, axes = eigh(fitted.T @ fitted, noise)
    axes = axes[:, strength < STRENGTH * instruments * len(X) / max(independent, 1.0)]
    return np.asarray(axes / np.linalg.norm(axes, axis=0))
