"""What is added pair by pair of nodes: compiled laws, and faces, by kernels; other cells in NumPy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy

import numpy as np

from softsim_core.arrays import Array, IndexArray
from softsim_core.dynamics.numba_backend.batches import cell_batches, count_folded
from softsim_core.dynamics.numba_backend.laws import compiled_law, own_values, point_cells, tune
from softsim_core.dynamics.numba_backend.layout import Nodes
from softsim_core.dynamics.numba_backend.point_cells import Given, Into, PointCells
from softsim_core.dynamics.numba_backend.pressing import PressedFaces, press_faces
from softsim_core.dynamics.numba_backend.rod_cells import fill_rods, own_rods, rod_cells, tune_rods
from softsim_core.dynamics.numba_backend.scatter import (
    add_all_blocks,
    cell_places,
    elimination_order,
    in_elimination_order,
)
from softsim_core.dynamics.numba_backend.strain_cells import fill_strain, strain_cells, tune_strain
from softsim_core.fem.cells import cell_forces, cell_stiffness, mean_volume_law
from softsim_core.fem.group import ElementGroup
from softsim_core.fem.prony import held_stiffness
from softsim_core.kernels import OneSignature
from softsim_core.linalg.symbolic import Plan
from softsim_core.mechanics.state import State, held_name

_NOTHING = np.zeros((0, 1, 3, 3))


class PairedCells:
    """See the module.

    Args:
        groups: Their groups, without cells that are rigid as a whole.
        whole: All groups of the model, with them.
        nodes: Places of the nodes in the step's arrays.
        local: Number of each free node among the free ones, shape (n,).
        layout: The plan of the factor.
        panels: Of the factor; `fill` adds to them.
        surfaces: Nodes of faces that actuators press on, shapes (m, a).
        coupled: Nodes of cells whose mass is not lumped, shapes (m, a).

    Attributes:
        pairs: What the kernels have to add of their blocks, see `scatter`.
    """

    def __init__(
        self,
        groups: Sequence[ElementGroup],
        whole: Sequence[ElementGroup],
        nodes: Nodes,
        local: IndexArray,
        layout: Plan,
        panels: Array,
        surfaces: Sequence[IndexArray] = (),
        coupled: Sequence[IndexArray] = (),
    ) -> None:
        self._groups = [
            in_elimination_order(group, nodes, local, layout) for group in groups if len(group.cells)
        ]
        self._batches = [cell_batches(group) for group in self._groups]
        self._strain = [strain_cells(group) for group in self._groups]
        self._rods = [rod_cells(group) for group in self._groups]
        kinds = [(group.element.name, group.material.name) for group in whole]
        self._memories = []
        for group in self._groups:
            k = kinds.index((group.element.name, group.material.name))
            self._memories.append((held_name(k), np.searchsorted(whole[k].numbers, group.numbers)))
        self._points: list[PointCells | None] = []
        self._fill_points: list[OneSignature | None] = []
        for group, cells, (_, memory) in zip(self._groups, self._batches, self._memories, strict=True):
            law = compiled_law(group.material)
            self._points.append(None if law is None else point_cells(group, cells, memory))
            self._fill_points.append(None if law is None else OneSignature(law.fill))
        self._surfaces, self._coupled = (
            [_Further(each, *elimination_order(each, nodes, local, layout)) for each in kind]
            for kind in (surfaces, coupled)
        )
        self._pressed = [each.pressed() for each in self._surfaces]
        further = [each.cells for each in (*self._surfaces, *self._coupled)]
        all_cells = [group.cells for group in self._groups] + further
        self._upper = [np.triu_indices(each.shape[1]) for each in all_cells]
        self._places, self.pairs = cell_places(all_cells, nodes, local, layout)
        self._panels = panels
        self._no_forces = np.zeros((len(local), 3))
        self._filled = np.zeros(1, np.bool_)  # whether the blocks hold anything; of all copies, as they are
        self._fill_strain, self._fill_rods = OneSignature(fill_strain), OneSignature(fill_rods)
        self._press_faces = [OneSignature(press_faces) for _ in self._surfaces]
        self._add_all_blocks, self._count_folded = OneSignature(add_all_blocks), OneSignature(count_folded)

    def of_another_copy(self) -> PairedCells:
        """The same cells for parameters of their own; the room to work in is this one's."""
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
        """Take over the parameters of each body's law by name."""
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
        """Add to the panels at a state; returns the forces f - lag K v on the nodes in [N], shape (n, 3).

        Only blocks of free nodes go to the panels; what moving regions take `scatter` adds later. The forces
        are for reading.

        Args:
            state: Positions.
            materials: Parameters of each body's law by name.
            positive: See fem.cells.cell_stiffness.
            scale: What the stiffness is multiplied by.
            lag: In [s].
            straining: The velocities v in [m/s], shape (n, 3); None: there are none, nor is anything held.
            moved: See fem.cells.cell_stiffness.
            mean_share: See there.
        """
        x, kept = state.positions, self.pairs.blocks
        if self._filled[0]:
            kept[:] = 0.0
        self._filled[0] = bool(self._groups)
        if not self._groups:
            return self._no_forces
        forces = np.zeros_like(x)
        velocities = forces.copy() if straining is None else straining
        for k, group in enumerate(self._groups):
            points, fill_points, strain = self._points[k], self._fill_points[k], self._strain[k]
            by = forces[:0] if moved is None else moved
            held = None if straining is None else state.extra.get(self._memories[k][0])
            if points is not None and fill_points is not None:
                found = moved is not None and mean_volume_law(group) is not None
                fill_points(
                    Given(
                        x, by if found else forces[:0], velocities, _NOTHING if held is None else held,
                        positive and not found, lag, mean_share, scale,
                    ),
                    points, Into(self._places[k], forces, self._panels, kept),
                )  # fmt: skip
                continue
            if strain is not None and positive:
                self._fill_strain(x, by, velocities, lag, scale, strain, forces)
                self._add_all_blocks(strain.blocks, self._places[k], self._panels, kept)
                continue
            rods = self._rods[k]
            if rods is not None and positive:
                self._fill_rods(x, by, velocities, lag, scale, rods, forces)
                self._add_all_blocks(rods.blocks, self._places[k], self._panels, kept)
                continue
            p = group.values(materials)
            stiffness = cell_stiffness(group, x, p, positive, moved=moved, mean_share=mean_share)
            on_nodes = cell_forces(group, x, p)
            if held is not None:
                chosen = held_stiffness(group, held[self._memories[k][1]])
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
        """Add what actuators press on, after `fill`; returns the forces -lag K v in [N], shape (n, 3).

        Args:
            stiffness: Of each surface, see ActuatorGroup.surface_stiffness.
            velocities: In [m/s], shape (n, 3).
            lag: In [s].
            scale: What the stiffness is multiplied by.
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
        """Add blocks (m, a (a + 1) / 2, 3, 3) of the pairs of nodes of a group or surface to the matrix."""
        blocks = np.zeros((*of_pairs.shape[:3], 4))
        blocks[..., :3] = of_pairs
        self._add_all_blocks(blocks, self._places[k], self._panels, self.pairs.blocks)

    def folded(self, positions: Array) -> int:
        """How many cells of more than four nodes are inside out at positions (n, 3)."""
        return sum(
            self._count_folded(positions, cells)
            for group, cells in zip(self._groups, self._batches, strict=True)
            if group.fills and group.cells.shape[1] != 4
        )


class _Further:
    """Faces that an actuator presses on, or cells whose mass is not lumped.

    Args:
        faces: Their nodes, shape (m, a).
        order: How they are eliminated, shape (m,).
        inside: And then the nodes of each, shape (m, a).

    Attributes:
        cells: Their nodes in that order.
        taken: What of blocks (m, a, a, 3, 3) of the faces as given belongs to the pairs of `cells`.
    """

    def __init__(self, faces: IndexArray, order: IndexArray, inside: IndexArray) -> None:
        first, second = np.triu_indices(faces.shape[1])
        self.cells = np.take_along_axis(faces[order], inside, axis=1)
        self.taken = order[:, None], inside[:, first], inside[:, second]
        self._given = faces, order, inside

    def pressed(self) -> PressedFaces:
        """What the kernel needs of faces."""
        faces, order, inside = (np.ascontiguousarray(each, dtype=np.int64) for each in self._given)
        return PressedFaces(faces, order, inside, np.zeros((len(faces), self.taken[1].shape[1], 3, 4)))
