"""What a MuJoCo model is written with."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree

import numpy as np

from softsim_core.arrays import Array
from softsim_core.mjcf.masks import Mask
from softsim_core.mjcf.reading import Told
from softsim_core.scene.builder import BuiltScene
from softsim_core.scene.description import SceneDescription


@dataclass(frozen=True, slots=True, eq=False)
class Draft:
    """A model that is being written.

    Attributes:
        scene, built: What is written.
        root, world: The document, and its element `worldbody`.
        told: What MuJoCo has nothing for.
        masks: What may touch, by the names of bodies.
        carriers: Element and origin in [m], shape (3,), of what moves with each joint and frame; no body of
            the document is turned at the start.
    """

    scene: SceneDescription
    built: BuiltScene
    root: ElementTree.Element
    world: ElementTree.Element
    told: Told
    masks: dict[str, Mask]
    carriers: dict[str, tuple[ElementTree.Element, Array]]

    def section(self, tag: str) -> ElementTree.Element:
        """The one element of that tag below the root."""
        found = self.root.find(tag)
        return add(self.root, tag) if found is None else found


def add(parent: ElementTree.Element, tag: str, /, **attributes: str) -> ElementTree.Element:
    """A new element below another one."""
    return ElementTree.SubElement(parent, tag, attributes)


def words(numbers: Any) -> str:
    """Numbers as MJCF has them, exact."""
    return " ".join(repr(number) for number in np.asarray(numbers).ravel().tolist())
