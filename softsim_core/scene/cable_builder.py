"""Cables of a scene, compiled: their points bound to the body that carries them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from softsim_core.actuation.cable import Cables
from softsim_core.actuation.cable_layout import row_layout
from softsim_core.arrays import Array
from softsim_core.errors import SceneError
from softsim_core.mechanics.model import Model
from softsim_core.mesh import embed
from softsim_core.mesh.placement import place
from softsim_core.scene.cable_file import read_cable_points
from softsim_core.scene.description import SceneDescription
from softsim_core.scene.objects import CableDescription

if TYPE_CHECKING:
    from softsim_core.scene.builder import Body

OUTSIDE = 0.02
"""A cable point may lie this far outside its body, in heights of an element."""


def cables(scene: SceneDescription, model: Model, bodies: tuple[Body, ...]) -> Cables | None:
    """All cables of a scene, or None.

    Raises:
        SceneError: a point lies outside its body, or all points of a cable coincide.
        ConfigError: a file of points cannot be read.
    """
    joints = [j for j, joint in enumerate(scene.joints) if joint.cable is not None]
    if not joints:
        return None
    nodes, weights, first, pull, rest, lower, upper, by_force = [], [], [0], [], [], [], [], []
    for j in joints:
        name, cable = scene.joints[j].name, scene.joints[j].cable
        assert cable is not None
        body = next(each for each in bodies if each.name == cable.body)
        points = cable_points(cable)
        bound = embed(points, body.mesh)
        worst = int(np.argmax(bound.outside))
        if bound.outside[worst] > OUTSIDE:
            raise SceneError(
                f"cable {name}: point {worst} at {points[worst].round(6).tolist()} m lies outside body "
                f"{body.name}; move it inside, or check the cable's placement"
            )
        if cable.pull_point is not None:
            on = -1 if cable.pull_on is None else scene.joint_names.index(cable.pull_on)
            local: Array = np.array(cable.pull_point, dtype=float)
            if on >= 0:
                origin, rotation = model.joint_frame(on, model.rest_state())
                local = rotation.T @ (local - origin)
            pull.append((first[-1], on, local))
            nodes.append(np.zeros((1, 4), dtype=np.int64))
            weights.append(np.zeros((1, 4)))
        nodes.append(bound.nodes + body.nodes.start)
        weights.append(bound.weights)
        first.append(sum(len(each) for each in nodes))
        rest.append(cable.rest_length if cable.rest_length is not None else np.nan)
        lower.append(0.0 if cable.pull_only else -np.inf)
        upper.append(np.inf if cable.max_tension is None else cable.max_tension)
        by_force.append(cable.control == "force")
    pulled, ends, carried, forced = (
        np.array(joints),
        np.array(first),
        np.concatenate(nodes),
        np.array(by_force),
    )
    result = Cables(
        tuple(scene.joints[j].name for j in joints),
        pulled,
        ends,
        carried,
        np.concatenate(weights),
        tuple(pull),
        np.array(rest, dtype=float),
        np.array(lower),
        np.array(upper),
        forced,
        row_layout(model, pulled, ends, carried, pull, forced),
    )
    start = model.rest_state()
    lengths = result.lengths(result.points(model, start))
    if not lengths.all():
        raise SceneError(
            f"cable {result.names[int(np.argmin(lengths))]}: all its points coincide; move them apart"
        )
    given = ~np.isnan(result.rest_length)
    result.rest_length[~given] = lengths[~given]
    return result


def cable_points(cable: CableDescription) -> Array:
    """Points of a cable in the world in [m], shape (k, 3), at the start of the scene."""
    points = cable.points
    read = np.array(points, dtype=float) if isinstance(points, tuple) else read_cable_points(points)
    return place(read.reshape(-1, 3), cable.placement)
