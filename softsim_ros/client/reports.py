"""Numbers and sentences of the robot's nodes, from the text of `/diagnostics` to the client's state."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node

from softsim_ros.client.known import Known
from softsim_ros.qos import EVERY_ONE


class Reports:
    """Follows `/diagnostics` for simulator and inverse control of the node's namespace.

    Whether something runs, is on or is paused is not read here: that is on typed topics.

    Args:
        node: The node whose executor delivers the messages.
        known: Where the simulator's numbers are kept.
        on_inverse: Called with the sentence of inverse control.
    """

    def __init__(self, node: Node, known: Known, on_inverse: Callable[[str], None]) -> None:
        self._known, self._on_inverse = known, on_inverse
        space = node.get_namespace().strip("/")
        self._simulator, self._inverse = (
            f"{space}/{name}".lstrip("/") for name in ("simulator", "inverse_controller")
        )
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, EVERY_ONE)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == self._simulator:
                self._on_simulator(status)
            elif status.name == self._inverse:
                self._on_inverse(status.message)

    def _on_simulator(self, status: DiagnosticStatus) -> None:
        values = {pair.key: pair.value for pair in status.values}
        fault = status.message if status.level == DiagnosticStatus.ERROR else ""
        self._known.change(
            real_time_factor=_number(values, "real_time_factor"),
            time_s=_number(values, "time_s"),
            time_at=time.monotonic(),
            dt=_number(values, "dt_s"),
            fault=fault,
            scene_error=fault if values.get("scene") == "not loaded" else "",
        )


def _number(values: Mapping[str, str], name: str) -> float | None:
    try:
        return float(values[name])
    except (KeyError, ValueError):
        return None
