"""Named arrays as bytes and back: equal arrays give equal bytes, and nothing damaged or foreign comes in.

The bytes are: a line that names format and version; the SHA-256 fingerprint of the scene; the length of the
table (8 bytes, little endian) and the table, JSON `[[name, [length, ...]], ...]`; all arrays one behind the
other as little-endian float64; the SHA-256 checksum of everything before it.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping

import numpy as np

from softsim_core.arrays import Array
from softsim_core.errors import SnapshotError, listing

MAGIC = b"softsim snapshot, version 2\n"
"""How a snapshot of this format begins."""

_FAMILY = b"softsim snapshot, version "
_DIGEST = 32
_ORTHOGONAL = 1e-6


def pack(fingerprint: bytes, arrays: Mapping[str, Array]) -> bytes:
    """Bytes of named arrays of the scene with a fingerprint (32 bytes)."""
    table = json.dumps([[name, array.shape] for name, array in arrays.items()]).encode()
    numbers = b"".join(np.ascontiguousarray(array, dtype="<f8").tobytes() for array in arrays.values())
    body = MAGIC + fingerprint + len(table).to_bytes(8, "little") + table + numbers
    return body + hashlib.sha256(body).digest()


def unpack(data: bytes, fingerprint: bytes, shapes: Mapping[str, tuple[int, ...]]) -> dict[str, Array]:
    """The arrays of `pack`, by name.

    Args:
        data: The bytes.
        fingerprint: That of the scene which is running.
        shapes: Names and shapes that must be there, no others; -1 is any length.

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
        held = {str(name): tuple(map(int, shape)) for name, shape in json.loads(body[start:end])}
        values = np.frombuffer(body, dtype="<f8", offset=end).astype(float)
    except (ValueError, TypeError, RecursionError) as error:
        raise SnapshotError("the snapshot's table of contents is damaged; save a new one") from error
    _compare(held, shapes)
    if len(values) != sum(math.prod(shape) for shape in held.values()):
        raise SnapshotError("the snapshot is shorter or longer than its table says; save a new one")
    if not np.isfinite(values).all():
        raise SnapshotError("the snapshot holds a value that is not finite; save a new one")
    parts = np.split(values, np.cumsum([int(np.prod(shape)) for shape in held.values()])[:-1])
    return {name: part.reshape(shape) for (name, shape), part in zip(held.items(), parts, strict=True)}


def need_rotations(name: str, rotations: Array) -> None:
    """Refuse what are no rotation matrices, shape (k, 3, 3).

    Raises:
        SnapshotError: one of them is not orthogonal, or mirrors.
    """
    products = rotations @ rotations.transpose(0, 2, 1)
    if not (np.abs(products - np.eye(3)) < _ORTHOGONAL).all() or not (np.linalg.det(rotations) > 0.0).all():
        raise SnapshotError(f"the snapshot's {name} are no rotations; save a new one")


def _compare(held: Mapping[str, tuple[int, ...]], shapes: Mapping[str, tuple[int, ...]]) -> None:
    """Refuse names and shapes that are not those of `shapes`."""
    for problem, names in (
        ("lacks", [name for name in shapes if name not in held]),
        ("holds unknown", [name for name in held if name not in shapes]),
    ):
        if names:
            raise SnapshotError(f"the snapshot {problem} {listing(names)}; save a new one")
    for name, shape in shapes.items():
        fits = len(held[name]) == len(shape) and all(
            want == has or (want == -1 and has >= 0) for want, has in zip(shape, held[name], strict=True)
        )
        if not fits:
            raise SnapshotError(f"the snapshot's {name} has shape {held[name]}, not {shape}; save a new one")
