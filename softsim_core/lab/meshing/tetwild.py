"""The mesher, alone in a process: `python .../tetwild.py IN.npz OUT.npz`; it imports nothing of this suite.

It loads the compiled part of pytetwild by itself, because the whole package requires PyVista and thus 600 MB
of VTK, which filling a surface does not need. The mesher accepts surfaces that intersect themselves; it fills
the volume with nonzero winding number.

Source: Hu, Schneider, Wang, Zorin, Panozzo 2020, Fast tetrahedral meshing in the wild.
"""

from __future__ import annotations

import importlib.machinery
import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import numpy as np

DISTRIBUTION = "pytetwild"
_MODULE = "PyfTetWildWrapper"
_ITERATIONS = 80
_SILENT = 6


def compiled_part() -> Path | None:
    """Return the file of the compiled mesher, or None if pytetwild is not installed."""
    found = importlib.util.find_spec(DISTRIBUTION)  # does not run the package
    if found is None or found.origin is None:
        return None
    folder = Path(found.origin).parent
    names = (folder / f"{_MODULE}{suffix}" for suffix in importlib.machinery.EXTENSION_SUFFIXES)
    return next((name for name in names if name.is_file()), None)


def _load() -> ModuleType:
    file = compiled_part()
    if file is None:
        raise ImportError(f"{DISTRIBUTION} is not installed")
    spec = importlib.util.spec_from_file_location(_MODULE, file)
    if spec is None or spec.loader is None:
        raise ImportError(f"{file} cannot be loaded")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _limit_memory(most: int) -> None:
    """Limit the memory of this process, where the system supports it."""
    try:
        import resource
    except ImportError:  # no POSIX system
        return
    resource.setrlimit(resource.RLIMIT_DATA, (most, most))


def main(words: list[str]) -> int:
    """Fill the surface of one file and write the tetrahedra into another."""
    with np.load(words[0]) as surface:
        _limit_memory(int(surface["memory"]))
        points, tets = _load().tetrahedralize_mesh(
            surface["points"],
            surface["triangles"].astype(np.uint32),
            True,  # optimise
            False,  # do not skip simplifying the surface within the envelope
            0.05,  # of the diagonal; ignored because of the absolute length below
            float(surface["edge"]),
            float(surface["envelope"]),
            float(surface["energy"]),
            bool(surface["coarsen"]),
            1,  # threads
            _ITERATIONS,
            _SILENT,
            True,  # quiet
            False,  # another order of a cell's corners
            False,  # keep what lies outside
            np.empty((0, 3)),
            np.empty((0, 4), dtype=np.int32),
            np.empty(0),
        )
    np.savez(words[1], points=points, tets=tets)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
