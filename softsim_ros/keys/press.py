"""Keys: their names, a robot's table of them, and the action that a press asks for."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final, Literal, NamedTuple, TypeAlias

from softsim_core.base import degrees
from softsim_core.scene import Action, KeyBinding, RobotDescription
from softsim_ros.client import GoToPose, RobotState, StepJoints, Tilt


@dataclass(frozen=True, slots=True)
class KeyPress:
    """One key, plain or with Ctrl.

    Attributes:
        name: One of `softsim_core.scene.control.KEY_NAMES`: "up", "plus", "space", a lower-case letter, a
            digit, a punctuation character.
        ctrl: Whether Ctrl (or Cmd) was down. Tab is Ctrl+I on every terminal.
    """

    name: str
    ctrl: bool = False

    def __str__(self) -> str:
        label = self.name.replace("_", " ").capitalize() if len(self.name) > 1 else self.name
        return f"Ctrl+{label.capitalize()}" if self.ctrl else label


HELP_KEY: Final = "?"

BUILT_IN: Final[Mapping[str, KeyBinding]] = {
    "space": KeyBinding(action="pause", help="pause / go on"),
    "r": KeyBinding(action="reset", help="reset the simulation"),
    "x": KeyBinding(action="quit", help="quit"),
}
"""Keys of every robot, unless its file binds them to something else."""

STOP_KEYS: Final[Mapping[str, KeyBinding]] = {
    "enter": KeyBinding(action="e_stop", help="E-STOP"),
    "e": KeyBinding(action="clear_e_stop", help="release the e-stop"),
}
"""Keys of every robot with a servo board. Enter is the emergency stop because it is the largest key."""

GOAL_STEP_M: Final = 0.002
"""Distance in [m] by which one press moves the goal."""

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
"""Angle in [rad] by which one press turns the reference of the closed loop."""

TILT_KEYS: Final[Mapping[str, str]] = {
    "up": "tilt about y",
    "right": "tilt about x",
    "plus": "more tilt",
    "minus": "less tilt",
}
"""Actions of keys while the closed loop is on: arrows choose an axis (x and z in a frame with y up)."""


def key_table(robot: RobotDescription) -> dict[str, KeyBinding]:
    """Return all bindings of a robot: its own, then the built-in ones of keys that it leaves free."""
    every = {**BUILT_IN, **(STOP_KEYS if robot.board else {})}
    return {**robot.keys, **{key: binding for key, binding in every.items() if key not in robot.keys}}


def key_of(robot: RobotDescription, action: Action) -> str | None:
    """Return the key that a robot has for an action, or None."""
    return next((key for key, binding in key_table(robot).items() if binding.action == action), None)


def goal_help(name: str) -> str:
    """Return the action of a goal key, for the display: "goal +x"."""
    sign, axis = GOAL_KEYS[name]
    return f"goal {'+' if sign > 0 else '-'}{axis}"


REPEAT_INTERVAL_S: Final = 0.1
"""Shortest time in [s] between two effects of one key: a held key moves at most ten steps per second."""

HOLD_GAP_S: Final = 0.75
"""Longest time in [s] between two repeats of a held key; it exceeds the delay before keys repeat."""


@dataclass(frozen=True, slots=True)
class MoveGoal:
    """Action that moves the effector's goal along world x, y, z in [m]."""

    shift: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class SetReference:
    """Action that sends the closed loop a reference."""

    reference: Tilt


@dataclass(frozen=True, slots=True)
class CallAction:
    """Action given by its name."""

    action: Action


@dataclass(frozen=True, slots=True)
class Quit:
    """Action that ends the program."""


KeyAction: TypeAlias = StepJoints | GoToPose | MoveGoal | SetReference | CallAction | Quit


@dataclass(frozen=True, slots=True)
class KeyState:
    """State of the keys.

    Attributes:
        pressed_at: When each key was last pressed, including repeats, in [s].
        acted_at: When each key last had an effect, in [s].
        last_key: Label of the newest key.
        show_help: Whether the key table is shown.
        axis: The axis about which keys turn the closed loop's reference.
    """

    pressed_at: Mapping[str, float] = field(default_factory=dict)
    acted_at: Mapping[str, float] = field(default_factory=dict)
    last_key: str = ""
    show_help: bool = True
    axis: Literal["x", "y"] = "y"


class Pressed(NamedTuple):
    """Result of a press: the keys' new state, the action to run, and a message (empty: none)."""

    keys: KeyState
    action: KeyAction | None = None
    message: str = ""


def press(
    keys: KeyState,
    robot: RobotDescription,
    state: RobotState,
    key: KeyPress,
    now: float,
    repeat_interval_s: float = REPEAT_INTERVAL_S,
    goal_step_m: float = GOAL_STEP_M,
) -> Pressed:
    """Return the action of a key press.

    While inverse control is on the keys of GOAL_KEYS move the goal. If the closed loop sends the goals, they
    turn its reference instead. Both override the bindings of the robot's file.

    Args:
        keys: State of the keys before the press.
        robot: Joints, poses, key bindings.
        state: State of the robot.
        key: The key; plain and Ctrl+key have the same action, except that Ctrl+C always quits.
        now: Steady clock in [s].
        repeat_interval_s: Shortest time in [s] between two steps of one held key.
        goal_step_m: Distance in [m] by which a key moves the goal.
    """
    if key == KeyPress("c", ctrl=True):
        return Pressed(replace(keys, last_key=str(key)), Quit())
    is_repeated = now - keys.pressed_at.get(key.name, -math.inf) < HOLD_GAP_S
    since = now - keys.acted_at.get(key.name, -math.inf)
    keys = replace(keys, last_key=str(key), pressed_at={**keys.pressed_at, key.name: now})
    acted = replace(keys, acted_at={**keys.acted_at, key.name: now})
    if state.inverse and key.name in GOAL_KEYS:
        if since < repeat_interval_s:
            return Pressed(keys)
        if state.tilt is not None:
            return _turn(acted, state.tilt, key.name)
        return Pressed(acted, _goal_shift(key.name, goal_step_m))
    binding = key_table(robot).get(key.name)
    if binding is None:
        return _handle_unbound_key(keys, robot, key, is_repeated)
    if binding.action is not None:
        return _action(keys, key, binding.action, is_repeated)
    if since < _shortest_interval(robot, binding, repeat_interval_s):
        return Pressed(keys)
    if binding.pose is not None:
        return Pressed(acted, GoToPose(binding.pose))
    return Pressed(acted, StepJoints(binding.joints, binding.by))


def _handle_unbound_key(keys: KeyState, robot: RobotDescription, key: KeyPress, is_repeated: bool) -> Pressed:
    if key.name == HELP_KEY:
        return Pressed(replace(keys, show_help=keys.show_help if is_repeated else not keys.show_help))
    if any(controller.on_key for controller in robot.controllers):
        return Pressed(keys, None, f"{key} goes to the scene's own code")
    return Pressed(keys, None, f"{key} is not bound; {HELP_KEY} shows the keys")


def _action(keys: KeyState, key: KeyPress, action: Action, is_repeated: bool) -> Pressed:
    if action == "quit":
        return Pressed(keys, Quit())
    if is_repeated and action != "e_stop":  # a held key must not switch something on and off
        return Pressed(keys)
    return Pressed(keys, CallAction(action), f"{key}: {action} ...")


def _goal_shift(name: str, step_m: float) -> MoveGoal:
    sign, axis = GOAL_KEYS[name]
    x, y, z = (sign * step_m if each == axis else 0.0 for each in "xyz")
    return MoveGoal((x, y, z))


def _turn(keys: KeyState, reference: Tilt, name: str) -> Pressed:
    """Return the action of a goal key while the closed loop sends the goals."""
    if name not in TILT_KEYS:
        return Pressed(keys, None, "nothing moved: the closed loop gives the goals")
    if name in ("up", "right"):
        keys = replace(keys, axis="y" if name == "up" else "x")
        return Pressed(keys, None, tilt_line(reference, keys.axis))
    step = TILT_STEP_RAD if name == "plus" else -TILT_STEP_RAD
    turned = reference._replace(**{keys.axis: round(getattr(reference, keys.axis) + step, 9)})
    return Pressed(keys, SetReference(turned), tilt_line(turned, keys.axis))


def tilt_line(reference: Tilt, axis: str) -> str:
    """Return the reference for the display, in degrees, and the axis that the keys turn."""
    x, y = (round(degrees(value), 1) + 0.0 for value in reference)  # + 0.0: no "-0.0"
    return f"tilt reference deg: x {x:.1f} y {y:.1f}   + and - turn {axis}"


def _shortest_interval(robot: RobotDescription, binding: KeyBinding, repeat_interval_s: float) -> float:
    """Return the time in [s] between two steps, so that a held key moves no joint above its top speed."""
    steps, moved = binding.steps, [joint for joint in robot.joints if joint.name in binding.joints]
    return max(repeat_interval_s, *(abs(steps[joint.name]) / joint.limits.speed for joint in moved), 0.0)
