"""What the robot's nodes report of themselves, from the text of `/diagnostics` to the client's state."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node

from softsim_ros.client.known import Known
from softsim_ros.client.state import Tilt
from softsim_ros.qos import EVERY_ONE


class InverseReport(NamedTuple):
    """What inverse control says: whether it is on, and how it fares."""

    is_on: bool
    sentence: str


class Reports:
    """Follows `/diagnostics` for the nodes of the node's namespace.

    Args:
        node: The node whose executor delivers the messages.
        known: Where the simulator's numbers and the e-stop are kept.
        on_inverse: Called with each report of inverse control.
        on_loop: Called with the closed loop's reference, or None while it is off.
    """

    def __init__(
        self,
        node: Node,
        known: Known,
        on_inverse: Callable[[InverseReport], None],
        on_loop: Callable[[Tilt | None], None],
    ) -> None:
        self._known, self._on_inverse, self._on_loop = known, on_inverse, on_loop
        space = node.get_namespace().strip("/")
        self._readers: dict[str, Callable[[DiagnosticStatus, Mapping[str, str]], None]] = {
            f"{space}/{name}".lstrip("/"): reader
            for name, reader in (
                ("simulator", self._on_simulator),
                ("servo_bridge: servo board", self._on_board),
                ("inverse_controller", self._on_inverse_status),
                ("closed_loop", self._on_loop_status),
            )
        }
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, EVERY_ONE)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if reader := self._readers.get(status.name):
                reader(status, {pair.key: pair.value for pair in status.values})

    def _on_simulator(self, status: DiagnosticStatus, values: Mapping[str, str]) -> None:
        if "state" not in values:
            return
        fault = status.message if status.level == DiagnosticStatus.ERROR else ""
        self._known.change(
            simulator=values["state"],
            real_time_factor=_number(values, "real_time_factor"),
            time_s=_number(values, "time_s"),
            dt=_number(values, "dt_s"),
            fault=fault,
            scene_error=fault if values.get("scene") == "not loaded" else "",
        )

    def _on_board(self, _: DiagnosticStatus, values: Mapping[str, str]) -> None:
        self._known.change(e_stopped=values.get("e_stop") == "True")

    def _on_inverse_status(self, status: DiagnosticStatus, values: Mapping[str, str]) -> None:
        self._on_inverse(InverseReport(values.get("mode", "off") != "off", status.message))

    def _on_loop_status(self, _: DiagnosticStatus, values: Mapping[str, str]) -> None:
        if values.get("state", "off") == "off":
            self._on_loop(None)
        else:
            x, y = (_number(values, f"reference_{axis}_rad") or 0.0 for axis in "xy")
            self._on_loop(Tilt(x, y))


def _number(values: Mapping[str, Any], name: str) -> float | None:
    try:
        return float(values[name])
    except (KeyError, ValueError):
        return None
