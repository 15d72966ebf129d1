"""An element of one's own: the linear tetrahedron with four quadrature points, in dynamics beside tet4.

F is uniform in a linear tetrahedron, so one point is enough and both elements give the same motion. One
whose F is not, such as one with nodes on its edges, is written the same way: with other slopes at each point.
Run it: python examples/my_element.py
"""

from __future__ import annotations

import numpy as np

from softsim_core import (
    AttachmentDescription,
    BodyDescription,
    Box,
    MaterialDescription,
    SceneDescription,
    Simulation,
    SolverSettings,
    box_mesh,
)
from softsim_core.physics.fem.elements import ElementData, element, register_element

INNER, OUTER = (5.0 - 5.0**0.5) / 20.0, (5.0 + 3.0 * 5.0**0.5) / 20.0
"""Coordinates of the four points that integrate quadratic functions (Keast 1986)."""

LINEAR = element("tet4")
FOUR_POINTS = ElementData(
    name="tet4_four_points",
    reference=LINEAR.reference,
    points=INNER + (OUTER - INNER) * LINEAR.reference,
    weights=np.full(4, 1.0 / 24.0),
    slopes=np.repeat(LINEAR.slopes, 4, axis=0),
    edges=LINEAR.edges,
    faces=LINEAR.faces,
)


def swinging_beam(kind: str, backend: str = "auto") -> np.ndarray:
    """Node positions in [m], shape (n, 3), of a beam held at one end, after 0.5 s."""
    beam = BodyDescription(
        name="beam",
        mesh=box_mesh((0.1, 0.02, 0.02), (6, 2, 2)),
        material=MaterialDescription(young_modulus=1e5, poisson_ratio=0.4),
        total_mass=0.04,
        element=kind,
    )
    wall = Box(center=(0.0, 0.01, 0.01), size=(1e-4, 0.1, 0.1))
    held = AttachmentDescription(name="held", body="beam", to="world", box=wall)
    solver = SolverSettings(backend=backend)  # type: ignore[arg-type]
    simulation = Simulation(SceneDescription(name="beam", bodies=(beam,), attachments=(held,), solver=solver))
    for _ in range(50):
        simulation.step()
    return simulation.positions


def difference(backend: str = "auto") -> float:
    """Largest distance in [mm] between the nodes of a beam of this element and of one of tet4."""
    register_element(FOUR_POINTS)
    apart = swinging_beam("tet4_four_points", backend) - swinging_beam("tet4", backend)
    return 1e3 * float(np.linalg.norm(apart, axis=1).max())


if __name__ == "__main__":
    print(f"four points and one: {difference():.2e} mm apart after 0.5 s")
