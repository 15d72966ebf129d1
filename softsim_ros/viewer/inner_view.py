"""What lies inside the bodies: finite elements and nodes, rigid zones, regions of fixings, frames, labels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from softsim_core.arrays import Array, IndexArray
from softsim_core.scene.description import AttachmentDescription, SceneDescription
from softsim_ros.viewer.shapes import box_lines, shrunk_faces, sphere_lines
from softsim_ros.viewer.surface import MM

SWITCHES: Final[Mapping[str, str]] = {
    "elements": "Finite elements",
    "nodes": "Nodes",
    "zones": "Rigid zones and fixings",
    "boxes": "Boxes and spheres that select nodes",
    "frames": "Frames",
    "arms": "Servo arms",
    "labels": "Labels",
}
"""What can be switched, and its words on the page."""

SHOWN_AT_START: Final = frozenset({"arms", "labels"})

ELEMENT_SHARE = 0.85
ZONE_COLOURS = ((230, 119, 0), (47, 158, 68), (25, 113, 194), (174, 62, 201), (201, 42, 42), (12, 133, 153))


class InnerView:
    """Draws the inside and the frames of a scene.

    Args:
        scene: viser's scene.
        robot: What the scene is made of.
        frames: Names of its frames, in the order of their poses.
    """

    def __init__(self, scene: Any, robot: SceneDescription, frames: Sequence[str]) -> None:
        self._scene, self._robot = scene, robot
        self._tetrahedra: IndexArray = np.zeros((0, 4), np.int64)
        self._zones: list[tuple[str, IndexArray]] = []
        self._positions: Array | None = None
        self._moving: dict[str, Any] = {}
        self.shown = set(SHOWN_AT_START)
        self._frames = [(name, scene.add_frame(f"/frames/{name}", show_axes=False)) for name in frames]
        for _, handle in self._frames:
            handle.axes_length, handle.axes_radius, handle.origin_radius = 12.0, 0.5, 1.0
        self._still: dict[str, list[Any]] = {
            "arms": self._arms(),
            "labels": self._labels(),
            "boxes": self._boxes(),
        }
        for switch in self._still:
            self.switch(switch, switch in self.shown)

    @property
    def needs_nodes(self) -> bool:
        """Whether something is shown that needs the positions of the nodes."""
        return bool(self.shown & {"elements", "nodes", "zones"})

    def set_structure(self, tetrahedra: IndexArray, zones: Sequence[Mapping[str, Any]]) -> None:
        """Tell elements, shape (m, 4), and rigid zones (`name`, `nodes`)."""
        self._tetrahedra = tetrahedra
        self._zones = [(str(zone["name"]), np.array(zone["nodes"], dtype=np.int64)) for zone in zones]
        self._forget(("elements", "zones"))

    def switch(self, name: str, shown: bool) -> None:
        """Show or hide one of SWITCHES."""
        (self.shown.add if shown else self.shown.discard)(name)
        if name == "frames":
            for _, handle in self._frames:
                handle.show_axes = shown
        for handle in self._still.get(name, ()):
            handle.visible = shown
        self._forget((name,))
        if self._positions is not None:
            self.move_nodes(self._positions)

    def move_frames(self, poses: Array) -> None:
        """Place the frames; rows of x, y, z in [mm] and a quaternion x, y, z, w, shape (f, 7)."""
        if len(poses) == len(self._frames):
            for (_, handle), row in zip(self._frames, poses, strict=True):
                handle.position, handle.wxyz = row[:3], row[[6, 3, 4, 5]]

    def move_nodes(self, positions: Array) -> None:
        """Place nodes and elements; `positions` in [mm], shape (n, 3)."""
        self._positions = positions
        if int(self._tetrahedra.max(initial=-1)) >= len(positions):
            return  # of another scene
        if "elements" in self.shown and len(self._tetrahedra):
            vertices, faces = shrunk_faces(positions, self._tetrahedra, ELEMENT_SHARE)
            self._draw("elements", "mesh", vertices.astype(np.float32), faces)
        if "nodes" in self.shown:
            self._draw("nodes", "points", positions.astype(np.float32), (33, 37, 41), size=0.9)
        if "zones" in self.shown:
            for number, (name, nodes) in enumerate(self._zones):
                if int(nodes.max(initial=-1)) < len(positions):
                    colour = ZONE_COLOURS[number % len(ZONE_COLOURS)]
                    self._draw(
                        f"zones/{name}", "points", positions[nodes].astype(np.float32), colour, size=2.0
                    )

    def _draw(
        self, name: str, kind: str, points: NDArray[np.float32], extra: Any, *, size: float = 1.0
    ) -> None:
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

    def _forget(self, names: Sequence[str]) -> None:
        for drawn in [each for each in self._moving if each.split("/")[0] in names]:
            self._moving.pop(drawn).remove()

    def _labels(self) -> list[Any]:
        return [
            self._scene.add_label(f"/frames/{joint.name}/label", joint.name.replace("_", " ").capitalize())
            for joint in self._robot.joints
            if joint.kind == "revolute"  # the servos; slides and cables have no place of their own
        ]

    def _arms(self) -> list[Any]:
        arms = []
        for joint in self._robot.joints:
            length = MM * joint.horn_length
            if length > 0.0:
                arms.append(
                    self._scene.add_box(
                        f"/frames/{joint.name}_horn/arm",
                        color=(52, 58, 64),
                        dimensions=(4.0, 8.0, length),
                        position=(0.0, 0.0, length / 2.0),
                    )
                )
                arms.append(
                    self._scene.add_box(
                        f"/frames/{joint.name}/servo",
                        color=(73, 80, 87),
                        opacity=0.7,
                        dimensions=(20.0, 20.0, 12.0),
                        position=(0.0, 0.0, -10.0),
                    )
                )
        return arms

    def _boxes(self) -> list[Any]:
        return [self._region(attachment) for attachment in self._robot.attachments]

    def _region(self, attachment: AttachmentDescription) -> Any:
        box, sphere = attachment.box, attachment.sphere
        if box is not None:
            lines = box_lines(box.center, box.size, box.rotation_deg)
        else:
            assert sphere is not None  # a description has exactly one
            lines = sphere_lines(sphere.center, sphere.radius)
        parent = f"/frames/{attachment.relative_to}" if attachment.relative_to else ""
        return self._scene.add_line_segments(
            f"{parent}/box_{attachment.name}", (MM * lines).astype(np.float32), (201, 42, 42), thickness=0.4
        )
