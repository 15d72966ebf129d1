"""Draw what is inside bodies and around them: elements, regions, frames, collision surfaces, normals."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final, TypeAlias

import numpy as np
from visualization_msgs.msg import Marker, MarkerArray

from softsim_core.base import Array, IndexArray
from softsim_core.scene import AttachmentDescription, RobotDescription, ViewSettings
from softsim_ros.nodes.viewer.marker_view import MarkerView, marker_points
from softsim_ros.nodes.viewer.surface import (
    MM,
    Lines,
    Points,
    box_lines,
    normal_lines,
    shrunk_faces,
    sphere_lines,
)


class CollisionView:
    """Draws the topic `collisions`: wire frames of the surfaces, and a box around each."""

    def __init__(self, scene: Any) -> None:
        self._surfaces = MarkerView(
            scene, "collisions", part_of=lambda name, _: f"collisions/{name}", wireframe=True
        )
        self._boxes = Lines(scene, "/search_boxes", (134, 142, 150), 0.3)
        self._view = ViewSettings()

    def apply_view(self, view: ViewSettings) -> None:
        """Apply view settings."""
        self._view = view
        self._surfaces.switch(view.collisions, view.hidden)
        if not view.collisions:
            self._surfaces.clear()
        if not view.search_boxes:
            self._boxes.show(None)

    def update(self, message: MarkerArray) -> None:
        """Draw the surfaces at their current positions."""
        view = self._view
        if view.collisions:
            self._surfaces.update(message)
        if view.search_boxes:
            shown = [each for each in message.markers if f"collisions/{each.ns}" not in view.hidden]
            self._boxes.show(np.concatenate([around(each) for each in shown]) if shown else None)


def around(marker: Marker) -> Points:
    """Return the edges in [mm] of a surface's box along the axes of the world, shape (12, 2, 3)."""
    points = marker_points(marker)
    margin = MM * marker.scale.x / 2.0 if marker.type == Marker.SPHERE else 0.0
    lower, upper = points.min(axis=0) - margin, points.max(axis=0) + margin
    lines = box_lines(tuple(0.5 * (lower + upper)), tuple(upper - lower), (0.0, 0.0, 0.0))
    return lines.astype(np.float32)


LENGTH_MM: Final = 2.0
PERIOD_S: Final = 0.2
"""Period in [s] at which normals are redrawn."""


class NormalsView:
    """Draws a line from the centre of each triangle along its normal."""

    def __init__(self, scene: Any) -> None:
        self._lines = Lines(scene, "/normals", (12, 133, 153), 0.15)
        self._drawn_at = -math.inf
        self._shown = False

    def switch(self, shown: bool) -> None:
        """Show or hide the normals."""
        self._shown, self._drawn_at = shown, -math.inf
        if not shown:
            self._lines.show(None)

    def update(self, points: Points, triangles: IndexArray, now: float) -> None:
        """Redraw the normals if their period is over.

        Args:
            points: Vertices in [mm], shape (p, 3).
            triangles: Triangles with normals, shape (k, 3).
            now: Steady clock in [s].
        """
        if self._shown and now - self._drawn_at >= PERIOD_S:
            self._drawn_at = now
            self._lines.show(normal_lines(points, triangles, LENGTH_MM))


Still: TypeAlias = tuple[str, str, Any]
"""An object that is drawn once: its layer, the part of the scene that it belongs to, its handle."""

ELEMENT_SHARE = 0.85
EDGES = (20, 24, 28)
REGION_SHARE = 2.2
"""Size of the nodes of rigid regions relative to other nodes."""

STILL = 1e-4
"""Change below which a frame is not moved in the picture, in [mm] or in its quaternion."""

REGION_COLOURS = ((230, 119, 0), (47, 158, 68), (25, 113, 194), (174, 62, 201), (201, 42, 42), (12, 133, 153))


class InnerView:
    """Draws the inside and the frames of a scene; `frames` are their names in the order of their poses."""

    def __init__(self, scene: Any, robot: RobotDescription, frames: Sequence[str]) -> None:
        self._scene, self._robot = scene, robot
        self._tetrahedra: IndexArray = np.zeros((0, 4), np.int64)
        self._bodies: dict[str, slice] = {}
        self._regions: list[tuple[str, IndexArray]] = []
        self._positions: Array | None = None
        self._moving: dict[str, Any] = {}
        self._view = ViewSettings()
        self._frames = [(name, scene.add_frame(f"/frames/{name}", show_axes=False)) for name in frames]
        for _, handle in self._frames:
            handle.axes_length, handle.axes_radius, handle.origin_radius = 12.0, 0.5, 1.0
        self._poses: Array = np.full((len(self._frames), 7), np.inf)
        self._still: tuple[Still, ...] = (*self._arms(), *self._labels(), *self._boxes())
        self.apply_view(self._view)

    @property
    def needs_nodes(self) -> bool:
        """Whether a visible layer needs the positions of the nodes."""
        view = self._view
        return view.elements or view.nodes or view.regions

    def set_structure(
        self,
        tetrahedra: IndexArray,
        bodies: Sequence[Mapping[str, Any]],
        regions: Sequence[Mapping[str, Any]],
    ) -> None:
        """Set the structure of the scene.

        Args:
            tetrahedra: Node indices of the elements, shape (m, 4).
            bodies: `name` and `nodes` (first and end index) of each body.
            regions: `name` and `nodes` (all indices) of each rigid region.
        """
        self._tetrahedra = tetrahedra
        self._bodies = {str(body["name"]): slice(*body["nodes"]) for body in bodies}
        self._regions = [
            (str(region["name"]), np.array(region["nodes"], dtype=np.int64)) for region in regions
        ]
        self._remove_moving()

    def apply_view(self, view: ViewSettings) -> None:
        """Apply view settings."""
        self._view = view
        for name, handle in self._frames:
            part = name.removesuffix("_horn")
            handle.show_axes = view.frames and not {f"joints/{part}", f"attachments/{part}"} & {*view.hidden}
        for layer, part, handle in self._still:
            handle.visible = getattr(view, layer) and part not in view.hidden
        self._remove_moving()
        if self._positions is not None:
            self.move_nodes(self._positions)

    def move_frames(self, poses: Array) -> None:
        """Move the frames; rows of x, y, z in [mm] and a quaternion x, y, z, w, shape (f, 7)."""
        if len(poses) != len(self._frames):
            return
        moved = (np.abs(poses - self._poses) > STILL).any(axis=1)  # frames at rest cost nothing
        for number in np.flatnonzero(moved):
            handle, row = self._frames[number][1], poses[number]
            handle.position, handle.wxyz = row[:3], row[[6, 3, 4, 5]]
            self._poses[number] = row

    def move_nodes(self, positions: Array) -> None:
        """Move nodes and elements; `positions` in [mm], shape (n, 3)."""
        self._positions = positions
        if int(self._tetrahedra.max(initial=-1)) >= len(positions):
            return  # nodes of another scene
        view, visible = self._view, np.ones(len(positions), dtype=bool)  # nodes of bodies that are shown
        for name, part in self._bodies.items():
            visible[part] = f"bodies/{name}" not in view.hidden
        tetrahedra = self._tetrahedra[visible[self._tetrahedra[:, 0]]]
        if view.elements and len(tetrahedra):
            vertices, faces = shrunk_faces(positions, tetrahedra, ELEMENT_SHARE)
            self._draw("elements", "mesh", vertices.astype(np.float32), faces)
        size = MM * view.node_size
        if view.nodes and visible.any():
            self._draw("nodes", "points", positions[visible].astype(np.float32), (33, 37, 41), size=size)
        for number, (name, nodes) in enumerate(self._regions if view.regions else ()):
            if f"attachments/{name}" in view.hidden or int(nodes.max(initial=-1)) >= len(positions):
                continue
            colour, points = REGION_COLOURS[number % len(REGION_COLOURS)], positions[nodes].astype(np.float32)
            self._draw(f"regions/{name}", "points", points, colour, size=REGION_SHARE * size)

    def _draw(self, name: str, kind: str, points: Points, extra: Any, *, size: float = 1.0) -> None:
        if name in self._moving:
            if kind == "mesh":
                self._moving[name].vertices = points
            else:
                self._moving[name].points = points
        elif kind == "mesh":
            self._moving[name] = self._scene.add_mesh_simple(
                f"/{name}", points, extra.astype(np.uint32), color=(77, 130, 214), flat_shading=True
            )
        else:
            self._moving[name] = self._scene.add_point_cloud(
                f"/{name}", points, extra, point_size=size, point_shape="square", precision="float32"
            )

    def _remove_moving(self) -> None:
        """Remove moving objects; they are drawn again with the next positions."""
        for handle in self._moving.values():
            handle.remove()
        self._moving.clear()

    def _labels(self) -> list[Still]:
        return [
            (
                "labels",
                f"joints/{joint.name}",
                self._scene.add_label(
                    f"/frames/{joint.name}/label", joint.name.replace("_", " ").capitalize()
                ),
            )
            for joint in self._robot.joints
            if joint.kind == "revolute"  # the servos; slides and cables have no position of their own
        ]

    def _arms(self) -> list[Still]:
        """Draw the arm of each servo, along z of the frame that it moves, and the servo itself."""
        arms: list[Still] = []
        for joint in self._robot.joints:
            length = MM * joint.horn_length
            boxes = {
                f"{joint.name}_horn": ("arm", (52, 58, 64), 1.0, (4.0, 8.0, length), length / 2.0),
                joint.name: ("servo", (73, 80, 87), 0.7, (20.0, 20.0, 12.0), -10.0),
            }
            for frame, (name, colour, opacity, size, height) in boxes.items() if length > 0.0 else ():
                center = (0.0, 0.0, height)
                solid = self._scene.add_box(
                    f"/frames/{frame}/{name}",
                    color=colour,
                    opacity=None if opacity == 1.0 else opacity,
                    dimensions=size,
                    position=center,
                )
                edges = self._scene.add_line_segments(
                    f"/frames/{frame}/edges",
                    box_lines(center, size, (0.0, 0.0, 0.0)).astype(np.float32),
                    EDGES,
                    thickness=0.35,
                )
                arms += [("arms", f"joints/{joint.name}", handle) for handle in (solid, edges)]
        return arms

    def _boxes(self) -> list[Still]:
        attachments = [each for each in self._robot.scene.attachments if each.group is None]
        return [("boxes", f"attachments/{each.name}", self._region(each)) for each in attachments]

    def _region(self, attachment: AttachmentDescription) -> Any:
        box, sphere = attachment.box, attachment.sphere
        if box is not None:
            lines = box_lines(box.center, box.size, box.rotation_deg)
        elif sphere is not None:
            lines = sphere_lines(sphere.center, sphere.radius)
        else:
            rod = next(each.rod for each in self._robot.scene.bodies if each.name == attachment.body)
            assert rod is not None  # a description has a region, or an end of a rod
            place = rod.end_place(attachment.end == "start")
            lines = sphere_lines((place[0], place[1], place[2]), 0.6 * max(rod.section.size))
        parent = f"/frames/{attachment.relative_to}" if attachment.relative_to else ""
        return self._scene.add_line_segments(
            f"{parent}/box_{attachment.name}", (MM * lines).astype(np.float32), (201, 42, 42), thickness=0.4
        )
