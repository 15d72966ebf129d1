"""`softsim doctor`: report what is installed, which port, which ROS, and what to do about problems."""

from __future__ import annotations

import argparse
import contextlib
import importlib.util
import os
import platform
import shutil
import sys
from enum import Enum
from pathlib import Path
from typing import NamedTuple

from serial.tools import list_ports

from servo_bridge import PortError
from servo_bridge.driver import find_port
from servo_bridge.emulator import VirtualBoard, why_missing
from softsim_core.base import SoftSimError, version_of
from softsim_node import environment, has_ros_wheels, ros_problems, system_ros
from softsim_ros import OPTIONAL
from softsim_ros.cli import ROS_PACKAGES, Colours


class Level(Enum):
    """Severity: fine, worth knowing, or broken; the value is its mark in the list."""

    OK = "ok  "
    WARNING = "warn"
    PROBLEM = "FAIL"


class Finding(NamedTuple):
    """One line of the doctor: severity, what was checked, the result, and advice (or none)."""

    level: Level
    subject: str
    text: str
    advice: str = ""


PACKAGES = {  # import name -> distribution; all are needed but Numba
    "numpy": "numpy",
    "scipy": "scipy",
    "meshio": "meshio",
    "yaml": "PyYAML",
    "serial": "pyserial",
    "lazy_loader": "lazy-loader",
    "jinja2": "Jinja2",
}
OPTIONAL_PACKAGES = {  # import name -> distribution, and what needs it
    "daqp": ("daqp", "inverse control (key I, inverse:=true, path follower)"),
    "viser": ("viser", "web page (up without --no-viewer, viewer:=true)"),
    "rosbags": ("rosbags", "record, replay, export and report"),
    "c3d": ("c3d", "motion capture files (C3D) in validate and calibrate"),
    "pytetwild": ("pytetwild", "meshes of parts (mesh, new)"),
    "fast_simplification": ("fast-simplification", "surfaces of over 40 000 triangles (mesh, new)"),
    "urdf_parser_py": ("urdfdom_py", "robot arms from URDF files (key arm, demo pick_and_place)"),
    "xacro": ("xacro", "robot arms from xacro files"),
    "matplotlib": ("matplotlib", "charts of report, pictures of workspace --out"),
}
OLDEST, NEWEST = (3, 10), (3, 13)
UNKNOWN = "(version unknown)"


def check_python() -> list[Finding]:
    """Check version and location of the interpreter."""
    version = sys.version_info[:2]
    text = f"{platform.python_version()} at {sys.executable}, {os.cpu_count()} cores"
    if not OLDEST <= version <= NEWEST:
        return [Finding(Level.PROBLEM, "Python", text, "use Python 3.10 to 3.13 (3.12 is ROS 2 Jazzy's own)")]
    inside = sys.prefix != sys.base_prefix
    advice = "" if inside else "the ROS wheels need a virtual environment: start with ./softsim"
    return [Finding(Level.OK if inside else Level.WARNING, "Python", text, advice)]


def check_packages() -> list[Finding]:
    """Check the packages that everything needs."""
    missing = [name for name in PACKAGES if importlib.util.find_spec(name) is None]
    if missing:
        names = " ".join(PACKAGES[name] for name in missing)
        return [Finding(Level.PROBLEM, "packages", f"missing: {names}", f"pip install {names}")]
    text = ", ".join(f"{name} {version_of(name) or UNKNOWN}" for name in PACKAGES.values())
    return [Finding(Level.OK, "packages", text)]


def check_optional_packages() -> list[Finding]:
    """Check the packages that some commands need, and report what is unavailable without each."""
    findings = []
    for name, (distribution, lost) in OPTIONAL_PACKAGES.items():
        if importlib.util.find_spec(name) is not None:
            findings.append(Finding(Level.OK, distribution, version_of(distribution) or UNKNOWN))
            continue
        advice = f"pip install {distribution}, or ros2_ws/pip-requirements.txt in a virtual environment"
        findings.append(Finding(Level.WARNING, distribution, f"not installed: without it no {lost}", advice))
    return findings


def check_numba() -> list[Finding]:
    """Check Numba, and whether the kernels are compiled already."""
    from softsim_core.physics.kernels import why_plain

    if plain := why_plain():
        advice = "until then the SciPy path runs, several times slower"
        return [Finding(Level.WARNING, "numba", plain, advice)]
    from softsim_core.simulation import cached_kernels, kernels_ready

    compiled, folder = cached_kernels()
    text = f"{version_of('numba')}, {compiled} compiled kernels cached in {folder}"
    if kernels_ready():
        return [Finding(Level.OK, "numba", f"{text}: robots run on the compiled path")]
    advice = (
        "they compile beside the first robot, which goes over to them while it runs; compile them now: "
        "python -m softsim_core.simulation.warmup"
    )
    return [Finding(Level.OK, "numba", f"{text}, not all yet: robots begin on the SciPy path", advice)]


def check_configs() -> list[Finding]:
    """Check which robots and scenes are found, and whether the robots can be read."""
    from softsim_core.scene import load_scene
    from softsim_core.scene.io import config_roots, known_scenes

    roots = config_roots()
    if not roots:
        advice = "set SOFTSIM_CONFIG_PATH to a folder that holds robots/ and scenes/"
        return [Finding(Level.PROBLEM, "configs", "no configs folder found", advice)]
    robots = known_scenes("robots")
    text = f"{len(robots)} robots, {len(known_scenes('scenes'))} scenes in {', '.join(map(str, roots))}"
    findings = [Finding(Level.OK, "configs", text)]
    for name in robots:
        try:
            load_scene(name, kind="robots")
        except SoftSimError as error:
            findings.append(Finding(Level.PROBLEM, f"robot {name}", str(error), "mend the file"))
    return findings


def check_terminal() -> list[Finding]:
    """Check whether keys can be typed here."""
    if sys.stdin.isatty() and sys.stdout.isatty():
        size = shutil.get_terminal_size()
        text = f"{size.columns} x {size.lines}, teleop works here"
    else:
        text = "none: softsim up shows a status line instead of the teleop"
    return [Finding(Level.OK, "terminal", text)]


def check_board(port: str = "") -> list[Finding]:
    """Check which port the bridge would use, and whether it has access; an empty `port` searches."""
    devices = sorted(info.device for info in list_ports.comports())
    try:
        found = find_port(port)
    except PortError as error:
        advice = "without a board everything runs on the virtual one: softsim up tripod"
        return [Finding(Level.OK if not devices else Level.WARNING, "board", str(error), advice)]
    if not Path(found).exists():
        text = f"{found} does not exist; ports seen: {', '.join(devices) or 'none'}"
        return [Finding(Level.PROBLEM, "board", text)]
    if not os.access(found, os.R_OK | os.W_OK):
        advice = "sudo usermod -aG dialout $USER, then log out and in"
        return [Finding(Level.PROBLEM, "board", f"no permission to use {found}", advice)]
    return [Finding(Level.OK, "board", found)]


def check_virtual_board() -> list[Finding]:
    """Check whether a virtual board can be created on this machine."""
    with VirtualBoard() as virtual:
        return [Finding(Level.OK, "virtual board", f"works (just now on {virtual.port})")]


def check_emulated_board() -> list[Finding]:
    """Check whether the firmware can run in an emulated board; nothing else needs it."""
    missing = why_missing()
    text = f"not possible here: {missing}" if missing else "works: softsim up tripod --board emulated"
    return [Finding(Level.OK, "emulated board", text)]


def check_flashing() -> list[Finding]:
    """Check whether a board's firmware can be uploaded, which is needed once per board."""
    program = shutil.which("avrdude")
    advice = "" if program else "only to put the firmware onto a board: sudo apt install avrdude"
    return [Finding(Level.OK, "avrdude", program or "not installed", advice)]


SHARED_MEMORY = Path("/dev/shm")
SHARED_MEMORY_NEEDED = 64_000_000


def check_client() -> list[Finding]:
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
    missing = [name for name in ROS_PACKAGES if importlib.util.find_spec(name) is None]
    if missing:
        package = "ros-jazzy-common-interfaces"
        advice = f"pip install {package}==5.3.6, or sudo apt install {package}"
        findings.append(Finding(Level.PROBLEM, "messages", f"missing: {', '.join(missing)}", advice))
    for name, offer in OPTIONAL.items():
        here = importlib.util.find_spec(name) is not None
        text = f"here: {offer}" if here else f"not here (apt's ROS 2 has it); it brings {offer}"
        findings.append(Finding(Level.OK, name, text))
    return findings


def check_mixture() -> list[Finding]:
    """Check whether a system ROS and the wheels are mixed in this environment."""
    other = system_ros(os.environ)
    if other and has_ros_wheels(Path(sys.prefix)):
        text = f"{other} is active beside the ROS wheels in {sys.prefix}"
        return [Finding(Level.PROBLEM, "mixture", text, "use a terminal where /opt/ros is not sourced")]
    return []


def check_reach() -> list[Finding]:
    """Check which computers can reach the nodes started here."""
    requested, text = environment.requested_range(os.environ), environment.describe_range(os.environ)
    if requested in ("SUBNET", "SYSTEM_DEFAULT") or os.environ.get(environment.PEERS):
        names = f"{environment.DISCOVERY_VARIABLE} and {environment.PEERS}"
        advice = f"unset {names} to keep the robot to this computer"
        return [Finding(Level.WARNING, "discovery", text, advice)]
    return [Finding(Level.OK, "discovery", text)]


def check_log_folder() -> list[Finding]:
    """Check whether ROS can write its logs."""
    home = Path(os.environ.get("ROS_HOME", Path(os.environ.get("HOME", "/nonexistent")) / ".ros"))
    folder = Path(os.environ.get("ROS_LOG_DIR", home / "log"))
    with contextlib.suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
    if folder.is_dir() and os.access(folder, os.W_OK):
        return [Finding(Level.OK, "logs", str(folder))]
    advice = "set ROS_LOG_DIR to a folder of yours"
    return [Finding(Level.PROBLEM, "logs", f"{folder} cannot be written", advice)]


def check_shared_memory() -> list[Finding]:
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


COLOURS = {Level.OK: "green", Level.WARNING: "yellow", Level.PROBLEM: "red"}

CHECKS = (
    check_python,
    check_packages,
    check_optional_packages,
    check_numba,
    check_configs,
    check_client,
    check_mixture,
    check_reach,
    check_log_folder,
    check_shared_memory,
    check_board,
    check_virtual_board,
    check_emulated_board,
    check_flashing,
    check_terminal,
)


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("--port", default="", metavar="PATH", help="the board's port, where you know it")


def run(arguments: argparse.Namespace) -> int:
    """Print every finding; return 0 if nothing is broken (warnings allowed), else 1."""
    found = examine(arguments.port)
    colour = Colours(sys.stdout)
    for finding in found:
        mark = colour(COLOURS[finding.level], finding.level.value)
        print(f"{mark}  {finding.subject}: {finding.text}")
        if finding.advice:
            print(f"      -> {finding.advice}")
    problems = sum(finding.level is Level.PROBLEM for finding in found)
    warnings = sum(finding.level is Level.WARNING for finding in found)
    print(f"{len(found)} checks, {problems} broken, {warnings} to mind")
    return 1 if problems else 0


def examine(port: str = "") -> list[Finding]:
    """Run every check; a check that fails itself becomes a finding, too."""
    found = []
    for check in CHECKS:
        try:
            found += check(port) if check is check_board else check()
        except Exception as error:  # a broken installation may fail anywhere, and it is reported here
            name = check.__name__.removeprefix("check_").replace("_", " ")
            found.append(Finding(Level.PROBLEM, name, f"the check itself failed: {error!r}"))
    return found
