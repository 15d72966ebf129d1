"""Surfaces and mass properties of rigid bodies: sphere, box, cylinder, plane, closed meshes."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field

import numpy as np

from softsim_core.base import LOCAL, Array, FieldError, IndexArray, MeshError, MeshFile, SceneError, Vector
from softsim_core.physics.mesh.readers import read_surface
from softsim_core.physics.mesh.surface import enclosed_volume, is_closed
from softsim_core.physics.mesh.types import SurfaceMesh

_SEGMENTS = 32
_REFINEMENTS = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Shape:
    """The surface of a rigid body, in its own frame, centred on the origin; exactly one field is given.

    Attributes:
        sphere: Radius in [m]; collides as an exact sphere.
        box: Edge lengths along x, y, z in [m].
        cylinder: Radius and height (along z) in [m].
        plane: Edge lengths along x and y in [m] of a rectangle with its normal along +z.
        mesh: A closed surface; with mass, its frame's origin is moved to the centre of mass.
    """

    sphere: float | None = None
    box: Vector | None = None
    cylinder: tuple[float, float] | None = None
    plane: tuple[float, float] | None = None
    mesh: MeshFile | None = field(default=None, metadata=LOCAL)

    def __post_init__(self) -> None:
        defined = [
            each for each in (self.sphere, self.box, self.cylinder, self.plane, self.mesh) if each is not None
        ]
        if len(defined) != 1:
            raise SceneError("shape: give exactly one of sphere, box, cylinder, plane and mesh")
        sizes = defined[0] if isinstance(defined[0], tuple) else (defined[0],)
        for size in sizes:
            if isinstance(size, (int, float)) and not 0.0 < size < math.inf:
                raise FieldError("shape", "size", size, "> 0 m")


def surface_of(shape: Shape) -> SurfaceMesh:
    """Return the surface of a shape in its own frame, outward; closed, except a plane.

    A sphere and a cylinder are polyhedra with their vertices on the true surface; a sphere's is for display
    only.

    Raises:
        MeshError: the file of a mesh cannot be used.
    """
    if shape.sphere is not None:
        return sphere_surface(shape.sphere)
    if shape.box is not None:
        return box_surface(shape.box)
    if shape.cylinder is not None:
        return cylinder_surface(*shape.cylinder)
    if shape.plane is not None:
        x, y = 0.5 * shape.plane[0], 0.5 * shape.plane[1]
        corners = np.array([[-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0]])
        return SurfaceMesh(corners, np.array([[0, 1, 2], [0, 2, 3]]), "plane")
    assert shape.mesh is not None
    return read_surface(shape.mesh.file, shape.mesh.placement)


def mass_properties(shape: Shape, surface: SurfaceMesh, mass: float) -> tuple[Array, Array]:
    """Return centre of mass and inertia of a solid of uniform density; exact for primitives.

    Args:
        shape: The shape.
        surface: Its surface in [m], from `surface_of`.
        mass: Mass in [kg], > 0.

    Returns:
        Centre in [m], shape (3,), and inertia about it in [kg m^2], shape (3, 3), in the shape's axes.

    Raises:
        MeshError: the surface is open, or winds inward.
    """
    if shape.sphere is not None:
        return np.zeros(3), 0.4 * mass * shape.sphere**2 * np.eye(3)
    if shape.box is not None:
        squares = np.array(shape.box) ** 2
        return np.zeros(3), mass / 12.0 * np.diag(squares.sum() - squares)
    if shape.cylinder is not None:
        radius, height = shape.cylinder
        across = (3.0 * radius**2 + height**2) / 12.0
        return np.zeros(3), mass * np.diag([across, across, 0.5 * radius**2])
    return solid_properties(surface, mass)


def solid_properties(surface: SurfaceMesh, mass: float) -> tuple[Array, Array]:
    """Return centre of mass and inertia of the volume in a closed surface, by the divergence theorem.

    Every triangle spans a tetrahedron with the mean of the points; signed volumes make their sum exact.

    Args:
        surface: Closed outward surface in [m].
        mass: Mass in [kg], > 0.

    Returns:
        As for `mass_properties`.

    Raises:
        MeshError: the surface is open, or winds inward.
    """
    if not is_closed(surface.triangles):
        raise MeshError(
            surface.name,
            "the surface of a body with mass must be closed and wound one way; "
            "close its holes, or give the body no mass",
        )
    volume = enclosed_volume(surface.points, surface.triangles)
    if not volume > 0.0:
        raise MeshError(surface.name, "the surface winds inward; reverse its triangles")
    middle = surface.points.mean(axis=0)
    corners = surface.points[surface.triangles] - middle
    sixfold = np.linalg.det(corners)
    centre = np.einsum("k,kci->i", sixfold, corners) / (24.0 * volume)
    sums = corners.sum(axis=1)
    pairs = np.einsum("k,kci,kcj->ij", sixfold, corners, corners)
    pairs = pairs + np.einsum("k,ki,kj->ij", sixfold, sums, sums)
    second = mass * (pairs / (120.0 * volume) - np.outer(centre, centre))
    return middle + centre, np.trace(second) * np.eye(3) - second


def sphere_surface(radius: float, refinements: int = _REFINEMENTS) -> SurfaceMesh:
    """Return an icosahedron with vertices on the sphere, each triangle cut into four `refinements` times."""
    golden = 0.5 * (1.0 + math.sqrt(5.0))
    signs = list(itertools.product((-1.0, 1.0), repeat=2))
    points = np.array([np.roll([0.0, a, b * golden], shift) for shift in range(3) for a, b in signs])
    points = points / math.hypot(1.0, golden)
    edge = np.linalg.norm(points[:, None] - points[None], axis=2)
    near = np.isclose(edge, edge[edge > 0.0].min())
    corners = np.array(list(itertools.combinations(range(12), 3)))
    triangles = corners[near[corners, np.roll(corners, 1, axis=1)].all(axis=1)]
    inward = np.linalg.det(points[triangles]) < 0.0
    triangles[inward] = triangles[inward][:, ::-1]
    for _ in range(refinements):
        points, triangles = _refine_surface(points, triangles)
        points /= np.linalg.norm(points, axis=1, keepdims=True)
    return SurfaceMesh(radius * points, triangles, "sphere")


def box_surface(lengths: tuple[float, float, float], divisions: int = 1) -> SurfaceMesh:
    """Return a box with 2 divisions² triangles per face.

    Args:
        lengths: Edge lengths along x, y, z in [m].
        divisions: Squares along every edge, >= 1.
    """
    steps = np.arange(divisions + 1)
    lattice = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1)
    first = lattice[:-1, :-1].reshape(-1, 2)
    squares = np.stack([first + shift for shift in ((0, 0), (1, 0), (1, 1), (0, 1))], axis=1)
    plane = squares[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 2)
    corners = []
    for axis, side in itertools.product(range(3), (0, divisions)):
        face = np.full((len(plane), 3), side)
        along = [(axis + 1) % 3, (axis + 2) % 3]
        face[:, along if side else along[::-1]] = plane
        corners.append(face)
    places, index = np.unique(np.concatenate(corners), axis=0, return_inverse=True)
    points = (places / divisions - 0.5) * np.array(lengths)
    return SurfaceMesh(points, index.reshape(-1, 3).astype(np.int64), "box")


def cylinder_surface(radius: float, height: float, segments: int = _SEGMENTS) -> SurfaceMesh:
    """Return a prism with its vertices on the cylinder about z.

    Args:
        radius: Radius in [m].
        height: Height in [m]; from -height / 2 to height / 2.
        segments: Sides of the prism, >= 3.
    """
    angles = 2.0 * np.pi * np.arange(segments) / segments
    circle = radius * np.column_stack([np.cos(angles), np.sin(angles)])
    low = np.column_stack([circle, np.full(segments, -0.5 * height)])
    ends = np.array([[0.0, 0.0, -0.5 * height], [0.0, 0.0, 0.5 * height]])
    points = np.concatenate([low, low * [1.0, 1.0, -1.0], ends])
    here = np.arange(segments)
    there = np.roll(here, -1)
    bottom, top = np.full(segments, 2 * segments), np.full(segments, 2 * segments + 1)
    triangles = [
        (here, there, there + segments),
        (here, there + segments, here + segments),
        (bottom, there, here),
        (top, here + segments, there + segments),
    ]
    return SurfaceMesh(points, np.concatenate([np.column_stack(each) for each in triangles]), "cylinder")


def _refine_surface(points: Array, triangles: IndexArray) -> tuple[Array, IndexArray]:
    """Return the surface with every triangle cut into four at the middles of its edges."""
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    distinct, index = np.unique(edges, axis=0, return_inverse=True)
    ab, bc, ca = (len(points) + index.reshape(-1, 3)).T
    a, b, c = triangles.T
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    middles = 0.5 * (points[distinct[:, 0]] + points[distinct[:, 1]])
    return np.concatenate([points, middles]), np.concatenate([np.column_stack(part) for part in parts])
