"""Contact between surfaces: which may meet, where they come close, and the forces between them."""

from __future__ import annotations

from softsim_core.contact.detection import Detector, Proximities
from softsim_core.contact.solver import ContactSolution, solve_contacts
from softsim_core.contact.surfaces import CollisionSurface, check_surface, may_meet

__all__ = [
    "CollisionSurface",
    "ContactSolution",
    "Detector",
    "Proximities",
    "check_surface",
    "may_meet",
    "solve_contacts",
]
