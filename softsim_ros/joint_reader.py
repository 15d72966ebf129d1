"""Joint states of a robot, whoever sends them, in the order of its commands."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from sensor_msgs.msg import JointState

from softsim_core.arrays import Array
from softsim_core.scene.description import JointDescription


class JointReader:
    """Takes joint states that name all joints of a robot, in any order, among others or not.

    Args:
        joints: Of the robot, in command order.
        refuse: Called with one sentence when a message begins to name other joints.
    """

    def __init__(self, joints: Sequence[JointDescription], refuse: Callable[[str], None]) -> None:
        self._joints, self._refuse = joints, refuse
        self._order: tuple[tuple[str, ...], list[int] | None] = ((), None)

    def read(self, message: JointState) -> Array | None:
        """Positions in [rad] or [m], efforts where these are commanded, (j,); None: of another robot."""
        names = tuple(message.name)
        if names != self._order[0]:
            self._order = (names, self._order_of(names))
        order = self._order[1]
        if order is None or len(message.position) != len(names):
            return None
        told = len(message.effort) == len(names)
        return np.array(
            [
                message.effort[index] if told and joint.by_effort else message.position[index]
                for index, joint in zip(order, self._joints, strict=True)
            ]
        )

    def _order_of(self, names: tuple[str, ...]) -> list[int] | None:
        missing = [joint.name for joint in self._joints if joint.name not in names]
        if missing:
            self._refuse(
                f"joint states of another robot ignored: {', '.join(missing)} not in {', '.join(names)}"
            )
            return None
        return [names.index(joint.name) for joint in self._joints]
