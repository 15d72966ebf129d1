"""Elements: what a cell is; register your own with `register_element`."""

from softsim_core.physics.fem.elements.element import Element, ElementData
from softsim_core.physics.fem.elements.registry import element, element_names, register_element

__all__ = ["Element", "ElementData", "element", "element_names", "register_element"]
