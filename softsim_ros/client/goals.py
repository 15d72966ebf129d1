"""The effector's goal as it is moved in steps: pure functions, SI."""

from __future__ import annotations

from collections.abc import Sequence

from softsim_core.units import MILLIMETRE
from softsim_ros.client.state import EffectorPose, RobotState, known_effector


def moved_goal(state: RobotState, shift: Sequence[float], now: float) -> EffectorPose | None:
    """The goal given from here, or else the effector's place, moved by `shift` (3,) in [m]; None: unknown."""
    start = state.goal or known_effector(state, now)
    if start is None:
        return None
    x, y, z = (round(value + by, 9) for value, by in zip(start.position, shift, strict=True))
    return EffectorPose((x, y, z), start.quaternion_xyzw)


def format_point(pose: EffectorPose) -> str:
    """A position as "x 0.0 y -2.0 z 31.5", in mm."""
    values = (round(value / MILLIMETRE, 1) + 0.0 for value in pose.position)  # + 0.0: no "-0.0"
    return " ".join(f"{axis} {value:.1f}" for axis, value in zip("xyz", values, strict=True))
