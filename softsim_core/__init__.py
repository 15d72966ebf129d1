"""Soft-robot physics: finite elements, rigid frames, joints. NumPy arrays in and out."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from softsim_core.dynamics.simulation import Simulation
    from softsim_core.mechanics.pose import Pose
    from softsim_core.scene import load_scene
    from softsim_core.scene.description import SceneDescription

__all__ = ["Pose", "SceneDescription", "Simulation", "load_scene"]

_HOME = {
    "Pose": "softsim_core.mechanics.pose",
    "SceneDescription": "softsim_core.scene.description",
    "Simulation": "softsim_core.dynamics.simulation",
    "load_scene": "softsim_core.scene",
}


def __getattr__(name: str) -> Any:  # importing the package alone stays light: no scipy, no numba
    if name in _HOME:
        from importlib import import_module

        return getattr(import_module(_HOME[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
