"""A newcomer's walk: from a clean checkout `./softsim up tripod` says one address, and the robot is there."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from waiting import DEADLINE_S

pytest.importorskip("rclpy")
pytest.importorskip("viser")

from browser_page import BrowserPage
from kernel_cache import share_kernels
from node_processes import domain_guards
from tcp_ports import free_port

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.packaging]

REPOSITORY = Path(__file__).resolve().parents[2]
MADE_WITHIN_S = 400.0
"""Compiling the kernels on a busy machine."""

MAKER = """#!/bin/sh
# in place of uv: the environment is the one of these tests, and nothing is fetched
case "$1" in
venv)
    for folder in "$@"; do :; done
    mkdir -p "$folder/bin"
    printf '#!/bin/sh\\nPYTHONPATH="{checkout}" exec "{python}" "$@"\\n' >"$folder/bin/python"
    chmod +x "$folder/bin/python"
    printf 'import sys\\nfrom softsim_ros.cli import main\\nsys.exit(main())\\n' >"$folder/bin/softsim" ;;
esac
"""


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """The files that git knows and those it would take, in a folder of their own, with compiled kernels."""
    if shutil.which("git") is None or not (REPOSITORY / ".git").exists():
        pytest.skip("no git checkout to take a clean copy of")
    if "/opt/ros/" in os.environ.get("AMENT_PREFIX_PATH", ""):
        pytest.skip("a system ROS is active, which ./softsim refuses")
    known = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        check=True,
    )
    folder = tmp_path / "checkout"
    for name in filter(None, known.stdout.split("\0")):
        if (REPOSITORY / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(REPOSITORY / name, folder / name)
    share_kernels(folder)
    return folder


@pytest.fixture
def path(tmp_path: Path, checkout: Path) -> str:
    """PATH with a maker of environments that fetches nothing."""
    folder = tmp_path / "bin"
    folder.mkdir()
    (folder / "uv").write_text(MAKER.format(checkout=checkout, python=sys.executable))
    (folder / "uv").chmod(0o755)
    return f"{folder}{os.pathsep}{os.environ['PATH']}"


def child_that_runs(module: str, parent: int) -> int:
    """The process with that module's name on its command line."""
    children = Path(f"/proc/{parent}/task/{parent}/children").read_text().split()
    return next(int(each) for each in children if module in Path(f"/proc/{each}/cmdline").read_text())


def test_one_command_one_address_one_robot(
    checkout: Path, path: str, ros_domain: int, browser: Any, spin_until: Callable[..., bool], tmp_path: Path
) -> None:
    log = tmp_path / "output.txt"
    variables = {**os.environ, "PATH": path, "XDG_RUNTIME_DIR": str(tmp_path), "PYTHONUNBUFFERED": "1"}
    for name in ("SOFTSIM_HOME", "SOFTSIM_PYTHON", "NUMBA_CACHE_DIR"):
        variables.pop(name, None)
    with log.open("wb") as output:
        process = subprocess.Popen(
            ["./softsim", "up", "tripod", "--port", str(free_port())],
            cwd=checkout,
            env=variables,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            pass_fds=list(domain_guards),
        )
    try:
        stamp = checkout / ".softsim" / "stamp"
        over = lambda: process.poll() is not None  # noqa: E731
        assert spin_until(lambda: stamp.exists() or over(), MADE_WITHIN_S), log.read_text()
        assert spin_until(lambda: "open http" in log.read_text() or over(), 120.0), log.read_text()
        addresses = re.findall(r"http://\S+", log.read_text())
        assert len(addresses) == 1, log.read_text()
        page = BrowserPage(browser, addresses[0])
        page.wait_for_node("/bodies/silicone")
        assert len(page.vertices("/bodies/silicone")) > 1000
        page.close()
        os.kill(child_that_runs("viewer_node", process.pid), signal.SIGKILL)
        assert spin_until(lambda: "the web page has ended, the robot continues" in log.read_text() or over())
        process.send_signal(signal.SIGINT)
        assert process.wait(DEADLINE_S) == 0
        assert len(re.findall(r"http://\S+", log.read_text())) == 1
    finally:
        process.kill()
