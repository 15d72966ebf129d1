"""Which key does what: a robot's own bindings, those every robot has, and those of goal and tilt."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from softsim_core.scene.control import Action, KeyBinding
from softsim_core.scene.robot import RobotDescription

HELP_KEY: Final = "?"

BUILT_IN: Final[Mapping[str, KeyBinding]] = {
    "space": KeyBinding(action="pause", help="pause / go on"),
    "r": KeyBinding(action="reset", help="reset the simulation"),
    "x": KeyBinding(action="quit", help="quit"),
}
"""Keys every robot has unless its file binds them to something else."""

STOP_KEYS: Final[Mapping[str, KeyBinding]] = {
    "enter": KeyBinding(action="e_stop", help="E-STOP"),
    "e": KeyBinding(action="clear_e_stop", help="release the e-stop"),
}
"""Those of every robot with a servo board; the first is large, and known without looking."""

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

TILT_STEP_RAD: Final = 0.1
"""How far one press turns the reference of the closed loop, in [rad]."""

TILT_KEYS: Final[Mapping[str, str]] = {
    "up": "tilt about y",
    "right": "tilt about x",
    "plus": "more tilt",
    "minus": "less tilt",
}
"""What each key does while the closed loop is on: arrows choose an axis, in a frame with y up its x and z."""


def key_table(robot: RobotDescription) -> dict[str, KeyBinding]:
    """All bindings of a robot: its own, then the built-in ones it leaves free."""
    every = {**BUILT_IN, **(STOP_KEYS if robot.board else {})}
    return {**robot.keys, **{key: binding for key, binding in every.items() if key not in robot.keys}}


def key_of(robot: RobotDescription, action: Action) -> str | None:
    """The key that a robot has for an action."""
    return next((key for key, binding in key_table(robot).items() if binding.action == action), None)


def goal_help(name: str) -> str:
    """What a goal key does, for the display: "goal +x"."""
    sign, axis = GOAL_KEYS[name]
    return f"goal {'+' if sign > 0 else '-'}{axis}"
