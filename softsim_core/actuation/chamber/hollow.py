"""Which faces of a body a chamber presses on: all its hollows, one of them, or a named surface."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from softsim_core.actuation.building import Surroundings
from softsim_core.actuation.chamber.description import ChamberDescription
from softsim_core.arrays import Array, IndexArray
from softsim_core.errors import SceneError, listing
from softsim_core.mechanics.model import FIXED
from softsim_core.mesh import TetMesh
from softsim_core.mesh.faces import boundary_faces, cavities, encloses, turned

FLAT = 0.02
"""A rim may leave its plane by this part of its radius."""


class Hollow(NamedTuple):
    """What encloses a chamber.

    Attributes:
        faces: Node indices of its faces in the body's mesh, pointing out of the hollow, shape (m, a).
        lids: Places in [m] of the nodes of faces that fixed plates close it with, shape (k, a, 3).
    """

    faces: IndexArray
    lids: Array


def hollow_of(name: str, described: ChamberDescription, surroundings: Surroundings) -> Hollow:
    """The hollow of a chamber of a name.

    Raises:
        SceneError: there is none such as described, or it is open.
    """
    mesh = surroundings.meshes[described.body]
    if described.surface is not None:
        return _of_surface(name, described.surface, described.body, surroundings)
    faces = closed_hollow(name, described, mesh)
    return Hollow(faces, np.zeros((0, faces.shape[1], 3)))


def closed_hollow(name: str, described: ChamberDescription, mesh: TetMesh) -> IndexArray:
    """Faces of a chamber that its body's mesh closes all around, shape (k, 3) or (k, 6).

    Raises:
        SceneError: there is none, or none around the chamber's place.
    """
    found = cavities(mesh)
    if not found:
        raise SceneError(
            f"chamber {name}: body {described.body} encloses no hollow; a chamber needs one that its mesh "
            "closes all around, or a named `surface` that ends at the world"
        )
    return _chosen(name, described, mesh, found)


def _chosen(name: str, described: ChamberDescription, mesh: TetMesh, found: list[IndexArray]) -> IndexArray:
    """All hollows, or the one around a place."""
    if described.inside is None:
        return np.concatenate(found)
    place = np.array(described.inside, dtype=float)
    around = [faces for faces in found if encloses(mesh.points, faces, place)]
    if not around:
        middles = [mesh.points[np.unique(faces)].mean(axis=0).round(6).tolist() for faces in found]
        raise SceneError(
            f"chamber {name}: {place.tolist()} m lies in no hollow of body {described.body}; the middles of "
            f"its hollows are {middles} m"
        )
    return around[0]


def _of_surface(name: str, surface: str, body: str, surroundings: Surroundings) -> Hollow:
    mesh = surroundings.meshes[body]
    if surface not in mesh.surfaces:
        known = f"its surfaces are {listing(mesh.surfaces)}" if mesh.surfaces else "its mesh names none"
        raise SceneError(
            f"chamber {name}: body {body} has no surface {surface!r}: {known}; name a physical group of "
            "faces in its Gmsh file"
        )
    faces = turned(boundary_faces(mesh))
    rows = {tuple(sorted(corners)): k for k, corners in enumerate(faces[:, :3].tolist())}
    wanted = [rows.get(tuple(sorted(corners)), -1) for corners in mesh.surfaces[surface].tolist()]
    if -1 in wanted:
        raise SceneError(
            f"chamber {name}: {wanted.count(-1)} of the {len(wanted)} faces of surface {surface!r} are no "
            f"boundary of body {body}; name faces that its cells leave free"
        )
    faces = faces[np.unique(wanted)]
    lids = _lids(name, surface, faces, mesh.points, _held(surroundings, body))
    corners = np.concatenate([mesh.points[faces[:, :3]], lids[:, :3]])
    middle = corners.mean(axis=(0, 1))
    a, b, c = np.moveaxis(corners - middle, 1, 0)
    if np.einsum("ki,ki->", a, np.cross(b, c)) <= 0.0:
        raise SceneError(
            f"chamber {name}: surface {surface!r} goes around body {body} from outside; name the faces "
            "of a hollow"
        )
    return Hollow(faces, lids)


def _held(surroundings: Surroundings, body: str) -> IndexArray:
    """Nodes of a body that are attached to the world, in the numbers of its own mesh."""
    first, count = surroundings.first_node[body], len(surroundings.meshes[body].points)
    return np.flatnonzero(surroundings.model.region_of_node[first : first + count] == FIXED)


def _lids(name: str, surface: str, faces: IndexArray, points: Array, held: IndexArray) -> Array:
    """Faces that close an open surface by plates, a fan in each opening; see Hollow.lids."""
    sides = np.concatenate(
        [faces[:, [k, (k + 1) % 3, *([3 + k] if faces.shape[1] == 6 else [])]] for k in range(3)]
    )
    _, first, counts = np.unique(np.sort(sides[:, :2], axis=1), axis=0, return_index=True, return_counts=True)
    rim = sides[first[counts == 1]]
    if (counts > 2).any():
        raise SceneError(
            f"chamber {name}: an edge of surface {surface!r} has more than two faces; mend its mesh"
        )
    loose = ~np.isin(rim, held).all(axis=1)
    if loose.any():
        place = points[rim[np.flatnonzero(loose)[0], :2]].mean(axis=0).round(6).tolist()
        raise SceneError(
            f"chamber {name}: surface {surface!r} is open, at {int(loose.sum())} edges that are not attached "
            f"to the world (one at {place} m); close it, or attach its rim to the plate that closes it"
        )
    _, opening = connected_components(
        sp.coo_matrix((np.ones(len(rim)), rim[:, :2].T), shape=(len(points),) * 2), directed=False
    )
    found = [np.zeros((0, faces.shape[1], 3))]
    for one in np.unique(opening[rim[:, 0]]).tolist():
        edges = rim[opening[rim[:, 0]] == one]
        places = points[np.unique(edges)]
        middle = places.mean(axis=0)
        _, sizes, _ = np.linalg.svd(places - middle)
        if sizes[2] > FLAT * sizes[1]:
            raise SceneError(
                f"chamber {name}: the rim of surface {surface!r} around {middle.round(6).tolist()} m is not "
                "flat, and no plate closes it; let the surface end in a plane"
            )
        a, b, c = points[edges[:, 1]], points[edges[:, 0]], np.broadcast_to(middle, (len(edges), 3))
        fan = [a, b, c]
        if faces.shape[1] == 6:
            fan += [points[edges[:, 2]], 0.5 * (b + c), 0.5 * (c + a)]
        found.append(np.stack(fan, axis=1))
    return np.concatenate(found)
