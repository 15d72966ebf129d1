"""Fewer triangles where a surface has far more than its mesh can follow."""

from __future__ import annotations

import importlib
import importlib.util

import numpy as np

from softsim_core.errors import MeshError
from softsim_core.extras import install_command
from softsim_core.mesh.types import SurfaceMesh

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
