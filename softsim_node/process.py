"""One node as a process, or a program that uses ROS: start, spin, and an end in a safe state."""

from __future__ import annotations

import argparse
import ctypes
import faulthandler
import gc
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Final, TypeVar

import rclpy
import rclpy.utilities
from rclpy.exceptions import ParameterException
from rclpy.executors import (
    Executor,
    ExternalShutdownException,
    ShutdownException,
    SingleThreadedExecutor,
    TimeoutException,
)
from rclpy.signals import SignalHandlerOptions

from softsim_core.base import SoftSimError, use_safe_path
from softsim_node import environment
from softsim_node.environment import check_ros_variables, prepare_environment
from softsim_node.guards import GuardedNode
from softsim_node.parameters import Program
from softsim_node.signals import OUTLIVE, ending
from softsim_node.text import error_message

ENABLE: Final = "ROS_SECURITY_ENABLE"
STRATEGY: Final = "ROS_SECURITY_STRATEGY"
ENFORCE: Final = "Enforce"

LONGEST_REASON: Final = 120


class SecurityError(SoftSimError, RuntimeError):
    """Security is requested, and the middleware or its keys cannot provide it."""


def need_security() -> None:
    """Check that secured nodes can be created; call it once rclpy runs, if they are requested.

    Raises:
        SecurityError: they cannot be created; the message says why.
    """
    try:
        node = rclpy.create_node("security_check", start_parameter_services=False, enable_rosout=False)
    except Exception as error:  # classes of rclpy's extension
        reason = str(error).splitlines()[0].removeprefix("error creating node: ").split(", at /")[0]
        raise SecurityError(
            f"{ENABLE} is true, but no secured node can be made: {reason[:LONGEST_REASON]}; "
            "ROS 2 from PyPI has no DDS security: use apt's, or unset it"
        ) from error
    node.destroy_node()


def security_warning(environment: Mapping[str, str]) -> str:
    """Return a warning for a process that requests security and runs without it; empty if there is none."""
    if environment.get(ENABLE) != "true" or environment.get(STRATEGY) == ENFORCE:
        return ""
    return (
        f"{ENABLE} is true, but not enforced: without keys for its enclave this process is open to "
        f"everybody; {STRATEGY}={ENFORCE} refuses to start then"
    )


_TRIM_THRESHOLD: Final = -1
_MMAP_THRESHOLD: Final = -3
"""Names of settings in glibc's malloc.h."""

UNRETURNED_BYTES: Final = 1 << 28
LARGEST_BYTES: Final = 1 << 25
"""Most memory that is not returned to the system, and the largest array in it (malloc allows no more)."""


def reuse_freed_memory() -> bool:
    """Reuse freed memory for later arrays instead of returning it to the system; False without glibc.

    A step in NumPy frees and allocates the same arrays, a few hundred kilobytes each. If they are returned,
    each new one consists of pages that the system fills with zeros, which takes a fifth of the step's time.
    The setting applies to the whole process, so the simulator makes it, not the library.
    """
    try:
        set_option = ctypes.CDLL(None).mallopt
    except (OSError, TypeError, AttributeError):
        return False
    return bool(set_option(_TRIM_THRESHOLD, UNRETURNED_BYTES)) and bool(
        set_option(_MMAP_THRESHOLD, LARGEST_BYTES)
    )


SPIN_PERIOD_S = 0.1
"""Longest time in [s] of one wait for work, and so until a stop flag is noticed."""

REFUSAL_PERIOD_S = 1.0
"""Shortest time in [s] between two log messages about errors in callbacks."""

_CALLBACKS_AT_ONCE = 32


def spin(executor: Executor, continues: Callable[[], bool] = lambda: True) -> None:
    """Run callbacks until the context shuts down or `continues` returns False.

    It is a loop over `spin_once`, which is correct for every executor, also if its own `spin` does not end on
    shutdown.
    """
    try:
        while executor.context.ok() and continues():
            serve_once(executor, SPIN_PERIOD_S)
    except (ExternalShutdownException, ShutdownException):
        pass
    except Exception:
        if executor.context.ok():  # else the context was shut down in the middle of the call
            raise


def serve_once(executor: Executor, timeout_s: float) -> None:
    """Run one callback, waiting for it at most `timeout_s` in [s]; see `outliving`."""
    with outliving(executor):
        executor.spin_once(timeout_sec=timeout_s)


def ready_callbacks(executor: Executor, enough: Callable[[], bool] = lambda: False) -> None:
    """Run the callbacks that are ready now, at most a few dozen, without waiting.

    `enough` returns whether the others may wait for the next call; each check for more takes half a
    millisecond.
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
    """Log an error inside the block as a message, and continue.

    This includes a ROS message that cannot be decoded. Errors caused by the shutdown of the context are
    raised.
    """
    try:
        yield
    except (ExternalShutdownException, ShutdownException):
        raise
    except Exception as error:
        if not executor.context.ok():
            raise
        for node in list(executor.get_nodes())[:1]:
            node.get_logger().error(error_message(error), throttle_duration_sec=REFUSAL_PERIOD_S)


def serve_callbacks(node: Any) -> None:
    """Run a node's callbacks until the process is to end, or its context shuts down."""
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    spin(executor, lambda: not ending.asked)


NodeType = TypeVar("NodeType", bound=GuardedNode)

END_LIMIT_S = 60.0
"""Longest time in [s] for the end of a process.

A process that hangs is ended then, with the stacks of its threads on stderr and exit code 1.
"""

_STDERR = 2


class RosStartError(SoftSimError, RuntimeError):
    """ROS cannot start with this command line or in this environment."""


def start_ros(words: Sequence[str] = ()) -> None:
    """Prepare the environment and start rclpy; signals are left to `ending`.

    Args:
        words: Command line without the program's name.

    Raises:
        MixedRosError: two installations of ROS would meet in this process.
        DiscoveryError: the requested discovery range is not allowed.
        RosVariableError: a variable has a value with which ROS cannot start.
        RosStartError: wrong --ros-args, or missing keys for security.
        SecurityError: security is requested, and this installation of ROS has none.
    """
    prepare_environment()
    check_ros_variables()
    try:
        rclpy.init(args=["node", *words], signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:  # rclpy's extension; the text ends with a source location
        raise RosStartError(str(error).splitlines()[0].split(", at /")[0]) from error
    if os.environ.get(ENABLE) == "true":
        need_security()


@contextmanager
def ros_process() -> Iterator[None]:
    """Run rclpy for the `with` block; its loops check `ending`, and a request to end is no error.

    rclpy stays up until the end of the block: the e-stop of a robot is served while it moves to its safe
    pose.
    """
    ending.watch()
    with ending.orderly():
        start_ros()
        try:
            with _ending_quietly():
                yield
        finally:
            with _limited_end():
                rclpy.utilities.try_shutdown()


def run_node(
    program: Program,
    build: Callable[[argparse.Namespace], NodeType],
    args: Sequence[str] | None = None,
    serve: Callable[[NodeType], None] | None = None,
) -> int:
    """Run one node as a process: start rclpy, build, serve, close. Return the exit code.

    SIGINT, SIGTERM, SIGHUP and the end of the program that started this one end it in order, with 0; rclpy
    stays up until the node is closed. An error of the suite (`SoftSimError`) gives one message on stderr and
    1; a wrong command line gives 2; `--help` prints the purpose of the program and its parameters.

    Args:
        program: Name, purpose and parameters.
        build: Creates the node from the program's own options once rclpy runs.
        args: Command line without the program's name; None takes that of the process.
        serve: Runs the node until `ending.asked`; None runs its callbacks.
    """
    ending.watch()
    use_safe_path()
    gc.freeze()  # a full collection would walk all imported modules for 40 to 65 ms
    words = list(sys.argv[1:] if args is None else args)
    node: NodeType | None = None
    code = 0
    try:
        start_ros(words)
        options = program.options(words)
        with _ending_quietly():
            if not ending.asked:
                node = build(options)
                node.get_logger().info(environment.describe_range(os.environ))
                if warning := security_warning(os.environ):
                    node.get_logger().warning(warning)
                (serve or serve_callbacks)(node)
                if ending.is_orphan and rclpy.utilities.ok():
                    node.get_logger().warning(
                        "the program that started this one has ended, so does this; "
                        f"{OUTLIVE}=1 lets it continue"
                    )
    except (SoftSimError, ParameterException) as error:
        sys.stderr.write(f"{error}\n")
        code = 1
    except SystemExit as end:  # raised by the parser of the command line
        code = int(end.code or 0)
    finally:
        with _limited_end():
            if node is not None:
                node.close()
                node.destroy_node()
            rclpy.utilities.try_shutdown()
            ending.over()
    return ending.leave(code)


@contextmanager
def _limited_end() -> Iterator[None]:
    """End the process if the block takes longer than END_LIMIT_S.

    Fast DDS can deadlock while it is shut down, above all after another process of its domain was killed.
    Such a call may own Python's lock, so no thread of Python could end it; faulthandler needs no lock.
    """
    faulthandler.dump_traceback_later(END_LIMIT_S, exit=True, file=_STDERR)
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()


@contextmanager
def _ending_quietly() -> Iterator[None]:
    """Treat errors caused by a request to end, or by a context that was shut down, as an ordinary end."""
    try:
        yield
    except (KeyboardInterrupt, ExternalShutdownException, ShutdownException):
        pass
    except SoftSimError:
        raise
    except OSError:  # write to a terminal that has gone
        if not ending.asked:
            raise
    except Exception:
        if rclpy.utilities.ok():
            raise
