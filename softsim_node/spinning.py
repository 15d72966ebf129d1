"""Serving the callbacks of nodes, so that nothing which is sent to them ends the loop."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from rclpy.executors import (
    Executor,
    ExternalShutdownException,
    ShutdownException,
    SingleThreadedExecutor,
    TimeoutException,
)

from softsim_node.ending import ending
from softsim_node.sentences import sentence_of

SPIN_PERIOD_S = 0.1
"""How long one look for work lasts: the longest time a stop flag goes unseen, in [s]."""

REFUSAL_PERIOD_S = 1.0
"""What fails in a callback is logged at most this often, in [s]."""

_CALLBACKS_AT_ONCE = 32


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
        if executor.context.ok():  # else the context was shut down in the middle of the call
            raise


def serve_once(executor: Executor, timeout_s: float) -> None:
    """Serve one callback, waiting for it at most `timeout_s` in [s]; see `outliving`."""
    with outliving(executor):
        executor.spin_once(timeout_sec=timeout_s)


def ready_callbacks(executor: Executor, enough: Callable[[], bool] = lambda: False) -> None:
    """Run the callbacks that are ready now, at most a few dozen, without waiting.

    Args:
        executor: Theirs.
        enough: Whether the rest of them may wait for the next call; a look for more costs half a millisecond.
    """
    for _ in range(_CALLBACKS_AT_ONCE):
        if enough():
            return
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
            node.get_logger().error(sentence_of(error), throttle_duration_sec=REFUSAL_PERIOD_S)


def serve_callbacks(node: Any) -> None:
    """Serve a node's callbacks until the process shall end, or its context shuts down."""
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    spin(executor, lambda: not ending.asked)
