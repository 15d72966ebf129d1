"""One node as a process, or a program that uses ROS: start, serve, and an end in a safe state."""

from __future__ import annotations

import argparse
import faulthandler
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Protocol, TypeVar

import rclpy
import rclpy.utilities
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException, ShutdownException
from rclpy.signals import SignalHandlerOptions

from softsim_core.errors import SoftSimError
from softsim_core.processes import use_safe_path
from softsim_node import discovery, security
from softsim_node.ending import OUTLIVE, ending
from softsim_node.environment import check_ros_variables, prepare_environment
from softsim_node.help import Program
from softsim_node.spinning import serve_callbacks


class RunnableNode(Protocol):
    """A node that can end in a safe state; every node of the suite is one."""

    def close(self) -> None:
        """Reach the safe state, end threads and ports; a second call does nothing."""
        ...

    def destroy_node(self) -> None:
        """Close, then destroy the node; a second call does nothing."""
        ...

    def get_logger(self) -> Any:
        """Rclpy's logger of the node."""
        ...


NodeType = TypeVar("NodeType", bound=RunnableNode)

END_LIMIT_S = 60.0
"""A process that ends has this long for it in [s]; one that hangs is ended then, with the stacks of its
threads on stderr and exit code 1."""

_STDERR = 2


class RosStartError(SoftSimError, RuntimeError):
    """ROS cannot start with this command line or in this environment."""


def start_ros(words: Sequence[str] = ()) -> None:
    """Prepare the environment and start rclpy; signals are left to `ending`.

    Args:
        words: Command line without the program's name.

    Raises:
        MixedRosError: two installations of ROS would meet in this process.
        DiscoveryError: the wish for a discovery range is not allowed.
        RosVariableError: a variable has a value with which ROS cannot start.
        RosStartError: wrong --ros-args, or keys that security wants are missing.
        SecurityError: security is wanted, and this installation of ROS has none.
    """
    prepare_environment()
    check_ros_variables()
    try:
        rclpy.init(args=["node", *words], signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:  # classes of rclpy's extension, which end in the place in its source
        raise RosStartError(str(error).splitlines()[0].split(", at /")[0]) from error
    if security.is_wanted(os.environ):
        security.need_security()


@contextmanager
def ros_process() -> Iterator[None]:
    """Run rclpy for the `with` block, whose loops look at `ending`; a request to end is no error.

    Until the end of the block rclpy stays up: a robot's e-stop is served while it goes to its safe pose.
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
    """Run one node as a process: start rclpy, build, serve, close. Returns the exit code.

    SIGINT, SIGTERM, SIGHUP and the end of the program that started this one end it in order, with 0; rclpy
    stays up until the node is closed. An error of the suite (`SoftSimError`) is one sentence on stderr and 1;
    a wrong command line is 2; `--help` prints what the program does and its parameters.

    Args:
        program: Name, purpose and parameters.
        build: Makes the node from the program's own options once rclpy runs.
        args: Command line without the program's name; None takes the process's own.
        serve: What the node does until `ending` is asked; None serves its callbacks.
    """
    ending.watch()
    use_safe_path()
    words = list(sys.argv[1:] if args is None else args)
    node: NodeType | None = None
    code = 0
    try:
        start_ros(words)
        options = program.options(words)
        with _ending_quietly():
            if not ending.asked:
                node = build(options)
                node.get_logger().info(discovery.sentence(os.environ))
                if warning := security.warning(os.environ):
                    node.get_logger().warning(warning)
                (serve or serve_callbacks)(node)
                _tell_orphan(node)
    except (SoftSimError, ParameterException) as error:
        code = complain(str(error))
    except SystemExit as end:  # of the command line
        code = int(end.code or 0)
    finally:
        with _limited_end():
            if node is not None:
                node.close()
                node.destroy_node()
            rclpy.utilities.try_shutdown()
            ending.over()
    return ending.leave(code)


def complain(sentence: str) -> int:
    """Write one sentence to stderr; returns the exit code 1."""
    sys.stderr.write(f"{sentence}\n")
    return 1


@contextmanager
def _limited_end() -> Iterator[None]:
    """End the process where the block takes longer than END_LIMIT_S.

    Fast DDS can deadlock while it is taken down, above all after another process of its domain was killed.
    Such a call may hold Python's lock, so no thread of Python could end it; faulthandler needs no lock.
    """
    faulthandler.dump_traceback_later(END_LIMIT_S, exit=True, file=_STDERR)
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()


@contextmanager
def _ending_quietly() -> Iterator[None]:
    """What a request to end, or a context that was shut down, makes fail inside is an ordinary end."""
    try:
        yield
    except (KeyboardInterrupt, ExternalShutdownException, ShutdownException):
        pass
    except SoftSimError:
        raise
    except OSError:  # writing to a terminal that has gone
        if not ending.asked:
            raise
    except Exception:
        if rclpy.utilities.ok():
            raise


def _tell_orphan(node: RunnableNode) -> None:
    if ending.is_orphan and rclpy.utilities.ok():
        node.get_logger().warning(
            f"the program that started this one has ended, so does this; {OUTLIVE}=1 lets it go on"
        )
