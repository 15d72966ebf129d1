"""Triangles and edge lengths that suit a mesh of about as many nodes as are wished."""

from __future__ import annotations

import importlib
import importlib.util
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from softsim_core.base import MeshError, install_command
from softsim_core.physics.mesh import SurfaceMesh, TetMesh

MOST_TRIANGLES = 40_000
"""More than these are made fewer before the surface is filled."""


def simplified(surface: SurfaceMesh, most: int = MOST_TRIANGLES) -> SurfaceMesh:
    """A surface of at most about so many triangles; itself where it has no more.

    Edges are contracted where that moves the surface least.

    Args:
        surface: Closed, turned alike.
        most: Number of triangles, >= 4.

    Raises:
        MeshError: the package that does it is not installed.

    Source: Garland, Heckbert 1997, Surface simplification using quadric error metrics.
    """
    count = len(surface.triangles)
    if count <= most:
        return surface
    if importlib.util.find_spec("fast_simplification") is None:
        raise MeshError(
            surface.name,
            f"has {count} triangles, and more than {most} need fast-simplification; "
            f"{install_command('mesh')}, or export it with a coarser tolerance",
        )
    middle = surface.points.mean(axis=0)
    scale = float(np.ptp(surface.points, axis=0).max())
    points, triangles = importlib.import_module("fast_simplification").simplify(
        np.ascontiguousarray((surface.points - middle) / scale),
        np.ascontiguousarray(surface.triangles, dtype=np.int32),
        target_count=most,
    )
    return SurfaceMesh(
        middle + scale * np.asarray(points, dtype=np.float64),
        np.ascontiguousarray(triangles, dtype=np.int64),
        surface.name,
    )


TOLERANCE = 0.15
"""Of the wished number of nodes."""
MOST_TRIES = 6
_EXPONENT = 2.5  # nodes go with edge^-3 inside and edge^-2 along walls: measured between them
_STUCK = 0.9  # longer edges that leave more than this share of the nodes: the surface needs them
_NODES_PER_CUBE = 2.2  # of a compact part: nodes times edge cubed over volume


class Sized(NamedTuple):
    """A mesh of about a wished size.

    Attributes:
        mesh: The mesh.
        edge: Length of edges in [m] that was asked of the mesher.
        tries: How often it was asked.
    """

    mesh: TetMesh
    edge: float
    tries: int


def with_nodes(
    fill: Callable[[float], TetMesh], volume: float, longest: float, nodes: int, tolerance: float = TOLERANCE
) -> Sized:
    """The mesh nearest to a wished number of nodes, within a tolerance of it or after MOST_TRIES.

    A try that fails ends the search; meshes that were made before it are not lost.

    Args:
        fill: Makes a mesh with edges of about a length in [m].
        volume: Of the part in [m^3].
        longest: Longest edges in [m] that are tried: a curved surface needs its nodes, however long they are.
        nodes: Wished number of nodes, those on edges of quadratic cells included.
        tolerance: Share of that number by which the mesh may miss it.

    Raises:
        MeshError: the number is less than 4, or the mesher fails at the first try.
    """
    if nodes < 4:
        raise MeshError("", f"{nodes} nodes are too few for one tetrahedron; ask for 50 or more")
    edge = min((_NODES_PER_CUBE * volume / nodes) ** (1.0 / 3.0), longest)
    found: list[tuple[float, TetMesh]] = []
    for _ in range(MOST_TRIES):
        try:
            found.append((edge, fill(edge)))
        except MeshError:
            if not found:
                raise
            break
        count = len(found[-1][1].points)
        if abs(count / nodes - 1.0) <= tolerance or (count > nodes and edge >= longest):
            break
        if count > nodes and _stuck(found):
            break
        edge = min(_next_edge([(each, len(mesh.points)) for each, mesh in found], nodes), longest)
    best, mesh = min(found, key=lambda each: abs(math.log(len(each[1].points) / nodes)))
    return Sized(mesh, best, len(found))


def _stuck(found: list[tuple[float, TetMesh]]) -> bool:
    """Whether longer edges left almost as many nodes."""
    if len(found) < 2:
        return False
    (before, many), (edge, mesh) = found[-2:]
    return before < edge and len(mesh.points) > _STUCK * len(many.points)


def _next_edge(found: list[tuple[float, int]], nodes: int) -> float:
    """The length where a power law through what is nearest on both sides, or through the last, meets it."""
    more = [each for each in found if each[1] > nodes]
    less = [each for each in found if each[1] < nodes]
    if more and less:
        (short, many), (long, few) = max(more), min(less)
        if short < long:
            share = math.log(nodes / few) / math.log(many / few)
            ratio: float = (short / long) ** min(max(share, 0.1), 0.9)
            return long * ratio
    edge, count = found[-1]
    factor: float = (count / nodes) ** (1.0 / _EXPONENT)
    return edge * min(max(factor, 0.25), 4.0)
