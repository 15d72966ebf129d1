"""Triangle counts and edge lengths for a mesh with about the requested number of nodes."""

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
"""A surface with more triangles is simplified before it is filled."""


def simplify_surface(surface: SurfaceMesh, most: int = MOST_TRIANGLES) -> SurfaceMesh:
    """Simplify a surface to at most about `most` triangles; return the surface itself if it has no more.

    Edges are contracted where that changes the surface least. It must be closed and consistently oriented.

    Raises:
        MeshError: the required package is not installed.

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
"""Tolerance as a part of the requested number of nodes."""
MOST_TRIES = 6
_EXPONENT = 2.5  # nodes scale with edge^-3 inside and edge^-2 along walls; measured values lie between
_STUCK = 0.9  # if longer edges leave more than this part of the nodes, the surface needs them
_NODES_PER_CUBE = 2.2  # of a compact part: nodes times edge cubed over volume


class Sized(NamedTuple):
    """A mesh with about the requested number of nodes.

    Attributes:
        mesh: The mesh.
        edge: Length of edges in [m] that was requested from the mesher.
        tries: Number of runs of the mesher.
    """

    mesh: TetMesh
    edge: float
    tries: int


def with_nodes(
    fill: Callable[[float], TetMesh], volume: float, longest: float, nodes: int, tolerance: float = TOLERANCE
) -> Sized:
    """Return the mesh nearest to a requested number of nodes, within a tolerance of it or after MOST_TRIES.

    A failed try ends the search; meshes from before are still used.

    Args:
        fill: Function that makes a mesh with edges of about a length in [m].
        volume: Volume of the part in [m^3].
        longest: Longest edges in [m] to try: a curved surface needs its nodes for edges of any length.
        nodes: Requested number of nodes, including those on edges of quadratic cells.
        tolerance: Tolerance as a part of that number.

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
        if count > nodes and len(found) > 1:
            before, many = found[-2]
            if before < edge and count > _STUCK * len(many.points):
                break
        edge = min(_next_edge([(each, len(mesh.points)) for each, mesh in found], nodes), longest)
    best, mesh = min(found, key=lambda each: abs(math.log(len(each[1].points) / nodes)))
    return Sized(mesh, best, len(found))


def _next_edge(found: list[tuple[float, int]], nodes: int) -> float:
    """Return the edge length for `nodes` from a power law through the nearest tries, or the last one."""
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
