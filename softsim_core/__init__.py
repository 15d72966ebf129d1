"""Soft-robot physics: finite elements, rigid frames, joints, contact. NumPy arrays in and out, SI units.

What a user of the library needs stands here: `from softsim_core import ...`; docs/library.md has a line on
each name. Importing the package loads none of it: a name brings its module when it is first asked for. The
public names of this package, and of each one below it, stand in the `__init__.pyi` beside its `__init__.py`.
"""

import sys

# `python -m softsim_core.simulation.warmup` puts the current folder first on the import path. Where this
# package lies elsewhere no module may come from there, so this stands before the first import that could.
if (
    sys.argv[:1] == ["-m"]
    and not (sys.flags.isolated or getattr(sys.flags, "safe_path", False))
    and sys.path[0] != __file__.rpartition("/softsim_core/")[0]
):
    del sys.path[0]

from typing import Final

from lazy_loader import attach_stub

from softsim_core.base import find_former_names, keep_former_names

__version__ = "0.2.0"

_find, __dir__, _names = attach_stub(__name__, __file__)
__getattr__ = find_former_names(__name__, {"Seen": "StepObservation"}, _find)
__all__ = ["__version__", *_names]

MOVED: Final = {
    **{
        f"softsim_core.{name}": f"softsim_core.{group}.{name}"
        for group, names in {
            "physics": "actuation contact dynamics fem kernels linalg mechanics mesh sensing",
            "simulation": "batch warmup",
            "scene": "editing",
            "control": "inverse observer",
            "lab": "identification learning meshing study",
            "base": "arrays errors units values",
        }.items()
        for name in names.split()
    },
    "softsim_core.linalg.linear_solver": "softsim_core.physics.linalg.solver_interface",
    "softsim_core.scene.attachment": "softsim_core.scene.deformable",
    "softsim_core.scene.material_region": "softsim_core.scene.deformable",
    "softsim_core.scene.objects": "softsim_core.scene.description",
    "softsim_core.scene.python_loader": "softsim_core.scene.io.loaders",
    "softsim_core.scene.reinforcement": "softsim_core.scene.rod",
    "softsim_core.scene.solver_settings": "softsim_core.scene.description",
    "softsim_core.scene.yaml_loader": "softsim_core.scene.io.loaders",
}
"""New names of modules, and of packages with all that is in them, that had another name before 0.2.0."""

keep_former_names(MOVED)
