"""Edits that add a part to a scene or take one out, with all that has to follow from it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import count
from typing import Any, Literal

from softsim_core.actuation.cable.builder import cable_points
from softsim_core.actuation.cable.description import CableDescription
from softsim_core.editing.edits import Edit, Put, Remove
from softsim_core.editing.regions import plain_masses, plain_shape, plain_vector
from softsim_core.errors import SceneError
from softsim_core.scene.overrides import Item
from softsim_core.scene.robot import RobotDescription
from softsim_core.values import Box, Placement, Sphere, Vector

Edits = tuple[Edit, ...]


def add_attachment(
    robot: RobotDescription, body: str, shape: Box | Sphere, to: Literal["world", "free"]
) -> tuple[str, Edits]:
    """A region that is held still, or that is a rigid frame; returns its part and the edits."""
    names = [each.name for each in robot.scene.attachments]
    name = _free("fixed" if to == "world" else "rigid", names)
    item: dict[str, Any] = {"name": name, "body": body, "to": to, _key(shape): plain_shape(shape)}
    if to == "free":
        item["frame"] = {"translation": plain_vector(shape.center)}
    return f"attachments/{name}", (Put(("attachments", Item(name)), item),)


def add_cable(
    robot: RobotDescription, body: str, pull_point: Vector, points: Sequence[Vector], most: float
) -> tuple[str, Edits]:
    """A cable from a place in the world through points of a body; it can be shortened by `most` in [m]."""
    cable = {
        "body": body,
        "points": [plain_vector(point) for point in points],
        "pull_point": plain_vector(pull_point),
    }
    limits = {"lower": 0.0, "upper": round(most, 5), "speed": round(5.0 * most, 5)}
    return _add_joint(robot, "cable", {"limits": limits, "cable": cable})


def add_chamber(
    robot: RobotDescription, body: str, most: float, inside: Vector | None = None
) -> tuple[str, Edits]:
    """The hollow of a body as a chamber of up to `most` in [Pa]; of several hollows that around `inside`."""
    chamber: dict[str, Any] = {"body": body, "control": "pressure"}
    if inside is not None:
        chamber["inside"] = plain_vector(inside)
    limits = {"lower": 0.0, "upper": float(most), "speed": float(most)}
    return _add_joint(robot, "chamber", {"limits": limits, "chamber": chamber})


def add_collision(robot: RobotDescription, body: str, box: Box | None = None) -> tuple[str, Edits]:
    """A surface of a body that touches others: that in a box, or all of it."""
    name = _free(f"{body}_skin", [each.name for each in robot.scene.collisions])
    item: dict[str, Any] = {"name": name, "body": body}
    if box is not None:
        item["boxes"] = [plain_shape(box)]
    part = f"collisions/{name}" + ("" if box is None else "#0")
    return part, (Put(("collisions", Item(name)), item),)


def add_mass(robot: RobotDescription, body: str, shape: Box | Sphere, mass: float) -> tuple[str, Edits]:
    """Mass in [kg] that the nodes of a region carry."""
    masses = plain_masses(robot.scene, body)
    added = {"mass": mass, _key(shape): plain_shape(shape)}
    steps = ("bodies", Item(body), "added_masses")
    return f"bodies/{body}/added_masses#{len(masses)}", (Put(steps, [*masses, added]),)


def route(robot: RobotDescription, name: str, points: Sequence[Vector]) -> Edits:
    """Other points of a cable, in the world in [m]."""
    cable = _cable(robot, name)
    at = ("joints", Item(name), "cable")
    edits: list[Edit] = [Put((*at, "points"), [plain_vector(point) for point in points])]
    if cable.placement != Placement():
        still = {"scale": 1.0, "rotation_deg": [0.0, 0.0, 0.0], "translation": [0.0, 0.0, 0.0]}
        edits.append(Put((*at, "placement"), still))
    return tuple(edits)


def routed_points(robot: RobotDescription, name: str) -> list[Vector]:
    """The points of a cable in the world in [m], from the pulled end on.

    Raises:
        SceneError: it is no cable, or its file cannot be read.
    """
    return [(float(x), float(y), float(z)) for x, y, z in cable_points(_cable(robot, name))]


def remove(robot: RobotDescription, part: str) -> Edits:
    """A part taken out, as `regions_of` and the like name it: "attachments/base", "collisions/skin#1".

    Raises:
        SceneError: no such part, or one that is not taken out so.
    """
    scene = robot.scene
    path, _, number = part.partition("#")
    kind, _, name = path.partition("/")
    if kind == "attachments" and name in [each.name for each in scene.attachments]:
        gone: list[Edit] = [Remove(("attachments", Item(name)))]
        return (*gone, Remove(("effector",))) if scene.effector == name else tuple(gone)
    if kind == "joints" and name in scene.joint_names:
        return _remove_joint(robot, name)
    for collision in scene.collisions:
        if kind == "collisions" and name == collision.name:
            others = [plain_shape(box) for k, box in enumerate(collision.boxes) if str(k) != number]
            if number and others:
                return (Put(("collisions", Item(name), "boxes"), others),)
            return (Remove(("collisions", Item(name))),)
    body, _, below = name.partition("/")
    if kind == "bodies" and below == "added_masses" and number.isdigit():
        masses = plain_masses(scene, body)
        if int(number) < len(masses):
            del masses[int(number)]
            return (Put(("bodies", Item(body), "added_masses"), masses),)
    raise SceneError(f"{part:.80} is no part that can be taken out here; edit the file by hand")


def _add_joint(robot: RobotDescription, kind: str, contents: dict[str, Any]) -> tuple[str, Edits]:
    """A joint of an actuator at the end of the list; every pose has it at 0."""
    name = _free(kind, robot.joint_names)
    edits: list[Edit] = [Put(("joints", Item(name)), {"name": name, "kind": kind, **contents})]
    edits += [Put(("poses", pose), [*values, 0.0]) for pose, values in robot.poses.items()]
    return f"joints/{name}", tuple(edits)


def _remove_joint(robot: RobotDescription, name: str) -> Edits:
    """The joint, its number in every pose, and the keys that drive nothing else."""
    place = robot.joint_names.index(name)
    edits: list[Edit] = [Remove(("joints", Item(name)))]
    for pose, values in robot.poses.items():
        edits.append(Put(("poses", pose), [value for k, value in enumerate(values) if k != place]))
    alone = [key for key, binding in robot.keys.items() if set(binding.joints) == {name}]
    if alone and len(alone) == len(robot.keys):
        return (*edits, Remove(("keys",)))
    for key, binding in robot.keys.items():
        if name in binding.joints:
            rest = [each for each in binding.joints if each != name]
            edits.append(Put(("keys", key, "joints"), rest) if rest else Remove(("keys", key)))
    return tuple(edits)


def _cable(robot: RobotDescription, name: str) -> CableDescription:
    for joint in robot.joints:
        if joint.name == name and isinstance(joint.actuator, CableDescription):
            return joint.actuator
    raise SceneError(f"{name:.80} is no cable of this scene")


def _free(name: str, taken: Iterable[str]) -> str:
    """The name, or the first with a number behind it that is not taken."""
    used = set(taken)
    return name if name not in used else next(other for n in count(2) if (other := f"{name}_{n}") not in used)


def _key(shape: Box | Sphere) -> str:
    return "box" if isinstance(shape, Box) else "sphere"
