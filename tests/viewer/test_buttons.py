"""Every button of the page has its effect, seen on ROS topics and services, or in the picture."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Final

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("viser")

from driven_page import BODY, HIGH, MID, START, Driven
from std_msgs.msg import String

pytestmark = [pytest.mark.ros, pytest.mark.slow]

BOARD: Final = "servo_bridge: servo board"
CAMERA: Final = "window.__viserMutable.camera.position.toArray()"
OF_VISER: Final = frozenset({"Minimize panel"})


def turns_a_joint(joint: int, step: float, driven: Driven, label: str) -> None:
    wanted = [MID] * 3
    for times in (1, 2):
        driven.page.click(label)
        wanted[joint] = MID + times * step
        assert driven.joints_at(*wanted)


def goes_to(position: float, driven: Driven, label: str) -> None:
    driven.robot.command([-1.2, -1.1, -1.0])
    assert driven.joints_at(-1.2, -1.1, -1.0)
    driven.page.click(label)
    assert driven.joints_at(position, position, position)


def sends(driven: Driven, label: str) -> None:
    driven.page.click(label)
    assert driven.until(lambda: driven.bridge_state() == "active")
    assert driven.shows("bridge comm")
    driven.page.click(label)
    assert driven.until(lambda: driven.bridge_state() == "inactive")
    assert driven.shows("bridge no-comm")


def stops_and_releases(driven: Driven, _: str) -> None:
    driven.page.click("Start / stop sending to the board")
    assert driven.until(lambda: driven.bridge_state() == "active")
    assert driven.reports(BOARD, "e_stop", "False")
    driven.page.click("E-STOP")
    assert driven.reports(BOARD, "e_stop", "True")
    driven.page.page.get_by_text("e-stop", exact=True).wait_for(state="visible")
    driven.page.click("Release e-stop")
    assert driven.reports(BOARD, "e_stop", "False")
    assert driven.shows("no e-stop")
    driven.page.click("Start / stop sending to the board")
    assert driven.until(lambda: driven.bridge_state() == "inactive")


def switches_inverse_control(driven: Driven, label: str) -> None:
    assert driven.reports("inverse_controller", "mode", "off")
    driven.page.click(label)
    assert driven.until(lambda: driven.reported("inverse_controller", "mode") not in ("", "off"))
    assert driven.shows("inverse on")
    driven.page.click(label)
    assert driven.reports("inverse_controller", "mode", "off")
    assert driven.shows("inverse off")


def pauses(driven: Driven, label: str) -> None:
    driven.page.click(label)
    assert driven.reports("simulator", "state", "paused")
    assert driven.shows("paused")
    driven.page.click(label)
    assert driven.reports("simulator", "state", "running")
    assert driven.shows("running")


def makes_one_step(driven: Driven, label: str) -> None:
    driven.page.click("Run / pause")
    assert driven.reports("simulator", "state", "paused")
    assert driven.shows("paused")
    assert driven.next_report("simulator")  # the count of steps of now
    before = int(driven.reported("simulator", "steps"))
    driven.page.click(label)
    assert driven.reports("simulator", "steps", str(before + 1))
    driven.page.click("Run / pause")
    assert driven.reports("simulator", "state", "running")
    assert driven.shows("running")
    driven.page.click(label)  # pauses first
    assert driven.reports("simulator", "state", "paused")


def loads_anew(driven: Driven, label: str) -> None:
    told = driven.robot.client.collect(String, "scene/structure")
    driven.page.click(label)
    assert driven.until(lambda: told)
    driven.page.wait_for_node(BODY)
    assert driven.joints_at(0.0, 0.0, 0.0)


def jumps_to_the_slowest_step(driven: Driven, label: str) -> None:
    follow = driven.page.page.get_by_role("checkbox", name="Follow the newest step", exact=True)
    if not follow.is_checked():
        follow.click()
    driven.page.click(label)
    assert driven.until(lambda: not follow.is_checked())


def brings_the_camera_back(driven: Driven, label: str) -> None:
    page = driven.page

    def turned() -> list[float]:
        """Where the camera is once the mouse has turned it."""
        before = page.page.evaluate(CAMERA)
        page.drag((200.0, 200.0), (300.0, 260.0))
        page.release()
        assert driven.until(lambda: math.dist(before, page.page.evaluate(CAMERA)) > 50.0)
        return list(page.page.evaluate(CAMERA))

    homes = []
    for _ in range(2):
        away = turned()
        page.click(label)
        assert driven.until(lambda away=away: math.dist(away, page.page.evaluate(CAMERA)) > 50.0)
        page.await_frames()
        homes.append(page.page.evaluate(CAMERA))
    assert math.dist(*homes) < 20.0  # the body, which it looks at, may have moved a little


def saves_a_picture(driven: Driven, label: str) -> None:
    from imageio.v3 import imread

    page = driven.page.page
    page.evaluate("window.picturesAreDrawn = true")
    with page.expect_download(timeout=120_000) as saved:
        driven.page.click(label)
    page.evaluate("window.picturesAreDrawn = false")
    picture = imread(Path(saved.value.path()), extension=".png")
    assert picture.shape[:2] == (900, 1200)
    assert picture[..., :3].std() > 5.0  # the robot, not one colour


def saves_a_clip(driven: Driven, label: str) -> None:
    from PIL import Image

    page = driven.page.page
    page.evaluate("window.picturesAreDrawn = true")
    with page.expect_download(timeout=120_000) as saved:
        driven.page.click(label)
    page.evaluate("window.picturesAreDrawn = false")
    clip = Image.open(Path(saved.value.path()))
    assert clip.format == "WEBP"
    assert clip.size == (640, 480)


def closes_the_hint(driven: Driven, label: str) -> None:
    driven.page.click(label)
    driven.page.page.get_by_text("drag turns").wait_for(state="hidden")


Effect = Callable[[Driven, str], None]

EFFECTS: Final[dict[str, tuple[str, Effect]]] = {
    "↑ up": ("Drive", partial(turns_a_joint, 0, 0.1)),
    "↓ down": ("Drive", partial(turns_a_joint, 0, -0.1)),
    "← up": ("Drive", partial(turns_a_joint, 1, 0.1)),
    "→ down": ("Drive", partial(turns_a_joint, 1, -0.1)),
    "+ up": ("Drive", partial(turns_a_joint, 2, 0.1)),
    "− down": ("Drive", partial(turns_a_joint, 2, -0.1)),
    "A start pose": ("Drive", partial(goes_to, START)),
    "Q mid pose": ("Drive", partial(goes_to, MID)),
    "Z high pose": ("Drive", partial(goes_to, HIGH)),
    "B send to the board": ("Drive", sends),
    "I inverse control": ("Drive", switches_inverse_control),
    "Space pause / go on": ("Drive", pauses),
    "R reset the simulation": ("Drive", partial(goes_to, 0.0)),
    "Start / stop sending to the board": ("Drive", sends),
    "E-STOP": ("Drive", stops_and_releases),
    "Run / pause": ("Plots", pauses),
    "Step": ("Plots", makes_one_step),
    "Reset": ("Plots", partial(goes_to, 0.0)),
    "Reload": ("Plots", loads_anew),
    "Jump to the slowest step": ("Timing", jumps_to_the_slowest_step),
    "Reset view": ("View", brings_the_camera_back),
    "Save picture": ("View", saves_a_picture),
    "Save clip": ("View", saves_a_clip),
    "Close the hint": ("Drive", closes_the_hint),
}
"""For each button the tab where it is clicked and the test of what it does."""


ELSEWHERE: Final = {
    "Show properties": "test_scene_page.py",
    "Apply changes": "test_scene_page.py",
    "Forget changes": "test_scene_page.py",
    "Save view": "test_scene_page.py",
    "Undo": "test_edit_page.py",
    "Redo": "test_edit_page.py",
    "Discard": "test_edit_page.py",
    "Apply": "test_edit_page.py",
    "Save": "test_edit_page.py",
    "Copy": "test_edit_page.py",
    "Release e-stop": "test_buttons.py",
}
"""Buttons whose effect another file tests; some are there only at times."""


def test_each_button_of_the_page_has_its_test(driven: Driven) -> None:
    page, found = driven.page.page, set()
    for tab in page.get_by_role("tab").all():
        tab.click()
        driven.page.await_frames()
        labels = {button.inner_text() for button in page.get_by_role("button").all()}
        found |= {label for label in labels if label} - OF_VISER
    assert found - set(ELSEWHERE) == set(EFFECTS)
    for label, file in ELSEWHERE.items():
        assert f'"{label}"' in Path(__file__).with_name(file).read_text(encoding="utf-8")


@pytest.mark.parametrize("label", EFFECTS)
def test_a_button_acts(label: str, driven: Driven) -> None:
    tab, effect = EFFECTS[label]
    driven.to_mid()
    driven.page.tab(tab)
    effect(driven, label)
