"""What the teleop knows: measured and commanded joints, the robot's nodes, the last key; immutable, SI."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, Literal, NamedTuple, TypeAlias

from softsim_core.scene.robot import RobotDescription

STALE_AFTER_S: Final = 2.0
"""Age in [s] from which measured positions are no longer a base for a command."""

SETTLING_S: Final = 0.5
"""Time in [s] a joint gets, beyond its travel at top speed, to reach a command."""

REACHED: Final = 0.02
"""A joint that is this near to its command, in [rad] or [m], is there (a compliant servo sags a little)."""

_REMEMBERED_ECHOES: Final = 32

BridgeState: TypeAlias = Literal["not running", "init", "no-comm", "comm", "finalized", "changing"]


class EffectorPose(NamedTuple):
    """Position in [m] and unit quaternion (x, y, z, w) of the effector, or of its goal, in the world."""

    position: tuple[float, float, float]
    quaternion_xyzw: tuple[float, float, float, float]


class TiltReference(NamedTuple):
    """Reference of the closed loop: tilts about x and y in [rad], and the axis that the keys turn."""

    axis: Literal["x", "y"]
    x: float
    y: float


@dataclass(frozen=True, slots=True)
class TeleopState:
    """Everything a key press depends on and the display shows.

    Attributes:
        measured: Measured joint positions in [rad] or [m], joint order; None before the first message.
        measured_at: Time of the newest measurement, steady clock, in [s].
        commanded: Newest command on the topic, whoever sent it, same shape and unit; None: unknown.
        trusted_until: Time in [s] until which the joints may still be on their way to `commanded`.
        owns_command: `commanded` was sent from here, so it is ours to repeat where repeating is needed.
        echoes: Own commands that have not come back on the topic yet, oldest first.
        simulator: The simulator's state in its own word ("running", "paused", "stopped"); empty: not heard.
        real_time_factor: Simulated seconds a wall second in [-]; None: not heard.
        enforce_limits: Whether the simulator keeps joint limits; None: not heard, the robot's file decides.
        inverse: Inverse control is on, it owns the command topic; the arrow keys move the goal.
        inverse_note: The inverse controller's newest sentence, such as "unreachable, 3.2 mm away".
        goal: The goal these keys moved; None before the first step.
        effector: Where the effector is; None before the first message.
        effector_at: Time of that message, steady clock, in [s].
        tilt: The closed loop's reference while the loop is on; None: it is not.
        bridge: State of the servo bridge.
        pulses_us: Pulse widths in [us] that an emulated board measures on its pins; empty: there are none.
        pulses_at: Time of that message, steady clock, in [s]; without an emulated board there is none.
        seen_at: When each key was last seen, repeats included, in [s].
        acted_at: When each key last had an effect, in [s].
        last_key: Label of the newest key.
        message: Newest sentence for the person.
        show_help: The key table is shown.
    """

    measured: tuple[float, ...] | None = None
    measured_at: float = -math.inf
    commanded: tuple[float, ...] | None = None
    trusted_until: float = -math.inf
    owns_command: bool = False
    echoes: tuple[tuple[float, ...], ...] = ()
    simulator: str = ""
    real_time_factor: float | None = None
    enforce_limits: bool | None = None
    inverse: bool = False
    inverse_note: str = ""
    goal: EffectorPose | None = None
    effector: EffectorPose | None = None
    effector_at: float = -math.inf
    tilt: TiltReference | None = None
    bridge: BridgeState = "not running"
    pulses_us: tuple[float, ...] = ()
    pulses_at: float = -math.inf
    seen_at: Mapping[str, float] = field(default_factory=dict)
    acted_at: Mapping[str, float] = field(default_factory=dict)
    last_key: str = ""
    message: str = ""
    show_help: bool = True

    @property
    def paused(self) -> bool:
        """The simulation stands still because somebody paused it."""
        return self.simulator == "paused"

    def is_fresh(self, now: float) -> bool:
        """Whether the measured positions are recent enough to command from, at `now` in [s]."""
        return self.measured is not None and now - self.measured_at <= STALE_AFTER_S


def with_measurement(state: TeleopState, positions: Sequence[float], now: float) -> TeleopState:
    """The state after a measurement of all joints; a non-finite one is reported and not used."""
    if not all(map(math.isfinite, positions)):
        return replace(state, message="a joint position that is not a finite number arrived and was ignored")
    return replace(state, measured=tuple(positions), measured_at=now)


def with_heard_command(
    state: TeleopState, robot: RobotDescription, values: Sequence[float], now: float
) -> TeleopState:
    """The state after a command on the topic: our own changes nothing, another's becomes the newest."""
    heard = tuple(values)
    if heard in state.echoes:
        return replace(state, echoes=state.echoes[state.echoes.index(heard) + 1 :])
    if state.owns_command and heard == state.commanded:
        return state  # our own again: it is repeated
    if len(heard) != len(robot.joints) or not all(map(math.isfinite, heard)):
        return state  # the simulator refuses it and says so
    return with_command(state, robot, heard, now)


def with_command(
    state: TeleopState, robot: RobotDescription, values: tuple[float, ...], now: float, *, own: bool = False
) -> TeleopState:
    """The state once `values` are on their way to the joints; `own`: they will be heard back on the topic."""
    start = state.measured or values
    travel = max(
        (abs(b - a) / joint.limits.speed for a, b, joint in zip(start, values, robot.joints, strict=True)),
        default=0.0,
    )
    return replace(
        state,
        commanded=values,
        trusted_until=now + travel + SETTLING_S,
        owns_command=own,
        echoes=(*state.echoes, values)[-_REMEMBERED_ECHOES:] if own else state.echoes,
    )


def held_positions(state: TeleopState, now: float) -> tuple[float, ...]:
    """What to command joints that a key does not move: their command, or where they are if it was overridden.

    A joint keeps its command while it may still be moving there, or stands there; otherwise something else (a
    trajectory, a reset) moved it, and an old command must not pull it back.
    """
    assert state.measured is not None
    if state.commanded is None:
        return state.measured
    return tuple(
        command if now <= state.trusted_until or abs(command - position) <= REACHED else position
        for command, position in zip(state.commanded, state.measured, strict=True)
    )


def with_inverse(state: TeleopState, enabled: bool) -> TeleopState:
    """The state once inverse control is on, or off: either way the goal of before is forgotten."""
    return replace(state, inverse=enabled, goal=None, inverse_note="")
