"""Surface files read by ourselves: STL (binary and text) and OBJ.

meshio reads STL only with lower-case keywords and LF line ends and takes a cut-off binary file for text; of
an OBJ file it refuses the common case of texture coordinates that are not one for each vertex.
"""

from __future__ import annotations

import itertools
import warnings
from pathlib import Path

import numpy as np

from softsim_core.arrays import Array, IndexArray
from softsim_core.errors import MeshError

_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_STL_WORDS = ("solid", "facet", "outer", "endloop", "endfacet", "endsolid")


def parse_stl(data: bytes, path: Path) -> tuple[Array, IndexArray]:
    """Vertices and triangles of an STL file; corners at exactly the same place become one vertex.

    A file that is long enough for its triangle count is binary, whatever its header says: four letters of a
    text would count more than 10^8 triangles. Any other must be text beginning with "solid". Normals,
    attribute bytes and what follows the last triangle are not used.

    Args:
        data: The file's bytes.
        path: Its name, for messages.

    Returns:
        Points in file units, shape (n, 3), in order of first appearance, and triangles, shape (k, 3).

    Raises:
        MeshError: the file is neither, or is cut off.
    """
    count = int.from_bytes(data[80:84], "little")
    if 84 + _FACET.itemsize * count <= len(data):
        corners = np.frombuffer(data, _FACET, count, 84)["corners"].reshape(-1, 3).astype(np.float64)
    elif data[:512].lstrip()[:5].lower() == b"solid" and b"\0" not in data[:512]:
        corners = _text_corners(data, path)
    elif len(data) < 84:
        raise MeshError(path, f"{len(data)} bytes are too few for binary STL, and text STL begins with solid")
    else:
        raise MeshError(
            path,
            f"binary STL of {count} triangles needs {84 + _FACET.itemsize * count} bytes, not {len(data)}; "
            "it is damaged or cut off (text STL would begin with solid)",
        )
    return merge_corners(corners)


def parse_obj(data: bytes, path: Path) -> tuple[Array, IndexArray]:
    """Vertices and triangles of an OBJ file; faces with more corners are split into fans.

    Args:
        data: The file's bytes.
        path: Its name, for messages.

    Returns:
        Points in file units, shape (n, 3), and triangles, shape (k, 3).

    Raises:
        MeshError: names the line and what was expected there.
    """
    points: list[list[float]] = []
    triangles: list[tuple[int, int, int]] = []
    text = data.decode("utf-8", errors="replace").replace("\\\r\n", " ").replace("\\\n", " ")
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split()
        if not words or words[0] not in ("v", "f"):
            continue
        try:
            if words[0] == "v":
                x, y, z = (float(word) for word in words[1:4])
                points.append([x, y, z])
                continue
            corners = [int(word.split("/")[0]) for word in words[1:]]
        except ValueError:
            raise MeshError(
                path, f"line {number}: {line.strip()!r} is no vertex (v x y z) and no face (f i j k)"
            ) from None
        if len(corners) < 3 or 0 in corners:
            raise MeshError(path, f"line {number}: a face needs at least 3 vertex numbers, counted from 1")
        first, *rest = (corner - 1 if corner > 0 else len(points) + corner for corner in corners)
        triangles.extend((first, second, third) for second, third in itertools.pairwise(rest))
    return np.array(points, dtype=np.float64).reshape(-1, 3), np.array(triangles, dtype=np.int64).reshape(
        -1, 3
    )


def merge_corners(corners: Array) -> tuple[Array, IndexArray]:
    """Vertices and triangles of a triangle soup.

    Args:
        corners: Three rows a triangle, shape (3 k, 3).

    Returns:
        Distinct points in order of first appearance, shape (n, 3), and triangles, shape (k, 3).
    """
    corners = corners + 0.0  # -0.0 becomes 0.0
    if not len(corners):
        return corners.reshape(0, 3), np.empty((0, 3), dtype=np.int64)
    _, first, inverse = np.unique(corners, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return corners[first[order]], rank[inverse.reshape(-1)].reshape(-1, 3).astype(np.int64)


def drop_degenerate(triangles: IndexArray, path: Path) -> IndexArray:
    """Triangles without those that use a vertex twice; warns when there are any."""
    a, b, c = triangles.T
    degenerate = (a == b) | (b == c) | (c == a)
    if degenerate.any():
        warnings.warn(
            f"mesh {path}: {degenerate.sum()} of {len(triangles)} triangles with two equal corners dropped",
            stacklevel=3,
        )
    return np.asarray(triangles[~degenerate])


def _text_corners(data: bytes, path: Path) -> Array:
    corners: list[list[float]] = []
    word, number = "", 0
    for number, line in enumerate(data.decode("utf-8", errors="replace").splitlines(), start=1):
        words = line.split()
        if not words:
            continue
        word = words[0].lower()
        if word == "vertex":
            try:
                x, y, z = (float(value) for value in words[1:])
            except ValueError:
                raise MeshError(
                    path, f"line {number}: a vertex needs three numbers, not {line.strip()!r}"
                ) from None
            corners.append([x, y, z])
        elif word not in _STL_WORDS:
            raise MeshError(path, f"line {number}: {words[0]!r} is no word of a text STL file")
        elif word == "endfacet" and len(corners) % 3:
            raise MeshError(path, f"line {number}: a facet needs exactly 3 vertices")
    if word != "endsolid" or len(corners) % 3:
        raise MeshError(path, f"ends at line {number} without endsolid; the file is cut off")
    return np.array(corners, dtype=np.float64).reshape(-1, 3)
