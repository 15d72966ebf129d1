"""Keys pressed on a robot on paper: the rules of keys, joints and goals one after the other, without ROS."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TypeAlias

from softsim_core.scene import RobotDescription
from softsim_ros.client import (
    EffectorPose,
    RobotState,
    Tilt,
    decide,
    format_point,
    moved_goal,
    with_measurement,
)
from softsim_ros.keys import CallAction, KeyPress, KeyState, MoveGoal, Quit, SetReference, press as rules

Effect: TypeAlias = tuple[float, ...] | EffectorPose | Tilt | CallAction | Quit
"""What goes out: joint positions, a goal, a reference of the closed loop, an action, the end."""


@dataclass(frozen=True)
class Typed:
    """What a person at the keys sees: robot, keys, newest sentence."""

    state: RobotState = field(default_factory=RobotState)
    keys: KeyState = field(default_factory=KeyState)
    message: str = ""

    def knowing(self, **values: object) -> Typed:
        """With other values of the robot's state."""
        return replace(self, state=replace(self.state, **values))

    def measuring(self, positions: Sequence[float], now: float) -> Typed:
        """After a measurement of all joints."""
        return replace(self, state=with_measurement(self.state, positions, now))


def press(
    typed: Typed, robot: RobotDescription, key: KeyPress, now: float
) -> tuple[Typed, tuple[Effect, ...]]:
    """What is seen after a key press, and what goes out."""
    keys, deed, sentence = rules.press(typed.keys, robot, typed.state, key, now)
    typed = replace(typed, keys=keys, message=sentence or typed.message)
    if deed is None:
        return typed, ()
    if isinstance(deed, CallAction | Quit):
        return typed, (deed,)
    if isinstance(deed, SetReference):
        return typed.knowing(tilt=deed.reference), (deed.reference,)
    if isinstance(deed, MoveGoal):
        goal = moved_goal(typed.state, deed.shift, now)
        if goal is None:
            return replace(typed, message="goal not moved: no effector pose received yet"), ()
        return replace(typed.knowing(goal=goal), message=f"goal {format_point(goal)} mm"), (goal,)
    decision = decide(typed.state, robot, deed, now)
    typed = replace(typed, state=decision.state, message=decision.message)
    return typed, () if decision.values is None else (decision.values,)
