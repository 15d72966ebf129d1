"""A part of a body that is made of something else."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from softsim_core.errors import SceneError
from softsim_core.scene.material import MaterialDescription
from softsim_core.values import Box, Sphere


@dataclass(frozen=True, slots=True, kw_only=True)
class MaterialRegionDescription:
    """Cells of a body with another material than the rest of it, such as a bone or a softer skin.

    Attributes:
        name: Unique in its body.
        material: Law and parameters; the mass per volume is the body's.
        group: Name of a group of cells of the mesh's file: a physical group of volumes of Gmsh.
        box, sphere: Or cells whose middle lies there, on the rest shape. Exactly one of the three.
    """

    name: str
    material: MaterialDescription
    group: str | None = None
    box: Box | None = None
    sphere: Sphere | None = None

    def __post_init__(self) -> None:
        if sum(each is not None for each in (self.group, self.box, self.sphere)) != 1:
            raise SceneError(f"material region {self.name}: give exactly one of group, box and sphere")

    @property
    def values(self) -> Mapping[str, float]:
        """The parameters of its law by name."""
        return self.material.values

    def changed(self, values: Mapping[str, float]) -> MaterialRegionDescription:
        """The same region with other values of its law."""
        return replace(self, material=self.material.changed(**values))
