"""Environment variables every command needs, set in one place and only where the user has not set them."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import MutableMapping
from pathlib import Path

BOOTSTRAP_MARK = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"


class MixedRosError(RuntimeError):
    """A system ROS is active in a process whose ROS comes from pip wheels; the two cannot be mixed."""


def has_ros_wheels(prefix: Path) -> bool:
    """Whether the environment at `prefix` holds the pip wheels of ROS 2."""
    return any(prefix.glob("lib/python3*/site-packages/ros_wheels_bootstrapper"))


def system_ros(environment: MutableMapping[str, str]) -> str | None:
    """First folder under /opt/ros that a search path of this environment names, or None."""
    for variable in ("AMENT_PREFIX_PATH", "PYTHONPATH", "LD_LIBRARY_PATH"):
        for folder in environment.get(variable, "").split(os.pathsep):
            if folder.startswith("/opt/ros/"):
                return folder
    return None


def set_defaults(environment: MutableMapping[str, str], prefix: Path, home: Path, wheels: bool) -> None:
    """Fill in what ROS needs and the user has not set.

    Args:
        environment: Changed in place.
        prefix: Root of the Python environment.
        home: The user's home folder; where it cannot be written, logs go to the temporary folder.
        wheels: Whether ROS comes from the pip wheels in `prefix`.
    """
    environment.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    if not os.access(home, os.W_OK):
        log = Path(tempfile.gettempdir()) / f"softsim-log-{os.getuid()}"
        environment.setdefault("ROS_LOG_DIR", str(log))
    if wheels:  # the package index of the wheels lies in the environment itself
        prefixes = [part for part in environment.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if part]
        if str(prefix) not in prefixes:
            environment["AMENT_PREFIX_PATH"] = os.pathsep.join([*prefixes, str(prefix)])


def prepare() -> None:
    """Set the defaults for this process; start it again where another environment left its mark.

    Raises:
        MixedRosError: /opt/ros is sourced although this environment has ROS wheels of its own.
    """
    prefix = Path(sys.prefix)
    wheels = has_ros_wheels(prefix)
    if wheels:
        other = system_ros(os.environ)
        if other is not None:
            raise MixedRosError(
                f"a system ROS ({other}) is active in this terminal and cannot be mixed with the ROS wheels "
                f"in {prefix}; use a terminal where it is not sourced, or build ros2_ws with colcon and use "
                "ros2 run"
            )
        libraries = os.environ.get("LD_LIBRARY_PATH", "").split(os.pathsep)
        if os.environ.get(BOOTSTRAP_MARK) and str(prefix / "lib") not in libraries:
            del os.environ[BOOTSTRAP_MARK]
            os.execv(sys.executable, sys.orig_argv)  # the wheels set the library path at the start of Python
    set_defaults(os.environ, prefix, Path(os.environ.get("HOME", "/nonexistent")), wheels)
