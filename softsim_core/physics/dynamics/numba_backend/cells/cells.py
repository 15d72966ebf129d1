"""Cells of a model for the compiled step, with their own kernels or assembled pair by pair of nodes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy

import numpy as np

from softsim_core.base import Array, IndexArray, unique_pairs
from softsim_core.physics.dynamics.numba_backend import (
    CellPlaces,
    Cells,
    Elements,
    Kinematics,
    Motion,
    Nodes,
    PressedFaces,
    Work,
    jacobians,
    kernel,
    motion_subspace,
    press_faces,
)
from softsim_core.physics.dynamics.numba_backend.cells.batches import (
    add_all_blocks,
    cell_batches,
    cell_places,
    count_folded,
    elimination_order,
    in_elimination_order,
    in_lanes,
    node_pairs,
    scatter,
)
from softsim_core.physics.dynamics.numba_backend.cells.elements import (
    assemble_tetrahedra,
    von_mises_stress,
)
from softsim_core.physics.dynamics.numba_backend.cells.laws import compiled_law, own_values, point_cells, tune
from softsim_core.physics.dynamics.numba_backend.cells.points import (
    CellInputs,
    CellOutputs,
    Memory,
    PointCells,
    hold,
)
from softsim_core.physics.dynamics.numba_backend.cells.rod_cells import (
    fill_rods,
    own_rods,
    rod_cells,
    tune_rods,
)
from softsim_core.physics.dynamics.numba_backend.cells.strain_cells import (
    fill_strain,
    strain_cells,
    tune_strain,
)
from softsim_core.physics.fem import (
    ElementGroup,
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

_NOTHING = np.zeros((0, 1, 3, 3))


class PairedCells:
    """Cells of several groups, assembled pair by pair of nodes or by a kernel of their own.

    Args:
        model: The model.
        groups: Groups of the cells, without cells in a single rigid region.
        nodes: Places of the nodes in the step's arrays.
        local: Number of each free node among the free ones, shape (n,).
        layout: The plan of the factor.
        panels: Panels of the factor; `fill` adds to them.
        surfaces: Nodes of faces that actuators press on, shapes (m, a).
        tetrahedra: Nodes of tetrahedra with kernels of their own, in elimination order, shapes (m, 4).

    Attributes:
        pairs: Stored blocks that the kernels have to add, see batches.
        places_of_tetrahedra: Places of the blocks of `tetrahedra`.
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
        tetrahedra: Sequence[IndexArray] = (),
    ) -> None:
        self._groups = [
            in_elimination_order(group, nodes, local, layout) for group in groups if len(group.cells)
        ]
        self._batches = [cell_batches(group) for group in self._groups]
        self._strain = [strain_cells(group) for group in self._groups]
        self._rods = [rod_cells(group) for group in self._groups]
        kinds = [(group.element.name, group.material.name) for group in model.groups]
        self._memories = []
        for group in self._groups:
            k = kinds.index((group.element.name, group.material.name))
            self._memories.append(
                (step_stress_name(k), np.searchsorted(model.groups[k].numbers, group.numbers))
            )
        self._points: list[PointCells | None] = []
        self._fill_points: list[OneSignature | None] = []
        for group, cells, (_, memory) in zip(self._groups, self._batches, self._memories, strict=True):
            law = compiled_law(group.material)
            self._points.append(None if law is None else point_cells(group, cells, memory))
            self._fill_points.append(None if law is None else OneSignature(law.run))
        coupled = () if model.coupling is None else model.coupling.cells  # cells whose mass is not lumped
        self._surfaces, self._coupled = (
            [_Further(each, *elimination_order(each, nodes, local, layout)) for each in kind]
            for kind in (surfaces, coupled)
        )
        self._pressed = [each.to_arrays() for each in self._surfaces]
        further = [each.cells for each in (*self._surfaces, *self._coupled)]
        all_cells = [group.cells for group in self._groups] + further
        self._upper = [np.triu_indices(each.shape[1]) for each in all_cells]
        places, self.pairs = cell_places([*all_cells, *tetrahedra], nodes, local, layout)
        self._places, self.places_of_tetrahedra = places[: len(all_cells)], places[len(all_cells) :]
        self._panels = panels
        self._no_forces = np.zeros((len(local), 3))
        self._filled = np.zeros(1, np.bool_)  # whether the blocks are not zero; shared by all copies
        self._fill_strain, self._fill_rods = OneSignature(fill_strain), OneSignature(fill_rods)
        self._press_faces = [OneSignature(press_faces) for _ in self._surfaces]
        self._add_all_blocks, self._count_folded = OneSignature(add_all_blocks), OneSignature(count_folded)

    def of_another_copy(self) -> PairedCells:
        """Return the same cells with parameters of their own; the buffers are shared."""
        other = copy(self)
        other._points = [None if each is None else own_values(each) for each in self._points]
        other._strain = [
            None if each is None else each._replace(moduli=each.moduli.copy()) for each in self._strain
        ]
        other._rods = [None if each is None else own_rods(each) for each in self._rods]
        return other

    def __bool__(self) -> bool:
        return bool(self._groups or self._surfaces or self._coupled)

    def tune(self, materials: Sequence[Mapping[str, float]]) -> None:
        """Set the parameters of each body's law by name."""
        for group, points, strain, rods in zip(
            self._groups, self._points, self._strain, self._rods, strict=True
        ):
            if points is not None:
                tune(points, group, group.values(materials))
            if strain is not None:
                tune_strain(strain, group, group.values(materials))
            if rods is not None:
                tune_rods(rods, group, group.values(materials))

    def fill(
        self,
        state: State,
        materials: Sequence[Mapping[str, float]],
        positive: bool,
        scale: float = 1.0,
        lag: float = 0.0,
        straining: Array | None = None,
        moved: Array | None = None,
        mean_share: float = 1.0,
    ) -> Array:
        """Add the stiffness at a state to the panels.

        Return the forces f - lag K v on the nodes in [N], (n, 3).

        Only blocks of free nodes go to the panels; `scatter` adds those of moving regions later. The forces
        must not be modified.

        Args:
            state: Positions.
            materials: Parameters of each body's law by name.
            positive: See fem.cells.cell_stiffness.
            scale: Factor on the stiffness.
            lag: Time lag in [s].
            straining: Velocities v in [m/s], shape (n, 3); None: zero, and no viscoelastic stress is added.
            moved: See fem.cells.cell_stiffness.
            mean_share: See fem.cells.cell_stiffness.
        """
        x, pair_blocks = state.positions, self.pairs.blocks
        if self._filled[0]:
            pair_blocks[:] = 0.0
        self._filled[0] = bool(self._groups)
        if not self._groups:
            return self._no_forces
        forces = np.zeros_like(x)
        velocities = forces.copy() if straining is None else straining
        for k, group in enumerate(self._groups):
            points, fill_points, strain = self._points[k], self._fill_points[k], self._strain[k]
            by = forces[:0] if moved is None else moved
            stress = None if straining is None else state.extra.get(self._memories[k][0])
            if points is not None and fill_points is not None:
                found = moved is not None and mean_volume_law(group) is not None
                fill_points(
                    CellInputs(
                        x, by if found else forces[:0], velocities, _NOTHING if stress is None else stress,
                        positive and not found, lag, mean_share, scale,
                    ),
                    points, CellOutputs(self._places[k], forces, self._panels, pair_blocks), None,
                )  # fmt: skip
                continue
            if strain is not None and positive:
                self._fill_strain(x, by, velocities, lag, scale, strain, forces)
                self._add_all_blocks(strain.blocks, self._places[k], self._panels, pair_blocks)
                continue
            rods = self._rods[k]
            if rods is not None and positive:
                self._fill_rods(x, by, velocities, lag, scale, rods, forces)
                self._add_all_blocks(rods.blocks, self._places[k], self._panels, pair_blocks)
                continue
            p = group.values(materials)
            stiffness = cell_stiffness(group, x, p, positive, moved=moved, mean_share=mean_share)
            on_nodes = cell_forces(group, x, p)
            if stress is not None:
                chosen = step_stress_stiffness(group, stress[self._memories[k][1]])
                stiffness += chosen[..., None, None] * np.eye(3)
                on_nodes -= chosen @ x[group.cells]
            on_nodes -= lag * np.einsum("mabij,mbj->mai", stiffness, velocities[group.cells])
            np.add.at(forces, group.cells, on_nodes)
            first, second = self._upper[k]
            self._add(k, scale * stiffness[:, first, second])
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
        self._filled[0] = True
        first = len(self._groups)
        for k, (surface, of_faces) in enumerate(zip(self._pressed, stiffness, strict=True)):
            vectors = np.ascontiguousarray(of_faces)
            self._press_faces[k](vectors, surface, velocities, float(lag), float(scale), forces)
            self._add_all_blocks(surface.blocks, self._places[first + k], self._panels, self.pairs.blocks)
        return forces

    def couple(self, masses: Sequence[Array], scale: float) -> None:
        """Add masses (m, a, a) in [kg] of the coupled cells times `scale` to the matrix, after `fill`."""
        self._filled[0] = True
        first = len(self._groups) + len(self._surfaces)
        for k, (cells, of_cells) in enumerate(zip(self._coupled, masses, strict=True)):
            self._add(first + k, scale * of_cells[cells.taken][..., None, None] * np.eye(3))

    def _add(self, k: int, of_pairs: Array) -> None:
        """Add blocks (m, a (a + 1) / 2, 3, 3) of the node pairs of a group or surface to the matrix."""
        blocks = np.zeros((*of_pairs.shape[:3], 4))
        blocks[..., :3] = of_pairs
        self._add_all_blocks(blocks, self._places[k], self._panels, self.pairs.blocks)

    def count_inverted(self, positions: Array) -> int:
        """Count the cells of other than four nodes that are inverted at positions (n, 3)."""
        return sum(
            self._count_folded(positions, cells)
            for group, cells in zip(self._groups, self._batches, strict=True)
            if group.fills and group.cells.shape[1] != 4
        )


class _Further:
    """Faces that an actuator presses on, or cells with a consistent mass matrix.

    Args:
        faces: Nodes of the faces, shape (m, a).
        order: Elimination order of the faces, shape (m,).
        inside: Order of the nodes in each face of that order, shape (m, a).

    Attributes:
        cells: Nodes of the faces in that order.
        taken: Index of the blocks (m, a, a, 3, 3) of the given faces that belong to the pairs of `cells`.
    """

    def __init__(self, faces: IndexArray, order: IndexArray, inside: IndexArray) -> None:
        first, second = np.triu_indices(faces.shape[1])
        self.cells = np.take_along_axis(faces[order], inside, axis=1)
        self.taken = order[:, None], inside[:, first], inside[:, second]
        self._inputs = faces, order, inside

    def to_arrays(self) -> PressedFaces:
        """Return the arrays of pressed faces for the kernel."""
        faces, order, inside = (np.ascontiguousarray(each, dtype=np.int64) for each in self._inputs)
        return PressedFaces(faces, order, inside, np.zeros((len(faces), self.taken[1].shape[1], 3, 4)))


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


COMPILED = (("tet4", "corotational"), ("tet4", "corotational_qr"))
"""Elements and laws with kernels of their own: rotations by polar decomposition, and by cell frames."""


@kernel
def assemble_cells(
    x: Array, scale: float, polar: int, frames: int, cells: Cells, nodes: Nodes, work: Work
) -> None:
    """Add the forces of cells with kernels, and `scale` times their stiffness, to panels and reduced.

    PairedCells.fill must have run before: its stored blocks for the reduced coordinates are added, too.
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
        panels: Panels of the factor.
        surfaces: See PairedCells.

    Attributes:
        arrays: Arrays for the kernels.
        paired: Cells whose stiffness is added pair by pair.
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
        by_kind = {(group.element.name, group.material.name): group for group in groups}
        tetrahedra = [
            by_kind.pop(kind, empty_group(element(kind[0]), material(kind[1]))) for kind in COMPILED
        ]
        orders = [elimination_order(group.cells, nodes, local, layout) for group in tetrahedra]
        tetrahedra = [group.part(order) for group, (order, _) in zip(tetrahedra, orders, strict=True)]
        ordered = [
            group.with_node_order(inside) for group, (_, inside) in zip(tetrahedra, orders, strict=True)
        ]
        self._paired_groups = tuple(by_kind.values())
        self.paired = PairedCells(
            model,
            self._paired_groups,
            nodes,
            local,
            layout,
            panels,
            surfaces,
            [group.cells for group in ordered],
        )
        self._kernels = [
            (group, _elements(group, sorted_by_node, places), not group.material.in_cell_axes)
            for group, sorted_by_node, places in zip(
                tetrahedra, ordered, self.paired.places_of_tetrahedra, strict=True
            )
        ]
        self.arrays = self._arrays()

    def _arrays(self) -> Cells:
        polar, frames = (elements for _, elements, _ in self._kernels)
        return Cells(polar, frames, self.paired.pairs)

    def of_another_copy(self) -> PlannedCells:
        """Return the same cells with parameters of their own; the buffers are shared."""
        other = copy(self)
        other._kernels = [
            (group, elements._replace(lame=np.zeros_like(elements.lame)), polar)
            for group, elements, polar in self._kernels
        ]
        other.paired = self.paired.of_another_copy()
        other.arrays = other._arrays()
        return other

    def tune(self, materials: Sequence[Mapping[str, float]]) -> None:
        """Set the parameters of each body's law by name."""
        self.paired.tune(materials)
        for group, elements, _ in self._kernels:
            moduli = np.stack(lame(group.values(materials)), axis=1) * group.volumes[:, None]
            padded = np.zeros((len(elements.lame) * LANES, 2))
            padded[: len(moduli)] = moduli
            elements.lame[:] = padded.reshape(-1, LANES, 2).swapaxes(1, 2)

    def von_mises(self, state: State, materials: Sequence[Mapping[str, float]], work: Work) -> Array:
        """Return the von Mises stress of each cell in [Pa], shape (m,); zero in a single rigid region."""
        result = np.zeros(self._count)
        for group, elements, polar in self._kernels:
            moduli = np.zeros((self._count, 2))
            moduli[group.numbers] = np.stack(lame(group.values(materials)), axis=1)
            von_mises_stress(state.positions, polar, elements, group.numbers, moduli, work, result)
        for group in (each for each in self._paired_groups if each.fills):
            result[group.numbers] = cell_von_mises(group, state.positions, group.values(materials))
        return result


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
    motion: Motion, external: Array, spring: Array, tangent: int, kinematics: Kinematics, cells: Cells,
    nodes: Nodes, work: Work,
) -> None:  # fmt: skip
    """Add the static tangent to panels and reduced, beside the contribution of paired cells.

    `external` are all loads but elastic ones (n, 3); `tangent` is elements.EXACT or CLAMPED.
    """
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
