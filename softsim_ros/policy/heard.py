"""What the topics of a robot said, as the senses of a policy; the newest of each."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from softsim_core.arrays import Array
from softsim_core.mechanics.pose import Pose, rotation_of


class Heard:
    """Senses of one robot, with the time when each was heard.

    Args:
        asks: Names of what is looked at, see Senses.
        goal_size: Numbers of a goal.
    """

    def __init__(self, asks: Sequence[str], goal_size: int) -> None:
        self._asks = asks
        self._values: dict[str, Array] = {}
        self._at: dict[str, float] = {}
        self._goal_size = goal_size
        self._goal: Array | None = None
        self.commands = np.zeros((1, 0))

    def take(self, name: str, value: Array, now: float) -> bool:
        """Keep a value, heard at `now` in [s]; False: it is not used, for it is not finite."""
        if not np.isfinite(value).all():
            return False
        self._values[name], self._at[name] = value[None], now
        return True

    def take_pose(self, pose: Pose, now: float) -> None:
        """Keep the effector's pose."""
        self.take("effector_position", pose.position, now)
        self.take("effector_rotation", rotation_of(pose.quaternion_xyzw), now)

    def aim(self, goal: Array | None) -> None:
        """Keep what is wanted, shape (g,); None: nothing yet."""
        self._goal = goal

    def missing(self, now: float, timeout: float) -> list[str]:
        """Names of what was not heard within `timeout` before `now`, in [s]."""
        return [name for name in self._asks if not now - self._at.get(name, -np.inf) <= timeout]

    @property
    def has_goal(self) -> bool:
        """Whether it is known what is wanted."""
        return self._goal is not None or not self._goal_size

    # --- Senses ---------------------------------------------------------------------------------------

    @property
    def joint_positions(self) -> Array:
        """See Senses."""
        return self._values["joint_positions"]

    @property
    def joint_efforts(self) -> Array:
        """See Senses."""
        return self._values["joint_efforts"]

    @property
    def effector_position(self) -> Array:
        """See Senses."""
        return self._values["effector_position"]

    @property
    def effector_rotation(self) -> Array:
        """See Senses."""
        return self._values["effector_rotation"]

    @property
    def effector_rate(self) -> Array:
        """See Senses."""
        return self._values["effector_rate"]

    @property
    def effector_force(self) -> Array:
        """See Senses."""
        return self._values["effector_force"]

    @property
    def thing_position(self) -> Array:
        """See Senses."""
        return self._values["thing_position"]

    @property
    def goals(self) -> Array:
        """See Senses."""
        return np.zeros((1, 0)) if self._goal is None else self._goal[None]
