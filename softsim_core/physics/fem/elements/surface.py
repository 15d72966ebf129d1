r"""Surface cells: triangles of three nodes, and of six as the faces of quadratic tetrahedra.

They have two reference coordinates. With the slopes :math:`x_\xi, x_\eta` of a cell at rest, the gradients of
the shape functions lie in its tangent plane, and the volume at a point is the thickness times the area there.
"""

from __future__ import annotations

import numpy as np

from softsim_core.base import Array, MeshError
from softsim_core.physics.fem.elements.cell import Element, ElementData

_CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
_FIRST = np.array([-1.0, 1.0, 0.0])
_SECOND = np.array([-1.0, 0.0, 1.0])


def _quadratic_slopes(points: Array) -> Array:
    """Return shape function derivatives at points (q, 2), shape (q, 6, 2).

    Corners first, then edge midpoints.
    """
    l = np.column_stack([1.0 - points.sum(axis=1), points])  # noqa: E741 (barycentric)
    by_l = np.zeros((len(points), 6, 3))
    for i in range(3):
        by_l[:, i, i] = 4.0 * l[:, i] - 1.0
        j = (i + 1) % 3
        by_l[:, 3 + i, i], by_l[:, 3 + i, j] = 4.0 * l[:, j], 4.0 * l[:, i]
    return np.asarray(by_l @ np.column_stack([_FIRST, _SECOND]))


_MIDDLES = np.array([[0.5, 0.0], [0.5, 0.5], [0.0, 0.5]])
_POINTS = np.array([[1.0, 1.0], [4.0, 1.0], [1.0, 4.0]]) / 6.0

TRI3 = ElementData(
    name="tri3",
    reference=_CORNERS,
    points=np.full((1, 2), 1.0 / 3.0),
    weights=np.array([0.5]),
    slopes=np.column_stack([_FIRST, _SECOND])[None],
    edges=np.array([[0, 1], [1, 2], [2, 0]]),
    faces=np.array([[0, 1, 2]]),
)
TRI6 = ElementData(
    name="tri6",
    reference=np.concatenate([_CORNERS, _MIDDLES]),
    points=_POINTS,
    weights=np.full(3, 1.0 / 6.0),
    slopes=_quadratic_slopes(_POINTS),
    edges=np.array([[0, 3], [3, 1], [1, 4], [4, 2], [2, 5], [5, 0]]),
    faces=np.array([[0, 1, 2, 3, 4, 5]]),
    shares=np.array([0.0, 0.0, 0.0, 1.0, 1.0, 1.0]) / 3.0,
)
"""The shares are the integrals of the shape functions, which are zero at the corners."""


def surface_quadrature(element: Element, corners: Array, thickness: Array) -> tuple[Array, Array]:
    """Return the volumes and gradients of surface cells at rest, in axes whose third is the normal.

    Args:
        element: TRI3 or TRI6.
        corners: Rest positions of the cells' nodes in [m], shape (m, a, 3).
        thickness: Of each cell in [m], shape (m,).

    Returns:
        Volumes at the points in [m^3], shape (m, q), and gradients in [1/m], shape (m, q, a, 3), whose third
        component is zero.

    Raises:
        MeshError: a cell without area.
    """
    tangents = np.einsum("mai,qad->mqdi", corners, element.slopes)
    across = np.cross(tangents[..., 0, :], tangents[..., 1, :])
    area = np.linalg.norm(across, axis=-1)
    if not (area > 0.0).all():
        cell = int(np.flatnonzero(~(area > 0.0).all(axis=1))[0])
        raise MeshError("of a layer", f"triangle {cell} has no area; mesh the part again")
    first = tangents[..., 0, :] / np.linalg.norm(tangents[..., 0, :], axis=-1, keepdims=True)
    second = np.cross(across / area[..., None], first)
    in_plane = np.stack([first, second], axis=-1)  # (m, q, 3, 2)
    jacobian = np.swapaxes(tangents @ in_plane, -1, -2)  # in-plane by reference coordinates
    gradients = np.zeros((*area.shape, len(element.reference), 3))
    gradients[..., :2] = np.einsum("qad,mqdj->mqaj", element.slopes, np.linalg.inv(jacobian))
    return element.weights * area * thickness[:, None], gradients
