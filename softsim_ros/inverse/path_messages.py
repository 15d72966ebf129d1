"""nav_msgs/Path to an effector path."""

from __future__ import annotations

import numpy as np
from nav_msgs.msg import Path as PathMessage

from softsim_core.inverse.paths import EffectorPath, PathRefusedError
from softsim_ros.frames import RobotFrames
from softsim_ros.inverse.goals import FARTHEST_M
from softsim_ros.inverse.robot import check_frame

MOST_POSES = 100_000
"""A path of more poses is refused."""


def effector_path(message: PathMessage, frames: RobotFrames) -> EffectorPath:
    """The path of a message; its poses' stamps, counted from the first one, are the times.

    Args:
        message: Poses in `world` (or the robot's base, which is the same); a pose's own frame may be empty.
        frames: Names of the robot's frames.

    Raises:
        CommandError: unknown frame, no poses, stamps that do not increase, or a number that is not finite.
    """
    if len(message.poses) > MOST_POSES:
        raise PathRefusedError(f"it has {len(message.poses)} poses; send at most {MOST_POSES}")
    check_frame("path", message.header.frame_id, frames)
    for pose in message.poses:
        if pose.header.frame_id:
            check_frame("path", pose.header.frame_id, frames)
    if not message.poses:
        raise PathRefusedError("it has no poses")
    stamps = [(pose.header.stamp.sec, pose.header.stamp.nanosec) for pose in message.poses]
    first = stamps[0]
    times = [float(sec - first[0]) + 1e-9 * (nanosec - first[1]) for sec, nanosec in stamps]
    places = [pose.pose.position for pose in message.poses]
    if not all(abs(each) <= FARTHEST_M for place in places for each in (place.x, place.y, place.z)):
        raise PathRefusedError(f"a position is not finite or further than {FARTHEST_M:g} m away")
    turns = [pose.pose.orientation for pose in message.poses]
    return EffectorPath(
        times,
        np.array([(place.x, place.y, place.z) for place in places]),
        np.array([(turn.x, turn.y, turn.z, turn.w) for turn in turns]),
    )
