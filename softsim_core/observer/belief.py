"""What is believed of unknown numbers: a mean with a covariance, a Kalman filter.

    predict:  P <- P + Q
    update:   K = P H^T (H P H^T + R)^-1,   z <- z + K v,   P <- (I - K H) P (I - K H)^T + K R K^T

Source: Kalman 1960; the covariance in Joseph's form (Bucy and Joseph 1968), which rounding leaves positive.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from softsim_core.arrays import Array


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """A mean z (p,) and a covariance P (p, p), in the units of the unknowns; never changed in place."""

    mean: Array
    covariance: Array

    @property
    def deviation(self) -> Array:
        """Standard deviations of the unknowns, shape (p,)."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    def spread(self, variance: Array) -> Belief:
        """After independent changes of such variances (p,)."""
        return Belief(self.mean, self.covariance + np.diag(variance))

    def updated(self, innovation: Array, rows: Array, noise: Array) -> Belief:
        """After a measurement.

        Args:
            innovation: v: what was measured less what was expected, shape (m,).
            rows: H: its derivatives by the unknowns, shape (m, p).
            noise: R: covariance of the measurement, shape (m, m).
        """
        across = self.covariance @ rows.T
        gain = np.linalg.solve(rows @ across + noise, across.T).T
        left = np.eye(len(self.mean)) - gain @ rows
        covariance = left @ self.covariance @ left.T + gain @ noise @ gain.T
        return Belief(self.mean + gain @ innovation, 0.5 * (covariance + covariance.T))

    def pinned(self, which: slice) -> Belief:
        """After some unknowns have become known to be 0, whatever was believed of them."""
        mean, covariance = self.mean.copy(), self.covariance.copy()
        mean[which] = 0.0
        covariance[which] = 0.0
        covariance[:, which] = 0.0
        return Belief(mean, covariance)

    def opened(self, which: slice, mean: Array, covariance: Array) -> Belief:
        """After some unknowns were found anew, independent of the others: their mean and covariance."""
        opened = self.pinned(which)
        opened.mean[which] = mean
        opened.covariance[which, which] = covariance
        return opened


def squared_distance(innovation: Array, covariance: Array) -> float:
    """v^T S^-1 v: chi-square distributed where v (m,) is normal of covariance S (m, m)."""
    return float(innovation @ np.linalg.solve(covariance, innovation))
