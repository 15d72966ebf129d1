"""What a scene says of a cable; typed, SI."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar, Literal

from softsim_core.actuation.building import ActuatorDescription
from softsim_core.errors import SceneError
from softsim_core.units import FORCE, SHORTENING, JointUnits
from softsim_core.values import POINT, FieldError, Placement, Vector, need_finite, need_positive


@dataclass(frozen=True, slots=True, kw_only=True)
class CableDescription(ActuatorDescription):
    """The cable that a joint of kind "cable" pulls: it slides without friction through points of a body.

    Its coordinate is the cable displacement: by how much it is shortened against its rest length, in [m].
    Commands are displacements; the joint's position is the real one, which differs where the cable is slack
    or at its largest tension.

    Attributes:
        body: Name of the deformable body that carries the points.
        points: Points in the frame of `placement`, from the pulled end to the anchored one; at least two, or
            one beside a pull point. Or a file that lists them (JSON or YAML).
        group: Instead of points, a group of the mesh's file by name (a physical group of Gmsh): its nodes,
            from the one nearest to the pull point on, each time the nearest of those that are left.
        placement: Where the frame of `points` sits (scale converts file units to [m]).
        pull_point: Point in world coordinates in [m] where the cable leaves the robot; None: the first of
            `points` plays that part.
        pull_on: None: the pull point is fixed in space. A joint name: it moves with that joint.
        control: "displacement": commands are displacements in [m]. "force": commands are tensions in [N].
        pull_only: A cable goes slack (True); False makes it a rod that can push, for comparison.
        max_tension: Largest tension in [N], > 0; None: not limited.
        rest_length: Length in [m] at displacement 0; None: the length at the start of the scene.
    """

    kind: ClassVar[str] = "cable"
    body: str
    points: tuple[Vector, ...] | Path = ()
    group: str | None = None
    placement: Placement = Placement()
    pull_point: Vector | None = field(default=None, metadata=POINT)
    pull_on: str | None = None
    control: Literal["displacement", "force"] = "displacement"
    pull_only: bool = True
    max_tension: float | None = None
    rest_length: float | None = None

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
        if self.pull_on is not None and self.pull_point is None:
            raise SceneError("cable: pull_on needs a pull_point; give one or remove pull_on")
        for name, unit in (("max_tension", "N"), ("rest_length", "m")):
            value = getattr(self, name)
            if value is not None:
                need_positive("cable", name, value, unit)

    @property
    def by_effort(self) -> bool:
        """See ActuatorDescription."""
        return self.control == "force"

    @property
    def units(self) -> JointUnits:
        """See ActuatorDescription."""
        return JointUnits(FORCE if self.by_effort else SHORTENING, SHORTENING, "N")

    def bodies(self) -> dict[str, str | None]:
        """See ActuatorDescription."""
        return {"body": self.body}

    def carriers(self) -> dict[str, str | None]:
        """See ActuatorDescription."""
        return {"pull_on": self.pull_on}

    def carried_by(self, joint: str) -> CableDescription:
        """See ActuatorDescription."""
        stands = self.pull_point is not None and self.pull_on is None
        return replace(self, pull_on=joint) if stands else self
