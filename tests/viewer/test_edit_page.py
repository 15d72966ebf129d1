"""A cable finger built by mouse in the page from its bare mesh; saved and started again, it is the same."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("viser")

from browser_page import BrowserPage
from node_processes import Client
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String

from softsim_core import load_scene
from softsim_core.scene.io import config_file, write_description
from softsim_ros.messages import Proposal, read_proposal
from softsim_ros.nodes.viewer import ROUTE

pytestmark = [pytest.mark.ros, pytest.mark.slow]

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
BARE = f"""\
# My finger: nothing is known of it but its mesh.
name: finger
bodies:
  - name: part
    mesh: {{file: {config_file("meshes/finger_low.vtk")}}}  # from the CAD export
    # GUESS: the material
    material: {{young_modulus: 1.8e+6, poisson_ratio: 0.45}}
    density: 1070.0  # kg/m^3

# end of the file
gravity: [0.0, 0.0, -9.81]
"""
SIDE = 15.0
"""x of the finger's flat side in [mm], which the camera sees."""
TRIES = 6
"""The page is drawn by software and may lag: a gesture then misses its handle and changes nothing. It is made
again, as a person would do, so many times at most."""
LATE_S = 10.0
"""A gesture without a change for so long in [s] has missed."""


@lru_cache(maxsize=4)
def read(text: str) -> Proposal:
    """What a message tells; a wait asks for it again and again, and would take a core from the page."""
    return read_proposal(text)


class Editor:
    """The page of a finger that is edited, and what its simulator tells."""

    def __init__(self, page: BrowserPage, client: Client, until: Callable[..., bool]) -> None:
        self.page, self.client, self._until = page, client, until
        self.told = client.collect(String, "scene/proposal", LATCHED)
        self.structures = client.collect(String, "scene/structure", LATCHED)
        self.states = client.collect(JointState, "joint_states", 5)

    @property
    def newest(self) -> Proposal:
        return read(self.told[-1].data)

    def until(self, condition: Callable[[], Any]) -> bool:
        return self._until(condition)

    def gesture(self, make: Callable[[], None]) -> None:
        """Make a gesture of the mouse until it has changed something."""
        before = self.newest.undoable
        for _ in range(TRIES):
            make()
            if self._until(lambda: self.newest.undoable > before, LATE_S):
                return

    @property
    def history(self) -> list[tuple[int, str]]:
        """What was told: changes that can be undone, and the sentence."""
        told = [read(each.data) for each in self.told]
        return [(each.undoable, each.message) for each in told]

    def begin(self) -> None:
        self.page.wait_for_node("/bodies/part")
        self.page.tab("Edit")
        self.page.tick("Edit")
        self.page.wait_for_node("/edit/bodies/part")
        assert self.until(lambda: self.told and self.newest.robot is not None)

    def press(self, what: str, *point: float) -> Proposal:
        """Click on a point of the body in [mm]; what comes of it."""
        self.page.choose("A click on a body does", what)
        return self.click(*point)

    def click(self, *point: float, tells: bool = True) -> Proposal:
        def make() -> None:
            x, y = self.page.screen((point[0], point[1], point[2]))
            self.page.point_at((x - 40.0, y - 40.0))
            self.page.point_at((x, y))
            self.page.page.mouse.click(x, y)

        before = self.newest.undoable
        if not tells:
            make()
            self.page.page.get_by_text("the cable leaves there").first.wait_for(state="visible")
            return self.newest
        self.gesture(make)
        return self.changed(before, lambda _: True)

    def changed(self, before: int, wanted: Callable[[Proposal], bool]) -> Proposal:
        """The proposal with one more change than before that is as wanted, once the page shows it."""
        arrived = self.until(lambda: self.newest.undoable > before and wanted(self.newest))
        assert arrived, f"no such proposal came; told before: {self.history}"
        told = self.newest
        counts = f"{told.undoable} to undo, {told.redoable} to redo"
        self.page.page.get_by_text(counts).first.wait_for(state="visible")
        return told

    def drag(
        self, handle: str, axis: int, length: float, place_of: Callable[[Proposal], float]
    ) -> tuple[Proposal, Proposal]:
        """Drag an arrow of a handle along an axis, in [mm], and wait until a coordinate has followed.

        A drag is one change, and is told several times.

        Args:
            handle: Name of the handle.
            axis: Of the arrow.
            length: Of the drag.
            place_of: Gives what is dragged, in [m].

        Returns:
            The proposals before and after.
        """

        def make() -> None:
            node = f"window.__viserMutable.nodeRefFromName['/edit/{handle}']"
            start = list(self.page.still(f"{node}.position.toArray()"))
            start[axis] += 8.0 if handle == "size" else 13.0
            end = list(start)
            end[axis] += length
            self.page.drag(self.page.screen(tuple(start)), self.page.screen(tuple(end)))
            self.page.release()

        before = self.newest
        self.page.wait_for_node(f"/edit/{handle}")
        self.gesture(make)
        wanted = place_of(before) + 1e-3 * length
        return before, self.changed(before.undoable, lambda told: abs(place_of(told) - wanted) < 0.003)

    def ask(self, name: str, sentence: str) -> None:
        self.page.click(name)
        self.page.page.get_by_text(sentence).first.wait_for(state="visible")

    def runs(self) -> list[str]:
        seen = len(self.states)
        assert self.until(lambda: len(self.states) > seen + 2)
        return list(self.states[-1].name)


def box_of(told: Proposal) -> Any:
    """The box that holds the first fixed nodes."""
    assert told.robot is not None
    return told.robot.scene.attachments[0].box


@pytest.fixture
def finger(ros_domain: int, start_process: Any) -> Iterator[Client]:
    client = Client(ros_domain, "finger", start_process)
    yield client
    client.close()


def test_a_finger_is_built_by_the_mouse_saved_and_started_again(
    start_station: Callable[..., tuple[Any, str]],
    finger: Client,
    browser: Any,
    spin_until: Callable[..., bool],
    tmp_path: Path,
) -> None:
    file = tmp_path / "finger.yaml"
    file.write_text(BARE)
    station, address = start_station(str(file))
    page = BrowserPage(browser, address)
    editor = Editor(page, finger, spin_until)
    try:
        editor.begin()
        # a first try, thrown away
        assert editor.press("add a fixed box", SIDE, -50.0, 2.5).is_changed
        page.click("Discard")
        assert editor.until(lambda: not editor.newest.is_changed)
        assert editor.newest.undoable == 0
        # held at its base: a box, moved and made smaller by its handles
        editor.press("add a fixed box", SIDE, -6.0, 2.5)
        before, told = editor.drag("centre", 0, -8.0, lambda told: float(box_of(told).center[0]))
        assert box_of(told).size == box_of(before).size
        _, told = editor.drag("size", 2, 6.0, lambda told: float(box_of(told).size[2]))
        assert [each.part for each in told.chosen] == ["attachments/fixed"]
        assert told.chosen[0].count > 3
        assert len(page.vertices("/edit/chosen/0")) > 9  # the chosen nodes are seen
        # a rigid tip, which is the effector
        told = editor.press("add a rigid box", SIDE, -100.0, 2.5)
        assert told.problems == ()
        page.click("Make it the effector")
        assert editor.until(lambda: editor.newest.robot.scene.effector == "rigid")
        # a cable along the side: where it leaves, and two points
        page.choose("A click on a body does", ROUTE)
        editor.click(SIDE, -3.0, 2.5, tells=False)
        editor.click(SIDE, -30.0, 2.5)
        told = editor.click(SIDE, -80.0, 2.5)
        assert told.routes["cable"].shape == (2, 3)
        assert told.routes["cable"][:, 0] == pytest.approx([0.015, 0.015], abs=1e-3)
        _, told = editor.drag("point", 2, 4.0, lambda told: float(told.routes["cable"][1, 2]))
        assert told.problems == ()
        # what runs has not been disturbed, and the file neither
        assert editor.runs() == []
        assert file.read_text() == BARE
        # every action is undone and done again
        page.click("Undo")
        assert editor.until(lambda: editor.newest.redoable == 1)  # the whole drag has been told
        page.click("Redo")
        assert editor.until(lambda: editor.newest.redoable == 0)
        built, actions = editor.newest.robot, editor.newest.undoable
        assert built is not None
        assert actions == 8
        for left in reversed(range(actions)):  # the page merges clicks that come within 50 ms
            page.click("Undo")
            assert editor.until(lambda left=left: editor.newest.undoable == left), f"{editor.history}"
        assert not editor.newest.is_changed
        assert editor.newest.robot.scene.attachments == ()
        for done in range(1, actions + 1):
            page.click("Redo")
            assert editor.until(lambda done=done: editor.newest.undoable == done), f"{editor.history}"
        assert editor.newest.robot == built
        # applied: it runs, and obeys
        editor.ask("Apply", "applied: the scene restarts")
        assert editor.until(lambda: list(editor.states[-1].name) == ["cable"])
        finger.publish("position_controller/commands", Float64MultiArray(data=[0.004]))
        assert editor.until(lambda: editor.states[-1].effort[0] > 0.01)
        assert file.read_text() == BARE
        page.wait_for_node("/bodies/part")  # what runs is seen again
        page.wait_until_gone("/edit/bodies/part")
        page.tab("Edit")
        editor.ask("Save", "saved to ")
        saved = file.read_text()
        for line in BARE.splitlines():
            assert line in saved.splitlines()  # with all remarks, and where they stood
        assert load_scene(file).scene == built.scene
        ran = json.loads(editor.structures[-1].data)["description"]
        assert ran == write_description(load_scene(file))
        assert not page.errors
    finally:
        page.close()
    assert station.process.end() == 0
    again, address = start_station(str(file))
    page = BrowserPage(browser, address)
    try:
        page.wait_for_node("/bodies/part")
        newest = finger.collect(String, "scene/structure", LATCHED)
        assert spin_until(lambda: newest)
        assert json.loads(newest[-1].data)["description"] == ran
        states = finger.collect(JointState, "joint_states", 5)
        assert spin_until(lambda: len(states) > 5)
        assert list(states[-1].name) == ["cable"]
    finally:
        page.close()
    assert again.process.end() == 0


def test_a_shipped_scene_is_copied_not_overwritten(
    start_station: Callable[..., tuple[Any, str]], browser: Any, spin_until: Callable[..., bool]
) -> None:
    source = load_scene("cable_finger").source
    assert source is not None
    before = source.read_text()
    station, address = start_station("cable_finger")
    page = BrowserPage(browser, address)
    try:
        page.wait_for_node("/bodies/finger")
        page.tab("Edit")
        page.tick("Edit")
        page.wait_for_node("/edit/bodies/finger")
        page.page.get_by_text("came with softsim and is not overwritten").first.wait_for(state="visible")
        page.click("Save")
        page.page.get_by_text(re.compile("not saved: .*came with softsim")).first.wait_for(state="visible")
        page.click("Copy")
        page.page.get_by_text("which is edited from now on").first.wait_for(state="visible")
        copy = station.process.folder / "cable_finger.yaml"
        assert spin_until(copy.is_file)
        assert load_scene(copy).scene == load_scene(source).scene
        assert source.read_text() == before
        assert [line for line in before.splitlines() if "#" in line and line not in copy.read_text()] == []
    finally:
        page.close()
    assert station.process.end() == 0
