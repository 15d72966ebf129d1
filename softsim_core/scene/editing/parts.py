"""Parts and regions of a proposed scene: the edits that add, change and remove them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import count
from typing import Any, Final, Literal

import numpy as np

from softsim_core.base import Array, Box, Placement, SceneError, Sphere, Vector
from softsim_core.physics.actuation.cable import CableDescription, cable_points
from softsim_core.physics.mechanics import rotation_euler
from softsim_core.scene import RobotDescription, SceneDescription, nodes_in
from softsim_core.scene.editing.edits import Edit, Put, Remove
from softsim_core.scene.io import Item, Steps

DIGITS: Final = 7
"""Places and sizes are written to so many digits after the point, in [m]."""


@dataclass(frozen=True, slots=True)
class Region:
    """A box or a sphere that chooses nodes of a body.

    Attributes:
        part: What it belongs to, such as "attachments/base".
        body: Name of the body.
        shape: Where it is, in the coordinates of `frame`.
        steps: Where it is written; of a list without names the steps to the list.
        index: Its place in that list; None: it is written by itself.
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
        """Points (..., 3) in its coordinates, in the world."""
        return np.asarray(points @ _turn(self.frame.rotation_deg).T + np.array(self.frame.translation))

    def contains(self, place: Array) -> bool:
        """Whether a place (3,) in the world in [m] lies in it."""
        local = _turn(self.frame.rotation_deg).T @ (place - np.array(self.frame.translation))
        return bool(len(nodes_in(self.shape, local[None])))

    def at(self, center: Array) -> Box | Sphere:
        """The same shape with its centre (3,) elsewhere in the world, in [m]."""
        local = _turn(self.frame.rotation_deg).T @ (center - np.array(self.frame.translation))
        if isinstance(self.shape, Sphere):
            return Sphere(center=_vector(local), radius=self.shape.radius)
        return Box(center=_vector(local), size=self.shape.size, rotation_deg=self.shape.rotation_deg)


def regions_of(scene: SceneDescription) -> dict[str, Region]:
    """All boxes and spheres of a scene, by the part that each belongs to.

    Parts with several, such as collision surfaces, have their number behind a hash: "collisions/skin#1".
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
                found.append(
                    Region(f"bodies/{body.name}/added_masses#{number}", body.name, shape, steps, number)
                )
    for collision in scene.collisions:
        for number, box in enumerate(collision.boxes):
            steps = ("collisions", Item(collision.name), "boxes")
            found.append(Region(f"collisions/{collision.name}#{number}", collision.body, box, steps, number))
    return {region.part: region for region in found}


def reshaped(scene: SceneDescription, region: Region, shape: Box | Sphere) -> Put:
    """The edit that gives a region of a scene another shape of the same kind."""
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
    """What parts of a body carry, as a file says it.

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
    """A box or a sphere as a file says it."""
    if isinstance(shape, Sphere):
        return {"center": plain_vector(shape.center), "radius": round(shape.radius, DIGITS)}
    plain: dict[str, Any] = {"center": plain_vector(shape.center), "size": plain_vector(shape.size)}
    if any(shape.rotation_deg):
        plain["rotation_deg"] = [round(float(angle), 4) for angle in shape.rotation_deg]
    return plain


def plain_vector(values: Any) -> list[float]:
    """Three numbers in [m] as a file says them."""
    return [round(float(value), DIGITS) + 0.0 for value in values]


def shape_of(plain: Mapping[str, Any]) -> Box | Sphere:
    """The box or sphere of what `plain_shape` made."""
    if "radius" in plain:
        return Sphere(center=_vector(plain["center"]), radius=float(plain["radius"]))
    turned = _vector(plain.get("rotation_deg", (0.0, 0.0, 0.0)))
    return Box(center=_vector(plain["center"]), size=_vector(plain["size"]), rotation_deg=turned)


def _turn(angles_deg: tuple[float, float, float]) -> Array:
    return rotation_euler(np.radians(angles_deg))


def _vector(values: Any) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return x, y, z


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
