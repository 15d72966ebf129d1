"""What the robot's nodes report of themselves: faults, the e-stop, time, the stages of a step."""

from __future__ import annotations

from typing import Final

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_msgs.msg import Float64MultiArray

from softsim_core.arrays import Array
from softsim_ros.messages import read_step_profile
from softsim_ros.viewer.log_link import LogLink

_NEWEST_ONLY: Final = QoSProfile(depth=1)


class DiagnosticsLink:
    """Follows `/diagnostics`, `stage_statistics` and `step_profile` of the node's namespace.

    Args:
        node: The node whose executor delivers the messages.

    Attributes:
        fault: What the simulator says is wrong; empty while nothing is.
        scene_error: The same where a file of the scene is the cause.
        e_stopped: Whether the servos are held still by the e-stop.
        time_s: Simulated time in [s]; None: not heard.
        dt: Time step in [s]; None: not heard.
        stages: For each stage of a step its statistics, by name.
        log: What they log.
        profile: Stages and rows of the last steps, see `step_profile`; None: not heard.
    """

    def __init__(self, node: Node) -> None:
        self.log = LogLink(node)
        self.fault = self.scene_error = ""
        self.e_stopped = False
        self.time_s: float | None = None
        self.dt: float | None = None
        self.profile: tuple[tuple[str, ...], Array] | None = None
        self.stages: dict[str, dict[str, str]] = {}
        self._space = node.get_namespace().strip("/")
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        node.create_subscription(DiagnosticArray, "stage_statistics", self._on_stages, _NEWEST_ONLY)
        node.create_subscription(Float64MultiArray, "step_profile", self._on_profile, _NEWEST_ONLY)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == f"{self._space}/simulator":
                self.fault = status.message if status.level == DiagnosticStatus.ERROR else ""
                values = _values(status)
                self.scene_error = self.fault if values.get("scene") == "not loaded" else ""
                self.time_s, self.dt = float(values["time_s"]), float(values["dt_s"])
            elif status.name == f"{self._space}/servo_bridge: servo board":
                self.e_stopped = _values(status).get("e_stop") == "True"

    def _on_stages(self, message: DiagnosticArray) -> None:
        self.stages = {status.name: _values(status) for status in message.status}

    def _on_profile(self, message: Float64MultiArray) -> None:
        self.profile = read_step_profile(message)


def _values(status: DiagnosticStatus) -> dict[str, str]:
    return {pair.key: pair.value for pair in status.values}
