"""Filling a closed surface with tetrahedra, in a process with limits of time and memory."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import signal
import subprocess
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from time import monotonic

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from softsim_core.base import (
    Array,
    IndexArray,
    MeshError,
    install_command,
    python_command,
    start_process,
    write_file,
)
from softsim_core.lab.meshing.tetwild import DISTRIBUTION, compiled_part
from softsim_core.physics.mesh import SurfaceMesh, TetMesh, read_tets, tet_volumes, write_tets

_FORMAT = 1
"""Raised when the same input and options shall be meshed anew."""


def cache_folder() -> Path:
    """Where meshes are kept: softsim/meshes under XDG_CACHE_HOME, or under ~/.cache."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "softsim" / "meshes"


def key_of(data: bytes, options: Mapping[str, object]) -> str:
    """Name of the mesh that a file's bytes and options give."""
    try:
        mesher = version(DISTRIBUTION)
    except PackageNotFoundError:
        mesher = ""
    told = json.dumps({"format": _FORMAT, "mesher": mesher, **options}, sort_keys=True)
    return hashlib.sha256(told.encode() + b"\0" + data).hexdigest()[:32]


def kept(key: str) -> tuple[TetMesh, float] | None:
    """The mesh of that key and the edge length in [m] it was made with, if it is there and whole."""
    with contextlib.suppress(MeshError, OSError, ValueError):
        mesh = read_tets(cache_folder() / f"{key}.vtk")
        return mesh, float((cache_folder() / f"{key}.txt").read_text())
    return None


def keep(key: str, mesh: TetMesh, edge: float) -> bool:
    """Keep a mesh, whole or not at all; whether it could be written."""
    folder = cache_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_file(folder / f"{key}.txt", repr(edge))
        write_tets(folder / f"{key}.vtk", mesh)
    except (MeshError, OSError):
        return False
    return True


COMMAND = tuple(python_command(Path(__file__).with_name("tetwild.py")))
"""The mesher: it gets the names of a file to read and of one to write."""
ENERGIES = {10.0: 0.25, 30.0: 0.75}
"""The mesher stops where its worst element is so good (3 is regular); it has this share of its time for it.

Where it does not get there, less is asked for. Worst angles with 10 are 12 to 24 degrees; with 7 they are 17
to 25, but it then often goes on for ever.
"""
WORD_S = 10.0
"""How often a word is said of a mesher that works, in [s]."""
_TAIL = 160


@dataclass(frozen=True, slots=True, kw_only=True)
class Filling:
    """How a surface is filled.

    Attributes:
        envelope: How far the mesh's boundary may be from the surface, of the diagonal.
        coarsen: Make edges as long as the shape of elements allows, longer than wished.
        time_limit: In [s].
        memory: In bytes.
        waited: Told each WORD_S for how many seconds the mesher has worked.
    """

    envelope: float = 1.0e-3
    coarsen: bool = False
    time_limit: float = 300.0
    memory: int = 6 << 30
    waited: Callable[[float], None] = lambda seconds: None


def have_mesher() -> bool:
    """Whether the mesher is installed."""
    return compiled_part() is not None


def filled(surface: SurfaceMesh, edge: float, how: Filling, command: tuple[str, ...] = COMMAND) -> TetMesh:
    """Linear tetrahedra inside a closed surface, all positively oriented; not the same ones every time.

    Args:
        surface: Closed, outward, in [m].
        edge: Wished length of edges in [m].
        how: Accuracy and limits.
        command: The mesher.

    Raises:
        MeshError: the mesher is not installed, takes too long, ends in an error, or makes nothing.
    """
    name = surface.name
    if command is COMMAND and not have_mesher():
        raise MeshError(name, f"cannot be filled without pytetwild; {install_command('mesh')}")
    middle = surface.points.mean(axis=0)
    scale = float(np.linalg.norm(np.ptp(surface.points, axis=0)))
    with tempfile.TemporaryDirectory(prefix="softsim-mesh-") as folder:
        given, made = Path(folder, "surface.npz"), Path(folder, "tets.npz")
        started, allowed = monotonic(), 0.0
        for energy, share in ENERGIES.items():
            np.savez(
                given,
                points=(surface.points - middle) / scale,
                triangles=surface.triangles,
                edge=edge / scale,
                envelope=how.envelope,
                energy=energy,
                coarsen=how.coarsen,
                memory=how.memory,
            )
            allowed += share * how.time_limit
            if _run((*command, str(given), str(made)), folder, (started, allowed), how.waited, name):
                break
        else:
            raise MeshError(
                name,
                f"the mesher was stopped after {how.time_limit:g} s; ask for a coarser mesh (--size, "
                "--nodes), allow more deviation (--deviation) or more time (--time-limit)",
            )
        try:
            with np.load(made) as result:
                points, tets = result["points"], result["tets"]
        except (OSError, ValueError, KeyError) as error:
            raise MeshError(name, f"the mesher wrote no mesh ({error}); try another size") from error
    if not len(tets):
        raise MeshError(
            name,
            "the mesher found nothing inside: its walls are thinner than what the mesh may deviate; allow "
            "less with --deviation",
        )
    return _tidy(middle + scale * np.asarray(points, dtype=np.float64), tets.astype(np.int64), name)


def _run(
    command: tuple[str, ...],
    folder: str,
    limit: tuple[float, float],
    waited: Callable[[float], None],
    name: str,
) -> bool:
    """Whether it ended in time.

    Args:
        command: The program.
        folder: Where it works.
        limit: Since when time counts, by the monotonic clock, and how much there is, in [s].
        waited: Told how much time has passed.
        name: Of the part.

    Raises:
        MeshError: it ended in an error.
    """
    with start_process(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        cwd=folder,  # the mesher writes into it
    ) as process:
        try:
            while True:
                left = limit[0] + limit[1] - monotonic()
                try:
                    _, error = process.communicate(timeout=max(min(left, WORD_S), 0.0))
                    break
                except subprocess.TimeoutExpired:
                    if left <= WORD_S:
                        process.kill()
                        process.communicate()
                        return False
                    waited(monotonic() - limit[0])
        except BaseException:
            process.kill()
            raise
    if process.returncode:
        raise MeshError(name, f"the mesher {_why(process.returncode, error.decode(errors='replace'))}")
    return True


def _why(code: int, error: str) -> str:
    """What ended the mesher, and what to do."""
    if "MemoryError" in error or "bad_alloc" in error:
        return "ran out of memory; ask for a coarser mesh (--size, --nodes)"
    if code < 0:
        try:
            how = signal.Signals(-code).name
        except ValueError:
            how = f"signal {-code}"
        return f"crashed ({how}); try another --size, or repair the surface in the CAD program"
    lines = error.strip().splitlines()
    return f"failed ({(lines[-1] if lines else f'exit code {code}')[:_TAIL]}); try another --size"


def _tidy(points: Array, tets: IndexArray, name: str) -> TetMesh:
    """Positively oriented and without unused points."""
    wrong = tet_volumes(points, tets) < 0.0
    tets[wrong] = tets[wrong][:, [0, 1, 3, 2]]
    used, numbers = np.unique(tets, return_inverse=True)
    return TetMesh(np.ascontiguousarray(points[used]), numbers.reshape(-1, 4).astype(np.int64), name)


def pieces(mesh: TetMesh) -> IndexArray:
    """Numbers of tetrahedra in each piece that hangs together by faces, largest first."""
    faces = np.sort(mesh.tets[:, [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]].reshape(-1, 3), axis=1)
    order = np.lexsort(faces.T)
    same = np.flatnonzero((faces[order][1:] == faces[order][:-1]).all(axis=1))
    rows, columns = order[same] // 4, order[same + 1] // 4
    graph = sp.coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(len(mesh.tets),) * 2)
    _, label = connected_components(graph, directed=False)
    return np.asarray(np.sort(np.bincount(label))[::-1], dtype=np.int64)
