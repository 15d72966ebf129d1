"""Contact between surfaces: which may meet, where they come close, and the forces between them."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from softsim_core.physics.contact.detection import Detector, Proximities
    from softsim_core.physics.contact.solver import ContactSolution, solve_contacts
    from softsim_core.physics.contact.surfaces import CollisionSurface, check_surface, may_meet

__all__ = [
    "CollisionSurface",
    "ContactSolution",
    "Detector",
    "Proximities",
    "check_surface",
    "may_meet",
    "solve_contacts",
]

_HOME = {
    "CollisionSurface": "surfaces",
    "ContactSolution": "solver",
    "Detector": "detection",
    "Proximities": "detection",
    "check_surface": "surfaces",
    "may_meet": "surfaces",
    "solve_contacts": "solver",
}


def __getattr__(name: str) -> Any:  # describing a scene needs its settings alone: no numba, no scipy
    if name in _HOME:
        return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
