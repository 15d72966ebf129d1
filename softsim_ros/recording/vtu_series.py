"""The moving mesh as VTU files with one PVD file that ParaView opens."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable
from pathlib import Path
from xml.sax.saxutils import quoteattr

import meshio

from softsim_core.file_writing import make_folder, put_in_place, write_file
from softsim_ros.recording.surface_frames import MeshFrame


def write_vtu_series(frames: Iterable[MeshFrame], kind: str, folder: Path, name: str) -> tuple[Path, int]:
    """Write a file per frame into `folder/name/` and `folder/name.pvd`, which lists them with their times.

    Args:
        frames: What to write.
        kind: "triangle" or "tetra".
        folder: Existing folder.
        name: Of the series.

    Returns:
        The PVD file and the number of frames; points in [m], `von_mises` in [Pa] at the points.
    """
    make_folder(folder / name)
    entries = []
    with tempfile.TemporaryDirectory(dir=folder) as aside:
        new = Path(aside, "new.vtu")
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
