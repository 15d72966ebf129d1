"""Laws with compiled stress and tangent at a point, and the moduli of their kernels.

A law of one's own is compiled from its function `stress_and_tangent`, which computes one point after the
other; the laws of the package compute LANES points at once.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from softsim_core.base import Array, IndexArray
from softsim_core.physics.dynamics.numba_backend.cells.batches import CellBatches, allocate_aligned, in_lanes
from softsim_core.physics.dynamics.numba_backend.cells.corotational import (
    corotational_moduli,
    fill_corotational,
    remember_corotational,
)
from softsim_core.physics.dynamics.numba_backend.cells.points import (
    CellInputs,
    CellOutputs,
    PointCells,
    allocate_buffers,
    deformation_gradients,
    fill_given,
)
from softsim_core.physics.dynamics.numba_backend.cells.rubber import (
    fill_powers,
    fill_rubber,
    mooney_rivlin_moduli,
    ogden_moduli,
    remember_powers,
    remember_rubber,
    rubber_moduli,
)
from softsim_core.physics.fem import ElementGroup, mean_volume_law, split_bulk
from softsim_core.physics.fem.materials import (
    Corotational,
    Material,
    MooneyRivlin,
    Ogden,
    Relaxing,
    SeriesRubber,
    VolumetricMaterial,
    clamp_tangent,
    compile_points,
    law_within,
)
from softsim_core.physics.kernels import OneSignature
from softsim_core.physics.linalg import LANES


class CompiledLaw(NamedTuple):
    """Kernels of a law.

    Attributes:
        moduli: Returns the moduli of the kernels for the law and values p (m, k), see PointCells, shape (m,
            n). All are proportional to the shear response but those in `fixed`.
        size: n.
        fill: Adds forces and stiffness of cells.
        remember: Advances the cells' memory after a step; None: the law cannot relax.
        fixed: Columns of the moduli that have another unit.
    """

    moduli: Callable[[Any, Array], Array]
    size: int
    fill: Callable[..., None]
    remember: Callable[..., None] | None
    fixed: tuple[int, ...] = ()


COMPILED_LAWS: dict[Any, CompiledLaw] = {  # by class
    SeriesRubber: CompiledLaw(rubber_moduli, 5, fill_rubber, remember_rubber),
    Corotational: CompiledLaw(corotational_moduli, 1, fill_corotational, remember_corotational),
    Ogden: CompiledLaw(ogden_moduli, 5, fill_powers, remember_powers, (2, 4)),
    MooneyRivlin: CompiledLaw(mooney_rivlin_moduli, 5, fill_powers, remember_powers, (2, 4)),
}


def compiled_law(law: Material) -> CompiledLaw | None:
    """Return the kernels of a law, with or without Prony terms; None: it has none.

    Raises:
        SceneError: Numba does not compile the function `stress_and_tangent`.
    """
    within = law_within(law)
    if within.stress_and_tangent is not None and within.has_potential:
        return None if isinstance(within, VolumetricMaterial) else _own_law(within)
    return next((each for kind, each in COMPILED_LAWS.items() if isinstance(within, kind)), None)


def _own_values(law: Material, p: Array) -> Array:
    """Return the values (m, k) of a law's parameters, its moduli."""
    return p


@cache
def _own_law(law: Material) -> CompiledLaw:
    """Return the kernels of a law with `stress_and_tangent`."""
    size, at_points = len(law.parameters), compile_points(law)
    gradients_of, assemble = OneSignature(deformation_gradients), OneSignature(fill_given)

    def fill(inputs: CellInputs, cells: PointCells, into: CellOutputs) -> None:
        batches, m = len(cells.cells.nodes), int(cells.cells.size[0])
        q = len(cells.weights) // batches
        f, stress, tangent = np.empty((m, q, 3, 3)), np.zeros((m, q, 3, 3)), np.zeros((m, q, 3, 3, 3, 3))
        gradients_of(inputs, cells, f)
        values = cells.moduli.reshape(batches, size + 2, LANES)[:, 2:].swapaxes(1, 2).reshape(-1, size)[:m]
        at_points(
            f.reshape(-1, 3, 3), np.repeat(values, q, axis=0), stress.reshape(-1, 3, 3),
            tangent.reshape(-1, 3, 3, 3, 3),
        )  # fmt: skip
        if inputs.positive:
            tangent = clamp_tangent(tangent)
        assemble(inputs, cells, stress, tangent.reshape(m, q, 9, 9), into)

    return CompiledLaw(_own_values, size, fill, None, tuple(range(size)))


def point_cells(group: ElementGroup, cells: CellBatches, memory: IndexArray) -> PointCells:
    """Return the cells of a group with a compiled law, see PointCells.

    `tune` sets the values of their law.
    """
    compiled = compiled_law(group.material)
    assert compiled is not None
    weights = in_lanes(group.weights)
    batches, count, _ = weights.shape
    moduli = allocate_aligned((batches * (2 + compiled.size), LANES))
    buffers = allocate_buffers(group.cells.shape[1], count)
    return PointCells(cells, weights.reshape(-1, LANES), moduli, memory, buffers)


def own_values(cells: PointCells) -> PointCells:
    """Return the same cells with moduli of their own, still zero."""
    return cells._replace(moduli=allocate_aligned(cells.moduli.shape))


def tune(cells: PointCells, group: ElementGroup, p: Array, shear_alone: bool = False) -> None:
    """Set the moduli for values p (m, k) of the law; `shear_alone`: without bulk and without relaxation."""
    compiled, law = compiled_law(group.material), law_within(group.material)
    assert compiled is not None
    left = np.ones(len(p))
    if isinstance(group.material, Relaxing):
        left = left if shear_alone else group.material.compute_equilibrium_fraction(p)
        p = group.material.own(p)
    bulk = (np.zeros(len(p)), np.zeros(len(p)))
    if isinstance(law, VolumetricMaterial):
        bulk = (law.bulk(p), bulk[1]) if mean_volume_law(group) is None else split_bulk(group, law, p)
    moduli = compiled.moduli(law, p)
    scaled = np.setdiff1d(np.arange(moduli.shape[1]), compiled.fixed)
    moduli[:, scaled] *= left[:, None]
    bulk_of_both = np.zeros((len(p), 2)) if shear_alone else np.column_stack(bulk)
    cells.moduli[:] = in_lanes(np.concatenate([bulk_of_both, moduli], axis=1)).reshape(-1, LANES)
