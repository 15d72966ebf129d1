"""Client of the inverse controller's switch, and the controller's entry in /diagnostics."""

from __future__ import annotations

import time
from collections.abc import Callable

from rcl_interfaces.srv import SetParametersAtomically
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_srvs.srv import SetBool

from softsim_core.base import MILLIMETRE, listing
from softsim_ros import StateListener
from softsim_ros.client import AsyncService
from softsim_ros.messages import ERROR, OK, WARN
from softsim_ros.nodes.inverse.control_thread import ControlStatus
from softsim_ros.nodes.inverse.plant import Feedback


def health(
    status: ControlStatus, alive: bool, feedback: Feedback, foreign_commands: int
) -> tuple[bytes, str, dict[str, object]]:
    """Return level, message and values of the diagnostics.

    `alive` is whether the control thread runs, `feedback` which measured pose corrects the model, and
    `foreign_commands` the number of commands that other nodes sent while control was on.
    """
    report = status.report
    level, message = OK, status.message or status.mode
    if not alive:
        level, message = ERROR, "the control thread has ended; restart the inverse controller"
    elif status.fault:
        level = ERROR
    elif status.mode == "holding" or (
        report is not None and (report.status in ("unreachable", "stalled") or report.sensitivity_age > 0)
    ):
        level = WARN
    values: dict[str, object] = {"mode": status.mode, "feedback": feedback}
    if report is not None:
        values |= {
            "feedback_fresh": status.measured,
            "residual_mm": report.residual_m / MILLIMETRE,
            "residual_rad": report.residual_rad,
            "reachable": report.reachable,
            "active_limits": listing(report.active),
            "status": report.status,
            "sensitivity_age_ticks": report.sensitivity_age,
            "qp_ms": report.qp_ms,
            "tick_ms": report.tick_ms,
            "ticks_per_second": status.rate,
        }
    values |= {f"mean_{stage}_ms": time_ms for stage, time_ms in status.stages_ms}
    values |= {"time_behind_s": status.late_s, "foreign_commands": foreign_commands}
    return level, message, values


NAME = "inverse_controller"


class InverseSwitch:
    """Follows and switches the `inverse_controller` of a node's namespace, without ever blocking.

    Args:
        changed: Called with True or False when the controller goes on or off.

    Attributes:
        is_on: Whether it controls; False while it does not run.
    """

    def __init__(self, node: Node, changed: Callable[[bool], None], warn: Callable[[str], None]) -> None:
        self.is_on = False
        self._changed, self._warn = changed, warn
        self._enable = AsyncService(node, SetBool, f"{NAME}/enable")
        self._parameters = AsyncService(node, SetParametersAtomically, f"{NAME}/set_parameters_atomically")
        self._state = StateListener(node, f"{NAME}/enabled", self._on_enabled)

    @property
    def is_silent(self) -> bool:
        """Whether it sends no sign of life but has not ended: its process is paused, or cut off."""
        return self._state.value is None and self._state.is_matched

    @property
    def service(self) -> str:
        """Name of the service that switches the controller."""
        return self._enable.name

    @property
    def is_there(self) -> bool:
        """Whether its services have been found."""
        return self._enable.is_there and self._parameters.is_there

    def expire(self) -> None:
        """Give up calls that have waited too long; call this periodically."""
        for service in (self._enable, self._parameters):
            service.expire(time.monotonic())

    def enable(self, answered: Callable[[str], None]) -> None:
        """Switch the controller on, unless a call is in progress.

        `answered` is called with the reason of a refusal, or with an empty text on success.
        """

        def on_answer(response: SetBool.Response | None) -> None:
            answered("no answer" if response is None else "" if response.success else response.message)

        if not self._enable.is_busy:
            self._enable.call(SetBool.Request(data=True), time.monotonic(), on_answer)

    def follow(self, task: str) -> None:
        """Set the part of a goal that it follows: position, orientation, height_tilt or pose."""

        def on_answer(response: SetParametersAtomically.Response | None) -> None:
            if response is None or not response.result.successful:
                reason = "no answer" if response is None else response.result.reason
                self._warn(f"the inverse controller's task cannot be set to {task}: {reason}")

        if not self._parameters.is_busy:
            parameter = Parameter("task", value=task).to_parameter_msg()
            request = SetParametersAtomically.Request(parameters=[parameter])
            self._parameters.call(request, time.monotonic(), on_answer)

    def _on_enabled(self, enabled: bool | None) -> None:
        was_on, self.is_on = self.is_on, bool(enabled)
        if self.is_on != was_on:
            self._changed(self.is_on)
