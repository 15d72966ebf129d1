"""Description of a joint: the frame it moves or the actuator it commands; typed, SI."""

from __future__ import annotations

from dataclasses import dataclass

from softsim_core.base import (
    ANGLE,
    LENGTH,
    FieldError,
    JointUnits,
    Placement,
    SceneError,
    Vector,
    need_finite,
    need_not_negative,
    need_positive,
    need_unit,
    one_of,
)
from softsim_core.physics.actuation import FRAME_KINDS, ActuatorDescription, described_kinds
from softsim_core.physics.mechanics import JointLimits


@dataclass(frozen=True, slots=True, kw_only=True)
class JointDescription:
    """One scalar degree of freedom between a base frame and the frame it moves.

    Attributes:
        name: Unique name; the order of joints in the scene is the order of commands.
        kind: revolute ([rad] about `axis`), prismatic ([m] along `axis`), or the name of a kind of actuator,
            such as cable ([m] by which it is shortened).
        actuator: The description of that actuator, in files under the key named after its kind; its joint has
            no frame and no axis.
        parent: Name of an earlier joint in the list that carries this joint's base; chains may have any
            length.
        base: Base frame in the world, with the parent at rest (its scale is not used).
        axis: Unit axis in the base frame, through its origin.
        limits: Position interval and top speed.
        rest: Position at which the scene is built, in [rad] or [m].
        stiffness: None: the joint is exactly at its command (a prescribed unknown; its reaction is the
            holding torque). A number: a spring of that stiffness in [N m/rad] or [N/m] pulls it there.
        inertia: Generalised inertia in [kg m^2] or [kg] of a joint with stiffness.
        slide_axis: Direction in the base frame in which the start move shifts the base, in simulation only.
        horn_length: Length in [m] of the servo arm, for pictures only.
    """

    name: str
    kind: str = "revolute"
    actuator: ActuatorDescription | None = None
    parent: str | None = None
    base: Placement = Placement()
    axis: Vector = (0.0, 1.0, 0.0)
    limits: JointLimits = JointLimits()
    rest: float = 0.0
    stiffness: float | None = None
    inertia: float = 0.0
    slide_axis: Vector = (1.0, 0.0, 0.0)
    horn_length: float = 0.0

    def __post_init__(self) -> None:
        owner = f"joint {self.name}"
        need_unit(owner, "axis", self.axis)
        need_unit(owner, "slide_axis", self.slide_axis)
        need_finite(owner, "rest", (self.rest,))
        if self.stiffness is not None:
            need_positive(owner, "stiffness", self.stiffness, "(or absent)")
        need_not_negative(owner, "inertia", self.inertia, "")
        need_not_negative(owner, "horn_length", self.horn_length, "")
        kind, described = self.kind, described_kinds()
        if self.moves_frame:
            paired = self.actuator is None
            kind = kind if self.actuator is None else self.actuator.kind
        elif kind in described:
            paired = isinstance(self.actuator, described[kind])
        else:
            raise FieldError(owner, "kind", repr(kind), one_of(kind, (*FRAME_KINDS, *described)))
        if not paired:
            raise SceneError(f"{owner}: `{kind}` and kind = {kind} belong together; give both or neither")
        if not self.moves_frame and (self.stiffness is not None or self.parent is not None):
            raise SceneError(f"{owner}: a joint of kind {kind} takes no stiffness and no parent; remove them")

    @property
    def by_effort(self) -> bool:
        """Whether its command is an effort, such as the pressure of a chamber, not a position."""
        return self.actuator is not None and self.actuator.by_effort

    @property
    def units(self) -> JointUnits:
        """Units of its command, position and effort."""
        if self.actuator is not None:
            return self.actuator.units
        return JointUnits(ANGLE, ANGLE, "N·m") if self.kind == "revolute" else JointUnits(LENGTH, LENGTH, "N")

    @property
    def moves_frame(self) -> bool:
        """Whether it is a revolute or a prismatic joint, not an actuator's."""
        return self.kind in FRAME_KINDS
