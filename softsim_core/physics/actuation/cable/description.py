"""Description of a cable in a scene: typed, in SI units; its points may be in a file."""

from __future__ import annotations

import importlib
import json
import math
from dataclasses import dataclass, field, replace
from os import PathLike
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np

from softsim_core.base import (
    FORCE,
    POINT,
    SHORTENING,
    Array,
    ConfigError,
    FieldError,
    JointUnits,
    Placement,
    SceneError,
    Vector,
    listing,
    need_finite,
    need_not_negative,
    need_positive,
)
from softsim_core.physics.actuation import ActuatorDescription, EditedNumber, Route
from softsim_core.physics.mesh import TetMesh, place


def read_cable_points(file: str | PathLike[str]) -> Array:
    """Return the points of a cable in file units, from the pulled end to the anchored one, shape (k, 3).

    Args:
        file: JSON (.json) or YAML (.yaml, .yml): a list of lists of three numbers.

    Raises:
        ConfigError: the file is missing or damaged, or an entry is no point; the message names it.
    """
    path = Path(file)
    data = _read(path)
    if not isinstance(data, list) or not data:
        raise ConfigError(path, "", f"must be a list of points [x, y, z], not {_format_value(data)}")
    for index, point in enumerate(data):
        numbers = isinstance(point, list) and {type(each) for each in point} <= {int, float}
        if not numbers or len(point) != 3 or not all(map(math.isfinite, point)):
            raise ConfigError(
                path, f"[{index}]", f"must be a list of 3 finite numbers, not {_format_value(point)}"
            )
        if index and point == data[index - 1]:
            raise ConfigError(path, f"[{index}]", "lies where the point before it lies; remove one of them")
    return np.array(data, dtype=float)


def _read(path: Path) -> Any:
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError(path, "", f"cannot be read ({error.strerror or error})") from error
    except UnicodeDecodeError as error:
        raise ConfigError(path, "", f"is not UTF-8 text (byte {error.start})") from error
    if path.suffix.lower() == ".json":
        try:
            return json.loads(text)
        except ValueError as error:
            raise ConfigError(path, "", f"is not JSON: {error}") from error
    if path.suffix.lower() not in (".yaml", ".yml"):
        raise ConfigError(path, "", "a file of cable points ends in .json, .yaml or .yml")
    yaml = importlib.import_module("yaml")
    try:
        return yaml.safe_load(text)
    except yaml.YAMLError as error:
        problem = getattr(error, "problem", None) or "is not valid YAML"
        raise ConfigError(path, "", f"YAML syntax: {problem}") from error


def _format_value(value: Any) -> str:
    text = "empty" if value is None else json.dumps(value, default=str)
    return text if len(text) <= 60 else text[:57] + "..."


@dataclass(frozen=True, slots=True, kw_only=True)
class CableDescription(ActuatorDescription):
    """Cable that a joint of kind "cable" pulls; it slides through points of a body.

    Its coordinate is the cable displacement: the shortening relative to its rest length, in [m]. Commands are
    displacements or tensions, see `control`. The joint's position is the actual displacement, which differs
    from the command where the cable is slack, at its largest tension, or stretched: with the compliance
    c = compliance + rest length / axial_stiffness, a taut cable has the tension
    pretension + (command - displacement) / c.

    Attributes:
        body: Name of the deformable body that carries the points.
        points: Points in the frame of `placement`, from the pulled end to the anchored one; at least two, or
            one in addition to a pull point. Or a file that lists them (JSON or YAML).
        group: Instead of points, the name of a group in the mesh file (a physical group of Gmsh): its nodes,
            starting with the one nearest to the pull point, each followed by the nearest remaining one.
        placement: Placement of the frame of `points` (scale converts file units to [m]).
        pull_point: Point in world coordinates in [m] where the cable leaves the robot; None: the first of
            `points`.
        pull_on: Name of the joint that carries the pull point; None: it is fixed in space.
        guides: Points in world coordinates in [m] over which the cable runs between pull point and `points`,
            as over the holes of a plate; `pull_on` carries them, too. They need a pull point.
        control: "displacement": commands are displacements in [m]. "force": commands are tensions in [N].
        pull_only: Whether the cable can go slack; False makes it a rod that can push, for comparison.
        max_tension: Largest tension in [N], > 0; None: not limited.
        rest_length: Length in [m] at displacement 0; None: the length at the start of the scene.
        axial_stiffness: EA of the cable in [N]: force per strain of its rest length; None: this length does
            not stretch.
        compliance: Stretch in [m/N] that does not depend on the rest length, such as that of the cable
            between the pull point and the winch, or of a spring, >= 0.
        pretension: Tension in [N] at displacement 0 under the command 0, >= 0; only of cables that stretch
            and are not commanded by tension.
        friction: Coefficient of friction at the points between the ends, >= 0: a cable that slides over a
            point where it turns by an angle a loses the share 1 - exp(-friction a) of its tension there.
        friction_per_length: Share of the tension lost per length in [1/m], >= 0, as in a narrow channel.
        presliding: Motion in [m], > 0, in which friction grows from zero to that of sliding; a reversal takes
            twice as long.
    """

    kind: ClassVar[str] = "cable"
    body: str
    points: tuple[Vector, ...] | Path = ()
    group: str | None = None
    placement: Placement = Placement()
    pull_point: Vector | None = field(default=None, metadata=POINT)
    pull_on: str | None = None
    guides: tuple[Vector, ...] = field(default=(), metadata=POINT)
    control: Literal["displacement", "force"] = "displacement"
    pull_only: bool = True
    max_tension: float | None = None
    rest_length: float | None = None
    axial_stiffness: float | None = None
    compliance: float = 0.0
    pretension: float = 0.0
    friction: float = 0.0
    friction_per_length: float = 0.0
    presliding: float = 1e-4

    def __post_init__(self) -> None:
        if self.group is not None:
            if self.points != ():
                raise SceneError("cable: give points or a group, not both; remove one of them")
            if self.pull_point is None:
                raise SceneError("cable: a group has no first point; give a pull_point")
        elif not isinstance(self.points, Path):
            least = 2 if self.pull_point is None else 1
            if len(self.points) < least:
                raise FieldError("cable", "points", len(self.points), f"at least {least} points")
            for point in self.points:
                need_finite("cable", "points", point)
        if self.pull_point is not None:
            need_finite("cable", "pull_point", self.pull_point)
        for name in ("pull_on", "guides"):
            if getattr(self, name) and self.pull_point is None:
                raise SceneError(f"cable: {name} needs a pull_point; give one or remove {name}")
        for point in self.guides:
            need_finite("cable", "guides", point)
        units = {"max_tension": "N", "rest_length": "m", "axial_stiffness": "N", "presliding": "m"}
        for name, unit in units.items():
            value = getattr(self, name)
            if value is not None:
                need_positive("cable", name, value, unit)
        need_not_negative("cable", "friction", self.friction, "")
        need_not_negative("cable", "friction_per_length", self.friction_per_length, "1/m")
        if not self.pull_only and (self.friction or self.friction_per_length):
            raise SceneError("cable: friction is for cables that only pull; remove it or pull_only: false")
        need_not_negative("cable", "compliance", self.compliance, "m/N")
        need_not_negative("cable", "pretension", self.pretension, "N")
        if self.pretension > 0.0 and self.axial_stiffness is None and self.compliance == 0.0:
            raise SceneError(
                "cable: pretension needs a cable that stretches; give axial_stiffness or compliance"
            )
        if self.pretension > 0.0 and self.by_effort:
            raise SceneError("cable: with `control: force` the command is the tension; remove pretension")
        if self.max_tension is not None and self.pretension > self.max_tension:
            raise FieldError(
                "cable", "pretension", self.pretension, f"at most max_tension, {self.max_tension:g} N"
            )

    @property
    def by_effort(self) -> bool:
        """Whether commands are tensions (force control) instead of shortenings."""
        return self.control == "force"

    @property
    def units(self) -> JointUnits:
        """Units of the cable's joint; commands are forces or shortenings, positions are shortenings."""
        return JointUnits(FORCE if self.by_effort else SHORTENING, SHORTENING, "N")

    @property
    def route(self) -> Route:
        """Its way through points of its body."""
        return Route(
            body=self.body,
            points=self.points_in,
            pull_point=self.pull_point,
            pull_on=self.pull_on,
            guides=self.guides,
            placed=self.placement != Placement(),
            special=tuple(
                name
                for name in ("axial_stiffness", "compliance", "pretension", "friction", "friction_per_length")
                if getattr(self, name)
            ),
            pull_only=self.pull_only,
            largest_force=self.max_tension,
            rest_length=self.rest_length,
        )

    @property
    def edited_numbers(self) -> tuple[EditedNumber, ...]:
        """The largest tension, and the largest displacement if it is commanded."""
        tension = EditedNumber("Largest tension [N]", 1.0, (self.kind, "max_tension"))
        shortening = EditedNumber("Shortened by at most [mm]", 1e3, ("limits", "upper"))
        return (tension,) if self.by_effort else (tension, shortening)

    def points_in(self, mesh: TetMesh | None = None) -> Array:
        """Return the points in the world in [m], shape (k, 3), at the start of the scene.

        Args:
            mesh: Mesh of the body, for a cable that names a group of it.

        Raises:
            SceneError: the mesh has no such group.
            ConfigError: a file of points cannot be read.
        """
        if self.group is not None:
            groups = {} if mesh is None else mesh.groups
            if mesh is None or self.group not in groups:
                raise SceneError(
                    f"cable: the mesh of body {self.body} has no group {self.group!r}; its groups are "
                    f"{listing(groups)}"
                )
            return _chain_points(mesh.points[groups[self.group]], np.array(self.pull_point, dtype=float))
        points = self.points
        read = np.array(points, dtype=float) if isinstance(points, tuple) else read_cable_points(points)
        return place(read.reshape(-1, 3), self.placement)

    def bodies(self) -> dict[str, str | None]:
        """Return the name of the body that carries the cable, under the key `body`."""
        return {"body": self.body}

    def carriers(self) -> dict[str, str | None]:
        """Return the name of the joint that carries the pull point, under the key `pull_on`."""
        return {"pull_on": self.pull_on}

    def carried_by(self, joint: str) -> CableDescription:
        """Return the description with a pull point that is fixed in space moved onto a joint."""
        stands = self.pull_point is not None and self.pull_on is None
        return replace(self, pull_on=joint) if stands else self


def _chain_points(points: Array, start: Array) -> Array:
    """Return points (k, 3) as a chain: the one nearest to `start`, then each time the nearest remaining."""
    left, here, chain = points, start, []
    while len(left):
        nearest = int(np.argmin(np.linalg.norm(left - here, axis=1)))
        here = left[nearest]
        chain.append(here)
        left = np.delete(left, nearest, axis=0)
    return np.array(chain)
