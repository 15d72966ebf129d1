"""Where the base of a joint is to go, as a message and back."""

from __future__ import annotations

from collections.abc import Callable

import pytest

pytest.importorskip("sensor_msgs", reason="the message packages are not installed")

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Twist
from sensor_msgs.msg import MultiDOFJointState

from softsim_core.base import CommandError
from softsim_ros.messages import base_target, read_base_target


def test_a_base_target_reads_back() -> None:
    assert read_base_target(base_target(Time(), "servo_1", (0.1, -0.2, 0.3))) == ("servo_1", (0.1, -0.2, 0.3))


def turned(message: MultiDOFJointState) -> None:
    message.transforms[0].rotation.w, message.transforms[0].rotation.x = 0.0, 1.0


@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (
            lambda message: setattr(message.header, "frame_id", "servo_1"),
            "unknown frame_id 'servo_1'",
        ),
        (lambda message: message.joint_names.append("servo_2"), "2 joint names with 1 transforms; name one"),
        (lambda message: message.transforms.clear(), "1 joint names with 0 transforms; name one joint"),
        (lambda message: message.twist.append(Twist()), "leave rotation, twist and wrench out"),
        (turned, "leave rotation, twist and wrench out"),
    ],
)
def test_what_a_base_cannot_do_is_refused(
    spoil: Callable[[MultiDOFJointState], object], sentence: str
) -> None:
    message = base_target(Time(), "servo_1", (0.1, 0.0, 0.0))
    spoil(message)
    with pytest.raises(CommandError, match=sentence):
        read_base_target(message)
