"""From the mechanical model to the arrays of the compiled step: planned once a model."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from softsim_core.actuation.cable import Cables
from softsim_core.arrays import Array, IndexArray
from softsim_core.dynamics.fast.cables import IN_BODY, IN_WORLD
from softsim_core.dynamics.fast.layout import Border, Elements, Lines, Nodes, Tree, Work
from softsim_core.dynamics.fast.simd import LANES, ROWS
from softsim_core.dynamics.fast.symbolic import Plan, plan
from softsim_core.dynamics.stepper import joint_stiffness
from softsim_core.mechanics.model import FREE, Model


class Prepared(NamedTuple):
    """Everything the kernels need.

    Attributes:
        free, mixed: Elements whose nodes are all free, and the others that deform.
        free_ids, mixed_ids: Their numbers in the model.
        nodes, border, lines, tree, work: See layout.
    """

    free: Elements
    mixed: Elements
    free_ids: IndexArray
    mixed_ids: IndexArray
    nodes: Nodes
    border: Border
    lines: Lines
    tree: Tree
    work: Work


def prepare(model: Model, cables: Cables) -> Prepared:
    """Plan the elimination and lay out all arrays."""
    lines = _lines(cables)
    local = np.full(len(model.rest), -1, dtype=np.int64)
    local[model.free_nodes] = np.arange(len(model.free_nodes))
    chosen = _deforming_elements(model)
    edges, beside = _couplings(model, chosen, local)
    beside = np.concatenate([beside, _pulled(model, lines, local)])
    border_size = model.border_size + len(lines.joint)
    layout = plan(len(model.free_nodes), edges, beside, border_size, LANES, ROWS)
    all_free = (model.zone_of_node[model.elements.nodes[chosen]] == FREE).all(axis=1)
    free_ids, free = _elements(model, chosen[all_free], local, layout)
    mixed_ids, mixed = _elements(model, chosen[~all_free], local, layout)
    return Prepared(
        free,
        mixed,
        free_ids,
        mixed_ids,
        _nodes(model, layout, border_size),
        _border(model),
        lines,
        _tree(layout),
        _work(model, layout, border_size),
    )


def set_moduli(elements: Elements, lame: Array) -> None:
    """Set Lame parameters times volume (e, 2) in [N m]; lanes without an element get none."""
    padded = np.zeros((len(elements.lame) * LANES, 2))
    padded[: len(lame)] = lame
    elements.lame[:] = padded.reshape(-1, LANES, 2).swapaxes(1, 2)


def _deforming_elements(model: Model) -> IndexArray:
    """Elements that are not rigid as a whole, in mesh order."""
    zones = model.zone_of_node[model.elements.nodes]
    rigid = (zones == zones[:, :1]).all(axis=1) & (zones[:, 0] != FREE)
    return np.flatnonzero(~rigid)


def _couplings(model: Model, chosen: IndexArray, local: IndexArray) -> tuple[IndexArray, IndexArray]:
    """Pairs of coupled free nodes, and pairs (free node, border unknown)."""
    nodes = model.elements.nodes[chosen]
    pairs = np.stack([np.repeat(nodes, 4, axis=1).ravel(), np.tile(nodes, (1, 4)).ravel()], axis=1)
    zones = model.zone_of_node[pairs]
    edges = local[pairs[(zones == FREE).all(axis=1)]]
    beside = pairs[(zones[:, 0] == FREE) & (zones[:, 1] >= 0)]
    touching = np.unique(np.stack([local[beside[:, 0]], model.zone_of_node[beside[:, 1]]], axis=1), axis=0)
    border = {(node, b) for node, zone in touching.tolist() for b in model.zones[zone].border.tolist()}
    unique = np.unique(edges, axis=0) if len(edges) else np.zeros((0, 2), dtype=np.int64)
    return unique, np.array(sorted(border), dtype=np.int64).reshape(-1, 2)


def _pulled(model: Model, lines: Lines, local: IndexArray) -> IndexArray:
    """Pairs (free node, border unknown of the cable that pulls it)."""
    cable = np.repeat(np.arange(len(lines.joint)), np.diff(lines.first))
    pairs = np.stack([lines.nodes, np.broadcast_to(cable[:, None], lines.nodes.shape)], axis=-1)
    pairs = pairs[lines.carrier == IN_BODY].reshape(-1, 2)
    free = local[pairs[:, 0]] >= 0
    return np.unique(np.stack([local[pairs[free, 0]], model.border_size + pairs[free, 1]], axis=1), axis=0)


def _lines(cables: Cables) -> Lines:
    """The cables of a scene for the kernels."""
    layout, count, points = cables.layout, len(cables), len(cables.nodes)
    carrier, local = np.full(points, IN_BODY), np.zeros((points, 3))
    for point, joint, place in cables.pull:
        carrier[point], local[point] = (joint if joint >= 0 else IN_WORLD), place
    return Lines(
        first=cables.first,
        nodes=cables.nodes,
        weights=cables.weights,
        carrier=carrier,
        local=local,
        entry=layout.of_points[::4].copy(),
        start=layout.start,
        place=layout.place,
        levers=layout.levers.copy(),
        lever_points=layout.lever_points.copy(),
        lever_unknowns=layout.lever_unknowns.copy(),
        joint=cables.joint,
        rest_length=cables.rest_length,
        by_force=cables.by_force,
        coefficient=layout.coefficient.copy(),
        points=np.zeros((points, 3)),
        pulls=np.zeros((points, 3)),
        travel=np.zeros(count),
        gap=np.zeros(count),
        tension=np.zeros(count),
        compliance=np.zeros((count, count)),
    )


def _nodes(model: Model, layout: Plan, border_size: int) -> Nodes:
    free = model.free_nodes
    zone_nodes = np.concatenate([np.zeros(0, np.int64)] + [zone.nodes for zone in model.zones])
    border = np.zeros((len(zone_nodes), 6), dtype=np.int64)
    size = np.zeros(len(zone_nodes), dtype=np.int64)
    zone_of = np.repeat(np.arange(len(model.zones)), [len(zone.nodes) for zone in model.zones])
    for z, zone in enumerate(zone_of):
        unknowns = model.zones[zone].border
        border[z, : len(unknowns)], size[z] = unknowns, len(unknowns)
    number = np.full(len(model.rest), -1, dtype=np.int64)
    number[zone_nodes] = np.arange(len(zone_nodes))
    first = np.concatenate([[0], np.cumsum(layout.columns)])[layout.supernode]
    first_unknown, supernode = np.full((2, len(model.rest)), -1, dtype=np.int64)
    first_unknown[free], supernode[free] = 3 * layout.position, layout.supernode
    return Nodes(
        free=free,
        row=layout.row_offset,
        stride=layout.width[layout.supernode],
        column=3 * layout.position - first,
        right=(layout.later + layout.side - 1)[layout.supernode],
        unknown=3 * layout.position,
        zone=zone_nodes,
        zone_of=zone_of.astype(np.int64),
        local=np.concatenate([np.zeros((0, 3))] + [zone.local for zone in model.zones]),
        border=border,
        size=size,
        zone_number=number,
        border_column=_border_columns(layout, border_size),
        first_unknown=first_unknown,
        supernode=supernode,
        mass=model.mass.copy(),
        diagonal=np.zeros(len(model.rest)),
    )


def _border(model: Model) -> Border:
    joints = model.joints

    def stacked(rows: list[Array], *shape: int) -> Array:
        return np.array(rows, dtype=float).reshape(-1, *shape)

    return Border(
        base_position=stacked([joint.base_position for joint in joints], 3),
        base_rotation=stacked([joint.base_rotation for joint in joints], 3, 3),
        axis=stacked([0.0 * joint.axis if joint.cable else joint.axis for joint in joints], 3),
        slide=stacked([joint.slide_axis for joint in joints], 3),
        revolute=np.array([joint.revolute for joint in joints], dtype=np.bool_),
        stiffness=joint_stiffness(model),
        inertia=np.array([joint.inertia for joint in joints], dtype=float),
        parent=np.array([joint.parent for joint in joints], dtype=np.int64),
        rest=np.array([joint.rest for joint in joints], dtype=float),
        zones=np.array([(zone.frame, zone.joint) for zone in model.zones], dtype=np.int64).reshape(-1, 2),
    )


def _tree(layout: Plan) -> Tree:
    arrays = {name: getattr(layout, name) for name in Tree._fields[:-2]}
    first_column = np.concatenate([np.zeros(1, np.int64), np.cumsum(layout.columns)])[: len(layout.columns)]
    parent = np.full(len(layout.columns), -1, dtype=np.int64)
    for s in range(len(parent)):
        parent[layout.children[layout.first_child[s] : layout.first_child[s + 1]]] = s
    return Tree(**arrays, first_column=first_column, parent=parent)


def _work(model: Model, layout: Plan, border_size: int) -> Work:
    size, nodes = model.border_size, len(model.rest)
    in_zones = sum(len(zone.nodes) for zone in model.zones)
    return Work(
        panels=np.zeros(layout.panel[-1]),
        stack=np.zeros(layout.stack_size),
        schur=np.zeros((border_size, border_size + 1)),
        scratch=np.zeros((border_size, border_size + 1)),
        solution=np.zeros(3 * len(layout.position) + border_size),
        gathered=np.zeros(int(layout.width.max(initial=1))),
        forces=np.zeros((nodes, 3)),
        jacobian=np.zeros((in_zones, 6, 3)),
        angular=np.zeros((size, 3)),
        linear=np.zeros((size, 3)),
        origin=np.zeros((size, 3)),
        zone_origins=np.zeros((len(model.zones), 3)),
        zone_rotations=np.zeros((len(model.zones), 3, 3)),
        ahead=np.zeros((nodes, 3)),
        deformation=np.zeros((9, LANES)),
        rotations=np.zeros((10, LANES)),
        rotated=np.zeros((4 * LANES, 4)),
        turns=np.zeros((12, 4)),
        one=np.zeros((3, 3)),
        two=np.zeros((3, 3)),
    )


def _border_columns(layout: Plan, border_size: int) -> IndexArray:
    """Panel column of each border unknown in each supernode, -1 where absent, shape (s, b + c)."""
    first = 3 * len(layout.position)
    table = [[places.get(first + b, -1) for b in range(border_size)] for places in layout.column_of]
    return np.array(table, dtype=np.int64).reshape(len(layout.column_of), border_size)


def _elements(
    model: Model, chosen: IndexArray, local: IndexArray, layout: Plan
) -> tuple[IndexArray, Elements]:
    """The chosen elements in elimination order, with their places in the panels; their numbers come first."""
    nodes = model.elements.nodes[chosen]
    zones = model.zone_of_node[nodes]
    count = len(layout.position)
    places = np.append(layout.position, 0)[local[nodes]]  # held and zone nodes have no place of their own
    rank = np.where(zones == FREE, places, np.where(zones >= 0, count, count + 1))
    order = np.argsort(rank.min(axis=1, initial=count), kind="stable")
    chosen, nodes, zones, rank = chosen[order], nodes[order], zones[order], rank[order]
    inside = np.argsort(rank, axis=1, kind="stable")
    ordered = np.take_along_axis(nodes, inside, axis=1)
    gradients = np.take_along_axis(model.elements.gradients[chosen], inside[:, :, None], axis=1)
    counts = np.stack([(zones == FREE).sum(axis=1), (zones >= 0).sum(axis=1)], axis=1)
    starts, strides = np.zeros((len(chosen), 18), dtype=np.int64), np.zeros((len(chosen), 4), dtype=np.int64)
    for e in range(len(chosen)):
        free = local[ordered[e, : counts[e, 0]]].tolist()
        pair = 0
        for a, node in enumerate(free):
            s = layout.supernode[node]
            strides[e, a] = layout.width[s]
            starts[e, 10 + a], starts[e, 14 + a] = layout.row_offset[node], s
            for other in free[a:]:
                column = layout.column_of[s][3 * int(layout.position[other])]
                starts[e, pair] = layout.row_offset[node] + column
                pair += 1
    return chosen, Elements(
        nodes=_in_lanes(ordered),
        corners=_in_lanes(nodes),
        gradients=_in_lanes(gradients.reshape(-1, 12)),
        lame=np.zeros((-(-len(chosen) // LANES), 2, LANES)),
        starts=starts,
        strides=strides,
        counts=counts,
    )


def _in_lanes(rows: Any) -> Any:
    """Rows (e, r) as batches (B, r, LANES); lanes beyond the last row repeat it."""
    missing = -len(rows) % LANES
    padded = np.concatenate([rows, np.repeat(rows[-1:], missing, axis=0)])
    return np.ascontiguousarray(padded.reshape(-1, LANES, rows.shape[1]).swapaxes(1, 2))
