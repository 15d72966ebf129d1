r"""Definition of an element: nodes per cell, quadrature, and shape gradients at the quadrature points.

A cell with node positions :math:`x_a` maps reference coordinates :math:`\xi` to
:math:`x(\xi) = \sum_a N_a(\xi) x_a`. At a quadrature point of reference weight :math:`\hat w_q`, with the
rest positions :math:`X_a`,

.. math:: J_{ij} = \sum_a X_{ai} \partial N_a / \partial \xi_j, \qquad w_q = \hat w_q |\det J|, \qquad
    g_a = J^{-T} \partial N_a / \partial \xi, \qquad F = \sum_a x_a g_a^T .

An element is therefore pure data: forces, tangents and stresses need nothing but these arrays.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from softsim_core.base import Array, IndexArray, MeshError


class Element(Protocol):
    """A kind of cell.

    Attributes:
        name: Name used in scenes.
        reference: Reference coordinates of the nodes, shape (a, 3).
        points: Quadrature points in reference coordinates, shape (q, 3).
        weights: Their weights, all > 0; their sum is the volume of the reference cell, shape (q,).
        slopes: Derivatives of the shape functions by the reference coordinates at the points, (q, a, 3).
            Over the nodes they sum to zero, and `reference` times them is the identity.
        edges: Node pairs along the cell's edges, for pictures, shape (e, 2).
        faces: Node numbers of the cell's faces, seen from outside counter-clockwise, shape (f, k).
        mass_shares: Part of a cell's mass that each node carries; they are >= 0, their sum is 1, shape (a,).
        mass_matrix: Integrals of N_a N_b over a cell of volume 1, whose sum is 1, shape (a, a), or None.
        kind: Kind of cells of a mesh, by meshio's name, that it fills unless a scene names another element;
            empty: none.
        mean_volume: Whether the bulk of a VolumetricMaterial beyond `point_bulk` acts on the cell's mean
            dilatation, not on that of each point.
        point_ratio: Largest lambda / mu that then acts at each point.
    """

    @property
    def name(self) -> str: ...  # noqa: D102 (documented above, like the rest)
    @property
    def reference(self) -> Array: ...  # noqa: D102
    @property
    def points(self) -> Array: ...  # noqa: D102
    @property
    def weights(self) -> Array: ...  # noqa: D102
    @property
    def slopes(self) -> Array: ...  # noqa: D102
    @property
    def edges(self) -> IndexArray: ...  # noqa: D102
    @property
    def faces(self) -> IndexArray: ...  # noqa: D102
    @property
    def mass_shares(self) -> Array: ...  # noqa: D102
    @property
    def mass_matrix(self) -> Array | None: ...  # noqa: D102
    @property
    def kind(self) -> str: ...  # noqa: D102
    @property
    def mean_volume(self) -> bool: ...  # noqa: D102
    @property
    def point_ratio(self) -> float: ...  # noqa: D102


@dataclass(frozen=True, slots=True, eq=False)
class ElementData:
    """An element given by its arrays; see Element. Without `shares`, all nodes carry the same mass."""

    name: str
    reference: Array
    points: Array
    weights: Array
    slopes: Array
    edges: IndexArray
    faces: IndexArray
    shares: Array | None = None
    mean_volume: bool = False
    mass_matrix: Array | None = None
    kind: str = ""
    point_ratio: float = 1.0

    @property
    def mass_shares(self) -> Array:
        """Share of a cell's mass that each node carries, shape (a,); equal shares if `shares` is None."""
        nodes = len(self.reference)
        return np.full(nodes, 1.0 / nodes) if self.shares is None else self.shares


def check_element(element: Element) -> None:
    """Refuse an element whose arrays are inconsistent.

    Raises:
        ValueError: the element breaks a rule of Element; the message says which.
    """
    nodes, points = len(element.reference), len(element.points)
    shapes = (element.reference.shape, element.points.shape, element.weights.shape, element.slopes.shape)
    if shapes != ((nodes, 3), (points, 3), (points,), (points, nodes, 3)):
        raise ValueError(
            f"element {element.name}: reference, points, weights and slopes must have the shapes (a, 3), "
            f"(q, 3), (q,) and (q, a, 3), not {', '.join(map(str, shapes))}"
        )
    if not (element.weights > 0.0).all():
        raise ValueError(f"element {element.name}: all quadrature weights must be > 0")
    shares = element.mass_shares
    if shares.shape != (nodes,) or not (shares >= 0.0).all() or abs(shares.sum() - 1.0) > 1e-9:
        raise ValueError(
            f"element {element.name}: mass_shares must be {nodes} numbers >= 0 whose sum is 1, not {shares}"
        )
    identity = np.einsum("ai,qaj->qij", element.reference, element.slopes)
    if np.abs(element.slopes.sum(axis=1)).max() > 1e-9 or np.abs(identity - np.eye(3)).max() > 1e-9:
        raise ValueError(
            f"element {element.name}: the slopes must sum to zero over the nodes, and reference times slopes "
            "must be the identity, or a linear field is not met"
        )


def cell_axes(corners: Array) -> Array:
    """Return the frame of each cell from its first edge and the plane of its first three nodes.

    Args:
        corners: Node positions in [m], shape (m, a, 3); the first three nodes are used.

    Returns:
        Rotations whose columns are the frame's axes, shape (m, 3, 3).
    """
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    first = first / np.linalg.norm(first, axis=-1, keepdims=True)
    third = np.cross(first, second)
    third = third / np.linalg.norm(third, axis=-1, keepdims=True)
    return np.stack([first, np.cross(third, first), third], axis=-1)


def rest_quadrature(element: Element, corners: Array) -> tuple[Array, Array]:
    """Return the quadrature of cells at rest: weights in [m^3], (m, q), and gradients in [1/m], (m, q, a, 3).

    Args:
        element: The element.
        corners: Rest positions of the cells' nodes in [m], shape (m, a, 3).

    Raises:
        MeshError: a cell without volume, or one that is turned inside out at some of its points.
    """
    jacobian = np.einsum("mai,qaj->mqij", corners, element.slopes)
    determinant = np.linalg.det(jacobian)
    bad = np.flatnonzero(~(determinant * np.sign(determinant[:, :1]) > 0.0).all(axis=1))
    if len(bad):
        raise MeshError("of a body", f"cell {bad[0]} has no volume, or is folded; mesh the part again")
    volume = np.abs(determinant)
    gradients = np.einsum("qaj,mqji->mqai", element.slopes, np.linalg.inv(jacobian))
    return element.weights * volume, np.ascontiguousarray(gradients)
