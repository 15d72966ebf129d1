"""Callbacks of nodes: an error in one becomes a message, and the node continues; steady timers; answers."""

from __future__ import annotations

import functools
import inspect
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cached_property
from typing import Any, Final

from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.executors import ExternalShutdownException, ShutdownException
from rclpy.node import Node
from rclpy.parameter import Parameter

from softsim_core.base import CommandError, SoftSimError, known_names, shorten
from softsim_node.parameters import with_decimals
from softsim_node.text import error_message, one_line

REFUSAL_PERIOD_S: Final = 1.0
"""Shortest time in [s] between two refusals that begin alike."""

HEAD: Final = 30
"""Number of first characters that are the same in refusals that count as alike."""

MOST_KINDS: Final = 10
"""Number of different refusals that are reported in one period."""

Guarded = Callable[..., Any]


class Refusals:
    """Reports refusals, and messages that begin alike at most once per period.

    Args:
        say: Called with each message, on one line and shortened.
        clock: Steady clock in [s].
    """

    def __init__(self, say: Callable[[str], object], clock: Callable[[], float] = time.monotonic) -> None:
        self._say, self._clock = say, clock
        self._said_at: dict[str, float] = {}

    def report(self, text: str) -> None:
        """Report a message, unless one that begins alike was reported within the period."""
        line, now = one_line(text), self._clock()
        self._said_at = {head: at for head, at in self._said_at.items() if now - at < REFUSAL_PERIOD_S}
        if line[:HEAD] not in self._said_at and len(self._said_at) < MOST_KINDS:
            self._said_at[line[:HEAD]] = now
            self._say(line)


def guard_subscription(callback: Guarded, refuse: Callable[[str], None], topic: str) -> Guarded:
    """Wrap a topic's callback so that its error is passed to `refuse` as a message.

    The message of a CommandError stands alone; that of any other error names the topic.
    """

    @functools.wraps(callback)
    def receive(*arguments: Any) -> None:
        try:
            callback(*arguments)
        except CommandError as error:
            refuse(error_message(error))
        except Exception as error:
            refuse(f"message on {topic} {error_message(error)}")

    return receive


def guard_service(callback: Guarded, refuse: Callable[[str], None], service: str) -> Guarded:
    """Wrap a service's callback so that its error becomes the response; long responses are shortened.

    A callback that is a coroutine stays one.
    """

    def set_refusal(response: Any, error: Exception) -> Any:
        text = error_message(error)
        refuse(f"request to {service} {text}")
        if hasattr(response, "success") and hasattr(response, "message"):
            response.success, response.message = False, text
        return response

    def shorten_message(response: Any) -> Any:
        if isinstance(getattr(response, "message", None), str):
            response.message = one_line(response.message)
        return response

    @functools.wraps(callback)
    def answer(request: Any, response: Any) -> Any:
        try:
            return shorten_message(callback(request, response))
        except Exception as error:
            return set_refusal(response, error)

    @functools.wraps(callback)
    async def answer_later(request: Any, response: Any) -> Any:
        try:
            return shorten_message(await callback(request, response))
        except Exception as error:
            return set_refusal(response, error)

    return answer_later if inspect.iscoroutinefunction(callback) else answer


def answering(action: Callable[..., str]) -> Guarded:
    """Return a callback of a Trigger or SetBool service that answers with the message of an action.

    It is called without arguments, or with the value that a SetBool request has. An error of this project
    (SoftSimError) is answered as a failure.
    """

    def answer(request: Any, response: Any) -> Any:
        try:
            response.message = action(request.data) if hasattr(request, "data") else action()
            response.success = True
        except SoftSimError as error:
            response.success, response.message = False, str(error)
        return response

    return answer


def steady_timer(node: Node, period_s: float, callback: Callable[[], Any], **options: Any) -> Any:
    """Create a timer of a node on the steady clock, which simulated time does not slow down."""
    return node.create_timer(period_s, callback, clock=Clock(clock_type=ClockType.STEADY_TIME), **options)


def guard_parameters(callback: Guarded, refuse: Callable[[str], None]) -> Guarded:
    """Wrap a callback for new parameters so that its error refuses them; long reasons are shortened."""

    @functools.wraps(callback)
    def decide(parameters: Any) -> SetParametersResult:
        try:
            result: SetParametersResult = callback(parameters)
        except Exception as error:
            result = SetParametersResult(successful=False, reason=error_message(error))
            refuse(f"parameters {result.reason}")
        result.reason = one_line(result.reason)
        return result

    return decide


class GuardedNode(Node):
    """A node with guards around the callbacks of its topics, services and new parameters.

    This includes rclpy's own parameter services. See `softsim_node.guards`.
    """

    def close(self) -> None:
        """Reach the safe state, end threads and ports, destroy the node; a second call does nothing."""
        self.destroy_node()

    def refuse(self, text: str) -> None:
        """Log why something that came from outside was refused."""
        if self.context.ok():
            self._refusals.report(text)

    @cached_property
    def _refusals(self) -> Refusals:
        return Refusals(self.get_logger().warning)

    @contextmanager
    def refusing(self, what: str) -> Iterator[None]:
        """Log an error inside the block as a message, and continue; `what` was being done."""
        try:
            yield
        except (ExternalShutdownException, ShutdownException):
            raise
        except Exception as error:
            if not self.context.ok():
                raise
            self.refuse(f"{what} {error_message(error)}")

    def create_subscription(
        self, msg_type: Any, topic: str, callback: Any, *args: Any, **options: Any
    ) -> Any:
        """Create a subscription like rclpy; a ROS message on which `callback` fails is refused."""
        behind = guard_subscription(callback, self.refuse, topic)
        return super().create_subscription(msg_type, topic, behind, *args, **options)

    def create_service(self, srv_type: Any, srv_name: str, callback: Any, **options: Any) -> Any:
        """Create a service like rclpy; a request on which `callback` fails is answered with a message."""
        behind = guard_service(callback, self.refuse, srv_name)
        return super().create_service(srv_type, srv_name, behind, **options)

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Set parameters like rclpy; refuse an undeclared name with a message that lists the nearest names.

        Whole numbers are accepted for parameters that are declared as floating-point numbers: `2` for `2.0`.
        """
        for each in parameter_list:
            if not self.has_parameter(each.name):
                names = sorted(self.get_parameters_by_prefix(""))
                hint = known_names(shorten(each.name), names, "known parameters:")
                return SetParametersResult(reason=one_line(f"no parameter {shorten(each.name)!r}; {hint}"))
        return super().set_parameters_atomically([self._as_declared(each) for each in parameter_list])

    def _as_declared(self, parameter: Parameter) -> Parameter:
        number = with_decimals(parameter.value)
        declared = self.get_parameter_or(parameter.name).type_
        takes = declared in (Parameter.Type.DOUBLE, Parameter.Type.DOUBLE_ARRAY)
        return (
            Parameter(parameter.name, value=number) if takes and number is not parameter.value else parameter
        )

    def add_on_set_parameters_callback(self, callback: Any) -> None:
        """Add a callback like rclpy; parameters on which `callback` fails are refused."""
        super().add_on_set_parameters_callback(guard_parameters(callback, self.refuse))
