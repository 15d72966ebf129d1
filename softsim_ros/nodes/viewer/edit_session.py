"""State of the edit mode: the chosen part, its fields and handles, and what a click adds."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final

import numpy as np

from softsim_core.base import Array, Box, CommandError, SceneError, SoftSimError, Sphere, vector
from softsim_core.physics.actuation import Route
from softsim_core.scene import BodyDescription, JointDescription, RobotDescription
from softsim_core.scene.editing import (
    Edit,
    Put,
    Region,
    add_attachment,
    add_cable,
    add_chamber,
    add_collision,
    add_mass,
    plain_masses,
    plain_vector,
    regions_of,
    remove,
    reshape_region,
    route,
)
from softsim_core.scene.io import Item, Steps, read_overrides
from softsim_ros.messages import Proposal
from softsim_ros.nodes.viewer.parameters import KILO
from softsim_ros.nodes.viewer.part_tree import field_text
from softsim_ros.nodes.viewer.surface import MM

GRAMS: Final = 1000.0

Edits = Sequence[Edit]


@dataclass(frozen=True)
class Field:
    """A value that the user can edit.

    Attributes:
        label: Its name, with the unit that is shown.
        text: The value as text.
        edits: Returns the edits for the value that the user entered; raises TypeError or ValueError if it is
            invalid.
    """

    label: str
    text: str
    edits: Callable[[Any], Edits]


def fields_of(robot: RobotDescription, part: str, region: Region | None) -> list[Field]:
    """Return the fields of a part of a scene; `region` is its box or sphere."""
    if region is not None:
        return list(_of_region(robot, region))
    kind, _, name = part.partition("/")
    if kind == "joints":
        return [field for joint in robot.joints if joint.name == name for field in _of_joint(joint)]
    if kind == "bodies":
        return [field for body in robot.scene.bodies if body.name == name for field in _of_body(body)]
    return []


class _Draft:
    """A region while its fields are read; each field changes it, so the last edit contains all changes."""

    def __init__(self, robot: RobotDescription, region: Region) -> None:
        self._scene, self.region = robot.scene, region
        self.grams: float | None = None

    def put(self, shape: Box | Sphere) -> Edits:
        """Return the edit for another shape, including a mass that was read before."""
        self.region = replace(self.region, shape=shape)
        edit = reshape_region(self._scene, self.region, shape)
        if self.grams is not None:
            edit.value[self.region.index]["mass"] = _digits(self.grams / GRAMS)
        return (edit,)

    def move(self, value: Any) -> Edits:
        """Return the edit for another centre, in [mm]."""
        return self.put(self.region.at(_three(value) / MM))

    def resize(self, value: Any) -> Edits:
        """Return the edit for another size or radius, in [mm]."""
        if isinstance(self.region.shape, Sphere):
            return self.put(replace(self.region.shape, radius=float(value) / MM))
        return self.put(replace(self.region.shape, size=_rounded_vector(_three(value) / MM)))

    def turn(self, value: Any) -> Edits:
        """Return the edit for other angles of a box, in [deg]."""
        assert isinstance(self.region.shape, Box)  # only boxes have the field
        return self.put(replace(self.region.shape, rotation_deg=_rounded_vector(_three(value))))

    def weigh(self, value: Any) -> Edits:
        """Return the edit for another mass, in [g]."""
        self.grams = float(value)
        return self.put(self.region.shape)


def _of_region(robot: RobotDescription, region: Region) -> Iterator[Field]:
    """Yield the fields of a region: its place and size, and what it belongs to."""
    shape, draft = region.shape, _Draft(robot, region)
    yield Field("Centre [mm]", _text(region.center * MM), draft.move)
    if isinstance(shape, Sphere):
        yield Field("Radius [mm]", _text(shape.radius * MM), draft.resize)
    else:
        yield Field("Size [mm]", _text(np.array(shape.size) * MM), draft.resize)
        yield Field("Turned about x, y, z [deg]", _text(np.array(shape.rotation_deg)), draft.turn)
    kind, _, name = region.part.partition("/")
    at: Steps = ("attachments", Item(name), "to")
    for attachment in robot.scene.attachments if kind == "attachments" else ():
        if attachment.name == name:
            yield Field("Moves with (world, free, a joint)", attachment.to, lambda value: (Put(at, value),))
    if region.index is not None and region.steps[-1] == "added_masses":
        mass = plain_masses(robot.scene, region.body)[region.index]["mass"]
        yield Field("Mass [g]", _text(mass * GRAMS), draft.weigh)


def _of_joint(joint: JointDescription) -> Iterator[Field]:
    for label, per_si, keys in () if joint.actuator is None else joint.actuator.edited_numbers:
        value: Any = joint
        for key in keys:
            value = joint.actuator if key == joint.kind else getattr(value, key)
        text = _text(None if value is None else value * per_si)
        yield Field(label, text, _put_number(per_si, "joints", Item(joint.name), *keys))


def _of_body(body: BodyDescription) -> Iterator[Field]:
    at: Steps = ("bodies", Item(body.name))

    def take(value: Any) -> Edits:
        """Return the edit for another elastomer of the table, with all its constants."""
        if not isinstance(value, str):
            raise ValueError("the name of an elastomer is needed; `softsim material` lists them")
        return (Put((*at, "material"), {"preset": value}),)

    if not body.is_rod:
        yield Field("Elastomer", body.material.preset or "", take)
    for parameter in body.material.law_for("polar").parameters:
        if parameter.name.startswith("prony_"):
            continue  # a list in the file
        scale, unit = (1.0 / KILO, "kPa") if parameter.unit == "Pa" else (1.0, parameter.unit)
        label = parameter.name.replace("_", " ").capitalize() + ("" if unit == "-" else f" [{unit}]")
        value = body.material.values[parameter.name] * scale
        yield Field(label, _text(value), _put_number(scale, *at, "material", parameter.name))
    if body.total_mass is not None:
        yield Field("Mass [g]", _text(body.total_mass * GRAMS), _put_number(GRAMS, *at, "total_mass"))
    else:
        yield Field("Density [kg/m³]", _text(body.density), _put_number(1.0, *at, "density"))


def _put_number(scale: float, *steps: str | Item) -> Callable[[Any], Edits]:
    """Return a function that writes a displayed number in SI; `scale` displayed units are one SI unit."""
    return lambda value: (Put(steps, _digits(float(value) / scale)),)


def _digits(value: float) -> float:
    """Return a value without the rounding error of a change of units."""
    return float(f"{value:.12g}")


def _text(value: Any) -> str:
    """Return one or several numbers as YAML text."""
    if value is None:
        return ""
    if np.ndim(value):
        return "[" + ", ".join(_text(each) for each in value) + "]"
    return field_text(_digits(round(float(value), 6)) + 0.0)


def _three(value: Any) -> Array:
    """Return three numbers as an array, shape (3,)."""
    numbers = np.array([float(each) for each in value])
    if numbers.shape != (3,):
        raise ValueError("three numbers are needed, such as [1, 2.5, 0]")
    return numbers


def _rounded_vector(values: Any) -> tuple[float, float, float]:
    x, y, z = plain_vector(values)
    return x, y, z


CHOOSE: Final = "choose what is there"
ROUTE: Final = "route a cable: first where it leaves"
CLICKS: Final = (
    CHOOSE,
    "add a fixed box",
    "add a fixed sphere",
    "add a rigid box",
    "add a rigid sphere",
    ROUTE,
    "add a chamber",
    "add a contact surface",
    "add a contact box",
    "add a mass",
)
"""Actions of a click on a body."""

SHARE: Final = 0.15
"""Size of a new box as a fraction of its body's diagonal."""

NEW_MASS: Final = 0.01
NEW_PRESSURE: Final = 1.0e4


class EditSession:
    """The edit mode of a page, without the page; `send` is called with edits and their stroke.

    Attributes:
        is_on: Whether the proposal is shown in place of the robot.
        click: Action of a click on a body, one of CLICKS.
        part: The chosen part, "" for none.
        point: Number of the chosen point of a cable, -1 its pull point.
        proposal: The newest proposal; None if none was received.
    """

    def __init__(self, send: Callable[[Sequence[Edit], str], None]) -> None:
        self._send = send
        self.is_on = False
        self.click = CHOOSE
        self.part, self.point = "", 0
        self.proposal: Proposal | None = None
        self._leaves: tuple[str, Array] | None = None
        self._awaited = ""

    # --- the proposal ---------------------------------------------------------------------------------

    def take(self, proposal: Proposal) -> None:
        """Take a newer proposal; choose a part that was just added, deselect one that was removed."""
        self.proposal = proposal
        parts = self.parts
        if self._awaited in parts:
            self.part, self._awaited = self._awaited, ""
        if self.part not in parts:
            self.part, self.point = "", 0
        self.point = max(-self.first, min(self.point, len(self.route) - 1))

    @property
    def robot(self) -> RobotDescription | None:
        """The proposed scene."""
        return None if self.proposal is None else self.proposal.robot

    @property
    def parts(self) -> tuple[str, ...]:
        """Parts that can be chosen."""
        robot = self.robot
        if robot is None:
            return ()
        scene = robot.scene
        whole = [f"collisions/{each.name}" for each in scene.collisions if not each.boxes]
        driven = [f"joints/{each.name}" for each in scene.joints if each.actuator is not None]
        bodies = [f"bodies/{each.name}" for each in scene.bodies]
        return (*bodies, *self.regions, *driven, *whole)

    @property
    def regions(self) -> dict[str, Region]:
        """Boxes and spheres by the names of their parts."""
        return {} if self.robot is None else regions_of(self.robot.scene)

    @property
    def route(self) -> Array:
        """Points of the chosen cable in the world in [m], shape (k, 3); empty if no cable is chosen."""
        if self.proposal is None or self._joint is None:
            return np.zeros((0, 3))
        return self.proposal.routes.get(self._joint.name, np.zeros((0, 3)))

    @property
    def _joint(self) -> JointDescription | None:
        robot, (kind, _, name) = self.robot, self.part.partition("/")
        if robot is None or kind != "joints":
            return None
        return next((joint for joint in robot.joints if joint.name == name), None)

    @property
    def _cable(self) -> Route | None:
        joint = self._joint
        return joint.actuator.route if joint is not None and joint.actuator is not None else None

    @property
    def first(self) -> int:
        """Index of point 0 of the chosen cable in `point_names`: 1 if there is a pull point."""
        return int(self._cable is not None and self._cable.pull_point is not None)

    @property
    def point_names(self) -> tuple[str, ...]:
        """Names of the points of the chosen cable, from its exit on."""
        points = tuple(f"point {number + 1}" for number in range(len(self.route)))
        return ("pull point", *points) if self.first else points

    @property
    def is_free(self) -> bool:
        """Whether the chosen part is a rigid region."""
        attachments = () if self.robot is None else self.robot.scene.attachments
        return self.part in [f"attachments/{each.name}" for each in attachments if each.to == "free"]

    def choose(self, part: str) -> None:
        """Choose a part."""
        self.part, self.point = part if part in self.parts else "", 0

    def choose_point(self, name: str) -> None:
        """Choose a point of the chosen cable by its name in `point_names`."""
        if name in self.point_names:
            self.point = self.point_names.index(name) - self.first

    def choose_click(self, click: str) -> None:
        """Choose the action of a click on a body, one of CLICKS."""
        self.click = click if click in CLICKS else CHOOSE

    # --- clicks on a body -----------------------------------------------------------------------------

    def press(self, body: str, place: Array, points: Array) -> str:
        """Handle a click on a body; return a message for the user.

        Args:
            body: Name of the body.
            place: Where it was hit at rest in [m], shape (3,).
            points: Vertices of the body at rest in [m], shape (p, 3).

        Raises:
            SoftSimError: nothing can be added there.
        """
        robot = self.robot
        if robot is None:
            return ""
        diagonal = float(np.linalg.norm(np.ptp(points, axis=0)))
        if self.click == CHOOSE:
            self._pick(body, place, diagonal)
            return ""
        at = _round_lengths(place, diagonal)
        edge = _round_lengths(np.array(SHARE * diagonal), diagonal)
        box = Box(center=vector(at), size=(float(edge),) * 3)
        sphere = Sphere(center=vector(at), radius=0.5 * float(edge))
        if self.click == ROUTE:
            return self._lead(robot, body, at, diagonal)
        made = {
            "add a fixed box": lambda: add_attachment(robot, body, box, "world"),
            "add a fixed sphere": lambda: add_attachment(robot, body, sphere, "world"),
            "add a rigid box": lambda: add_attachment(robot, body, box, "free"),
            "add a rigid sphere": lambda: add_attachment(robot, body, sphere, "free"),
            "add a chamber": lambda: add_chamber(robot, body, NEW_PRESSURE),
            "add a contact surface": lambda: add_collision(robot, body),
            "add a contact box": lambda: add_collision(robot, body, box),
            "add a mass": lambda: add_mass(robot, body, sphere, NEW_MASS),
        }[self.click]()
        self._awaited = made[0]
        self._send(made[1], "")
        return f"{made[0]} proposed"

    def _pick(self, body: str, place: Array, diagonal: float) -> None:
        """Choose a cable's point near a place (3,) in [m], the smallest region around it, or the body."""
        assert self.proposal is not None  # set if there is a robot
        for name, points in self.proposal.routes.items():
            apart = np.linalg.norm(points - place, axis=1)
            if len(apart) and apart.min() < 0.03 * diagonal:
                self.part, self.point = f"joints/{name}", int(apart.argmin())
                return
        around = [each for each in self.regions.values() if each.body == body and each.contains(place)]
        smallest = min(around, key=lambda each: float(np.linalg.norm(_half(each.shape))), default=None)
        self.choose(f"bodies/{body}" if smallest is None else smallest.part)

    def _lead(self, robot: RobotDescription, body: str, at: Array, diagonal: float) -> str:
        """Handle a click that routes a cable: first its exit, then its points, one after the other."""
        cable = self._cable
        if cable is not None and cable.body == body and self._joint is not None:
            points = [*self.route.tolist(), at.tolist()]
            self.point = len(points) - 1
            self._send(route(robot, self._joint.name, points), "")
            return f"{len(points)} points"
        if self._leaves is None or self._leaves[0] != body:
            self._leaves = body, at
            return "the cable leaves there; click where it enters the body, then on to where it ends"
        _, start = self._leaves
        self._leaves = None
        part, edits = add_cable(robot, body, vector(start), [vector(at)], round(0.1 * diagonal, 4))
        self._awaited = part
        self._send(edits, "")
        return f"{part} proposed; further clicks lead it on"

    # --- handles --------------------------------------------------------------------------------------

    def handles(self) -> dict[str, Array]:
        """Return the chosen part's handles in [m], shapes (3,): "centre" and "size", or "point"."""
        region = self.regions.get(self.part)
        if region is not None:
            return {"centre": region.center, "size": region.center + region.rotation @ _half(region.shape)}
        cable, points = self._cable, self.route
        if cable is None or not len(points):
            return {}
        if self.point < 0 and cable.pull_point is not None:
            return {"point": np.array(cable.pull_point)}
        return {"point": points[max(self.point, 0)]}

    def drag(self, handle: str, place: Array, stroke: str) -> None:
        """Handle a drag of a handle of the chosen part to a place (3,) in [m]."""
        if edits := self._move_handle(handle, place):
            self._send(edits, stroke)

    def _move_handle(self, handle: str, place: Array) -> Sequence[Edit]:
        """Return the edits that move a handle to a place."""
        robot, region, joint, cable = self.robot, self.regions.get(self.part), self._joint, self._cable
        if robot is None:
            return ()
        if region is not None:
            return (reshape_region(robot.scene, region, drag_handle(region, handle, place)),)
        if joint is None or cable is None or not len(self.route):
            return ()
        at = _round_lengths(place, 0.1)
        if self.point < 0 and cable.pull_point is not None:
            return (Put(("joints", Item(joint.name), joint.kind, "pull_point"), plain_vector(at)),)
        points = self.route.copy()
        points[max(self.point, 0)] = at
        return route(robot, joint.name, points.tolist())

    # --- values ---------------------------------------------------------------------------------------

    def fields(self) -> list[Field]:
        """Return the editable values of the chosen part."""
        if self.robot is None:
            return []
        found = fields_of(self.robot, self.part, self.regions.get(self.part))
        at = self.handles().get("point")
        if at is None:
            return found
        move = partial(self._move_handle, "point")
        return [Field("Point [mm]", _text(at * MM), lambda value: move(_three(value) / MM)), *found]

    def write(self, texts: Sequence[tuple[Field, str]]) -> None:
        """Propose the values that the user entered into fields.

        Raises:
            SoftSimError: a text is no value for its field.
        """
        edits: list[Edit] = []
        for field, text in texts:
            value = read_overrides(f"value: {text}").get("value")
            try:
                edits += field.edits(value)
            except SoftSimError:
                raise
            except (TypeError, ValueError) as error:
                raise CommandError(f"{field.label}: {text:.60} is no such value ({error!s:.80})") from error
        if edits:
            self._send(edits, "")

    def remove(self) -> None:
        """Remove the chosen part.

        Raises:
            SoftSimError: it cannot be removed here.
        """
        if self.robot is not None and self.part:
            self._send(remove(self.robot, self.part), "")

    def remove_point(self) -> None:
        """Remove the chosen point from the chosen cable."""
        if self.robot is None or self._joint is None or self.point < 0 or not len(self.route):
            raise SceneError("choose a point of a cable first")
        points = np.delete(self.route, self.point, axis=0).tolist()
        self._send(route(self.robot, self._joint.name, points), "")

    def make_effector(self) -> None:
        """Make the chosen rigid region the end effector."""
        if not self.is_free:
            raise SceneError("choose a rigid region first")
        self._send((Put(("effector",), self.part.partition("/")[2]),), "")


def drag_handle(region: Region, handle: str, place: Array) -> Box | Sphere:
    """Return the shape of a region after its handle "centre" or "size" is dragged to a place (3,) in [m].

    Dragging a corner moves the three faces that meet there; the opposite corner stays fixed. The centre of a
    sphere stays fixed when its size is dragged.
    """
    shape, diagonal = region.shape, 10.0 * float(np.linalg.norm(2.0 * _half(region.shape)))
    if handle == "centre":
        return region.at(_round_lengths(place, diagonal))
    local = region.rotation.T @ (place - region.center)
    if isinstance(shape, Sphere):
        least = 1e-3 * diagonal
        radius = _round_lengths(np.array(max(float(np.linalg.norm(local)), least)), diagonal)
        return Sphere(center=shape.center, radius=float(radius))
    opposite = -_half(shape)
    size = _round_lengths(np.maximum(local - opposite, 1e-3 * diagonal), diagonal)
    center = region.center + region.rotation @ (opposite + 0.5 * size)
    moved = region.at(center)
    return Box(center=moved.center, size=vector(size), rotation_deg=shape.rotation_deg)


def _half(shape: Box | Sphere) -> Array:
    """Return the vector from the centre to the size handle, in the axes of the shape, shape (3,)."""
    if isinstance(shape, Sphere):
        return np.array([shape.radius, 0.0, 0.0])
    return 0.5 * np.array(shape.size)


def _round_lengths(values: Array, diagonal: float) -> Array:
    """Round lengths to about a thousandth of a diagonal, the accuracy of a drag by hand."""
    digits = 4 - math.ceil(math.log10(max(diagonal, 1e-9)))
    return np.round(values, max(0, digits))
