"""From a scene description to the mechanical model and the surfaces that follow it."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np

from softsim_core.actuation.cable import Cables
from softsim_core.arrays import Array, IndexArray
from softsim_core.dynamics.stepper import Parameters
from softsim_core.errors import SceneError
from softsim_core.fem.material import LinearMaterial
from softsim_core.fem.tetrahedra import rest_tetrahedra
from softsim_core.mechanics.model import FREE, HELD, Joint, Model, Zone
from softsim_core.mechanics.pose import rotation_euler
from softsim_core.mesh import (
    Embedding,
    SurfaceMesh,
    TetMesh,
    boundary,
    check_tets,
    embed,
    read_surface,
    read_tets,
)
from softsim_core.scene.cable_builder import cables
from softsim_core.scene.description import AttachmentDescription, JointDescription, SceneDescription
from softsim_core.scene.regions import nodes_in
from softsim_core.scene.rigid_builder import RigidBody, rigid_bodies, rigid_objects


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A body within the model: its nodes and elements are contiguous.

    Attributes:
        name: Name of the body.
        nodes: Slice of the model's nodes.
        mesh: Its tetrahedra, with its own node numbers.
        boundary: Boundary triangles with the model's node numbers, shape (k, 3).
        surface: Visual surface at rest.
        embedding: How the visual surface follows the body's nodes.
    """

    name: str
    nodes: slice
    mesh: TetMesh
    boundary: IndexArray
    surface: SurfaceMesh
    embedding: Embedding


@dataclass(frozen=True, slots=True, eq=False)
class BuiltScene:
    """A scene ready to run: model, tunable parameters at their first values, and what is in it."""

    model: Model
    parameters: Parameters
    bodies: tuple[Body, ...]
    rigid: tuple[RigidBody, ...]
    cables: Cables | None


def build(scene: SceneDescription) -> BuiltScene:
    """Compile a scene.

    Raises:
        SceneError: names or regions do not fit together.
        MeshError: a mesh cannot be used.
        MaterialError: a material value is outside its interval.
    """
    bodies = _bodies(scene)
    rest = np.concatenate([body.mesh.points for body in bodies]) if bodies else np.zeros((0, 3))
    tets = [body.mesh.tets + body.nodes.start for body in bodies]
    joints = tuple(_joint(joint, scene.joint_names) for joint in scene.joints)
    zone_of_node, spring, moving = _assign_nodes(scene, bodies, joints, rest)
    frames = [attachment for attachment in scene.attachments if attachment.to == "free"]
    frame_rest = (
        np.array([attachment.frame.translation for attachment in frames], dtype=float).reshape(-1, 3),
        np.array([_rotation(attachment.frame.rotation_deg) for attachment in frames]).reshape(-1, 3, 3),
    )
    model = Model(
        rest=rest,
        elements=rest_tetrahedra(rest, np.concatenate([np.zeros((0, 4), np.int64), *tets])),
        element_body=np.repeat(np.arange(len(bodies)), [len(body.mesh.tets) for body in bodies]),
        mass=np.concatenate(
            [np.zeros(0)]
            + [
                np.full(len(body.mesh.points), description.total_mass / len(body.mesh.points))
                for body, description in zip(bodies, scene.bodies, strict=True)
            ]
        ),
        spring=spring,
        gravity=np.array(scene.gravity, dtype=float),
        dt=scene.dt,
        law=scene.solver.rotation,
        zone_of_node=zone_of_node,
        zones=_zones(moving, scene, joints, frame_rest, zone_of_node, rest),
        frame_names=tuple(attachment.name for attachment in frames),
        frame_rest=frame_rest,
        joints=joints,
        rigid=rigid_bodies(scene),
    )
    parameters = Parameters(
        lame=np.array(
            [
                LinearMaterial(body.material.young_modulus, body.material.poisson_ratio).lame
                for body in scene.bodies
            ],
            dtype=float,
        ).reshape(-1, 2),
        rayleigh_stiffness=scene.solver.rayleigh_stiffness,
        rayleigh_mass=scene.solver.rayleigh_mass,
    )
    return BuiltScene(model, parameters, bodies, rigid_objects(scene), cables(scene, model, bodies))


def _bodies(scene: SceneDescription) -> tuple[Body, ...]:
    bodies, start = [], 0
    for description in scene.bodies:
        mesh = description.mesh
        if not isinstance(mesh, TetMesh):
            mesh = read_tets(mesh.file, mesh.placement)
        for sentence in check_tets(mesh).warnings:
            warnings.warn(f"body {description.name}: {sentence}", stacklevel=4)
        triangles = boundary(mesh)
        if description.surface is None:
            used, numbered = np.unique(triangles, return_inverse=True)
            surface = SurfaceMesh(mesh.points[used], numbered.reshape(-1, 3).astype(np.int64), mesh.name)
        else:
            surface = read_surface(description.surface.file, description.surface.placement)
        nodes = slice(start, start + len(mesh.points))
        embedding = embed(surface.points, mesh)
        bodies.append(Body(description.name, nodes, mesh, triangles + start, surface, embedding))
        start = nodes.stop
    return tuple(bodies)


def _rotation(rotation_deg: tuple[float, float, float]) -> Array:
    return rotation_euler(np.radians(rotation_deg))


def _joint(joint: JointDescription, names: tuple[str, ...]) -> Joint:
    return Joint(
        name=joint.name,
        revolute=joint.kind == "revolute",
        base_position=np.array(joint.base.translation, dtype=float),
        base_rotation=_rotation(joint.base.rotation_deg),
        axis=np.array(joint.axis, dtype=float),
        slide_axis=np.array(joint.slide_axis, dtype=float),
        limits=joint.limits,
        rest=joint.rest,
        stiffness=joint.stiffness,
        inertia=joint.inertia,
        parent=-1 if joint.parent is None else names.index(joint.parent),
        cable=joint.kind == "cable",
    )


def _assign_nodes(
    scene: SceneDescription, bodies: tuple[Body, ...], joints: tuple[Joint, ...], rest: Array
) -> tuple[IndexArray, Array, list[AttachmentDescription]]:
    """Zone number and fixing spring of each node, and the attachments that move, in zone order."""
    zone_of_node = np.full(len(rest), FREE, dtype=np.int64)
    spring = np.zeros(len(rest))
    owner: dict[int, str] = {}
    moving: list[AttachmentDescription] = []
    for attachment in scene.attachments:
        body = next(body for body in bodies if body.name == attachment.body)
        points = body.mesh.points
        if attachment.relative_to is not None:
            base = joints[scene.joint_names.index(attachment.relative_to)]
            points = (points - base.base_position) @ base.base_rotation
        region = attachment.box or attachment.sphere
        assert region is not None  # checked by the description
        nodes = nodes_in(region, points) + body.nodes.start
        if len(nodes) == 0:
            raise SceneError(
                f"attachment {attachment.name}: no node of body {body.name} lies inside its region; "
                f"move or enlarge it (the body spans {points.min(0)} to {points.max(0)} m there)"
            )
        if attachment.stiffness is not None:
            spring[nodes] += attachment.stiffness
            continue
        taken = [node for node in nodes.tolist() if node in owner]
        if taken:
            raise SceneError(
                f"attachments {owner[taken[0]]} and {attachment.name} share {len(taken)} nodes; "
                "move or shrink one of their regions"
            )
        owner.update(dict.fromkeys(nodes.tolist(), attachment.name))
        if attachment.to == "world":
            zone_of_node[nodes] = HELD
        else:
            zone_of_node[nodes] = len(moving)
            moving.append(attachment)
    return zone_of_node, spring, moving


def _zones(
    moving: list[AttachmentDescription],
    scene: SceneDescription,
    joints: tuple[Joint, ...],
    frame_rest: tuple[Array, Array],
    zone_of_node: IndexArray,
    rest: Array,
) -> tuple[Zone, ...]:
    frames = [attachment.name for attachment in moving if attachment.to == "free"]
    zones = []
    for number, attachment in enumerate(moving):
        nodes = np.flatnonzero(zone_of_node == number)
        if attachment.to == "free":
            f, j = frames.index(attachment.name), -1
            origin, rotation = frame_rest[0][f], frame_rest[1][f]
            border = 6 * f + np.arange(6)
            if np.linalg.matrix_rank(rest[nodes] - rest[nodes].mean(axis=0), tol=1e-9) < 2:
                raise SceneError(
                    f"attachment {attachment.name}: the {len(nodes)} nodes of a free frame lie on one line, "
                    "so its rotation is not determined; enlarge its region"
                )
        else:
            f, j = -1, scene.joint_names.index(attachment.to)
            origin, rotation = joints[j].frame(joints[j].rest, 0.0)
            chain = [j]
            while joints[chain[0]].parent >= 0:
                chain.insert(0, joints[chain[0]].parent)
            border = 6 * len(frames) + np.array(chain)
        zones.append(Zone(attachment.name, f, j, nodes, (rest[nodes] - origin) @ rotation, border))
    return tuple(zones)
