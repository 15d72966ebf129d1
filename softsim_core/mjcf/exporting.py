"""From a scene of ours to a MuJoCo model: soft bodies as flexes, rigid ones as geoms, joints and cables."""

from __future__ import annotations

from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from softsim_core.arrays import Array
from softsim_core.errors import MjcfError
from softsim_core.fem.materials.tension import rest_stiffness
from softsim_core.mechanics.model import FIXED, FREE
from softsim_core.mesh.rods import RodMesh
from softsim_core.mjcf.driven import add_cables, add_servos, joint_attributes
from softsim_core.mjcf.elements import Draft, add, words
from softsim_core.mjcf.masks import masks
from softsim_core.mjcf.reading import Told
from softsim_core.mjcf.solids import add_rigid_bodies
from softsim_core.scene.builder import BuiltScene, build
from softsim_core.scene.deformable import BodyDescription
from softsim_core.scene.description import SceneDescription

ITERATIONS = 3000
"""Most iterations of MuJoCo's solve of a step; its own 100 leave soft bodies unsolved."""
_EXACT_LAW = "saint_venant_kirchhoff"
_SAME_AT_REST = ("corotational", "corotational_qr", "stable_neo_hookean")
_POINT_INERTIA = 1.67e-5
"""Inertia of a vertex per mass in [m^2]: it never turns, but MuJoCo wants one."""
_LIGHT_KG = 1e-6
_THIN_M = 1e-4


@dataclass(frozen=True, slots=True)
class ExportedModel:
    """A scene as a MuJoCo model.

    Attributes:
        text: The MJCF document.
        told: What MuJoCo has nothing for, or does otherwise, a sentence each.
    """

    text: str
    told: tuple[str, ...]


def export_mjcf(scene: SceneDescription, iterations: int = ITERATIONS) -> ExportedModel:
    """A scene as a MuJoCo model; vertices of its flexes are our nodes, in our order.

    Args:
        scene: The scene; its soft bodies are of linear tetrahedra.
        iterations: Most iterations of a step's solve.

    Raises:
        MjcfError: it holds a body that MuJoCo has nothing for.
        SceneError, MeshError: it cannot be built.
    """
    built = build(scene)
    _check(built, scene.name)
    told = Told()
    _tell(scene, told)
    root = ElementTree.Element("mujoco", model=scene.name)
    add(root, "compiler", angle="radian")
    option = add(
        root,
        "option",
        timestep=words([scene.dt]),
        gravity=words(scene.gravity),
        integrator="discrete",
        iterations=str(iterations),
    )
    if scene.joints or built.model.frame_names:
        option.set("solver", "CG")  # MuJoCo 3 has no other one where vertices or tendons hang on what moves
    if not scene.collisions:
        add(option, "flag", contact="disable")
    draft = Draft(scene, built, root, add(root, "worldbody"), told, masks(scene, told), {})
    _add_carriers(draft)
    add_rigid_bodies(draft)
    flexes = add(root, "deformable") if scene.bodies else root
    for b in range(len(scene.bodies)):
        _add_flex(draft, flexes, b)
    add_servos(draft)
    add_cables(draft)
    ElementTree.indent(root)
    return ExportedModel(ElementTree.tostring(root, encoding="unicode") + "\n", tuple(told.lines))


def _check(built: BuiltScene, name: str) -> None:
    for body in built.bodies:
        if isinstance(body.mesh, RodMesh):
            raise MjcfError(name, f"body {body.name} is a rod, which no flex here stands for; leave it out")
        if body.mesh.order == 2:
            raise MjcfError(name, f"body {body.name} has quadratic cells, MuJoCo linear ones; set `order: 1`")


def _tell(scene: SceneDescription, told: Told) -> None:
    for body in scene.bodies:
        law = body.material.law_for(scene.solver.rotation).name
        if law in _SAME_AT_REST:
            told.say(f"body {body.name}", f"law {law}: MuJoCo's {_EXACT_LAW} is the same at small strain")
        elif law != _EXACT_LAW:
            told.say(f"body {body.name}", f"law {law}: the model has its stiffness at rest")
        for each in body.reinforcements:
            told.say(f"body {body.name}", f"{each.name}: layers and fibres are not in the model")
        for region in body.regions:
            told.say(f"body {body.name}", f"{region.name}: a flex is of one material, that of the body")
        if body.mass_distribution == "consistent":
            told.say(f"body {body.name}", "consistent mass: each vertex has its share by volume in the model")
        if any(body.velocity):
            told.say(f"body {body.name}", "velocity: everything starts without in the model")
    if scene.bodies and scene.solver.rayleigh_mass > 0.0:
        told.say("solver", "rayleigh_mass: MuJoCo's flexes have no damping per mass")
    for sensor in scene.sensors:
        told.say(f"sensor {sensor.name}", "is not in the model")
    if scene.bodies and not scene.collisions and any(each.shape.plane for each in scene.rigid_bodies):
        told.say("contact", "nothing collides in the scene, so nothing does in the model")


def _add_carriers(draft: Draft) -> None:
    """A body for each joint and each free frame, with the mass of the nodes that it carries."""
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
        add(body, "joint", **joint_attributes(model, j, joint))
        draft.carriers[joint.name] = (body, np.asarray(origin))
        nodes = [region.nodes for region in model.regions if region.joint == j]
        _add_inertial(draft, body, np.concatenate([*nodes, np.zeros(0, dtype=np.int64)]), origin)


def _add_inertial(draft: Draft, body: ElementTree.Element, nodes: Array, origin: Array) -> None:
    """Mass and inertia of nodes that move as one, and a little more, which MuJoCo asks for."""
    model = draft.built.model
    mass, arms = model.mass[nodes], model.rest[nodes] - origin
    total = float(mass.sum())
    centre = mass @ arms / total if total > 0.0 else np.zeros(3)
    arms = arms - centre
    second = np.einsum("k,ki,kj->ij", mass, arms, arms)
    inertia = np.trace(second) * np.eye(3) - second + _LIGHT_KG * _POINT_INERTIA * np.eye(3)
    add(
        body,
        "inertial",
        pos=words(centre),
        mass=words([total + _LIGHT_KG]),
        fullinertia=words(inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]),
    )


def _add_flex(draft: Draft, flexes: ElementTree.Element, b: int) -> None:
    """A soft body: a body with three slides for each node that moves by itself, and the cells."""
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
    mask = draft.masks[body.name]
    flex = add(
        flexes,
        "flex",
        name=body.name,
        dim="3",
        radius=words([max(draft.built.contact.contact_distance, _THIN_M)]),
        rgba=words(description.colour),
        body=" ".join(owners),
        vertex=words(local),
        element=words(body.cells[:, [0, 1, 3, 2]]),  # MuJoCo winds them the other way
    )
    add(
        flex,
        "contact",
        selfcollide="none",
        contype=str(mask.own),
        conaffinity=str(mask.others),
        friction=words([draft.scene.contact.friction, 0.005, 0.0001]),
    )
    young, poisson = _moduli(draft, description)
    damp = draft.scene.solver.rayleigh_stiffness
    add(flex, "elasticity", young=words([young]), poisson=words([poisson]), damping=words([damp]))


def _add_point(draft: Draft, name: str, n: int) -> str:
    """A node that moves by itself; its name."""
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
    """Young modulus in [Pa] and Poisson ratio of the law at rest."""
    law = description.material.law_for(draft.scene.solver.rotation)
    values = np.array(list(description.material.values.values()))
    if law.name in (_EXACT_LAW, *_SAME_AT_REST):
        return float(description.material.young_modulus), float(description.material.poisson_ratio)
    at_rest = rest_stiffness(law, values)
    return at_rest.young, at_rest.poisson
