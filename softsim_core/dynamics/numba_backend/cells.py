"""The cells of a model for the compiled step: with kernels of their own, or through blocks of node pairs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy

import numpy as np

from softsim_core.arrays import Array, IndexArray, unique_pairs
from softsim_core.dynamics.numba_backend.batches import in_lanes
from softsim_core.dynamics.numba_backend.compile import kernel
from softsim_core.dynamics.numba_backend.elements import assemble_free, assemble_mixed, von_mises_stress
from softsim_core.dynamics.numba_backend.layout import Cells, Elements, Nodes, Work
from softsim_core.dynamics.numba_backend.paired import PairedCells
from softsim_core.dynamics.numba_backend.scatter import node_pairs, scatter
from softsim_core.fem.cells import cell_von_mises
from softsim_core.fem.elements import element
from softsim_core.fem.group import ElementGroup, empty_group
from softsim_core.fem.materials import material
from softsim_core.fem.materials.isotropic import lame
from softsim_core.linalg.simd import LANES
from softsim_core.linalg.symbolic import Plan
from softsim_core.mechanics.model import FREE, Model
from softsim_core.mechanics.state import State

COMPILED = (("tet4", "corotational"), ("tet4", "corotational_qr"))
"""Elements and laws with kernels of their own: rotations by polar decomposition, and by frames."""


@kernel
def assemble_cells(
    x: Array, scale: float, polar: int, frames: int, cells: Cells, nodes: Nodes, work: Work
) -> None:
    """Forces of cells with kernels, and scale times their stiffness, into panels and reduced.

    PairedCells.fill has been there before: what it kept for the reduced coordinates is added, too.

    `polar` and `frames` are the tangents of the two kinds of Cells, see elements.FROZEN.
    """
    assemble_free(x, scale, polar, cells.polar_free, work)
    assemble_mixed(x, scale, polar, cells.polar_mixed, nodes, work)
    assemble_free(x, scale, frames, cells.frame_free, work)
    assemble_mixed(x, scale, frames, cells.frame_mixed, nodes, work)
    scatter(cells.pairs, nodes, work)


class PlannedCells:
    """All cells that deform, and where they go.

    Args:
        model: Whose cells.
        groups: Its groups without cells that are rigid as a whole, see `deforming`.
        nodes: Places of the nodes in the step's arrays.
        local: Number of each free node among the free ones, shape (n,).
        layout: The plan of the factor.
        panels: Of the factor.
        surfaces: See PairedCells.

    Attributes:
        arrays: For the kernels.
        paired: The cells whose stiffness is added pair by pair.
    """

    def __init__(
        self,
        model: Model,
        groups: Sequence[ElementGroup],
        nodes: Nodes,
        local: IndexArray,
        layout: Plan,
        panels: Array,
        surfaces: Sequence[IndexArray] = (),
    ) -> None:
        self._count = sum(len(group.cells) for group in model.filling)
        self._kernels: list[tuple[ElementGroup, Elements, bool]] = []
        by_kind = {(group.element.name, group.material.name): group for group in groups}
        for kind in COMPILED:
            group = by_kind.pop(kind, None) or empty_group(element(kind[0]), material(kind[1]))
            all_free = (model.region_of_node[group.cells] == FREE).all(axis=1)
            for chosen in (all_free, ~all_free):
                part, elements = _elements(model, group.part(np.flatnonzero(chosen)), local, layout)
                self._kernels.append((part, elements, not part.material.in_cell_axes))
        self._paired_groups = tuple(by_kind.values())
        self.paired = PairedCells(
            self._paired_groups,
            model.groups,
            nodes,
            local,
            layout,
            panels,
            surfaces,
            () if model.coupling is None else model.coupling.cells,
        )
        self.arrays = self._arrays()

    def _arrays(self) -> Cells:
        polar_free, polar_mixed, frame_free, frame_mixed = (elements for _, elements, _ in self._kernels)
        return Cells(polar_free, polar_mixed, frame_free, frame_mixed, self.paired.pairs)

    def of_another_copy(self) -> PlannedCells:
        """The same cells for parameters of their own; the room to work in is this one's."""
        other = copy(self)
        other._kernels = [
            (group, elements._replace(lame=np.zeros_like(elements.lame)), polar)
            for group, elements, polar in self._kernels
        ]
        other.paired = self.paired.of_another_copy()
        other.arrays = other._arrays()
        return other

    def tune(self, materials: Sequence[Mapping[str, float]]) -> None:
        """Take over the parameters of each body's law by name."""
        self.paired.tune(materials)
        for group, elements, _ in self._kernels:
            moduli = np.stack(lame(group.values(materials)), axis=1) * group.volumes[:, None]
            padded = np.zeros((len(elements.lame) * LANES, 2))
            padded[: len(moduli)] = moduli
            elements.lame[:] = padded.reshape(-1, LANES, 2).swapaxes(1, 2)

    def von_mises(self, state: State, materials: Sequence[Mapping[str, float]], work: Work) -> Array:
        """Von Mises stress of each cell in [Pa], shape (m,); cells of one rigid region have none."""
        result = np.zeros(self._count)
        for group, elements, polar in self._kernels:
            moduli = np.zeros((self._count, 2))
            moduli[group.numbers] = np.stack(lame(group.values(materials)), axis=1)
            von_mises_stress(state.positions, polar, elements, group.numbers, moduli, work, result)
        for group in (each for each in self._paired_groups if each.fills):
            result[group.numbers] = cell_von_mises(group, state.positions, group.values(materials))
        return result


def deforming(model: Model) -> list[ElementGroup]:
    """The groups of a model without cells that are rigid as a whole."""
    groups = []
    for group in model.groups:
        regions = model.region_of_node[group.cells]
        rigid = (regions == regions[:, :1]).all(axis=1) & (regions[:, 0] != FREE)
        groups.append(group.part(np.flatnonzero(~rigid)))
    return groups


def couplings(
    model: Model, groups: Sequence[ElementGroup], local: IndexArray
) -> tuple[IndexArray, IndexArray]:
    """Pairs of coupled free nodes, and pairs (free node, reduced coordinate)."""
    pairs = np.concatenate([np.zeros((0, 2), np.int64), *(node_pairs(group.cells) for group in groups)])
    regions = model.region_of_node[pairs]
    edges = local[pairs[(regions == FREE).all(axis=1)]]
    beside = pairs[(regions[:, 0] == FREE) & (regions[:, 1] >= 0)]
    touching = unique_pairs(np.stack([local[beside[:, 0]], model.region_of_node[beside[:, 1]]], axis=1))
    reduced = {
        (node, b) for node, region in touching.tolist() for b in model.regions[region].reduced.tolist()
    }
    return unique_pairs(edges), np.array(sorted(reduced), dtype=np.int64).reshape(-1, 2)


def _elements(
    model: Model, group: ElementGroup, local: IndexArray, layout: Plan
) -> tuple[ElementGroup, Elements]:
    """The cells of a group in elimination order, and their places in the panels."""
    nodes = group.cells
    regions = model.region_of_node[nodes]
    count = len(layout.position)
    places = np.append(layout.position, 0)[local[nodes]]  # held and region nodes have no place of their own
    rank = np.where(regions == FREE, places, np.where(regions >= 0, count, count + 1))
    order = np.argsort(rank.min(axis=1, initial=count), kind="stable")
    group, nodes, regions, rank = group.part(order), nodes[order], regions[order], rank[order]
    inside = np.argsort(rank, axis=1, kind="stable")
    ordered = np.take_along_axis(nodes, inside, axis=1)
    gradients = np.take_along_axis(group.gradients[:, 0], inside[:, :, None], axis=1)
    counts = np.stack([(regions == FREE).sum(axis=1), (regions >= 0).sum(axis=1)], axis=1)
    starts, strides = np.zeros((len(nodes), 18), dtype=np.int64), np.zeros((len(nodes), 4), dtype=np.int64)
    node = local[ordered]  # -1 where it is not free; free ones come first
    is_free = np.arange(4) < counts[:, :1]
    starts[:, 10:14] = offset = np.where(is_free, np.append(layout.row_offset, 0)[node], 0)
    starts[:, 14:] = supernode = np.where(is_free, np.append(layout.supernode, 0)[node], 0)
    strides[is_free] = layout.width[supernode[is_free]]
    for a in range(4):
        for b in range(a, 4):
            there = np.flatnonzero(is_free[:, b])
            pair = a * counts[there, 0] - a * (a - 1) // 2 + b - a
            unknown = 3 * layout.position[node[there, b]]
            column = layout.panel_columns(supernode[there, a], unknown)
            starts[there, pair] = offset[there, a] + column
    return group, Elements(
        nodes=in_lanes(ordered),
        corners=in_lanes(nodes),
        gradients=in_lanes(gradients.reshape(-1, 12)),
        lame=np.zeros((-(-len(nodes) // LANES), 2, LANES)),
        starts=starts,
        strides=strides,
        counts=counts,
    )
