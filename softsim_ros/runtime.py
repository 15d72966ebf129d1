"""What the nodes of this package share: doors, an end in order, callbacks in a thread, parameters."""

from __future__ import annotations

import threading
from collections.abc import Iterable
from contextlib import suppress

from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from softsim_node.guarded_node import GuardedNode
from softsim_node.spinning import spin


class ClosableNode(GuardedNode):
    """A node that ends its own threads and ports, and outlives whatever is sent to it."""

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
