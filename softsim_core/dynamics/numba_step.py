"""The fast time step: compiled assembly into the panels of a supernodal multifrontal Cholesky factorisation.

One step is three compiled calls (assemble, factor, finish); everything that does not change is planned once. It computes
what scipy_step computes, to rounding.
"""

from __future__ import annotations

from time import perf_counter
from typing import NamedTuple

import numpy as np

from softsim_core.arrays import Array, IndexArray
from softsim_core.dynamics import kernels as k
from softsim_core.dynamics import kinematics_kernels as kin
from softsim_core.dynamics.simd import LANES, ROWS
from softsim_core.dynamics.stepper import Inputs, Parameters, joint_stiffness
from softsim_core.dynamics.symbolic import Plan, plan
from softsim_core.mechanics.model import FREE, Model
from softsim_core.mechanics.state import State


class Elements(NamedTuple):
    """Elements for the kernels, nodes in elimination order (free ones first); see kernels.assemble_*."""

    nodes: IndexArray
    corners: IndexArray
    gradients: Array
    lame: Array
    starts: IndexArray
    strides: IndexArray


class Nodes(NamedTuple):
    """Free nodes (panel rows) and zone nodes (frames they follow) for the kernels."""

    free: IndexArray
    row_offset: IndexArray
    stride: IndexArray
    column: IndexArray
    right: IndexArray
    unknown: IndexArray
    zone: IndexArray
    zone_of: IndexArray
    local: Array
    border: IndexArray
    size: IndexArray
    index: IndexArray


class Joints(NamedTuple):
    """Joint geometry for the kernels."""

    base_position: Array
    base_rotation: Array
    axis: Array
    slide: Array
    revolute: Array


class Tree(NamedTuple):
    """The elimination plan for the kernels."""

    columns: IndexArray
    later: IndexArray
    side: IndexArray
    width: IndexArray
    panel: IndexArray
    update: IndexArray
    first_child: IndexArray
    children: IndexArray
    first_run: IndexArray
    runs: IndexArray
    first_row: IndexArray
    row_index: IndexArray
    first_column: IndexArray


class Work(NamedTuple):
    """Storage the kernels write."""

    panels: Array
    stack: Array
    schur: Array
    scratch: Array
    solution: Array
    gathered: Array
    forces: Array
    nodal: Array
    jacobian: Array
    angular: Array
    linear: Array
    origin: Array
    zone_origins: Array
    zone_rotations: Array


@k.kernel
def assemble(  # type: ignore[no-untyped-def]
    x,
    v,
    external,
    h,
    lag,
    rayleigh_mass,
    polar,
    border,
    joints,
    free_elements,
    mixed_elements,
    counts,
    bpos,
    nodes,
    work,
):
    """Forces, matrix and right-hand side of the step, into `work`."""
    kin.screws(border, joints, work.angular, work.linear, work.origin)
    kin.jacobians(
        x, nodes.zone, nodes.border, nodes.size, work.angular, work.linear, work.origin, work.jacobian
    )
    work.panels[:] = 0.0
    work.schur[:] = 0.0
    work.forces[:] = external
    scale = h * lag
    k.assemble_free(x, v, lag, scale, polar, free_elements, work.panels, work.forces)
    k.assemble_mixed(
        x, v, lag, scale, polar, mixed_elements, counts, nodes.index, work.jacobian, nodes.border, nodes.size, bpos,
        work.panels, work.schur, work.forces,
    )  # fmt: skip
    k.assemble_nodes(
        v, h, rayleigh_mass, work.nodal, nodes.free, nodes.row_offset, nodes.stride, nodes.column,
        nodes.right, nodes.zone,
        work.jacobian, nodes.border, nodes.size, work.panels, work.schur, work.forces,
    )  # fmt: skip


@k.kernel
def factor(tree, work):  # type: ignore[no-untyped-def]
    """Factor and solve forward."""
    k.factor(tree, work.panels, work.stack, work.schur)


@k.kernel
def finish(  # type: ignore[no-untyped-def]
    x,
    v,
    velocities,
    efforts,
    h,
    lag,
    stiffness,
    inertia,
    targets,
    base_shift,
    border,
    joints,
    zones,
    tree,
    nodes,
    work,
):
    """Solve the border and backward, advance positions and velocities, and report the joint efforts."""
    _, _, joint_positions, shift = border
    size, count = len(velocities), len(joint_positions)
    first = size - count
    known = np.zeros(size, dtype=np.bool_)
    change = work.solution[3 * len(nodes.free) :]
    for j in range(count):
        b = first + j
        if stiffness[j] == 0.0:
            known[b] = True
            change[b] = (targets[j] - joint_positions[j]) / h - velocities[b]
        else:
            work.schur[b, b] += inertia[j] + h * lag * stiffness[j]
            work.schur[b, size] += h * stiffness[j] * (targets[j] - joint_positions[j] - lag * velocities[b])
    k.solve_border(work.schur, known, change, work.scratch)
    k.solve_backward(tree, work.panels, work.solution, work.gathered)
    for f in range(len(nodes.free)):
        node, place = nodes.free[f], nodes.unknown[f]
        for i in range(3):
            v[node, i] += work.solution[place + i]
            x[node, i] += h * v[node, i]
    for j in range(count):
        b = first + j
        if known[b]:
            impulse = inertia[j] * change[b] - work.schur[b, size]
            for a in range(size):
                impulse += (work.schur[a, b] if a < b else work.schur[b, a]) * change[a]
            efforts[j] = impulse / h
    for b in range(size):
        velocities[b] += change[b]
    kin.advance_frames(h, border, velocities)
    shift[0] = base_shift
    for j in range(count):
        if known[first + j]:
            joint_positions[j] = targets[j]
        else:
            efforts[j] = stiffness[j] * (targets[j] - joint_positions[j])
    kin.zone_frames(border, joints, zones, work.zone_origins, work.zone_rotations)
    kin.place_zone_nodes(x, nodes.zone, nodes.zone_of, nodes.local, work.zone_origins, work.zone_rotations)
    kin.screws(border, joints, work.angular, work.linear, work.origin)
    kin.jacobians(
        x, nodes.zone, nodes.border, nodes.size, work.angular, work.linear, work.origin, work.jacobian
    )
    kin.zone_velocities(v, velocities, nodes.zone, nodes.border, nodes.size, work.jacobian)


class NumbaStepper:
    """Plan once, then step in three compiled calls."""

    name = "numba"

    def __init__(self, model: Model) -> None:
        self.model = model
        self.stage_times: dict[str, float] = {}
        local = np.full(len(model.rest), -1, dtype=np.int64)
        local[model.free_nodes] = np.arange(len(model.free_nodes))
        elements, counts = _ordered_elements(model)
        layout = plan(
            len(model.free_nodes), *_couplings(model, elements, counts, local), model.border_size, LANES, ROWS
        )
        self._nodes = _nodes(model, layout)
        self._joints = Joints(
            *(
                np.array([getattr(joint, name) for joint in model.joints], dtype=float).reshape(-1, *shape)
                for name, shape in (
                    ("base_position", (3,)), ("base_rotation", (3, 3)), ("axis", (3,)), ("slide_axis", (3,)),
                )
            ),
            np.array([joint.revolute for joint in model.joints], dtype=np.bool_),
        )  # fmt: skip
        self._zones = np.array([(zone.frame, zone.joint) for zone in model.zones], dtype=np.int64).reshape(
            -1, 2
        )
        first_column = np.concatenate([[0], np.cumsum(layout.columns)[:-1]]).astype(np.int64)
        self._tree = Tree(
            layout.columns, layout.later, layout.side, layout.width, layout.panel, layout.update, layout.first_child, layout.children,
            layout.first_run, layout.runs, layout.first_row, layout.row_index, first_column[: len(layout.columns)],
        )  # fmt: skip
        self._work = _work(model, layout)
        self._bpos = _border_columns(layout, model)
        self._element_ids, self._free_elements, self._mixed_elements, self._counts = _slots(
            model, elements, counts, local, layout
        )
        self._stiffness = joint_stiffness(model)
        self._inertia = np.array([joint.inertia for joint in model.joints], dtype=float)
        self._polar = model.law == "polar"
        self._tuned: tuple[bytes, float, float] | None = None

    def step(self, state: State, inputs: Inputs, parameters: Parameters) -> None:
        """See Stepper."""
        model, work = self.model, self._work
        lag = model.dt + parameters.rayleigh_stiffness
        self._tune(parameters, lag)
        started = perf_counter()
        border = (state.frame_positions, state.frame_rotations, state.joint_positions, state.base_shift)
        external = inputs.forces + self._weight
        if self._soft:
            reach = state.positions + lag * state.velocities - model.rest
            external -= model.spring[:, None] * reach
        assemble(
            state.positions, state.velocities, external, model.dt, lag, parameters.rayleigh_mass, self._polar, border,
            self._joints, self._free_elements, self._mixed_elements, self._counts, self._bpos, self._nodes, work,
        )  # fmt: skip
        assembled = perf_counter()
        factor(self._tree, work)
        factored = perf_counter()
        finish(
            state.positions, state.velocities, state.border_velocities, state.joint_efforts, model.dt, lag,
            self._stiffness, self._inertia, inputs.targets, inputs.base_shift, border, self._joints, self._zones,
            self._tree, self._nodes, work,
        )  # fmt: skip
        finished = perf_counter()
        self.stage_times = {
            "assemble": 1e3 * (assembled - started),
            "factor": 1e3 * (factored - assembled),
            "solve": 1e3 * (finished - factored),
        }

    def _tune(self, parameters: Parameters, lag: float) -> None:
        """Take over tunable parameters when they have changed."""
        tuned = (parameters.lame.tobytes(), lag, parameters.rayleigh_mass)
        if tuned == self._tuned:
            return
        self._tuned = tuned
        model = self.model
        lame = parameters.lame[model.element_body] * model.elements.volumes[:, None]
        for ids, elements in zip(self._element_ids, (self._free_elements, self._mixed_elements), strict=True):
            elements.lame[:] = lame[ids]
        inertia = (1.0 + model.dt * parameters.rayleigh_mass) * model.mass
        self._work.nodal[:, 0] = model.mass
        self._work.nodal[:, 1] = inertia + model.dt * lag * model.spring
        self._weight = model.mass[:, None] * model.gravity
        self._soft = bool(model.spring.any())


def _ordered_elements(model: Model) -> tuple[IndexArray, IndexArray]:
    """Elements that deform, and how many of their nodes are free, and in moving zones, shapes (e,), (e, 2)."""
    zones = model.zone_of_node[model.elements.nodes]
    rigid = (zones == zones[:, :1]).all(axis=1) & (zones[:, 0] != FREE)
    chosen = np.flatnonzero(~rigid)
    counts = np.stack([(zones == FREE).sum(axis=1), (zones >= 0).sum(axis=1)], axis=1)[chosen]
    return chosen, counts


def _couplings(
    model: Model, chosen: IndexArray, counts: IndexArray, local: IndexArray
) -> tuple[IndexArray, IndexArray]:
    """Pairs of coupled free nodes, and pairs (free node, border unknown)."""
    nodes = model.elements.nodes[chosen]
    pairs = np.stack([np.repeat(nodes, 4, axis=1).ravel(), np.tile(nodes, (1, 4)).ravel()], axis=1)
    zones = model.zone_of_node[pairs]
    edges = local[pairs[(zones == FREE).all(axis=1)]]
    beside = pairs[(zones[:, 0] == FREE) & (zones[:, 1] >= 0)]
    border = {
        (node, unknown)
        for node, zone in set(
            zip(local[beside[:, 0]].tolist(), model.zone_of_node[beside[:, 1]].tolist(), strict=True)
        )
        for unknown in model.zones[zone].border.tolist()
    }
    unique = np.unique(edges, axis=0) if len(edges) else np.zeros((0, 2), dtype=np.int64)
    return unique, np.array(sorted(border), dtype=np.int64).reshape(-1, 2)


def _nodes(model: Model, layout: Plan) -> Nodes:
    free = model.free_nodes
    zone_nodes = np.concatenate([np.zeros(0, np.int64)] + [zone.nodes for zone in model.zones])
    border = np.zeros((len(zone_nodes), 6), dtype=np.int64)
    size = np.zeros(len(zone_nodes), dtype=np.int64)
    zone_of = np.repeat(np.arange(len(model.zones)), [len(zone.nodes) for zone in model.zones])
    for z, zone in enumerate(zone_of):
        unknowns = model.zones[zone].border
        border[z, : len(unknowns)], size[z] = unknowns, len(unknowns)
    index = np.full(len(model.rest), -1, dtype=np.int64)
    index[zone_nodes] = np.arange(len(zone_nodes))
    first = np.concatenate([[0], np.cumsum(layout.columns)])[layout.supernode]
    return Nodes(
        free=free,
        row_offset=layout.row_offset,
        stride=layout.width[layout.supernode],
        column=3 * layout.position - first,
        right=(layout.later + layout.side - 1)[layout.supernode],
        unknown=3 * layout.position,
        zone=zone_nodes,
        zone_of=zone_of.astype(np.int64),
        local=np.concatenate([np.zeros((0, 3))] + [zone.local for zone in model.zones]),
        border=border,
        size=size,
        index=index,
    )


def _work(model: Model, layout: Plan) -> Work:
    size, nodes = model.border_size, len(model.rest)
    in_zones = sum(len(zone.nodes) for zone in model.zones)
    return Work(
        panels=np.zeros(layout.panel[-1]),
        stack=np.zeros(layout.stack_size),
        schur=np.zeros((size, size + 1)),
        scratch=np.zeros((size, size)),
        solution=np.zeros(3 * len(layout.position) + size),
        gathered=np.zeros(int(layout.width.max(initial=1))),
        forces=np.zeros((nodes, 3)),
        nodal=np.zeros((nodes, 2)),
        jacobian=np.zeros((in_zones, 6, 3)),
        angular=np.zeros((size, 3)),
        linear=np.zeros((size, 3)),
        origin=np.zeros((size, 3)),
        zone_origins=np.zeros((len(model.zones), 3)),
        zone_rotations=np.zeros((len(model.zones), 3, 3)),
    )


def _border_columns(layout: Plan, model: Model) -> IndexArray:
    """Panel column of each border unknown in each supernode, -1 where absent, shape (s, b)."""
    first = 3 * len(layout.position)
    table = [[places.get(first + b, -1) for b in range(model.border_size)] for places in layout.column_of]
    return np.array(table, dtype=np.int64).reshape(len(layout.column_of), model.border_size)


def _slots(
    model: Model, chosen: IndexArray, counts: IndexArray, local: IndexArray, layout: Plan
) -> tuple[tuple[IndexArray, IndexArray], Elements, Elements, IndexArray]:
    """Elements in elimination order with their places in the panels: all-free ones, then mixed ones with counts."""
    nodes = model.elements.nodes[chosen]
    zones = model.zone_of_node[nodes]
    late = len(layout.position)
    rank = np.where(
        zones == FREE, layout.position[np.where(zones == FREE, local[nodes], 0)] if late else 0, late
    )
    rank = np.where(zones >= 0, late + 1, rank)
    rank = np.where((zones != FREE) & (zones < 0), late + 2, rank)
    inside = np.argsort(rank, axis=1, kind="stable")
    order = np.argsort(rank.min(axis=1), kind="stable")
    inside, chosen, counts, nodes = inside[order], chosen[order], counts[order], nodes[order]
    sorted_nodes = np.take_along_axis(nodes, inside, axis=1)
    gradients = np.take_along_axis(model.elements.gradients[chosen], inside[:, :, None], axis=1)
    starts = np.zeros((len(chosen), 18), dtype=np.int64)
    strides = np.zeros((len(chosen), 4), dtype=np.int64)
    for e in range(len(chosen)):
        free = [int(local[node]) for node in sorted_nodes[e, : counts[e, 0]]]
        pair = 0
        for a, node in enumerate(free):
            s = layout.supernode[node]
            strides[e, a] = layout.width[s]
            starts[e, 10 + a], starts[e, 14 + a] = layout.row_offset[node], s
            for other in free[a:]:
                starts[e, pair] = (
                    layout.row_offset[node] + layout.column_of[s][3 * int(layout.position[other])]
                )
                pair += 1

    def part(mask: Array) -> Elements:
        return Elements(
            nodes=np.ascontiguousarray(sorted_nodes[mask]),
            corners=np.ascontiguousarray(nodes[mask][:, :3]),
            gradients=np.ascontiguousarray(gradients[mask]),
            lame=np.zeros((int(mask.sum()), 2)),
            starts=np.ascontiguousarray(starts[mask]),
            strides=np.ascontiguousarray(strides[mask]),
        )

    all_free = counts[:, 0] == 4
    return (
        (chosen[all_free], chosen[~all_free]),
        part(all_free),
        part(~all_free),
        np.ascontiguousarray(counts[~all_free]),
    )
