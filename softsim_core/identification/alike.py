r"""Errors of neighbouring rows that are alike: how much less they tell than as many independent ones.

With the slopes J and the residuals r of row i, its score is :math:`s_i = J_i^T r_i`, and the parameters found
have the covariance :math:`A \, \sum_k w_k \sum_i s_i s_{i+k}^T \, A` with :math:`A = (J^T J)^{-1}`. The sum
goes over twice as many neighbours k as have errors that are alike beyond chance, with weights that fall to
zero. Beside the same with no neighbours this tells by how much intervals are wider.

Source: Newey, West 1987, A simple, positive semi-definite, heteroskedasticity and autocorrelation consistent
covariance matrix.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from softsim_core.arrays import Array, IndexArray

CHANCE = 2.0
"""Standard deviations of a correlation of independent rows beyond which one is not by chance."""


def widening(
    slopes: Array,
    residuals: Array,
    sessions: Sequence[tuple[IndexArray, int]],
    priors: Array | None = None,
) -> Array:
    """How many times as wide the interval of each parameter is, shape (p,), >= 1.

    Args:
        slopes: Of all residuals, those of the sessions one after the other, shape (n, p).
        residuals: Shape (n,); beside priors of unit variance.
        sessions: Of each, the order in which neighbours follow each other, (k,), and the residuals of a row.
        priors: Slopes of residuals of unit variance that are independent of all, shape (m, p).
    """
    known = np.zeros((slopes.shape[1],) * 2) if priors is None else priors.T @ priors
    inverse = np.linalg.pinv(slopes.T @ slopes + known)
    apart, together = known.copy(), known.copy()
    first = 0
    for order, size in sessions:
        own = slice(first, first + len(order) * size)
        first = own.stop
        errors = residuals[own].reshape(len(order), size)[order]
        scores = (slopes[own] * residuals[own, None]).reshape(len(order), size, -1).sum(axis=1)[order]
        window = 2 * neighbours(errors)
        product = scores.T @ scores
        apart += product
        together += product
        for k in range(1, window + 1):
            product = (1.0 - k / (window + 1.0)) * scores[k:].T @ scores[:-k]
            together += product + product.T
    before, after = (np.diagonal(inverse @ each @ inverse) for each in (apart, together))
    return np.sqrt(np.maximum(after / np.maximum(before, 1e-300), 1.0))


def neighbours(errors: Array) -> int:
    """How many rows after a row err as it does, beyond chance; errors are (k, e)."""
    count, total = len(errors), float((errors**2).sum())
    if total == 0.0:
        return 0
    for k in range(1, count // 4 + 1):
        if (errors[k:] * errors[:-k]).sum() / total < CHANCE / np.sqrt(count):
            return k - 1
    return count // 4
