"""Registry of elements by name."""

from __future__ import annotations

from softsim_core.base import Registry
from softsim_core.physics.fem.elements.cell import Element, check_element
from softsim_core.physics.fem.elements.solid import HEX8, TET4, TET10

_ELEMENTS: Registry[Element] = Registry("element", TET4, TET10, HEX8)


def register_element(element: Element) -> None:
    """Make an element known to scenes by its name.

    Raises:
        SceneError: the name is one of the package's own.
        ValueError: its arrays do not fit together; see Element.
    """
    check_element(element)
    _ELEMENTS.register(element)


def element(name: str) -> Element:
    """Return the element of that name.

    Raises:
        SceneError: there is none; the message lists the known ones.
    """
    return _ELEMENTS.get(name)


def element_of_kind(kind: str) -> Element | None:
    """Return the first element that fills cells of a kind of meshes; None: there is none."""
    every = map(_ELEMENTS.get, _ELEMENTS.names())
    return next((each for each in every if getattr(each, "kind", "") == kind), None)


def element_names() -> tuple[str, ...]:
    """Return the names of all known elements."""
    return _ELEMENTS.names()
