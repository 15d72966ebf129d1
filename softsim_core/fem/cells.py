r"""Energy, forces, stiffness and stress of the cells of any group, in NumPy.

.. math:: F = \sum_a x_a g_a^T, \quad f_a = -\sum_q w_q P g_a, \quad
    K_{ab} = -\partial f_a / \partial x_b = \sum_q w_q \, g_a \cdot (\partial P / \partial F) \cdot g_b

Of a VolumetricMaterial in an element with a mean volume, a part of the bulk acts on the mean of theta over
the cell, and the pressure at a point is :math:`p = a_p \theta + (a - a_p) \bar\theta`. Source: Simo, Taylor,
Pister 1985, Variational and projection methods for the volume constraint.
"""

from __future__ import annotations

from functools import singledispatch

import numpy as np

from softsim_core.arrays import Array
from softsim_core.fem.group import ElementGroup
from softsim_core.fem.materials.material import TangentModes, VolumetricMaterial, von_mises
from softsim_core.fem.materials.strain import StrainMaterial, without_pressing


def deformation_gradients(group: ElementGroup, positions: Array) -> Array:
    """F at the quadrature points, shape (m, q, 3, 3), at node positions (n, 3) in [m]."""
    return np.asarray(np.swapaxes(positions[group.cells], 1, 2)[:, None] @ group.gradients)


def strain_change(group: ElementGroup, before: Array, after: Array) -> float:
    """Largest change of the Green strain at a point, by the Frobenius norm; NaN if a place (n, 3) is one."""
    old, new = deformation_gradients(group, before), deformation_gradients(group, after)
    change = np.swapaxes(new, -1, -2) @ new - np.swapaxes(old, -1, -2) @ old
    return 0.5 * float(np.sqrt(np.einsum("mqij,mqij->mq", change, change).max(initial=0.0)))


def mean_volume_law(group: ElementGroup) -> VolumetricMaterial | None:
    """The law of cells whose mean dilatation takes a part of the bulk; None: those of the group do not."""
    law = group.material
    return law if group.element.mean_volume and isinstance(law, VolumetricMaterial) else None


def takes_found_stress(group: ElementGroup) -> bool:
    """Whether a time step takes the pressure or stress that its linear solve found; see `cell_stiffness`."""
    return mean_volume_law(group) is not None or isinstance(group.material, StrainMaterial)


@singledispatch
def cell_energy(group: ElementGroup, positions: Array, p: Array) -> Array:
    """Elastic energy of each cell in [J], shape (m,).

    Args:
        group: The cells.
        positions: Node positions in [m], shape (n, 3).
        p: Parameters of each cell, shape (m, k); see ElementGroup.values.
    """
    gradients, law, p = deformation_gradients(group, positions), mean_volume_law(group), p[:, None]
    if law is None:
        return np.asarray((group.weights * group.material.energy(gradients, p)).sum(axis=1))
    at_points, on_mean = split_bulk(law, p)
    dilatation = law.dilatation(gradients)
    density = law.shear_energy(gradients, p) + 0.5 * at_points * dilatation**2
    mean = mean_over(group, dilatation)
    return np.asarray((group.weights * (density + 0.5 * on_mean * mean**2)).sum(axis=1))


def point_stress(group: ElementGroup, positions: Array, p: Array) -> Array:
    """First Piola stress at the quadrature points in [Pa], (m, q, 3, 3); arguments as for `cell_energy`."""
    gradients, law, p = deformation_gradients(group, positions), mean_volume_law(group), p[:, None]
    if law is None:
        return group.material.stress(gradients, p)
    pressure = _pressure(group, law, gradients, p)[..., None, None]
    return np.asarray(law.shear_stress(gradients, p) + pressure * law.dilatation_slope(gradients))


@singledispatch
def cell_forces(group: ElementGroup, positions: Array, p: Array) -> Array:
    """Forces of the cells on their nodes in [N], shape (m, a, 3); arguments as for `cell_energy`."""
    weighted = group.weights[..., None, None] * point_stress(group, positions, p)
    return np.asarray(-(group.gradients @ np.swapaxes(weighted, -1, -2)).sum(axis=1))


@singledispatch
def cell_stiffness(
    group: ElementGroup,
    positions: Array,
    p: Array,
    positive: bool = False,
    distant: bool = False,
    moved: Array | None = None,
    mean_share: float = 1.0,
) -> Array:
    """-df_a/dx_b of each cell in [N/m], shape (m, a, a, 3, 3).

    Exact, or `positive` for a time step, or for statics `distant` from an equilibrium; see Material.

    With `moved`, the displacement in [m] of all nodes by the last linear solve, shape (n, 3), cells with a
    mean volume take the pressure that this solve found, to first order, instead of that of the positions it
    led to. So one iteration is enough for a step, also where the material is nearly incompressible; nothing
    is made positive then. Fibres and layers, which are stiff and thin, take the stress so; of a positive one
    nothing that presses them. Source: Magisano, Leonetti, Garcea 2017, Advantages of the mixed format.

    With a `mean_share` below 1, the answer to the mean volume has so much of its stiffness.
    """
    law, gradients = mean_volume_law(group), deformation_gradients(group, positions)
    p, m, q, a = p[:, None], *group.gradients.shape[:3]
    if law is None:
        plain = group.material
        if moved is not None and isinstance(plain, StrainMaterial):
            before, change = (deformation_gradients(group, each) for each in (positions - moved, moved))
            found = plain.extrapolated_stress(before, change, p)
            return _blocks(
                group, plain.tangent_at(gradients, p, without_pressing(found) if positive else found)
            )
        if positive and not distant and (modes := plain.positive_modes(gradients, p)) is not None:
            return _blocks_of_modes(group, modes)
        of = plain.distant_tangent if distant else plain.positive_tangent if positive else plain.tangent
        return _blocks(group, of(gradients, p))
    at_points, on_mean = split_bulk(law, p)
    if moved is None:
        pressure = _pressure(group, law, gradients, p)
        at = law.positive_tangent_at if positive or distant else law.tangent_at
    else:
        pressure = _extrapolated_pressure(group, law, positions, moved, p)
        at = law.tangent_at
    blocks = _blocks(group, at(gradients, p, np.broadcast_to(at_points, (m, q)), pressure))
    volume = _volume_gradient(group, law, gradients).reshape(m, 3 * a)
    rank_one = (mean_share * on_mean / group.volumes[:, None] * volume)[:, :, None] * volume[:, None]
    return blocks + rank_one.reshape(m, a, 3, a, 3).swapaxes(2, 3)


def split_bulk(law: VolumetricMaterial, p: Array) -> tuple[Array, Array]:
    """Bulk coefficients at the points and on the mean in [Pa], of parameters (..., k)."""
    at_points = law.point_bulk(p)
    return at_points, np.asarray(law.bulk(p) - at_points)


def mean_over(group: ElementGroup, at_points: Array) -> Array:
    """Mean over the volume of each cell of values at its points (m, q), shape (m, 1)."""
    return np.asarray((group.weights * at_points).sum(axis=1) / group.volumes)[:, None]


def _pressure(group: ElementGroup, law: VolumetricMaterial, gradients: Array, p: Array) -> Array:
    """a_p theta + (a - a_p) times its mean, in [Pa], shape (m, q)."""
    at_points, on_mean = split_bulk(law, p)
    dilatation = law.dilatation(gradients)
    return np.asarray(at_points * dilatation + on_mean * mean_over(group, dilatation))


def _extrapolated_pressure(
    group: ElementGroup, law: VolumetricMaterial, positions: Array, moved: Array, p: Array
) -> Array:
    """The pressure before the nodes `moved`, and to first order what they changed of it, shape (m, q)."""
    before = deformation_gradients(group, positions - moved)
    change = (law.dilatation_slope(before) * deformation_gradients(group, moved)).sum(axis=(-2, -1))
    at_points, on_mean = split_bulk(law, p)
    return _pressure(group, law, before, p) + at_points * change + on_mean * mean_over(group, change)


def _volume_gradient(group: ElementGroup, law: VolumetricMaterial, gradients: Array) -> Array:
    """Derivative of the volume integral of theta by the nodes in [m^2], shape (m, a, 3)."""
    weighted = group.weights[..., None, None] * law.dilatation_slope(gradients)
    return np.asarray((group.gradients @ np.swapaxes(weighted, -1, -2)).sum(axis=1))


def mean_volume_answer(group: ElementGroup, positions: Array, p: Array, velocities: Array) -> Array:
    """K v in [N/s] of the mean volume's part of the stiffness alone, at velocities (n, 3), shape (n, 3)."""
    result, law = np.zeros_like(positions), mean_volume_law(group)
    if law is not None:
        p = p[:, None]
        volume = _volume_gradient(group, law, deformation_gradients(group, positions))
        rate = (volume * velocities[group.cells]).sum(axis=(1, 2)) / group.volumes
        answer = (split_bulk(law, p)[1][:, 0] * rate)[:, None, None] * volume
        np.add.at(result, group.cells, answer)
    return result


def _blocks(group: ElementGroup, tangent: Array) -> Array:
    """Stiffness blocks (m, a, a, 3, 3) in [N/m] of tangents dP/dF (m, q, 3, 3, 3, 3) in [Pa]."""
    m, q, a = group.gradients.shape[:3]
    weighted = (group.weights[..., None, None] * tangent.reshape(m, q, 9, 9)).reshape(m, q, 27, 3)
    right = weighted @ np.swapaxes(group.gradients, -1, -2)  # (i J k), b
    right = right.reshape(m, q, 3, 3, 3 * a).swapaxes(2, 3).reshape(m, q, 3, 9 * a)  # J, (i k b)
    blocks = (group.gradients @ right).sum(axis=1).reshape(m, a, 3, 3, a)
    return np.ascontiguousarray(blocks.transpose(0, 1, 4, 2, 3))


def _blocks_of_modes(group: ElementGroup, tangent: TangentModes) -> Array:
    """As `_blocks`, of tangents at the points (m, q): some fifty products per pair of nodes less."""
    m, q, a = group.gradients.shape[:3]
    modes = tangent.modes.shape[-3]
    moved = tangent.modes.reshape(m, q, 3 * modes, 3) @ np.swapaxes(group.gradients, -1, -2)  # (k i), a
    moved = moved.reshape(m, q * modes, 3 * a)
    weighted = (group.weights[..., None] * tangent.weights).reshape(m, q * modes, 1) * moved
    blocks = (np.swapaxes(weighted, 1, 2) @ moved).reshape(m, 3, a, 3, a)
    result = np.ascontiguousarray(blocks.transpose(0, 2, 4, 1, 3))
    scaled = (group.weights * tangent.isotropic)[..., None, None] * group.gradients
    alike = (scaled @ np.swapaxes(group.gradients, -1, -2)).sum(axis=1)
    result[..., range(3), range(3)] += alike[..., None]
    return result


@singledispatch
def cauchy_stress(group: ElementGroup, positions: Array, p: Array) -> Array:
    """Stress in world axes at the points in [Pa], (m, q, 3, 3); arguments as for `cell_energy`."""
    stress = point_stress(group, positions, p)
    return group.material.cauchy_stress(deformation_gradients(group, positions), stress)


def cell_von_mises(group: ElementGroup, positions: Array, p: Array) -> Array:
    """Von Mises stress of each cell in [Pa], the mean over its volume, shape (m,)."""
    return mean_over(group, von_mises(cauchy_stress(group, positions, p)))[:, 0]


def inverted_cells(group: ElementGroup, positions: Array) -> Array:
    """Which cells are flat or inside out somewhere, det F <= 0, shape (m,)."""
    return np.asarray((np.linalg.det(deformation_gradients(group, positions)) <= 0.0).any(axis=1))
