"""A scene that is edited while its page is open: a wrong file shows its error in place of the scene."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("viser")

from browser_page import BrowserPage
from edited_scenes import SCENE, save

from softsim_core import load_scene

pytestmark = [pytest.mark.ros, pytest.mark.slow]

BODY = "/bodies/silicone"
CAMERA = "window.__viserMutable.camera.position.toArray()"


def camera_at_rest(page: BrowserPage, spin_until: Callable[..., bool]) -> list[float]:
    """Where the camera is once the page has taken the whole drag: the same for several pictures."""
    seen: list[list[float]] = []

    def rests() -> bool:
        seen.append(page.page.evaluate(CAMERA))
        page.await_frames()
        return len(seen) > 8 and all(each == pytest.approx(seen[-1], abs=1e-6) for each in seen[-8:])

    assert spin_until(rests), seen[-8:]
    return seen[-1]


def test_a_wrong_file_shows_its_error_in_place_of_the_scene(
    start_station: Callable[..., tuple[Any, str]],
    browser: Any,
    spin_until: Callable[..., bool],
    tmp_path: Path,
) -> None:
    file, tripod = tmp_path / "mine.yaml", load_scene("tripod").source
    save(file, SCENE.format(base=tripod, young="300.0e+3"))
    robot, address = start_station(str(file), "--watch")
    page = BrowserPage(browser, address)
    try:
        page.wait_for_node(BODY)
        page.drag((200.0, 200.0), (260.0, 240.0))
        page.release()
        camera = camera_at_rest(page, spin_until)
        save(file, SCENE.format(base=tripod, young="-1.0"))
        told = page.page.get_by_text("/tripod: scene not loaded: ")
        told.first.wait_for(state="visible")
        assert "young_modulus: must be > 0 Pa" in told.first.inner_text()
        page.wait_until_gone(BODY)
        save(file, SCENE.format(base=tripod, young="400.0e+3"))
        page.wait_for_node(BODY)
        told.first.wait_for(state="hidden")
        assert spin_until(lambda: robot.get_parameter("young_modulus") == 400.0e3, 60.0)
        assert page.page.evaluate(CAMERA) == pytest.approx(camera, abs=1e-3)  # the view is kept
    finally:
        page.close()
