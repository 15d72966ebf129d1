"""Export of a scene to a MuJoCo model: soft bodies as flexes, rigid ones as geoms, joints and cables."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree

import numpy as np

from softsim_core.base import Array, FormerAttribute, MjcfError, listing
from softsim_core.mjcf.reading import ConversionNotes
from softsim_core.physics.actuation import Route
from softsim_core.physics.fem.materials import rest_stiffness
from softsim_core.physics.mechanics import FIXED, FREE, quaternion_of
from softsim_core.physics.mesh import RodMesh
from softsim_core.scene import BodyDescription, JointDescription, RigidBodyDescription, SceneDescription
from softsim_core.scene.building import BuiltScene, RigidBody, build

_BITS = 31


@dataclass(frozen=True, slots=True)
class Mask:
    """MuJoCo's contype and conaffinity."""

    own: int = 0
    others: int = 0


def masks(scene: SceneDescription, notes: ConversionNotes) -> dict[str, Mask]:
    """Return a bit for each body with collision surfaces, and the bits of the bodies that it touches."""
    groups: dict[str, list[frozenset[str]]] = {name: [] for name in scene.body_names}
    for collision in scene.collisions:
        groups[collision.body].append(frozenset(collision.groups))
        if collision.surface is not None or collision.boxes or collision.faces is not None:
            notes.say(f"collision {collision.name}", "the whole surface of its body touches in the model")
    touching = [name for name, each in groups.items() if each]
    if len(touching) > _BITS:
        note = f"all of the {len(touching)} bodies with a surface may touch each other in the model"
        notes.say("collisions", note)
        return {name: Mask(int(bool(each)), int(bool(each))) for name, each in groups.items()}
    bit = {name: 1 << k for k, name in enumerate(touching)}
    result = {}
    for name, own in groups.items():
        met = [
            other
            for other in touching
            if other != name and any(not a & b for a in own for b in groups[other])
        ]
        result[name] = Mask(bit.get(name, 0), sum(bit[other] for other in met))
    return result


@dataclass(frozen=True, slots=True, eq=False)
class Draft:
    """A model under construction.

    Attributes:
        scene, built: The exported scene.
        root, world: The document, and its element `worldbody`.
        notes: Messages on parts that MuJoCo does not support.
        masks: Collision masks by the names of bodies.
        carriers: Element and origin in [m], shape (3,), of the bodies that move with each joint and frame; no
            body of the document is rotated at the start.
    """

    scene: SceneDescription
    built: BuiltScene
    root: ElementTree.Element
    world: ElementTree.Element
    notes: ConversionNotes
    masks: dict[str, Mask]
    carriers: dict[str, tuple[ElementTree.Element, Array]]

    def section(self, tag: str) -> ElementTree.Element:
        """Return the one element of a tag below the root."""
        found = self.root.find(tag)
        return add(self.root, tag) if found is None else found


def add(parent: ElementTree.Element, tag: str, /, **attributes: str) -> ElementTree.Element:
    """Create an element below another one."""
    return ElementTree.SubElement(parent, tag, attributes)


def words(numbers: Any) -> str:
    """Format numbers for MJCF without loss."""
    return " ".join(repr(number) for number in np.asarray(numbers).ravel().tolist())


_FIRM = {"revolute": 1e3, "prismatic": 1e5}
"""Stiffness in [N m/rad] or [N/m] of servos that are rigid in our scenes."""
_TIGHT = 1e5
"""Stiffness in [N/m] of cables that are rigid in our scenes."""
_STILL_KG_M2 = 1e-4


def add_servos(draft: Draft) -> None:
    """Add a position actuator for each joint that moves a frame; report other joints."""
    for joint in draft.scene.joints:
        if joint.moves_frame:
            called, stiffness = f"joint {joint.name}", joint.stiffness or _FIRM[joint.kind]
            servo = add(draft.section("actuator"), "position", name=joint.name, joint=joint.name)
            servo.set("kp", words([stiffness]))
            if not joint.stiffness:
                servo.set("dampratio", "1")
            if joint.stiffness is None:
                draft.notes.say(called, f"follows its command with {stiffness:g} N·m/rad (N/m) there")
            if joint.rest:
                draft.notes.say(called, f"set its control to {joint.rest:g}, where it starts")
            if any(joint.base.rotation_deg) or joint.limits.speed < math.inf:
                draft.notes.say(called, "has no limit of speed in the model")
        elif joint.actuator is None or joint.actuator.route is None:
            draft.notes.say(f"joint {joint.name}", f"kind {joint.kind}: MuJoCo has nothing for it")


def _add_cable(draft: Draft, joint: JointDescription, cable: Route) -> None:
    """Add a tendon through the points of a cable, with its actuator."""
    body = next(k for k, each in enumerate(draft.scene.bodies) if each.name == cable.body)
    points = cable.points(draft.built.bodies[body].solid)
    tendon = add(draft.section("tendon"), "spatial", name=joint.name)
    places: list[tuple[Array, str]] = [(point, _owner(draft, body, point)) for point in points]
    if cable.pull_point is not None:
        outside = (cable.pull_point, *cable.guides)
        places[:0] = [(np.array(point), cable.pull_on or "world") for point in outside]
    for k, (point, owner) in enumerate(places):
        _add_site(draft, f"{joint.name}_{k}", point, owner)
        add(tendon, "site", site=f"{joint.name}_{k}")
    draft.notes.say(f"cable {joint.name}", "its points sit on the nearest nodes in the model")
    if cable.special:
        draft.notes.say(f"cable {joint.name}", f"the model is without its {listing(cable.special)}")
    if not cable.pull_only:
        draft.notes.say(f"cable {joint.name}", "pushes, too: in the model it pulls only")
    most = cable.largest_force or 1e6
    length = float(np.linalg.norm(np.diff([place for place, _ in places], axis=0), axis=1).sum())
    rest = cable.rest_length or length
    upper = joint.limits.upper
    if not math.isfinite(upper):
        upper = most if joint.by_effort else rest
    kind = "motor" if joint.by_effort else "general"
    acting = add(draft.section("actuator"), kind, name=joint.name, tendon=joint.name, gear="-1")
    if joint.by_effort:
        acting.set("ctrlrange", words([0.0, upper]))
        return
    draft.notes.say(f"cable {joint.name}", f"holds its displacement with {_TIGHT:g} N/m in the model")
    acting.set("gainprm", words([_TIGHT]))
    acting.set("biastype", "affine")
    acting.set("biasprm", words([-_TIGHT * rest, -_TIGHT, 0.0]))
    acting.set("forcerange", words([0.0, most]))
    acting.set("ctrlrange", words([max(joint.limits.lower, -rest), upper]))


def _owner(draft: Draft, body: int, point: Array) -> str:
    """Return the body of a soft body's node nearest to a point."""
    model, own = draft.built.model, draft.built.bodies[body]
    nearest = int(np.argmin(np.linalg.norm(model.rest[own.nodes] - point, axis=1)))
    region = int(model.region_of_node[own.nodes.start + nearest])
    if region == FREE:
        return f"{own.name}_{nearest}"
    return "world" if region == FIXED else _carrier_name(draft, region)


def _add_site(draft: Draft, name: str, point: Array, owner: str) -> None:
    if owner == "world":
        add(draft.world, "site", name=name, pos=words(point))
    elif owner in draft.carriers:
        element, origin = draft.carriers[owner]
        add(element, "site", name=name, pos=words(point - origin))
    else:
        element = next(each for each in draft.world if each.get("name") == owner)
        start = np.array([float(word) for word in element.get("pos", "0 0 0").split()])
        add(element, "site", name=name, pos=words(point - start))


def add_rigid_bodies(draft: Draft) -> None:
    """Add free rigid bodies as bodies of their own, and the others as geoms of their carriers."""
    model, weights = draft.built.model, draft.built.model.rigid
    for description, body in zip(draft.scene.rigid_bodies, draft.built.rigid, strict=True):
        if body.free >= 0:
            element = add(draft.world, "body", name=body.name, pos=words(body.position))
            element.set("quat", _quaternion(body.rotation))
            add(element, "freejoint", name=f"{body.name}_free")
            _add_mass(element, np.zeros(3), weights.mass[body.free], weights.inertia[body.free])
            _add_geom(draft, element, description, body, (np.zeros(3), np.eye(3)))
            if any((*description.velocity, *description.angular_velocity)):
                draft.notes.say(f"rigid body {body.name}", "velocity: everything starts without in the model")
            continue
        carrier, pose = draft.world, (body.position, body.rotation)
        joints = {joint.name: j for j, joint in enumerate(model.joints)}
        name = body.on.removesuffix("_base") if body.on not in draft.carriers else body.on
        if name in draft.carriers:
            origin, rotation = _frame(draft, body.on, joints)
            if body.on in draft.carriers:
                carrier, below = draft.carriers[body.on]
            else:  # the base of a joint is carried by the joint's carrier
                parent = draft.scene.joints[joints[name]].parent
                carrier, below = draft.carriers.get(parent or "", (draft.world, np.zeros(3)))
            pose = (origin + rotation @ body.position - below, rotation @ body.rotation)
        _add_geom(draft, carrier, description, body, pose)


def _frame(draft: Draft, on: str, joints: dict[str, int]) -> tuple[Array, Array]:
    """Return the initial world pose of a frame, a joint's frame or a joint's base."""
    model = draft.built.model
    if on in model.frame_names:
        f = model.frame_names.index(on)
        return model.frame_rest[0][f], model.frame_rest[1][f]
    if on in joints:
        return model.joint_frame(joints[on], model.rest_state())
    joint = model.joints[joints[on.removesuffix("_base")]]
    return joint.base_position, joint.base_rotation


def _quaternion(rotation: Array) -> str:
    x, y, z, w = quaternion_of(rotation)
    return words([w, x, y, z])


def _add_geom(
    draft: Draft,
    parent: ElementTree.Element,
    description: RigidBodyDescription,
    body: RigidBody,
    pose: tuple[Array, Array],
) -> None:
    shape, mask = description.shape, draft.masks[body.name]
    if shape.sphere is not None:
        kind, size = "sphere", [shape.sphere]
    elif shape.box is not None:
        kind, size = "box", [0.5 * each for each in shape.box]
    elif shape.cylinder is not None:
        kind, size = "cylinder", [shape.cylinder[0], 0.5 * shape.cylinder[1]]
    elif shape.plane is not None:
        kind, size = "plane", [0.5 * shape.plane[0], 0.5 * shape.plane[1], 0.1]
    else:
        kind, size = "mesh", []
        points, triangles = words(body.surface.points), words(body.surface.triangles)
        add(draft.section("asset"), "mesh", name=body.name, vertex=points, face=triangles)
        if mask.own:
            draft.notes.say(f"rigid body {body.name}", "touches with the convex hull of its mesh in MuJoCo")
    if kind == "plane" and parent is not draft.world:
        draft.notes.say(f"rigid body {body.name}", "a plane that moves is a thin box in the model")
        kind, size = "box", [*size[:2], 0.0005]
    place, turn = words(pose[0]), _quaternion(pose[1])
    geom = add(parent, "geom", name=body.name, type=kind, pos=place, quat=turn, mass="0")
    _set_contact(draft, geom, mask)
    geom.set("rgba", words(description.colour))
    if size:
        geom.set("size", words(size))
    else:
        geom.set("mesh", body.name)


def _set_contact(draft: Draft, element: ElementTree.Element, mask: Mask) -> None:
    element.set("contype", str(mask.own))
    element.set("conaffinity", str(mask.others))
    element.set("friction", words([draft.scene.contact.friction, 0.005, 0.0001]))


ITERATIONS = 3000
"""Largest number of iterations of MuJoCo's solver per step; its default 100 leaves soft bodies unsolved."""
_EXACT_LAW = "saint_venant_kirchhoff"
_SAME_AT_REST = ("corotational", "corotational_qr", "stable_neo_hookean")
_POINT_INERTIA = 1.67e-5
"""Inertia of a vertex per mass in [m^2]: a vertex never rotates, but MuJoCo requires an inertia."""
_LIGHT_KG = 1e-6
_THIN_M = 1e-4


@dataclass(frozen=True, slots=True)
class ExportedModel:
    """The MJCF document of a scene, and remarks on parts that MuJoCo lacks or treats differently."""

    text: str
    remarks: tuple[str, ...]
    told = FormerAttribute("remarks")


def export_mjcf(scene: SceneDescription, iterations: int = ITERATIONS) -> ExportedModel:
    """Export a scene as a MuJoCo model; the vertices of its flexes are our nodes, in our order.

    The soft bodies must consist of linear tetrahedra. `iterations` is the most that a step's solver makes.

    Raises:
        MjcfError: it contains a body that MuJoCo does not support.
        SceneError, MeshError: it cannot be built.
    """
    built = build(scene)
    _check(built, scene.name)
    notes = ConversionNotes()
    _note_differences(scene, notes)
    root = ElementTree.Element("mujoco", model=scene.name)
    add(root, "compiler", angle="radian")
    option = add(root, "option", timestep=words([scene.dt]), gravity=words(scene.gravity))
    option.set("integrator", "discrete")
    option.set("iterations", str(iterations))
    if scene.joints or built.model.frame_names:
        option.set("solver", "CG")  # the only solver of MuJoCo 3 for vertices or tendons on moving bodies
    if not scene.collisions:
        add(option, "flag", contact="disable")
    draft = Draft(scene, built, root, add(root, "worldbody"), notes, masks(scene, notes), {})
    _add_carriers(draft)
    add_rigid_bodies(draft)
    flexes = add(root, "deformable") if scene.bodies else root
    for b in range(len(scene.bodies)):
        _add_flex(draft, flexes, b)
    add_servos(draft)
    for joint in scene.joints:
        if joint.actuator is not None and (route := joint.actuator.route) is not None:
            _add_cable(draft, joint, route)
    ElementTree.indent(root)
    return ExportedModel(ElementTree.tostring(root, encoding="unicode") + "\n", tuple(notes.lines))


def _check(built: BuiltScene, name: str) -> None:
    for body in built.bodies:
        if isinstance(body.mesh, RodMesh):
            raise MjcfError(name, f"body {body.name} is a rod, which no flex here stands for; leave it out")
        if any(cells.shape[1] != 4 for cells in body.blocks.values()):
            kinds = listing(body.blocks)
            raise MjcfError(name, f"body {body.name} has cells {kinds}, MuJoCo only tet4; set `order: 1`")


def _note_differences(scene: SceneDescription, notes: ConversionNotes) -> None:
    for body in scene.bodies:
        law = body.material.law_for(scene.solver.rotation).name
        if law in _SAME_AT_REST:
            notes.say(f"body {body.name}", f"law {law}: MuJoCo's {_EXACT_LAW} is the same at small strain")
        elif law != _EXACT_LAW:
            notes.say(f"body {body.name}", f"law {law}: the model has its stiffness at rest")
        for each in body.reinforcements:
            notes.say(f"body {body.name}", f"{each.name}: layers and fibres are not in the model")
        for region in body.regions:
            notes.say(f"body {body.name}", f"{region.name}: a flex is of one material, that of the body")
        if body.mass_distribution == "consistent":
            note = "consistent mass: each vertex has its share by volume in the model"
            notes.say(f"body {body.name}", note)
        if any(body.velocity):
            notes.say(f"body {body.name}", "velocity: everything starts without in the model")
    if scene.bodies and scene.solver.rayleigh_mass > 0.0:
        notes.say("solver", "rayleigh_mass: MuJoCo's flexes have no damping per mass")
    for sensor in scene.sensors:
        notes.say(f"sensor {sensor.name}", "is not in the model")
    if scene.bodies and not scene.collisions and any(each.shape.plane for each in scene.rigid_bodies):
        notes.say("contact", "nothing collides in the scene, so nothing does in the model")


def _add_carriers(draft: Draft) -> None:
    """Add a body for each joint and each free frame, with the mass of the nodes that it carries."""
    model, scene = draft.built.model, draft.scene
    start = model.rest_state()
    for f, name in enumerate(model.frame_names):
        nodes = [region.nodes for region in model.regions if region.frame == f]
        body = add(draft.world, "body", name=name, pos=words(model.frame_rest[0][f]))
        add(body, "freejoint", name=f"{name}_free")
        draft.carriers[name] = (body, np.array(model.frame_rest[0][f]))
        _add_inertial(draft, body, np.concatenate(nodes), model.frame_rest[0][f])
    for j, joint in enumerate(scene.joints):
        if not joint.moves_frame:
            continue
        origin, _ = model.joint_frame(j, start)
        parent, below = draft.carriers.get(joint.parent or "", (draft.world, np.zeros(3)))
        body = add(parent, "body", name=joint.name, pos=words(origin - below))
        moving = add(body, "joint", name=joint.name, type="hinge" if joint.kind == "revolute" else "slide")
        moving.set("axis", words(model.joints[j].base_rotation @ model.joints[j].axis))
        moving.set("ref", words([joint.rest]))
        moving.set("armature", words([joint.inertia or (0.0 if joint.stiffness else _STILL_KG_M2)]))
        if math.isfinite(joint.limits.lower) and math.isfinite(joint.limits.upper):
            moving.set("range", words([joint.limits.lower, joint.limits.upper]))
        draft.carriers[joint.name] = (body, np.asarray(origin))
        nodes = [region.nodes for region in model.regions if region.joint == j]
        _add_inertial(draft, body, np.concatenate([*nodes, np.zeros(0, dtype=np.int64)]), origin)


def _add_inertial(draft: Draft, body: ElementTree.Element, nodes: Array, origin: Array) -> None:
    """Add mass and inertia of rigidly connected nodes, and the small inertia that MuJoCo requires."""
    model = draft.built.model
    mass, arms = model.mass[nodes], model.rest[nodes] - origin
    total = float(mass.sum())
    centre = mass @ arms / total if total > 0.0 else np.zeros(3)
    arms = arms - centre
    second = np.einsum("k,ki,kj->ij", mass, arms, arms)
    inertia = np.trace(second) * np.eye(3) - second + _LIGHT_KG * _POINT_INERTIA * np.eye(3)
    _add_mass(body, centre, total + _LIGHT_KG, inertia)


def _add_mass(body: ElementTree.Element, centre: Array, mass: float, inertia: Array) -> None:
    """Add a mass in [kg] with its centre and its inertia (3, 3) in [kg m^2]."""
    upper = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    add(body, "inertial", pos=words(centre), mass=words([mass]), fullinertia=words(upper))


def _add_flex(draft: Draft, flexes: ElementTree.Element, b: int) -> None:
    """Add a soft body: a body with three slides for each free node, and the cells."""
    model, body, description = draft.built.model, draft.built.bodies[b], draft.scene.bodies[b]
    owners, local = [], []
    for n in range(body.nodes.start, body.nodes.stop):
        region = int(model.region_of_node[n])
        if region == FREE:
            owners.append(_add_point(draft, f"{body.name}_{n - body.nodes.start}", n))
            local.append(np.zeros(3))
        elif region == FIXED:
            owners.append("world")
            local.append(model.rest[n])
        else:
            name = _carrier_name(draft, region)
            owners.append(name)
            local.append(model.rest[n] - draft.carriers[name][1])
    radius, colour = max(draft.built.contact.contact_distance, _THIN_M), words(description.colour)
    flex = add(flexes, "flex", name=body.name, dim="3", radius=words([radius]), rgba=colour)
    flex.set("body", " ".join(owners))
    flex.set("vertex", words(local))
    flex.set("element", words(body.solid.tets[:, [0, 1, 3, 2]]))  # MuJoCo orders the corners the other way
    _set_contact(draft, add(flex, "contact", selfcollide="none"), draft.masks[body.name])
    young, poisson = _moduli(draft, description)
    damp = draft.scene.solver.rayleigh_stiffness
    add(flex, "elasticity", young=words([young]), poisson=words([poisson]), damping=words([damp]))


def _add_point(draft: Draft, name: str, n: int) -> str:
    """Add a free node; return its name."""
    model = draft.built.model
    mass = float(model.mass[n])
    body = add(draft.world, "body", name=name, pos=words(model.rest[n]))
    add(body, "inertial", pos="0 0 0", mass=words([mass]), diaginertia=words([_POINT_INERTIA * mass] * 3))
    more = {"stiffness": words([model.spring[n]])} if model.spring[n] > 0.0 else {}
    for axis in ("1 0 0", "0 1 0", "0 0 1"):
        add(body, "joint", type="slide", axis=axis, **more)
    return name


def _carrier_name(draft: Draft, region: int) -> str:
    model = draft.built.model
    moved = model.regions[region]
    return model.frame_names[moved.frame] if moved.frame >= 0 else model.joints[moved.joint].name


def _moduli(draft: Draft, description: BodyDescription) -> tuple[float, float]:
    """Return Young modulus in [Pa] and Poisson ratio of the law at rest."""
    law = description.material.law_for(draft.scene.solver.rotation)
    values = np.array(list(description.material.values.values()))
    if law.name in (_EXACT_LAW, *_SAME_AT_REST):
        return float(description.material.young_modulus), float(description.material.poisson_ratio)
    at_rest = rest_stiffness(law, values)
    return at_rest.young, at_rest.poisson
