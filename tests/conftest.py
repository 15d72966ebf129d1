"""Fixtures shared by all tests."""

from __future__ import annotations

import gc
import os
import signal
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

REPOSITORY = Path(__file__).resolve().parents[1]
sys.path += [str(Path(__file__).parent), str(REPOSITORY)]  # tests may import `terminal_session`, `benchmarks`

from node_processes import private_ros  # noqa: E402 (found by the line above)

gc.disable()  # until all tests are collected: half the time of that went to walks over what stays

SIGNALS = {
    signal.SIGINT: signal.default_int_handler,
    signal.SIGTERM: signal.SIG_DFL,
    signal.SIGHUP: signal.SIG_DFL,
}
"""What a program of the suite handles, and what Python does about it by itself."""

REGISTRIES = {
    "servo_bridge.driver.ports": "_openers",
    "servo_bridge.protocols.registry": "_registered",
    "softsim_core.lab.identification.tables": "READERS",
    "softsim_core.physics.actuation.registry": "_kinds",
    "softsim_core.physics.fem.elements.registry": "_ELEMENTS",
    "softsim_core.physics.fem.materials.registry": "_MATERIALS",
    "softsim_core.physics.linalg.solvers": "_solvers",
    "softsim_core.physics.sensing.sensors": "_kinds",
}
"""Where users' own parts are registered, by module."""

settings.register_profile("seeded", derandomize=True, deadline=None)
settings.load_profile("seeded")  # each run draws the same examples on every machine, however slow it is


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """All pages one after the other, where files are shared among workers."""
    if config.getoption("dist") != "loadfile":
        return None
    from distribution import OneBrowser

    return OneBrowser(config, log)


@pytest.hookimpl(trylast=True)
def pytest_collection_finish() -> None:
    """Collect garbage from now on, but do not walk the collected tests each time."""
    gc.freeze()
    gc.enable()


@pytest.hookimpl(trylast=True)
def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Tell what failed when it fails: a run that is ended at its time limit prints no summary."""
    if report.outcome == "failed" and "PYTEST_XDIST_WORKER" not in os.environ:
        crash = getattr(report.longrepr, "reprcrash", None)
        reason = (
            crash.message.splitlines()[0][:200] if crash and crash.message else str(report.longrepr)[:200]
        )
        print(f"\n{report.when} of {report.nodeid} failed: {reason}", file=sys.__stderr__, flush=True)


@pytest.fixture(autouse=True)
def signals_as_before() -> Iterator[None]:
    """A program that runs inside a test leaves neither its handlers of signals nor a request to end."""
    for (
        number,
        usual,
    ) in SIGNALS.items():  # a program that ended ignores them, and who starts in the background
        if signal.getsignal(number) is signal.SIG_IGN:  # may; a process started here would ignore them, too
            signal.signal(number, usual)
    before = {number: signal.getsignal(number) for number in SIGNALS}
    yield
    used = sys.modules.get("softsim_node.signals")  # tests of the core run without it
    if used is not None:
        vars(used.ending).update(vars(used.Ending()))
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture(autouse=True)
def registries_as_before() -> Iterator[None]:
    """What a test registers, or a robot's file that it loads, is forgotten after it."""
    registries = list(_registries())
    before = [dict(each) for each in registries]
    yield
    for registry, content in zip(registries, before, strict=True):
        registry.clear()
        registry.update(content)


def _registries() -> Iterator[dict[str, Any]]:
    for module, name in REGISTRIES.items():
        try:
            registry = getattr(import_module(module), name)
        except ModuleNotFoundError as error:  # the core is also tested without the others' libraries
            if (error.name or "").startswith(("softsim", "servo_bridge")):
                raise
            continue
        yield getattr(registry, "_registered", registry)


@pytest.fixture(scope="session")
def reference_dir() -> Path:
    """Folder of the reference facts; tests that need it skip where it is absent."""
    folder = Path(os.environ.get("SOFTSIM_REFERENCE", REPOSITORY.parent / "shared" / "reference"))
    if not (folder / "data").is_dir():
        pytest.skip(f"reference data not found in {folder} (set SOFTSIM_REFERENCE)")
    return folder


@pytest.fixture(
    params=[pytest.param("numba", marks=pytest.mark.numba), pytest.param("scipy", marks=pytest.mark.slow)]
)
def backend(request: pytest.FixtureRequest) -> str:
    """Both implementations of the time step, one after the other."""
    if request.param == "numba":
        pytest.importorskip("numba")
    return str(request.param)


@pytest.fixture
def ros_domain(tmp_path: Path) -> Iterator[int]:
    """A ROS domain that no other test on this machine uses now, in the environment of this test."""
    pytest.importorskip("rclpy")
    with private_ros(tmp_path) as domain:
        yield domain
