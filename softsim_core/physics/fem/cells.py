r"""Energy, forces, stiffness and stress of cells, and their sums and means at the nodes.

.. math:: F = \sum_a x_a g_a^T, \quad f_a = -\sum_q w_q P g_a, \quad
    K_{ab} = -\partial f_a / \partial x_b = \sum_q w_q \, g_a \cdot (\partial P / \partial F) \cdot g_b

In an element with a mean volume, a part of the bulk of a VolumetricMaterial acts on the mean of theta over
the cell, and the pressure at a point is :math:`p = a_p \theta + (a - a_p) \bar\theta`. Source: Simo, Taylor,
Pister 1985, Variational and projection methods for the volume constraint.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import singledispatch
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from softsim_core.base import Array, IndexArray
from softsim_core.physics.fem.elements import Element
from softsim_core.physics.fem.group import ElementGroup
from softsim_core.physics.fem.materials import (
    StrainMaterial,
    TangentModes,
    VolumetricMaterial,
    von_mises,
    without_pressing,
)
from softsim_core.physics.linalg import Factoriser, LinearSolver

LEFT_IN_PLACE = 1e-9
"""Share of the stiffness in the least squares of RotatingSteps that keeps nodes where a linear step leads."""


def deformation_gradients(group: ElementGroup, positions: Array) -> Array:
    """Return F at the quadrature points, shape (m, q, 3, 3), for node positions (n, 3) in [m]."""
    return np.asarray(np.swapaxes(positions[group.cells], 1, 2)[:, None] @ group.gradients)


def strain_change(group: ElementGroup, before: Array, after: Array) -> float:
    """Return the largest change of the Green strain at a point, by the Frobenius norm.

    NaN if a position (n, 3) is NaN.
    """
    old, new = deformation_gradients(group, before), deformation_gradients(group, after)
    change = np.swapaxes(new, -1, -2) @ new - np.swapaxes(old, -1, -2) @ old
    return 0.5 * float(np.sqrt(np.einsum("mqij,mqij->mq", change, change).max(initial=0.0)))


def mean_volume_law(group: ElementGroup) -> VolumetricMaterial | None:
    """Return the law of a group whose cells have a mean volume, on which part of the bulk acts; else None."""
    law = group.material
    return law if group.element.mean_volume and isinstance(law, VolumetricMaterial) else None


def takes_found_stress(group: ElementGroup) -> bool:
    """Return whether a time step uses the pressure or stress of the last linear solve.

    See `cell_stiffness`.
    """
    return mean_volume_law(group) is not None or isinstance(group.material, StrainMaterial)


@singledispatch
def cell_energy(group: ElementGroup, positions: Array, p: Array) -> Array:
    """Return the elastic energy of each cell in [J], shape (m,).

    Args:
        group: The cells.
        positions: Node positions in [m], shape (n, 3).
        p: Parameters of each cell, shape (m, k); see ElementGroup.values.
    """
    gradients, law, p = deformation_gradients(group, positions), mean_volume_law(group), p[:, None]
    if law is None:
        return np.asarray((group.weights * group.material.energy(gradients, p)).sum(axis=1))
    at_points, on_mean = split_bulk(group, law, p)
    dilatation = law.dilatation(gradients)
    density = law.shear_energy(gradients, p) + 0.5 * at_points * dilatation**2
    mean = mean_over(group, dilatation)
    return np.asarray((group.weights * (density + 0.5 * on_mean * mean**2)).sum(axis=1))


def point_stress(group: ElementGroup, positions: Array, p: Array) -> Array:
    """Return the first Piola stress at the quadrature points in [Pa], shape (m, q, 3, 3).

    The arguments are those of `cell_energy`.
    """
    gradients, law, p = deformation_gradients(group, positions), mean_volume_law(group), p[:, None]
    if law is None:
        return group.material.stress(gradients, p)
    pressure = _pressure(group, law, gradients, p)[..., None, None]
    return np.asarray(law.shear_stress(gradients, p) + pressure * law.dilatation_slope(gradients))


@singledispatch
def cell_forces(group: ElementGroup, positions: Array, p: Array) -> Array:
    """Return the forces of the cells on their nodes in [N], shape (m, a, 3).

    The arguments are those of `cell_energy`.
    """
    weighted = group.weights[..., None, None] * point_stress(group, positions, p)
    return np.asarray(-(group.gradients @ np.swapaxes(weighted, -1, -2)).sum(axis=1))


class LinearMove(NamedTuple):
    """Displacement of all nodes by a linear solve.

    Attributes:
        start: Positions at which it was linearised in [m], shape (n, 3).
        moved: The displacement to first order in [m], shape (n, 3). Nodes of regions that turn end elsewhere.
    """

    start: Array
    moved: Array


@singledispatch
def cell_stiffness(
    group: ElementGroup,
    positions: Array,
    p: Array,
    positive: bool = False,
    distant: bool = False,
    last: LinearMove | None = None,
    mean_share: float = 1.0,
) -> Array:
    """Return the stiffness -df_a/dx_b of each cell in [N/m], shape (m, a, a, 3, 3).

    It is exact by default, `positive` for a time step, or `distant` for statics far from an equilibrium; see
    Material.

    `last` is the move by the last linear solve, which led here or close to here. With it, cells with a mean
    volume take the pressure that this solve found, to first order, instead of the pressure at the
    new positions. One iteration per step is then enough, even where the material is nearly incompressible. No
    eigenvalues are clamped in this case. Fibres and layers, which are stiff and thin, take the stress of the
    last solve in the same way; a positive stiffness leaves out its compressive part. Source: Magisano,
    Leonetti, Garcea 2017, Advantages of the mixed format.

    `mean_share` scales the stiffness of the mean volume.
    """
    law, gradients = mean_volume_law(group), deformation_gradients(group, positions)
    p, m, q, a = p[:, None], *group.gradients.shape[:3]
    if law is None:
        plain = group.material
        if last is not None and isinstance(plain, StrainMaterial):
            before, change = (deformation_gradients(group, each) for each in last)
            found = plain.extrapolated_stress(before, change, p)
            return _blocks(
                group, plain.tangent_at(gradients, p, without_pressing(found) if positive else found)
            )
        if positive and not distant and (modes := plain.positive_modes(gradients, p)) is not None:
            return _blocks_of_modes(group, modes)
        of = plain.distant_tangent if distant else plain.positive_tangent if positive else plain.tangent
        return _blocks(group, of(gradients, p))
    at_points, on_mean = split_bulk(group, law, p)
    if last is None:
        pressure = _pressure(group, law, gradients, p)
        at = law.positive_tangent_at if positive or distant else law.tangent_at
    else:
        pressure = _extrapolated_pressure(group, law, last, p)
        at = law.tangent_at
    blocks = _blocks(group, at(gradients, p, np.broadcast_to(at_points, (m, q)), pressure))
    volume = _volume_gradient(group, law, gradients).reshape(m, 3 * a)
    rank_one = (mean_share * on_mean / group.volumes[:, None] * volume)[:, :, None] * volume[:, None]
    return blocks + rank_one.reshape(m, a, 3, a, 3).swapaxes(2, 3)


def split_bulk(group: ElementGroup, law: VolumetricMaterial, p: Array) -> tuple[Array, Array]:
    """Return the bulk coefficients at the points and on the mean in [Pa] for parameters (..., k)."""
    at_points = law.point_bulk(p, group.element.point_ratio)
    return at_points, np.asarray(law.bulk(p) - at_points)


def mean_over(group: ElementGroup, at_points: Array) -> Array:
    """Return the mean over the volume of each cell of values at its points (m, q), shape (m, 1)."""
    return np.asarray((group.weights * at_points).sum(axis=1) / group.volumes)[:, None]


def _pressure(group: ElementGroup, law: VolumetricMaterial, gradients: Array, p: Array) -> Array:
    """Return the pressure a_p theta + (a - a_p) mean(theta) in [Pa], shape (m, q)."""
    at_points, on_mean = split_bulk(group, law, p)
    dilatation = law.dilatation(gradients)
    return np.asarray(at_points * dilatation + on_mean * mean_over(group, dilatation))


def _extrapolated_pressure(group: ElementGroup, law: VolumetricMaterial, last: LinearMove, p: Array) -> Array:
    """Return the pressure before a move plus its first-order change in [Pa], shape (m, q)."""
    before, moved = (deformation_gradients(group, each) for each in last)
    change = (law.dilatation_slope(before) * moved).sum(axis=(-2, -1))
    at_points, on_mean = split_bulk(group, law, p)
    return _pressure(group, law, before, p) + at_points * change + on_mean * mean_over(group, change)


def _volume_gradient(group: ElementGroup, law: VolumetricMaterial, gradients: Array) -> Array:
    """Return the derivative of the volume integral of theta by the nodes in [m^2], shape (m, a, 3)."""
    weighted = group.weights[..., None, None] * law.dilatation_slope(gradients)
    return np.asarray((group.gradients @ np.swapaxes(weighted, -1, -2)).sum(axis=1))


def mean_volume_answer(group: ElementGroup, positions: Array, p: Array, velocities: Array) -> Array:
    """Return K v in [N/s] of the mean volume's stiffness alone for velocities (n, 3), shape (n, 3)."""
    result, law = np.zeros_like(positions), mean_volume_law(group)
    if law is not None:
        p = p[:, None]
        volume = _volume_gradient(group, law, deformation_gradients(group, positions))
        rate = (volume * velocities[group.cells]).sum(axis=(1, 2)) / group.volumes
        answer = (split_bulk(group, law, p)[1][:, 0] * rate)[:, None, None] * volume
        np.add.at(result, group.cells, answer)
    return result


def _blocks(group: ElementGroup, tangent: Array) -> Array:
    """Return stiffness blocks (m, a, a, 3, 3) in [N/m] for tangents dP/dF (m, q, 3, 3, 3, 3) in [Pa]."""
    m, q, a = group.gradients.shape[:3]
    weighted = (group.weights[..., None, None] * tangent.reshape(m, q, 9, 9)).reshape(m, q, 27, 3)
    right = weighted @ np.swapaxes(group.gradients, -1, -2)  # (i J k), b
    right = right.reshape(m, q, 3, 3, 3 * a).swapaxes(2, 3).reshape(m, q, 3, 9 * a)  # J, (i k b)
    blocks = (group.gradients @ right).sum(axis=1).reshape(m, a, 3, 3, a)
    return np.ascontiguousarray(blocks.transpose(0, 1, 4, 2, 3))


def _blocks_of_modes(group: ElementGroup, tangent: TangentModes) -> Array:
    """Return the blocks of `_blocks` from tangent modes, with some fifty products per pair of nodes less."""
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
    """Return the stress in world axes at the points in [Pa], shape (m, q, 3, 3).

    The arguments are those of `cell_energy`.
    """
    stress = point_stress(group, positions, p)
    return group.material.cauchy_stress(deformation_gradients(group, positions), stress)


def cell_von_mises(group: ElementGroup, positions: Array, p: Array) -> Array:
    """Return the von Mises stress of each cell in [Pa], the mean over its volume, shape (m,)."""
    return mean_over(group, von_mises(cauchy_stress(group, positions, p)))[:, 0]


def inverted_cells(group: ElementGroup, positions: Array) -> Array:
    """Return which cells are flat or inverted at a point, det F <= 0, shape (m,)."""
    return np.asarray((np.linalg.det(deformation_gradients(group, positions)) <= 0.0).any(axis=1))


def elastic_forces(
    groups: Sequence[ElementGroup], positions: Array, materials: Sequence[Mapping[str, float]]
) -> Array:
    """Return the forces of all cells on the nodes in [N], shape (n, 3).

    Args:
        groups: All cells.
        positions: Node positions in [m], shape (n, 3).
        materials: Parameters by name of each body's law, then of each layer's and of the fibres'.
    """
    forces = np.zeros_like(positions)
    for group in groups:
        np.add.at(forces, group.cells, cell_forces(group, positions, group.values(materials)))
    return forces


class BlockPattern:
    """Sparsity pattern of the blocks of all pairs of nodes of cells; reuse it to assemble faster.

    Args:
        count: Number of nodes n.
        cells: Nodes of the cells of several kinds, shapes (m, a).
    """

    def __init__(self, count: int, cells: Sequence[IndexArray]) -> None:
        pairs = [(count * nodes[:, :, None] + nodes[:, None, :]).ravel() for nodes in cells]
        blocks = np.concatenate([np.zeros(0, dtype=np.int64), *pairs])
        places, place = np.unique(blocks, return_inverse=True)
        put = (np.ones(len(blocks)), (place.ravel(), np.arange(len(blocks))))
        self._sum = sp.csr_matrix(put, shape=(len(places), len(blocks)))
        rows, columns = np.divmod(places, count)
        ends = np.searchsorted(rows, np.arange(count + 1))
        numbers = np.arange(9 * len(places)).reshape(-1, 3, 3)
        entries = sp.bsr_matrix((numbers, columns, ends), shape=(3 * count, 3 * count)).tocsr()
        self._entry, self._columns, self._starts = entries.data, entries.indices, entries.indptr

    def matrix(self, blocks: Sequence[Array]) -> sp.csr_matrix:
        """Return the sum of the cells' blocks (m, a, a, 3, 3), sparse, shape (3 n, 3 n)."""
        values = np.concatenate([np.zeros((0, 9)), *(each.reshape(-1, 9) for each in blocks)])
        size = len(self._starts) - 1
        sums = (self._sum @ values).ravel()[self._entry]
        return sp.csr_matrix((sums, self._columns, self._starts), shape=(size, size))


def stiffness_matrix(
    groups: Sequence[ElementGroup],
    positions: Array,
    materials: Sequence[Mapping[str, float]],
    positive: bool = False,
    distant: bool = False,
    last: LinearMove | None = None,
    mean_share: float = 1.0,
    pattern: BlockPattern | None = None,
) -> sp.csr_matrix:
    """Return the stiffness of all cells on the nodes in [N/m], sparse, shape (3 n, 3 n).

    The arguments are those of `elastic_forces` and `cell_stiffness`; `pattern` is that of the groups,
    computed here if it is None.
    """
    if pattern is None:
        pattern = BlockPattern(len(positions), [group.cells for group in groups])
    return pattern.matrix(
        [
            cell_stiffness(group, positions, group.values(materials), positive, distant, last, mean_share)
            for group in groups
        ]
    )


class RotatingSteps:
    """Steps in which cells rotate by large angles without strain.

    A linear step moves nodes along straight lines, which stretches cells that rotate. Here the spin and the
    strain of the linear step give each point the gradient exp(spin) (1 + strain) F, and the nodes move to
    where their cells fit these gradients best (least squares). A short step equals the linear one.

    Source: Huang, Tong, Zhou, Bao, Desbrun 2011, Interactive shape interpolation through controllable dynamic
    deformation (rotation-strain coordinates).

    Args:
        groups: The cells that fill the bodies.
        free: Indices of the free nodes, shape (k,).
        count: Number of nodes n.
        solver: Solver of the least squares.
    """

    def __init__(
        self, groups: Sequence[ElementGroup], free: IndexArray, count: int, solver: LinearSolver
    ) -> None:
        gradients, weights = [sp.csr_matrix((0, count))], [np.zeros(0)]
        for group in groups:
            values = np.swapaxes(group.gradients, -1, -2)
            nodes = np.broadcast_to(group.cells[:, None, None], values.shape)
            ends = np.arange(0, values.size + 1, values.shape[-1])
            gradients.append(sp.csr_matrix((values.ravel(), nodes.ravel(), ends), (len(ends) - 1, count)))
            weights.append(np.repeat(group.weights, 3))
        self._gradients = sp.vstack(gradients, format="csr")
        self._forces = (self._gradients.T @ sp.diags(np.concatenate(weights))).tocsr()[free]
        laplacian = self._forces @ self._gradients[:, free]
        near = LEFT_IN_PLACE * float(laplacian.diagonal().mean()) * sp.eye(len(free))
        self._factors = Factoriser(solver).factor(laplacian + near)

    def correction(self, before: Array, after: Array) -> Array:
        """Return what to add to the free nodes after a linear step in [m], shape (k, 3).

        Args:
            before: Positions of all nodes before the step in [m], shape (n, 3).
            after: Positions after the linear step in [m], shape (n, 3).

        Raises:
            LinAlgError: a cell is flat.
        """
        old, change = (
            np.swapaxes((self._gradients @ each).reshape(-1, 3, 3), 1, 2) for each in (before, after - before)
        )
        slope = change @ np.linalg.inv(old)
        spin = 0.5 * (slope - np.swapaxes(slope, 1, 2))
        angle = np.sqrt(0.5 * (spin**2).sum(axis=(1, 2)))[:, None, None]
        rotation = np.eye(3) + np.sinc(angle / np.pi) * spin
        rotation += 0.5 * np.sinc(0.5 * angle / np.pi) ** 2 * (spin @ spin)
        missing = rotation @ (old + change - spin @ old) - (old + change)
        return self._factors.solve(self._forces @ np.swapaxes(missing, 1, 2).reshape(-1, 3))


def von_mises_stress(
    groups: Sequence[ElementGroup], positions: Array, materials: Sequence[Mapping[str, float]]
) -> Array:
    """Return the von Mises stress of every cell in [Pa], in the order of their numbers, shape (m,).

    Layers and fibres are left out. The arguments are those of `elastic_forces`.
    """
    filling = [group for group in groups if group.fills]
    result = np.zeros(sum(len(group.cells) for group in filling))
    for group in filling:
        result[group.numbers] = cell_von_mises(group, positions, group.values(materials))
    return result


def to_nodes(element: Element) -> Array:
    """Return the map from values at a cell's points to values at its nodes, shape (a, q).

    It evaluates the linear field that fits the points best. With fewer than four points, it is their mean.
    """
    if len(element.points) < 4:
        return np.full((len(element.reference), len(element.points)), 1.0 / len(element.points))
    at_points, at_nodes = (
        np.column_stack([np.ones(len(each)), each]) for each in (element.points, element.reference)
    )
    return np.asarray(at_nodes @ np.linalg.pinv(at_points))


def stress_at_nodes(
    groups: Sequence[ElementGroup],
    positions: Array,
    materials: Sequence[Mapping[str, float]],
) -> Array:
    """Return the stress in world axes in [Pa], shape (n, 3, 3), as the mean over the cells around each node.

    A node without cells has zero stress. A stress that is linear in space is exact at the nodes of quadratic
    cells; at their corners it is one order more accurate than a mean over the points.

    Args:
        groups: The cells, without layers and fibres.
        positions: Node positions in [m], shape (n, 3).
        materials: See `elastic_forces`.

    Source: Hinton and Campbell 1974, Local and global smoothing of discontinuous finite element functions.
    """
    total, around = np.zeros((len(positions), 3, 3)), np.zeros(len(positions))
    for group in groups:
        at_points = cauchy_stress(group, positions, group.values(materials))
        of_nodes = np.einsum("aq,mqij->maij", to_nodes(group.element), at_points)
        np.add.at(total, group.cells, of_nodes)
        np.add.at(around, group.cells, 1.0)
    return np.asarray(total / np.maximum(around, 1.0)[:, None, None])
