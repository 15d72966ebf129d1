"""Conversion of the mechanical model to the arrays of the compiled step, planned once per model."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np

from softsim_core.base import Array, IndexArray, unique_pairs
from softsim_core.physics.actuation import Actuators, drive_stiffness
from softsim_core.physics.actuation.compiled import CompiledKinds, compiled_kinds
from softsim_core.physics.dynamics.numba_backend.batches import allocate_aligned
from softsim_core.physics.dynamics.numba_backend.cells import PlannedCells, couplings, deforming
from softsim_core.physics.dynamics.numba_backend.layout import (
    Acting,
    ActuatorRows,
    ActuatorStiffness,
    Kinematics,
    Nodes,
    StepArrays,
    Work,
)
from softsim_core.physics.fem import ElementGroup
from softsim_core.physics.linalg import LANES, Plan, Tree, empty_factor, tree_of
from softsim_core.physics.mechanics import FREE, MOVED, Model


class Prepared(NamedTuple):
    """All arrays of the compiled step.

    Attributes:
        cells: The cells of all bodies.
        nodes, kinematics, rows, tree, work: See layout.
        kinds: Actuators that have compiled kernels.
    """

    cells: PlannedCells
    nodes: Nodes
    kinematics: Kinematics
    rows: ActuatorRows
    kinds: CompiledKinds
    tree: Tree
    work: Work

    @property
    def arrays(self) -> StepArrays:
        """Arrays for the kernels, beside those of cells and actuators."""
        return StepArrays(self.kinematics, self.nodes, self.tree, self.work)

    def acting(self, stiffness: ActuatorStiffness) -> Acting | None:
        """Return the actuators of a step in which they add this stiffness; None: there are none."""
        return Acting(self.rows, self.kinds, stiffness) if len(self.rows.joint) else None


LayOut: TypeAlias = Callable[[int, IndexArray, IndexArray, int], Plan]
"""Function that plans the panels.

It takes the number of free nodes, their couplings, their couplings with reduced coordinates, and the number
of reduced coordinates.
"""


def prepare(model: Model, actuators: Actuators, lay_out: LayOut) -> Prepared:
    """Plan the panels and lay out all arrays."""
    kinds, compiled = compiled_kinds(actuators)
    rows = _rows(model, actuators, compiled)
    local = np.full(len(model.rest), -1, dtype=np.int64)
    local[model.free_nodes] = np.arange(len(model.free_nodes))
    groups = deforming(model)
    edges, beside = couplings(model, groups, local)
    taut_edges, taut_beside = _find_taut_couplings(model, actuators, local)
    edges = np.concatenate([edges, taut_edges])
    beside = np.concatenate([beside, _find_actuator_couplings(model, rows, local), taut_beside])
    reduced_size = model.reduced_size + len(actuators)
    layout = lay_out(len(model.free_nodes), edges, beside, reduced_size)
    nodes = _nodes(model, layout, reduced_size)
    work = _work(model, layout, reduced_size)
    return Prepared(
        PlannedCells(model, groups, nodes, local, layout, work.factor.panels, actuators.surfaces()),
        nodes,
        _kinematics(model),
        rows,
        kinds,
        tree_of(layout),
        work,
    )


def of_another_copy(prepared: Prepared, model: Model, actuators: Actuators) -> Prepared:
    """Return the plan of one model for another one that `shares_plan` with it.

    Constant arrays and buffers are shared, so only one of the two may be in a step at a time.
    """
    kinds, compiled = compiled_kinds(actuators)
    return prepared._replace(
        cells=prepared.cells.of_another_copy(),
        nodes=prepared.nodes._replace(mass=model.mass.copy(), diagonal=np.zeros(len(model.rest))),
        kinematics=_kinematics(model),
        rows=_rows(model, actuators, compiled),
        kinds=kinds,
    )


def shares_plan(one: Model, other: Model) -> bool:
    """Return whether two models differ at most in masses, drives and values of actuators."""
    if one is other:
        return True
    same = np.array_equal
    if len(one.groups) != len(other.groups) or len(one.regions) != len(other.regions):
        return False
    return (
        same(one.rest, other.rest)
        and same(one.region_of_node, other.region_of_node)
        and one.frame_names == other.frame_names
        and [each.name for each in one.joints] == [each.name for each in other.joints]
        and (one.coupling is None) == (other.coupling is None)
        and all(
            (a is b or type(a) is type(b) is ElementGroup)
            and a.element is b.element
            and a.material is b.material
            and same(a.cells, b.cells)
            and same(a.gradients, b.gradients)
            and same(a.weights, b.weights)
            and same(a.parameter_set, b.parameter_set)
            for a, b in zip(one.groups, other.groups, strict=True)
        )
        and all(
            (a.frame, a.joint) == (b.frame, b.joint)
            and same(a.nodes, b.nodes)
            and same(a.local, b.local)
            and same(a.reduced, b.reduced)
            for a, b in zip(one.regions, other.regions, strict=True)
        )
    )


def _find_actuator_couplings(model: Model, rows: ActuatorRows, local: IndexArray) -> IndexArray:
    """Return pairs (free node, reduced coordinate of the actuator with that node in its row)."""
    owner = np.repeat(np.arange(len(rows.value)), np.diff(rows.start))
    on_node = rows.place < len(model.rest)
    pairs = np.stack([local[rows.place[on_node]], model.reduced_size + owner[on_node]], axis=1)
    return unique_pairs(pairs[pairs[:, 0] >= 0])


def _find_taut_couplings(
    model: Model, actuators: Actuators, local: IndexArray
) -> tuple[IndexArray, IndexArray]:
    """Return the couplings by taut actuators: pairs of free nodes, and (free node, reduced coordinate)."""
    edges, beside = [np.zeros((0, 2), np.int64)], [np.zeros((0, 2), np.int64)]
    rest = model.rest_state()
    if MOVED in rest.extra and len(actuators):
        ones = np.ones(len(actuators))
        rows, _ = actuators.geometric_stiffness(model, rest, ones, without_surfaces=True)
        for r in range(rows.height):
            places = rows.place[rows.start[r] : rows.start[r + 1]]
            nodes = places[places < len(model.rest)]
            regions = model.region_of_node[nodes]
            free = np.unique(local[nodes[regions == FREE]])
            reduced = [model.regions[region].reduced for region in np.unique(regions[regions >= 0])]
            border = np.concatenate([places[places >= len(model.rest)] - len(model.rest), *reduced])
            edges.append(np.stack(np.meshgrid(free, free), axis=-1).reshape(-1, 2))
            beside.append(np.stack(np.meshgrid(free, border), axis=-1).reshape(-1, 2))
    return np.concatenate(edges), np.concatenate(beside)


def _rows(model: Model, actuators: Actuators, compiled: int) -> ActuatorRows:
    """Return the rows of actuators for the kernels."""
    constraints, count = actuators.constraints, len(actuators)
    return ActuatorRows(
        joint=constraints.joint,
        start=constraints.start,
        place=constraints.place,
        command=np.zeros(count),
        compliance=np.zeros(count),
        compiled=np.array([compiled]),
        coefficient=np.zeros((len(constraints.place), 3)),
        value=np.zeros(count),
        before=np.zeros(count),
        violation=np.zeros(count),
        multiplier=np.zeros(count),
        response=np.zeros((count, count)),
    )


def _nodes(model: Model, layout: Plan, reduced_size: int) -> Nodes:
    free = model.free_nodes
    region_nodes = np.concatenate([np.zeros(0, np.int64)] + [region.nodes for region in model.regions])
    reduced = np.zeros((len(region_nodes), _widest(model)), dtype=np.int64)
    size = np.zeros(len(region_nodes), dtype=np.int64)
    region_of = np.repeat(np.arange(len(model.regions)), [len(region.nodes) for region in model.regions])
    for z, region in enumerate(region_of):
        unknowns = model.regions[region].reduced
        reduced[z, : len(unknowns)], size[z] = unknowns, len(unknowns)
    number = np.full(len(model.rest), -1, dtype=np.int64)
    number[region_nodes] = np.arange(len(region_nodes))
    first = layout.first_column[layout.supernode]
    first_unknown, supernode = np.full((2, len(model.rest)), -1, dtype=np.int64)
    first_unknown[free], supernode[free] = 3 * layout.position, layout.supernode
    return Nodes(
        free=free,
        row=layout.row_offset,
        stride=layout.width[layout.supernode],
        column=3 * layout.position - first,
        right=(layout.later + layout.side - 1)[layout.supernode],
        unknown=3 * layout.position,
        region=region_nodes,
        region_of=region_of.astype(np.int64),
        local=np.concatenate([np.zeros((0, 3))] + [region.local for region in model.regions]),
        reduced=reduced,
        size=size,
        region_number=number,
        reduced_column=_reduced_columns(layout, reduced_size),
        first_unknown=first_unknown,
        supernode=supernode,
        mass=model.mass.copy(),
        diagonal=np.zeros(len(model.rest)),
    )


def _widest(model: Model) -> int:
    """Return the largest number of reduced coordinates that move one node."""
    return max((len(region.reduced) for region in model.regions), default=1)


def _kinematics(model: Model) -> Kinematics:
    joints = model.joints

    def stack(rows: list[Array], *shape: int) -> Array:
        return np.array(rows, dtype=float).reshape(-1, *shape)

    return Kinematics(
        base_rotation=stack([joint.base_rotation for joint in joints], 3, 3),
        axis=stack([joint.axis if joint.moves_frame else 0.0 * joint.axis for joint in joints], 3),
        slide=stack([joint.slide_axis for joint in joints], 3),
        revolute=np.array([joint.revolute for joint in joints], dtype=np.bool_),
        stiffness=drive_stiffness(model),
        inertia=np.array([joint.inertia for joint in joints], dtype=float),
        parent=np.array([joint.parent for joint in joints], dtype=np.int64),
        rest=np.array([joint.rest for joint in joints], dtype=float),
        rest_rotation=stack([joint.frame(joint.rest, joint.base_position, 0.0)[1] for joint in joints], 3, 3),
        regions=np.array([(region.frame, region.joint) for region in model.regions], dtype=np.int64).reshape(
            -1, 2
        ),
    )


def _work(model: Model, layout: Plan, reduced_size: int) -> Work:
    size, nodes, joints = model.reduced_size, len(model.rest), len(model.joints)
    in_regions = sum(len(region.nodes) for region in model.regions)
    return Work(
        factor=empty_factor(layout, reduced_size),
        scratch=np.zeros((reduced_size, reduced_size + 1)),
        forces=np.zeros((nodes, 4)),
        jacobian=np.zeros((in_regions, _widest(model), 3)),
        angular=np.zeros((size, 3)),
        linear=np.zeros((size, 3)),
        origin=np.zeros((size, 3)),
        base_origins=np.zeros((joints, 3)),
        base_rotations=np.zeros((joints, 3, 3)),
        joint_origins=np.zeros((joints, 3)),
        joint_rotations=np.zeros((joints, 3, 3)),
        region_origins=np.zeros((len(model.regions), 3)),
        region_rotations=np.zeros((len(model.regions), 3, 3)),
        ahead=np.zeros((nodes, 3)),
        deformation=allocate_aligned((9, LANES)),
        rotations=allocate_aligned((9, LANES)),
        turned=allocate_aligned((12, LANES)),
        blocks=allocate_aligned((30, LANES, 4)),
    )


def _reduced_columns(layout: Plan, reduced_size: int) -> IndexArray:
    """Return the panel column of each reduced coordinate in each supernode, else -1, shape (s, b + c)."""
    first, size = 3 * len(layout.position), len(layout.columns)
    supernodes = np.repeat(np.arange(size), reduced_size)
    unknowns = np.tile(first + np.arange(reduced_size), size)
    return layout.panel_columns(supernodes, unknowns).reshape(size, reduced_size)
