"""Surfaces with stress colours as messages.

Colours are chosen in OKLCH, in which equal steps of lightness look equal: from dark blue through magenta and
orange to light yellow, so that the order is visible even in grey. Source: Ottosson 2020, "A perceptual color
space for image processing".
"""

from __future__ import annotations

from binascii import crc32
from collections.abc import Mapping
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2, PointField
from shape_msgs.msg import Mesh, MeshTriangle

from softsim_core.base import Array, IndexArray
from softsim_ros.messages.states import header, message_array

STEPS = 256
_LIGHTNESS = (0.25, 0.95)
_HUE_DEG = (265.0, 460.0)  # blue, magenta (330), red (380), orange (410), yellow (460 = 100)
_CHROMA = 0.17

_LMS_OF_LAB = np.array(
    [
        [1.0, 0.3963377774, 0.2158037573],
        [1.0, -0.1055613458, -0.0638541728],
        [1.0, -0.0894841775, -1.2914855480],
    ]
)
_RGB_OF_LMS = np.array(
    [
        [4.0767416621, -3.3077115913, 0.2309699292],
        [-1.2684380046, 2.6097574011, -0.3413193965],
        [-0.0041960863, -0.7034186147, 1.7076147010],
    ]
)


def linear_rgb(lightness: Array, chroma: Array, hue_rad: Array) -> Array:
    """Return linear red, green, blue of OKLCH colours, shape (n, 3); outside 0..1 beyond a screen's range."""
    lab = np.stack([lightness, chroma * np.cos(hue_rad), chroma * np.sin(hue_rad)], axis=-1)
    rgb: Array = (lab @ _LMS_OF_LAB.T) ** 3 @ _RGB_OF_LMS.T
    return rgb


def colour_table(steps: int = STEPS) -> NDArray[np.float32]:
    """Return the scale as sRGB rows from lowest to highest value, shape (steps, 3), with reduced chroma.

    The chroma is the largest that a screen can show.
    """
    along = np.linspace(0.0, 1.0, steps)
    lightness = _LIGHTNESS[0] + (_LIGHTNESS[1] - _LIGHTNESS[0]) * along
    hue = np.radians(_HUE_DEG[0] + (_HUE_DEG[1] - _HUE_DEG[0]) * along)
    low, high = np.zeros(steps), np.full(steps, _CHROMA)
    for _ in range(30):  # bisection for the largest chroma a screen can show
        middle = 0.5 * (low + high)
        rgb = linear_rgb(lightness, middle, hue)
        shown = ((rgb >= 0.0) & (rgb <= 1.0)).all(axis=1)
        low, high = np.where(shown, middle, low), np.where(shown, high, middle)
    linear = np.clip(linear_rgb(lightness, low, hue), 0.0, 1.0)
    screen = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1.0 / 2.4) - 0.055)
    return screen.astype(np.float32)


_TABLE = colour_table()


def stress_colours(values: Array, highest: float) -> NDArray[np.float32]:
    """Return screen (sRGB) colours of values on a scale from 0 to `highest`.

    Args:
        values: Stress in [Pa], shape (n,), >= 0.
        highest: Stress in [Pa] that gets the last colour; values above share it; with 0 all get the
            first.

    Returns:
        Red, green, blue in 0..1, shape (n, 3).
    """
    if not highest > 0.0:
        return np.repeat(_TABLE[:1], len(values), axis=0)
    steps = np.clip(np.rint(np.asarray(values) * ((STEPS - 1) / highest)), 0, STEPS - 1)
    return _TABLE[steps.astype(np.intp)]


POINT = np.dtype([(name, "<f4") for name in ("x", "y", "z", "von_mises")])
"""A point: position in [m], von Mises stress in [Pa]."""

_DATATYPES = {"<f4": PointField.FLOAT32, "<i4": PointField.INT32}


def cloud(stamp: Time, frame: str, rows: NDArray[np.void]) -> PointCloud2:
    """Return rows of a structured array, shape (p,), as a message with a field for each of their names."""
    fields: Mapping[str, Any] = rows.dtype.fields or {}
    return PointCloud2(
        header=header(stamp, frame),
        height=1,
        width=len(rows),
        fields=[
            PointField(name=name, offset=offset, datatype=_DATATYPES[kind.str], count=1)
            for name, (kind, offset, *_) in fields.items()
        ],
        is_bigendian=False,
        point_step=rows.dtype.itemsize,
        row_step=rows.nbytes,
        data=message_array(rows, "B"),
        is_dense=True,
    )


def point_cloud(stamp: Time, frame: str, points: Array, von_mises: Array) -> PointCloud2:
    """Return vertices with their stress as rows of POINT, in the order of the vertices.

    Args:
        stamp: Time of the positions.
        frame: Frame of the positions.
        points: Positions in [m], shape (p, 3).
        von_mises: Stress at the points in [Pa], shape (p,).
    """
    rows = np.empty((len(points), 4), dtype="<f4")
    rows[:, :3] = points
    rows[:, 3] = von_mises
    return cloud(stamp, frame, rows.view(POINT)[:, 0])


def read_point_cloud(message: PointCloud2) -> NDArray[np.float32]:
    """Return rows (x, y, z, von_mises) of a message of `point_cloud`, shape (p, 4); a view, not a copy."""
    return np.frombuffer(message.data, dtype="<f4").reshape(-1, 4)


def topology(points: Array, triangles: IndexArray) -> Mesh:
    """Return rest vertices and triangles of a surface as a message.

    It is built from message objects, which takes milliseconds for thousands of triangles; meant to be sent
    once.

    Args:
        points: Rest positions in [m], shape (p, 3).
        triangles: Vertex indices, shape (q, 3).
    """
    corners = np.asarray(triangles, dtype=np.uint32)
    return Mesh(
        triangles=[MeshTriangle(vertex_indices=corner) for corner in corners],
        vertices=[Point(x=x, y=y, z=z) for x, y, z in np.asarray(points, dtype=float).tolist()],
    )


def mesh_checksum(cells: IndexArray, points: Array | None = None) -> int:
    """Return a CRC-32 that identifies a mesh, independent of how it was transferred.

    Args:
        cells: Point indices, shape (k, corners).
        points: Rest positions in [m], shape (p, 3); None: the cells are sufficient.
    """
    before = 0 if points is None else crc32(np.ascontiguousarray(points, dtype="<f8").tobytes())
    return crc32(np.ascontiguousarray(cells, dtype="<u4").tobytes(), before)
