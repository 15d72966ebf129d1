"""On a system that is not POSIX, and without ROS, the core is imported whole and the command line answers."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]

ELSEWHERE = f"""
import importlib, importlib.abc, os, pkgutil, signal, sys
absent = {{"fcntl", "termios", "tty", "pty", "resource", "grp", "pwd", "curses", "readline", "syslog",
          "crypt", "rclpy", "viser"}}
class Absent(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in absent:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
for name in absent:
    sys.modules.pop(name, None)
sys.meta_path.insert(0, Absent())
for name in ("SIGHUP", "SIGXCPU", "SIGKILL", "SIGUSR1", "SIGALRM"):
    delattr(signal, name)
for name in ("nice", "getuid", "geteuid", "fork", "killpg", "setsid", "getloadavg", "sched_getaffinity"):
    delattr(os, name)
sys.path.insert(0, {str(REPOSITORY)!r})
"""

EVERY_MODULE = """
import softsim_core
found = list(pkgutil.walk_packages(softsim_core.__path__, "softsim_core."))
for module in found:
    try:
        importlib.import_module(module.name)
    except ModuleNotFoundError as error:
        if error.name != "gymnasium":  # of an extra, at the top of two modules
            raise
print(len(found))
"""

COMMANDS = """
from softsim_ros.cli import main
codes = [main(words) for words in (["--version"], ["scenes"], ["urdf", "tripod"], ["up", "tripod"], ["upp"])]
print(codes)
"""


def elsewhere(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", ELSEWHERE + code], capture_output=True, text=True, timeout=300, check=False
    )


@pytest.mark.slow
def test_the_core_needs_no_module_that_only_posix_systems_have() -> None:
    done = elsewhere(EVERY_MODULE)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) > 250


@pytest.mark.slow
def test_commands_answer_there() -> None:
    done = elsewhere(COMMANDS)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "[0, 0, 0, 1, 2]"
    assert "ROS 2 (rclpy) is not installed; " in done.stderr
    assert "[ros]', which exists for" in done.stderr
