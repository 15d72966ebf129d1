r"""Measures of errors (mean, root mean square, 95th percentile, largest), and losses that a fit minimises.

The loss is a function of the error vector e (3,) of a measured point,

.. math:: \rho(e) = |e|^2 \quad \text{or} \quad \rho(e) = 2 c^2 (\sqrt{1 + |e|^2 / c^2} - 1),

so it does not depend on the axes of the frame. Its score is :math:`\psi = \tfrac12 \partial\rho/\partial e`.

Source: Huber, Ronchetti 2009, Robust statistics; Engels, Stewenius, Nister 2006, Bundle adjustment rules (the
root of a loss as a residual).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from softsim_core.base import Array
from softsim_core.lab.identification.calibration import Loss
from softsim_core.lab.identification.description import ErrorLimits

PARTS = ("low", "middle", "high")
"""Names of the thirds of the workspace along an axis."""


@dataclass(frozen=True, slots=True)
class Measures:
    """Statistics of error lengths in [m]; NaN where there are none.

    Attributes:
        count: Number of errors.
        mean, rms, p95, max: Mean, root mean square, 95th percentile and largest length.
    """

    count: int
    mean: float
    rms: float
    p95: float
    max: float

    def plain(self) -> dict[str, float | int | None]:
        """Return the statistics in [mm], for JSON."""
        values = {f"{name}_mm": 1e3 * getattr(self, name) for name in ("mean", "rms", "p95", "max")}
        return {"count": self.count, **{name: v if np.isfinite(v) else None for name, v in values.items()}}

    def beyond(self, limits: ErrorLimits) -> list[str]:
        """Return a message for each limit that is exceeded."""
        exceeded = []
        for name in ("mean", "rms", "p95", "max"):
            most, value = getattr(limits, f"{name}_mm"), 1e3 * getattr(self, name)
            if most is not None and not value <= most:  # NaN (no measurements) exceeds every limit
                exceeded.append(f"{name} {value:.3g} mm, allowed {most:g} mm")
        return exceeded


def measures(errors: Array) -> Measures:
    """Return the statistics of error vectors (..., 3) in [m]."""
    lengths = np.linalg.norm(errors, axis=-1).ravel()
    if not len(lengths):
        return Measures(0, *4 * (np.nan,))
    return Measures(
        len(lengths),
        float(lengths.mean()),
        float(np.sqrt((lengths**2).mean())),
        float(np.percentile(lengths, 95.0)),
        float(lengths.max()),
    )


def by_region(errors: Array, positions: Array) -> dict[str, tuple[float, float, Measures]]:
    """Return statistics of errors (k, 3) in [m] for each third of their positions' extent along x, y and z.

    Returns:
        By name: begin and end of the third in [m], and the statistics.
    """
    regions = {}
    for axis, name in enumerate("xyz"):
        along = positions[:, axis]
        if not len(along) or np.ptp(along) <= 0.0:
            continue
        edges = np.linspace(along.min(), along.max(), len(PARTS) + 1)
        part = np.clip(np.searchsorted(edges, along, side="right") - 1, 0, len(PARTS) - 1)
        for k, words in enumerate(PARTS):
            found = measures(errors[part == k])
            regions[f"{name} {words}"] = (float(edges[k]), float(edges[k + 1]), found)
    return regions


@dataclass(frozen=True, slots=True)
class PointLoss:
    """A loss of the errors of points.

    Attributes:
        kind: Kind of loss.
        scale: Error c in [m] beyond which a point counts as an outlier.
    """

    kind: Loss
    scale: float

    def _roots(self, points: Array) -> Array:
        r"""Return :math:`\sqrt{1 + |e|^2 / c^2}` of points (k, 3), shape (k, 1)."""
        return np.asarray(np.sqrt(1.0 + (points**2).sum(axis=1, keepdims=True) / self.scale**2))

    def residuals(self, errors: Array) -> Array:
        """Return numbers (n,), three per point, with the loss of errors (n,) in [m] as sum of squares."""
        if self.kind == "linear":
            return errors
        points = errors.reshape(-1, 3)
        return np.asarray((points * np.sqrt(2.0 / (1.0 + self._roots(points)))).ravel())

    def slopes(self, errors: Array, slopes: Array) -> Array:
        """Return the slopes of `residuals` from those of the errors, shape (n, p)."""
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
        r"""Return the scores :math:`\psi` of errors (n,) in [m], shape (n,)."""
        if self.kind == "linear":
            return errors
        points = errors.reshape(-1, 3)
        return np.asarray((points / self._roots(points)).ravel())

    def curvature(self, errors: Array) -> float:
        r"""Return the mean of :math:`\partial\psi_d/\partial e_d` over all components of errors (n,)."""
        if self.kind == "linear":
            return 1.0
        roots = self._roots(errors.reshape(-1, 3))
        return float((1.0 / roots - (roots**2 - 1.0) / (3.0 * roots**3)).mean())
