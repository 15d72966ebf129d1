"""The description of a sensor in a scene, and the kind that builds the sensor from it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from enum import Enum
from types import EllipsisType
from typing import Any, ClassVar, Final, NamedTuple

import numpy as np

from softsim_core.base import Array, FieldError, Placement, SceneError, known_names, need_finite
from softsim_core.physics.actuation import ActuatorView, Surroundings
from softsim_core.physics.contact import CollisionSurface
from softsim_core.physics.sensing.sensor import Place, Sensor

ANY_BODY: Final = "body"
"""A reference may name a body, deformable or rigid."""
SOFT_BODY: Final = "deformable body"
"""A reference may name a deformable body."""
PLACE: Final = "frame"
"""A reference may name a rigid frame: the world, an attachment, a joint with a frame, a rigid body."""


class Reference(NamedTuple):
    """A name in a sensor's description: the field with the name, the name, and what it may name.

    `among` is ANY_BODY, SOFT_BODY, PLACE, or the kind of an actuator, such as "cable".
    """

    field: str
    name: str
    among: str


class Quantity(Enum):
    """What an output of a sensor is; whoever sends or shows it chooses the form by this.

    Attributes:
        WRENCH: Force in [N] and moment in [N m], shape (6,).
        PRESSURES: Pressures of a grid of cells in [Pa], shape (rows, columns).
        INERTIAL: Specific force in [m/s^2] and angular rate in [rad/s], shape (6,); or followed by an
            orientation in the world as a quaternion (x, y, z, w), shape (10,).
        POINTS: Positions in the world in [m], NaN where not seen, shape (k, 3).
        NUMBER: One number.
        JOINT: Position and effort of a joint, in its units, shape (2,).
        PRESSURE: Gauge pressure in [Pa].
        NUMBERS: Anything else.
    """

    WRENCH = "wrench"
    PRESSURES = "pressures"
    INERTIAL = "inertial"
    POINTS = "points"
    NUMBER = "number"
    JOINT = "joint"
    PRESSURE = "pressure"
    NUMBERS = "numbers"


class Output(NamedTuple):
    """A part of a sensor's samples that is sent and shown by itself.

    Attributes:
        quantity: What it is.
        below: Text behind the sensor's topic, such as "/volume"; empty for one output at least.
        part: Index of its numbers in a sample; ...: all of them.
        deviations: Standard deviations of its noise: of specific force, angular rate and, if it has one,
            orientation; of a pressure. Empty: unknown, or no message has a place for them.
        joint: Name of the joint that it belongs to; empty: none.
    """

    quantity: Quantity
    below: str = ""
    part: int | EllipsisType = ...
    deviations: tuple[float, ...] = ()
    joint: str = ""


class Mount(NamedTuple):
    """Where a sensor with a frame of its own sits: the frame that carries it, and its pose there."""

    on: str
    pose: Placement


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulatedSensorDescription:
    """A sensor of a simulated scene; each kind derives its own frozen dataclass.

    Attributes:
        kind: Name of the kind, in files under the key `kind`.
        output_quantity: What its only output is, unless it defines `outputs`.
        named_parts: What each field that names a part of the scene may name (see Reference.among).
        name: Unique among the sensors of a scene.
        rate: Samples per second in [Hz], at most one per step; None: one per step.
        seed: Seed of its noise, >= 0; the noise also depends on the name.

    A field whose name ends in `noise` is a standard deviation, >= 0; one in `bias`, a number or a vector.

    Raises:
        FieldError: a field has an invalid value.
    """

    kind: ClassVar[str]
    output_quantity: ClassVar[Quantity] = Quantity.NUMBERS
    named_parts: ClassVar[Mapping[str, str]] = {}
    name: str
    rate: float | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        if not self.name:
            raise FieldError("sensor", "name", repr(self.name), "a text")
        if self.rate is not None and not 0.0 < self.rate < math.inf:
            raise FieldError(self.owner, "rate", self.rate, "> 0 Hz")
        if self.seed < 0:
            raise FieldError(self.owner, "seed", self.seed, ">= 0")
        for field in fields(self):
            value = getattr(self, field.name)
            numbers = value if isinstance(value, tuple) else () if value is None else (value,)
            if field.name.endswith("bias"):
                need_finite(self.owner, field.name, numbers)
            elif field.name.endswith("noise") and not all(0.0 <= each < math.inf for each in numbers):
                raise FieldError(self.owner, field.name, value, ">= 0")
        self.check()

    def check(self) -> None:
        """Refuse invalid values of the kind's own fields.

        Raises:
            FieldError: a field has an invalid value.
        """

    @property
    def owner(self) -> str:
        """The sensor's name in messages."""
        return f"sensor {self.name}"

    def references(self) -> tuple[Reference, ...]:
        """Return the parts of the scene that the sensor names; a field that is None names none."""
        named = ((field, getattr(self, field), among) for field, among in self.named_parts.items())
        return tuple(Reference(*each) for each in named if each[1] is not None)

    @property
    def outputs(self) -> tuple[Output, ...]:
        """What is sent and shown of its samples; by default all numbers, row by row."""
        return (Output(self.output_quantity),)

    @property
    def mount(self) -> Mount | None:
        """Its own frame, in whose axes it measures; None: it has none."""
        return None

    @property
    def axes(self) -> str:
        """Name of the frame in whose axes it measures if it has no mount; empty: the robot's base."""
        return ""


def need_sensors(
    scene: str,
    dt: float,
    sensors: Sequence[SimulatedSensorDescription],
    defined: Mapping[str, Sequence[str]],
) -> None:
    """Refuse sensors that name parts which the scene lacks, or that sample faster than its steps of `dt` [s].

    `defined` are the names of the parts of the scene by kind of reference (see Reference.among).

    Raises:
        SceneError: a sensor names a missing part or is too fast.
    """
    for sensor in sensors:
        for field, name, among in sensor.references():
            if name not in defined.get(among, ()):
                raise SceneError(
                    f"scene {scene}: unknown {among} {name!r} ({field} of {sensor.owner}); "
                    f"{known_names(name, defined.get(among, ()))}"
                )
        if sensor.rate is not None and sensor.rate * dt > 1.0 + 1e-9:
            raise SceneError(
                f"scene {scene}: {sensor.owner}: rate must be <= {1.0 / dt:g} Hz, one sample a step of "
                f"{dt:g} s, not {sensor.rate:g}; remove it or give a smaller one"
            )


@dataclass(frozen=True, slots=True, eq=False)
class Scenery:
    """The parts of a scene from which sensors are built.

    Attributes:
        soft: The model, and how points are bound to its deformable bodies.
        body_names: Names of all bodies, by their numbers in contacts.
        places: Rigid frames, by their names in the scene.
        surfaces: Collision surfaces.
        points: Positions of their vertices at the start in [m], shape (v, 3).
        actuators: Every actuator at the start, by the name of its joint.
    """

    soft: Surroundings
    body_names: tuple[str, ...]
    places: Mapping[str, Place]
    surfaces: tuple[CollisionSurface, ...]
    points: Array
    actuators: Mapping[str, ActuatorView]

    def surfaces_of(self, body: str) -> list[CollisionSurface]:
        """Return the collision surfaces of a body that have triangles."""
        number = self.body_names.index(body)
        return [each for each in self.surfaces if each.owner == number and len(each.triangles)]


@dataclass(frozen=True, slots=True, eq=False)
class SensorKind:
    """A kind of sensor.

    Attributes:
        description: Type of its description.
        build: Returns the sensor of a description.
    """

    description: type[SimulatedSensorDescription]
    build: Callable[[Any, Scenery], Sensor]

    @property
    def name(self) -> str:
        """The kind's name in scene files."""
        return self.description.kind


def both(first: object, second: object) -> Array:
    """Return two triples joined, shape (6,); a number stands for three equal ones."""
    return np.concatenate([np.broadcast_to(np.asarray(each, dtype=float), 3) for each in (first, second)])
