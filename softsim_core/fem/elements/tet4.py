"""The linear tetrahedron: four nodes, one quadrature point, F uniform in the cell."""

from __future__ import annotations

import numpy as np

from softsim_core.fem.elements.element import ElementData

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
)
"""N_0 = 1 - xi - eta - zeta, N_1 = xi, N_2 = eta, N_3 = zeta. Nearly incompressible matter locks on it."""
