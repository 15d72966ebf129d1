"""Contact detection: pairs of points at which surfaces are locally closest, within a reach."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softsim_core.arrays import Array, IndexArray
from softsim_core.contact.boxes import allocate
from softsim_core.contact.found import allocate_found, allocate_near
from softsim_core.contact.surfaces import CollisionSurface
from softsim_core.contact.sweep import sweep
from softsim_core.contact.topology import build_topology
from softsim_core.scene.objects import ContactSettings

_ROOM = 1024  # pairs of features; doubled when a scene needs more


class Proximities(NamedTuple):
    """k contacts, sorted by key. Point P lies on the pair's first surface (side a), point Q on its second.

    Attributes:
        a: Vertices that carry P, shape (k, 3); those of weight 0 repeat another one.
        a_weights: Their shares, rows sum to 1, shape (k, 3).
        b: Vertices that carry Q, shape (k, 3).
        b_weights: Their shares, shape (k, 3).
        normal: Unit vector from side b to side a, shape (k, 3). P and Q of a sphere are its centre; it
            touches `radius` along the normal away from there.
        distance: Gap between the surfaces along the normal in [m], radii taken off; negative where they
            overlap, shape (k,).
        pair: Numbers of the surfaces, first < second, shape (k, 2).
        key: Number of the pair of features; the same from step to step, unique, shape (k,).
    """

    a: IndexArray
    a_weights: Array
    b: IndexArray
    b_weights: Array
    normal: Array
    distance: Array
    pair: IndexArray
    key: IndexArray


class Detector:
    """Finds where surfaces come close.

    Each contact is a local minimum of the distance: a vertex against a face, an edge or a vertex, or two
    edges; and, so that a sphere may lie in a dent, every vertex of a deformable surface that is hardly
    farther from it than the contact distance. A vertex of one surface that lies inside the other, by up to
    half the reach and with its own surface facing the face it went through, gives a negative distance along
    that face's outward normal.

    Args:
        surfaces: The surfaces, over disjoint ranges of the vertices.
        rest_points: Vertex positions at rest in [m], shape (v, 3).
        settings: Points of one body that lie within the contact distance at rest never meet.

    Source: local minimal distance, Johnson and Willemsen 2003; one triangle per feature, Curtis, Tamstorf
    and Manocha 2008.
    """

    def __init__(
        self, surfaces: tuple[CollisionSurface, ...], rest_points: Array, settings: ContactSettings
    ) -> None:
        self.surfaces = surfaces
        self._rest = np.ascontiguousarray(rest_points, dtype=np.float64)
        self._contact_distance = settings.contact_distance
        self._topology = build_topology(surfaces, self._rest)
        self._boxes = allocate(self._topology)
        self._near, self._found = allocate_near(_ROOM), allocate_found(_ROOM)

    def detect(self, points: Array, reach: float, travel: Array | None = None) -> Proximities:
        """Contacts with a gap of at most `reach`, and what the two surfaces may move.

        Args:
            points: Vertex positions in [m], shape (v, 3).
            reach: Largest gap in [m] of surfaces that stand still: the alarm distance.
            travel: How far each surface may move within the step in [m], shape (s,); None: not at all.
        """
        travel = np.zeros(len(self.surfaces)) if travel is None else travel
        points = np.ascontiguousarray(points, dtype=np.float64)
        while True:
            near, found = self._near, self._found
            needed = sweep(
                points,
                self._rest,
                reach,
                travel,
                self._contact_distance,
                self._topology,
                self._boxes,
                near,
                found,
            )
            if needed <= len(found.distance):
                break
            self._near, self._found = allocate_near(2 * needed), allocate_found(2 * needed)
        count = found.counter[0]
        order = np.argsort(found.key[:count], kind="stable")
        return Proximities(
            a=found.a[order],
            a_weights=found.a_weights[order],
            b=found.b[order],
            b_weights=found.b_weights[order],
            normal=found.normal[order],
            distance=found.distance[order],
            pair=found.pair[order],
            key=found.key[order],
        )
