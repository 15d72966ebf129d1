"""What the seam of elements and materials hides stays hidden: no other folder names it."""

from __future__ import annotations

import re
from pathlib import Path

CORE = Path(__file__).resolve().parents[2] / "softsim_core"

WORDS = re.compile(r"\blam[eé]\b|\btet4\b|\bfour nodes\b", re.IGNORECASE)

MAY_NAME_THEM = {
    "fem",  # the seam itself
    "mesh",  # reads and checks meshes of tetrahedra
    "scene/description.py",  # the default of a body's element
    # the kernels of groups that have kernels
    "dynamics/numba_backend/cells.py",
    "dynamics/numba_backend/elements.py",
    "dynamics/numba_backend/lanes.py",
    "dynamics/numba_backend/simd_elements.py",
    "dynamics/numba_backend/twist.py",
    "dynamics/numba_backend/inversion.py",
    "dynamics/numba_backend/layout.py",
}


def test_no_other_file_names_an_element_or_lame_parameters() -> None:
    found = []
    for file in sorted(CORE.rglob("*.py")):
        name = file.relative_to(CORE).as_posix()
        if name in MAY_NAME_THEM or name.split("/")[0] in MAY_NAME_THEM:
            continue
        for number, line in enumerate(file.read_text(encoding="utf-8").splitlines(), 1):
            if WORDS.search(line):
                found.append(f"{name}:{number} {line.strip()}")
    assert found == []
