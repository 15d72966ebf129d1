"""The effector goal under the arrow keys while inverse control drives the joints: pure functions, SI."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

from softsim_core.units import MILLIMETRE
from softsim_ros.teleop.state import STALE_AFTER_S, EffectorPose, TeleopState

GOAL_STEP_M: Final = 0.002
"""How far one press moves the goal, in [m]."""

GOAL_KEYS: Final[Mapping[str, tuple[int, str]]] = {
    "up": (1, "x"),
    "down": (-1, "x"),
    "left": (1, "y"),
    "right": (-1, "y"),
    "plus": (1, "z"),
    "minus": (-1, "z"),
}
"""Direction and world axis of each key while inverse control is on: REP-103, x forward, y left, z up."""


@dataclass(frozen=True, slots=True)
class PublishGoal:
    """Publish a goal for the effector."""

    goal: EffectorPose


def goal_help(name: str) -> str:
    """What a goal key does, for the display: "goal +x"."""
    sign, axis = GOAL_KEYS[name]
    return f"goal {'+' if sign > 0 else '-'}{axis}"


def move_goal(
    state: TeleopState, name: str, step_m: float, now: float
) -> tuple[TeleopState, tuple[PublishGoal, ...]]:
    """The state after a goal key, and the goal to publish.

    The first goal is the effector's present pose, moved by one step.

    Args:
        state: What is known before; inverse control is on.
        name: A key of GOAL_KEYS.
        step_m: Length of the step in [m].
        now: Steady clock in [s].
    """
    start = state.goal or known_effector(state, now)
    if start is None:
        return replace(state, message="goal not moved: no effector pose received yet"), ()
    sign, axis = GOAL_KEYS[name]
    index = "xyz".index(axis)
    position = list(start.position)
    position[index] = round(position[index] + sign * step_m, 9)
    goal = EffectorPose((position[0], position[1], position[2]), start.quaternion_xyzw)
    return replace(state, goal=goal, message=f"goal {format_point(goal)} mm"), (PublishGoal(goal),)


def known_effector(state: TeleopState, now: float) -> EffectorPose | None:
    """Where the effector is at `now` [s]; None when it was not heard of lately."""
    return state.effector if now - state.effector_at <= STALE_AFTER_S else None


def goal_line(state: TeleopState, now: float) -> str:
    """Goal, effector and the distance between them for the display, in mm."""
    effector = known_effector(state, now)
    goal = "at the effector" if state.goal is None else format_point(state.goal)
    line = f"goal mm: {goal}   effector: {'no data' if effector is None else format_point(effector)}"
    if effector is not None and state.goal is not None:
        line += f"   off by {math.dist(effector.position, state.goal.position) / MILLIMETRE:.2f}"
    return line


def format_point(pose: EffectorPose) -> str:
    """A position as "x 0.0 y -2.0 z 31.5", in mm."""
    values = (round(value / MILLIMETRE, 1) + 0.0 for value in pose.position)  # + 0.0: no "-0.0"
    return " ".join(f"{axis} {value:.1f}" for axis, value in zip("xyz", values, strict=True))
