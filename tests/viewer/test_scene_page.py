"""The tab Scene and the switches of the picture in headless Chromium: what they change, on ROS topics."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("viser")

from browser_page import BrowserPage
from geometry_msgs.msg import PoseArray
from std_msgs.msg import String

from softsim_core import load_scene

pytestmark = [pytest.mark.ros, pytest.mark.slow]

CAMERA = "window.__viserMutable.camera.position.toArray()"
BODY = "/bodies/silicone"
WAIT_S = 120.0


class Scene:
    """The page with its robot's frames."""

    def __init__(self, page: BrowserPage, robot: Any, spin_until: Callable[..., bool]) -> None:
        self.page, self.robot, self._spin_until = page, robot, spin_until
        self.frames = robot.client.collect(PoseArray, "frames", 5)
        self.structures = robot.client.collect(String, "scene/structure")
        assert self.until(lambda: self.frames)

    def until(self, condition: Callable[[], Any], within_s: float = WAIT_S) -> bool:
        return self._spin_until(condition, within_s)

    def open(self, *branches: str) -> None:
        """Open branches of the tree that are closed, the outer ones first."""
        for name in branches:
            self.page.page.get_by_text(name, exact=True).locator("visible=true").last.click()
            self.page.await_frames()

    def visible(self, button: str) -> Any:
        return self.page.page.get_by_role("button", name=button, exact=True).locator("visible=true")

    def field(self, label: str) -> Any:
        words = self.page.page.locator("label").get_by_text(label, exact=True)
        return words.locator("xpath=../../..").locator("input, textarea").locator("visible=true")

    def servo_is_at(self, y: float) -> bool:
        """Whether the first frame after the effector's, the base of servo 0, comes to have this y in [m]."""
        return self.until(lambda: abs(self.frames[-1].poses[1].position.y - y) < 1e-6)


@pytest.fixture(scope="module")
def scene(station: tuple[Any, str], browser: Any, spin_until: Callable[..., bool]) -> Iterator[Scene]:
    robot, address = station
    page = BrowserPage(browser, address)
    page.wait_for_node(BODY)
    page.page.get_by_text("running").first.wait_for(state="visible")
    page.tab("Scene")
    yield Scene(page, robot, spin_until)
    page.close()


def test_a_part_is_changed_where_it_is_found_in_the_tree(scene: Scene) -> None:
    scene.page.page.get_by_text("A scene with control, wiring and view of its robot").wait_for(
        state="visible"
    )
    assert scene.visible("Show properties").count() == 1
    scene.open("joints", "servo_0", "base")
    assert scene.until(lambda: scene.visible("Show properties").count() == 3)  # the scene, servo 0, its base
    scene.visible("Show properties").last.click()
    scene.field("translation").wait_for(state="visible")
    link = scene.page.page.get_by_text("open in VS Code").get_attribute("href")
    file, _, line = link.removeprefix("vscode://file").rpartition(":")
    assert "translation" in Path(file).read_text().splitlines()[int(line) - 1]
    scene.field("translation").fill("[-0.06, 0.004, 0")
    scene.page.click("Apply changes")
    scene.page.page.get_by_text("YAML syntax").wait_for(state="visible")
    scene.field("translation").fill("[-0.06, 0.004, 0.0]")
    scene.page.click("Apply changes")
    assert scene.servo_is_at(0.004)
    assert scene.robot.get_parameter("overrides") == (
        "joints:\n- name: servo_0\n  base:\n    translation: [-0.06, 0.004, 0.0]\n"
    )
    scene.page.wait_for_node(BODY)
    assert (
        scene.field("translation").input_value() == "[-0.06, 0.004, 0.0]"
    )  # still selected, in the open tab
    scene.page.click("Forget changes")
    assert scene.servo_is_at(0.0)
    scene.visible("Forget changes").wait_for(state="detached")


def test_the_mouse_moves_the_base_of_the_chosen_servo(scene: Scene) -> None:
    scene.page.wait_for_node("/base_handle")
    start = scene.frames[-1].poses[1].position
    x, y, z = 1e3 * start.x, 1e3 * start.y, 1e3 * start.z
    for _ in range(5):  # a page that is late with a picture lets the mouse pass beside the handle
        scene.page.drag(scene.page.screen((x, y, z + 20.0)), scene.page.screen((x, y, z + 26.0)))
        scene.page.release()
        if scene.until(lambda: scene.frames[-1].poses[1].position.z > start.z + 0.003, 5.0):
            break
    moved = scene.frames[-1].poses[1].position
    assert moved.z == pytest.approx(start.z + 0.006, abs=0.003)
    assert (moved.x, moved.y) == pytest.approx((start.x, start.y), abs=1e-6)
    assert scene.robot.trigger("reset")[0]
    assert scene.until(lambda: scene.frames[-1].poses[1].position.z == start.z)


def test_a_value_that_cannot_be_is_refused_and_nothing_moves(scene: Scene) -> None:
    told = len(scene.structures)
    scene.visible("Show properties").first.click()
    scene.field("dt").fill("-1")
    scene.page.click("Apply changes")
    scene.page.page.get_by_text("dt: must be > 0 s").wait_for(state="visible")
    heard = scene.frames[-1]
    assert scene.until(lambda: scene.frames[-1] is not heard)
    assert len(scene.structures) == told


def test_a_part_is_hidden_by_its_switch(scene: Scene) -> None:
    scene.open("bodies", "silicone")
    switch = scene.page.page.get_by_role("checkbox", name="Shown", exact=True).locator("visible=true")
    assert scene.until(lambda: switch.count() == 1)
    switch.click()
    scene.page.wait_until_gone(BODY)
    switch.click()
    scene.page.wait_for_node(BODY)


def test_normals_are_drawn_and_a_saved_view_is_gone_back_to(scene: Scene, tmp_path: Path) -> None:
    scene.page.tab("View")
    scene.page.tick("Normals")
    scene.page.wait_for_node("/normals")
    scene.page.tick("Normals")
    scene.page.wait_until_gone("/normals")
    scene.page.tick("Labels")
    with scene.page.page.expect_download(timeout=60_000) as saved:
        scene.page.click("Save view")
    file = tmp_path / "view.yaml"
    saved.value.save_as(file)
    camera = scene.page.page.evaluate(CAMERA)
    view = load_scene(file).view
    assert not view.labels
    assert view.camera is not None
    x, y, z = (1e3 * each for each in view.camera.position)
    assert camera == pytest.approx([-y, z, -x], abs=0.1)  # y is up in the browser
    scene.page.drag((200.0, 300.0), (300.0, 360.0))
    scene.page.release()
    assert scene.page.page.evaluate(CAMERA) != pytest.approx(camera, abs=10.0)
    scene.page.click("Reset view")

    def back() -> bool:
        return bool(scene.page.page.evaluate(CAMERA) == pytest.approx(camera, abs=0.5))

    assert scene.until(back)
    scene.page.tick("Labels")


def test_a_scene_begins_with_what_its_view_says(scene: Scene) -> None:
    assert scene.robot.set_parameters(robot="tripod_step_3") == (True, "")  # it has no joints, but a page
    scene.page.wait_for_node("/regions/fixings")
    scene.page.tab("View")
    boxes = scene.page.page.get_by_role("checkbox", name="Boxes and spheres that select nodes", exact=True)
    assert boxes.is_checked()
    assert scene.robot.set_parameters(robot="gripper_step_4") == (True, "")
    scene.page.wait_for_node("/collisions/tip_walls_1")
    scene.page.tab("View")
    scene.page.tick("Boxes of the contact search")
    scene.page.wait_for_node("/search_boxes")
    scene.page.tick("Collision surfaces")
    scene.page.wait_until_gone("/collisions/tip_walls_1")
