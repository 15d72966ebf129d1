"""The quadratic function nearest to what an optimisation has seen around its best, and where it is least."""

from __future__ import annotations

import numpy as np

from softsim_core.arrays import Array

_LEAST_CURVATURE = 1e-9
"""Of the curvature in the steepest direction; a flatter function has no minimum that could be trusted."""


def quadratic_minimum(points: Array, costs: Array) -> Array | None:
    r"""Minimum within the unit box of :math:`c + g^T x + x^T H x / 2`, fitted to the best points.

    Args:
        points: Points in the unit box, shape (n, p).
        costs: Finite costs, shape (n,).

    Returns:
        Where the fit is least, shape (p,); None: there are too few points, or the fit has no minimum.
    """
    size = points.shape[1]
    needed = (size + 1) * (size + 2) // 2
    best = np.argsort(costs, kind="stable")[: 2 * needed]
    if len(best) <= needed:
        return None
    points, costs = points[best], costs[best]
    extent, rise = np.ptp(points, axis=0), np.ptp(costs)
    if not ((extent > 0.0).all() and 0.0 < rise < np.inf):
        return None
    scaled = (points - points[0]) / extent
    rows, columns = np.triu_indices(size)
    terms = np.column_stack([np.ones(len(scaled)), scaled, scaled[:, rows] * scaled[:, columns]])
    found, _, rank, _ = np.linalg.lstsq(terms, (costs - costs[0]) / rise, rcond=None)
    if rank < needed:
        return None
    hessian = np.zeros((size, size))
    hessian[rows, columns] = found[size + 1 :]
    hessian += hessian.T
    curvatures = np.linalg.eigvalsh(hessian)
    if not curvatures[0] > _LEAST_CURVATURE * curvatures[-1]:
        return None
    minimum: Array = points[0] + extent * np.linalg.solve(hessian, -found[1 : size + 1])
    return minimum.clip(0.0, 1.0)
