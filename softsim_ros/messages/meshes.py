"""Surfaces as messages: moving vertices with their stress, and the triangles that join them."""

from __future__ import annotations

from binascii import crc32

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2, PointField
from shape_msgs.msg import Mesh, MeshTriangle

from softsim_core.arrays import Array, IndexArray
from softsim_ros.messages.buffers import message_array
from softsim_ros.messages.states import header

POINT_FIELDS = ("x", "y", "z", "von_mises")
"""Fields of a point, float32 each: position in [m], von Mises stress in [Pa]."""


def point_cloud(stamp: Time, frame: str, points: Array, von_mises: Array) -> PointCloud2:
    """Vertices with their stress as float32 x, y, z, von_mises; the order of the vertices is kept.

    Args:
        stamp: Time of the positions.
        frame: Frame of the positions.
        points: Positions in [m], shape (p, 3).
        von_mises: Stress at the points in [Pa], shape (p,).
    """
    rows = np.empty((len(points), 4), dtype="<f4")
    rows[:, :3] = points
    rows[:, 3] = von_mises
    return PointCloud2(
        header=header(stamp, frame),
        height=1,
        width=len(rows),
        fields=[
            PointField(name=name, offset=4 * index, datatype=PointField.FLOAT32, count=1)
            for index, name in enumerate(POINT_FIELDS)
        ],
        is_bigendian=False,
        point_step=16,
        row_step=16 * len(rows),
        data=message_array(rows, "B"),
        is_dense=True,
    )


def read_point_cloud(message: PointCloud2) -> NDArray[np.float32]:
    """Rows (x, y, z, von_mises) of a message made by `point_cloud`, shape (p, 4); a view, not a copy."""
    return np.frombuffer(message.data, dtype="<f4").reshape(-1, len(POINT_FIELDS))


def topology(points: Array, triangles: IndexArray) -> Mesh:
    """Rest vertices and triangles of a surface.

    Built from message objects: milliseconds for thousands of triangles; meant to be sent once.

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
    """CRC-32 by which a mesh is known again, whichever way it came.

    Args:
        cells: Point indices, shape (k, corners).
        points: Rest positions in [m], shape (p, 3); None: the cells tell enough.
    """
    before = 0 if points is None else crc32(np.ascontiguousarray(points, dtype="<f8").tobytes())
    return crc32(np.ascontiguousarray(cells, dtype="<u4").tobytes(), before)
