"""What the simulator tells of its steps: statistics of their stages, and the last ones in full."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from std_msgs.msg import Float64MultiArray

from softsim_core.arrays import Array
from softsim_ros.messages import read_step_profile
from softsim_ros.qos import NEWEST_ONLY


class StepStatistics:
    """Follows `stage_statistics` and `step_profile` of the node's namespace.

    Args:
        node: The node whose executor delivers the messages.

    Attributes:
        stages: For each stage of a step its statistics, by name.
        profile: Stages and rows of the last steps, see `step_profile`; None: not heard.
    """

    def __init__(self, node: Node) -> None:
        self.profile: tuple[tuple[str, ...], Array] | None = None
        self.stages: dict[str, dict[str, str]] = {}
        node.create_subscription(DiagnosticArray, "stage_statistics", self._on_stages, NEWEST_ONLY)
        node.create_subscription(Float64MultiArray, "step_profile", self._on_profile, NEWEST_ONLY)

    def _on_stages(self, message: DiagnosticArray) -> None:
        self.stages = {
            status.name: {pair.key: pair.value for pair in status.values} for status in message.status
        }

    def _on_profile(self, message: Float64MultiArray) -> None:
        self.profile = read_step_profile(message)
