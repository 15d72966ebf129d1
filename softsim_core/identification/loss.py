r"""Losses of the rows' errors: least squares, and one that takes less notice of outliers.

The loss acts on a measured point as a whole, on its error e with three components,

.. math:: \rho(e) = |e|^2 \quad \text{or} \quad \rho(e) = 2 c^2 (\sqrt{1 + |e|^2 / c^2} - 1),

so that it does not depend on the axes of the frame. Its score is
:math:`\psi = \tfrac12 \partial\rho/\partial e`.

Source: Huber, Ronchetti 2009, Robust statistics; Engels, Stewenius, Nister 2006, Bundle adjustment rules (the
root of a loss as a residual).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from softsim_core.arrays import Array
from softsim_core.identification.calibration import Loss


@dataclass(frozen=True, slots=True)
class PointLoss:
    """A loss of the errors of points.

    Attributes:
        kind: Which.
        scale: From which error on a point is an outlier, c in [m].
    """

    kind: Loss
    scale: float

    def _roots(self, points: Array) -> Array:
        r""":math:`\sqrt{1 + |e|^2 / c^2}` of points (k, 3), shape (k, 1)."""
        return np.asarray(np.sqrt(1.0 + (points**2).sum(axis=1, keepdims=True) / self.scale**2))

    def residuals(self, errors: Array) -> Array:
        """Numbers whose sum of squares is the loss of errors (n,) in [m], three of each point, shape (n,)."""
        if self.kind == "linear":
            return errors
        points = errors.reshape(-1, 3)
        return np.asarray((points * np.sqrt(2.0 / (1.0 + self._roots(points)))).ravel())

    def slopes(self, errors: Array, slopes: Array) -> Array:
        """Slopes of `residuals` from those of the errors, shape (n, p)."""
        if self.kind == "linear":
            return slopes
        points = errors.reshape(-1, 3)
        roots = self._roots(points)
        factors = np.sqrt(2.0 / (1.0 + roots))
        bends = -1.0 / (factors * roots * (1.0 + roots) ** 2 * self.scale**2)
        by_point = slopes.reshape(len(points), 3, -1)
        along = np.einsum("kd,kdp->kp", points, by_point)
        turned = factors[:, :, None] * by_point + (bends * points)[:, :, None] * along[:, None, :]
        return np.asarray(turned.reshape(slopes.shape))

    def scores(self, errors: Array) -> Array:
        r"""The scores :math:`\psi` of errors (n,) in [m], shape (n,)."""
        if self.kind == "linear":
            return errors
        points = errors.reshape(-1, 3)
        return np.asarray((points / self._roots(points)).ravel())

    def curvature(self, errors: Array) -> float:
        r"""The mean of :math:`\partial\psi_d/\partial e_d` over all components of errors (n,)."""
        if self.kind == "linear":
            return 1.0
        roots = self._roots(errors.reshape(-1, 3))
        return float((1.0 / roots - (roots**2 - 1.0) / (3.0 * roots**3)).mean())
