"""Draw marker arrays of the simulator in the page: cables, chambers, contacts, rigid bodies."""

from __future__ import annotations

import re
from binascii import crc32
from collections.abc import Callable, Collection
from typing import Any, Final

import numpy as np
from geometry_msgs.msg import PoseArray
from numpy.typing import NDArray
from visualization_msgs.msg import Marker, MarkerArray

from softsim_ros.nodes.viewer.surface import MM, Points

LONGEST_AXES_MM: Final = 30.0
"""Upper limit of the length of a rigid body's axes, which otherwise reach out of the body."""


LONGEST_NODE_NAME: Final = 60

_SINGLE: Final = frozenset({Marker.ARROW, Marker.CUBE, Marker.SPHERE, Marker.CYLINDER})


def marker_points(marker: Marker) -> Points:
    """Return the points of a marker in [mm], shape (k, 3): its list, or its position if it has none."""
    at = marker.pose.position
    shift = np.array([at.x, at.y, at.z])
    points = np.array([(p.x, p.y, p.z) for p in marker.points]).reshape(-1, 3)
    return np.asarray(MM * (shift[None] if marker.type in _SINGLE else points + shift), dtype=np.float32)


def marker_colour(marker: Marker) -> tuple[int, int, int]:
    """Return red, green, blue in 0..255."""
    colour = marker.color
    return round(255 * colour.r), round(255 * colour.g), round(255 * colour.b)


def marker_opacity(marker: Marker) -> float | None:
    """Return the opacity in 0..1 of a transparent marker, and None for any other."""
    alpha = marker.color.a
    return alpha if 0.0 < alpha < 1.0 else None


def node_name(name: str) -> str:
    """Return a foreign name as a part of a name in viser's tree: itself if it is plain, else its CRC-32."""
    plain = re.fullmatch(rf"[\w -]{{0,{LONGEST_NODE_NAME}}}", name)
    return name if plain else f"named_{crc32(name.encode()):08x}"


class MarkerView:
    """Draws the markers of one topic, in the world's frame.

    Args:
        scene: viser's scene.
        name: Folder of the tree, such as "cables".
        part_of: Returns the part of the scene that a marker draws, given its name and number.
        wireframe: Whether triangles and spheres are drawn as wire frames.
        offset: Distance in [mm] by which triangles are moved along their normals. A surface that lies on the
            wall of a body would otherwise flicker through it.
    """

    def __init__(
        self,
        scene: Any,
        name: str,
        *,
        part_of: Callable[[str, int], str] = lambda name, number: "",
        wireframe: bool = False,
        offset: float = 0.0,
    ) -> None:
        self._scene, self._name = scene, name
        self._part_of, self._wireframe, self._offset = part_of, wireframe, offset
        self._visible, self._hidden = True, frozenset[str]()
        self._drawn: dict[tuple[str, int], tuple[int, Any]] = {}

    def switch(self, shown: bool, hidden: Collection[str] = ()) -> None:
        """Show or hide all markers; those of `hidden` parts are always hidden."""
        self._visible, self._hidden = shown, frozenset(hidden)
        for key, (_, handle) in self._drawn.items():
            handle.visible = self._shows(key)

    def clear(self) -> None:
        """Remove all markers."""
        self.update(MarkerArray())

    def update(self, message: MarkerArray) -> None:
        """Draw the markers of a message and remove all others."""
        named = set()
        for marker in message.markers:
            key = (marker.ns, marker.id)
            if marker.action == Marker.ADD and self._draw(key, marker):
                named.add(key)
        for key in self._drawn.keys() - named:
            self._drawn.pop(key)[1].remove()

    def _shows(self, key: tuple[str, int]) -> bool:
        return self._visible and self._part_of(*key) not in self._hidden

    def _draw(self, key: tuple[str, int], marker: Marker) -> bool:
        points = marker_points(marker)
        if marker.type == Marker.LINE_STRIP:
            points = np.stack([points[:-1], points[1:]], axis=1)
        elif marker.type == Marker.LINE_LIST:
            points = points[: len(points) // 2 * 2].reshape(-1, 2, 3)
        elif marker.type == Marker.TRIANGLE_LIST and self._offset:
            points = points + np.float32(self._offset) * facing(points)
        if not len(points):
            return False
        kind, handle = self._drawn.get(key, (-1, None))
        if handle is not None and kind == marker.type and _move(handle, marker, points):
            return True
        if handle is not None:
            handle.remove()
        handle = self._make(f"/{self._name}/{node_name(key[0]) or 'marker'}_{key[1]}", marker, points)
        handle.visible = self._shows(key)
        self._drawn[key] = (marker.type, handle)
        return True

    def _make(self, name: str, marker: Marker, points: Points) -> Any:
        colour, size = marker_colour(marker), MM * marker.scale.x
        if marker.type in (Marker.LINE_STRIP, Marker.LINE_LIST):
            return self._scene.add_line_segments(name, points, colour, thickness=max(size, 0.2))
        if marker.type == Marker.TRIANGLE_LIST:
            return self._scene.add_mesh_simple(
                name,
                points,
                corner_faces(points),
                color=colour,
                opacity=marker_opacity(marker),
                wireframe=self._wireframe,
                side="double",
            )
        if marker.type == Marker.SPHERE:
            return self._scene.add_icosphere(
                name, size / 2.0, colour, subdivisions=2, wireframe=self._wireframe, position=points[0]
            )
        return self._scene.add_point_cloud(
            name, points, colour, point_size=max(size, 0.5), point_shape="circle", precision="float32"
        )


def corner_faces(corners: Points) -> NDArray[np.uint32]:
    """Return triangles over a list of their corners (3 k, 3), shape (k, 3)."""
    return np.arange(len(corners) // 3 * 3, dtype=np.uint32).reshape(-1, 3)


def facing(corners: Points) -> Points:
    """Return the unit normal of each corner's triangle; corners and normals have shape (3 k, 3)."""
    a, b, c = np.moveaxis(corners.reshape(-1, 3, 3), 1, 0)
    ways = np.cross(b - a, c - a)
    ways /= np.maximum(np.linalg.norm(ways, axis=1, keepdims=True), 1e-12)
    return np.repeat(ways, 3, axis=0)


def _move(handle: Any, marker: Marker, points: Points) -> bool:
    """Move a drawn marker, and recolour triangles; return False if the number of corners has changed."""
    if marker.type == Marker.SPHERE:
        handle.position = points[0]
    elif marker.type != Marker.TRIANGLE_LIST:
        handle.points = points
    elif len(handle.vertices) == len(points):
        handle.vertices = points
        if handle.color != (colour := marker_colour(marker)):
            handle.color = colour
    else:
        return False
    return True


class RigidView:
    """Draws rigid bodies and their frames: the triangles once, then the poses."""

    def __init__(self, scene: Any) -> None:
        self._scene = scene
        self._bodies: list[tuple[str, Any, Any]] = []  # name, frame, surface
        self._visible, self._axes, self._hidden = True, False, frozenset[str]()

    def show(self, message: MarkerArray) -> None:
        """Draw other bodies: one TRIANGLE_LIST each, in the body's own frame."""
        for _, frame, _ in self._bodies:
            frame.remove()
        names = [marker.ns or str(marker.id) for marker in message.markers]
        apart = len({*names}) == len(names)  # otherwise use numbers: two nodes never share a name
        shown = [node_name(name) if apart else str(number) for number, name in enumerate(names)]
        self._bodies = [
            (name, *self._make(node, marker))
            for name, node, marker in zip(names, shown, message.markers, strict=True)
        ]
        self.switch(self._visible, axes=self._axes, hidden=self._hidden)

    def switch(self, shown: bool, *, axes: bool = False, hidden: Collection[str] = ()) -> None:
        """Show or hide surfaces (`shown`) and frames (`axes`); `hidden` parts show neither."""
        self._visible, self._axes, self._hidden = shown, axes, frozenset(hidden)
        for name, frame, surface in self._bodies:
            there = f"rigid_bodies/{name}" not in self._hidden
            surface.visible = shown and there
            frame.show_axes = axes and there

    def move(self, message: PoseArray) -> None:
        """Move the bodies, in their order; poses of another number of bodies are of another scene."""
        if len(message.poses) != len(self._bodies):
            return
        for (_, frame, _), pose in zip(self._bodies, message.poses, strict=True):
            turn = pose.orientation
            frame.position = (MM * pose.position.x, MM * pose.position.y, MM * pose.position.z)
            frame.wxyz = (turn.w, turn.x, turn.y, turn.z)

    def _make(self, node: str, marker: Marker) -> tuple[Any, Any]:
        """Return the frame and the surface of a body, under a name in viser's tree."""
        vertices = marker_points(marker)
        length = min(1.3 * float(np.abs(vertices).max(initial=0.0)), LONGEST_AXES_MM)
        frame = self._scene.add_frame(
            f"/rigid/{node}", show_axes=False, axes_length=length, axes_radius=length / 24.0
        )
        surface = self._scene.add_mesh_simple(
            f"/rigid/{node}/surface",
            vertices,
            corner_faces(vertices),
            color=marker_colour(marker),
            opacity=marker_opacity(marker),
            flat_shading=True,
            side="double",
        )
        return frame, surface
