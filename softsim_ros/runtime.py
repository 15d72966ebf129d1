"""What the nodes of this package share: doors, an end in order, callbacks in a thread, parameters."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cached_property
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.context import Context
from rclpy.exceptions import (
    InvalidParameterTypeException,
    InvalidParameterValueException,
)
from rclpy.executors import ExternalShutdownException, ShutdownException, SingleThreadedExecutor
from rclpy.node import Node

from softsim_node.parameters import ParameterError
from softsim_node.sentences import sentence_of
from softsim_node.spinning import spin
from softsim_ros import doors


class ClosableNode(Node):
    """A node that ends its own threads and ports, and outlives whatever is sent to it.

    Every callback of a topic, a service or new parameters stands behind a door: see `softsim_ros.doors`.
    """

    def refuse(self, sentence: str) -> None:
        """Log why something that came from outside was not obeyed."""
        if self.context.ok():
            self._refusals.tell(sentence)

    @cached_property
    def _refusals(self) -> doors.Refusals:
        return doors.Refusals(self.get_logger().warning)

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
        behind = doors.message_door(callback, self.refuse, topic)
        return super().create_subscription(msg_type, topic, behind, *args, **options)

    def create_service(self, srv_type: Any, srv_name: str, callback: Any, **options: Any) -> Any:
        """As rclpy's; a request that `callback` cannot serve is answered with a sentence."""
        behind = doors.service_door(callback, self.refuse, srv_name)
        return super().create_service(srv_type, srv_name, behind, **options)

    def add_on_set_parameters_callback(self, callback: Any) -> None:
        """As rclpy's; parameters that `callback` cannot take are refused with a sentence."""
        super().add_on_set_parameters_callback(doors.parameter_door(callback, self.refuse))

    def close(self) -> None:
        """End threads and ports, then destroy the node; a second call does nothing."""
        self.destroy_node()


class SpinThread:
    """Callbacks of some nodes in a thread of their own; leaving the `with` block ends and joins it."""

    def __init__(self, nodes: Iterable[Node], context: Context | None = None) -> None:
        self.executor = SingleThreadedExecutor(context=context)
        for node in nodes:
            self.executor.add_node(node)
        self._stop = threading.Event()
        self._thread = threading.Thread(
            target=spin, args=(self.executor, lambda: not self._stop.is_set()), name="spin"
        )

    def __enter__(self) -> SpinThread:
        """Start the thread."""
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Stop and join the thread; the nodes are left to their owner."""
        self.close()

    def close(self) -> None:
        """Stop and join the thread, if it was started."""
        self._stop.set()
        if self._thread.is_alive():
            with suppress(
                Exception
            ):  # the guard condition dies with its context; the loop ends by itself then
                self.executor.wake()
            self._thread.join()
        self.executor.shutdown(timeout_sec=0)


@contextmanager
def parameter_probe(name: str, **node_options: Any) -> Iterator[Node]:
    """A node for the `with` block, to read parameters of this process that its real node is made from.

    Args:
        name: Name of the real node.
        **node_options: Passed on to rclpy's Node.
    """
    node = Node(
        name,
        start_parameter_services=False,
        enable_rosout=False,
        enable_logger_service=False,
        **node_options,
    )
    try:
        yield node
    finally:
        node.destroy_node()


def declare_number(
    node: Node, name: str, default: float, description: str, lower: float, upper: float
) -> float:
    """Declare a float parameter that can change at run time within [lower, upper]; returns its value.

    Raises:
        ParameterError: the value given at start is not a float or lies outside.
    """
    descriptor = ParameterDescriptor(
        description=description,
        floating_point_range=[FloatingPointRange(from_value=float(lower), to_value=float(upper), step=0.0)],
    )
    allowed = f"a number from {lower:g} to {upper:g}, written with a decimal point"
    return float(_declare(node, name, float(default), descriptor, allowed))


def declare_switch(
    node: Node, name: str, default: bool, description: str, *, read_only: bool = False
) -> bool:
    """Declare a true/false parameter; returns its value.

    Raises:
        ParameterError: the value given at start is not true or false.
    """
    descriptor = ParameterDescriptor(description=description, read_only=read_only)
    return bool(_declare(node, name, default, descriptor, "true or false"))


def declare_text(
    node: Node,
    name: str,
    default: str,
    description: str,
    *,
    choices: Sequence[str] = (),
    read_only: bool = True,
) -> str:
    """Declare a text parameter; returns its value.

    Args:
        node: The node that owns it.
        name: Its name.
        default: Its value where none is given.
        description: One sentence, shown by `ros2 param describe`.
        choices: Allowed values; none means any text. Checked here, at start.
        read_only: Whether it is fixed after the start.

    Raises:
        ParameterError: the value given at start is not a text or not one of `choices`.
    """
    constraints = f"one of: {', '.join(choices)}" if choices else ""
    descriptor = ParameterDescriptor(
        description=description, additional_constraints=constraints, read_only=read_only
    )
    value = str(_declare(node, name, default, descriptor, constraints or "a text"))
    if choices and value not in choices:
        raise ParameterError(f"parameter {name} = {value!r} is refused; allowed is {constraints}")
    return value


def _declare(node: Node, name: str, default: object, descriptor: ParameterDescriptor, allowed: str) -> Any:
    try:
        return node.declare_parameter(name, default, descriptor).value
    except InvalidParameterTypeException as error:
        raise ParameterError(f"parameter {name} has the wrong type; allowed is {allowed}") from error
    except InvalidParameterValueException as error:
        raise ParameterError(f"parameter {name} is refused; allowed is {allowed}") from error
