"""The values of a part of a proposed scene as fields that a person writes, lengths in millimetres."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from softsim_core.actuation.cable.description import CableDescription
from softsim_core.actuation.chamber.description import ChamberDescription
from softsim_core.arrays import Array
from softsim_core.editing import Edit, Put
from softsim_core.editing.regions import Region, plain_masses, plain_vector, reshaped
from softsim_core.scene.deformable import BodyDescription
from softsim_core.scene.joint import JointDescription
from softsim_core.scene.overrides import Item, Steps
from softsim_core.scene.robot import RobotDescription
from softsim_core.values import Box, Sphere
from softsim_ros.viewer.surface import MM
from softsim_ros.viewer.tuning import KILO

GRAMS: Final = 1000.0

Edits = Sequence[Edit]


@dataclass(frozen=True)
class Field:
    """A value that a person can write.

    Attributes:
        label: Its name, with the unit that is shown.
        text: The value as text.
        edits: The edits for the value that a person wrote; TypeError or ValueError where it is none.
    """

    label: str
    text: str
    edits: Callable[[Any], Edits]


def fields_of(robot: RobotDescription, part: str, region: Region | None) -> list[Field]:
    """The fields of a part of a scene; `region` is its box or sphere."""
    if region is not None:
        return list(_of_region(robot, region))
    kind, _, name = part.partition("/")
    if kind == "joints":
        return [field for joint in robot.joints if joint.name == name for field in _of_joint(joint)]
    if kind == "bodies":
        return [field for body in robot.scene.bodies if body.name == name for field in _of_body(body)]
    return []


def point_field(at: Array, moved: Callable[[Array], Edits]) -> Field:
    """The field of one point of a cable at (3,) in [m]."""
    return Field("Point [mm]", _text(at * MM), lambda value: moved(_three(value) / MM))


class _Draft:
    """A region while its fields are read: each of them changes it, the last one's edit holds all."""

    def __init__(self, robot: RobotDescription, region: Region) -> None:
        self._scene, self.region = robot.scene, region
        self.grams: float | None = None

    def put(self, shape: Box | Sphere) -> Edits:
        """The edit for another shape, and the mass that was read before."""
        self.region = replace(self.region, shape=shape)
        edit = reshaped(self._scene, self.region, shape)
        if self.grams is not None:
            edit.value[self.region.index]["mass"] = _digits(self.grams / GRAMS)
        return (edit,)

    def move(self, value: Any) -> Edits:
        """Another centre, in [mm]."""
        return self.put(self.region.at(_three(value) / MM))

    def resize(self, value: Any) -> Edits:
        """Another size or radius, in [mm]."""
        if isinstance(self.region.shape, Sphere):
            return self.put(replace(self.region.shape, radius=float(value) / MM))
        return self.put(replace(self.region.shape, size=_vector(_three(value) / MM)))

    def turn(self, value: Any) -> Edits:
        """Other angles of a box, in [deg]."""
        assert isinstance(self.region.shape, Box)  # only boxes have the field
        return self.put(replace(self.region.shape, rotation_deg=_vector(_three(value))))

    def weigh(self, value: Any) -> Edits:
        """Another mass, in [g]."""
        self.grams = float(value)
        return self.put(self.region.shape)


def _of_region(robot: RobotDescription, region: Region) -> Iterator[Field]:
    """Place and size of a region, and what it belongs to."""
    shape, draft = region.shape, _Draft(robot, region)
    yield Field("Centre [mm]", _text(region.center * MM), draft.move)
    if isinstance(shape, Sphere):
        yield Field("Radius [mm]", _text(shape.radius * MM), draft.resize)
    else:
        yield Field("Size [mm]", _text(np.array(shape.size) * MM), draft.resize)
        yield Field("Turned about x, y, z [deg]", _text(np.array(shape.rotation_deg)), draft.turn)
    kind, _, name = region.part.partition("/")
    for attachment in robot.scene.attachments if kind == "attachments" else ():
        if attachment.name == name:
            put = _put("attachments", Item(name), "to")
            yield Field("Moves with (world, free, a joint)", attachment.to, put)
    if region.index is not None and region.steps[-1] == "added_masses":
        mass = plain_masses(robot.scene, region.body)[region.index]["mass"]
        yield Field("Mass [g]", _text(mass * GRAMS), draft.weigh)


def _of_joint(joint: JointDescription) -> Iterator[Field]:
    at: Steps = ("joints", Item(joint.name))
    if isinstance(joint.actuator, CableDescription):
        most = joint.actuator.max_tension
        yield Field("Largest tension [N]", _text(most), _put_number(1.0, *at, "cable", "max_tension"))
        if not joint.by_effort:
            upper = _text(joint.limits.upper * MM)
            yield Field("Shortened by at most [mm]", upper, _put_number(MM, *at, "limits", "upper"))
    elif isinstance(joint.actuator, ChamberDescription) and joint.by_effort:
        for label, key in (("Largest", "upper"), ("Smallest", "lower")):
            text = _text(getattr(joint.limits, key) / KILO)
            yield Field(f"{label} pressure [kPa]", text, _put_number(1.0 / KILO, *at, "limits", key))


def _of_body(body: BodyDescription) -> Iterator[Field]:
    at: Steps = ("bodies", Item(body.name))

    def take(value: Any) -> Edits:
        """Another elastomer of the table, with all its constants."""
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


def _put(*steps: str | Item) -> Callable[[Any], Edits]:
    return lambda value: (Put(steps, value),)


def _put_number(scale: float, *steps: str | Item) -> Callable[[Any], Edits]:
    """Puts a shown number, of which an SI unit has so many, in SI."""
    return lambda value: (Put(steps, _digits(float(value) / scale)),)


def _digits(value: float) -> float:
    """Without the rounding of a change of units."""
    return float(f"{value:.12g}")


def _text(value: Any) -> str:
    """A number, or several, as YAML reads them."""
    if value is None:
        return ""
    if np.ndim(value):
        return "[" + ", ".join(_text(each) for each in value) + "]"
    yaml = importlib.import_module("yaml")
    text: str = yaml.safe_dump(_digits(round(float(value), 6)) + 0.0 if not isinstance(value, str) else value)
    return text.removesuffix("...\n").strip()


def _three(value: Any) -> Array:
    """Three numbers."""
    numbers = np.array([float(each) for each in value])
    if numbers.shape != (3,):
        raise ValueError("three numbers are needed, such as [1, 2.5, 0]")
    return numbers


def _vector(values: Any) -> tuple[float, float, float]:
    x, y, z = plain_vector(values)
    return x, y, z
