"""What changes in time: positions, velocities, frames, joints. Bytes out, the same bytes in."""

from __future__ import annotations

import io
from dataclasses import dataclass, fields

import numpy as np

from softsim_core.arrays import Array
from softsim_core.errors import SnapshotError


@dataclass(slots=True, eq=False)
class State:
    """State of a simulation (arrays are changed in place).

    Attributes:
        positions: Node positions in [m], shape (n, 3); nodes of zones follow frames and joints.
        velocities: Node velocities in [m/s], shape (n, 3).
        frame_positions: Origins of the free frames in [m], shape (f, 3).
        frame_rotations: Rotations of the free frames, shape (f, 3, 3).
        border_velocities: Velocity and spin of the free frames, then joint velocities, shape (6 f + j,).
        joint_positions: Joint positions in [rad] or [m], shape (j,).
        joint_efforts: Torque in [N m] or force in [N] that each joint's drive applied in the last step, shape (j,).
        base_shift: Shift in [m] of the joint bases along their slide axes, shape (1,).
    """

    positions: Array
    velocities: Array
    frame_positions: Array
    frame_rotations: Array
    border_velocities: Array
    joint_positions: Array
    joint_efforts: Array
    base_shift: Array

    def arrays(self) -> dict[str, Array]:
        """The arrays by name."""
        return {item.name: getattr(self, item.name) for item in fields(self)}

    def copy_from(self, other: State) -> None:
        """Take over the values of a state of the same scene, in place."""
        for name, array in self.arrays().items():
            array[...] = getattr(other, name)

    def copy(self) -> State:
        """An independent copy."""
        return State(**{name: array.copy() for name, array in self.arrays().items()})


def pack(header: bytes, arrays: dict[str, Array]) -> bytes:
    """Bytes of named arrays behind a header; equal arrays give equal bytes."""
    stream = io.BytesIO()
    stream.write(header)
    for array in arrays.values():
        stream.write(np.ascontiguousarray(array, dtype="<f8").tobytes())
    return stream.getvalue()


def unpack(data: bytes, header: bytes, arrays: dict[str, Array]) -> None:
    """Fill `arrays` in place from bytes of `pack` with the same header.

    Raises:
        SnapshotError: another header or length; nothing is changed then.
    """
    expected = len(header) + 8 * sum(array.size for array in arrays.values())
    if data[: len(header)] != header or len(data) != expected:
        raise SnapshotError("not a snapshot of this scene: take a new one with the scene that is running")
    values = np.frombuffer(data, dtype="<f8", offset=len(header))
    if not np.isfinite(values).all():
        raise SnapshotError("the snapshot holds a value that is not finite; take a new one")
    start = 0
    for array in arrays.values():
        array[...] = values[start : start + array.size].reshape(array.shape)
        start += array.size
