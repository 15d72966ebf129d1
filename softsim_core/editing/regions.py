"""The boxes and spheres of a scene: where each is, and the edit that moves or resizes it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from softsim_core.arrays import Array
from softsim_core.editing.edits import Put
from softsim_core.errors import SceneError
from softsim_core.mechanics.pose import rotation_euler
from softsim_core.scene.description import SceneDescription
from softsim_core.scene.overrides import Item, Steps
from softsim_core.scene.regions import nodes_in
from softsim_core.values import Box, Placement, Sphere

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
