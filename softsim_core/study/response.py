r"""A quadratic surface through results: y = c + b . t + t' A t, with variables t scaled to [-1, 1]."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations_with_replacement
from typing import Any

import numpy as np

from softsim_core.arrays import Array


@dataclass(frozen=True, slots=True, eq=False)
class ResponseSurface:
    """A fitted surface over p variables.

    Attributes:
        lower, upper: Range of each variable, shape (p,).
        terms: Which scaled variables each coefficient multiplies: none, one or two of them.
        coefficients: As many as terms, in the unit of the quantity.
        share: Of the variance of the results that the surface explains, at most 1.
    """

    lower: Array
    upper: Array
    terms: tuple[tuple[int, ...], ...]
    coefficients: Array
    share: float

    def __call__(self, points: Array) -> Array:
        """Values at points (k, p) in the units of the variables, shape (k,)."""
        return np.asarray(_columns(_scaled(points, self.lower, self.upper), self.terms) @ self.coefficients)

    def plain(self) -> dict[str, Any]:
        """As plain data."""
        return {
            "lower": self.lower.tolist(),
            "upper": self.upper.tolist(),
            "terms": [list(each) for each in self.terms],
            "coefficients": self.coefficients.tolist(),
            "share": self.share,
        }


def response_surface(points: Array, values: Array) -> ResponseSurface:
    """The surface nearest to results in least squares; of too few, or of too few levels, a flatter one.

    Args:
        points: Values of the variables, shape (k, p), each with a range.
        values: Of the quantity, finite, shape (k,).
    """
    count, size = points.shape
    lower, upper = points.min(axis=0, initial=np.inf), points.max(axis=0, initial=-np.inf)
    scaled = _scaled(points, lower, upper)
    levels = [len(np.unique(scaled[:, k])) for k in range(size)]
    terms: list[tuple[int, ...]] = [(), *((k,) for k in range(size))]
    squares = list(combinations_with_replacement(range(size), 2))
    whole = [*terms, *(each for each in squares if each[0] != each[1] or levels[each[0]] > 2)]
    chosen = tuple(whole if count >= len(whole) else terms if count >= len(terms) else [()])
    columns = _columns(scaled, chosen)
    coefficients = np.linalg.lstsq(columns, values, rcond=None)[0]
    spread = float(((values - values.mean()) ** 2).sum())
    left = float(((values - columns @ coefficients) ** 2).sum())
    share = 1.0 - left / spread if spread > 0.0 else 1.0
    return ResponseSurface(lower, upper, chosen, coefficients, share)


def _scaled(points: Array, lower: Array, upper: Array) -> Array:
    return np.asarray(2.0 * (points - lower) / (upper - lower) - 1.0)


def _columns(scaled: Array, terms: tuple[tuple[int, ...], ...]) -> Array:
    return np.stack([scaled[:, list(each)].prod(axis=1) for each in terms], axis=1)
