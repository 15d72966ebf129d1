"""What the nodes of this package share: doors, an end in order, callbacks in a thread, parameters."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import cached_property
from typing import Any

from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, ShutdownException, SingleThreadedExecutor
from rclpy.node import Node

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
