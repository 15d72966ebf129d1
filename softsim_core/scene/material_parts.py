"""Which cells of a body are made of what."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from softsim_core.arrays import IndexArray
from softsim_core.errors import SceneError
from softsim_core.mesh import TetMesh
from softsim_core.scene.body import Body
from softsim_core.scene.deformable import BodyDescription
from softsim_core.scene.material import MaterialDescription
from softsim_core.scene.material_region import MaterialRegionDescription
from softsim_core.scene.regions import nodes_in
from softsim_core.wrong_names import known_names


def material_parts(
    description: BodyDescription, body: Body
) -> Iterator[tuple[str, MaterialDescription, IndexArray]]:
    """Owner in SceneDescription.materials, material and cells of the body, then of each of its regions.

    Raises:
        SceneError: a region has no cell, shares one with another region, or leaves none to the body.
    """
    owner = np.full(len(body.cells), -1)
    for k, region in enumerate(description.regions):
        inside = _cells_in(region, description, body)
        if len(inside) == 0:
            low, high = body.mesh.points.min(axis=0), body.mesh.points.max(axis=0)
            raise SceneError(
                f"material region {region.name} of body {description.name}: no cell's middle lies inside it; "
                f"move or enlarge it (the body spans {low} to {high} m)"
            )
        shared = owner[inside]
        if (shared >= 0).any():
            other = description.regions[int(shared.max())].name
            raise SceneError(
                f"body {description.name}: material regions {other} and {region.name} share "
                f"{int((shared >= 0).sum())} cells; move or shrink one of them"
            )
        owner[inside] = k
    if not (owner < 0).any():
        raise SceneError(
            f"body {description.name}: its material regions cover it whole; make one of them its `material`"
        )
    yield description.name, description.material, np.flatnonzero(owner < 0)
    for k, region in enumerate(description.regions):
        yield f"{description.name}.{region.name}", region.material, np.flatnonzero(owner == k)


def _cells_in(region: MaterialRegionDescription, description: BodyDescription, body: Body) -> IndexArray:
    if region.group is not None:
        groups = body.mesh.cell_groups if isinstance(body.mesh, TetMesh) else {}
        if region.group not in groups:
            raise SceneError(
                f"material region {region.name} of body {description.name}: its mesh has no group of volumes "
                f"{region.group!r}; {known_names(region.group, groups, 'it has')}"
            )
        return np.asarray(groups[region.group])
    shape = region.box or region.sphere
    assert shape is not None  # checked by the description
    return nodes_in(shape, body.mesh.points[body.cells[:, :4]].mean(axis=1))
