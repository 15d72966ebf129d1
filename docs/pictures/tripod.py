"""Make docs/pictures/tripod.png: the Tripod at rest, in its start pose and its high pose, stress in colour.

Run from the checkout: `pip install matplotlib` once, then `python docs/pictures/tripod.py`.
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
mpl.use("Agg")

import matplotlib.pyplot as plt
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

from softsim_core import Simulation, load_scene, rotation_of

TOP_KPA = 120.0
ARM_M = 0.0265


def draw(axes: plt.Axes, simulation: Simulation, title: str) -> mpl.cm.ScalarMappable:
    """Draw the silicone and the three servo arms in millimetres."""
    points = 1e3 * simulation.visual_points()
    stress = 1e-3 * simulation.visual_values(simulation.von_mises())
    faces = points[simulation.visual_triangles]
    normals = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    light = 0.55 + 0.45 * np.abs(normals @ [0.3, -0.4, 0.87]) / np.linalg.norm(normals, axis=1)
    scale = mpl.cm.ScalarMappable(mpl.colors.Normalize(0.0, TOP_KPA), "viridis")
    colours = scale.to_rgba(stress[simulation.visual_triangles].mean(axis=1))
    colours[:, :3] *= light[:, None]
    axes.add_collection3d(Poly3DCollection(faces, facecolors=colours, edgecolors=colours, linewidths=0.2))
    frames = simulation.frames()
    for name in simulation.joint_names:
        horn = frames[f"{name}_horn"]
        tip = horn.position + rotation_of(horn.quaternion_xyzw) @ [0.0, 0.0, ARM_M]
        line = Line3DCollection([1e3 * np.array([horn.position, tip])], colors="0.15", linewidths=4)
        axes.add_collection3d(line)
        axes.text(*(1e3 * horn.position - [0, 0, 11]), name, fontsize=7, ha="center", color="0.3")
    axes.set(xlim=(-65, 65), ylim=(-65, 65), zlim=(-10, 60), title=title)
    axes.set_box_aspect((130, 130, 70), zoom=1.55)
    axes.view_init(elev=24, azim=-60)
    axes.set_axis_off()
    return scale


def main() -> None:
    """Simulate, draw, save."""
    simulation = Simulation(load_scene("tripod_high"))
    figure = plt.figure(figsize=(10, 3.0), dpi=120)
    for column, (title, pose) in enumerate(
        (("rest", None), ("key A: start", "start"), ("key Z: high", "high"))
    ):
        if pose == "start":
            simulation.start_animation()
        elif pose is not None:
            simulation.command(simulation.robot.poses[pose])
        for _ in range(100):
            simulation.step()
        axes = figure.add_subplot(1, 3, column + 1, projection="3d")
        scale = draw(axes, simulation, title)
    figure.subplots_adjust(left=0, right=0.92, bottom=0, top=0.92, wspace=0)
    bar = figure.colorbar(scale, cax=figure.add_axes((0.935, 0.2, 0.012, 0.55)))
    bar.set_label("von Mises stress [kPa]", fontsize=8)
    bar.ax.tick_params(labelsize=7)
    figure.savefig(Path(__file__).with_name("tripod.png"))


if __name__ == "__main__":
    main()
