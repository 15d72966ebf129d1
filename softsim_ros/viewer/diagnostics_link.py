"""What the robot's nodes report of themselves: faults, the e-stop, the time of each stage."""

from __future__ import annotations

from typing import Final

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from rclpy.qos import QoSProfile

_NEWEST_ONLY: Final = QoSProfile(depth=1)


class DiagnosticsLink:
    """Follows `/diagnostics` and `stage_statistics` of the node's namespace.

    Args:
        node: The node whose executor delivers the messages.

    Attributes:
        fault: What the simulator says is wrong; empty while nothing is.
        e_stopped: Whether the servos are held still by the e-stop.
        stages: For each stage of a step its statistics, by name.
    """

    def __init__(self, node: Node) -> None:
        self.fault = ""
        self.e_stopped = False
        self.stages: dict[str, dict[str, str]] = {}
        self._space = node.get_namespace().strip("/")
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        node.create_subscription(DiagnosticArray, "stage_statistics", self._on_stages, _NEWEST_ONLY)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == f"{self._space}/simulator":
                self.fault = status.message if status.level == DiagnosticStatus.ERROR else ""
            elif status.name == f"{self._space}/servo_bridge: servo board":
                self.e_stopped = _values(status).get("e_stop") == "True"

    def _on_stages(self, message: DiagnosticArray) -> None:
        self.stages = {status.name: _values(status) for status in message.status}


def _values(status: DiagnosticStatus) -> dict[str, str]:
    return {pair.key: pair.value for pair in status.values}
