"""Meshes kept by what they were made of: the mesher makes another one every time, so the first one counts."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from softsim_core.errors import MeshError
from softsim_core.file_writing import write_file
from softsim_core.mesh.readers import read_tets
from softsim_core.mesh.types import TetMesh
from softsim_core.mesh.writers import write_tets
from softsim_core.meshing.tetwild import DISTRIBUTION

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
