"""A command's process with rclpy: signals are an ordinary end."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import rclpy
from rclpy.executors import ExternalShutdownException, ShutdownException
from rclpy.utilities import ok, try_shutdown

from softsim_core.errors import SoftSimError


@contextmanager
def ros_process() -> Iterator[None]:
    """Start rclpy for the `with` block; Ctrl-C and SIGTERM end the block without an error."""
    rclpy.init(args=[])
    try:
        yield
    except (KeyboardInterrupt, ExternalShutdownException, ShutdownException):
        pass
    except SoftSimError:
        raise
    except Exception:
        if ok():  # else a signal shut the context down in the middle of a call: an ordinary end
            raise
    finally:
        try_shutdown()
