"""Surfaces that touch: what they are, which may meet, and which cannot be used."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field

import numpy as np

from softsim_core.arrays import Array, IndexArray
from softsim_core.contact.crossing import self_crossing
from softsim_core.errors import SceneError
from softsim_core.mesh.surface import is_closed


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CollisionSurface:
    """A triangle surface, or a sphere, over a range of the global array of collision vertices.

    Attributes:
        name: Name, for messages.
        vertices: Range of its vertices in the global array; surfaces share no vertex. A sphere has one.
        triangles: Global vertex indices, outward by the right-hand rule, shape (k, 3); a sphere has none.
        groups: Names of the groups it belongs to.
        owner: Number of the body it belongs to.
        moving: Whether it can move; two surfaces that cannot never meet.
        soft: Whether it deforms: a sphere may press a dent into it.
        radius: Radius in [m] of a sphere; 0 for triangles.
        closed: Whether the triangles enclose a volume; worked out.
    """

    name: str
    vertices: slice
    triangles: IndexArray = field(default_factory=lambda: np.empty((0, 3), dtype=np.int64))
    groups: frozenset[str] = frozenset()
    owner: int
    moving: bool = True
    soft: bool = False
    radius: float = 0.0
    closed: bool = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "closed", self.radius > 0.0 or is_closed(self.triangles))


def may_meet(a: CollisionSurface, b: CollisionSurface) -> bool:
    """Whether two surfaces are checked against each other.

    A shared group: never. Of one body: only where each has groups. Both standing still: never.
    """
    if a is b or not (a.moving or b.moving) or a.groups & b.groups:
        return False
    return a.owner != b.owner or bool(a.groups and b.groups)


def check_surface(
    points: Array, triangles: IndexArray, name: str, *, closed: bool = False, carried: bool = False
) -> None:
    """Refuse a surface that cannot be used for contact.

    Args:
        points: Vertex positions in [m], shape (n, 3).
        triangles: Vertex indices, shape (k, 3).
        name: What it is called in the message.
        closed: Whether it must enclose a volume (a body with mass).
        carried: Whether it belongs to a rigid body that something carries, such as a link of an arm: one that
            crosses itself is used with a warning then.

    Raises:
        SceneError: it has a triangle without area, crosses itself, or is open where it must be closed.
    """
    corners = points[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1, initial=0.0)
    flat = np.flatnonzero(np.linalg.norm(normals, axis=1) <= 1e-12 * longest**2)
    if len(flat):
        raise SceneError(f"surface {name}: triangle {flat[0]} has no area; remove it or repair the mesh")
    if closed and not is_closed(triangles):
        raise SceneError(
            f"surface {name}: it is open or its triangles are turned unevenly; a body with mass needs a "
            "closed surface, so close its holes and turn all triangles outward"
        )
    crossing = self_crossing(corners, triangles)
    if crossing is not None:
        where = ", ".join(f"{x:.4g}" for x in corners[crossing[0]].mean(axis=0))
        one, other = crossing
        problem = f"surface {name}: triangles {one} and {other} cross each other near ({where}) m"
        if not carried:
            raise SceneError(f"{problem}; repair the mesh so that the surface does not cross itself")
        warnings.warn(
            f"{problem}; what gets between its parts may be pushed the wrong way: repair the mesh, take its "
            "convex hull, or leave the body out of `collisions` (an arm: `touch: false`)",
            stacklevel=3,
        )
