"""The simulator as the teleop sees it: its line in the diagnostics, and whether it keeps joint limits."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import GetParameters
from rclpy.node import Node

from softsim_ros.teleop.services import AsyncService

POLL_INTERVAL_S: Final = 2.0
ANSWER_WITHIN_S: Final = 2.0


class SimulatorLink:
    """Follows the simulator of the node's namespace.

    Args:
        node: The node whose executor delivers the messages.
        on_status: Called with the state's word ("running", "paused", ...) and the real-time factor, or None.
        on_enforced: Called with whether the simulator keeps joint limits.
    """

    def __init__(
        self,
        node: Node,
        on_status: Callable[[str, float | None], None],
        on_enforced: Callable[[bool], None],
    ) -> None:
        self._on_status, self._on_enforced = on_status, on_enforced
        self._name = f"{node.get_namespace().strip('/')}/simulator".lstrip("/")
        self._parameters = AsyncService(node, GetParameters, "simulator/get_parameters", ANSWER_WITHIN_S)
        self._next_poll = 0.0
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)

    def poll(self, now: float) -> None:
        """Ask for the limits' switch now and then; `now` is a steady clock in [s]."""
        self._parameters.expire(now)
        if now >= self._next_poll and not self._parameters.is_busy and self._parameters.is_there:
            self._next_poll = now + POLL_INTERVAL_S
            self._parameters.call(GetParameters.Request(names=["enforce_limits"]), now, self._on_parameters)

    def _on_parameters(self, answer: Any) -> None:
        for value in [] if answer is None else answer.values:
            if value.type == ParameterType.PARAMETER_BOOL:
                self._on_enforced(bool(value.bool_value))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == self._name:
                values = {pair.key: pair.value for pair in status.values}
                if "state" in values:
                    self._on_status(values["state"], _number(values.get("real_time_factor")))


def _number(text: str | None) -> float | None:
    try:
        return None if text is None else float(text)
    except ValueError:
        return None
