"""The parameters of ros2_control's controller manager and joint trajectory controller for a robot."""

from __future__ import annotations

from typing import Any, Final

import yaml

from softsim_core import RobotDescription

CONTROLLER: Final = "joint_trajectory_controller"
UPDATE_RATE: Final = 100
"""Updates of the controller manager a second."""

GOAL_TOLERANCE: Final = 0.02
"""How far from its goal a joint may end, in [rad] or [m]: silicone pulls at it."""

GOAL_TIME: Final = 0.0
"""So long after the end of a trajectory its joints may be on their way, in [s]; 0: as long as it takes."""


def controllers(robot: RobotDescription, namespace: str) -> str:
    """YAML text: one trajectory controller over all joints, in the namespace of the robot."""
    start = f"/{namespace.strip('/')}".rstrip("/")
    kind = "joint_trajectory_controller/JointTrajectoryController"
    constraints: dict[str, Any] = {"stopped_velocity_tolerance": 0.0, "goal_time": GOAL_TIME}
    constraints |= {joint: {"goal": GOAL_TOLERANCE} for joint in robot.joint_names}
    controller = {
        "type": kind,
        "joints": list(robot.joint_names),
        "command_interfaces": ["position"],
        "state_interfaces": ["position"],
        "allow_partial_joints_goal": True,
        "constraints": constraints,
    }
    manager = {"update_rate": UPDATE_RATE, CONTROLLER: {"type": kind}}
    nodes = {"controller_manager": manager, CONTROLLER: controller}
    return yaml.safe_dump(
        {f"{start}/{name}": {"ros__parameters": values} for name, values in nodes.items()}, sort_keys=False
    )
