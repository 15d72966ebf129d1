"""What every node's process shares: start, spin loop, shutdown without traceback, declared parameters."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cached_property
from typing import Any, TypeVar

import rclpy
import rclpy.utilities
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.context import Context
from rclpy.exceptions import (
    InvalidParameterTypeException,
    InvalidParameterValueException,
)
from rclpy.executors import (
    Executor,
    ExternalShutdownException,
    ShutdownException,
    SingleThreadedExecutor,
    TimeoutException,
)
from rclpy.node import Node

from softsim_core.errors import SoftSimError
from softsim_ros import doors
from softsim_ros.environment import prepare_environment
from softsim_ros.interrupts import put_off_in_callbacks

SPIN_PERIOD_S = 0.1
"""How long one look for work lasts: the longest time a stop flag goes unseen, in [s]."""


_CALLBACKS_AT_ONCE = 32


class ParameterError(SoftSimError, ValueError):
    """A parameter given at start (command line or file) has a wrong type or value."""


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
            self.refuse(f"{what} {doors.sentence_of(error)}")

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


NodeType = TypeVar("NodeType", bound=ClosableNode)


def spin(executor: Executor, keep_going: Callable[[], bool] = lambda: True) -> None:
    """Serve callbacks until the context shuts down or `keep_going` turns false.

    A loop over `spin_once`: right for every executor, also where its own `spin` does not end on shutdown.
    """
    try:
        while executor.context.ok() and keep_going():
            serve_once(executor, SPIN_PERIOD_S)
    except (ExternalShutdownException, ShutdownException):
        pass
    except Exception:
        if executor.context.ok():  # else a signal shut the context down in the middle of the call
            raise


def serve_once(executor: Executor, timeout_s: float) -> None:
    """Serve one callback, waiting for it at most `timeout_s` in [s]; see `outliving`."""
    with outliving(executor):
        executor.spin_once(timeout_sec=timeout_s)


def ready_callbacks(executor: Executor) -> None:
    """Run the callbacks that are ready now, at most a few dozen, without waiting."""
    for _ in range(_CALLBACKS_AT_ONCE):
        try:
            handler, _, _ = executor.wait_for_ready_callbacks(timeout_sec=0)
        except TimeoutException:
            return
        with outliving(executor):
            handler()
            if (error := handler.exception()) is not None:
                raise error


@contextmanager
def outliving(executor: Executor) -> Iterator[None]:
    """Log what fails inside in a sentence, such as a message that cannot even be decoded, and go on.

    What fails because the context was shut down passes.
    """
    try:
        yield
    except (ExternalShutdownException, ShutdownException):
        raise
    except Exception as error:
        if not executor.context.ok():
            raise
        for node in list(executor.get_nodes())[:1]:
            node.get_logger().error(doors.sentence_of(error), throttle_duration_sec=doors.REFUSAL_PERIOD_S)


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
def ros_process() -> Iterator[None]:
    """Run rclpy for the `with` block; Ctrl-C and SIGTERM end the block without an error."""
    rclpy.init(args=[])
    try:
        yield
    except (KeyboardInterrupt, ExternalShutdownException, ShutdownException):
        pass
    except SoftSimError:
        raise
    except Exception:
        if rclpy.utilities.ok():  # else a signal shut the context down in the middle of a call
            raise
    finally:
        rclpy.utilities.try_shutdown()


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


def serve_callbacks(node: Node) -> None:
    """Serve a node's callbacks until its context shuts down."""
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    spin(executor)


def run_node(
    build: Callable[[], NodeType],
    args: Sequence[str] | None = None,
    serve: Callable[[NodeType], None] = serve_callbacks,
) -> int:
    """Run one node as a process: start rclpy, build, serve, end. Returns the exit code.

    Ctrl-C and SIGTERM end with 0. An error of the suite (`SoftSimError`) is one sentence on stderr and 1.

    Args:
        build: Makes the node once rclpy runs.
        args: Command line without the program name; None takes the process's own.
        serve: What the node does until its context shuts down.
    """
    put_off_in_callbacks()
    try:
        prepare_environment()
        rclpy.init(args=None if args is None else ["node", *args])
    except Exception as error:  # mixed ROS installations; wrong --ros-args (classes of rclpy's extension)
        return complain(str(error).splitlines()[0].split(", at /")[0])
    node: NodeType | None = None
    code = 0
    try:
        node = build()
        serve(node)
    except (KeyboardInterrupt, ExternalShutdownException, ShutdownException):
        pass
    except SoftSimError as error:
        code = complain(str(error))
    except Exception:
        if rclpy.utilities.ok():
            raise
        # a signal shut the context down in the middle of a call: an ordinary end
    finally:
        with suppress(KeyboardInterrupt):
            if node is not None:
                node.close()
            rclpy.utilities.try_shutdown()
    return code


def complain(sentence: str) -> int:
    """Write one sentence to stderr; returns the exit code 1."""
    sys.stderr.write(f"{sentence}\n")
    return 1


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
