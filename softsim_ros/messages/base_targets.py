"""Where the base of a joint is to go, as a message: the joint by its name, the place as a transform."""

from __future__ import annotations

from collections.abc import Sequence

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Quaternion, Transform, Vector3
from sensor_msgs.msg import MultiDOFJointState

from softsim_core.errors import CommandError
from softsim_core.scene.catalog import shortened
from softsim_ros.messages.states import header

WORLD = "world"


def base_target(stamp: Time, joint: str, position: Sequence[float]) -> MultiDOFJointState:
    """A message that sends the base of a joint to a position (3,) in [m] in `world`."""
    x, y, z = map(float, position)
    place = Transform(translation=Vector3(x=x, y=y, z=z))
    return MultiDOFJointState(header=header(stamp, WORLD), joint_names=[joint], transforms=[place])


def read_base_target(message: MultiDOFJointState) -> tuple[str, tuple[float, float, float]]:
    """Joint and position in [m] of a message.

    Raises:
        CommandError: another frame than `world`, not one joint with one transform, a rotation, velocities or
            forces: only the place of a base can be chosen.
    """
    if message.header.frame_id != WORLD:
        raise CommandError(
            f"base target refused: unknown frame_id {shortened(message.header.frame_id)!r}; allowed: {WORLD}"
        )
    if len(message.joint_names) != 1 or len(message.transforms) != 1:
        raise CommandError(
            f"base target refused: {len(message.joint_names)} joint names with {len(message.transforms)} "
            "transforms; name one joint a message, with one transform"
        )
    place = message.transforms[0]
    if message.twist or message.wrench or place.rotation != Quaternion():
        raise CommandError(
            "base target refused: only a base's place can be chosen; leave rotation, twist and wrench out"
        )
    at = place.translation
    return message.joint_names[0], (at.x, at.y, at.z)
