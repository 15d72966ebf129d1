"""The page of `softsim up` in headless Chromium: what it shows, what its controls do on ROS topics."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("viser")

from browser_page import BrowserPage
from driven_page import BODY, HELD_MS, HIGH, MID, START, Driven
from geometry_msgs.msg import PoseStamped
from std_msgs.msg import String

pytestmark = [pytest.mark.ros, pytest.mark.slow]

CAMERA = "window.__viserMutable.camera.position.toArray()"
SPEAKING_SCENE = """
from softsim_core.robots import servo

def create_scene(scene):
    scene.name = "tripod"
    scene.add(servo("wheel"))

    @scene.on_key
    def say(simulation, key):
        print(f"{key} was pressed")
"""


def test_the_page_asks_nobody_else(driven: Driven, station: tuple[Any, str]) -> None:
    root = station[1].split("?")[0]
    own = (root, f"blob:{root}", "data:")
    assert driven.page.requests[0] == station[1]
    assert [url for url in driven.page.requests if not url.startswith(own)] == []
    assert driven.page.errors == []


def test_the_body_on_the_screen_moves_when_a_command_arrives(driven: Driven) -> None:
    before = driven.page.vertices(BODY)
    assert len(before) > 1000
    driven.robot.command([HIGH, START, MID])
    assert driven.joints_at(HIGH, START, MID)

    def moved() -> bool:
        now = driven.page.vertices(BODY)  # none while the body is made anew
        return len(now) == len(before) and max(map(abs, np.subtract(before, now))) > 5.0

    assert driven.until(moved)


def test_a_phone_has_the_panel_over_its_whole_width_and_the_tabs_in_one_row(
    driven: Driven, browser: Any, station: tuple[Any, str]
) -> None:
    page = BrowserPage(browser, station[1], width=360, height=740)
    try:
        page.wait_for_node(BODY)
        tabs = page.page.get_by_role("tab")
        tabs.last.wait_for(state="visible")
        look = "tabs => tabs.map(tab => tab.getBoundingClientRect().toJSON())"
        boxes: list[dict[str, float]] = []

        def panel_rests() -> bool:
            """Whether no tab has moved since the last look: the panel grows as its rows come in."""
            before, boxes[:] = list(boxes), tabs.evaluate_all(look)  # all at one moment
            return before == boxes and len(boxes) == 8

        assert driven.until(panel_rests), boxes
        assert len({box["y"] for box in boxes}) == 1
        assert boxes[0]["x"] < 10.0
        assert 350.0 < boxes[-1]["x"] + boxes[-1]["width"] <= 360.0
        assert page.page.get_by_role("button", name="E-STOP").bounding_box()["width"] > 300.0
    finally:
        page.close()


def test_the_picture_shows_the_robot_and_follows_it(
    driven: Driven, browser: Any, station: tuple[Any, str]
) -> None:
    import imageio.v3 as imageio

    page = BrowserPage(browser, station[1], width=900, height=360, draws=True)
    try:
        page.wait_for_node(BODY)

        def arm() -> Any:
            """Colours (h, w, 3) of the part of the page where the body lies in its low pose."""
            around = np.array([page.screen(tuple(point)) for point in outline])
            (left, top), (right, bottom) = around.min(axis=0), around.max(axis=0)
            clip = {"x": left, "y": top, "width": right - left, "height": bottom - top}
            return imageio.imread(page.page.screenshot(clip=clip))[..., :3].astype(float)

        driven.robot.command([START, START, START])
        assert driven.joints_at(START, START, START)
        outline = np.array(page.vertices(BODY)).reshape(-1, 3)[::20]
        page.await_frames()
        low = arm()
        driven.robot.command([HIGH, HIGH, HIGH])
        assert driven.joints_at(HIGH, HIGH, HIGH)

        def changed() -> bool:
            page.await_frames()
            return float((np.abs(arm() - low).max(axis=2) > 20.0).mean()) > 0.05

        assert low.std() > 10.0  # not one colour
        assert driven.until(changed)
    finally:
        page.close()
        driven.to_start()


def test_every_key_acts_with_ctrl_and_leaves_the_camera(driven: Driven) -> None:
    page = driven.page
    position = "window.__viserMutable.camera.position.toArray()"
    driven.to_mid()
    camera = page.page.evaluate(position)
    at = [MID, MID, MID]
    for keys, joint, step in (
        ("Control+ArrowUp", 0, 0.1),
        ("Control+ArrowDown", 0, -0.1),
        ("Control+ArrowLeft", 1, 0.1),
        ("Control+ArrowRight", 1, -0.1),
        ("Control+Shift++", 2, 0.1),
        ("Control+-", 2, -0.1),
    ):
        before = len(driven.commands)
        at[joint] += step
        page.press(keys)
        assert driven.commanded(before, *at), keys
        assert driven.joints_at(*at), keys
    for keys, pose in (("Control+z", HIGH), ("Control+q", MID)):
        page.press(keys)
        assert driven.joints_at(pose, pose, pose), keys
    page.press("Control+a")
    assert driven.joints_at(START, START, START)
    for keys, first, second in (
        ("Control+Space", "paused", "running"),
        ("Control+b", "bridge comm", "bridge no-comm"),
        ("Control+i", "inverse on", "inverse off"),
    ):
        page.press(keys)
        assert driven.shows(first), keys
        page.page.wait_for_timeout(HELD_MS)
        page.press(keys)
        assert driven.shows(second), keys
    page.press("Control+Enter")
    page.page.get_by_text("e-stop", exact=True).wait_for(state="visible")
    page.press("Control+e")
    assert driven.shows("no e-stop")
    page.press("Control+r")
    assert driven.joints_at(0.0, 0.0, 0.0)
    assert page.page.evaluate(position) == pytest.approx(camera, abs=1e-6)


def test_sliders_command_joints_and_tune_the_material(driven: Driven) -> None:
    page = driven.page
    driven.to_mid()
    page.tab("Drive")
    page.set_number("servo_1", -1.3)
    assert driven.joints_at(MID, -1.3, MID)
    page.tab("Tune")
    for label, parameter, shown, value in (
        ("Young modulus of silicone [kPa]", "young_modulus", 500.0, 500.0e3),
        ("Poisson ratio of silicone", "poisson_ratio", 0.4, 0.4),
        ("Damping per stiffness [s]", "rayleigh_stiffness", 0.02, 0.02),
        ("Damping per mass [1/s]", "rayleigh_mass", 2.0, 2.0),
        ("Speed [× real time]", "speed", 0.5, 0.5),
    ):
        before = driven.robot.get_parameter(parameter)
        page.set_number(label, shown)
        assert driven.until(lambda p=parameter, v=value: driven.robot.get_parameter(p) == pytest.approx(v))
        assert driven.robot.set_parameters(**{parameter: before}) == (True, "")


@pytest.fixture
def inverse(driven: Driven) -> Iterator[None]:
    """Inverse control, switched on by its key in a pose where the robot does not snap through."""
    driven.to_start()  # the servos slide in
    driven.to_mid()
    driven.page.page.wait_for_timeout(HELD_MS)
    driven.page.press("Control+i")
    assert driven.shows("inverse on")
    driven.page.wait_for_node("/goal/ball")
    yield
    driven.page.page.wait_for_timeout(HELD_MS)
    driven.page.press("Control+i")
    assert driven.shows("inverse off")
    driven.page.wait_until_gone("/goal/ball")


def last_goal(driven: Driven) -> Any:
    """The pose of the goal once all have come that the page has sent."""
    driven.await_page()
    return driven.goals[-1].pose


GOAL = "window.__viserMutable.nodeRefFromName['/goal'].position.toArray()"


def drag_goal(driven: Driven, start: tuple[float, float, float], end: tuple[float, float, float]) -> Any:
    """The newest goal after a drag from and to places beside the goal's middle in mm; also that middle."""
    page, before = driven.page, len(driven.goals)
    center = page.still(GOAL)
    first, last = (tuple(c + d for c, d in zip(center, off, strict=True)) for off in (start, end))
    page.drag(page.screen(first), page.screen(last))
    page.release()
    assert driven.until(lambda: len(driven.goals) > before), (
        f"no goal came; the handle was at {center} and is at {page.page.evaluate(GOAL)}"
    )
    return last_goal(driven), center


def test_a_dragged_goal_arrives_on_its_topic_and_the_robot_follows(driven: Driven, inverse: None) -> None:
    goal, (_, _, z) = drag_goal(driven, (0.0, 0.0, 18.0), (0.0, 0.0, 14.0))
    assert 1e3 * goal.position.z == pytest.approx(z - 4.0, abs=2.0)
    poses = driven.robot.client.collect(PoseStamped, "effector_pose", 5)
    assert driven.until(lambda: poses and abs(poses[-1].pose.position.z - goal.position.z) < 5e-4)


def test_a_turned_goal_has_another_orientation(driven: Driven, inverse: None) -> None:
    radius, turn = 16.25, math.radians(15.0)  # of the handle's arcs
    start, end = (
        (radius * math.cos(angle), 0.0, radius * math.sin(angle))
        for angle in (math.pi / 4, math.pi / 4 - turn)
    )
    q = drag_goal(driven, start, end)[0].orientation
    assert 2.0 * math.asin(abs(q.y)) == pytest.approx(turn, abs=math.radians(5.0))
    assert math.hypot(q.x, q.z) < 0.2 * abs(q.y)


@pytest.fixture
def pull_mode(driven: Driven) -> Iterator[None]:
    """Drags pull, until the test ends: a page that stayed so would turn no camera and move no handle."""
    switch = "Drag pulls (as Shift + drag)"
    driven.page.tab("View")
    driven.page.tick(switch)
    yield
    driven.page.tick(switch)


def test_a_drag_with_shift_pulls_the_body(driven: Driven) -> None:
    pulls_the_body(driven, shift=True)


@pytest.mark.usefixtures("pull_mode")
def test_a_drag_pulls_the_body_where_drags_are_to_pull(driven: Driven) -> None:
    pulls_the_body(driven, shift=False)


def test_after_that_a_drag_turns_the_camera_again(driven: Driven) -> None:
    x, y = grip_of(driven)
    before, position = len(driven.wrenches), driven.page.page.evaluate(CAMERA)
    driven.page.drag((x, y + 2.0), (x + 20.0, y - 20.0))
    driven.page.release()
    driven.await_page()
    assert driven.page.page.evaluate(CAMERA) != pytest.approx(position, abs=10.0)
    assert len(driven.wrenches) == before
    driven.page.click("Reset view")


def grip_of(driven: Driven) -> tuple[float, float]:
    """Where on the screen the highest point of an arm is seen."""
    driven.to_mid()
    vertices = driven.page.vertices(BODY)
    points = list(zip(vertices[0::3], vertices[1::3], vertices[2::3], strict=True))
    arm = [point for point in points if 12.0 < math.hypot(*point[:2]) < 20.0 and point[0] > 0.0]
    return driven.page.screen(max(arm, key=lambda point: point[2]))


def pulls_the_body(driven: Driven, *, shift: bool) -> None:
    x, y = grip_of(driven)
    before = len(driven.wrenches)
    driven.page.drag((x, y + 2.0), (x, y - 60.0), shift=shift)
    assert driven.until(lambda: len(driven.wrenches) > before + 10)
    last = driven.wrenches[-1]
    driven.page.release(shift=shift)
    assert last.header.frame_id.startswith("mesh_point/")
    assert last.wrench.force.z > 0.1  # upwards, as the mouse went
    driven.await_page()
    count = len(driven.wrenches)
    driven.await_page()
    assert len(driven.wrenches) == count  # let go


def test_two_browsers_agree(driven: Driven, browser: Any, station: tuple[Any, str]) -> None:
    other = BrowserPage(browser, station[1])
    try:
        other.wait_for_node(BODY)
        driven.to_mid()
        driven.page.tab("Drive")
        driven.page.set_number("servo_0", -1.2)
        assert driven.joints_at(-1.2, MID, MID)
        assert driven.until(lambda: abs(float(other.number("servo_0").input_value()) + 1.2) < 0.01)
        other.tab("View")
        other.tick("Stress colours")
        driven.page.wait_for_node("/stress/00")
        driven.page.wait_until_gone(BODY)
        other.tick("Stress colours")
        driven.page.wait_for_node(BODY)

        def same() -> bool:
            here, there = driven.page.vertices(BODY), other.vertices(BODY)  # none: the body is not there yet
            return bool(here) and len(here) == len(there) and max(map(abs, np.subtract(here, there))) < 0.05

        assert driven.until(same)
    finally:
        other.close()


def test_what_lies_inside_can_be_switched_on(driven: Driven) -> None:
    page = driven.page
    page.tab("View")
    for words, node in (
        ("Finite elements", "/elements"),
        ("Nodes", "/nodes"),
        ("Rigid regions and fixings", "/regions/centre"),
    ):
        page.tick(words)
        page.wait_for_node(node)
        page.tick(words)
        page.wait_until_gone(node)
    page.tab("Scene")
    assert driven.shows("A scene with control, wiring and view of its robot")


def test_time_and_stages_are_told_and_the_slowest_step_is_found(driven: Driven) -> None:
    page = driven.page
    assert driven.shows("dt = 10 ms")
    page.tab("Timing")
    assert driven.shows("the last second")
    assert driven.shows("publishing")

    def looked_at() -> tuple[int, float]:
        """Number and milliseconds of the step whose tree is shown."""
        words = page.page.get_by_text(re.compile(r"step \d+, t = ")).inner_text()
        number, duration = re.search(r"step (\d+), .* ([\d.]+) ms", words).groups()
        return int(number), float(duration)

    follow = page.page.get_by_role("checkbox", name="Follow the newest step", exact=True)
    if not follow.is_checked():  # pages share it, and a test before this may have jumped
        page.tick("Follow the newest step")
    first = looked_at()[0]
    assert driven.until(lambda: looked_at()[0] > first)
    page.click("Jump to the slowest step")
    assert driven.until(lambda: not follow.is_checked())
    slowest = looked_at()
    row = int(page.number("Step shown").input_value())  # often one of the first after a reset
    page.set_number("Step shown", 3 if row != 3 else 4)
    assert driven.until(lambda: looked_at()[0] != slowest[0])
    assert looked_at()[1] <= slowest[1]
    earlier = looked_at()[0]
    page.tick("Follow the newest step")
    assert driven.until(lambda: looked_at()[0] > max(earlier, slowest[0]))


def test_another_scene_takes_its_place_and_the_tripod_comes_back(driven: Driven) -> None:
    page = driven.page
    page.tab("Scene")
    page.choose("Robot or scene", "parts/servo")
    assert driven.until(lambda: driven.robot.get_parameter("robot") == "parts/servo")
    page.wait_until_gone(BODY)
    page.tab("Scene")
    page.choose("Robot or scene", "tripod")
    assert driven.until(lambda: driven.robot.get_parameter("robot") == "tripod")
    page.wait_for_node(BODY)
    driven.to_mid()


def test_what_a_scene_prints_is_in_the_log(driven: Driven, allowed_code: Path) -> None:
    page = driven.page
    (allowed_code / "speaking.py").write_text(SPEAKING_SCENE)
    assert driven.robot.set_parameters(robot="speaking") == (True, "")
    page.wait_until_gone(BODY)
    page.tab("Log")
    driven.robot.client.publish("keys", String(data="k"))
    assert driven.shows("k was pressed")
    assert driven.shows("simulator.scene")
    assert driven.robot.set_parameters(robot="tripod") == (True, "")
    page.wait_for_node(BODY)
    driven.to_mid()
