"""Marker messages in serialised form: serialised once, then their numbers are replaced in place.

Building a Marker of thousands of triangles from Point and ColorRGBA objects takes tens of milliseconds. The
layout of the serialised form does not change while every marker keeps its number of points, so only the
numbers are rewritten.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from softsim_core.base import Array, IndexArray, SoftSimError
from softsim_ros.messages.meshes import stress_colours

PROBE_STAMP = np.array([0x15EA51DE, 0x2B1D5EED], dtype="<u4")
"""Time stamp that occurs nowhere else in a message."""


def view_of(copy: bytearray, data: bytes, probe: Array, what: str) -> Array:
    """Return a view of `copy` in the place and shape of a probe, which `data` contains once."""
    pattern = probe.tobytes()
    offset = data.find(pattern)
    if offset < 0 or data.find(pattern, offset + 1) >= 0:
        raise SoftSimError(
            f"mesh marker: cannot locate its {what} in the serialised message; update the suite"
        )
    return np.frombuffer(copy, probe.dtype, probe.size, offset).reshape(probe.shape)


def triangle_marker(frame: str, corners: Array, colours: Array) -> Marker:
    """Return a TRIANGLE_LIST marker built from message objects (slow; for the template and for comparison).

    Args:
        frame: Frame of the corners.
        corners: Corner positions in [m], three per triangle, shape (3 q, 3).
        colours: Red, green, blue, alpha in 0..1, one per corner, shape (3 q, 4).
    """
    marker = Marker(ns="mesh", id=0, type=Marker.TRIANGLE_LIST, action=Marker.ADD)
    marker.header.frame_id = frame
    marker.pose.orientation.w = 1.0
    marker.scale.x = marker.scale.y = marker.scale.z = 1.0
    marker.color = ColorRGBA(r=1.0, g=1.0, b=1.0, a=1.0)
    marker.points = [Point(x=x, y=y, z=z) for x, y, z in corners.tolist()]
    marker.colors = [ColorRGBA(r=r, g=g, b=b, a=a) for r, g, b, a in colours.tolist()]
    return marker


class MarkerTemplate:
    """The serialised marker of one surface, with views of the numbers that change.

    Args:
        frame: Frame of the positions.
        triangles: Vertex indices, shape (q, 3).
        alpha: Opacity in 0..1.

    Raises:
        SoftSimError: the middleware's serialised form is not the expected one.
    """

    def __init__(self, frame: str, triangles: IndexArray, alpha: float = 1.0) -> None:
        self._corner_vertices = np.asarray(triangles).ravel()
        count = len(self._corner_vertices)
        probe_points = (1.0e5 + np.arange(3.0 * count)).astype("<f8").reshape(count, 3)
        probe_colours = (1.0e6 + np.arange(4.0 * count)).astype("<f4").reshape(count, 4)
        marker = triangle_marker(frame, probe_points, probe_colours)
        marker.header.stamp = Time(sec=int(PROBE_STAMP[0]), nanosec=int(PROBE_STAMP[1]))
        data: bytes = serialize_message(marker)
        self._data = bytearray(data)
        self._stamp = view_of(self._data, data, PROBE_STAMP, "time stamp")
        self._points = view_of(self._data, data, probe_points, "points")
        self._colours = view_of(self._data, data, probe_colours, "colours")
        self._colours[:, 3] = alpha
        self._check_round_trip()

    def fill(self, stamp: Time, points: Array, von_mises: Array, highest: float = 0.0) -> bytes:
        """Return the serialised marker of a state, ready for `publisher.publish`.

        Args:
            stamp: Time of the positions.
            points: Vertex positions in [m], shape (p, 3).
            von_mises: Stress at the vertices in [Pa], shape (p,).
            highest: Stress in [Pa] of the last colour; 0 takes the largest of `von_mises`.
        """
        scale = highest if highest > 0.0 else float(np.max(von_mises, initial=0.0))
        self._stamp[:] = stamp.sec, stamp.nanosec
        np.take(points, self._corner_vertices, axis=0, out=self._points)
        self._colours[:, :3] = stress_colours(von_mises, scale)[self._corner_vertices]
        return bytes(self._data)

    def _check_round_trip(self) -> None:
        """Deserialise a filled template once, to detect a changed layout at the start and not in a viewer."""
        vertices = int(self._corner_vertices.max(initial=-1)) + 1
        points = np.linspace(-1.0, 1.0, 3 * vertices).reshape(vertices, 3)
        marker = deserialize_message(self.fill(Time(sec=7, nanosec=8), points, points[:, 2] + 1.0), Marker)
        read = np.array([[point.x, point.y, point.z] for point in marker.points]).reshape(-1, 3)
        colours = np.array([[c.r, c.g, c.b, c.a] for c in marker.colors], dtype=np.float32).reshape(-1, 4)
        stamp = (marker.header.stamp.sec, marker.header.stamp.nanosec)
        if not (
            stamp == (7, 8)
            and np.array_equal(read, points[self._corner_vertices])
            and np.array_equal(colours, self._colours)
        ):
            raise SoftSimError(
                "mesh marker: the spliced message does not read back as written; update the suite"
            )


class MovingMarkers:
    """The serialised array of some markers, with views of their stamps, positions and colours.

    Args:
        markers: The markers; one without points moves by its pose, any other by its points.

    Raises:
        SoftSimError: the middleware's serialised form is not the expected one.
    """

    def __init__(self, markers: Sequence[Marker]) -> None:
        probe = deserialize_message(serialize_message(MarkerArray(markers=list(markers))), MarkerArray)
        places, colours, first = [], [], 1.0e5
        for number, marker in enumerate(probe.markers):
            marker.header.stamp = Time(sec=int(PROBE_STAMP[0]) + number, nanosec=int(PROBE_STAMP[1]))
            place = first + np.arange(3.0 * max(1, len(marker.points))).reshape(-1, 3)
            corners = [Point(x=x, y=y, z=z) for x, y, z in place.tolist()]
            if marker.points:
                marker.points = corners
            else:
                (marker.pose.position,) = corners
            colour = (1.0e6 + 4.0 * number + np.arange(4.0)).astype("<f4")
            r, g, b, a = colour.tolist()
            marker.color = ColorRGBA(r=r, g=g, b=b, a=a)
            places.append(place)
            colours.append(colour)
            first += place.size
        data = serialize_message(probe)
        copy = self._data = bytearray(data)
        stamps = [PROBE_STAMP + np.array([number, 0], dtype="<u4") for number in range(len(places))]
        self._stamps = [view_of(copy, data, stamp, "time stamp") for stamp in stamps]
        self._places = [view_of(copy, data, place, "points") for place in places]
        self._colours = [view_of(copy, data, colour, "colour") for colour in colours]
        for view, marker in zip(self._colours, markers, strict=True):
            view[:] = marker.color.r, marker.color.g, marker.color.b, marker.color.a

    def fill(self, stamp: Time, places: Sequence[Array], colours: Sequence[Array] = ()) -> bytes:
        """Return the serialised array of a state, ready for `publisher.publish`.

        Args:
            stamp: Time of the positions.
            places: For each marker its points, shape (k, 3), or the position of its pose, shape (3,), in [m].
            colours: For each marker red, green, blue and alpha in 0..1, shape (4,); without them the colours
                stay.
        """
        for view, place, moment in zip(self._places, places, self._stamps, strict=True):
            view[:] = place
            moment[:] = stamp.sec, stamp.nanosec
        if len(colours):
            for shown, colour in zip(self._colours, colours, strict=True):
                shown[:] = colour
        return bytes(self._data)
