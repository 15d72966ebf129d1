"""Fixtures of the viewer's tests: `softsim up` with its page, and a headless Chromium that looks at it."""

from __future__ import annotations

import importlib.util
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from headless_browser import running_chromium
from kept_open import kept_open
from node_processes import Client, NodeProcess, ProcessGroup, private_ros
from shared_robots import Robot
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
start_robot, shared_robot, shared_robots = _ROS.start_robot, _ROS.shared_robot, _ROS.shared_robots


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Let tests of the Tripod's station follow each other, and then those of other pages."""
    items.sort(key=_rank)


def _rank(item: pytest.Item) -> int:
    names = getattr(item, "fixturenames", ())
    return 0 if "station" in names else 1 if "browser" in names else 2


@pytest.fixture(scope="session", name="spin_until")
def _spin_until() -> Callable[..., bool]:
    """Looks at a condition until it holds; False when the deadline passed first."""
    return spin_until


@pytest.fixture(scope="module")
def browser(request: pytest.FixtureRequest) -> Any:
    """A headless Chromium with software WebGL, one for all pages of a worker."""
    return kept_open.value(request, running_chromium)


@pytest.fixture(scope="module")
def start_station(
    start_process: Callable[..., Any], client: Any, tmp_path_factory: pytest.TempPathFactory
) -> Callable[..., tuple[Any, str]]:
    """Runs a robot or scene as `softsim up` does, with a page; returns it with the page's address."""
    pytest.importorskip("viser")

    def start(name: str, *arguments: str) -> tuple[Any, str]:
        process, address = started(start_process, tmp_path_factory.mktemp("runtime"), name, *arguments)
        return Robot(process, client), address

    return start


def started(start: Callable[..., Any], folder: Path, name: str, *arguments: str) -> tuple[NodeProcess, str]:
    """Start a robot or scene as `softsim up` does; the process, and the address of its page."""
    from tcp_ports import free_port

    words = ("up", name, "--headless", "--lite", "--port", str(free_port()), *arguments)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", str(folder))
        process = start("softsim_ros.cli", *words)
    assert process.says("open http", BUILD_S), process.output
    return process, re.findall(r"open (http://\S+)", process.output)[0]


@pytest.fixture(scope="session")
def allowed_code(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder whose Python scenes the station may load while it runs."""
    return tmp_path_factory.mktemp("allowed_code")


@pytest.fixture(scope="module")
def station(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, allowed_code: Path
) -> tuple[Robot, str]:
    """The Tripod with everything: simulator, bridge on a virtual board, inverse control, page.

    It runs on for all files that use it, in a ROS domain of its own, and is brought back before each of them.
    """
    pytest.importorskip("rclpy")
    pytest.importorskip("viser")

    @contextmanager
    def running() -> Iterator[tuple[Robot, str]]:
        folder = tmp_path_factory.mktemp("station")
        with private_ros(folder) as domain:
            processes = ProcessGroup(folder)
            client = Client(domain, "tripod", processes)
            try:
                words = ("tripod", "--inverse", "--allow-code", str(allowed_code))
                process, address = started(processes, folder, *words)
                yield Robot(process, client), address
            finally:
                client.close()
                processes.end()

    robot, address = kept_open.value(request, running)
    robot.restore()
    return robot, address


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


@pytest.fixture(autouse=True)
def _frames_come(request: pytest.FixtureRequest) -> None:
    """Before each test of the Tripod's page: a page whose frames have stopped is opened anew."""
    if "driven" in request.fixturenames:
        request.getfixturevalue("driven").page.reopened()
