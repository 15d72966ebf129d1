"""How large errors are: mean, root mean square, 95th percentile, largest; over regions of the workspace."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from softsim_core.arrays import Array
from softsim_core.identification.description import ErrorLimits

PARTS = ("low", "middle", "high")
"""Thirds of the workspace along an axis."""


@dataclass(frozen=True, slots=True)
class Measures:
    """Lengths of errors in [m]; nan where there are none.

    Attributes:
        count: How many errors.
        mean, rms, p95, max: Of their lengths.
    """

    count: int
    mean: float
    rms: float
    p95: float
    max: float

    def plain(self) -> dict[str, float | int | None]:
        """For JSON, in [mm]."""
        values = {f"{name}_mm": 1e3 * getattr(self, name) for name in ("mean", "rms", "p95", "max")}
        return {"count": self.count, **{name: v if np.isfinite(v) else None for name, v in values.items()}}

    def beyond(self, limits: ErrorLimits) -> list[str]:
        """Which limits are not kept, each in words."""
        told = []
        for name in ("mean", "rms", "p95", "max"):
            most, value = getattr(limits, f"{name}_mm"), 1e3 * getattr(self, name)
            if most is not None and not value <= most:  # nothing measured keeps no limit
                told.append(f"{name} {value:.3g} mm, allowed {most:g} mm")
        return told


def measures(errors: Array) -> Measures:
    """Of error vectors (..., 3) in [m]."""
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
    """Measures in each third of the extent along x, y and z: name, its begin and end in [m], and they.

    Args:
        errors: Shape (k, 3), in [m].
        positions: Where they are, shape (k, 3), in [m].
    """
    told = {}
    for axis, name in enumerate("xyz"):
        along = positions[:, axis]
        if not len(along) or np.ptp(along) <= 0.0:
            continue
        edges = np.linspace(along.min(), along.max(), len(PARTS) + 1)
        part = np.clip(np.searchsorted(edges, along, side="right") - 1, 0, len(PARTS) - 1)
        for k, words in enumerate(PARTS):
            found = measures(errors[part == k])
            told[f"{name} {words}"] = (float(edges[k]), float(edges[k + 1]), found)
    return told
