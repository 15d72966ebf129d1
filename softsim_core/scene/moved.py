"""Where modules and names are now that scene files written for an earlier version import from elsewhere."""

from __future__ import annotations

import re
from importlib import import_module
from typing import Final

MODULES: Final = {
    "softsim_core.actuation.limits": "softsim_core.mechanics.limits",
    "softsim_core.dynamics.bases": "softsim_core.simulation.bases",
    "softsim_core.dynamics.drive": "softsim_core.simulation.drive",
    "softsim_core.dynamics.scene_state": "softsim_core.simulation.scene_state",
    "softsim_core.dynamics.simulation": "softsim_core.simulation",
    "softsim_core.dynamics.warmup": "softsim_core.warmup",
    "softsim_core.mesh.finger_mesh": "softsim_core.robots.finger_mesh",
    "softsim_core.mesh.maze_mesh": "softsim_core.robots.maze_mesh",
    "softsim_core.mesh.tripod_mesh": "softsim_core.robots.tripod_mesh",
    "softsim_core.scene.gripper_parts": "softsim_core.robots.gripper_parts",
    "softsim_core.scene.parts": "softsim_core.robots.parts",
    "softsim_core.scene.values": "softsim_core.values",
}
"""Modules by their former names."""


def new_place(error: ImportError) -> str | None:
    """One sentence for a person whose import failed because something has moved; None: nothing has."""
    wanted = re.search(r"cannot import name '(\w+)' from '([\w.]+)'", str(error))
    name, module = wanted.groups() if wanted else ("", error.name or "")
    full = f"{module}.{name}" if name else module
    if full in MODULES:
        return f"the module {full} has moved; import {MODULES[full]} in its place"
    package = module.partition(".")[0]
    if name and package == __name__.partition(".")[0] and name in import_module(package).__all__:
        return f"{name} is not in {module} any more; write `from {package} import {name}`"
    return None
