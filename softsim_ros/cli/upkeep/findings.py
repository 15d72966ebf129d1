"""Checks of `softsim doctor`: Python, packages, kernels, robots' files, ports, ROS 2."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
import platform
import shutil
import sys
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

from serial.tools import list_ports

from servo_bridge import PortError
from servo_bridge.driver import find_port
from servo_bridge.emulator import VirtualBoard, why_missing
from softsim_core.base import SoftSimError


class Level(Enum):
    """Severity: fine, worth knowing, or broken."""

    OK = "ok"
    WARNING = "warning"
    PROBLEM = "problem"


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of the doctor.

    Attributes:
        level: Severity.
        subject: What was checked.
        text: Result of the check.
        advice: What to do; empty if there is nothing to do.
    """

    level: Level
    subject: str
    text: str
    advice: str = ""


PACKAGES = {  # import name -> distribution; all are needed but Numba
    "numpy": "numpy",
    "scipy": "scipy",
    "meshio": "meshio",
    "cattrs": "cattrs",
    "yaml": "PyYAML",
    "serial": "pyserial",
    "lazy_loader": "lazy-loader",
}
OPTIONAL = {  # import name -> distribution, and what needs it
    "daqp": ("daqp", "inverse control (key I, inverse:=true, path follower)"),
    "viser": ("viser", "web page (up without --no-viewer, viewer:=true)"),
    "rosbags": ("rosbags", "record, replay, export and report"),
    "c3d": ("c3d", "motion capture files (C3D) in validate and calibrate"),
    "pytetwild": ("pytetwild", "meshes of parts (mesh, new)"),
    "fast_simplification": (
        "fast-simplification",
        "surfaces of over 40 000 triangles (mesh, new)",
    ),
    "urdf_parser_py": ("urdfdom_py", "robot arms from URDF files (key arm, demo pick_and_place)"),
    "xacro": ("xacro", "robot arms from xacro files"),
    "matplotlib": ("matplotlib", "charts of report, pictures of workspace --out"),
}
OLDEST, NEWEST = (3, 10), (3, 13)


def python() -> list[Finding]:
    """Check version and location of the interpreter."""
    version = sys.version_info[:2]
    text = f"{platform.python_version()} at {sys.executable}, {os.cpu_count()} cores"
    if not OLDEST <= version <= NEWEST:
        return [Finding(Level.PROBLEM, "Python", text, "use Python 3.10 to 3.13 (3.12 is ROS 2 Jazzy's own)")]
    inside = sys.prefix != sys.base_prefix
    advice = "" if inside else "the ROS wheels need a virtual environment: start with ./softsim"
    return [Finding(Level.OK if inside else Level.WARNING, "Python", text, advice)]


def packages() -> list[Finding]:
    """Check the packages that everything needs."""
    missing = [name for name in PACKAGES if importlib.util.find_spec(name) is None]
    if missing:
        names = " ".join(PACKAGES[name] for name in missing)
        return [Finding(Level.PROBLEM, "packages", f"missing: {names}", f"pip install {names}")]
    text = ", ".join(f"{name} {_version(name)}" for name in PACKAGES.values())
    return [Finding(Level.OK, "packages", text)]


def optional_packages() -> list[Finding]:
    """Check the packages that some commands need, and report what is unavailable without each."""
    findings = []
    for name, (distribution, lost) in OPTIONAL.items():
        if importlib.util.find_spec(name) is not None:
            findings.append(Finding(Level.OK, distribution, _version(distribution)))
            continue
        advice = f"pip install {distribution}, or ros2_ws/pip-requirements.txt in a virtual environment"
        findings.append(Finding(Level.WARNING, distribution, f"not installed: without it no {lost}", advice))
    return findings


def numba() -> list[Finding]:
    """Check Numba, and whether the kernels are compiled already."""
    from softsim_core.physics.kernels import why_plain

    if plain := why_plain():
        advice = "until then the SciPy path runs, several times slower"
        return [Finding(Level.WARNING, "numba", plain, advice)]
    from softsim_core.simulation import cached_kernels, kernels_ready

    compiled, folder = cached_kernels()
    text = f"{_version('numba')}, {compiled} compiled kernels cached in {folder}"
    if kernels_ready():
        return [Finding(Level.OK, "numba", f"{text}: robots run on the compiled path")]
    advice = (
        "they compile beside the first robot, which goes over to them while it runs; compile them now: "
        "python -m softsim_core.simulation.warmup"
    )
    return [Finding(Level.OK, "numba", f"{text}, not all yet: robots begin on the SciPy path", advice)]


def configs() -> list[Finding]:
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


def terminal() -> list[Finding]:
    """Check whether keys can be typed here."""
    if sys.stdin.isatty() and sys.stdout.isatty():
        size = shutil.get_terminal_size()
        return [Finding(Level.OK, "terminal", f"{size.columns} x {size.lines}, teleop works here")]
    text = "none: softsim up shows a status line instead of the teleop"
    return [Finding(Level.OK, "terminal", text)]


def _version(distribution: str) -> str:
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return "(version unknown)"


NO_ACCESS = "sudo usermod -aG dialout $USER, then log out and in"


def board(port: str = "") -> list[Finding]:
    """Check which port the bridge would use, and whether it has access.

    Args:
        port: Named by the user; empty searches.
    """
    devices = sorted(info.device for info in list_ports.comports())
    try:
        found = find_port(port)
    except PortError as error:
        advice = "without a board everything runs on the virtual one: softsim up tripod"
        return [Finding(Level.OK if not devices else Level.WARNING, "board", str(error), advice)]
    if not Path(found).exists():
        return [
            Finding(
                Level.PROBLEM, "board", f"{found} does not exist; ports seen: {', '.join(devices) or 'none'}"
            )
        ]
    if not os.access(found, os.R_OK | os.W_OK):
        return [Finding(Level.PROBLEM, "board", f"no permission to use {found}", NO_ACCESS)]
    return [Finding(Level.OK, "board", found)]


def virtual_board() -> list[Finding]:
    """Check whether a virtual board can be created on this machine."""
    with VirtualBoard() as virtual:
        return [Finding(Level.OK, "virtual board", f"works (just now on {virtual.port})")]


def emulated_board() -> list[Finding]:
    """Check whether the firmware can run in an emulated board; nothing else needs it."""
    missing = why_missing()
    if missing:
        return [Finding(Level.OK, "emulated board", f"not possible here: {missing}")]
    return [Finding(Level.OK, "emulated board", "works: softsim up tripod --board emulated")]


def flashing() -> list[Finding]:
    """Check whether a board's firmware can be uploaded, which is needed once per board."""
    program = shutil.which("avrdude")
    if program is None:
        advice = "only to put the firmware onto a board: sudo apt install avrdude"
        return [Finding(Level.OK, "avrdude", "not installed", advice)]
    return [Finding(Level.OK, "avrdude", program)]
