"""Replay page and report in a browser: they load from the disk, ask nobody for anything, and move."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from headless_browser import NOTHING_IS_DRAWN, running_chromium
from kept_open import kept_open

pytest.importorskip("rosbags")

from softsim_ros.cli import main

pytestmark = [pytest.mark.ros, pytest.mark.slow]

WAIT_MS = 120_000
MESH = "window.__viserMutable?.nodeRefFromName"


@pytest.fixture(scope="module")
def browser(request: pytest.FixtureRequest) -> Any:
    """The Chromium of all pages of a worker."""
    return kept_open.value(request, running_chromium)


@pytest.fixture
def tabs(browser: Any) -> Iterator[Any]:
    """Tabs that draw nothing."""
    context = browser.new_context()
    context.add_init_script(NOTHING_IS_DRAWN)
    context.set_default_timeout(WAIT_MS)
    yield context
    context.close()


def opened(tabs: Any, file: Path) -> tuple[Any, list[str], list[str]]:
    """A page of the file, the addresses it asks for, and its errors."""
    page = tabs.new_page()
    requests: list[str] = []
    errors: list[str] = []
    page.on("request", lambda request: requests.append(request.url))
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto(file.as_uri())
    return page, requests, errors


def outside(requests: list[str], file: Path) -> list[str]:
    return [url for url in requests if not url.startswith((file.as_uri(), "blob:", "data:", "about:"))]


def heights(frame: Any) -> list[float]:
    """Heights in [mm] of the vertices of the stress colours as the page has them now."""
    script = f"""() => Object.entries({MESH} || {{}}).filter(([name]) => name.startsWith('/stress/'))
        .flatMap(([_, node]) => {{
            const found = [];
            node.traverse(each => {{
                const place = each.geometry?.attributes?.position;
                if (each.isMesh && place)
                    for (let k = 0; k < place.count; ++k) found.push(place.getZ(k));
            }});
            return found;
        }})"""
    return [float(each) for each in frame.evaluate(script)]


def test_the_replay_page_moves_and_asks_nobody(robot_bag: Path, tmp_path: Path, tabs: Any) -> None:
    pytest.importorskip("viser")
    assert main(["export", str(robot_bag), "--html", "--out", str(tmp_path)]) == 0
    file = tmp_path / "replay.html"
    page, requests, errors = opened(tabs, file)
    page.wait_for_function(f"() => '/stress/11' in ({MESH} || {{}})")
    page.wait_for_function("() => document.querySelector('canvas') !== null")
    seen: set[float] = set()
    end = time.monotonic() + WAIT_MS / 1000.0
    while len(seen) < 3 and time.monotonic() < end:
        seen.add(round(sum(heights(page)), 1))
        page.wait_for_timeout(50)
    assert len(seen) == 3  # the robot moves, again and again
    drawn = page.evaluate(f"() => Object.keys({MESH})")
    assert {"/effector", "/goal", "/cables/line_0", "/rigid/cube"} <= set(drawn)
    assert outside(requests, file) == []
    assert errors == []


def test_the_report_shows_charts_and_replay_and_asks_nobody(
    robot_bag: Path, tmp_path: Path, tabs: Any
) -> None:
    pytest.importorskip("viser")
    pytest.importorskip("matplotlib")
    file = tmp_path / "report.html"
    assert main(["report", str(robot_bag), "--out", str(file)]) == 0
    page, requests, errors = opened(tabs, file)
    pictures = page.evaluate(
        "() => [...document.images].map(each => [each.alt, each.complete && each.naturalWidth > 100])"
    )
    assert pictures == [
        [title, True]
        for title in (
            "Joint angles",
            "Torques the servos hold",
            "Effector",
            "Distance to the goal",
            "Largest von Mises stress",
            "Real-time factor",
            "Time of each stage of a step",
        )
    ]
    text = page.inner_text("body")
    assert "Not in this recording: reports of inverse_controller in /diagnostics." in text
    assert "Dotted: commands. Dashed: limits." in text
    assert "warning" in text
    assert "slow" in text
    replay = page.frames[1]
    replay.wait_for_function(f"() => '/stress/11' in ({MESH} || {{}})")
    assert outside(requests, file) == []
    assert errors == []
