"""What a key press does: pure rules from key, bindings, measured joints and limits to effects."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, TypeAlias

from softsim_core.errors import listing
from softsim_core.mechanics.limits import JointLimits
from softsim_core.scene.control import Action, KeyBinding
from softsim_core.scene.description import JointDescription
from softsim_core.scene.robot import RobotDescription
from softsim_core.units import MILLIMETRE, degrees
from softsim_ros.teleop.decoder import KEY_NAMES, KeyPress
from softsim_ros.teleop.goal import GOAL_KEYS, GOAL_STEP_M, PublishGoal, move_goal
from softsim_ros.teleop.state import TeleopState, held_positions, with_command
from softsim_ros.teleop.tilt import PublishTilt, turn_reference

REPEAT_INTERVAL_S: Final = 0.1
"""Shortest time in [s] between two effects of one key: a held key moves at most ten steps per second."""

HOLD_GAP_S: Final = 0.75
"""A key seen again within this time in [s] is still held: longer than the delay before keys repeat."""

HELP_KEY: Final = "?"

INVERSE_OWNS: Final = "nothing moved: inverse control drives the joints; press its key again to take over"

BUILT_IN: Final[Mapping[str, KeyBinding]] = {
    "space": KeyBinding(action="pause", help="pause / go on"),
    "r": KeyBinding(action="reset", help="reset the simulation"),
    "x": KeyBinding(action="quit", help="quit"),
}
"""Keys every robot has unless its file binds them to something else."""


@dataclass(frozen=True, slots=True)
class PublishCommand:
    """Publish joint positions in [rad] or [m], joint order."""

    values: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class CallAction:
    """Call the service behind an action."""

    action: Action


@dataclass(frozen=True, slots=True)
class Quit:
    """End the teleop."""


Effect: TypeAlias = PublishCommand | PublishGoal | PublishTilt | CallAction | Quit


def key_table(robot: RobotDescription) -> dict[str, KeyBinding]:
    """All bindings of a robot: its own, then the built-in ones it leaves free."""
    return {**robot.keys, **{key: binding for key, binding in BUILT_IN.items() if key not in robot.keys}}


def unknown_keys(robot: RobotDescription) -> str | None:
    """A sentence about keys of the robot's file that no terminal sends, or None."""
    unknown = [key for key in robot.keys if key not in KEY_NAMES]
    if not unknown:
        return None
    names = sorted(key for key in KEY_NAMES if len(key) > 1)
    return f"no terminal sends the key {listing(unknown)}; use a letter, digit or sign, or {listing(names)}"


def press(
    state: TeleopState,
    robot: RobotDescription,
    key: KeyPress,
    now: float,
    repeat_interval_s: float = REPEAT_INTERVAL_S,
    goal_step_m: float = GOAL_STEP_M,
) -> tuple[TeleopState, tuple[Effect, ...]]:
    """The state after a key press, and what is to be done.

    While inverse control is on the keys of GOAL_KEYS move the goal, or turn the closed loop's reference while
    that gives the goals, whatever the robot's file binds them to; keys that would move
    joints, poses and the start animation among them, are refused.

    Args:
        state: What is known before.
        robot: Joints, poses, key bindings, command settings.
        key: The key; plain and Ctrl+key do the same, except that Ctrl+C always quits.
        now: Steady clock in [s].
        repeat_interval_s: Shortest time in [s] between two steps of one held key.
        goal_step_m: How far a key moves the goal, in [m].
    """
    if key == KeyPress("c", ctrl=True):
        return replace(state, last_key=str(key)), (Quit(),)
    held = now - state.seen_at.get(key.name, -math.inf) < HOLD_GAP_S
    since = now - state.acted_at.get(key.name, -math.inf)
    state = replace(state, last_key=str(key), seen_at={**state.seen_at, key.name: now})
    if state.inverse and key.name in GOAL_KEYS:
        if since < repeat_interval_s:
            return state, ()
        state = replace(state, acted_at={**state.acted_at, key.name: now})
        if state.tilt is not None:
            return turn_reference(state, key.name)
        return move_goal(state, key.name, goal_step_m, now)
    binding = key_table(robot).get(key.name)
    if binding is None:
        if key.name == HELP_KEY:
            return replace(state, show_help=state.show_help if held else not state.show_help), ()
        if any(controller.on_key for controller in robot.controllers):
            return replace(state, message=f"{key} goes to the scene's own code"), ()
        return replace(state, message=f"{key} is not bound; {HELP_KEY} shows the keys"), ()
    if binding.action is not None:
        return _action(state, key, binding.action, held)
    if since < _shortest_interval(robot, binding, repeat_interval_s):
        return state, ()
    state = replace(state, acted_at={**state.acted_at, key.name: now})
    refusal = _refusal(state, now)
    if refusal:
        return replace(state, message=refusal), ()
    return _move(state, robot, binding, now)


def _action(
    state: TeleopState, key: KeyPress, action: Action, held: bool
) -> tuple[TeleopState, tuple[Effect, ...]]:
    if action == "quit":
        return state, (Quit(),)
    if held:  # a held key must not switch something on and off
        return state, ()
    if action == "start" and state.inverse:
        return replace(state, message=INVERSE_OWNS), ()
    return replace(state, message=f"{key}: {action} ..."), (CallAction(action),)


def _shortest_interval(robot: RobotDescription, binding: KeyBinding, repeat_interval_s: float) -> float:
    """Time in [s] between two steps, so that a held key moves no joint faster than its top speed."""
    speeds = [joint.limits.speed for joint in robot.joints if joint.name in binding.joints]
    return max(repeat_interval_s, *(abs(binding.by) / speed for speed in speeds), 0.0)


def _refusal(state: TeleopState, now: float) -> str:
    if state.measured is None:
        return "nothing moved: no joint_states received yet; is the simulator running?"
    if not state.is_fresh(now):
        if state.paused:
            return "nothing moved: the simulation is paused; press the pause key again to go on"
        return (
            f"nothing moved: no joint_states for {now - state.measured_at:.0f} s; is the simulator running?"
        )
    if state.inverse:
        return INVERSE_OWNS
    return ""


def _move(
    state: TeleopState, robot: RobotDescription, binding: KeyBinding, now: float
) -> tuple[TeleopState, tuple[Effect, ...]]:
    assert state.measured is not None
    if binding.pose is not None:
        wanted, moved = tuple(robot.poses[binding.pose]), robot.joint_names
        title = f"pose {binding.pose}"
    else:
        held = held_positions(state, now)
        wanted = tuple(
            position + binding.by if joint.name in binding.joints else hold
            for joint, position, hold in zip(robot.joints, state.measured, held, strict=True)
        )
        moved = binding.joints
        title = ", ".join(
            f"{joint.name} to {format_position(joint, value)}"
            for joint, value in zip(robot.joints, wanted, strict=True)
            if joint.name in moved
        )
    return _command(state, robot, wanted, moved, title, now)


def move_joint(
    state: TeleopState, robot: RobotDescription, joint: str, position: float, now: float
) -> tuple[TeleopState, tuple[Effect, ...]]:
    """The state after one joint was asked to a position, and what is to be done; the others hold.

    Args:
        state: What is known before.
        robot: Joints and limits.
        joint: Name of the joint.
        position: Where it shall go, in [rad] or [m].
        now: Steady clock in [s].
    """
    refusal = _refusal(state, now)
    if refusal:
        return replace(state, message=refusal), ()
    held = dict(zip(robot.joint_names, held_positions(state, now), strict=True))
    wanted = tuple({**held, joint: position}.values())
    return _command(state, robot, wanted, (joint,), f"{joint} by slider", now)


def _command(
    state: TeleopState,
    robot: RobotDescription,
    wanted: Sequence[float],
    moved: Sequence[str],
    title: str,
    now: float,
) -> tuple[TeleopState, tuple[Effect, ...]]:
    values, stopped = _limited(state, robot, wanted, moved)
    message = listing(stopped) if stopped else title
    state = with_command(replace(state, message=message), robot, values, now, own=True)
    return state, (PublishCommand(values),)


def enforces_limits(state: TeleopState, robot: RobotDescription) -> bool:
    """Whether joint limits hold: as the simulator says, or before it does, as the robot's file says."""
    return robot.commands.enforce_limits if state.enforce_limits is None else state.enforce_limits


def _limited(
    state: TeleopState, robot: RobotDescription, wanted: Sequence[float], moved: Sequence[str]
) -> tuple[tuple[float, ...], list[str]]:
    """The wanted positions, within enforced limits, and a note for each moved joint that stops there."""
    if not enforces_limits(state, robot):
        return tuple(wanted), []
    values = tuple(joint.limits.clamp(value) for joint, value in zip(robot.joints, wanted, strict=True))
    notes = [
        f"{joint.name} stops at its {_limit_name(joint.limits, value)} limit {format_position(joint, value)}"
        for joint, before, value in zip(robot.joints, wanted, values, strict=True)
        if joint.name in moved and value != before
    ]
    return values, notes


def _limit_name(limits: JointLimits, value: float) -> str:
    return "lower" if value == limits.lower else "upper"


def format_position(joint: JointDescription, position: float) -> str:
    """A joint position for a person: "-1.4965 rad (-85.7 deg)" or "0.0123 m (12.3 mm)"."""
    if joint.kind == "revolute":
        return f"{position:.4f} rad ({degrees(position):.1f} deg)"
    return f"{position:.4f} m ({position / MILLIMETRE:.1f} mm)"
