"""Shells inside each other: which is a solid, which a cavity; all turned so that solids point outward."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from softsim_core.arrays import Array, BoolArray, IndexArray
from softsim_core.contact.crossing import crossings
from softsim_core.mesh.faces import encloses
from softsim_core.mesh.surface import enclosed_volume
from softsim_core.meshing.topology import shells

SPECK = 0.005
"""A shell whose box has less than this share of the largest one's diagonal is dropped."""


@dataclass(frozen=True, slots=True, eq=False)
class Nesting:
    """Closed shells and how they lie.

    Attributes:
        triangles: Solids outward, cavities into the hollow, by shell, shape (k, 3).
        label: Shell of each triangle, shape (k,).
        volumes: Of each shell, > 0, in the unit of the points cubed, shape (s,).
        depth: In how many others each lies; odd ones are cavities, shape (s,).
        body: Which body each belongs to: solids that cross are one, a cavity is of what is around it, (s,).
        crossing: Pairs of triangles that cross, shape (c, 2).
        turned: Shells that were turned inside out.
    """

    triangles: IndexArray
    label: IndexArray
    volumes: Array
    depth: IndexArray
    body: IndexArray
    crossing: IndexArray
    turned: int

    @property
    def cavities(self) -> BoolArray:
        """Which shells are cavities."""
        return np.asarray(self.depth % 2 == 1)


def nested(points: Array, triangles: IndexArray) -> Nesting:
    """How closed shells lie in each other.

    Args:
        points: Vertices, shape (n, 3).
        triangles: Turned alike within each shell, closed, shape (k, 3).
    """
    count, label = shells(triangles)
    triangles = triangles.copy()
    parts = [np.flatnonzero(label == k) for k in range(count)] if count < 64 else _split(label, count)
    volumes = np.array([enclosed_volume(points, triangles[part]) for part in parts])
    crossing = crossings(points[triangles], triangles)
    cross = np.zeros((count, count), dtype=bool)
    cross[label[crossing[:, 0]], label[crossing[:, 1]]] = True
    cross |= cross.T
    low = np.array([points[triangles[part]].min(axis=(0, 1)) for part in parts])
    high = np.array([points[triangles[part]].max(axis=(0, 1)) for part in parts])
    inside = np.zeros((count, count), dtype=bool)
    for k, part in enumerate(parts):
        boxed = (low <= low[k]).all(axis=1) & (high >= high[k]).all(axis=1) & ~cross[k]
        boxed[k] = False
        place = points[triangles[part[0]]].mean(axis=0)
        for other in np.flatnonzero(boxed).tolist():
            inside[k, other] = encloses(points, triangles[parts[other]], place)
    depth = inside.sum(axis=1)
    cavity = depth % 2 == 1
    turned = (volumes < 0.0) != cavity
    for k in np.flatnonzero(turned).tolist():
        triangles[parts[k]] = triangles[parts[k]][:, ::-1]
    return Nesting(
        triangles, label, np.abs(volumes), depth, _bodies(cross, inside, depth), crossing, int(turned.sum())
    )


def _split(label: IndexArray, count: int) -> list[IndexArray]:
    order = np.argsort(label, kind="stable")
    return np.split(order, np.cumsum(np.bincount(label, minlength=count))[:-1])


def _bodies(cross: BoolArray, inside: BoolArray, depth: IndexArray) -> IndexArray:
    """Shells that are one body: those that cross, and a cavity with the nearest shell around it."""
    joined = cross.copy()
    for k in np.flatnonzero(depth % 2 == 1).tolist():
        around = np.flatnonzero(inside[k])
        joined[k, around[depth[around].argmax()]] = True
    _, body = connected_components(sp.csr_matrix(joined), directed=False)
    return np.asarray(body, dtype=np.int64)
