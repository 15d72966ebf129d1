"""Fixtures of the viewer's tests: `softsim up` with its page, and a headless Chromium that looks at it."""

from __future__ import annotations

import importlib.util
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from headless_browser import ARGUMENTS, chromium_path
from waiting import BUILD_S, spin_until

sys.path.append(str(Path(__file__).parent))  # for `browser_page` and `tcp_ports`


def _ros_fixtures() -> ModuleType:
    """The module of fixtures for tests across processes."""
    file = Path(__file__).resolve().parents[1] / "ros" / "conftest.py"
    spec = importlib.util.spec_from_file_location("ros_fixtures", file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


_ROS = _ros_fixtures()
ros_domain, start_process, client = _ROS.ros_domain, _ROS.start_process, _ROS.client
start_robot = _ROS.start_robot
Robot = _ROS.Robot


@pytest.fixture(scope="session", name="spin_until")
def _spin_until() -> Callable[..., bool]:
    """Looks at a condition until it holds; False when the deadline passed first."""
    return spin_until


@pytest.fixture(scope="session")
def chromium() -> str:
    return chromium_path()


@pytest.fixture(scope="module")
def start_station(
    start_process: Callable[..., Any], client: Any, tmp_path_factory: pytest.TempPathFactory
) -> Callable[..., tuple[Any, str]]:
    """Runs a robot or scene as `softsim up` does, with a page; returns it with the page's address."""
    pytest.importorskip("viser")
    from tcp_ports import free_port

    def start(name: str, *arguments: str) -> tuple[Any, str]:
        port = free_port()
        words = ("up", name, "--headless", "--lite", "--port", str(port), *arguments)
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("XDG_RUNTIME_DIR", str(tmp_path_factory.mktemp("runtime")))
            process = start_process("softsim_ros.cli", *words)
        assert process.says("open http", BUILD_S), process.output
        return Robot(process, client), re.findall(r"open (http://\S+)", process.output)[0]

    return start


@pytest.fixture(scope="module")
def allowed_code(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder whose Python scenes the station may load while it runs."""
    return tmp_path_factory.mktemp("allowed_code")


@pytest.fixture(scope="module")
def station(start_station: Callable[..., tuple[Any, str]], allowed_code: Path) -> tuple[Any, str]:
    """The Tripod with everything: simulator, bridge on a virtual board, inverse control, page."""
    return start_station("tripod", "--inverse", "--allow-code", str(allowed_code))


@pytest.fixture(scope="module")
def driven(station: tuple[Any, str], browser: Any, spin_until: Callable[..., bool]) -> Iterator[Any]:
    """The page of the station, with what its robot says."""
    from browser_page import BrowserPage
    from driven_page import BODY, Driven

    robot, address = station
    page = BrowserPage(browser, address)
    page.wait_for_node(BODY)
    result = Driven(page, robot, spin_until)
    assert result.shows("running")
    yield result
    page.close()


@pytest.fixture(scope="module")
def browser(chromium: str) -> Iterator[Any]:
    """A headless Chromium with software WebGL."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        running = playwright.chromium.launch(executable_path=chromium, headless=True, args=list(ARGUMENTS))
        yield running
        running.close()
