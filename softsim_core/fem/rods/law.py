"""Energy, forces, stiffness, damping and stress of cells of rods."""

from __future__ import annotations

import numpy as np

from softsim_core.arrays import Array
from softsim_core.fem.cells import cauchy_stress, cell_energy, cell_forces, cell_stiffness
from softsim_core.fem.materials.section import Section
from softsim_core.fem.rods.group import RodGroup
from softsim_core.fem.rods.strain_points import StrainPoints


@cell_energy.register
def rod_energy(group: RodGroup, positions: Array, p: Array) -> Array:
    """See fem.cells.cell_energy."""
    total = np.zeros(len(group.cells))
    for points, stiffness in group.families(p):
        strain, _ = points.strains(points.products(points.vectors(positions, group.cells)))
        total += 0.5 * np.einsum(
            "mq,mqk,mqkl,mql->m", points.lengths, strain, stiffness, strain, optimize=True
        )
    return total


@cell_forces.register
def rod_forces(group: RodGroup, positions: Array, p: Array) -> Array:
    """See fem.cells.cell_forces."""
    total = np.zeros((*group.cells.shape, 3))
    for points, stiffness in group.families(p):
        vectors = points.vectors(positions, group.cells)
        strain, by_products = points.strains(points.products(vectors))
        resultants = points.lengths[..., None] * (stiffness @ strain[..., None])[..., 0]
        pulling = (resultants[..., None, :] @ by_products)[..., 0, :]
        total -= np.einsum("mqk,mqkai->mai", pulling, points.slopes(vectors))
    return total


@cell_stiffness.register
def rod_stiffness(
    group: RodGroup,
    positions: Array,
    p: Array,
    positive: bool = False,
    distant: bool = False,
    moved: Array | None = None,
    mean_share: float = 1.0,
) -> Array:
    """See fem.cells.cell_stiffness; a positive or distant one has of the resultants only what stretches."""
    count, a = group.cells.shape
    total = np.zeros((count, a, a, 3, 3))
    for points, stiffness in group.families(p):
        vectors = points.vectors(positions, group.cells)
        slopes, products = points.slopes(vectors), points.products(vectors)
        strain, by_products = points.strains(products)
        if moved is not None:  # to first order, what the last linear solve found
            second = points.products(points.vectors(moved, group.cells))
            strain = strain - (by_products @ second[..., None])[..., 0]
        resultants = points.lengths[..., None] * (stiffness @ strain[..., None])[..., 0]
        pulling = (resultants[..., None, :] @ by_products)[..., 0, :]
        moduli = np.swapaxes(by_products, -1, -2) @ stiffness @ by_products
        moduli *= points.lengths[..., None, None]
        if (positive or distant) and moved is None:
            stretches = np.diagonal(points.forms, axis1=1, axis2=2).any(axis=1)
            pulling = np.where(stretches, np.maximum(pulling, 0.0), 0.0)
        else:
            moduli += points.bent(products, resultants)
        flat = slopes.reshape(*slopes.shape[:3], -1)
        total += (
            (np.swapaxes(flat, -1, -2) @ (moduli @ flat))
            .sum(axis=1)
            .reshape(count, a, 3, a, 3)
            .swapaxes(2, 3)
        )
        turning = np.einsum(
            "mqk,kfg,mqfa,mqgb->mab", pulling, points.forms, points.maps, points.maps, optimize=True
        )
        total += turning[..., None, None] * np.eye(3)
    return total


def rod_viscosity(group: RodGroup, positions: Array, p: Array) -> Array:
    """-df_a/dv_b of the law's damping in [N s/m], shape (m, a, a, 3, 3): positive, and none for a turning."""
    assert isinstance(group.material, Section)
    count, a = group.cells.shape
    total = np.zeros((count, 3 * a, 3 * a))
    damping = group.material.damping(p)[:, None, None, None]
    for points, stiffness in group.families(p):
        by_places, weighted = (
            _by_places(points, group, positions),
            points.lengths[..., None, None] * stiffness,
        )
        total += (np.swapaxes(by_places, -1, -2) @ (damping * weighted) @ by_places).sum(axis=1)
    return total.reshape(count, a, 3, a, 3).swapaxes(2, 3)


def rod_drag(group: RodGroup, before: Array, positions: Array, p: Array, dt: float) -> Array:
    """Forces of the law's damping in [N] where the strains at `before` became others in dt, (m, a, 3)."""
    assert isinstance(group.material, Section)
    total = np.zeros((*group.cells.shape, 3))
    damping = group.material.damping(p)[:, None, None]
    for points, stiffness in group.families(p):
        old, new = (
            points.strains(points.products(points.vectors(at, group.cells))).values
            for at in (before, positions)
        )
        resultants = damping * points.lengths[..., None] * (stiffness @ ((new - old) / dt)[..., None])[..., 0]
        by_places = _by_places(points, group, positions)
        total -= np.einsum("mqk,mqkc->mc", resultants, by_places).reshape(total.shape)
    return total


def _by_places(points: StrainPoints, group: RodGroup, positions: Array) -> Array:
    """Derivatives of the strains by the places of a cell's nodes, shape (m, q, k, 3 a)."""
    vectors = points.vectors(positions, group.cells)
    slopes = points.slopes(vectors)
    return points.strains(points.products(vectors)).slopes @ slopes.reshape(*slopes.shape[:3], -1)


@cauchy_stress.register
def rod_stress(group: RodGroup, positions: Array, p: Array) -> Array:
    """See fem.cells.cauchy_stress: that of the fibre that is stressed most, with the shear at its place.

    Of clamps and of sections that are given by their stiffness it is what the shape that is drawn would have.
    """
    assert isinstance(group.material, Section)
    line, _ = group.material.scales(p)
    vectors = group.line.vectors(positions, group.cells)
    strain, _ = group.line.strains(group.line.products(vectors))
    reach = group.reach[:, None]
    bending = np.abs(strain[..., 3:5] * reach).sum(axis=-1)
    axial = line[:, None, 0] * (strain[..., 0] + np.where(strain[..., 0] < 0.0, -bending, bending))
    twisting = strain[..., 5] * reach.min(axis=-1)
    shear = line[:, 1, None] * np.hypot(np.hypot(strain[..., 1], strain[..., 2]), 2.0 * twisting)
    frame = vectors[..., :2, :] / np.linalg.norm(vectors[..., :2, :], axis=-1, keepdims=True)
    tangent, across = frame[..., 0, :], frame[..., 1, :]
    mixed = tangent[..., :, None] * across[..., None, :]
    return np.asarray(
        axial[..., None, None] * tangent[..., :, None] * tangent[..., None, :]
        + shear[..., None, None] * (mixed + np.swapaxes(mixed, -1, -2))
    )
