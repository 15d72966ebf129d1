"""Construction of the cables of a scene: their points bound to the body that carries them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from softsim_core.base import Array, SceneError, listing
from softsim_core.physics.actuation import ActuatorKind, Placed, Surroundings
from softsim_core.physics.actuation.cable.cables import Cables, row_layout
from softsim_core.physics.actuation.cable.description import CableDescription, read_cable_points
from softsim_core.physics.mesh import TetMesh, place


def build_cables(placed: Sequence[Placed], surroundings: Surroundings) -> Cables:
    """Return all cables of a scene.

    Raises:
        SceneError: a point is outside its body, or all points of a cable coincide.
        ConfigError: a file of points cannot be read.
    """
    model = surroundings.model
    start = model.rest_state()
    nodes, weights, first, pull = [], [], [0], []
    descriptions: list[CableDescription] = [each.description for each in placed]
    for each, cable in zip(placed, descriptions, strict=True):
        bound = surroundings.bind(
            f"cable {each.name}", cable.body, cable_points(cable, surroundings.meshes[cable.body])
        )
        if cable.pull_point is not None:
            on = -1 if cable.pull_on is None else surroundings.joint(cable.pull_on)
            local: Array = np.array(cable.pull_point, dtype=float)
            if on >= 0:
                origin, rotation = model.joint_frame(on, start)
                local = rotation.T @ (local - origin)
            pull.append((first[-1], on, local))
            nodes.append(np.zeros((1, 4), dtype=np.int64))
            weights.append(np.zeros((1, 4)))
        nodes.append(bound.nodes)
        weights.append(bound.weights)
        first.append(sum(len(points) for points in nodes))
    ends, carried = np.array(first), np.concatenate(nodes)
    result = Cables(
        names=tuple(each.name for each in placed),
        joint=np.array([each.joint for each in placed], dtype=np.int64),
        first=ends,
        nodes=carried,
        weights=np.concatenate(weights),
        pull=tuple(pull),
        rest_length=np.array([each.rest_length or np.nan for each in descriptions], dtype=float),
        lower=np.array([0.0 if each.pull_only else -np.inf for each in descriptions]),
        upper=np.array([each.max_tension or np.inf for each in descriptions]),
        by_force=np.array([each.control == "force" for each in descriptions], dtype=np.bool_),
        layout=row_layout(model, ends, carried, pull),
    )
    lengths = result.lengths(result.points(model, start))
    if not lengths.all():
        raise SceneError(
            f"cable {result.names[int(np.argmin(lengths))]}: all its points coincide; move them apart"
        )
    defined = ~np.isnan(result.rest_length)
    result.rest_length[~defined] = lengths[~defined]
    return result


def cable_points(cable: CableDescription, mesh: TetMesh | None = None) -> Array:
    """Return the points of a cable in the world in [m], shape (k, 3), at the start of the scene.

    Args:
        cable: The cable.
        mesh: Mesh of its body, for a cable that names a group of it.

    Raises:
        SceneError: the mesh has no such group.
        ConfigError: a file of points cannot be read.
    """
    if cable.group is not None:
        groups = {} if mesh is None else mesh.groups
        if mesh is None or cable.group not in groups:
            raise SceneError(
                f"cable: the mesh of body {cable.body} has no group {cable.group!r}; its groups are "
                f"{listing(groups)}"
            )
        return _chain_points(mesh.points[groups[cable.group]], np.array(cable.pull_point, dtype=float))
    points = cable.points
    read = np.array(points, dtype=float) if isinstance(points, tuple) else read_cable_points(points)
    return place(read.reshape(-1, 3), cable.placement)


def _chain_points(points: Array, start: Array) -> Array:
    """Return points (k, 3) as a chain: the one nearest to `start`, then each time the nearest remaining."""
    left, here, chain = points, start, []
    while len(left):
        nearest = int(np.argmin(np.linalg.norm(left - here, axis=1)))
        here = left[nearest]
        chain.append(here)
        left = np.delete(left, nearest, axis=0)
    return np.array(chain)


CABLE: Final[ActuatorKind] = ActuatorKind("cable", CableDescription, build_cables)
