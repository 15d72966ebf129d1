"""Compilation of a scene's rigid bodies and collision surfaces."""

from __future__ import annotations

import math
from collections.abc import Container, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from softsim_core.base import Array, Box, IndexArray, SceneError, known_names
from softsim_core.physics.contact import (
    CollisionModel,
    CollisionSurface,
    ContactLimits,
    VertexCarrier,
    check_surface,
    first_overlap,
    may_meet,
    touching,
)
from softsim_core.physics.mechanics import FREE, Model, RigidBodies, State, no_rigid_bodies, rotation_euler
from softsim_core.physics.mesh import (
    SurfaceMesh,
    TetMesh,
    embed,
    mass_properties,
    read_surface,
    surface_of,
    triangles_of,
)
from softsim_core.scene import CollisionDescription, RigidBodyDescription, SceneDescription, nodes_in
from softsim_core.scene.building.bodies import Body


@dataclass(frozen=True, slots=True, eq=False)
class RigidBody:
    """A rigid body, free or carried.

    Attributes:
        name: Its name.
        surface: Its surface in its own frame in [m]; the origin is the centre of mass of a free body.
        colour: Red, green, blue, alpha in 0..1.
        position, rotation: Start pose in the world, or in the frame of its carrier.
        free: Number among the free rigid bodies, or -1.
        on: Its carrier; see RigidBodyDescription.
        radius: Radius in [m] of an exact sphere, else 0.
    """

    name: str
    surface: SurfaceMesh
    colour: tuple[float, float, float, float]
    position: Array
    rotation: Array
    free: int
    on: str
    radius: float


def rigid_objects(scene: SceneDescription) -> tuple[RigidBody, ...]:
    """Return all rigid bodies of a scene, in scene order.

    Raises:
        MeshError: a mesh cannot be used, or is open although a mass requires a closed one.
    """
    result, count = [], 0
    for description in scene.rigid_bodies:
        surface, centre, _ = _surface_and_mass(description)
        rotation = rotation_euler(np.radians(description.pose.rotation_deg))
        position = np.array(description.pose.translation, dtype=float) + rotation @ centre
        free = -1
        if description.mass is not None:
            free, count = count, count + 1
        radius = description.shape.sphere or 0.0
        shifted = SurfaceMesh(surface.points - centre, surface.triangles, surface.name)
        name, colour, on = description.name, description.colour, description.on
        result.append(RigidBody(name, shifted, colour, position, rotation, free, on, radius))
    return tuple(result)


def rigid_bodies(scene: SceneDescription) -> RigidBodies:
    """Return the rigid bodies with mass of a scene."""
    chosen = [each for each in scene.rigid_bodies if each.mass is not None]
    if not chosen:
        return no_rigid_bodies()
    places = [each for each in rigid_objects(scene) if each.free >= 0]
    return RigidBodies(
        tuple(each.name for each in chosen),
        np.array([each.mass for each in chosen], dtype=float),
        np.array([_surface_and_mass(each)[2] for each in chosen]),
        np.array([place.position for place in places]),
        np.array([place.rotation for place in places]),
        np.array([(*each.velocity, *each.angular_velocity) for each in chosen], dtype=float),
    )


def _surface_and_mass(description: RigidBodyDescription) -> tuple[SurfaceMesh, Array, Array]:
    """Return surface, centre of mass (3,) in its frame, and inertia (3, 3) about it; zeros without mass."""
    surface = surface_of(description.shape)
    if description.mass is None:
        return surface, np.zeros(3), np.zeros((3, 3))
    centre, inertia = mass_properties(description.shape, surface, description.mass)
    if description.inertia is not None:
        inertia = np.diag(description.inertia)
    return surface, centre, inertia


_DIRECTIONS = 256
"""Largest number of directions in which the width of a body is measured."""


def contacts(
    scene: SceneDescription,
    limits: ContactLimits,
    model: Model,
    bodies: tuple[Body, ...],
    rigid: tuple[RigidBody, ...],
) -> CollisionModel | None:
    """Return the collision surfaces of a scene and what it is compiled to, or None where no two can meet.

    Raises:
        SceneError: a surface cannot be used, or two overlap at the start.
        MeshError: a file cannot be read.
    """
    surfaces: list[CollisionSurface] = []
    nodes: list[IndexArray] = []
    weights: list[Array] = []
    carriers: list[VertexCarrier] = []
    first = 0
    for description in scene.collisions:
        owner = scene.body_names.index(description.body)
        soft = owner < len(bodies)
        name = f"of collision {description.name}"
        if soft:
            body = bodies[owner]
            surface, bound_nodes, bound_weights = _on_body(description, body)
            moving = bool((model.region_of_node[body.nodes] == FREE).any())
        else:
            thing = rigid[owner - len(bodies)]
            if description.faces is not None:
                raise SceneError(
                    f"collision {description.name}: {description.body} is a rigid body, which has no group "
                    f"{description.faces!r} of faces; remove `faces`"
                )
            surface = _choose_triangles(description, _own_surface(description) or thing.surface)
            moving = thing.free >= 0 or thing.on != "world"
        sphere = not soft and thing.radius > 0.0 and description.surface is None
        if sphere:
            surface = SurfaceMesh(np.zeros((1, 3)), np.zeros((0, 3), np.int64), surface.name)
        else:
            carried = not soft and thing.free < 0
            check_surface(surface.points, surface.triangles, name, carried=carried)
        size = len(surface.points)
        vertices = slice(first, first + size)
        if not soft:
            bound_nodes, bound_weights = np.zeros((size, 4), np.int64), np.zeros((size, 4))
            carriers.append(_carrier(thing, vertices, surface.points, scene, model))
        surfaces.append(
            CollisionSurface(
                name=description.name,
                vertices=vertices,
                triangles=surface.triangles + first,
                groups=frozenset(description.groups),
                owner=owner,
                moving=moving,
                soft=soft,
                radius=thing.radius if sphere else 0.0,
            )
        )
        nodes.append(bound_nodes)
        weights.append(bound_weights)
        first += size
    if not any(may_meet(a, b) for k, a in enumerate(surfaces) for b in surfaces[:k]):
        return None
    bound = np.concatenate(nodes), np.concatenate(weights), tuple(carriers)
    result = CollisionModel(tuple(surfaces), limits, *bound, model, _friction(scene), scene.body_names)
    need_apart(result, model.rest_state(), scene, "at the start")
    return result


def contact_limits(
    scene: SceneDescription, bodies: Sequence[Body], rigid: Sequence[RigidBody]
) -> ContactLimits:
    """Return contact distances and tolerance of a scene; defaults depend on its thinnest moving body."""
    settings = scene.contact
    if None not in (settings.alarm_distance, settings.contact_distance, settings.tolerance):
        return settings.limits()
    return settings.limits(min(thicknesses(scene, bodies, rigid).values(), default=math.inf))


def thicknesses(
    scene: SceneDescription, bodies: Sequence[Body], rigid: Sequence[RigidBody]
) -> dict[str, float]:
    """Return the least width in [m] of each body that may touch others, by name.

    Rigid bodies on the world, such as a floor, and flat bodies are not included.
    """
    touching = {each.body for each in scene.collisions}
    widths = {each.name: _least_width(each.outside.points) for each in bodies if each.name in touching}
    for each in rigid:
        if each.name in touching and (each.on != "world" or each.free >= 0):
            widths[each.name] = 2.0 * each.radius or _least_width(each.surface.points)
    return {name: width for name, width in widths.items() if width > 0.0}


def _least_width(points: Array) -> float:
    """Return the least width of points (n, 3) across a face of their convex hull; 0 if they are coplanar."""
    try:
        hull = ConvexHull(points)
    except QhullError:
        return 0.0
    normals = hull.equations[:: 1 + len(hull.equations) // _DIRECTIONS, :3]
    return float(np.ptp(points[hull.vertices] @ normals.T, axis=0).min())


def _friction(scene: SceneDescription) -> Array:
    """Return the Coulomb coefficient of each pair of collision surfaces, shape (s, s).

    If several entries fit a pair, the last one is used.
    """
    settings, collisions = scene.contact, scene.collisions
    friction = np.full((len(collisions),) * 2, settings.friction)
    for entry in settings.friction_pairs:
        one, other = (
            [k for k, each in enumerate(collisions) if name in (each.name, each.body)]
            for name in entry.between
        )
        friction[np.ix_(one, other)] = entry.friction
        friction[np.ix_(other, one)] = entry.friction
    return friction


def _on_body(description: CollisionDescription, body: Body) -> tuple[SurfaceMesh, IndexArray, Array]:
    """Return a surface on a deformable body, and nodes and weights of its vertices, (v, 4) each."""
    whole = _own_surface(description) or body.outside
    if description.faces is not None:
        try:
            triangles = triangles_in(description.faces, body)
        except SceneError as error:
            raise SceneError(f"collision {description.name}: {error}") from error
        whole = replace(whole, triangles=triangles - body.nodes.start)
    surface = _choose_triangles(description, whole)
    bound = embed(surface.points, body.solid)
    weights = np.where(np.abs(bound.weights) < 1e-9, 0.0, bound.weights)
    return surface, bound.nodes + body.nodes.start, weights / weights.sum(axis=1, keepdims=True)


def triangles_in(faces: str | None, body: Body) -> IndexArray:
    """Return boundary triangles of a deformable body, all or a group of faces of its file, shape (k, 3).

    Raises:
        SceneError: the mesh has no such group, or faces of it lie inside.
    """
    if faces is None:
        return body.boundary
    mesh = body.mesh
    named = mesh.surfaces if isinstance(mesh, TetMesh) else {}
    if not isinstance(mesh, TetMesh) or faces not in named:
        hint = known_names(faces, named, "its groups of faces are")
        raise SceneError(f"body {body.name} has no group {faces!r} of faces in its mesh; {hint}")
    group = np.unique(np.sort(named[faces], axis=1), axis=0)
    found = body.boundary[triangles_of(mesh, body.boundary - body.nodes.start, group)]
    inside = len(group) - len(found) // (4 if mesh.order == 2 else 1)
    if inside:
        raise SceneError(
            f"body {body.name} has {inside} of the {len(group)} faces of group {faces!r} inside; name faces "
            "that its cells leave free"
        )
    return found


def _own_surface(description: CollisionDescription) -> SurfaceMesh | None:
    """Return the surface of the description's file; None: it names none."""
    if description.surface is None:
        return None
    return read_surface(description.surface.file, description.surface.placement)


def triangles_in_boxes(boxes: Sequence[Box], triangles: IndexArray, points: Array) -> IndexArray:
    """Return the triangles (k, 3) with all corners in one of some boxes; without boxes, all."""
    if not boxes:
        return triangles
    chosen = np.zeros(len(triangles), dtype=bool)
    for box in boxes:
        chosen |= np.isin(triangles, nodes_in(box, points)).all(axis=1)
    return np.asarray(triangles[chosen])


def _choose_triangles(description: CollisionDescription, surface: SurfaceMesh) -> SurfaceMesh:
    """Return the triangles with all corners in one of the boxes, and only the points they use."""
    triangles = triangles_in_boxes(description.boxes, surface.triangles, surface.points)
    if description.boxes and not len(triangles):
        raise SceneError(
            f"collision {description.name}: no triangle of body {description.body} lies inside its "
            "boxes; move or enlarge them"
        )
    used, numbered = np.unique(triangles, return_inverse=True)
    return SurfaceMesh(surface.points[used], numbered.reshape(-1, 3).astype(np.int64), surface.name)


def _carrier(
    thing: RigidBody, vertices: slice, points: Array, scene: SceneDescription, model: Model
) -> VertexCarrier:
    """Return the carrier of the vertices of a rigid body's surface."""
    if thing.free >= 0:
        return VertexCarrier(vertices, points, rigid=thing.free)
    local = thing.position + points @ thing.rotation.T
    if thing.on in scene.joint_names:
        return VertexCarrier(vertices, local, joint=scene.joint_names.index(thing.on))
    if thing.on in model.frame_names:
        return VertexCarrier(vertices, local, frame=model.frame_names.index(thing.on))
    if thing.on == "world":
        return VertexCarrier(vertices, local)
    return VertexCarrier(vertices, local, base=scene.joint_names.index(thing.on.removesuffix("_base")))


def need_apart(
    contacts: CollisionModel,
    state: State,
    scene: SceneDescription,
    when: str,
    owners: Container[int] | None = None,
) -> None:
    """Raise SceneError if bodies overlap in a state.

    Args:
        contacts: The scene's surfaces.
        state: Their state.
        scene: Named in the message.
        when: For the message, such as "at the start".
        owners: Numbers of bodies, one of which must overlap; None: any.
    """
    points, surfaces = contacts.points(state), contacts.surfaces
    near = contacts.near(points, contacts.settings.alarm_distance)
    distance = near.distance
    if owners is not None:
        asked = [any(surfaces[number].owner in owners for number in pair) for pair in near.pair.tolist()]
        distance = np.where(asked, distance, np.inf)
    worst = int(np.argmin(distance)) if len(distance) else -1
    least = 0.0
    if worst >= 0:
        first, second = near.pair[worst].tolist()
        least = touching(surfaces[first], surfaces[second], points)
    if worst >= 0 and distance[worst] < -least:
        pair, by = near.pair[worst].tolist(), f" by {-1e3 * distance[worst]:.2g} mm"
    else:
        pair, by = first_overlap(surfaces, points, owners), ""
    if pair is not None:
        a, b = (surfaces[number].name for number in pair)
        raise SceneError(
            f"scene {scene.name}: collision surfaces {a} and {b} overlap{by} {when}; move one of their bodies"
        )
