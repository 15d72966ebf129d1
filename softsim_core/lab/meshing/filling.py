"""Generation of tetrahedra inside a closed surface, in a process with limits of time and memory."""

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

from softsim_core.base import (
    IndexArray,
    MeshError,
    install_command,
    python_command,
    start_process,
    write_file,
)
from softsim_core.lab.meshing.tetwild import DISTRIBUTION, compiled_part
from softsim_core.lab.meshing.topology import connected
from softsim_core.physics.mesh import SurfaceMesh, TetMesh, orient_tets, read_tets, write_tets

_FORMAT = 1  # version of cached meshes; increased to mesh the same input and options again


def cache_folder() -> Path:
    """Return the folder of cached meshes: softsim/meshes under XDG_CACHE_HOME, or under ~/.cache."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "softsim" / "meshes"


def key_of(data: bytes, options: Mapping[str, object]) -> str:
    """Return the cache key of the mesh of a file's bytes and options."""
    try:
        mesher = version(DISTRIBUTION)
    except PackageNotFoundError:
        mesher = ""
    settings = json.dumps({"format": _FORMAT, "mesher": mesher, **options}, sort_keys=True)
    return hashlib.sha256(settings.encode() + b"\0" + data).hexdigest()[:32]


def read_cached_mesh(key: str) -> tuple[TetMesh, float] | None:
    """Return the cached mesh of a key and its edge length in [m], if it exists and is complete."""
    with contextlib.suppress(MeshError, OSError, ValueError):
        mesh = read_tets(cache_folder() / f"{key}.vtk")
        return mesh, float((cache_folder() / f"{key}.txt").read_text())
    return None


def store_mesh(key: str, mesh: TetMesh, edge: float) -> bool:
    """Store a mesh in the cache atomically; return whether it could be written."""
    folder = cache_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_file(folder / f"{key}.txt", repr(edge))
        write_tets(folder / f"{key}.vtk", mesh)
    except (MeshError, OSError):
        return False
    return True


COMMAND = tuple(python_command(Path(__file__).with_name("tetwild.py")))
"""Command of the mesher, to which the names of an input and an output file are appended."""
ENERGIES = {10.0: 0.25, 30.0: 0.75}
"""Quality targets of the mesher (worst element, 3 is regular), each with its share of the time limit.

If the mesher does not reach a target, the next one is easier. Worst angles are 12 to 24 degrees with 10, and
17 to 25 degrees with 7, but then it often does not terminate.
"""
WORD_S = 10.0
"""Interval in [s] of progress reports while the mesher works."""
_TAIL = 160


@dataclass(frozen=True, slots=True, kw_only=True)
class Filling:
    """Options of the mesher.

    Attributes:
        envelope: Largest distance of the mesh's boundary from the surface, as a part of the diagonal.
        coarsen: Make edges as long as the quality of elements allows, even longer than requested.
        time_limit: In [s].
        memory: In bytes.
        waited: Called every WORD_S with the seconds since the mesher was started.
    """

    envelope: float = 1.0e-3
    coarsen: bool = False
    time_limit: float = 300.0
    memory: int = 6 << 30
    waited: Callable[[float], None] = lambda seconds: None


def have_mesher() -> bool:
    """Return whether the mesher is installed."""
    return compiled_part() is not None


def fill_surface(
    surface: SurfaceMesh, edge: float, how: Filling, command: tuple[str, ...] = COMMAND
) -> TetMesh:
    """Fill a closed surface with positively oriented linear tetrahedra; the result is not deterministic.

    Args:
        surface: Closed, outward, in [m].
        edge: Requested length of edges in [m].
        how: Accuracy and limits.
        command: The mesher.

    Raises:
        MeshError: the mesher is not installed, takes too long, ends in an error, or generates nothing.
    """
    name = surface.name
    if command is COMMAND and not have_mesher():
        raise MeshError(name, f"cannot be filled without pytetwild; {install_command('mesh')}")
    middle = surface.points.mean(axis=0)
    scale = float(np.linalg.norm(np.ptp(surface.points, axis=0)))
    with tempfile.TemporaryDirectory(prefix="softsim-mesh-") as folder:
        input_file, made = Path(folder, "surface.npz"), Path(folder, "tets.npz")
        started, allowed = monotonic(), 0.0
        for energy, share in ENERGIES.items():
            np.savez(
                input_file,
                points=(surface.points - middle) / scale,
                triangles=surface.triangles,
                edge=edge / scale,
                envelope=how.envelope,
                energy=energy,
                coarsen=how.coarsen,
                memory=how.memory,
            )
            allowed += share * how.time_limit
            if _run((*command, str(input_file), str(made)), folder, (started, allowed), how.waited, name):
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
    points = middle + scale * np.asarray(points, dtype=np.float64)
    used, numbers = np.unique(orient_tets(points, tets), return_inverse=True)
    return TetMesh(np.ascontiguousarray(points[used]), numbers.reshape(-1, 4).astype(np.int64), name)


def _run(
    command: tuple[str, ...],
    folder: str,
    limit: tuple[float, float],
    waited: Callable[[float], None],
    name: str,
) -> bool:
    """Run the mesher within a limit, monotonic start and duration in [s]; return whether it ended in time."""
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
    """Return why the mesher ended, and what to do."""
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


def pieces(mesh: TetMesh) -> IndexArray:
    """Return the tetrahedra of each piece that is connected by faces, largest first."""
    faces = np.sort(mesh.tets[:, [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]].reshape(-1, 3), axis=1)
    order = np.lexsort(faces.T)
    same = np.flatnonzero((faces[order][1:] == faces[order][:-1]).all(axis=1))
    _, label = connected(len(mesh.tets), order[same] // 4, order[same + 1] // 4)
    return np.asarray(np.sort(np.bincount(label))[::-1], dtype=np.int64)
