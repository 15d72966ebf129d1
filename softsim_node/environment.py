"""The environment of ROS processes: its variables, and discovery, by default on this computer only."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Mapping, MutableMapping
from pathlib import Path

from softsim_core.base import SoftSimError, listing, runtime_folder

DISCOVERY_VARIABLE = "SOFTSIM_DISCOVERY_RANGE"
RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
PEERS = "ROS_STATIC_PEERS"
SKIP_CURRENT_FOLDER = "SKIP_DEFAULT_XML_FILE"
"""Set to 1, Fast DDS ignores `DEFAULT_FASTRTPS_PROFILES.xml` in the current, possibly foreign folder."""

REACHES = {
    "LOCALHOST": "nodes on this computer only",
    "SUBNET": "every computer on the local network: anybody there can move the robot",
    "OFF": "no other process",
    "SYSTEM_DEFAULT": "whatever the middleware's own configuration says",
}
"""Allowed values, and who can reach the nodes with them."""


class DiscoveryError(SoftSimError, ValueError):
    """The requested discovery range is none of those that ROS knows."""


def requested_range(environment: Mapping[str, str]) -> str:
    """Return the discovery range for this process: SOFTSIM_DISCOVERY_RANGE, else LOCALHOST.

    If ROS_AUTOMATIC_DISCOVERY_RANGE is OFF, the default is OFF, too. That variable alone cannot widen the
    range: a sourced ROS sets it to SUBNET without a request by the user.

    Raises:
        DiscoveryError: SOFTSIM_DISCOVERY_RANGE is not one of REACHES.
    """
    requested = environment.get(DISCOVERY_VARIABLE, "")
    if not requested:
        return "OFF" if environment.get(RANGE) == "OFF" else "LOCALHOST"
    if requested not in REACHES:
        raise DiscoveryError(
            f"{DISCOVERY_VARIABLE}={requested[:40]!r} is refused; allowed: {listing(REACHES)}; or unset it"
        )
    return requested


def set_range(environment: MutableMapping[str, str]) -> None:
    """Apply the range to a process with this environment, and to those that it starts.

    Raises:
        DiscoveryError: as `requested_range`.
    """
    environment[RANGE] = requested_range(environment)
    environment.pop("ROS_LOCALHOST_ONLY", None)  # used by older releases; it would override the range
    environment.setdefault(SKIP_CURRENT_FOLDER, "1")


def describe_range(environment: Mapping[str, str]) -> str:
    """Return a message that says who can reach the nodes of a process, and how to change it."""
    reach = requested_range(environment)
    peers = environment.get(PEERS, "")
    among = f", and the computers in {PEERS} ({peers[:60]})" if peers and reach != "OFF" else ""
    domain = environment.get("ROS_DOMAIN_ID") or "0"
    change = f"; {DISCOVERY_VARIABLE}=SUBNET opens it to the network" if reach == "LOCALHOST" else ""
    return f"reached by {REACHES[reach]}{among} (domain {domain}, {reach}{change})"


BOOTSTRAP_MARK = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"


class MixedRosError(SoftSimError, RuntimeError):
    """A system ROS is active in a process with ROS from pip wheels; the two cannot be mixed."""


class RosVariableError(SoftSimError, ValueError):
    """An environment variable has a value with which ROS cannot start."""


HIGHEST_DOMAIN = 232
"""Highest ROS domain; the ports of higher ones do not exist."""


def ros_problems(environment: Mapping[str, str]) -> list[str]:
    """Return why ROS could not start with these variables, one message each; rclpy would end the process.

    Installed middleware is searched in their AMENT_PREFIX_PATH.
    """
    problems = []
    domain = environment.get("ROS_DOMAIN_ID", "")
    if domain and not (re.fullmatch("[0-9]{1,9}", domain) and int(domain) <= HIGHEST_DOMAIN):
        problems.append(
            f"ROS_DOMAIN_ID={domain[:40]!r} is refused; allowed: a whole number from 0 to {HIGHEST_DOMAIN}; "
            "or unset it, which means 0"
        )
    middleware = environment.get("RMW_IMPLEMENTATION", "")
    prefixes = [Path(part) for part in environment.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if part]
    index = "share/ament_index/resource_index/rmw_typesupport"
    names = {file.name for prefix in prefixes for file in prefix.glob(f"{index}/rmw_*")} - {
        "rmw_implementation"
    }
    if middleware and names and middleware not in names:
        problems.append(
            f"RMW_IMPLEMENTATION={middleware[:40]!r} is refused; installed here: {listing(sorted(names))}; "
            "or unset it"
        )
    return problems


def check_ros_variables() -> None:
    """Check the variables of this process; call it after `prepare_environment` and before rclpy is imported.

    Raises:
        RosVariableError: ROS could not start with the variables of this process.
    """
    if problems := ros_problems(os.environ):
        raise RosVariableError("; ".join(problems))


def has_ros_wheels(prefix: Path) -> bool:
    """Return whether the environment at `prefix` has the pip wheels of ROS 2."""
    return any(prefix.glob("lib/python3*/site-packages/ros_wheels_bootstrapper"))


def system_ros(environment: MutableMapping[str, str]) -> str | None:
    """Return the first folder under /opt/ros in a search path of this environment, or None."""
    for variable in ("AMENT_PREFIX_PATH", "PYTHONPATH", "LD_LIBRARY_PATH"):
        for folder in environment.get(variable, "").split(os.pathsep):
            if folder.startswith("/opt/ros/"):
                return folder
    return None


def set_defaults(environment: MutableMapping[str, str], prefix: Path) -> None:
    """Set the discovery range, and what ROS needs and the user has not set: a log folder, the package index.

    Args:
        environment: Changed in place.
        prefix: Root of the Python environment.

    Raises:
        DiscoveryError: the requested discovery range is not allowed.
        RuntimeFolderError: the runtime folder is the only one for the logs of ROS, and other users can access
            it.
    """
    set_range(environment)
    if "ROS_LOG_DIR" not in environment and "ROS_HOME" not in environment:
        home = environment.get("HOME")
        if not home or not _is_writable(Path(home) / ".ros" / "log"):  # a service has no home
            environment["ROS_LOG_DIR"] = str(runtime_folder(environment) / "ros-log")
    if has_ros_wheels(prefix):  # the package index of the wheels is in the environment itself
        prefixes = [part for part in environment.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if part]
        if str(prefix) not in prefixes:
            environment["AMENT_PREFIX_PATH"] = os.pathsep.join([*prefixes, str(prefix)])


def prepare_environment() -> None:
    """Set the defaults for this process; call it before rclpy starts.

    Raises:
        MixedRosError: /opt/ros is sourced although this environment has ROS wheels of its own.
        DiscoveryError: the requested discovery range is not allowed.
    """
    prefix = Path(sys.prefix)
    if has_ros_wheels(prefix):
        other = system_ros(os.environ)
        if other is not None:
            raise MixedRosError(
                f"a system ROS ({other}) is active in this terminal and cannot be mixed with the ROS wheels "
                f"in {prefix}; use a terminal where it is not sourced, or build ros2_ws with colcon and use "
                "ros2 run"
            )
        libraries = os.environ.get("LD_LIBRARY_PATH", "").split(os.pathsep)
        if os.environ.get(BOOTSTRAP_MARK) and str(prefix / "lib") not in libraries:
            del os.environ[
                BOOTSTRAP_MARK
            ]  # of another environment; the wheels set the path at Python's start
            os.execv(sys.executable, sys.orig_argv)
    set_defaults(os.environ, prefix)


def limit_blas_threads(environment: MutableMapping[str, str]) -> None:
    """Limit OpenBLAS to one thread, unless the user has set a number; call it before NumPy is imported.

    The dense systems of a robot are too small to be divided among threads, and OpenBLAS's threads spin while
    they wait: they were a third of the samples in a profile of the whole test suite.

    Args:
        environment: Changed in place, usually os.environ: child processes inherit the limit.
    """
    environment.setdefault("OPENBLAS_NUM_THREADS", "1")


def _is_writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK)
