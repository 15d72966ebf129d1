"""The picture of `softsim mesh`: the mesh's boundary, and the distribution of its angles."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np

from softsim_core.lab.meshing import MeshedPart
from softsim_core.physics.mesh import boundary_surface, dihedral_angles_deg
from softsim_ros import save_figure

matplotlib.use("Agg")

from matplotlib import pyplot as plt


def draw(made: MeshedPart, file: Path) -> None:
    """Draw the boundary in the file's unit, and a histogram of dihedral angles."""
    skin, unit = boundary_surface(made.mesh), made.source.unit
    points = skin.points / unit.metres
    figure = plt.figure(figsize=(11.0, 5.5))
    try:
        body = figure.add_subplot(1, 2, 1, projection="3d")
        body.plot_trisurf(
            *points.T, triangles=skin.triangles, color="#f2c27a", edgecolor="#7a5a20", linewidth=0.2
        )
        body.set_box_aspect(np.maximum(np.ptp(points, axis=0), 1e-9))
        body.set(xlabel=f"x [{unit.name}]", ylabel=f"y [{unit.name}]", zlabel=f"z [{unit.name}]")
        body.set_title(f"{made.report.nodes} nodes, {made.report.elements} tetrahedra")
        angles = figure.add_subplot(1, 2, 2)
        angles.hist(
            dihedral_angles_deg(made.mesh.points, made.mesh.tets[:, :4]).reshape(-1), 60, color="#4a7ba6"
        )
        angles.set(xlabel="dihedral angle [deg]", ylabel="how many", xlim=(0.0, 180.0))
        angles.set_title(f"{made.report.min_dihedral_deg:.1f} to {made.report.max_dihedral_deg:.1f} degrees")
        save_figure(figure, file)
    finally:
        plt.close(figure)
