"""The simulator's parameters: asked for now and then, heard of when they change, set at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

from rcl_interfaces.msg import ParameterEvent, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParametersAtomically
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python

from softsim_ros.teleop.services import AsyncService

POLL_PERIOD_S: Final = 1.0
ANSWER_WITHIN_S: Final = 20.0
"""Another scene may have to be built before a set request is answered."""


class ParametersLink:
    """Follows some parameters of `simulator` in the node's namespace.

    Args:
        node: The node whose executor delivers the answers.
        on_values: Called with the values by name whenever they arrive.
        say: Called with one sentence for the person.
    """

    def __init__(
        self, node: Node, on_values: Callable[[dict[str, Any]], None], say: Callable[[str], None]
    ) -> None:
        self._on_values, self._say = on_values, say
        self._get = AsyncService(node, GetParameters, "simulator/get_parameters", 2.0)
        self._set = AsyncService(
            node, SetParametersAtomically, "simulator/set_parameters_atomically", ANSWER_WITHIN_S
        )
        self._owner = node.resolve_service_name("simulator")
        node.create_subscription(ParameterEvent, "/parameter_events", self._on_event, 10)
        self._wanted: dict[str, Any] = {}
        self._next_poll = 0.0
        self.names: Sequence[str] = ()

    def set(self, name: str, value: Any) -> None:
        """Set a parameter; where requests follow each other fast, the newest value wins."""
        self._wanted[name] = value

    def poll(self, now: float) -> None:
        """Send what is wanted and ask for the values now and then; `now` is a steady clock in [s]."""
        self._get.expire(now)
        self._set.expire(now)
        if self._wanted and not self._set.is_busy:
            wanted, self._wanted = self._wanted, {}
            if not self._set.is_there:
                self._say("the simulator is not running; nothing was set")
                return
            parameters = [Parameter(name, value=value).to_parameter_msg() for name, value in wanted.items()]
            request = SetParametersAtomically.Request(parameters=parameters)
            self._set.call(request, now, self._on_set)
        idle = not (self._set.is_busy or self._get.is_busy or self._wanted)
        if idle and self.names and now >= self._next_poll and self._get.is_there:
            self._next_poll = now + POLL_PERIOD_S
            names = list(self.names)
            request = GetParameters.Request(names=names)
            self._get.call(request, now, lambda answer: self._on_answer(names, answer))

    def _on_set(self, answer: Any) -> None:
        self._next_poll = 0.0
        if answer is None:
            self._say("the simulator did not answer")
        elif not answer.result.successful:
            self._say(f"refused: {answer.result.reason}")

    def _on_event(self, event: ParameterEvent) -> None:
        if event.node == self._owner and not (self._set.is_busy or self._wanted):
            changed = {parameter.name: parameter.value for parameter in event.changed_parameters}
            self._tell({name: value for name, value in changed.items() if name in self.names})

    def _on_answer(self, names: Sequence[str], answer: Any) -> None:
        if answer is not None and not self._set.is_busy and not self._wanted:
            self._tell(dict(zip(names, answer.values, strict=False)))

    def _tell(self, values: Mapping[str, ParameterValue]) -> None:
        known = {name: parameter_value_to_python(value) for name, value in values.items()}
        self._on_values({name: value for name, value in known.items() if value is not None})
