"""State of the controlled robot as its topics report it, its frames, and checks of pose messages."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal, TypeAlias

import numpy as np
from geometry_msgs.msg import PoseStamped, Quaternion as QuaternionMessage
from rclpy.node import Node
from std_msgs.msg import String

from softsim_core.base import Array, CommandError, SceneError, SoftSimError, listing, shorten
from softsim_core.physics.contact import ContactSettings
from softsim_core.physics.mechanics import Pose, quaternion_of, rotation_exp, rotation_log, rotation_of
from softsim_core.scene import JointDescription, RobotDescription, SceneDescription
from softsim_core.scene.building import with_rest_frames
from softsim_node import LATCHED, WORLD, RobotFrames
from softsim_ros.messages import read_scene_message

FARTHEST_M = 1000.0
"""Largest distance of a goal from the origin along each axis, in [m]."""

NORM_TOLERANCE = 0.1
"""Largest deviation of a quaternion's norm from 1."""


def check_frame(what: str, frame: str, frames: RobotFrames) -> None:
    """Refuse a message in another frame than the world or the robot's base, which is at the world's origin.

    Raises:
        CommandError: lists the allowed frames; `what` names the message.
    """
    allowed = (WORLD, frames.base)
    if frame not in allowed:
        raise CommandError(
            f"{what} refused: unknown frame_id {shorten(frame)!r}; allowed: {listing(allowed)}"
        )


def checked_pose(message: PoseStamped, frames: RobotFrames, what: str) -> Pose:
    """Return the pose in a message, in the world; see `check_frame` and `unit_quaternion`.

    Raises:
        CommandError: unknown frame, a position that is not finite or too far away, or no rotation.
    """
    check_frame(what, message.header.frame_id, frames)
    place = message.pose.position
    position = np.array([place.x, place.y, place.z])
    if not (np.abs(position) <= FARTHEST_M).all():  # also catches NaN
        raise CommandError(
            f"{what} refused: position {position.tolist()} is not finite or beyond {FARTHEST_M:g} m"
        )
    return Pose(position, unit_quaternion(message.pose.orientation, what))


def unit_quaternion(message: QuaternionMessage, what: str) -> Array:
    """Return the unit quaternion (x, y, z, w) of a message, shape (4,); four zeros stand for no rotation.

    Raises:
        CommandError: not finite, or not a rotation.
    """
    turn = np.array([message.x, message.y, message.z, message.w])
    if not turn.any():
        return np.array([0.0, 0.0, 0.0, 1.0])
    norm = float(np.linalg.norm(turn))
    if not abs(norm - 1.0) <= NORM_TOLERANCE:  # also catches NaN
        raise CommandError(f"{what} refused: orientation {turn.tolist()} is no unit quaternion (x, y, z, w)")
    return np.asarray(turn / norm)


_NO_COLOUR = (0.0, 0.0, 0.0, 0.0)


class SimulatedRobot:
    """Follows `scene/structure` of a node's namespace; a real robot has no such topic.

    The first scene received counts as the model's, since a model may be coarser than the simulated scene.

    Args:
        changed: Called with a message when another robot is loaded, and with an empty text when the first is
            back.
    """

    def __init__(self, node: Node, changed: Callable[[str], None], refuse: Callable[[str], None]) -> None:
        self._changed, self._refuse = changed, refuse
        self._generation = 0
        self._first: SceneDescription | None = None
        self._problem = ""
        node.create_subscription(String, "scene/structure", self._on_scene, LATCHED)

    def _on_scene(self, message: String) -> None:
        try:
            scene = read_scene_message(message.data)
        except SoftSimError as error:
            self._refuse(str(error))
            return
        if scene.generation <= self._generation:
            return
        self._generation = scene.generation
        alone = scene.robot.robot_alone().scene  # without name, appearance and the objects that it touches
        bodies = tuple(replace(body, surface=None, colour=_NO_COLOUR) for body in alone.bodies)
        mechanics = replace(alone, name="robot", bodies=bodies, contact=ContactSettings())
        if self._first is None:
            self._first = mechanics
        before, source = self._problem, scene.robot.source
        self._problem = (
            ""
            if mechanics == self._first
            else "the simulator runs another robot now "
            f"({scene.robot.name if source is None else source.stem}) than the one that the model was made "
            "of; load that again, or restart inverse control"
        )
        if self._problem != before:
            self._changed(self._problem)


Feedback: TypeAlias = Literal["none", "effector_pose", "imu"]
FEEDBACKS: Final[tuple[Feedback, ...]] = ("none", "effector_pose", "imu")

SILENT_AFTER_S: Final = 1.0
"""Time in [s] without joint states after which the joints count as silent."""

FEEDBACK_WITHIN_S: Final = 0.2
"""Largest age in [s] of a measured pose that corrects the model."""

FOLLOWS_WITHIN: Final = 0.1
"""Largest distance from the command at which joints follow, as a fraction of their range.

Joints without a range use 1 rad or 1 m.
"""


@dataclass(frozen=True, slots=True)
class Plant:
    """Latest messages of the robot; immutable.

    Attributes:
        joints: Measured joint positions in [rad] or [m], efforts where these are commanded, shape (j,); None
            before the first message.
        joints_at: Their time, steady clock in [s].
        base_shift: Shift in [m] of the joint bases that the simulator publishes; None if none was received.
        effector: Measured pose of the effector; None before the first message.
        effector_at: Its time in [s].
        imu: Measured orientation, quaternion (x, y, z, w); None before the first message.
        imu_at: Its time in [s].
    """

    joints: Array | None = None
    joints_at: float = -math.inf
    base_shift: float | None = None
    effector: Pose | None = None
    effector_at: float = -math.inf
    imu: Array | None = None
    imu_at: float = -math.inf

    def with_joints(self, positions: Array, now: float) -> Plant:
        """Return the plant with a new measurement of its joints; one that is not finite is ignored."""
        return replace(self, joints=positions, joints_at=now) if np.isfinite(positions).all() else self

    def with_effector(self, pose: Pose, now: float) -> Plant:
        """Return the plant with a new measurement of its effector at `now` [s]."""
        return replace(self, effector=pose, effector_at=now)

    def with_imu(self, quaternion_xyzw: Array, now: float) -> Plant:
        """Return the plant with a new measurement of the effector's orientation at `now` [s]."""
        return replace(self, imu=quaternion_xyzw, imu_at=now)

    def is_silent(self, now: float) -> bool:
        """Return whether no recent joint states have arrived, at `now` in [s]."""
        return now - self.joints_at > SILENT_AFTER_S

    def measured_pose(self, feedback: Feedback, model: Pose | None, now: float) -> Pose | None:
        """Return the pose that corrects the model, or None if no recent one is known.

        Args:
            feedback: Source of the pose. An IMU measures the tilt only: position and heading are the model's.
            model: The model's pose.
            now: Steady clock in [s].
        """
        if feedback == "effector_pose" and now - self.effector_at <= FEEDBACK_WITHIN_S:
            return self.effector
        if feedback == "imu" and now - self.imu_at <= FEEDBACK_WITHIN_S and model is not None:
            assert self.imu is not None
            rotation = rotation_of(model.quaternion_xyzw)
            error = rotation_log(rotation_of(self.imu) @ rotation.T)
            error[2] = 0.0  # the model's turn about the world's vertical stays
            return Pose(model.position, quaternion_of(rotation_exp(error) @ rotation))
        return None


def off_command(joints: Sequence[JointDescription], positions: Array, command: Array) -> list[str]:
    """Return the names of the joints that are not near their command; both in [rad] or [m], shape (j,)."""
    off = []
    for joint, position, goal in zip(joints, positions, command, strict=True):
        span = joint.limits.upper - joint.limits.lower
        reach = FOLLOWS_WITHIN * (span if math.isfinite(span) else 1.0)
        if abs(position - goal) > reach:
            off.append(joint.name)
    return off


def effector_rest(robot: RobotDescription) -> Array:
    """Return the position of the effector in [m] on the robot at rest, shape (3,).

    Raises:
        SceneError: the robot has no effector.
    """
    for attachment in with_rest_frames(robot.scene).attachments:
        if attachment.name == robot.scene.effector and attachment.frame is not None:
            return np.array(attachment.frame.translation)
    raise SceneError(f"{robot.name} has no effector: add `effector: NAME` of a free attachment to its file")
