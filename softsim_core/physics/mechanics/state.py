"""The state of a model: every quantity that changes in time, by name, and its form as bytes.

The bytes are: a line with format and version; the SHA-256 fingerprint of the scene; the length of the table
(8 bytes, little endian) and the table, JSON `[[name, [length, ...]], ...]`; all arrays in order as
little-endian float64; the SHA-256 checksum of everything before it.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping

import numpy as np

from softsim_core.base import Array, SnapshotError, float_array, listing

MAGIC = b"softsim snapshot, version 2\n"
"""First line of a snapshot of this format."""

_FAMILY = b"softsim snapshot, version "
_DIGEST = 32
_ORTHOGONAL = 1e-6


def pack(fingerprint: bytes, arrays: Mapping[str, Array]) -> bytes:
    """Return the bytes of named arrays of the scene with a fingerprint (32 bytes)."""
    table = json.dumps([[name, array.shape] for name, array in arrays.items()]).encode()
    numbers = b"".join(np.ascontiguousarray(array, dtype="<f8").tobytes() for array in arrays.values())
    body = MAGIC + fingerprint + len(table).to_bytes(8, "little") + table + numbers
    return body + hashlib.sha256(body).digest()


def unpack(data: bytes, fingerprint: bytes, shapes: Mapping[str, tuple[int, ...]]) -> dict[str, Array]:
    """Return the arrays of `pack`, by name.

    Args:
        data: The bytes.
        fingerprint: Fingerprint of the running scene.
        shapes: Names and shapes of all arrays; -1 is any length.

    Raises:
        SnapshotError: another format, another scene, damaged or cut bytes, a missing or unknown name, a wrong
            shape, or a value that is not finite.
    """
    if not data.startswith(MAGIC):
        if data.startswith(_FAMILY):
            raise SnapshotError("the snapshot is of another version of the suite; save a new one")
        raise SnapshotError(
            "not a snapshot of this scene: an older version wrote it, or it is something else; save a new one"
        )
    body, checksum = data[:-_DIGEST], data[-_DIGEST:]
    if hashlib.sha256(body).digest() != checksum:
        raise SnapshotError("the snapshot is damaged or cut short; save a new one")
    if body[len(MAGIC) : len(MAGIC) + _DIGEST] != fingerprint:
        raise SnapshotError("not a snapshot of this scene: save a new one with the scene that is running")
    start = len(MAGIC) + _DIGEST + 8
    end = start + int.from_bytes(body[start - 8 : start], "little")
    try:
        stored = {str(name): tuple(map(int, shape)) for name, shape in json.loads(body[start:end])}
        values = np.frombuffer(body, dtype="<f8", offset=end).astype(float)
    except (ValueError, TypeError, RecursionError) as error:
        raise SnapshotError("the snapshot's table of contents is damaged; save a new one") from error
    _compare(stored, shapes)
    if len(values) != sum(math.prod(shape) for shape in stored.values()):
        raise SnapshotError("the snapshot is shorter or longer than its table says; save a new one")
    if not np.isfinite(values).all():
        raise SnapshotError("the snapshot holds a value that is not finite; save a new one")
    parts = np.split(values, np.cumsum([int(np.prod(shape)) for shape in stored.values()])[:-1])
    return {name: part.reshape(shape) for (name, shape), part in zip(stored.items(), parts, strict=True)}


def need_rotations(name: str, rotations: Array) -> None:
    """Refuse matrices (k, 3, 3) that are not rotation matrices.

    Raises:
        SnapshotError: one of them is not orthogonal, or mirrors.
    """
    products = rotations @ rotations.transpose(0, 2, 1)
    if not (np.abs(products - np.eye(3)) < _ORTHOGONAL).all() or not (np.linalg.det(rotations) > 0.0).all():
        raise SnapshotError(f"the snapshot's {name} are no rotations; save a new one")


def _compare(stored: Mapping[str, tuple[int, ...]], shapes: Mapping[str, tuple[int, ...]]) -> None:
    """Refuse names and shapes that differ from `shapes`."""
    for problem, names in (
        ("lacks", [name for name in shapes if name not in stored]),
        ("holds unknown", [name for name in stored if name not in shapes]),
    ):
        if names:
            raise SnapshotError(f"the snapshot {problem} {listing(names)}; save a new one")
    for name, shape in shapes.items():
        fits = len(stored[name]) == len(shape) and all(
            want == has or (want == -1 and has >= 0) for want, has in zip(shape, stored[name], strict=True)
        )
        if not fits:
            raise SnapshotError(
                f"the snapshot's {name} has shape {stored[name]}, not {shape}; save a new one"
            )


WARM_START_COLUMNS = 4
"""Numbers in a row of State.warm_start: the number of a contact, and its force in three directions in [N]."""

MOVED = "moved"
"""Name in State.extra of the displacement of the nodes in the last step in [m], (n, 3), for elements."""
ACCELERATION = "acceleration"
"""Name in State.extra of the accelerations of the nodes in [m/s^2], (n, 3), if the step uses them."""
REDUCED_ACCELERATION = "reduced_acceleration"
"""Name in State.extra of the accelerations of frames and joints, shape (r,), if the step uses them."""
HOLDING = "holding"
"""Name in State.extra of the flag that contacts held deformable bodies in the last step, (1,), 0 or 1."""
COMMANDED = "commanded"
"""Name in State.extra of the last commands of joints, shape (j,), if steps may be cut in parts."""
EFFORT_CHANGE = "effort_change"
"""Name in State.extra of the joint efforts in the last part of a cut step minus those of the step, (j,)."""

ACTUATOR_STATE = "actuators"
"""Name in State.extra of the stored values of all actuators, joined, shape (k,)."""

PASSIVE_EFFORTS = "passive_efforts"
"""Name in State.extra of the multipliers of the actuators' passive rows, shape (m,)."""


def memory_name(group: int) -> str:
    """Return the name in State.extra of the memory of a relaxing law's cells; see fem.prony."""
    return f"memory_{group}"


def step_stress_name(group: int) -> str:
    """Return the name in State.extra of these cells' stress that is fixed during a step, in [Pa]."""
    return f"held_{group}"


class State:
    """State of a simulation: named views of one buffer, changed in place.

    Assigning to an attribute copies into the buffer, with the existing shape and type.

    Args:
        nodes, frames, joints, rigid: Number of each.
        extra: Shapes of further arrays by name, see `extra`.
        buffer: Buffer to use; None: a new one, all zeros.

    Attributes:
        buffer: All numbers except the warm start, shape (s,).
        positions: Node positions in [m], shape (n, 3); nodes of regions follow frames and joints.
        velocities: Node velocities in [m/s], shape (n, 3).
        frame_positions: Origins of the free frames in [m], shape (f, 3).
        frame_rotations: Rotations of the free frames, shape (f, 3, 3).
        reduced_velocities: Velocity and spin of the free frames, then joint velocities, shape (6 f + j,).
        joint_positions: Joint positions in [rad] or [m], shape (j,).
        joint_efforts: Torque in [N m] or force in [N] that each joint's drive applied in the last step, shape
            (j,); an actuator's is its multiplier, such as a tension. For a step cut in parts, their mean in
            time.
        base_positions: Origins of the joint bases in [m] while their parents are at rest, without the shift,
            shape (j, 3).
        base_shift: Shift in [m] of the joint bases along their slide axes, shape (1,).
        rigid_positions: Centres of mass of the rigid bodies in [m], shape (r, 3).
        rigid_rotations: Rotations of the rigid bodies, shape (r, 3, 3).
        rigid_velocities: Velocity in [m/s] and spin in [rad/s] of the rigid bodies, world axes, shape (r, 6).
        extra: Further arrays of the scene by name, such as the history of a material.
        warm_start: Start values of the contact solver: the forces of the last step, shape (k, 4); replaced as
            a whole by each step. Not in the buffer.
    """

    def __init__(
        self,
        nodes: int,
        frames: int,
        joints: int,
        rigid: int = 0,
        extra: Mapping[str, tuple[int, ...]] | None = None,
        buffer: Array | None = None,
    ) -> None:
        shapes: dict[str, tuple[int, ...]] = {
            "positions": (nodes, 3),
            "velocities": (nodes, 3),
            "frame_positions": (frames, 3),
            "frame_rotations": (frames, 3, 3),
            "reduced_velocities": (6 * frames + joints,),
            "joint_positions": (joints,),
            "joint_efforts": (joints,),
            "base_positions": (joints, 3),
            "base_shift": (1,),
            "rigid_positions": (rigid, 3),
            "rigid_rotations": (rigid, 3, 3),
            "rigid_velocities": (rigid, 6),
        }
        own, further = len(shapes), list((extra or {}).items())
        named = [*shapes.items(), *further]
        ends = np.cumsum([int(np.prod(shape)) for _, shape in named])
        buffer = np.zeros(ends[-1]) if buffer is None else buffer
        views = [
            view.reshape(shape) for (_, shape), view in zip(named, np.split(buffer, ends[:-1]), strict=True)
        ]
        place = object.__setattr__
        place(self, "buffer", buffer)
        for name, view in zip(shapes, views[:own], strict=True):
            place(self, name, view)
        place(self, "extra", {name: view for (name, _), view in zip(further, views[own:], strict=True)})
        place(self, "warm_start", no_warm_start())

    buffer: Array
    positions: Array
    velocities: Array
    frame_positions: Array
    frame_rotations: Array
    reduced_velocities: Array
    joint_positions: Array
    joint_efforts: Array
    base_positions: Array
    base_shift: Array
    rigid_positions: Array
    rigid_rotations: Array
    rigid_velocities: Array
    extra: dict[str, Array]
    warm_start: Array

    def __setattr__(self, name: str, value: object) -> None:
        if name == "warm_start":
            object.__setattr__(self, name, float_array(value, (-1, WARM_START_COLUMNS), "warm_start"))
        elif name == "extra":
            raise AttributeError("State.extra cannot be replaced; write into its arrays")
        else:
            getattr(self, name)[...] = value

    def copy_from(self, other: State) -> None:
        """Copy the values of a state of the same scene, in place."""
        np.copyto(self.buffer, other.buffer)
        object.__setattr__(self, "warm_start", other.warm_start)

    def parts(self) -> dict[str, tuple[slice, tuple[int, ...]]]:
        """Return start in the buffer and shape of each of `arrays` except the warm start."""
        place, first = {}, self.buffer.ctypes.data
        for name, array in self.arrays().items():
            if name != "warm_start":
                start = (array.ctypes.data - first) // array.itemsize if array.size else 0
                place[name] = slice(start, start + array.size), array.shape
        return place

    def arrays(self) -> dict[str, Array]:
        """Return all arrays by name, as views; `extra.NAME` for the further arrays of the scene."""
        own = {name: array for name, array in sorted(vars(self).items()) if name not in ("buffer", "extra")}
        return {**own, **{f"extra.{name}": array for name, array in self.extra.items()}}

    def take(self, arrays: Mapping[str, Array]) -> None:
        """Copy the result of `arrays`, or of another state of the same scene, in place."""
        for name, array in arrays.items():
            if name.startswith("extra."):
                self.extra[name.removeprefix("extra.")][...] = array
            else:
                setattr(self, name, array)


def no_warm_start() -> Array:
    """Return the State.warm_start without contacts."""
    return np.zeros((0, WARM_START_COLUMNS))
