"""The moving mesh of a bag: positions with stress over time, and VTU files of them."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple
from xml.sax.saxutils import quoteattr

import meshio
import numpy as np
from numpy.typing import NDArray

from softsim_core.base import IndexArray, make_folder, put_in_place, write_file
from softsim_ros.nodes.simulator import RateGate
from softsim_ros.recording.bag import Bag

POINT_COLUMNS = 4


class MeshTopics(NamedTuple):
    """Topics of a mesh in a bag: its cells (latched), its moving points; name of its cells in mesh files."""

    cells: str
    points: str
    kind: str


SURFACE = MeshTopics("mesh/topology", "mesh/points", "triangle")
VOLUME = MeshTopics("mesh/tetrahedra", "mesh/nodes", "tetra")


class MeshFrame(NamedTuple):
    """A mesh at a time.

    Attributes:
        time_s: Time since the bag's first message, in [s].
        points: Positions in [m], shape (p, 3).
        von_mises: Stress at the points in [Pa], shape (p,).
        cells: Point indices, shape (k, corners); the same object as long as the scene is the same.
    """

    time_s: float
    points: NDArray[np.float32]
    von_mises: NDArray[np.float32]
    cells: IndexArray


def mesh_frames(bag: Bag, topics: MeshTopics = SURFACE, rate: float | None = None) -> Iterator[MeshFrame]:
    """Yield frames in time order; frames without their cells in the bag, or before them, are left out.

    `rate` is the largest number of frames per second of the bag, in [Hz]; None takes all.
    """
    cells_of = [(stamp, _cells(message)) for stamp, message in bag.messages(bag.topic(topics.cells))]
    following = 0
    cells: _Cells | None = None
    gate = RateGate(1.0 / rate if rate else 0.0)
    for stamp, message in bag.messages(bag.topic(topics.points)):
        while following < len(cells_of) and (cells is None or cells_of[following][0] <= stamp):
            cells, following = cells_of[following][1], following + 1
        time_s = 1e-9 * (stamp - bag.begin_ns)
        rows = np.frombuffer(message.data, dtype="<f4").reshape(-1, POINT_COLUMNS)
        if cells is None or not cells.join(len(rows)) or not gate.passes(time_s):
            continue
        yield MeshFrame(time_s, rows[:, :3], rows[:, 3], cells.indices)


class _Cells(NamedTuple):
    """Cells of a message and the number of points that they join; None if the message does not contain it."""

    indices: IndexArray
    points: int | None

    def join(self, count: int) -> bool:
        """Return whether `count` points may belong to the cells, and not to those of another scene."""
        return self.points in (None, count) and int(self.indices.max(initial=-1)) < count


def _cells(message: Any) -> _Cells:
    if hasattr(message, "triangles"):
        corners = np.array([each.vertex_indices for each in message.triangles], dtype=np.int64)
        return _Cells(corners.reshape(-1, 3), len(message.vertices))
    return _Cells(np.asarray(message.data, dtype=np.int64).reshape(-1, message.layout.dim[1].size), None)


def write_vtu_series(frames: Iterable[MeshFrame], kind: str, folder: Path, name: str) -> tuple[Path, int]:
    """Write a file per frame into `folder/name/`, and `folder/name.pvd`, which lists them with their times.

    Args:
        frames: Frames to write.
        kind: "triangle" or "tetra".
        folder: Existing folder.
        name: Name of the series.

    Returns:
        The PVD file and the number of frames; points in [m], `von_mises` in [Pa] at the points.
    """
    make_folder(folder / name)
    entries = []
    with tempfile.TemporaryDirectory(dir=folder) as temporary:
        new = Path(temporary, "new.vtu")
        for number, frame in enumerate(frames):
            file = f"{name}/{name}_{number:05d}.vtu"
            mesh = meshio.Mesh(frame.points, [(kind, frame.cells)], point_data={"von_mises": frame.von_mises})
            meshio.write(new, mesh)
            put_in_place(new, folder / file)
            entries.append(f'    <DataSet timestep="{frame.time_s!r}" part="0" file={quoteattr(file)}/>\n')
    pvd = write_file(
        folder / f"{name}.pvd",
        '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1" byte_order="LittleEndian">\n'
        f"  <Collection>\n{''.join(entries)}  </Collection>\n</VTKFile>\n",
    )
    return pvd, len(entries)
