"""What changes in time: positions, velocities, frames, joints. Bytes out, the same bytes in."""

from __future__ import annotations

import numpy as np

from softsim_core.arrays import Array
from softsim_core.errors import SnapshotError

MEMORY = 4
"""Numbers in a row of State.memory: what touches (as a number), and the force in three directions in [N]."""


class State:
    """State of a simulation: views of one buffer, changed in place.

    Args:
        nodes, frames, joints, rigid: How many there are.

    Attributes:
        buffer: All numbers, shape (s,).
        positions: Node positions in [m], shape (n, 3); nodes of zones follow frames and joints.
        velocities: Node velocities in [m/s], shape (n, 3).
        frame_positions: Origins of the free frames in [m], shape (f, 3).
        frame_rotations: Rotations of the free frames, shape (f, 3, 3).
        border_velocities: Velocity and spin of the free frames, then joint velocities, shape (6 f + j,).
        joint_positions: Joint positions in [rad] or [m], shape (j,).
        joint_efforts: Torque in [N m] or force in [N] that each joint's drive applied in the last step, shape
            (j,).
        base_shift: Shift in [m] of the joint bases along their slide axes, shape (1,).
        rigid_positions: Centres of mass of the rigid bodies in [m], shape (r, 3).
        rigid_rotations: Their rotations, shape (r, 3, 3).
        rigid_velocities: Their velocity in [m/s] and spin in [rad/s], world axes, shape (r, 6).
        memory: What the contact solver starts from: the forces of the last step; see dynamics.contacts. Not
            in the buffer.
    """

    __slots__ = (
        "base_shift",
        "border_velocities",
        "buffer",
        "frame_positions",
        "frame_rotations",
        "joint_efforts",
        "joint_positions",
        "memory",
        "positions",
        "rigid_positions",
        "rigid_rotations",
        "rigid_velocities",
        "velocities",
    )

    def __init__(self, nodes: int, frames: int, joints: int, rigid: int = 0) -> None:
        shapes: dict[str, tuple[int, ...]] = {
            "positions": (nodes, 3),
            "velocities": (nodes, 3),
            "frame_positions": (frames, 3),
            "frame_rotations": (frames, 3, 3),
            "border_velocities": (6 * frames + joints,),
            "joint_positions": (joints,),
            "joint_efforts": (joints,),
            "base_shift": (1,),
            "rigid_positions": (rigid, 3),
            "rigid_rotations": (rigid, 3, 3),
            "rigid_velocities": (rigid, 6),
        }
        ends = np.cumsum([int(np.prod(shape)) for shape in shapes.values()])
        self.buffer: Array = np.zeros(ends[-1])
        views = np.split(self.buffer, ends[:-1])
        for (name, shape), view in zip(shapes.items(), views, strict=True):
            setattr(self, name, view.reshape(shape))
        self.memory: Array = np.zeros((0, MEMORY))

    positions: Array
    velocities: Array
    frame_positions: Array
    frame_rotations: Array
    border_velocities: Array
    joint_positions: Array
    joint_efforts: Array
    base_shift: Array
    rigid_positions: Array
    rigid_rotations: Array
    rigid_velocities: Array

    def copy_from(self, other: State) -> None:
        """Take over the values of a state of the same scene, in place."""
        np.copyto(self.buffer, other.buffer)
        self.memory = other.memory


def pack(header: bytes, arrays: list[Array]) -> bytes:
    """Bytes of arrays behind a header; equal arrays give equal bytes."""
    return header + b"".join(np.ascontiguousarray(array, dtype="<f8").tobytes() for array in arrays)


def unpack(data: bytes, header: bytes, shapes: list[tuple[int, ...]]) -> list[Array]:
    """The arrays of `shapes` from bytes of `pack` with the same header.

    Raises:
        SnapshotError: another header or length, or a value that is not finite.
    """
    sizes = [int(np.prod(shape)) for shape in shapes]
    if shapes and -1 in shapes[-1]:  # the last array is as long as what is left
        row = -sizes[-1]
        sizes[-1] = (len(data) - len(header)) // 8 - sum(sizes[:-1])
        sizes[-1] -= sizes[-1] % row
    if data[: len(header)] != header or len(data) != len(header) + 8 * sum(sizes):
        raise SnapshotError("not a snapshot of this scene: take a new one with the scene that is running")
    values = np.frombuffer(data, dtype="<f8", offset=len(header)).astype(float)
    if not np.isfinite(values).all():
        raise SnapshotError("the snapshot holds a value that is not finite; take a new one")
    parts = np.split(values, np.cumsum(sizes)[:-1])
    return [part.reshape(shape) for part, shape in zip(parts, shapes, strict=True)]
