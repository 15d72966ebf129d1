"""Callback guards: what fails in a callback becomes one message, and the node lives on."""

from __future__ import annotations

import functools
import inspect
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cached_property
from typing import Any, Final

from rcl_interfaces.msg import SetParametersResult
from rclpy.executors import ExternalShutdownException, ShutdownException
from rclpy.node import Node
from rclpy.parameter import Parameter

from softsim_core.base.names import known_names
from softsim_core.scene.io.catalog import shortened
from softsim_node.parameters import with_decimals
from softsim_node.text import one_line, sentence_of

REFUSAL_PERIOD_S: Final = 1.0
"""Refusals that begin alike are said at most this often, in [s]."""

HEAD: Final = 30
"""Refusals are alike whose first characters, so many, are the same."""

MOST_KINDS: Final = 10
"""So many different refusals are said in one period."""

Guarded = Callable[..., Any]


class Refusals:
    """Says why something was refused; sentences that begin alike at most once a period.

    Args:
        say: Gets each sentence, on one line and cut.
        clock: Steady clock in [s].
    """

    def __init__(self, say: Callable[[str], object], clock: Callable[[], float] = time.monotonic) -> None:
        self._say, self._clock = say, clock
        self._said_at: dict[str, float] = {}

    def tell(self, sentence: str) -> None:
        """Say a sentence, unless one like it was said just now."""
        line, now = one_line(sentence), self._clock()
        self._said_at = {head: at for head, at in self._said_at.items() if now - at < REFUSAL_PERIOD_S}
        if line[:HEAD] not in self._said_at and len(self._said_at) < MOST_KINDS:
            self._said_at[line[:HEAD]] = now
            self._say(line)


def message_door(callback: Guarded, refuse: Callable[[str], None], topic: str) -> Guarded:
    """A topic's callback whose failure is told to `refuse` in a sentence."""

    @functools.wraps(callback)
    def receive(*arguments: Any) -> None:
        try:
            callback(*arguments)
        except Exception as error:
            refuse(f"message on {topic} {sentence_of(error)}")

    return receive


def service_door(callback: Guarded, refuse: Callable[[str], None], service: str) -> Guarded:
    """A service's callback that answers with the sentence of its failure; long answers are cut.

    A callback that is a coroutine stays one.
    """

    def refused(response: Any, error: Exception) -> Any:
        sentence = sentence_of(error)
        refuse(f"request to {service} {sentence}")
        if hasattr(response, "success") and hasattr(response, "message"):
            response.success, response.message = False, sentence
        return response

    def bounded(response: Any) -> Any:
        if isinstance(getattr(response, "message", None), str):
            response.message = one_line(response.message)
        return response

    @functools.wraps(callback)
    def answer(request: Any, response: Any) -> Any:
        try:
            return bounded(callback(request, response))
        except Exception as error:
            return refused(response, error)

    @functools.wraps(callback)
    async def answer_later(request: Any, response: Any) -> Any:
        try:
            return bounded(await callback(request, response))
        except Exception as error:
            return refused(response, error)

    return answer_later if inspect.iscoroutinefunction(callback) else answer


def parameter_door(callback: Guarded, refuse: Callable[[str], None]) -> Guarded:
    """A callback for new parameters that refuses them with the sentence of its failure; long ones are cut."""

    @functools.wraps(callback)
    def decide(parameters: Any) -> SetParametersResult:
        try:
            result: SetParametersResult = callback(parameters)
        except Exception as error:
            result = SetParametersResult(successful=False, reason=sentence_of(error))
            refuse(f"parameters {result.reason}")
        result.reason = one_line(result.reason)
        return result

    return decide


class GuardedNode(Node):
    """A node whose callbacks of topics, services and new parameters stand behind doors.

    Those of rclpy's own parameter services, too. See `softsim_node.guards`.
    """

    def refuse(self, sentence: str) -> None:
        """Log why something that came from outside was not obeyed."""
        if self.context.ok():
            self._refusals.tell(sentence)

    @cached_property
    def _refusals(self) -> Refusals:
        return Refusals(self.get_logger().warning)

    @contextmanager
    def refusing(self, what: str) -> Iterator[None]:
        """Log in a sentence what fails inside, and go on; `what` was being done."""
        try:
            yield
        except (ExternalShutdownException, ShutdownException):
            raise
        except Exception as error:
            if not self.context.ok():
                raise
            self.refuse(f"{what} {sentence_of(error)}")

    def create_subscription(
        self, msg_type: Any, topic: str, callback: Any, *args: Any, **options: Any
    ) -> Any:
        """As rclpy's; a message that `callback` cannot take is refused in a sentence."""
        behind = message_door(callback, self.refuse, topic)
        return super().create_subscription(msg_type, topic, behind, *args, **options)

    def create_service(self, srv_type: Any, srv_name: str, callback: Any, **options: Any) -> Any:
        """As rclpy's; a request that `callback` cannot serve is answered with a sentence."""
        behind = service_door(callback, self.refuse, srv_name)
        return super().create_service(srv_type, srv_name, behind, **options)

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """As rclpy's; a name that is not declared is refused with a message that lists the nearest ones.

        Whole numbers are taken where numbers are declared: `2` for `2.0`.
        """
        for each in parameter_list:
            if not self.has_parameter(each.name):
                names = sorted(self.get_parameters_by_prefix(""))
                known = known_names(shortened(each.name), names, "known parameters:")
                return SetParametersResult(reason=one_line(f"no parameter {shortened(each.name)!r}; {known}"))
        return super().set_parameters_atomically([self._as_declared(each) for each in parameter_list])

    def _as_declared(self, given: Parameter) -> Parameter:
        number = with_decimals(given.value)
        declared = self.get_parameter_or(given.name).type_
        takes = declared in (Parameter.Type.DOUBLE, Parameter.Type.DOUBLE_ARRAY)
        return Parameter(given.name, value=number) if takes and number is not given.value else given

    def add_on_set_parameters_callback(self, callback: Any) -> None:
        """As rclpy's; parameters that `callback` cannot take are refused with a sentence."""
        super().add_on_set_parameters_callback(parameter_door(callback, self.refuse))
