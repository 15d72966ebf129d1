"""Markers that move and change colour, sent as bytes: serialised once, their numbers replaced in place.

Building thousands of Point objects costs milliseconds, see messages.marker; the serialised form keeps its
layout as long as every marker keeps its number of points.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from softsim_core.arrays import Array
from softsim_ros.messages.marker import PROBE_STAMP, block


class MovingMarkers:
    """The serialised array of some markers, with views on their stamps, places and colours.

    Args:
        markers: As they are; one without points moves by its pose, any other by its points.

    Raises:
        SoftSimError: the middleware's serialised form is not the expected one.
    """

    def __init__(self, markers: Sequence[Marker]) -> None:
        copy = serialize_message(MarkerArray(markers=list(markers)))
        probe, places, colours, first = deserialize_message(copy, MarkerArray), [], [], 1.0e5
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
        self._data = bytearray(data)
        self._stamps = [
            self._view(data, PROBE_STAMP + np.array([number, 0], dtype="<u4"), "time stamp")
            for number in range(len(places))
        ]
        self._places = [self._view(data, place, "points") for place in places]
        self._colours = [self._view(data, colour, "colour") for colour in colours]
        for view, marker in zip(self._colours, markers, strict=True):
            view[:] = marker.color.r, marker.color.g, marker.color.b, marker.color.a

    def _view(self, data: bytes, probe: Array, what: str) -> Array:
        """The numbers of `self._data` that stand where `data` has those of a probe, in its shape."""
        offset = block(data, probe.tobytes(), what)
        return np.frombuffer(self._data, probe.dtype, probe.size, offset).reshape(probe.shape)

    def fill(self, stamp: Time, places: Sequence[Array], colours: Sequence[Array] = ()) -> bytes:
        """The serialised array at this state, ready for `publisher.publish`.

        Args:
            stamp: Time of the positions.
            places: For each marker its points, shape (k, 3), or the position of its pose, shape (3,), in [m].
            colours: For each marker red, green, blue and alpha in 0..1, shape (4,); without them they stay.
        """
        for view, place, moment in zip(self._places, places, self._stamps, strict=True):
            view[:] = place
            moment[:] = stamp.sec, stamp.nanosec
        if len(colours):
            for shown, colour in zip(self._colours, colours, strict=True):
                shown[:] = colour
        return bytes(self._data)
