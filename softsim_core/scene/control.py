"""Control of a robot: commands, start move, keys, inverse control. Typed, immutable, SI."""

from __future__ import annotations

import math
import string
import warnings
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

from softsim_core.base import (
    FieldError,
    SceneError,
    Vector,
    need_finite,
    need_not_negative,
    need_positive,
)

EffectorTask: TypeAlias = Literal["position", "orientation", "height_tilt", "pose"]
Action: TypeAlias = Literal["start", "send", "e_stop", "clear_e_stop", "inverse", "reset", "pause", "quit"]


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandSettings:
    """Handling of commands by the simulator.

    Attributes:
        enforce_limits: Enforce joint limits (position and speed); False allows full turns, in simulation
            only.
        out_of_range: "clamp" to the nearest allowed position, or "refuse" the whole command.
    """

    enforce_limits: bool = True
    out_of_range: Literal["clamp", "refuse"] = "clamp"


@dataclass(frozen=True, slots=True, kw_only=True)
class StartAnimation:
    """The robot's start move, in simulation only: joints move from rest to a named pose, bases slide in.

    Attributes:
        pose: Name of the final pose.
        duration: Time in [s], > 0.
        base_shift: Shift in [m] of every joint's base along its slide_axis.
        at_start: Play it as soon as the simulation runs.
    """

    pose: str
    duration: float = 0.2
    base_shift: float = 0.0
    at_start: bool = False

    def __post_init__(self) -> None:
        need_positive("start animation", "duration", self.duration, "s")
        need_finite("start animation", "base_shift", (self.base_shift,))


KEY_NAMES: Final = frozenset(
    {"up", "down", "left", "right", "home", "end", "insert", "delete", "page_up", "page_down"}
    | {"space", "plus", "minus", "enter", "escape", "backspace"}
    | (set(string.digits + string.ascii_lowercase + string.punctuation) - set("+=-_"))
)
"""Key names that a binding can use, as terminals and browsers send them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class KeyBinding:
    """Action of a teleop key: move joints `by` [rad] or [m], go to a `pose`, or an `action`.

    `by` is one number for all joints, or one for each, as for tendons that bend an arm together.
    """

    help: str
    joints: tuple[str, ...] = ()
    by: float | tuple[float, ...] = 0.0
    pose: str | None = None
    action: Action | None = None

    def __post_init__(self) -> None:
        if sum((bool(self.joints), self.pose is not None, self.action is not None)) != 1:
            raise SceneError(f"key binding {self.help!r}: give exactly one of joints, pose and action")
        need_finite(f"key binding {self.help!r}", "by", tuple(self.steps.values()))

    @property
    def steps(self) -> dict[str, float]:
        """Step of each joint in [rad] or [m] by its name.

        Raises:
            SceneError: `by` lists more or fewer numbers than there are joints.
        """
        by = self.by if isinstance(self.by, tuple) else (self.by,) * len(self.joints)
        if len(by) != len(self.joints):
            raise SceneError(
                f"key binding {self.help!r}: by has {len(by)} numbers for {len(self.joints)} joints"
            )
        return dict(zip(self.joints, by, strict=True))


@dataclass(frozen=True, slots=True, kw_only=True)
class InverseSettings:
    """Inverse control: the effector coordinates that follow the goal, with weights and limits.

    Attributes:
        task: Coordinates that follow a goal: "position" (x, y, z), "orientation" (a rotation), "height_tilt"
            (z and the direction of the effector's z axis) or "pose" (all six).
        position_weights: Weight of the error along world x, y, z in [-], >= 0.
        orientation_weights: Weight of the rotation error about world x, y, z in [-], >= 0.
        lever: Length in [m] that converts an angle to a displacement, > 0.
        rate: Largest rate in [1/s] at which the error is removed, > 0; a robot with a long slowest period is
            controlled at the lower rate that this period allows.
        gain: Deprecated, see `rate`: share of the error that one control tick removes, in (0, 1].
        max_shift: Largest position error in [m] along an axis that a tick considers, > 0; for a robot that is
            controlled at a lower rate it is scaled up, so that a tick requests the same displacement.
        max_turn: Largest rotation error in [rad] about an axis that a tick considers, > 0; scaled likewise.
        effort_weight: Weight of small joint efforts against tracking in [-], >= 0; decides between joints
            with the same effect.
        posture_weight: Weight of staying near `posture` against tracking in [-], >= 0.
        posture: Name of the pose that `posture_weight` pulls to; None: the pose at the start of control.
        retry: Whether a robot that gets no nearer to a goal goes back to its posture, and tries once more.
        lower, upper: Narrower joint interval in [rad] or [m] for all joints; None: the joints' own limits.
        speed: Lower joint speed in [rad/s] or [m/s], > 0; None: the joints' own.
        torque_limit: Largest holding torque in [N m] or force in [N] of a joint, > 0; None: not limited.
        min_tension: Least tension in [N] of tendons that pull only, >= 0. They are elastic, or move with a
            pretension, so that it can be kept.
        backend: Effector Jacobian by the static tangent ("analytic") or from sampled equilibria ("sampled").
        feedback_gain: Rate in [1/s] at which the model's error against the measured pose is learned, >= 0.
        max_correction: Largest learned position error in [m], >= 0; anti-windup.
        max_correction_turn: Largest learned rotation error in [rad], >= 0; anti-windup.
        tolerance: Distance in [m] within which a goal is reached, > 0.
        tolerance_turn: Angle in [rad] within which a goal is reached, > 0.
    """

    task: EffectorTask = "position"
    position_weights: Vector = (1.0, 1.0, 1.0)
    orientation_weights: Vector = (1.0, 1.0, 1.0)
    lever: float = 0.03
    rate: float = 70.0
    gain: float | None = None
    max_shift: float = 0.030
    max_turn: float = 0.2
    effort_weight: float = 1.0e-6
    posture_weight: float = 0.0
    posture: str | None = None
    retry: bool = False
    lower: float | None = None
    upper: float | None = None
    speed: float | None = None
    torque_limit: float | None = None
    min_tension: float = 0.0
    backend: Literal["analytic", "sampled"] = "analytic"
    feedback_gain: float = 5.0
    max_correction: float = 0.010
    max_correction_turn: float = 0.2
    tolerance: float = 1.0e-4
    tolerance_turn: float = 1.0e-3

    def __post_init__(self) -> None:
        units = (("lever", "m"), ("rate", "1/s"), ("max_shift", "m"), ("max_turn", "rad"), ("tolerance", "m"))
        for name, unit in (*units, ("tolerance_turn", "rad"), ("speed", ""), ("torque_limit", "")):
            value = getattr(self, name)
            if value is not None:
                need_positive("inverse", name, value, unit)
        weights = ("effort_weight", "posture_weight", "feedback_gain", "min_tension")
        for name in (*weights, "max_correction", "max_correction_turn"):
            need_not_negative("inverse", name, getattr(self, name), "")
        for name in ("position_weights", "orientation_weights"):
            if not all(0.0 <= weight < math.inf for weight in getattr(self, name)):
                raise FieldError("inverse", name, list(getattr(self, name)), "three numbers >= 0")
        if self.gain is not None:
            if not 0.0 < self.gain <= 1.0:
                raise FieldError("inverse", "gain", self.gain, "> 0 and <= 1")
            warnings.warn(
                f"inverse.gain = {self.gain:g} is deprecated: a share of one tick is another speed at each "
                "dt; write `rate` in 1/s instead, -ln(1 - gain) / dt",
                stacklevel=2,
            )
        for name in ("lower", "upper"):
            if math.isnan(getattr(self, name) or 0.0):
                raise FieldError("inverse", name, math.nan, "a number (or absent)")
        if self.lower is not None and self.upper is not None and not self.lower <= self.upper:
            raise FieldError("inverse", "lower", self.lower, f"<= upper = {self.upper}")

    def rate_at(self, dt: float) -> float:
        """Return the rate in [1/s] for ticks of dt [s]: `rate`, or the rate equivalent to `gain`."""
        if self.gain is None:
            return self.rate
        return math.inf if self.gain == 1.0 else -math.log1p(-self.gain) / dt
