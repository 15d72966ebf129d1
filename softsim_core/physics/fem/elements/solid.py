r"""Cells that fill bodies: tetrahedra with four nodes (linear) or ten (quadratic), hexahedra with eight.

With barycentric coordinates l of the corners, the quadratic shape functions are N_i = l_i (2 l_i - 1) at
corners and 4 l_i l_j on edges. The quadratic element represents bending, and nearly incompressible material
does not lock in it: a small part of the bulk acts at the four points, the rest on the mean volume of the
cell.

In the hexahedron, with reference coordinates in 0..1, the shape function of a node is the product over the
three directions of :math:`\xi_i` or :math:`1 - \xi_i`, whichever is 1 at its corner. A cell that bends has
shear that a bent beam has not, of energy :math:`\mu m / 2` with :math:`m = \overline{x^2}` in a cube. With
:math:`\lambda` on the mean volume alone, its stretching takes :math:`\mu m`, less than a beam's
:math:`(1 + \nu) \mu m`: together they are 1.15 of a beam's for :math:`\nu = 0.3` and 1 for 0.5.

Sources: Keast 1986 (points); Hinton, Rock, Zienkiewicz 1976 (mass: the diagonal of the consistent mass
matrix, scaled; row sums would be negative at corners); Nagtegaal, Parks, Rice 1974 (mean volume).
"""

from __future__ import annotations

from math import factorial, prod

import numpy as np

from softsim_core.base import Array
from softsim_core.physics.fem.elements.cell import ElementData

_CORNERS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])

TET4 = ElementData(
    name="tet4",
    reference=_CORNERS,
    points=np.full((1, 3), 0.25),
    weights=np.array([1.0 / 6.0]),
    slopes=np.array([[[-1.0, -1.0, -1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]]),
    edges=np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]),
    faces=np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]),
    mass_matrix=(np.ones((4, 4)) + np.eye(4)) / 20.0,
    kind="tetra",
)
"""N_0 = 1 - xi - eta - zeta, N_1 = xi, N_2 = eta, N_3 = zeta. Nearly incompressible material locks in it."""


MIDDLES = np.array([[0, 1], [1, 2], [0, 2], [0, 3], [1, 3], [2, 3]])
"""Corners at the ends of the edge on which each of the nodes 4 to 9 lies."""

_INNER, _OUTER = (5.0 - 5.0**0.5) / 20.0, (5.0 + 3.0 * 5.0**0.5) / 20.0


def _slopes(barycentric: Array) -> Array:
    """Return the shape function derivatives by the reference coordinates, shape (q, 10, 3), at l (q, 4)."""
    by_l = np.zeros((len(barycentric), 10, 4))
    corners, edges = np.arange(4), np.arange(4, 10)
    by_l[:, corners, corners] = 4.0 * barycentric - 1.0
    by_l[:, edges, MIDDLES[:, 0]] = 4.0 * barycentric[:, MIDDLES[:, 1]]
    by_l[:, edges, MIDDLES[:, 1]] = 4.0 * barycentric[:, MIDDLES[:, 0]]
    return np.asarray(by_l @ TET4.slopes[0])


def _mass_matrix() -> Array:
    """Return the integrals of N_a N_b over a cell of volume 1, shape (10, 10).

    A monomial of l integrates to 6 prod(k!) / (3 + sum(k))!.
    """
    first, second = np.concatenate([np.stack([np.arange(4)] * 2, axis=1), MIDDLES]).T
    shapes = []
    for i, j in zip(first.tolist(), second.tolist(), strict=True):
        powers = np.eye(4, dtype=int)
        square, single = tuple((powers[i] + powers[j]).tolist()), tuple(powers[i].tolist())
        shapes.append({square: 2.0, single: -1.0} if i == j else {square: 4.0})
    result = np.zeros((10, 10))
    for a, one in enumerate(shapes):
        for b, other in enumerate(shapes):
            for k, factor in one.items():
                for m, weight in other.items():
                    total = np.add(k, m).tolist()
                    integral = 6.0 * prod(map(factorial, total)) / factorial(3 + sum(total))
                    result[a, b] += factor * weight * integral
    return result


_POINTS = np.full((4, 4), _INNER) + (_OUTER - _INNER) * np.eye(4)

TET10 = ElementData(
    name="tet10",
    reference=np.concatenate([TET4.reference, TET4.reference[MIDDLES].mean(axis=1)]),
    points=_POINTS @ TET4.reference,
    weights=np.full(4, 1.0 / 24.0),
    slopes=_slopes(_POINTS),
    edges=np.concatenate([[[a, 4 + n], [4 + n, b]] for n, (a, b) in enumerate(MIDDLES.tolist())]),
    faces=np.array([[0, 2, 1, 6, 5, 4], [0, 1, 3, 4, 8, 7], [1, 2, 3, 5, 9, 8], [0, 3, 2, 7, 9, 6]]),
    shares=np.repeat([1.0 / 36.0, 4.0 / 27.0], [4, 6]),
    mean_volume=True,
    mass_matrix=_mass_matrix(),
    kind="tetra10",
)
"""Each face lists three corners, then the midpoints of their edges in the same sense."""


_CUBE = np.array(
    [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]], dtype=float
)
_CUBE_POINTS = 0.5 + (_CUBE - 0.5) / 3.0**0.5


def _trilinear_slopes(points: Array) -> Array:
    """Return the shape function derivatives by the reference coordinates, shape (q, 8, 3)."""
    factors = np.where(_CUBE == 1.0, points[:, None], 1.0 - points[:, None])
    signs = 2.0 * _CUBE - 1.0
    others = [np.delete(factors, axis, axis=2).prod(axis=2) for axis in range(3)]
    return np.asarray(signs * np.stack(others, axis=2))


def _cube_mass_matrix() -> Array:
    """Return the integrals of N_a N_b over a cell of volume 1, shape (8, 8)."""
    same = _CUBE[:, None] == _CUBE[None]
    return np.asarray(np.where(same, 1.0 / 3.0, 1.0 / 6.0).prod(axis=2))


HEX8 = ElementData(
    name="hex8",
    reference=_CUBE,
    points=_CUBE_POINTS,
    weights=np.full(8, 1.0 / 8.0),
    slopes=_trilinear_slopes(_CUBE_POINTS),
    edges=np.array(
        [[0, 1], [1, 2], [2, 3], [3, 0], [4, 5], [5, 6], [6, 7], [7, 4], [0, 4], [1, 5], [2, 6], [3, 7]]
    ),
    faces=np.array([[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]]),
    mean_volume=True,
    mass_matrix=_cube_mass_matrix(),
    kind="hexahedron",
    point_ratio=0.0,
)
"""Nodes are in VTK's order."""
