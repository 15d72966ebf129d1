"""Volumetric locking: where a mesh answers much stiffer than its material."""

from __future__ import annotations

from collections.abc import Mapping

from softsim_core.fem.elements import Element

LOCKING_RATIO = 0.49
"""From this Poisson ratio on, linear tetrahedra are much too stiff."""


def locking_warning(element: Element, values: Mapping[str, float]) -> str | None:
    """A sentence if cells of this kind lock with these parameters of a law, else None."""
    ratio = values.get("poisson_ratio", 0.0)
    if len(element.reference) != 4 or ratio < LOCKING_RATIO:
        return None
    return (
        f"poisson_ratio {ratio:g} is too stiff: nearly incompressible linear tetrahedra lock; "
        f"take less than {LOCKING_RATIO:g}"
    )
