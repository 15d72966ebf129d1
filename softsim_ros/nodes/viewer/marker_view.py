"""Draw marker arrays of the simulator in the page: cables and their tensions, chambers, contacts, bodies."""

from __future__ import annotations

import re
from binascii import crc32
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, Final

import numpy as np
from cmap import Colormap
from geometry_msgs.msg import PoseArray
from numpy.typing import NDArray
from visualization_msgs.msg import Marker, MarkerArray

from softsim_ros.nodes.viewer.surface import BANDS, MM, Points, next_top

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


def line_width(marker: Marker) -> float:
    """Return the width of a marker's lines in [mm]."""
    return float(max(MM * marker.scale.x, 0.2))


def marker_opacity(marker: Marker) -> float | None:
    """Return the opacity in 0..1 of a transparent marker, and None for any other."""
    alpha = marker.color.a
    return alpha if 0.0 < alpha < 1.0 else None


def node_name(name: str) -> str:
    """Return a foreign name as a part of a name in viser's tree: itself if it is plain, else its CRC-32."""
    plain = re.fullmatch(rf"[\w -]{{0,{LONGEST_NODE_NAME}}}", name)
    return name if plain else f"named_{crc32(name.encode()):08x}"


TENSION_COLOURS: Final = tuple(
    (int(r), int(g), int(b))
    for r, g, b in np.rint(255.0 * Colormap("matplotlib:plasma")(np.linspace(0.1, 0.8, BANDS))[:, :3])
)
"""Red, green, blue in 0..255 of each band of tension; lines of all of them stand out from both pages."""

GAMMA: Final = 2.2
"""Exponent of linear red, green, blue in 0..1."""

SLACK_COLOUR: Final = (134, 142, 150)
SLACK_N: Final = 1e-3
"""Tension in [N] below which a cable is drawn as slack."""


class TensionColours:
    """Colours of cables by the tension of their segments.

    Args:
        moves_frame: Whether each joint moves a frame; the others have actuators, in this order.

    Attributes:
        top: Tension in [N] at the upper end of the scale.
        colours: Colours of the segments of each cable by the number of its marker, shapes (k, 3).
    """

    def __init__(self, moves_frame: Sequence[bool]) -> None:
        self._number = {
            joint: count for count, joint in enumerate(np.flatnonzero(~np.array(moves_frame, bool)))
        }
        self.top = 1.0
        self.colours: dict[int, NDArray[np.uint8]] = {}

    def update(self, rows: NDArray[np.void]) -> None:
        """Take the newest tensions, rows of messages.TENSION.

        The tension of a pair on one motor is a difference; its size counts.
        """
        tension = np.abs(rows["tension"])
        self.top = next_top(self.top, float(tension.max(initial=0.0)))
        bands = np.clip((tension * (BANDS / self.top)).astype(np.int64), 0, BANDS - 1)
        colours = np.array(TENSION_COLOURS, np.uint8)[bands]
        colours[tension < SLACK_N] = SLACK_COLOUR
        self.colours.clear()
        for joint in np.unique(rows["joint"]):
            if (number := self._number.get(joint)) is not None:
                self.colours[number] = colours[rows["joint"] == joint]


class MarkerView:
    """Draws the markers of one topic, in the world's frame.

    Args:
        scene: viser's scene.
        name: Folder of the tree, such as "cables".
        part_of: Returns the part of the scene that a marker draws, given its name and number.
        wireframe: Whether triangles and spheres are drawn as wire frames.
        offset: Distance in [mm] by which triangles are moved along their normals. A surface that lies on the
            wall of a body would otherwise flicker through it.

    Attributes:
        line_colours: Colours of the segments of LINE_STRIP markers by their number, shapes (k, 3); other
            lines have the colour of their marker.
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
        self.line_colours: Mapping[int, NDArray[np.uint8]] = {}
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
        if handle is None or kind != marker.type or not _move(handle, marker, points):
            if handle is not None:
                handle.remove()
            handle = self._make(f"/{self._name}/{node_name(key[0]) or 'marker'}_{key[1]}", marker, points)
            handle.visible = self._shows(key)
            self._drawn[key] = (marker.type, handle)
        if marker.type == Marker.LINE_STRIP:
            colours = self.line_colours.get(key[1], ())
            coloured = len(colours) == len(points)
            shown = np.array(colours)[:, None] if coloured else marker_colour(marker)
            _paint(handle, marker, shown, 1 + coloured)
        return True

    def _make(self, name: str, marker: Marker, points: Points) -> Any:
        colour, size = marker_colour(marker), MM * marker.scale.x
        if marker.type in (Marker.LINE_STRIP, Marker.LINE_LIST):
            return self._scene.add_line_segments(name, points, colors=colour, thickness=line_width(marker))
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


def _paint(handle: Any, marker: Marker, colours: Any, factor: float) -> None:
    """Set colours in 0..255 of drawn lines, which broadcast to (k, 2, 3), and their thickness by a factor.

    The page takes colours of single points as linear values.
    """
    linear = np.rint(255.0 * (np.asarray(colours) / 255.0) ** GAMMA).astype(np.uint8)
    linear = np.broadcast_to(linear, handle.points.shape)
    if not np.array_equal(handle.colors, linear):
        handle.colors, handle.thickness = linear, factor * line_width(marker)


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
