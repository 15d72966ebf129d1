"""Checks and figures of a tetrahedral mesh: counts, volume, element shapes; unusable meshes are refused."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace

import numpy as np

from softsim_core.base import Array, IndexArray, MeshError, unique_pairs
from softsim_core.physics.mesh.types import TET_FACES, TetMesh, subdivide_mesh

SLIVER_ANGLE_DEG = 10.0
"""A tetrahedron with a dihedral angle below this, in [deg], counts as a sliver."""

_FLAT = 1.0e-10  # six times the volume over the cube of the longest edge: below it, a volume is round-off
_EDGES = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])


@dataclass(frozen=True, slots=True)
class MeshReport:
    """Figures of a mesh that passed `check_tets`.

    Attributes:
        nodes: Number of nodes.
        elements: Number of tetrahedra.
        volume: Sum of absolute volumes in [m^3].
        inverted: Number of tetrahedra with negative orientation.
        slivers: Number of tetrahedra with a dihedral angle below SLIVER_ANGLE_DEG.
        duplicate_nodes: Number of nodes at exactly the position of an earlier node.
        min_dihedral_deg: Smallest dihedral angle in [deg].
        max_dihedral_deg: Largest dihedral angle in [deg].
        min_radius_ratio: Worst 3 (inscribed radius) / (circumscribed radius); a regular tetrahedron has 1.
        mean_radius_ratio: Mean of this ratio.
        min_edge: Shortest edge in [m].
        mean_edge: Mean over the distinct edges in [m].
        max_edge: Longest edge in [m].
        warnings: Messages about accepted flaws that may reduce accuracy.
    """

    nodes: int
    elements: int
    volume: float
    inverted: int
    slivers: int
    duplicate_nodes: int
    min_dihedral_deg: float
    max_dihedral_deg: float
    min_radius_ratio: float
    mean_radius_ratio: float
    min_edge: float
    mean_edge: float
    max_edge: float
    warnings: tuple[str, ...]


def check_tets(mesh: TetMesh) -> MeshReport:
    """Return figures of a mesh, with warnings for slivers, negative orientation and coincident nodes.

    Angles, radii and edges of quadratic cells are those of their corners.

    Raises:
        MeshError: arrays of a wrong shape, no element, an index out of range, coordinates that are not
            finite, elements of zero volume, quadratic ones that fold, the same element twice, or nodes that
            no element uses.
    """
    check_arrays(mesh.points, mesh.tets, 10 if mesh.order == 2 else 4, mesh.name)
    n, m, tets = len(mesh.points), len(mesh.tets), mesh.tets[:, :4]
    volumes = tet_volumes(mesh.points, tets)
    inside = tet_volumes(mesh.points, subdivide_mesh(mesh).tets).reshape(m, -1)
    _refuse_unusable(mesh, volumes, inside)

    edges = unique_pairs(np.sort(tets[:, _EDGES].reshape(-1, 2), axis=1))
    lengths = np.linalg.norm(mesh.points[edges[:, 0]] - mesh.points[edges[:, 1]], axis=1)
    angles = dihedral_angles_deg(mesh.points, tets)
    ratios = radius_ratios(mesh.points, tets)
    slivers = np.flatnonzero(angles.min(axis=1) < SLIVER_ANGLE_DEG)
    inverted = np.flatnonzero(volumes < 0.0)
    duplicates = n - len(np.unique(mesh.points, axis=0))
    warnings = []
    if len(slivers):
        warnings.append(
            f"mesh {mesh.name}: {len(slivers)} of {m} elements are slivers (a dihedral angle below "
            f"{SLIVER_ANGLE_DEG:g} degrees, the smallest {angles.min():.2f}; first: element {slivers[0]}); "
            "accepted, but stresses there are unreliable"
        )
    if len(inverted):
        warnings.append(
            f"mesh {mesh.name}: {len(inverted)} of {m} elements have negative orientation "
            f"(first: element {inverted[0]}); accepted, their volume is taken absolute"
        )
    if duplicates:
        warnings.append(
            f"mesh {mesh.name}: {duplicates} of {n} nodes lie exactly on an earlier node; accepted, "
            "but parts that only touch there are not joined"
        )
    return MeshReport(
        nodes=n,
        elements=m,
        volume=float(np.abs(inside).sum()),
        inverted=len(inverted),
        slivers=len(slivers),
        duplicate_nodes=duplicates,
        min_dihedral_deg=float(angles.min()),
        max_dihedral_deg=float(angles.max()),
        min_radius_ratio=float(ratios.min()),
        mean_radius_ratio=float(ratios.mean()),
        min_edge=float(lengths.min()),
        mean_edge=float(lengths.mean()),
        max_edge=float(lengths.max()),
        warnings=tuple(warnings),
    )


def drop_unused_nodes(mesh: TetMesh) -> TetMesh:
    """Return the mesh without nodes that no cell uses; warns if there are any.

    Faces and nodes of the mesh's groups that lie on such nodes go with them, and groups that are left empty.
    """
    used = np.zeros(len(mesh.points), dtype=bool)
    used[mesh.tets] = True
    if used.all():
        return mesh
    warnings.warn(
        f"mesh {mesh.name}: {np.count_nonzero(~used)} of {len(used)} nodes belong to no cell and are "
        f"dropped, the first is node {int(np.argmin(used))} (counted from 0)",
        stacklevel=2,
    )
    number = np.cumsum(used) - 1
    surfaces = {name: number[faces[used[faces].all(axis=1)]] for name, faces in mesh.surfaces.items()}
    groups = {name: number[nodes[used[nodes]]] for name, nodes in mesh.groups.items()}
    return replace(
        mesh,
        points=mesh.points[used],
        tets=number[mesh.tets],
        surfaces={name: faces for name, faces in surfaces.items() if len(faces)},
        groups={name: nodes for name, nodes in groups.items() if len(nodes)},
        blocks={kind: replace(block, cells=number[block.cells]) for kind, block in mesh.blocks.items()},
    )


def check_arrays(points: Array, cells: IndexArray, corners: int, name: str, kind: str | None = None) -> None:
    """Refuse arrays that do not form a mesh.

    Args:
        points: Coordinates, must be finite and of shape (n, 3).
        cells: Indices, must be of shape (m, corners), m >= 1, and in 0..n-1.
        corners: Nodes of a cell: 4 or 10 for tetrahedra, 3 for triangles.
        name: Origin of the mesh, for messages.
        kind: Name of the cells in messages; None: triangles or tetrahedra.

    Raises:
        MeshError: names the error and its first place.
    """
    kind = kind or ("triangles" if corners == 3 else "tetrahedra")
    if points.ndim != 2 or points.shape[1] != 3:
        raise MeshError(name, f"coordinates have shape {points.shape}, they must have shape (n, 3)")
    if cells.ndim != 2 or cells.shape[1] != corners:
        raise MeshError(name, f"{kind} have shape {cells.shape}, they must have shape (m, {corners})")
    if len(points) == 0:
        raise MeshError(name, "holds no points; export the mesh again")
    if len(cells) == 0:
        raise MeshError(name, f"holds no {kind}; export the mesh with {kind}")
    bad_points = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if len(bad_points):
        first = bad_points[0]
        raise MeshError(
            name,
            f"{len(bad_points)} of {len(points)} points have coordinates that are not finite, "
            f"the first is point {first} {points[first].tolist()}; export the mesh again",
        )
    bad_cells = np.flatnonzero(((cells < 0) | (cells >= len(points))).any(axis=1))
    if len(bad_cells):
        first = bad_cells[0]
        raise MeshError(
            name,
            f"{len(bad_cells)} of {len(cells)} {kind} name a point outside 0..{len(points) - 1}, "
            f"the first is number {first} {cells[first].tolist()} (counted from 0); "
            "the file is damaged or cut off",
        )


def tet_volumes(points: Array, tets: IndexArray) -> Array:
    """Return signed volumes in [m^3], shape (m,): positive if (b - a) × (c - a) · (d - a) > 0."""
    corners = points[tets]
    return np.asarray(np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6.0)


def radius_ratios(points: Array, tets: IndexArray) -> Array:
    """Return 3 (inscribed) / (circumscribed radius), shape (m,): 1 if regular, 0 if flat."""
    corners = points[tets]
    edges = corners[:, 1:] - corners[:, :1]
    volumes = np.abs(np.linalg.det(edges)) / 6.0
    surface = np.linalg.norm(_face_normals(corners), axis=2).sum(axis=1)
    u, v, w = edges[:, 0], edges[:, 1], edges[:, 2]
    squares = (edges**2).sum(axis=2)
    to_centre = (
        squares[:, 0, None] * np.cross(v, w)
        + squares[:, 1, None] * np.cross(w, u)
        + squares[:, 2, None] * np.cross(u, v)
    )
    # inscribed r = 3 V / S, circumscribed R = |to_centre| / (12 V)
    return np.asarray(108.0 * volumes**2 / (surface * np.linalg.norm(to_centre, axis=1)))


def dihedral_angles_deg(points: Array, tets: IndexArray) -> Array:
    """Return the six angles between faces in [deg], shape (m, 6)."""
    normals = _face_normals(points[tets])
    one, other = normals[:, _EDGES[:, 0]], normals[:, _EDGES[:, 1]]
    sine = np.linalg.norm(np.cross(one, other), axis=2)
    cosine = -np.einsum("mei,mei->me", one, other)
    return np.asarray(np.degrees(np.arctan2(sine, cosine)))


def _face_normals(corners: Array) -> Array:
    """Return area vectors of the four faces of each tetrahedron, (m, 4, 3), from corners (m, 4, 3)."""
    faces = corners[:, TET_FACES]
    return np.asarray(0.5 * np.cross(faces[:, :, 1] - faces[:, :, 0], faces[:, :, 2] - faces[:, :, 0]))


def _refuse_unusable(mesh: TetMesh, volumes: Array, parts: Array) -> None:
    """Refuse unused nodes, and repeated, flat or folded cells.

    `volumes` (m,) are those of the corners, `parts` (m, p) those of the linear tetrahedra within each cell.
    """
    m = len(mesh.tets)
    unused = np.flatnonzero(np.bincount(mesh.tets.reshape(-1), minlength=len(mesh.points)) == 0)
    if len(unused):
        raise MeshError(
            mesh.name,
            f"{len(unused)} of {len(mesh.points)} nodes belong to no tetrahedron, the first is node "
            f"{unused[0]} (counted from 0); export the mesh without them, or call drop_unused_nodes",
        )
    _, first, inverse = np.unique(np.sort(mesh.tets, axis=1), axis=0, return_index=True, return_inverse=True)
    repeated = np.flatnonzero(first[inverse.reshape(-1)] != np.arange(m))
    if len(repeated):
        raise MeshError(
            mesh.name,
            f"{len(repeated)} of {m} elements repeat an earlier one, the first is element {repeated[0]} with "
            f"nodes {mesh.tets[repeated[0]].tolist()}; export each element once",
        )
    corners = mesh.points[mesh.tets]
    longest = np.linalg.norm(corners[:, _EDGES[:, 0]] - corners[:, _EDGES[:, 1]], axis=2).max(axis=1)
    flat = np.flatnonzero(6.0 * np.abs(volumes) <= _FLAT * longest**3)
    if len(flat):
        raise MeshError(
            mesh.name,
            f"{len(flat)} of {m} elements have zero volume, the first is element {flat[0]} "
            f"with nodes {mesh.tets[flat[0]].tolist()} (counted from 0); mesh the part again",
        )
    folded = np.flatnonzero((parts * volumes[:, None] <= 0.0).any(axis=1))
    if len(folded):
        raise MeshError(
            mesh.name,
            f"{len(folded)} of {m} quadratic elements are so curved that they fold, the first is element "
            f"{folded[0]} (counted from 0); move the nodes on its edges, or export a linear mesh",
        )
