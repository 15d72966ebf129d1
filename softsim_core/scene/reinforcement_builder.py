"""From layers and fibres of a description to groups of cells, and to the mass of layers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from softsim_core.arrays import Array
from softsim_core.errors import SceneError
from softsim_core.fem.elements import Element
from softsim_core.fem.elements.surface import TRI3, TRI6
from softsim_core.fem.group import ElementGroup, fibre_group, layer_group
from softsim_core.fem.mass import volume_shares
from softsim_core.fem.materials.strain import FIBRES, MEMBRANE
from softsim_core.mesh.faces import boundary_faces
from softsim_core.scene.body import Body
from softsim_core.scene.deformable import BodyDescription
from softsim_core.scene.description import SceneDescription
from softsim_core.scene.regions import nodes_in
from softsim_core.scene.reinforcement import AxisDescription, FibresDescription, LayerDescription


class _Parts:
    """Groups of one element and one law each, gathered part by part."""

    def __init__(self) -> None:
        self._found: dict[tuple[str, str], list[ElementGroup]] = {}

    def add(self, group: ElementGroup) -> None:
        self._found.setdefault((group.element.name, group.material.name), []).append(group)

    def joined(self, first_number: int) -> tuple[ElementGroup, ...]:
        """The groups, their cells numbered on from a number."""
        groups = []
        for parts in self._found.values():
            count = sum(len(part.cells) for part in parts)
            arrays = [
                np.concatenate([getattr(part, name) for part in parts])
                for name in ("cells", "weights", "gradients", "body", "parameter_set")
            ]
            cells, weights, gradients, body, parameter_set = arrays
            numbers = np.arange(first_number, first_number + count)
            first_number += count
            groups.append(
                ElementGroup(
                    parts[0].element, parts[0].material, cells, weights, gradients, body, numbers,
                    parameter_set, fills=False,
                )
            )  # fmt: skip
        return tuple(groups)


def reinforcements(
    scene: SceneDescription, bodies: Sequence[Body], filling: Sequence[ElementGroup], rest: Array
) -> tuple[tuple[ElementGroup, ...], Array]:
    """The groups of all layers and fibres, and the mass that layers give the nodes in [kg], shape (n,).

    Args:
        scene: Whose.
        bodies: Its bodies.
        filling: The groups that fill them.
        rest: Rest positions of all nodes in [m], shape (n, 3).

    Raises:
        SceneError: one covers nothing.
    """
    parts, mass = _Parts(), np.zeros(len(rest))
    owners = [owner for owner, _ in scene.materials]
    for b, (body, description) in enumerate(zip(bodies, scene.bodies, strict=True)):
        for each in description.reinforcements:
            number = owners.index(f"{description.name}.{each.name}")
            if isinstance(each, LayerDescription):
                group = _layer(each, description, body, b, number, rest)
                mass += each.density * volume_shares(group, len(rest))
            else:
                group = _fibres(each, description, b, number, filling, rest)
            parts.add(group)
    return parts.joined(sum(len(group.cells) for group in filling)), mass


def _layer(
    layer: LayerDescription, description: BodyDescription, body: Body, b: int, number: int, rest: Array
) -> ElementGroup:
    faces = boundary_faces(body.solid)
    region = layer.box or layer.sphere
    assert region is not None  # checked by the description
    inside = np.isin(faces, nodes_in(region, body.solid.points)).all(axis=1)
    faces = faces[inside] + body.nodes.start
    if not len(faces):
        low, high = body.solid.points.min(axis=0), body.solid.points.max(axis=0)
        raise SceneError(
            f"layer {layer.name} of body {description.name}: no face of the body lies inside its region; "
            f"move or enlarge it (the body spans {low} to {high} m)"
        )
    one = np.ones(len(faces), dtype=np.int64)
    element: Element = TRI6 if faces.shape[1] == 6 else TRI3
    thickness = np.full(len(faces), layer.thickness)
    return layer_group(element, MEMBRANE, rest, faces, thickness, b * one, 0 * one, number * one)


def _fibres(
    fibres: FibresDescription,
    description: BodyDescription,
    b: int,
    number: int,
    filling: Sequence[ElementGroup],
    rest: Array,
) -> ElementGroup:
    group = next(each for each in filling if (each.body == b).any())
    own = np.flatnonzero(group.body == b)
    region = fibres.box or fibres.sphere
    if region is not None:
        own = own[nodes_in(region, rest[group.cells[own]].mean(axis=1))]
    if fibres.radii is not None:
        distance = _distance(fibres, rest[group.cells[own]].mean(axis=1))
        own = own[(fibres.radii[0] <= distance) & (distance <= fibres.radii[1])]
    if not len(own):
        raise SceneError(
            f"fibres {fibres.name} of body {description.name}: no cell of the body has its middle inside "
            "their region or radii; move or enlarge them"
        )
    part = group.part(own)
    axes = _axes(_directions(fibres, description.name, part, rest))
    return fibre_group(part, FIBRES, rest, axes, np.full(len(own), number))


def _directions(fibres: FibresDescription, body: str, group: ElementGroup, rest: Array) -> Array:
    """Unit vectors along the fibres at the points of a group, shape (m, q, 3)."""
    if fibres.direction is not None:
        direction = np.array(fibres.direction, dtype=float)
        return np.broadcast_to(direction / np.linalg.norm(direction), (*group.weights.shape, 3))
    axis = fibres.around
    assert isinstance(axis, AxisDescription)  # checked by the description
    along = np.array(axis.direction, dtype=float)
    along /= np.linalg.norm(along)
    circle = np.cross(along, _places(group, rest) - np.array(axis.through))
    radius = np.linalg.norm(circle, axis=-1, keepdims=True)
    if not (radius > 1e-9).all():
        raise SceneError(
            f"fibres {fibres.name} of body {body}: their axis goes through a point of a cell, where they "
            "have no direction; move it or give them a region around it"
        )
    angle = np.radians(fibres.angle_deg)
    return np.asarray(np.cos(angle) * circle / radius + np.sin(angle) * along)


def _distance(fibres: FibresDescription, points: Array) -> Array:
    """Distance of points (m, 3) from the axis that fibres are wound around, in [m], shape (m,)."""
    axis = fibres.around
    assert axis is not None  # checked by the description
    along = np.array(axis.direction) / np.linalg.norm(axis.direction)
    return np.asarray(np.linalg.norm(np.cross(along, points - np.array(axis.through)), axis=1))


def _places(group: ElementGroup, rest: Array) -> Array:
    """Where the points of a group's cells lie in [m], shape (m, q, 3); cells are taken as straight."""
    nodes = group.element.reference
    from_nodes = np.linalg.pinv(np.column_stack([nodes, np.ones(len(nodes))]))
    points = group.element.points
    weights = np.column_stack([points, np.ones(len(points))]) @ from_nodes
    return np.asarray(weights @ rest[group.cells])


def _axes(directions: Array) -> Array:
    """Rotations whose first column is a direction (..., 3), shape (..., 3, 3)."""
    away = np.zeros_like(directions)
    np.put_along_axis(away, np.abs(directions).argmin(axis=-1)[..., None], 1.0, axis=-1)
    second = np.cross(directions, away)
    second /= np.linalg.norm(second, axis=-1, keepdims=True)
    return np.stack([directions, second, np.cross(directions, second)], axis=-1)
