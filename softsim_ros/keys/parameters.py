"""Parameters of a node whose user has keys: which robot they drive, and how."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from softsim_node.parameters import declare, parameter, parameter_probe
from softsim_ros.keys.press import REPEAT_INTERVAL_S
from softsim_ros.keys.table import GOAL_STEP_M

DEFAULT_ROBOT: Final = "tripod"


@dataclass(frozen=True, kw_only=True)
class KeySettings:
    """Values of the parameters."""

    robot: str = parameter(
        DEFAULT_ROBOT, "Name or path of the robot whose keys and joints are used", fixed=True
    )
    repeat_interval: float = parameter(
        REPEAT_INTERVAL_S, "Shortest time between two steps of one held key", unit="s", within=(0.02, 2.0)
    )
    goal_step: float = parameter(
        GOAL_STEP_M, "How far a key moves the goal of inverse control", unit="m", within=(1e-5, 0.05)
    )


def requested_robot(node_name: str) -> str:
    """The parameter `robot` given to this process, read before the node takes its namespace from it."""
    with parameter_probe(node_name, namespace=DEFAULT_ROBOT) as probe:
        return declare(probe, KeySettings()).robot
