"""Cells of a model for the compiled step: by kernels where there are some, else in NumPy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy

import numpy as np

from softsim_core.base import Array, IndexArray, unique_pairs
from softsim_core.physics.dynamics.numba_backend.actuator_rows import PressedFaces, add_stiffness, press_faces
from softsim_core.physics.dynamics.numba_backend.batches import (
    CellBatches,
    cell_batches,
    count_folded,
    in_lanes,
)
from softsim_core.physics.dynamics.numba_backend.elements import assemble_tetrahedra, von_mises_stress
from softsim_core.physics.dynamics.numba_backend.kinematics import jacobians, motion_subspace
from softsim_core.physics.dynamics.numba_backend.laws import compiled_law, own_values, point_cells, tune
from softsim_core.physics.dynamics.numba_backend.layout import (
    ActuatorStiffness,
    CellPlaces,
    Cells,
    Elements,
    Motion,
    Nodes,
    StepArrays,
    Work,
    add_all_blocks,
    cell_places,
    elimination_order,
    kernel,
    node_pairs,
    scatter,
)
from softsim_core.physics.dynamics.numba_backend.points import CellInputs, CellOutputs, Memory, hold
from softsim_core.physics.dynamics.numba_backend.thin_cells import (
    RodCells,
    StrainCells,
    fill_rods,
    fill_strain,
    rod_cells,
    strain_cells,
)
from softsim_core.physics.fem import (
    ElementGroup,
    LinearMove,
    cell_forces,
    cell_stiffness,
    cell_von_mises,
    empty_group,
    fading,
    mean_volume_law,
    step_stress_stiffness,
)
from softsim_core.physics.fem.elements import element
from softsim_core.physics.fem.materials import lame, material
from softsim_core.physics.kernels import OneSignature
from softsim_core.physics.linalg import LANES, Plan, inline
from softsim_core.physics.mechanics import FREE, Model, State, step_stress_name

_NO_STRESS = np.zeros((0, 1, 3, 3))


class PlainCells:
    """Cells of a group whose forces and stiffness are computed in NumPy.

    Args:
        group: The cells and the nodes of each, in elimination order.
        memory: Place of each cell in its group's memory, shape (m,); see fem.prony.
    """

    def __init__(self, group: ElementGroup, memory: IndexArray) -> None:
        self.group, self._memory, self._values = group, memory, np.zeros((0, 0))
        self._batches = cell_batches(group)
        self._add_blocks, self._count_folded = OneSignature(add_all_blocks), OneSignature(count_folded)

    def of_another_copy(self) -> PlainCells:
        """Return the same cells with parameters of their own."""
        return copy(self)

    def tune(self, p: Array) -> None:
        """Set the parameters of the law to values p (m, k)."""
        self._values = p

    def fill(self, inputs: CellInputs, into: CellOutputs) -> None:
        """Add forces and stiffness."""
        group, x, first, second = self.group, inputs.x, *np.triu_indices(self.group.cells.shape[1])
        last = LinearMove(x - inputs.moved, inputs.moved) if len(inputs.moved) else None
        stiffness = cell_stiffness(
            group, x, self._values, inputs.positive, last=last, mean_share=inputs.mean_share
        )
        on_nodes = cell_forces(group, x, self._values)
        if len(inputs.step_stress):
            chosen = step_stress_stiffness(group, inputs.step_stress[self._memory])
            stiffness += chosen[..., None, None] * np.eye(3)
            on_nodes -= chosen @ x[group.cells]
        on_nodes -= inputs.lag * np.einsum("mabij,mbj->mai", stiffness, inputs.velocities[group.cells])
        np.add.at(into.forces, group.cells, on_nodes)
        blocks = _four_wide(inputs.scale * stiffness[:, first, second])
        self._add_blocks(blocks, into.places, into.panels, into.pair_blocks)

    def count_inverted(self, positions: Array) -> int:
        """Count the cells that are inverted at positions (n, 3)."""
        return int(self._count_folded(positions, self._batches)) if self.group.fills else 0


class LawCells(PlainCells):
    """Cells of a group whose law has a kernel for its points."""

    def __init__(self, group: ElementGroup, memory: IndexArray) -> None:
        super().__init__(group, memory)
        law = compiled_law(group.material)
        assert law is not None
        self._cells, self._run = point_cells(group, self._batches, memory), OneSignature(law.run)
        self._has_pressure = mean_volume_law(group) is not None

    def of_another_copy(self) -> LawCells:
        """Return the same cells with parameters of their own."""
        other = copy(self)
        other._cells = own_values(self._cells)
        return other

    def tune(self, p: Array) -> None:
        """Set the parameters of the law to values p (m, k)."""
        tune(self._cells, self.group, p)

    def fill(self, inputs: CellInputs, into: CellOutputs) -> None:
        """Add forces and stiffness."""
        if len(inputs.moved):
            has = self._has_pressure
            inputs = inputs._replace(
                moved=inputs.moved if has else inputs.moved[:0], positive=inputs.positive and not has
            )
        self._run(inputs, self._cells, into, None)


class ThinCells(PlainCells):
    """Cells of layers, fibres or rods, whose stiffness without negative parts has a kernel."""

    def __init__(self, group: ElementGroup, memory: IndexArray, cells: StrainCells | RodCells) -> None:
        super().__init__(group, memory)
        self._cells = cells
        self._fill = OneSignature(fill_rods if isinstance(cells, RodCells) else fill_strain)

    def of_another_copy(self) -> ThinCells:
        """Return the same cells with parameters of their own."""
        other = copy(self)
        other._cells = self._cells.of_another_copy()
        return other

    def tune(self, p: Array) -> None:
        """Set the parameters of the law to values p (m, k)."""
        super().tune(p)
        self._cells.tune(self.group, p)

    def fill(self, inputs: CellInputs, into: CellOutputs) -> None:
        """Add forces and stiffness."""
        if inputs.positive:
            self._fill(inputs, self._cells, into)
        else:
            super().fill(inputs, into)


def _cells_of(group: ElementGroup, memory: IndexArray) -> PlainCells:
    """Return the cells of a group, by kernels where there are some."""
    if compiled_law(group.material) is not None:
        return LawCells(group, memory)
    cells = strain_cells(group) or rod_cells(group)
    return PlainCells(group, memory) if cells is None else ThinCells(group, memory, cells)


def _four_wide(blocks: Array) -> Array:
    """Return blocks (m, p, 3, 3) with a fourth number of zero in each row."""
    return np.concatenate([blocks, np.zeros((*blocks.shape[:3], 1))], axis=3)


COMPILED = (("tet4", "corotational"), ("tet4", "corotational_qr"))
"""Elements and laws with kernels of their own: rotations by polar decomposition, and by cell frames."""


@kernel
def assemble_cells(
    x: Array, scale: float, polar: int, frames: int, cells: Cells, nodes: Nodes, work: Work
) -> None:
    """Add the forces of cells with kernels, and `scale` times their stiffness, to panels and reduced.

    PlannedCells.fill must have run before: its stored blocks for the reduced coordinates are added, too.
    `polar` and `frames` are the tangents of the two kinds of Cells, see elements.FROZEN.
    """
    assemble_tetrahedra(x, scale, polar, cells.polar, cells.pairs.blocks, work)
    assemble_tetrahedra(x, scale, frames, cells.frames, cells.pairs.blocks, work)
    scatter(cells.pairs, nodes, work)


class PlannedCells:
    """All deforming cells of a model, with the places of their blocks.

    Args:
        model: The model.
        groups: Its groups without cells in a single rigid region, see `deforming`.
        nodes: Places of the nodes in the step's arrays.
        local: Number of each free node among the free ones, shape (n,).
        layout: The plan of the factor.
        panels: Panels of the factor; `fill` adds to them.
        surfaces: Nodes of faces that actuators press on, shapes (m, a).

    Attributes:
        arrays: Arrays of the kernels of tetrahedra.
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
        def order(cells: IndexArray) -> tuple[IndexArray, IndexArray]:
            return elimination_order(cells, nodes, local, layout)

        self._count = sum(len(group.cells) for group in model.filling)
        by_kind = {(group.element.name, group.material.name): group for group in groups}
        names = [(group.element.name, group.material.name) for group in model.groups]
        self._others: list[tuple[str, PlainCells]] = []
        tetrahedra, ordered, kinds = [], [], []
        for kind in COMPILED:
            group = by_kind.pop(kind, empty_group(element(kind[0]), material(kind[1])))
            cells, inside = order(group.cells)
            tetrahedra.append(group.part(cells))
            ordered.append(tetrahedra[-1].with_node_order(inside))
        for kind, group in by_kind.items():
            if len(group.cells):
                cells, inside = order(group.cells)
                group, k = group.part(cells).with_node_order(inside), names.index(kind)
                memory = np.searchsorted(model.groups[k].numbers, group.numbers)
                self._others.append((step_stress_name(k), _cells_of(group, memory)))
                kinds.append(group.cells)
        surfaces_and_coupled = []
        coupled = () if model.coupling is None else model.coupling.cells  # cells whose mass is not lumped
        for nodes_of in (*surfaces, *coupled):
            cells, inside = order(nodes_of)
            surfaces_and_coupled.append((nodes_of, cells, inside))
            kinds.append(np.take_along_axis(nodes_of[cells], inside, axis=1))
        self._surfaces = [_pressed_faces(*each) for each in surfaces_and_coupled[: len(surfaces)]]
        self._taken = [_upper_blocks(*each) for each in surfaces_and_coupled[len(surfaces) :]]
        kinds += [group.cells for group in ordered]
        self._places, self._pairs = cell_places(kinds, nodes, local, layout)
        self._panels, self._no_forces = panels, np.zeros((len(local), 3))
        self._filled = np.zeros(1, np.bool_)  # whether the blocks are not zero; shared by all copies
        self._kernels = [
            (group, _elements(group, nodes_sorted, places), not group.material.in_cell_axes)
            for group, nodes_sorted, places in zip(tetrahedra, ordered, self._places[-2:], strict=True)
        ]
        self._tetrahedra = [
            CellBatches(each.nodes, each.gradients.reshape(-1, LANES), np.array([len(group.cells)]))
            for group, each, _ in self._kernels
            if len(group.cells)
        ]
        self._count_folded = OneSignature(count_folded)
        self.arrays = self._arrays()
        self._press = [OneSignature(press_faces) for _ in self._surfaces]
        self._add_blocks = OneSignature(add_all_blocks)

    def _arrays(self) -> Cells:
        polar, frames = (elements for _, elements, _ in self._kernels)
        return Cells(polar, frames, self._pairs)

    def of_another_copy(self) -> PlannedCells:
        """Return the same cells with parameters of their own; the buffers are shared."""
        other = copy(self)
        other._kernels = [
            (group, elements._replace(lame=np.zeros_like(elements.lame)), polar)
            for group, elements, polar in self._kernels
        ]
        other._others = [(name, cells.of_another_copy()) for name, cells in self._others]
        other.arrays = other._arrays()
        return other

    def tune(self, materials: Sequence[Mapping[str, float]]) -> None:
        """Set the parameters of each body's law by name."""
        for _, cells in self._others:
            cells.tune(cells.group.values(materials))
        for group, elements, _ in self._kernels:
            elements.lame[:] = _lame_in_lanes(group, materials, group.volumes)

    def fill(
        self,
        state: State,
        positive: bool,
        scale: float = 1.0,
        lag: float = 0.0,
        straining: Array | None = None,
        moved: Array | None = None,
        mean_share: float = 1.0,
    ) -> Array:
        """Add the stiffness of all cells but `tetrahedra` at a state to the panels.

        Return the forces f - lag K v on the nodes in [N], (n, 3).

        Only blocks of free nodes go to the panels; `scatter` adds those of moving regions later. The forces
        must not be modified.

        Args:
            state: Positions.
            positive: See fem.cells.cell_stiffness.
            scale: Factor on the stiffness.
            lag: Time lag in [s].
            straining: Velocities v in [m/s], shape (n, 3); None: zero, and no viscoelastic stress is added.
            moved: Displacement by the last linear solve in [m], (n, 3); see fem.cells.LinearMove.
            mean_share: See fem.cells.cell_stiffness.
        """
        if self._filled[0]:
            self._pairs.blocks[:] = 0.0
        self._filled[0] = bool(self._others)
        if not self._others:
            return self._no_forces
        forces, none = np.zeros_like(state.positions), state.positions[:0]
        velocities = np.zeros_like(forces) if straining is None else straining
        inputs = CellInputs(
            state.positions, none if moved is None else moved, velocities, _NO_STRESS, positive, lag,
            mean_share, scale,
        )  # fmt: skip
        for (name, cells), places in zip(self._others, self._places, strict=False):
            stress = _NO_STRESS if straining is None else state.extra.get(name, _NO_STRESS)
            into = CellOutputs(places, forces, self._panels, self._pairs.blocks)
            cells.fill(inputs._replace(step_stress=stress), into)
        return forces

    def press(
        self, stiffness: Sequence[Array], velocities: Array, lag: float = 0.0, scale: float = 1.0
    ) -> Array:
        """Add the stiffness of pressed surfaces, after `fill`.

        Return the forces -lag K v in [N], shape (n, 3).

        Args:
            stiffness: Of each surface, see ActuatorGroup.surface_stiffness.
            velocities: Velocities in [m/s], shape (n, 3).
            lag: Time lag in [s].
            scale: Factor on the stiffness.
        """
        forces = np.zeros_like(velocities)
        for k, (surface, of_faces) in enumerate(zip(self._surfaces, stiffness, strict=True)):
            vectors = np.ascontiguousarray(of_faces)
            self._press[k](vectors, surface, velocities, float(lag), float(scale), forces)
            self._add(len(self._others) + k, surface.blocks)
        return forces

    def couple(self, masses: Sequence[Array], scale: float) -> None:
        """Add masses (m, a, a) in [kg] of the coupled cells times `scale` to the matrix, after `fill`."""
        first = len(self._others) + len(self._surfaces)
        for k, (taken, of_cells) in enumerate(zip(self._taken, masses, strict=True)):
            self._add(first + k, _four_wide(scale * of_cells[taken][..., None, None] * np.eye(3)))

    def _add(self, k: int, blocks: Array) -> None:
        """Add blocks (m, a (a + 1) / 2, 3, 4) of the k-th kind of cells to the matrix."""
        self._filled[0] = True
        self._add_blocks(blocks, self._places[k], self._panels, self._pairs.blocks)

    def count_inverted(self, positions: Array) -> int:
        """Count the cells that are inverted at positions (n, 3)."""
        others = sum(cells.count_inverted(positions) for _, cells in self._others)
        return others + sum(int(self._count_folded(positions, each)) for each in self._tetrahedra)

    def von_mises(self, state: State, materials: Sequence[Mapping[str, float]], work: Work) -> Array:
        """Return the von Mises stress of each cell in [Pa], shape (m,); zero in a single rigid region."""
        result = np.zeros(self._count)
        for group, elements, polar in self._kernels:
            moduli, stress = _lame_in_lanes(group, materials), np.zeros((len(elements.nodes), LANES))
            von_mises_stress(state.positions, polar, elements, moduli, work, stress)
            result[group.numbers] = stress.ravel()[: len(group.cells)]
        for group in (cells.group for _, cells in self._others if cells.group.fills):
            result[group.numbers] = cell_von_mises(group, state.positions, group.values(materials))
        return result


def _lame_in_lanes(
    group: ElementGroup, materials: Sequence[Mapping[str, float]], factor: Array | float = 1.0
) -> Array:
    """Return the Lame parameters of cells times a factor (m,), zero in lanes without one, (B, 2, LANES)."""
    moduli = np.zeros((2, -(-len(group.cells) // LANES) * LANES))
    moduli[:, : len(group.cells)] = factor * np.array(lame(group.values(materials)))
    return np.ascontiguousarray(moduli.reshape(2, -1, LANES).swapaxes(0, 1))


def _pressed_faces(faces: IndexArray, order: IndexArray, inside: IndexArray) -> PressedFaces:
    """Return the arrays of pressed faces, in elimination order."""
    faces, order, inside = (np.ascontiguousarray(each, np.int64) for each in (faces, order, inside))
    count, a = faces.shape
    return PressedFaces(faces, order, inside, np.zeros((count, a * (a + 1) // 2, 3, 4)))


def _upper_blocks(
    cells: IndexArray, order: IndexArray, inside: IndexArray
) -> tuple[IndexArray, IndexArray, IndexArray]:
    """Return the index of the blocks (m, a, a) of cells for pairs of nodes in elimination order."""
    first, second = np.triu_indices(cells.shape[1])
    return order[:, None], inside[:, first], inside[:, second]


class RelaxingCells:
    """Cells of a group with a compiled relaxing law.

    Args:
        group: The cells, at least one.
    """

    def __init__(self, group: ElementGroup) -> None:
        law = compiled_law(group.material)
        assert law is not None
        self._group = group
        self._cells = point_cells(group, cell_batches(group), np.arange(len(group.cells)))
        self._hold, self._remember = OneSignature(hold), OneSignature(law.run)
        self._tuned = np.zeros(0)

    def hold(self, p: Array, memory: Array, stress: Array, h: float) -> None:
        """Write the stress H that is known in a step of h [s] into `stress`; see fem.prony.step_stress."""
        self._hold(self._memory(p, memory, h), stress)

    def remember(self, p: Array, memory: Array, positions: Array, h: float) -> None:
        """Advance the cells' memory in place after a step of h [s] to node positions (n, 3)."""
        if not np.array_equal(p, self._tuned):
            tune(self._cells, self._group, p, shear_alone=True)
            self._tuned = p
        nothing = positions[:0]
        still = np.zeros_like(positions)
        inputs = CellInputs(positions, nothing, still, np.zeros((0, 1, 3, 3)), False, 0.0, 1.0, 1.0)
        self._remember(inputs, self._cells, None, self._memory(p, memory, h))

    def _memory(self, p: Array, memory: Array, h: float) -> Memory:
        shares, fades, halves = fading(self._group, p, h)
        return Memory(memory, fades, shares * halves)


def deforming(model: Model) -> list[ElementGroup]:
    """Return the groups of a model without cells in a single rigid region."""
    groups = []
    for group in model.groups:
        regions = model.region_of_node[group.cells]
        rigid = (regions == regions[:, :1]).all(axis=1) & (regions[:, 0] != FREE)
        groups.append(group.part(np.flatnonzero(~rigid)))
    return groups


def couplings(
    model: Model, groups: Sequence[ElementGroup], local: IndexArray
) -> tuple[IndexArray, IndexArray]:
    """Return pairs of coupled free nodes, and pairs (free node, reduced coordinate)."""
    pairs = np.concatenate([np.zeros((0, 2), np.int64), *(node_pairs(group.cells) for group in groups)])
    regions = model.region_of_node[pairs]
    edges = local[pairs[(regions == FREE).all(axis=1)]]
    beside = pairs[(regions[:, 0] == FREE) & (regions[:, 1] >= 0)]
    touching = unique_pairs(np.stack([local[beside[:, 0]], model.region_of_node[beside[:, 1]]], axis=1))
    reduced = {
        (node, b) for node, region in touching.tolist() for b in model.regions[region].reduced.tolist()
    }
    return unique_pairs(edges), np.array(sorted(reduced), dtype=np.int64).reshape(-1, 2)


def _elements(group: ElementGroup, ordered: ElementGroup, places: CellPlaces) -> Elements:
    """Return the arrays of tetrahedra of a group, and of the same with their nodes in elimination order."""
    return Elements(
        nodes=in_lanes(ordered.cells),
        corners=in_lanes(group.cells),
        gradients=in_lanes(ordered.gradients.reshape(-1, 12)),
        lame=np.zeros((-(-len(group.cells) // LANES), 2, LANES)),
        places=places,
    )


@kernel
def assemble_tangent(
    motion: Motion, external: Array, spring: Array, tangent: int, cells: Cells, taut: ActuatorStiffness,
    arrays: StepArrays,
) -> None:  # fmt: skip
    """Add the static tangent to panels and reduced, beside the contribution of other cells.

    `external` are all loads but elastic ones (n, 3); `tangent` is elements.EXACT or CLAMPED.
    """
    kinematics, nodes, work = arrays.kinematics, arrays.nodes, arrays.work
    x, first = motion.positions, 6 * len(motion.frame_positions)
    motion_subspace(motion, kinematics, work)
    jacobians(motion, nodes, work)
    work.forces[:, :3] = external
    work.ahead[:] = x
    assemble_cells(x, 1.0, tangent, tangent, cells, nodes, work)
    for f in range(len(nodes.free)):
        for i in range(3):
            place = nodes.row[f] + i * nodes.stride[f] + nodes.column[f] + i
            work.factor.panels[place] += spring[nodes.free[f]]
    for z in range(len(nodes.region)):
        add_region_node(x, z, spring, first, nodes, work)
    for j in range(len(kinematics.stiffness)):
        work.factor.schur[first + j, first + j] += kinematics.stiffness[j]
    still = np.zeros(len(motion.reduced_velocities))
    add_stiffness(taut, np.zeros_like(x), still, nodes, arrays.tree, work)


@inline
def add_region_node(x: Array, z: int, spring: Array, joints: int, nodes: Nodes, work: Work) -> None:
    """Add the soft fixing of region node z, and the work of its load's rotation by frames and joints.

    `joints` is the first reduced coordinate of joints. Of two joints, the outer one rotates the motion that
    the inner one gives the node; the six coordinates of a frame rotate at once, so the mean of both orders
    counts.
    """
    node = nodes.region[z]
    for q in range(nodes.size[z]):
        b = nodes.reduced[z, q]
        for p in range(q + 1):
            a = nodes.reduced[z, p]
            total = turned_work(node, z, a, q, work)
            if b < joints:
                slides = work.angular[a, 0] == 0.0 and work.angular[a, 1] == 0.0 and work.angular[a, 2] == 0.0
                total = 0.0 if slides else 0.5 * (total + turned_work(node, z, b, p, work))
            work.factor.schur[a, b] -= total
            for i in range(3):
                work.factor.schur[a, b] += spring[node] * work.jacobian[z, p, i] * work.jacobian[z, q, i]


@inline
def turned_work(node: int, z: int, a: int, q: int, work: Work) -> float:
    """Return f . (w x u) of region node z: load f, rotation w of coordinate a, motion u by the q-th one."""
    f, w, u = work.forces, work.angular, work.jacobian
    total = f[node, 0] * (w[a, 1] * u[z, q, 2] - w[a, 2] * u[z, q, 1])
    total += f[node, 1] * (w[a, 2] * u[z, q, 0] - w[a, 0] * u[z, q, 2])
    return total + f[node, 2] * (w[a, 0] * u[z, q, 1] - w[a, 1] * u[z, q, 0])  # type: ignore[no-any-return]
