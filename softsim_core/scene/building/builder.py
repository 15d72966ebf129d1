"""Compilation of a scene description to mechanical model, actuators, sensors and surfaces."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from softsim_core.base import Array, IndexArray, MeshFile, Placement, SceneError, known_names, listing
from softsim_core.physics.actuation import Actuators, Placed, Surroundings, actuator_kinds
from softsim_core.physics.contact import CollisionModel, ContactLimits
from softsim_core.physics.dynamics import torn_by_rough_steps
from softsim_core.physics.fem import (
    ElementGroup,
    MassCoupling,
    element_group,
    locking_warning,
    mass_coupling,
    memory_shape,
    takes_found_stress,
    volume_shares,
)
from softsim_core.physics.fem.elements import element, element_of_kind
from softsim_core.physics.fem.materials import SECTION, Relaxing
from softsim_core.physics.fem.rods import join_rods, rod_group
from softsim_core.physics.mechanics import (
    ACCELERATION,
    ACTUATOR_STATE,
    COMMANDED,
    EFFORT_CHANGE,
    FIXED,
    FREE,
    HOLDING,
    MOVED,
    PASSIVE_EFFORTS,
    REDUCED_ACCELERATION,
    Carrier,
    Joint,
    Model,
    Parameters,
    RigidRegion,
    memory_name,
    rotation_euler,
    step_stress_name,
)
from softsim_core.physics.mesh import (
    TETRAHEDRA,
    RodMesh,
    TetMesh,
    boundary,
    boundary_surface,
    check_tets,
    drop_unused_nodes,
    embed,
    linear,
    node_triangles,
    quadratic,
    read_surface,
    read_tets,
    rod_surface,
    whole_cells,
)
from softsim_core.physics.sensing import Place, Scenery, Sensors, sensor_kind
from softsim_core.scene import (
    AddedMassDescription,
    AttachmentDescription,
    BodyDescription,
    JointDescription,
    SceneDescription,
    nodes_in,
)
from softsim_core.scene.building.bodies import Body, draw_rod, draw_tetrahedra, material_parts, reinforcements
from softsim_core.scene.building.contact_builder import RigidBody, contact_limits, rigid_bodies, rigid_objects
from softsim_core.scene.building.plausibility import implausible


def surroundings(model: Model, bodies: tuple[Body, ...]) -> Surroundings:
    """Return the model and bodies to which actuators and sensors are bound."""
    return Surroundings(
        model, {body.name: body.solid for body in bodies}, {body.name: body.nodes.start for body in bodies}
    )


def actuators(scene: SceneDescription, model: Model, bodies: tuple[Body, ...]) -> Actuators:
    """Return the actuators of all joints of a scene; kinds in the order of the registry.

    Raises:
        SceneError: an actuator does not fit its surroundings.
        ConfigError: a file that an actuator names cannot be read.
    """
    around = surroundings(model, bodies)
    groups = []
    for kind in actuator_kinds().values():
        placed = [
            Placed(joint.name, j, joint.actuator)
            for j, joint in enumerate(scene.joints)
            if joint.actuator is not None and joint.kind == kind.name
        ]
        if placed:
            groups.append(kind.build(placed, around))
    return Actuators(groups)


@dataclass(frozen=True, slots=True, eq=False)
class BuiltScene:
    """A compiled scene: model, tunable parameters at their first values, bodies and actuators."""

    model: Model
    parameters: Parameters
    bodies: tuple[Body, ...]
    rigid: tuple[RigidBody, ...]
    actuators: Actuators
    contact: ContactLimits


def build(scene: SceneDescription, shaped: Sequence[tuple[BodyDescription, Body]] = ()) -> BuiltScene:
    """Compile a scene; see `rest_bodies` for `shaped`.

    Raises:
        SceneError: names or regions are inconsistent.
        MeshError: a mesh cannot be used.
    """
    bodies = rest_bodies(scene, shaped)
    rest = np.concatenate([body.mesh.points for body in bodies]) if bodies else np.zeros((0, 3))
    joints = tuple(_joint(joint, scene.joint_names) for joint in scene.joints)
    region_of_node, spring, moving = _assign_nodes(scene, bodies, joints, rest)
    frames = _frames(moving, region_of_node, rest)
    origins = np.array([frame.translation for frame in frames.values()], dtype=float).reshape(-1, 3)
    turns = np.array([rotation_euler(np.radians(each.rotation_deg)) for each in frames.values()])
    frame_rest = origins, turns.reshape(-1, 3, 3)
    filling = _groups(scene, bodies)
    rigid = rigid_objects(scene)
    for message in implausible(scene, bodies, filling, rigid):
        warnings.warn(message, stacklevel=3)
    reinforcing, mass_of_layers = reinforcements(scene, bodies, filling, rest)
    groups = (*filling, *reinforcing)
    model = Model(
        rest=rest,
        groups=groups,
        mass=_masses(scene, bodies, filling) + mass_of_layers,
        spring=spring,
        gravity=np.array(scene.gravity, dtype=float),
        dt=scene.dt,
        region_of_node=region_of_node,
        regions=_regions(moving, scene, joints, frame_rest, region_of_node, rest),
        frame_names=tuple(frames),
        frame_rest=frame_rest,
        joints=joints,
        rigid=rigid_bodies(scene),
        coupling=_coupling(scene, bodies, filling),
    )
    acting = actuators(scene, model, bodies)
    model = replace(model, extra_state=_extra_state(scene, model, acting))
    parameters = Parameters(
        materials=[dict(values) for _, values in scene.materials],
        rayleigh_stiffness=scene.solver.rayleigh_stiffness,
        rayleigh_mass=scene.solver.rayleigh_mass,
    )
    return BuiltScene(model, parameters, bodies, rigid, acting, contact_limits(scene, bodies, rigid))


def _extra_state(scene: SceneDescription, model: Model, acting: Actuators) -> dict[str, tuple[int, ...]]:
    """Return names and shapes of the state besides positions and velocities."""
    shapes: dict[str, tuple[int, ...]] = {}
    if any(map(takes_found_stress, model.groups)):
        shapes[MOVED] = model.rest.shape
    if scene.solver.time_integration == "bossak":
        shapes |= {ACCELERATION: model.rest.shape, REDUCED_ACCELERATION: (model.reduced_size,), HOLDING: (1,)}
    cuts = scene.solver.substeps > 1 and (scene.collisions or torn_by_rough_steps(model.groups))
    if model.joints and cuts:
        shapes |= {COMMANDED: (len(model.joints),), EFFORT_CHANGE: (len(model.joints),)}
    if acting.internal_size:
        shapes[ACTUATOR_STATE] = (acting.internal_size,)
    if acting.passive_size:
        shapes[PASSIVE_EFFORTS] = (acting.passive_size,)
    for k, group in enumerate(model.groups):
        if isinstance(group.material, Relaxing):
            shapes[memory_name(k)] = memory_shape(group)
            shapes[step_stress_name(k)] = (*group.weights.shape, 3, 3)
    return shapes


def with_rest_frames(scene: SceneDescription) -> SceneDescription:
    """Return the same scene with an explicit frame for every free attachment.

    The bodies are read or drawn only if an attachment has no explicit frame.

    Raises:
        SceneError, MeshError: see `build`.
    """
    if all(each.to != "free" or each.frame is not None for each in scene.attachments):
        return scene
    bodies = rest_bodies(scene)
    rest = np.concatenate([body.mesh.points for body in bodies])
    joints = tuple(_joint(joint, scene.joint_names) for joint in scene.joints)
    region_of_node, _, moving = _assign_nodes(scene, bodies, joints, rest)
    frames = _frames(moving, region_of_node, rest)
    attachments = [replace(each, frame=frames.get(each.name, each.frame)) for each in scene.attachments]
    return replace(scene, attachments=tuple(attachments))


def _frames(
    moving: Sequence[AttachmentDescription], region_of_node: IndexArray, rest: Array
) -> dict[str, Placement]:
    """Return every free frame at rest by name: as described, else at the mean of its nodes."""
    frames = {}
    for number, attachment in enumerate(moving):
        if attachment.to == "free":
            x, y, z = rest[region_of_node == number].mean(axis=0).tolist()
            frames[attachment.name] = attachment.frame or Placement(translation=(x, y, z))
    return frames


def rest_bodies(
    scene: SceneDescription, shaped: Sequence[tuple[BodyDescription, Body]] = ()
) -> tuple[Body, ...]:
    """Return the deformable bodies at rest, with their nodes numbered one body after the other.

    Bodies of another scene (`shaped`) are reused where the same mesh begins at the same node.

    Raises:
        MeshError: a mesh cannot be used.
    """
    bodies, start = list[Body](), 0
    for description in scene.bodies:
        body = next(
            (each for other, each in shaped if each.nodes.start == start and _same_mesh(other, description)),
            None,
        )
        if body is None:
            body = _rod(description, start) if description.is_rod else _tetrahedra(description, start)
        bodies.append(body)
        start = body.nodes.stop
    return tuple(bodies)


def _same_mesh(one: BodyDescription, other: BodyDescription) -> bool:
    """Return whether two bodies have the same name and mesh file; arrays and rods are not compared."""
    if not (isinstance(one.mesh, MeshFile) and isinstance(other.mesh, MeshFile)):
        return False
    names = ("name", "mesh", "surface", "order", "element")
    return all(getattr(one, name) == getattr(other, name) for name in names)


def _rod(description: BodyDescription, start: int) -> Body:
    """Build a body of cross-sections, with nodes numbered from `start`."""
    assert description.rod is not None  # checked by the description
    name = description.name
    mesh, sections = draw_rod(description.rod, f"rod {name}", description.material.values)
    surface, embedding = rod_surface(mesh)
    nodes, outside = slice(start, start + len(mesh.points)), node_triangles(mesh) + start
    ends, blocks = (mesh.end_nodes(True), mesh.end_nodes(False)), {SECTION.name: mesh.cells}
    return Body(name, nodes, mesh, outside, surface, embedding, sections, ends=ends, blocks=blocks)


def _tetrahedra(description: BodyDescription, start: int) -> Body:
    """Build a body of tetrahedra, with nodes numbered from `start`."""
    mesh, unloaded, ends = description.mesh, None, None
    if description.rod is not None:
        order = 1 if len(element(description.element or "").reference) == 4 else 2
        swept, unloaded = draw_tetrahedra(description.rod, f"rod {description.name}", order)
        mesh, ends = swept.mesh, swept.ends
    assert mesh is not None  # checked by the description
    if not isinstance(mesh, TetMesh):
        mesh = read_tets(mesh.file, mesh.placement)
    else:
        mesh = drop_unused_nodes(mesh)
    if description.order is not None:
        mesh = linear(mesh) if description.order == 1 else quadratic(mesh)
    for warning in check_tets(mesh).warnings:
        warnings.warn(f"body {description.name}: {warning}", stacklevel=5)
    if description.surface is None:
        surface = boundary_surface(mesh)
    else:
        surface = read_surface(description.surface.file, description.surface.placement)
    nodes, outside = slice(start, start + len(mesh.points)), boundary(mesh) + start
    name, embedding, cells = description.name, embed(surface.points, mesh), _cells(description, mesh)
    return Body(name, nodes, mesh, outside, surface, embedding, unloaded=unloaded, ends=ends, **cells)


def _cells(description: BodyDescription, mesh: TetMesh) -> dict[str, Any]:
    """Return `blocks` and `cell_of_tet` of a body.

    Cells stay whole if an element fills their kind, unless the body names an element of tetrahedra or an
    order.

    Raises:
        SceneError: the body's element fits none of its cells.
    """
    tetrahedra = TETRAHEDRA[mesh.order]
    nodes = {tetrahedra: mesh.tets.shape[1]}
    nodes |= {kind: block.cells.shape[1] for kind, block in mesh.blocks.items()}
    elements = {kind: found for kind in nodes if (found := element_of_kind(kind))}
    fitting: list[str] = []
    if description.element is not None:
        chosen = element(description.element)
        fitting = [kind for kind, count in nodes.items() if count == len(chosen.reference)]
        if not fitting:
            counts = listing(sorted(set(nodes.values())))
            raise SceneError(
                f"body {description.name}: the element {chosen.name} has {len(chosen.reference)} nodes, and "
                f"the cells of its mesh have {counts}; choose another element or mesh"
            )
        elements |= dict.fromkeys(fitting, chosen)
    in_tetrahedra = description.order is not None or tetrahedra in fitting
    fillable = () if in_tetrahedra else tuple(elements)
    cells, cell_of_tet = whole_cells(mesh, fillable)
    if split := [kind for kind in mesh.blocks if kind in fillable and kind not in cells]:
        warnings.warn(
            f"body {description.name}: cells of kind {listing(split)} share faces with cells that are split"
            " into tetrahedra, and are split, too; export a mesh of one kind to have them whole",
            stacklevel=6,
        )
    return {
        "blocks": {elements[kind].name: own for kind, own in cells.items()},
        "cell_of_tet": cell_of_tet,
    }


def _masses(scene: SceneDescription, bodies: tuple[Body, ...], groups: tuple[ElementGroup, ...]) -> Array:
    """Return the masses of all nodes in [kg], shape (n,)."""
    count = bodies[-1].nodes.stop if bodies else 0
    shares = sum((volume_shares(group, count) for group in groups), np.zeros(count))
    mass = np.zeros(count)
    for body, description in zip(bodies, scene.bodies, strict=True):
        own = shares[body.nodes]
        total = description.total_mass
        if total is None:
            assert description.density is not None  # checked by the description
            total = description.density * float(own.sum())
        if description.mass_distribution == "equal":
            mass[body.nodes] = total / len(own)
        else:
            mass[body.nodes] = total / own.sum() * own
        for added in description.added_masses:
            nodes = chosen_nodes(body, added, body.region_points)
            if len(nodes) == 0:
                raise SceneError(
                    f"body {body.name}: no node of it lies inside the region of an added mass; move or "
                    f"enlarge it (the body spans {body.mesh.points.min(0)} to {body.mesh.points.max(0)} m)"
                )
            mass[nodes] += added.mass / len(nodes)
    return mass


def _coupling(
    scene: SceneDescription, bodies: tuple[Body, ...], groups: tuple[ElementGroup, ...]
) -> MassCoupling | None:
    """Return the mass of consistent bodies beyond the lumped mass; None: there are no such bodies."""
    consistent = [each.mass_distribution == "consistent" for each in scene.bodies]
    if not any(consistent):
        return None
    volumes = np.zeros(len(bodies))
    for group in groups:
        volumes += np.bincount(group.body, group.volumes, minlength=len(bodies))
    density = np.zeros(len(bodies))
    for b, each in enumerate(scene.bodies):
        density[b] = (each.total_mass or 0.0) / volumes[b] if each.density is None else each.density
    chosen = [group.part(np.flatnonzero(np.array(consistent)[group.body])) for group in groups]
    chosen = [group for group in chosen if len(group.cells)]
    for group in chosen:
        if group.element.mass_matrix is None:
            raise SceneError(
                f"body {bodies[group.body[0]].name}: element {group.element.name} has no mass_matrix, "
                "which mass_distribution consistent needs; set it to volume"
            )
    return mass_coupling(chosen, [density[group.body] for group in chosen], bodies[-1].nodes.stop)


def _groups(scene: SceneDescription, bodies: tuple[Body, ...]) -> tuple[ElementGroup, ...]:
    """Return the cells of all bodies, one group for each pair of element and law that occurs."""
    unloaded = [body.mesh.points if body.unloaded is None else body.unloaded for body in bodies]
    points = np.concatenate([np.zeros((0, 3)), *unloaded])
    ends = np.cumsum([body.cell_count for body in bodies])
    owners = [owner for owner, _ in scene.materials]
    laws = scene.laws
    members: dict[tuple[str, str], list[tuple[int, int, IndexArray, IndexArray]]] = {}
    for b, description in enumerate(scene.bodies):
        if description.is_rod:
            continue
        firsts = np.cumsum([0, *map(len, bodies[b].blocks.values())])
        for owner, made_of, inside in material_parts(description, bodies[b]):
            number = owners.index(owner)
            locking: set[str | None] = set()
            for name, first, end in zip(bodies[b].blocks, firsts[:-1], firsts[1:], strict=True):
                own = inside[(first <= inside) & (inside < end)]
                if len(own):
                    locking.add(locking_warning(element(name), made_of.values))
                    members.setdefault((name, laws[number].name), []).append((b, number, own, own - first))
            for warning in (*locking, made_of.warning):
                if warning:
                    warnings.warn(f"body {owner}: {warning}", stacklevel=4)
    groups = []
    for (cell_name, _), parts in members.items():
        cells = [bodies[b].blocks[cell_name][rows] + bodies[b].nodes.start for b, _, _, rows in parts]
        numbers = [ends[b] - bodies[b].cell_count + inside for b, _, inside, _ in parts]
        counts = [len(rows) for *_, rows in parts]
        kind, law, body = element(cell_name), laws[parts[0][1]], np.repeat([b for b, *_ in parts], counts)
        group = element_group(kind, law, points, np.concatenate(cells), body, np.concatenate(numbers))
        sets = np.repeat([number for _, number, *_ in parts], counts)
        groups.append(replace(group, parameter_set=sets))
    rods = []
    for b, each in enumerate(bodies):
        if isinstance(each.mesh, RodMesh):
            assert each.sections is not None  # as all rods have
            first = int(ends[b]) - each.cell_count
            rods.append(rod_group(each.mesh, each.sections, SECTION, each.nodes.start, b, first))
    return (*groups, join_rods(rods)) if rods else tuple(groups)


def _joint(joint: JointDescription, names: tuple[str, ...]) -> Joint:
    return Joint(
        name=joint.name,
        revolute=joint.kind == "revolute",
        base_position=np.array(joint.base.translation, dtype=float),
        base_rotation=rotation_euler(np.radians(joint.base.rotation_deg)),
        axis=np.array(joint.axis, dtype=float),
        slide_axis=np.array(joint.slide_axis, dtype=float),
        limits=joint.limits,
        rest=joint.rest,
        stiffness=joint.stiffness,
        inertia=joint.inertia,
        parent=-1 if joint.parent is None else names.index(joint.parent),
        moves_frame=joint.moves_frame,
    )


def _assign_nodes(
    scene: SceneDescription, bodies: tuple[Body, ...], joints: tuple[Joint, ...], rest: Array
) -> tuple[IndexArray, Array, list[AttachmentDescription]]:
    """Return region number and fixing spring of each node, and the moving attachments in region order."""
    region_of_node = np.full(len(rest), FREE, dtype=np.int64)
    spring = np.zeros(len(rest))
    owner: dict[int, str] = {}
    moving: list[AttachmentDescription] = []
    for attachment in scene.attachments:
        body = next(body for body in bodies if body.name == attachment.body)
        points = body.region_points
        if attachment.relative_to is not None:
            base = joints[scene.joint_names.index(attachment.relative_to)]
            points = (points - base.base_position) @ base.base_rotation
        nodes = chosen_nodes(body, attachment, points)
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
            region_of_node[nodes] = FIXED
        else:
            region_of_node[nodes] = len(moving)
            moving.append(attachment)
    return region_of_node, spring, moving


def chosen_nodes(
    body: Body, chosen: AttachmentDescription | AddedMassDescription, points: Array
) -> IndexArray:
    """Return the nodes in a region, at an end or in a group of a body with nodes at `points` (n, 3)."""
    if chosen.end is not None:
        assert body.ends is not None  # checked by the description
        return np.asarray(body.nodes.start + body.ends[chosen.end == "end"])
    if chosen.group is not None:
        groups = body.mesh.groups if isinstance(body.mesh, TetMesh) else {}
        if chosen.group not in groups:
            hint = known_names(chosen.group, groups, "its groups are")
            raise SceneError(f"body {body.name}: its mesh has no group {chosen.group!r}; {hint}")
        return np.asarray(groups[chosen.group] + body.nodes.start)
    region = chosen.box or chosen.sphere
    assert region is not None  # checked by the description
    return np.asarray(nodes_in(region, points) + body.nodes.start)


def on_a_line(points: Array) -> bool:
    """Return whether points (n, 3) in [m] lie on one line."""
    return bool(np.linalg.matrix_rank(points - points.mean(axis=0), tol=1e-9) < 2)


def _regions(
    moving: list[AttachmentDescription],
    scene: SceneDescription,
    joints: tuple[Joint, ...],
    frame_rest: tuple[Array, Array],
    region_of_node: IndexArray,
    rest: Array,
) -> tuple[RigidRegion, ...]:
    frames = [attachment.name for attachment in moving if attachment.to == "free"]
    regions = []
    for number, attachment in enumerate(moving):
        nodes = np.flatnonzero(region_of_node == number)
        frame = attachment.name if attachment.to == "free" else attachment.to
        if frame in frames:
            f, j = frames.index(frame), -1
            origin, rotation = frame_rest[0][f], frame_rest[1][f]
            reduced = 6 * f + np.arange(6)
            if attachment.to == "free" and on_a_line(rest[nodes]):
                raise SceneError(
                    f"attachment {attachment.name}: the {len(nodes)} nodes of a free frame lie on one line, "
                    "so its rotation is not determined; enlarge its region"
                )
        else:
            f, j = -1, scene.joint_names.index(attachment.to)
            origin, rotation = joints[j].frame(joints[j].rest, joints[j].base_position, 0.0)
            chain = [j]
            while joints[chain[0]].parent >= 0:
                chain.insert(0, joints[chain[0]].parent)
            reduced = 6 * len(frames) + np.array(chain)
        regions.append(RigidRegion(attachment.name, f, j, nodes, (rest[nodes] - origin) @ rotation, reduced))
    return tuple(regions)


def sensors(scene: SceneDescription, built: BuiltScene, collisions: CollisionModel | None) -> Sensors:
    """Return all sensors of a scene before their first measurement.

    Raises:
        SceneError: one does not fit the scene.
    """
    if not scene.sensors:
        return Sensors((), scene.dt)
    model, rest = built.model, built.model.rest_state()
    built.actuators.measure(model, rest)
    scenery = Scenery(
        soft=surroundings(model, built.bodies),
        body_names=scene.body_names,
        places=_places(scene, built),
        surfaces=() if collisions is None else collisions.surfaces,
        points=np.zeros((0, 3)) if collisions is None else collisions.points(rest),
        actuators={view.name: view for view in built.actuators.views(model, rest)},
    )
    found = [(each, sensor_kind(each.kind).build(each, scenery)) for each in scene.sensors]
    return Sensors(found, scene.dt)


def _places(scene: SceneDescription, built: BuiltScene) -> dict[str, Place]:
    """Return rigidly moving parts by name; attachments have priority over joints, joints over bodies."""
    frames = {name: Carrier(frame=f) for f, name in enumerate(built.model.frame_names)}
    moving = [(j, joint.name) for j, joint in enumerate(scene.joints) if joint.moves_frame]
    horns = {name: Carrier(joint=j) for j, name in moving}
    bases = {f"{name}_base": Carrier(base=j) for j, name in moving}
    carriers = {"world": Carrier(), **bases, **horns, **frames}
    places = {}
    for body in built.rigid:
        if body.free >= 0:
            places[body.name] = Place(Carrier(rigid=body.free))
        else:
            places[body.name] = Place(carriers[body.on], body.position, body.rotation)
    places |= {name: Place(carrier) for name, carrier in carriers.items()}
    return places | {each.name: Place(carriers[each.to]) for each in scene.attachments if each.to != "free"}
