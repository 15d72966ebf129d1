"""Draw a simulation as it stands: bodies in their colours, servos, cables, held nodes, contacts, goal."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np

mpl.use("Agg")

import matplotlib.pyplot as plt
from mpl_toolkits.mplot3d import proj3d
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from softsim_core import Pose, Shape, Simulation, quaternion_of, rotation_of, surface_of
from softsim_core.base import Array, IndexArray
from softsim_core.physics.mechanics import FIXED
from softsim_core.scene.building import RigidBody

SIZE_PX, FILM_PX = (640, 400), (400, 250)
FILM_COLOURS = 40
LIGHT = np.array([0.35, -0.5, 0.79])
SERVO_COLOUR, ARM_COLOUR = (0.15, 0.45, 0.75, 1.0), (0.95, 0.95, 0.95, 1.0)
FORCE_MM_PER_N = 40.0
SHARP = np.cos(np.radians(25.0))
"""Edges between faces that turn by more are drawn."""


def extent(simulation: Simulation, *, ghost: bool = False, hidden: Sequence[str] = ()) -> Array:
    """Points in [mm] around all that `draw` shows, shape (k, 3)."""
    outlines = list(_rest_outlines(simulation)) if ghost else []
    cables = [1e3 * cable.points for cable in simulation.actuators]
    return np.concatenate([*_faces(simulation, hidden)[0], *outlines, *cables])


def draw(
    simulation: Simulation,
    around: Array,
    *,
    goal: Pose | None = None,
    ghost: bool = False,
    hidden: Sequence[str] = (),
    view: tuple[float, float] = (24.0, -60.0),
) -> Image.Image:
    """A picture.

    Args:
        simulation: What is drawn.
        around: Points in [mm] that it has to show, as large as it can, shape (k, 3); see `extent`.
        goal: Wanted pose of the effector, as a green cross.
        ghost: With the outline of the bodies at rest.
        hidden: Names of rigid bodies that are left out.
        view: Elevation and azimuth of the camera in [deg].
    """
    width, height = SIZE_PX
    figure = plt.figure(figsize=(width / 100.0, height / 100.0), dpi=100)
    square = (0.0, (height - width) / 2.0 / height, 1.0, width / height)
    axes = figure.add_axes(square, projection="3d", computed_zorder=False, proj_type="ortho")
    faces, colours = _faces(simulation, hidden, _towards_camera(*view))
    axes.add_collection3d(Poly3DCollection(faces, facecolors=colours, antialiased=False, zorder=1))
    _lines(axes, list(_outlines(simulation, hidden)), "0.25", 0.5, 2)
    outlines = list(_rest_outlines(simulation)) if ghost else []
    _lines(axes, outlines, "0.6", 0.6, 2)
    _draw_cables(axes, simulation)
    _draw_held_nodes(axes, simulation)
    _draw_contacts(axes, simulation)
    if goal is not None:
        turn = rotation_of(goal.quaternion_xyzw)
        arms = [1e3 * goal.position + 10.0 * np.outer((-1.0, 1.0), turn[:, axis]) for axis in range(3)]
        _lines(axes, arms, "tab:green", 2.5, 6)
    axes.view_init(*view)
    axes.set_axis_off()
    _fit(axes, around)
    figure.canvas.draw()
    image = Image.fromarray(np.asarray(figure.canvas.buffer_rgba())).convert("RGB")
    plt.close(figure)
    return image


def save_picture(image: Image.Image, file: Path, keyword: str, state: Mapping[str, object]) -> None:
    """Write a PNG of few colours, below 80 kB, that carries a state as text."""
    chunks = PngInfo()
    chunks.add_text(keyword, json.dumps(state))
    image.quantize(64, dither=Image.Dither.NONE).save(file, optimize=True, pnginfo=chunks)


def save_film(
    images: Sequence[Image.Image], file: Path, period_s: float, state: Mapping[str, object]
) -> None:
    """Write a GIF that runs for ever, a picture every `period_s` seconds; its comment carries a state."""
    small = [image.resize(FILM_PX, Image.Resampling.LANCZOS) for image in images]
    strip = Image.new("RGB", (FILM_PX[0], FILM_PX[1] * len(small)))
    for number, image in enumerate(small):
        strip.paste(image, (0, number * FILM_PX[1]))
    palette = strip.quantize(FILM_COLOURS, dither=Image.Dither.NONE)
    first, *others = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in small]
    pauses = [round(1e3 * period_s)] * len(others) + [1000]
    first.save(
        file,
        save_all=True,
        append_images=others,
        duration=pauses,
        loop=0,
        optimize=True,
        comment=json.dumps(state).encode(),
    )


def _towards_camera(elevation_deg: float, azimuth_deg: float) -> Array:
    elevation, azimuth = np.radians((elevation_deg, azimuth_deg))
    return np.array(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    )


def _faces(
    simulation: Simulation, hidden: Sequence[str], camera: Array | None = None
) -> tuple[list[Array], Array]:
    """Triangles in mm and their shaded colours; everything in one list, so that near hides far.

    Opaque faces that look away from a camera in this direction are left out.
    """
    points, triangles = 1e3 * simulation.visual_points(), simulation.visual_triangles
    corners = [points[triangles]]
    colours = [_body_colours(simulation)]
    for body, pose in _rigid_bodies(simulation, hidden):
        corners.append(_placed(body.surface.points, pose)[body.surface.triangles])
        colours.append(np.tile(body.colour, (len(body.surface.triangles), 1)))
    for pose, size, centre, colour in _servo_boxes(simulation):
        surface = surface_of(Shape(box=size))
        corners.append(_placed(surface.points + centre, pose)[surface.triangles])
        colours.append(np.tile(colour, (len(surface.triangles), 1)))
    faces, paint = np.concatenate(corners), np.concatenate(colours)
    normals = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    cosine = normals @ LIGHT / np.maximum(np.linalg.norm(normals, axis=1), 1e-12)
    paint[:, :3] *= (0.72 + 0.28 * cosine)[:, None]
    seen = np.ones(len(faces), bool) if camera is None else (paint[:, 3] < 1.0) | (normals @ camera > 0.0)
    return list(faces[seen]), paint[seen]


def _rigid_bodies(simulation: Simulation, hidden: Sequence[str]) -> Iterator[tuple[RigidBody, Pose]]:
    for body, pose in zip(simulation.rigid_bodies, simulation.rigid_poses, strict=True):
        if body.name not in hidden:
            yield body, pose


def _body_colours(simulation: Simulation) -> Array:
    """Colour of each visual triangle, taken from the body that its first vertex belongs to."""
    colours, first = np.zeros((len(simulation.visual_triangles), 4)), 0
    for body, description in zip(simulation.bodies, simulation.scene.bodies, strict=True):
        last = first + len(body.surface.points)
        corner = simulation.visual_triangles[:, 0]
        red, green, blue, alpha = description.colour
        colours[(first <= corner) & (corner < last)] = (red, green, blue, 0.35 + 0.65 * alpha)
        first = last
    return colours


def _servo_boxes(
    simulation: Simulation,
) -> Iterator[tuple[Pose, tuple[float, float, float], Array, tuple[float, float, float, float]]]:
    """Servo and arm of each joint with a horn: frame, edge lengths and centre in m, colour."""
    frames = simulation.frames()
    for joint in simulation.scene.joints:
        if joint.horn_length > 0.0:
            yield frames[joint.name], (0.022, 0.012, 0.020), np.array([0.0, 0.0, -0.014]), SERVO_COLOUR
            length = joint.horn_length
            yield (
                frames[f"{joint.name}_horn"],
                (0.003, 0.006, length),
                np.array([0.0, 0.0, length / 2]),
                ARM_COLOUR,
            )


def _outlines(simulation: Simulation, hidden: Sequence[str]) -> Iterator[Array]:
    """Sharp edges of everything that has faces, in mm."""
    yield from _sharp_edges(1e3 * simulation.visual_points(), simulation.visual_triangles)
    for body, pose in _rigid_bodies(simulation, hidden):
        yield from _sharp_edges(_placed(body.surface.points, pose), body.surface.triangles)
    for pose, size, centre, _ in _servo_boxes(simulation):
        surface = surface_of(Shape(box=size))
        yield from _sharp_edges(_placed(surface.points + centre, pose), surface.triangles)


def _rest_outlines(simulation: Simulation) -> Iterator[Array]:
    """Sharp edges of the deformable and the free rigid bodies where they start, in mm."""
    yield from _sharp_edges(1e3 * simulation.visual_rest_points, simulation.visual_triangles)
    for body in simulation.rigid_bodies:
        if body.free >= 0:
            pose = Pose(body.position, quaternion_of(body.rotation))
            yield from _sharp_edges(_placed(body.surface.points, pose), body.surface.triangles)


def _sharp_edges(points: Array, triangles: IndexArray) -> list[Array]:
    corners = points[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    faces_of: dict[tuple[int, int], list[int]] = {}
    for face, (a, b, c) in enumerate(triangles.tolist()):
        for edge in ((a, b), (b, c), (c, a)):
            faces_of.setdefault((min(edge), max(edge)), []).append(face)
    return [
        points[list(edge)]
        for edge, faces in faces_of.items()
        if len(faces) != 2 or normals[faces[0]] @ normals[faces[1]] < SHARP
    ]


def _draw_cables(axes: plt.Axes, simulation: Simulation) -> None:
    for cable in simulation.actuators:
        points = 1e3 * cable.points
        _lines(axes, [points], "tab:orange", 1.6, 4)
        axes.scatter(*points.T, color="tab:orange", s=7, zorder=4, depthshade=False)
        if cable.pulled_from_outside:
            axes.scatter(*points[:1].T, color="tab:red", s=22, zorder=4, depthshade=False)


def _draw_held_nodes(axes: plt.Axes, simulation: Simulation) -> None:
    """Nodes that move rigidly: red held by the world, purple with a joint or a free frame."""
    region = simulation.model.region_of_node
    points = 1e3 * simulation.positions
    for chosen, colour in ((region == FIXED, "tab:red"), (region >= 0, "tab:purple")):
        if chosen.any():
            axes.scatter(*points[chosen].T, color=colour, s=6, zorder=5, depthshade=False)


def _draw_contacts(axes: plt.Axes, simulation: Simulation) -> None:
    contacts = simulation.contacts
    loaded = np.linalg.norm(contacts.forces, axis=1) > 1e-6
    if loaded.any():
        points, forces = 1e3 * contacts.points[loaded], FORCE_MM_PER_N * contacts.forces[loaded]
        axes.scatter(*points.T, color="magenta", s=10, zorder=7, depthshade=False)
        _lines(axes, list(np.stack([points, points + forces], axis=1)), "magenta", 1.2, 7)


def _placed(points: Array, pose: Pose) -> Array:
    return 1e3 * (pose.position + points @ rotation_of(pose.quaternion_xyzw).T)


def _lines(axes: plt.Axes, lines: list[Array], colour: str, width: float, order: int) -> None:
    if lines:
        axes.add_collection3d(Line3DCollection(lines, colors=colour, linewidths=width, zorder=order))


def _fit(axes: plt.Axes, points: Array) -> None:
    """Show all points, as large as the picture allows."""
    low, high = points.min(axis=0), points.max(axis=0)
    size = np.maximum(high - low, 1.0)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(size)
    axes.apply_aspect()
    across, up, _ = proj3d.proj_transform(*points.T, axes.get_proj())
    pixels = axes.transData.transform(np.column_stack([across, up]))
    reach = np.abs(pixels - np.array(SIZE_PX) / 2.0).max(axis=0)
    axes.set_box_aspect(size, zoom=float(0.94 * (np.array(SIZE_PX) / 2.0 / reach).min()))
