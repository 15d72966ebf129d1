"""The simulator's parameters: asked for now and then, heard of when they change, set at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

from rcl_interfaces.msg import ParameterEvent, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParametersAtomically
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python

from softsim_ros.client.known import Known
from softsim_ros.client.services import AsyncService, Done, Outcome, unheeded
from softsim_ros.qos import EVERY_ONE

POLL_PERIOD_S: Final = 1.0
ANSWER_WITHIN_S: Final = 20.0
"""Another scene may have to be built before a set request is answered."""

LIMITS: Final = "enforce_limits"
"""This parameter is always followed: commands depend on it."""


class Parameters:
    """Follows and sets parameters of `simulator` in the node's namespace.

    Args:
        node: The node whose executor delivers the answers.
        known: Where the switch of the limits is kept.
    """

    def __init__(self, node: Node, known: Known) -> None:
        self._known = known
        self._get = AsyncService(node, GetParameters, "simulator/get_parameters", 2.0)
        self._set = AsyncService(
            node, SetParametersAtomically, "simulator/set_parameters_atomically", ANSWER_WITHIN_S
        )
        self._owner = node.resolve_service_name("simulator")
        node.create_subscription(ParameterEvent, "/parameter_events", self._on_event, EVERY_ONE)
        self._wanted: dict[str, Any] = {}
        self._waiting: list[Done] = []
        self._next_poll = 0.0
        self._names: Sequence[str] = ()
        self._on_values: Callable[[dict[str, Any]], None] = lambda _: None

    def follow(self, names: Sequence[str], on_values: Callable[[dict[str, Any]], None]) -> None:
        """Have `on_values` called with these parameters, in SI by name, whenever they arrive."""
        self._names, self._on_values = names, on_values

    def set(self, name: str, value: Any, done: Done = unheeded) -> None:
        """Set a parameter; where requests follow each other fast, the newest value wins."""
        self._wanted[name] = value
        self._waiting.append(done)

    def poll(self, now: float) -> None:
        """Send what is wanted and ask for the values now and then; `now` is a steady clock in [s]."""
        self._get.expire(now)
        self._set.expire(now)
        if self._wanted and not self._set.is_busy:
            self._send(now)
        idle = not (self._set.is_busy or self._get.is_busy or self._wanted)
        if idle and now >= self._next_poll and self._get.is_there:
            self._next_poll = now + POLL_PERIOD_S
            names = self._followed()
            request = GetParameters.Request(names=names)
            self._get.call(request, now, lambda answer: self._on_answer(names, answer))

    def _followed(self) -> list[str]:
        return list(dict.fromkeys((LIMITS, *self._names)))

    def _send(self, now: float) -> None:
        wanted, self._wanted = self._wanted, {}
        waiting, self._waiting = self._waiting, []
        if not self._set.is_there:
            self._end(Outcome(False, "the simulator is not running; nothing was set"), waiting)
            return
        parameters = [Parameter(name, value=value).to_parameter_msg() for name, value in wanted.items()]
        request = SetParametersAtomically.Request(parameters=parameters)
        self._set.call(request, now, lambda answer: self._on_set(answer, waiting))

    def _on_set(self, answer: Any, waiting: Sequence[Done]) -> None:
        self._next_poll = 0.0
        if answer is None:
            self._end(Outcome(False, "the simulator did not answer"), waiting)
        elif not answer.result.successful:
            self._end(Outcome(False, f"refused: {answer.result.reason}"), waiting)
        else:
            self._end(Outcome(True, ""), waiting)

    def _end(self, end: Outcome, waiting: Sequence[Done]) -> None:
        if end.sentence:
            self._known.say(end.sentence)
        for done in waiting:
            done(end)

    def _on_event(self, event: ParameterEvent) -> None:
        if event.node == self._owner and not (self._set.is_busy or self._wanted):
            followed = self._followed()
            changed = {parameter.name: parameter.value for parameter in event.changed_parameters}
            self._tell({name: value for name, value in changed.items() if name in followed})

    def _on_answer(self, names: Sequence[str], answer: Any) -> None:
        if answer is not None and not self._set.is_busy and not self._wanted:
            self._tell(dict(zip(names, answer.values, strict=False)))

    def _tell(self, values: Mapping[str, ParameterValue]) -> None:
        plain = {name: parameter_value_to_python(value) for name, value in values.items()}
        known = {name: value for name, value in plain.items() if value is not None}
        enforced = known.get(LIMITS)
        if enforced is not None and enforced != self._known.state.enforce_limits:
            self._known.change(enforce_limits=bool(enforced))
        self._on_values({name: value for name, value in known.items() if name in self._names})
