"""Registry of elements by name."""

from __future__ import annotations

from softsim_core.base import Registry
from softsim_core.physics.fem.elements.cell import Element, check_element
from softsim_core.physics.fem.elements.tetrahedra import TET4, TET10

_ELEMENTS: Registry[Element] = Registry("element", TET4, TET10)


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


def element_names() -> tuple[str, ...]:
    """Return the names of all known elements."""
    return _ELEMENTS.names()
