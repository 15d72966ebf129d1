"""Where joints shall go: pure rules from a wish, measured joints and limits to a command. SI."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

from softsim_core.errors import CommandError, listing
from softsim_core.mechanics.limits import JointLimits, check_command
from softsim_core.scene.joint import JointDescription
from softsim_core.scene.robot import RobotDescription
from softsim_core.units import Unit
from softsim_ros.client.state import RobotState, commandable, enforces_limits, held_positions, with_command

INVERSE_OWNS = "nothing moved: inverse control drives the joints; press its key again to take over"


@dataclass(frozen=True, slots=True)
class StepJoints:
    """Move some joints `by` [rad] or [m] from their last commands, or from where something else put them."""

    joints: tuple[str, ...]
    by: float


@dataclass(frozen=True, slots=True)
class GoToPose:
    """Move all joints to a named pose."""

    pose: str


@dataclass(frozen=True, slots=True)
class MoveJoint:
    """Move one joint to a position in [rad] or [m]."""

    joint: str
    position: float


@dataclass(frozen=True, slots=True)
class MoveAll:
    """Move all joints to positions in [rad] or [m], joint order."""

    positions: tuple[float, ...]


Wish: TypeAlias = StepJoints | GoToPose | MoveJoint | MoveAll


class Decision(NamedTuple):
    """What comes of a wish: the state after it, a sentence, and the command (None: nothing moves)."""

    state: RobotState
    sentence: str
    values: tuple[float, ...] | None


def decide(state: RobotState, robot: RobotDescription, wish: Wish, now: float) -> Decision:
    """What to command for a wish; joints that it does not name hold.

    Args:
        state: What is known before.
        robot: Joints, limits, poses.
        wish: Where joints shall go; beyond an enforced limit they go to the limit.
        now: Steady clock in [s].
    """
    refusal = unknown_name(robot, wish) or refusal_to_move(state, now)
    if refusal:
        return Decision(state, refusal, None)
    assert state.measured is not None
    if isinstance(wish, GoToPose):
        return _command(state, robot, robot.poses[wish.pose], robot.joint_names, f"pose {wish.pose}", now)
    if isinstance(wish, MoveAll):
        return _command(state, robot, wish.positions, robot.joint_names, "all joints by command", now)
    held = held_positions(commandable(state, robot), now)
    if isinstance(wish, MoveJoint):
        to = dict(zip(robot.joint_names, held, strict=True)) | {wish.joint: wish.position}
        return _command(state, robot, tuple(to.values()), (wish.joint,), f"{wish.joint} by slider", now)
    wanted = tuple(
        hold + wish.by if joint.name in wish.joints else hold
        for joint, hold in zip(robot.joints, held, strict=True)
    )
    title = ", ".join(
        f"{joint.name} to {format_command(joint, value)}"
        for joint, value in zip(robot.joints, wanted, strict=True)
        if joint.name in wish.joints
    )
    return _command(state, robot, wanted, wish.joints, title, now)


def refusal_to_move(state: RobotState, now: float) -> str:
    """Why no joint may be commanded at `now` in [s]; empty: they may."""
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


def unknown_name(robot: RobotDescription, wish: Wish) -> str:
    """A sentence about a joint or pose that the robot does not have; empty: it has them all."""
    if isinstance(wish, GoToPose):
        what, unknown, known = "pose", {wish.pose} - robot.poses.keys(), tuple(robot.poses)
    elif isinstance(wish, MoveAll):
        return ""
    else:
        joints = wish.joints if isinstance(wish, StepJoints) else (wish.joint,)
        what, unknown, known = "joint", set(joints) - set(robot.joint_names), robot.joint_names
    if not unknown:
        return ""
    return f"nothing moved: unknown {what} {listing(sorted(unknown))}; known: {listing(known)}"


def _command(
    state: RobotState,
    robot: RobotDescription,
    wanted: Sequence[float],
    moved: Sequence[str],
    title: str,
    now: float,
) -> Decision:
    try:
        check_command(wanted, robot.joint_names)
    except CommandError as error:
        return Decision(state, str(error), None)
    values, stopped = _limited(state, robot, wanted, moved)
    sentence = listing(stopped) if stopped else title
    return Decision(with_command(state, robot, values, now, own=True), sentence, values)


def _limited(
    state: RobotState, robot: RobotDescription, wanted: Sequence[float], moved: Sequence[str]
) -> tuple[tuple[float, ...], list[str]]:
    """The wanted positions, within enforced limits, and a note for each moved joint that stops there."""
    if not enforces_limits(state, robot):
        return tuple(wanted), []
    values = tuple(joint.limits.clamp(value) for joint, value in zip(robot.joints, wanted, strict=True))
    notes = [
        f"{joint.name} stops at its {_limit_name(joint.limits, value)} limit {format_command(joint, value)}"
        for joint, before, value in zip(robot.joints, wanted, values, strict=True)
        if joint.name in moved and value != before
    ]
    return values, notes


def _limit_name(limits: JointLimits, value: float) -> str:
    return "lower" if value == limits.lower else "upper"


def format_position(joint: JointDescription, position: float) -> str:
    """A joint position for a person: "-1.4965 rad (-85.7 deg)" or "0.0123 m (12.3 mm)"."""
    return _told(position, joint.units.position)


def format_command(joint: JointDescription, command: float) -> str:
    """A command for a person: as a position, or "2000 Pa (2.0 kPa)"."""
    return _told(command, joint.units.command)


def _told(value: float, unit: Unit) -> str:
    value = round(value, 3 - round(math.log10(unit.step))) + 0.0  # no traces of rounding, no -0
    digits = f"{value:.4f}" if unit.si in ("rad", "m") else f"{value:.4g}"
    return f"{digits} {unit.si} ({value * unit.per_si:.1f} {unit.shown})"
