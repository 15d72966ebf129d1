"""One node in a process of its own: spin until Ctrl-C or SIGTERM, then let it end in its safe state."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable
from types import FrameType

import rclpy
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import ok, try_shutdown

from softsim_core.errors import SoftSimError

END_SIGNALS = (signal.SIGINT, signal.SIGTERM)


def run_node(make: Callable[[], Node], args: list[str] | None = None) -> int:
    """Make a node and spin it; its `destroy_node` has to reach the safe state.

    A signal ends the loop and leaves rclpy up: services on an executor of their own are served to the end.

    Args:
        make: Makes the node; called after rclpy is up.
        args: Command line; None takes the process's.

    Returns:
        Exit code: 0 after Ctrl-C, SIGTERM or a shutdown, 2 where the node cannot be made (stderr says why).
    """
    node: Node | None = None
    ending = threading.Event()

    def end(number: int, frame: FrameType | None) -> None:
        ending.set()
        if node is None:  # nothing has to reach a safe state yet
            raise KeyboardInterrupt

    try:
        for number in END_SIGNALS:
            signal.signal(number, end)
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
        node = make()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        while ok() and not ending.is_set():
            executor.spin_once(timeout_sec=0.1)
    except (ExternalShutdownException, KeyboardInterrupt):
        pass
    except (ParameterException, SoftSimError) as error:
        sys.stderr.write(f"{error}\n")
        return 2
    except Exception:
        if ok():  # else the context went down under a call: a signal, not a fault
            raise
    finally:
        _ignore_signals()
        if node is not None:
            node.destroy_node()
        try_shutdown()
    return 0


def _ignore_signals() -> None:
    """From here on a second Ctrl-C must not cut the way to the safe state short."""
    for number in END_SIGNALS:
        signal.signal(number, signal.SIG_IGN)
