"""Checks of ROS 2: client, message packages, mixed installations, discovery, logs, shared memory."""

from __future__ import annotations

import importlib.util
import os
import shutil
import sys
from pathlib import Path

from softsim_node import environment, has_ros_wheels, ros_problems, system_ros
from softsim_ros import OPTIONAL
from softsim_ros.cli.upkeep.findings import Finding, Level

MESSAGE_PACKAGES = (
    "std_msgs", "sensor_msgs", "geometry_msgs", "trajectory_msgs", "visualization_msgs", "shape_msgs",
    "diagnostic_msgs", "rosgraph_msgs", "lifecycle_msgs", "std_srvs",
)  # fmt: skip
SHARED_MEMORY = Path("/dev/shm")
SHARED_MEMORY_NEEDED = 64_000_000


def client() -> list[Finding]:
    """Check whether rclpy starts, and where it comes from."""
    if importlib.util.find_spec("rclpy") is None:
        advice = "start with ./softsim, which installs it (x86-64 Linux), or source /opt/ros/jazzy/setup.bash"
        return [Finding(Level.PROBLEM, "ROS 2", "rclpy is not installed", advice)]
    if problems := ros_problems(os.environ):
        advice = "change the variable in this terminal; the commands that need ROS refuse to start"
        return [Finding(Level.PROBLEM, "ROS 2", each, advice) for each in problems]
    try:
        import rclpy
        from rclpy.utilities import get_rmw_implementation_identifier

        middleware = get_rmw_implementation_identifier()
    except Exception as error:
        advice = "the libraries are not found: start through ./softsim, in a terminal of its own"
        return [Finding(Level.PROBLEM, "ROS 2", f"rclpy does not start: {error}", advice)]
    source = "pip wheels" if has_ros_wheels(Path(sys.prefix)) else os.environ.get("ROS_DISTRO", "system")
    place = Path(rclpy.__file__).parent
    findings = [Finding(Level.OK, "ROS 2", f"rclpy ({source}) with {middleware} in {place}")]
    missing = [name for name in MESSAGE_PACKAGES if importlib.util.find_spec(name) is None]
    if missing:
        advice = (
            "pip install ros-jazzy-common-interfaces==5.3.6, or sudo apt install ros-jazzy-common-interfaces"
        )
        findings.append(Finding(Level.PROBLEM, "messages", f"missing: {', '.join(missing)}", advice))
    return [*findings, *_optional()]


def _optional() -> list[Finding]:
    """Report the features of optional message packages."""
    findings = []
    for name, offer in OPTIONAL.items():
        here = importlib.util.find_spec(name) is not None
        text = f"here: {offer}" if here else f"not here (apt's ROS 2 has it); it brings {offer}"
        findings.append(Finding(Level.OK, name, text))
    return findings


def mixture() -> list[Finding]:
    """Check whether a system ROS and the wheels are mixed in this environment."""
    other = system_ros(os.environ)
    if other and has_ros_wheels(Path(sys.prefix)):
        text = f"{other} is active beside the ROS wheels in {sys.prefix}"
        return [Finding(Level.PROBLEM, "mixture", text, "use a terminal where /opt/ros is not sourced")]
    return []


def reach() -> list[Finding]:
    """Check which computers can reach the nodes started here."""
    requested, text = environment.requested_range(os.environ), environment.describe_range(os.environ)
    if requested in ("SUBNET", "SYSTEM_DEFAULT") or os.environ.get(environment.PEERS):
        names = f"{environment.DISCOVERY_VARIABLE} and {environment.PEERS}"
        advice = f"unset {names} to keep the robot to this computer"
        return [Finding(Level.WARNING, "discovery", text, advice)]
    return [Finding(Level.OK, "discovery", text)]


def log_folder() -> list[Finding]:
    """Check whether ROS can write its logs."""
    home = Path(os.environ.get("ROS_HOME", Path(os.environ.get("HOME", "/nonexistent")) / ".ros"))
    folder = Path(os.environ.get("ROS_LOG_DIR", home / "log"))
    try:
        folder.mkdir(parents=True, exist_ok=True)
        writable = os.access(folder, os.W_OK)
    except OSError:
        writable = False
    if writable:
        return [Finding(Level.OK, "logs", str(folder))]
    return [
        Finding(Level.PROBLEM, "logs", f"{folder} cannot be written", "set ROS_LOG_DIR to a folder of yours")
    ]


def shared_memory() -> list[Finding]:
    """Check the space for ROS's transport between processes, and segments that killed processes left."""
    if not SHARED_MEMORY.is_dir():
        advice = "messages take the network loopback instead, which is slower; mount tmpfs on /dev/shm"
        return [Finding(Level.WARNING, "shared memory", "no /dev/shm", advice)]
    free = shutil.disk_usage(SHARED_MEMORY).free
    left = [path for path in SHARED_MEMORY.glob("fastrtps_*") if path.stat().st_uid == os.getuid()]
    text = f"{free / 1e6:.0f} MB free, {len(left)} transport files"
    if free < SHARED_MEMORY_NEEDED:
        advice = "end all nodes and remove what kill -9 left: rm /dev/shm/*fastrtps_*"
        return [Finding(Level.WARNING, "shared memory", text, advice)]
    return [Finding(Level.OK, "shared memory", text)]
