"""Parts and regions of a proposed scene: the edits that add, change and remove them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import count
from typing import Any, Final, Literal

import numpy as np

from softsim_core.base import Array, Box, Placement, SceneError, Sphere, Vector, vector
from softsim_core.physics.actuation import Route
from softsim_core.physics.mechanics import rotation_euler
from softsim_core.scene import RobotDescription, SceneDescription, nodes_in
from softsim_core.scene.editing.edits import Edit, Put, Remove
from softsim_core.scene.io import Item, Steps

DIGITS: Final = 7
"""Digits after the decimal point of written positions and sizes in [m]."""


@dataclass(frozen=True, slots=True)
class Region:
    """A box or a sphere that chooses nodes of a body.

    Attributes:
        part: Its owner, such as "attachments/base".
        body: Name of the body.
        shape: The shape, in the coordinates of `frame`.
        steps: Steps to it in the file; for a list without names the steps to the list.
        index: Its index in that list; None: it is not in a list.
        frame: Frame of its coordinates in the world (scale not used).
    """

    part: str
    body: str
    shape: Box | Sphere
    steps: Steps
    index: int | None = None
    frame: Placement = Placement()

    @property
    def rotation(self) -> Array:
        """Rotation of the box's axes in the world, shape (3, 3)."""
        own = self.shape.rotation_deg if isinstance(self.shape, Box) else (0.0, 0.0, 0.0)
        return np.asarray(_turn(self.frame.rotation_deg) @ _turn(own))

    @property
    def center(self) -> Array:
        """Its centre in the world in [m], shape (3,)."""
        turned = _turn(self.frame.rotation_deg) @ np.array(self.shape.center)
        return np.asarray(turned + np.array(self.frame.translation))

    def in_world(self, points: Array) -> Array:
        """Transform points (..., 3) from its coordinates to the world."""
        return np.asarray(points @ _turn(self.frame.rotation_deg).T + np.array(self.frame.translation))

    def contains(self, place: Array) -> bool:
        """Return whether a world position (3,) in [m] lies in it."""
        local = _turn(self.frame.rotation_deg).T @ (place - np.array(self.frame.translation))
        return bool(len(nodes_in(self.shape, local[None])))

    def at(self, center: Array) -> Box | Sphere:
        """Return the same shape with its centre (3,) at another position in the world, in [m]."""
        local = _turn(self.frame.rotation_deg).T @ (center - np.array(self.frame.translation))
        return replace(self.shape, center=vector(local))


def regions_of(scene: SceneDescription) -> dict[str, Region]:
    """Return all boxes and spheres of a scene, by the part that each belongs to.

    The number of a region in a part with several, such as a collision surface, follows a hash:
    "collisions/skin#1".
    """
    frames = {joint.name: joint.base for joint in scene.joints}
    found: list[Region] = []
    for attachment in scene.attachments:
        steps: Steps = ("attachments", Item(attachment.name))
        base = frames.get(attachment.relative_to or "", Placement())
        part = f"attachments/{attachment.name}"
        for key, shape in (("box", attachment.box), ("sphere", attachment.sphere)):
            if shape is not None:
                found.append(Region(part, attachment.body, shape, (*steps, key), None, base))
    for body in scene.bodies:
        for number, added in enumerate(body.added_masses):
            shape = added.box or added.sphere
            if shape is not None:
                steps = ("bodies", Item(body.name), "added_masses")
                part = f"bodies/{body.name}/added_masses#{number}"
                found.append(Region(part, body.name, shape, steps, number))
    for collision in scene.collisions:
        for number, box in enumerate(collision.boxes):
            steps = ("collisions", Item(collision.name), "boxes")
            found.append(Region(f"collisions/{collision.name}#{number}", collision.body, box, steps, number))
    return {region.part: region for region in found}


def reshape_region(scene: SceneDescription, region: Region, shape: Box | Sphere) -> Put:
    """Return the edit that replaces a region's shape by another one of the same kind."""
    if region.index is None:
        return Put(region.steps, plain_shape(shape))
    if region.steps[-1] == "boxes":
        (collision,) = (
            each for each in scene.collisions if f"collisions/{each.name}#{region.index}" == region.part
        )
        boxes = [plain_shape(each) for each in collision.boxes]
        boxes[region.index] = plain_shape(shape)
        return Put(region.steps, boxes)
    masses = plain_masses(scene, region.body)
    masses[region.index] |= {"box" if isinstance(shape, Box) else "sphere": plain_shape(shape)}
    return Put(region.steps, masses)


def plain_masses(scene: SceneDescription, body: str) -> list[dict[str, Any]]:
    """Return the added masses of a body in the form of a file.

    Raises:
        SceneError: there is no such body.
    """
    described = [each for each in scene.bodies if each.name == body]
    if not described:
        raise SceneError(f"scene {scene.name}: unknown body {body[:60]!r}")
    masses: list[dict[str, Any]] = []
    for added in described[0].added_masses:
        plain: dict[str, Any] = {"mass": added.mass}
        for key in ("box", "sphere"):
            if (shape := getattr(added, key)) is not None:
                plain[key] = plain_shape(shape)
        plain |= {key: value for key in ("end", "group") if (value := getattr(added, key)) is not None}
        masses.append(plain)
    return masses


def plain_shape(shape: Box | Sphere) -> dict[str, Any]:
    """Return a box or a sphere in the form of a file."""
    if isinstance(shape, Sphere):
        return {"center": plain_vector(shape.center), "radius": round(shape.radius, DIGITS)}
    plain: dict[str, Any] = {"center": plain_vector(shape.center), "size": plain_vector(shape.size)}
    if any(shape.rotation_deg):
        plain["rotation_deg"] = [round(float(angle), 4) for angle in shape.rotation_deg]
    return plain


def plain_vector(values: Any) -> list[float]:
    """Return three numbers in [m] in the form of a file."""
    return [round(float(value), DIGITS) + 0.0 for value in values]


def _turn(angles_deg: tuple[float, float, float]) -> Array:
    return rotation_euler(np.radians(angles_deg))


Edits = tuple[Edit, ...]


def add_attachment(
    robot: RobotDescription, body: str, shape: Box | Sphere, to: Literal["world", "free"]
) -> tuple[str, Edits]:
    """Return part name and edits that add a fixed region, or a region that is a rigid frame."""
    names = [each.name for each in robot.scene.attachments]
    name = _free("fixed" if to == "world" else "rigid", names)
    item: dict[str, Any] = {"name": name, "body": body, "to": to, _key(shape): plain_shape(shape)}
    if to == "free":
        item["frame"] = {"translation": plain_vector(shape.center)}
    return f"attachments/{name}", (Put(("attachments", Item(name)), item),)


def add_cable(
    robot: RobotDescription, body: str, pull_point: Vector, points: Sequence[Vector], most: float
) -> tuple[str, Edits]:
    """Return part name and edits that add a cable from a world position through points of a body.

    The cable can be shortened by `most` in [m].
    """
    through = [plain_vector(point) for point in points]
    cable = {"body": body, "points": through, "pull_point": plain_vector(pull_point)}
    limits = {"lower": 0.0, "upper": round(most, 5), "speed": round(5.0 * most, 5)}
    return _add_joint(robot, "cable", {"limits": limits, "cable": cable})


def add_chamber(robot: RobotDescription, body: str, most: float) -> tuple[str, Edits]:
    """Return part name and edits that make a body's cavity a chamber of up to `most` in [Pa]."""
    chamber: dict[str, Any] = {"body": body, "control": "pressure"}
    limits = {"lower": 0.0, "upper": float(most), "speed": float(most)}
    return _add_joint(robot, "chamber", {"limits": limits, "chamber": chamber})


def add_collision(robot: RobotDescription, body: str, box: Box | None = None) -> tuple[str, Edits]:
    """Return part name and edits that add a contact surface of a body, in a box or all of it."""
    name = _free(f"{body}_skin", [each.name for each in robot.scene.collisions])
    item: dict[str, Any] = {"name": name, "body": body}
    if box is not None:
        item["boxes"] = [plain_shape(box)]
    part = f"collisions/{name}" + ("" if box is None else "#0")
    return part, (Put(("collisions", Item(name)), item),)


def add_mass(robot: RobotDescription, body: str, shape: Box | Sphere, mass: float) -> tuple[str, Edits]:
    """Return part name and edits that add a mass in [kg] to the nodes of a region."""
    masses = plain_masses(robot.scene, body)
    added = {"mass": mass, _key(shape): plain_shape(shape)}
    steps = ("bodies", Item(body), "added_masses")
    return f"bodies/{body}/added_masses#{len(masses)}", (Put(steps, [*masses, added]),)


def route(robot: RobotDescription, name: str, points: Sequence[Vector]) -> Edits:
    """Return the edits that set the points of a cable, in the world in [m]."""
    kind, cable = _cable(robot, name)
    at = ("joints", Item(name), kind)
    edits: list[Edit] = [Put((*at, "points"), [plain_vector(point) for point in points])]
    if cable.placed:
        still = {"scale": 1.0, "rotation_deg": [0.0, 0.0, 0.0], "translation": [0.0, 0.0, 0.0]}
        edits.append(Put((*at, "placement"), still))
    return tuple(edits)


def routed_points(robot: RobotDescription, name: str) -> list[Vector]:
    """Return the points of a cable in the world in [m], beginning at the pulled end.

    Raises:
        SceneError: it is no cable, or its file cannot be read.
    """
    return [vector(point) for point in _cable(robot, name)[1].points(None)]


def remove(robot: RobotDescription, part: str) -> Edits:
    """Return the edits that remove a part, named as in `regions_of`: "attachments/base", "collisions/skin#1".

    Raises:
        SceneError: no such part, or one that cannot be removed in this way.
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
    """Return name and edits that append an actuator's joint; every pose has it at 0."""
    name = _free(kind, robot.joint_names)
    edits: list[Edit] = [Put(("joints", Item(name)), {"name": name, "kind": kind, **contents})]
    edits += [Put(("poses", pose), [*values, 0.0]) for pose, values in robot.poses.items()]
    return f"joints/{name}", tuple(edits)


def _remove_joint(robot: RobotDescription, name: str) -> Edits:
    """Return the edits that remove the joint, its number in every pose, and keys for this joint alone."""
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


def _cable(robot: RobotDescription, name: str) -> tuple[str, Route]:
    """Return the kind and the route of a joint."""
    for joint in robot.joints:
        if joint.name == name and joint.actuator is not None and joint.actuator.route is not None:
            return joint.kind, joint.actuator.route
    raise SceneError(f"{name:.80} is no cable of this scene")


def _free(name: str, taken: Iterable[str]) -> str:
    """Return the name, or the first one with a number appended that is not taken."""
    used = set(taken)
    return name if name not in used else next(other for n in count(2) if (other := f"{name}_{n}") not in used)


def _key(shape: Box | Sphere) -> str:
    return "box" if isinstance(shape, Box) else "sphere"
