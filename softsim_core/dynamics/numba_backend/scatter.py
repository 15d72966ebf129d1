"""Cells whose stiffness blocks are computed first, then added to the factor's panels pair by pair."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from softsim_core.arrays import Array, IndexArray
from softsim_core.dynamics.numba_backend.compile import kernel
from softsim_core.dynamics.numba_backend.layout import Nodes, Pairs, Work
from softsim_core.dynamics.numba_backend.rubber import fill_rubber, rubber_cells, tune
from softsim_core.dynamics.numba_backend.strain_cells import fill_strain, strain_cells, tune_strain
from softsim_core.fem.assembly import cell_forces, cell_stiffness, mean_volume_law
from softsim_core.fem.group import ElementGroup
from softsim_core.fem.materials.first_invariant import SeriesRubber
from softsim_core.fem.materials.relaxing import law_within
from softsim_core.fem.prony import held_stiffness
from softsim_core.kernels import OneSignature
from softsim_core.linalg.symbolic import Plan
from softsim_core.mechanics.state import State, held_name


@kernel
def scatter(scale: float, pairs: Pairs, nodes: Nodes, work: Work) -> None:
    """Add scale times the blocks of all pairs to panels and reduced; work.jacobian has to be in place."""
    panels, schur, jacobian, blocks = work.factor.panels, work.factor.schur, work.jacobian, pairs.blocks
    for p in range(len(pairs.free)):
        block, place, width = pairs.free[p, 0], pairs.free[p, 1], pairs.free[p, 2]
        for i in range(3):
            for j in range(3):
                panels[place + i * width + j] += scale * blocks[block, i, j]
    for p in range(len(pairs.beside)):
        block, place, width = pairs.beside[p, 0], pairs.beside[p, 1], pairs.beside[p, 2]
        supernode, z = pairs.beside[p, 3], pairs.beside[p, 4]
        for q in range(nodes.size[z]):
            at = place + nodes.reduced_column[supernode, nodes.reduced[z, q]]
            for i in range(3):
                total = 0.0
                for j in range(3):
                    total += blocks[block, i, j] * jacobian[z, q, j]
                panels[at + i * width] += scale * total
    for p in range(len(pairs.regions)):
        block, a, b = pairs.regions[p, 0], pairs.regions[p, 1], pairs.regions[p, 2]
        for q in range(nodes.size[b]):
            k = nodes.reduced[b, q]
            for r in range(nodes.size[a]):
                m = nodes.reduced[a, r]
                if m <= k:
                    for i in range(3):
                        for j in range(3):
                            schur[m, k] += scale * jacobian[a, r, i] * blocks[block, i, j] * jacobian[b, q, j]


class PairedCells:
    """The cells whose stiffness is added pair by pair: rubber by its own kernel, the others from NumPy.

    Args:
        groups: Their groups, without cells that are rigid as a whole.
        whole: All groups of the model, with them.
        nodes: Places of the nodes in the step's arrays.
        local: Number of each free node among the free ones, shape (n,).
        layout: The plan of the factor.
    """

    def __init__(
        self,
        groups: Sequence[ElementGroup],
        whole: Sequence[ElementGroup],
        nodes: Nodes,
        local: IndexArray,
        layout: Plan,
    ) -> None:
        self._groups = [
            (group, rubber_cells(group) if isinstance(law_within(group.material), SeriesRubber) else None)
            for group in groups
            if len(group.cells)
        ]
        kinds = [(group.element.name, group.material.name) for group in whole]
        self._reinforcing = [strain_cells(group) for group, _ in self._groups]
        self._places = []
        for group, _ in self._groups:
            k = kinds.index((group.element.name, group.material.name))
            self._places.append((k, np.searchsorted(whole[k].numbers, group.numbers)))
        ordered = [node_pairs(group.cells) for group, _ in self._groups]
        both = np.concatenate([np.zeros((0, 2), np.int64), *ordered])
        self.pairs = _placed(both, nodes, local, layout)
        self._fill_rubber, self._fill_strain = OneSignature(fill_rubber), OneSignature(fill_strain)

    def __bool__(self) -> bool:
        return bool(self._groups)

    def tune(self, materials: Sequence[Mapping[str, float]]) -> None:
        """Take over the parameters of each body's law by name."""
        for (group, compiled), reinforcing in zip(self._groups, self._reinforcing, strict=True):
            if compiled is not None:
                tune(compiled, group, group.values(materials))
            if reinforcing is not None:
                tune_strain(reinforcing, group, group.values(materials))

    def fill(
        self,
        state: State,
        materials: Sequence[Mapping[str, float]],
        positive: bool,
        lag: float = 0.0,
        straining: Array | None = None,
        moved: Array | None = None,
        mean_share: float = 1.0,
    ) -> Array:
        """Set the blocks at a state; returns the forces f - lag K v on the nodes in [N], shape (n, 3).

        Args:
            state: Positions.
            materials: Parameters of each body's law by name.
            positive: See fem.assembly.cell_stiffness.
            lag: In [s].
            straining: The velocities v in [m/s], shape (n, 3); None: there are none, nor is anything held.
            moved: See fem.assembly.cell_stiffness.
            mean_share: See there.
        """
        forces, first = np.zeros_like(state.positions), 0
        velocities = np.zeros_like(forces) if straining is None else straining
        for k, (group, compiled) in enumerate(self._groups):
            count = group.cells.size * group.cells.shape[1]
            blocks = self.pairs.blocks[first : first + count]
            first += count
            if compiled is not None and (not positive or (moved is not None and mean_volume_law(group))):
                by = forces[:0] if moved is None else moved
                self._fill_rubber(state.positions, by, velocities, lag, mean_share, compiled, forces, blocks)
                if straining is not None:
                    self._hold(k, state, lag, velocities, forces, blocks)
                continue
            reinforcing = self._reinforcing[k]
            if reinforcing is not None and positive:
                by = forces[:0] if moved is None else moved
                self._fill_strain(state.positions, by, velocities, lag, reinforcing, forces, blocks)
                continue
            p = group.values(materials)
            stiffness = cell_stiffness(
                group, state.positions, p, positive, moved=moved, mean_share=mean_share
            )
            on_nodes = cell_forces(group, state.positions, p)
            on_nodes -= lag * np.einsum("mabij,mbj->mai", stiffness, velocities[group.cells])
            np.add.at(forces, group.cells, on_nodes)
            blocks[:] = stiffness.reshape(-1, 3, 3)
            if straining is not None:
                self._hold(k, state, lag, velocities, forces, blocks)
        return forces

    def _hold(
        self, k: int, state: State, lag: float, velocities: Array, forces: Array, blocks: Array
    ) -> None:
        """Add what cells of a relaxing law hold; see fem.prony."""
        place, chosen = self._places[k]
        held = state.extra.get(held_name(place))
        if held is None:
            return
        group = self._groups[k][0]
        stiffness = held_stiffness(group, held[chosen])
        ahead = (state.positions + lag * velocities)[group.cells]
        np.add.at(forces, group.cells, -(stiffness @ ahead))
        blocks[:, range(3), range(3)] += stiffness.reshape(-1, 1)


def node_pairs(cells: IndexArray) -> IndexArray:
    """All ordered pairs of nodes of each cell (m, a), cell by cell, shape (m a a, 2)."""
    count = cells.shape[1]
    first, second = np.repeat(cells, count, axis=1), np.tile(cells, (1, count))
    return np.stack([first.ravel(), second.ravel()], axis=1)


def _placed(both: IndexArray, nodes: Nodes, local: IndexArray, layout: Plan) -> Pairs:
    """Where the block of each ordered pair of nodes (p, 2) goes; those of held nodes go nowhere."""
    free, region = local[both], nodes.region_number[both]
    place = np.append(layout.position, -1)[free]  # -1 where a node is not free
    upper = np.flatnonzero((free >= 0).all(axis=1) & (place[:, 0] <= place[:, 1]))
    node = free[upper, 0]
    supernode = layout.supernode[node]
    column = layout.panel_columns(supernode, 3 * place[upper, 1])
    in_free = np.stack([upper, layout.row_offset[node] + column, layout.width[supernode]], axis=1)
    mixed = np.flatnonzero((free[:, 0] >= 0) & (region[:, 1] >= 0))
    node = free[mixed, 0]
    supernode = layout.supernode[node]
    beside = (mixed, layout.row_offset[node], layout.width[supernode], supernode, region[mixed, 1])
    inside = np.flatnonzero((region >= 0).all(axis=1))
    return Pairs(
        blocks=np.zeros((len(both), 3, 3)),
        free=in_free,
        beside=np.stack(beside, axis=1).astype(np.int64).reshape(-1, 5),
        regions=np.column_stack([inside, region[inside]]).astype(np.int64).reshape(-1, 3),
    )
