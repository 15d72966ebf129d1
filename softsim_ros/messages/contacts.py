"""Contacts as a cloud of points that carry their normals, forces, gaps and bodies."""

from __future__ import annotations

import numpy as np
from builtin_interfaces.msg import Time
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2, PointField

from softsim_core.dynamics.report import ContactReport
from softsim_ros.messages.buffers import message_array
from softsim_ros.messages.states import header

_NUMBERS = (
    *("x", "y", "z"),
    *("normal_x", "normal_y", "normal_z"),
    *("force_x", "force_y", "force_z"),
    "gap",
)
_BODIES = ("body_a", "body_b")

CONTACT = np.dtype([*((name, "<f4") for name in _NUMBERS), *((name, "<i4") for name in _BODIES)])
"""A contact: its place and its gap in [m], the unit normal from body b to body a, the force on a in [N]."""


def contact_cloud(stamp: Time, frame: str, contacts: ContactReport) -> PointCloud2:
    """All contacts of a step, with those that are only close (force 0).

    Args:
        stamp: Time of the step.
        frame: Frame of places, normals and forces.
        contacts: What touched.
    """
    rows = np.zeros(len(contacts.points), dtype=CONTACT)
    columns = (contacts.points, contacts.normals, contacts.forces, contacts.gaps[:, None])
    for name, column in zip(_NUMBERS, np.concatenate(columns, axis=1).T, strict=True):
        rows[name] = column
    for name, body in zip(_BODIES, contacts.bodies.T, strict=True):
        rows[name] = body
    kinds = dict.fromkeys(_NUMBERS, PointField.FLOAT32) | dict.fromkeys(_BODIES, PointField.INT32)
    return PointCloud2(
        header=header(stamp, frame),
        height=1,
        width=len(rows),
        fields=[
            PointField(name=name, offset=4 * index, datatype=kind, count=1)
            for index, (name, kind) in enumerate(kinds.items())
        ],
        is_bigendian=False,
        point_step=CONTACT.itemsize,
        row_step=CONTACT.itemsize * len(rows),
        data=message_array(rows, "B"),
        is_dense=True,
    )


def read_contact_cloud(message: PointCloud2) -> NDArray[np.void]:
    """The contacts of a message made by `contact_cloud`, as rows of CONTACT; a view, not a copy."""
    return np.frombuffer(message.data, dtype=CONTACT)
