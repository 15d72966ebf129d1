"""Nodes that the parts of a proposed scene choose, for immediate display while a region is moved."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from softsim_core.base import Array, IndexArray, SceneError, SoftSimError
from softsim_core.physics.mechanics import rotation_euler
from softsim_core.physics.mesh import TetMesh
from softsim_core.scene import (
    AttachmentDescription,
    BodyDescription,
    JointDescription,
    SceneDescription,
)
from softsim_core.scene.building import (
    Body,
    chosen_nodes,
    on_a_line,
    rest_bodies,
    triangles_in,
    triangles_in_boxes,
)


@dataclass(frozen=True, slots=True, eq=False)
class Chosen:
    """The nodes that a part chooses.

    Attributes:
        part: The part, as in `regions_of` without a number: "attachments/base", "joints/air".
        body: Name of the body.
        nodes: Ascending node numbers within the body, shape (k,).
        points: Rest positions of the nodes in [m], shape (k, 3).
        problem: Reason why the scene cannot run with this part; "": there is none.
    """

    part: str
    body: str
    nodes: IndexArray
    points: Array
    problem: str = ""


class RestShapes:
    """Bodies of proposed scenes at rest; a body is rebuilt only if its shape has changed."""

    def __init__(self) -> None:
        self._made: dict[str, tuple[tuple[Any, ...], Body]] = {}

    def take(self, description: BodyDescription, body: Body) -> None:
        """Store a body that has already been built."""
        start = body.nodes.start
        nodes = slice(0, body.nodes.stop - start)
        own = replace(body, nodes=nodes, boundary=body.boundary - start)
        self._made[description.name] = (_shape(description), own)

    def body(self, description: BodyDescription) -> Body:
        """Return a body, with its nodes numbered from 0.

        Raises:
            MeshError: its mesh cannot be used.
        """
        shape = _shape(description)
        entry = self._made.get(description.name)
        if entry is None or entry[0] != shape:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                (body,) = rest_bodies(SceneDescription(name="rest", bodies=(description,)))
            entry = self._made[description.name] = (shape, body)
        return entry[1]


def chosen_by(scene: SceneDescription, shapes: RestShapes) -> list[Chosen]:
    """Return the nodes of every attachment, added mass, collision surface and chamber of a scene.

    Raises:
        MeshError: a mesh cannot be used.
    """
    bodies = {each.name: each for each in scene.bodies}
    found = list(_of_attachments(scene, bodies, shapes))
    for description in scene.bodies:
        body = shapes.body(description)
        for number, added in enumerate(description.added_masses):
            part = f"bodies/{body.name}/added_masses#{number}"
            found.append(_choose_nodes(part, body, partial(chosen_nodes, body, added, body.region_points)))
    for collision in scene.collisions:
        if collision.body in bodies and collision.surface is None:
            body = shapes.body(bodies[collision.body])
            find = partial(_touching, body, collision.boxes, collision.faces)
            found.append(_choose_nodes(f"collisions/{collision.name}", body, find))
    for joint in scene.joints:
        if joint.actuator is not None and joint.actuator.gas is not None:
            for name in filter(None, joint.actuator.bodies().values()):
                body = shapes.body(bodies[name])
                found.append(_choose_nodes(f"joints/{joint.name}", body, partial(_hollow, body, joint)))
    return found


def _of_attachments(
    scene: SceneDescription, bodies: dict[str, BodyDescription], shapes: RestShapes
) -> Iterator[Chosen]:
    owners: dict[tuple[str, int], str] = {}
    for attachment in scene.attachments:
        body = shapes.body(bodies[attachment.body])
        points = _in_frame_of(scene, attachment, body.region_points)
        find = partial(chosen_nodes, body, attachment, points)
        chosen = _choose_nodes(f"attachments/{attachment.name}", body, find)
        if attachment.stiffness is None and not chosen.problem:
            keys = [(body.name, node) for node in chosen.nodes.tolist()]
            shared = [owners[key] for key in keys if key in owners]
            owners |= dict.fromkeys(keys, attachment.name)
            if shared:
                problem = f"shares {len(shared)} nodes with {shared[0]}; move or shrink one of them"
                chosen = replace(chosen, problem=problem)
            elif attachment.to == "free" and on_a_line(chosen.points):
                chosen = replace(chosen, problem="its nodes lie on one line; enlarge it")
        yield chosen


def _in_frame_of(scene: SceneDescription, attachment: AttachmentDescription, points: Array) -> Array:
    """Transform points (n, 3) into the frame in which an attachment's region is given."""
    for joint in scene.joints:
        if joint.name == attachment.relative_to:
            turn = rotation_euler(np.radians(joint.base.rotation_deg))
            return np.asarray((points - np.array(joint.base.translation)) @ turn)
    return points


def _choose_nodes(part: str, body: Body, find: Callable[[], Any]) -> Chosen:
    try:
        nodes, problem = np.asarray(find(), dtype=np.int64), ""
    except SoftSimError as error:
        nodes, problem = np.zeros(0, np.int64), str(error)
    if not problem and not len(nodes):
        problem = "chooses no node; move or enlarge it"
    return Chosen(part, body.name, nodes, body.mesh.points[nodes], problem)


def _touching(body: Body, boxes: Any, faces: str | None) -> IndexArray:
    """Return corners of boundary triangles of a body: in one of some boxes, of a group of faces, or all."""
    return np.unique(triangles_in_boxes(boxes, triangles_in(faces, body), body.mesh.points))


def _hollow(body: Body, joint: JointDescription) -> IndexArray:
    """Return the nodes around a chamber."""
    assert joint.actuator is not None
    if not isinstance(body.mesh, TetMesh):
        raise SceneError(f"body {body.name} is a rod, which has no hollow")
    nodes = joint.actuator.enclosed_nodes(joint.name, body.mesh)
    return np.zeros(0, np.int64) if nodes is None else nodes


def _shape(description: BodyDescription) -> tuple[Any, ...]:
    """Return all values that the nodes of a body depend on."""
    names = ("mesh", "rod", "order", "element", "surface")
    material = description.material.values if description.rod is not None else None
    return (*(getattr(description, name) for name in names), material)
