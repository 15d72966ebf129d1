"""One node in a process of its own: spin until Ctrl-C or SIGTERM, then let it end in its safe state."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable

import rclpy
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.utilities import ok, try_shutdown

from softsim_core.errors import SoftSimError


def run_node(make: Callable[[], Node], args: list[str] | None = None) -> int:
    """Make a node and spin it; its `destroy_node` has to reach the safe state.

    Args:
        make: Makes the node; called after rclpy is up.
        args: Command line; None takes the process's.

    Returns:
        Exit code: 0 after Ctrl-C, SIGTERM or a shutdown, 2 where the node cannot be made (stderr says why).
    """
    node: Node | None = None
    try:
        rclpy.init(args=args)
        node = make()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        while ok():
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
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
