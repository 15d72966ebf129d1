"""The edit mode without its page: clicks, handles and fields become the edits that were meant."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("viser")

from softsim_core.base import Box, SoftSimError, Sphere
from softsim_core.physics.mesh import box_surface
from softsim_core.scene.editing import Edit, RestShapes, SceneDocument, chosen_by, routed_points
from softsim_core.scene.io import config_file, known_scenes
from softsim_ros.messages import ChosenPoints, Proposal
from softsim_ros.nodes.viewer import (
    CHOOSE,
    CLICKS,
    ROUTE,
    EditSession,
    drag_handle,
    first_hit,
    lines_of,
    status,
)

FINGER = config_file("meshes/finger_coarse.vtk")
BARE = f"""\
name: finger
bodies:
  - name: part
    mesh: {{file: {FINGER}}}
    material: {{young_modulus: 1.8e+6, poisson_ratio: 0.45}}
    density: 1070.0
"""
BESIDE = FINGER.with_name("finger.yaml")
CORNERS = np.array([[0.0, 0.0, 0.0], [0.015, -0.105, 0.02]])


class Edited:
    """A session and the document that its edits change, as a simulator answers them."""

    def __init__(self, text: str = BARE, file: Path = BESIDE) -> None:
        self.document = SceneDocument(file, text)
        self.session = EditSession(self._change)
        self.session.is_on = True
        self.tell()

    def _change(self, edits: Sequence[Edit], stroke: str) -> None:
        self.document.change(edits, stroke)
        self.tell()

    def tell(self) -> None:
        robot = self.document.robot
        chosen = tuple(
            ChosenPoints(each.part, len(each.points), each.points, each.problem)
            for each in chosen_by(robot.scene, RestShapes())
        )
        routes = {
            joint.name: np.array(routed_points(robot, joint.name))
            for joint in robot.joints
            if joint.kind == "cable"
        }
        self.session.take(Proposal(1, robot, chosen=chosen, routes=routes))

    def click(self, what: str, *place: float) -> str:
        assert what in CLICKS
        self.session.click = what
        return self.session.press("part", np.array(place), CORNERS)

    def write(self, **texts: str) -> None:
        """Write into the fields whose labels begin so."""
        fields = {field.label.split(" ")[0].lower(): field for field in self.session.fields()}
        self.session.write([(fields[name], text) for name, text in texts.items()])


def test_clicks_build_the_finger_and_undo_takes_it_apart() -> None:
    one = Edited()
    one.click("add a fixed box", 0.0075, 0.0, 0.0025)
    assert one.session.part == "attachments/fixed"  # chosen at once
    one.write(size="[20, 4, 20]")
    one.click("add a rigid box", 0.0075, -0.1035, 0.0075)
    one.write(size="[20, 2, 20]")
    one.session.make_effector()
    assert "click where it enters" in one.click(ROUTE, 0.003, 0.0105, 0.0125)
    assert one.document.robot.joints == ()
    one.click(ROUTE, 0.003, -0.01, 0.0125)
    one.click(ROUTE, 0.003, -0.09, 0.0125)
    robot = one.document.robot
    base, tip = robot.scene.attachments
    assert base.box == Box(center=(0.0075, 0.0, 0.0025), size=(0.02, 0.004, 0.02))
    assert (base.to, tip.to, robot.scene.effector) == ("world", "free", tip.name)
    assert routed_points(robot, "cable") == [(0.003, -0.01, 0.0125), (0.003, -0.09, 0.0125)]
    assert robot.joints[0].actuator.pull_point == (0.003, 0.0105, 0.0125)
    undone = 0
    while one.document.undo():
        undone += 1
    assert (undone, one.document.text) == (7, BARE)


@pytest.mark.parametrize("what", [each for each in CLICKS if each not in (CHOOSE, ROUTE)])
def test_every_click_adds_a_part_that_can_be_removed(what: str) -> None:
    one = Edited()
    one.click(what, 0.0075, -0.05, 0.0)
    added = one.session.part
    assert added
    assert added in one.session.parts
    one.session.remove()
    assert one.session.part == ""
    assert added not in one.session.parts


def test_a_click_chooses_what_is_there() -> None:
    one = Edited()
    one.click("add a fixed box", 0.0075, 0.0, 0.0)
    one.write(size="[40, 40, 40]")
    one.click("add a mass", 0.0075, -0.01, 0.0)
    one.write(radius="4")
    one.click(ROUTE, 0.003, -0.03, 0.0125)
    one.click(ROUTE, 0.003, -0.05, 0.0125)
    one.click(ROUTE, 0.003, -0.09, 0.0125)
    text = one.document.text
    for place, part in (
        ((0.0075, 0.018, 0.0), "attachments/fixed"),
        ((0.0075, -0.012, 0.0), "bodies/part/added_masses#0"),  # the smaller one
        ((0.003, -0.0895, 0.0125), "joints/cable"),
        ((0.0075, -0.07, 0.0), "bodies/part"),
    ):
        one.click(CHOOSE, *place)
        assert one.session.part == part
    one.click(CHOOSE, 0.003, -0.0895, 0.0125)
    assert one.session.point == 1
    assert one.document.text == text


# --- handles -----------------------------------------------------------------------------------------------


def test_the_handles_of_a_box_move_it_and_a_corner_of_it() -> None:
    one = Edited()
    one.click("add a fixed box", 0.0075, 0.0, 0.0)
    before = one.session.regions["attachments/fixed"]
    assert isinstance(before.shape, Box)
    one.session.drag("centre", np.array([0.01, 0.002, 0.003]), "drag 1")
    moved = one.session.regions["attachments/fixed"]
    assert moved.center == pytest.approx([0.01, 0.002, 0.003], abs=1e-4)
    assert moved.shape.size == before.shape.size
    opposite = moved.center - 0.5 * np.array(moved.shape.size)
    one.session.drag("size", one.session.handles()["size"] + 0.004, "drag 2")
    larger = one.session.regions["attachments/fixed"]
    assert np.array(larger.shape.size) == pytest.approx(np.array(moved.shape.size) + 0.004, abs=2e-4)
    assert larger.center - 0.5 * np.array(larger.shape.size) == pytest.approx(opposite, abs=1e-6)
    assert one.document.undoable == 3


def test_a_drag_is_undone_at_once() -> None:
    one = Edited()
    one.click("add a fixed sphere", 0.0075, 0.0, 0.0)
    text = one.document.text
    for step in range(5):
        one.session.drag("size", np.array([0.0075 + 0.01 * (step + 1), 0.0, 0.0]), "drag 1")
    shape = one.session.regions["attachments/fixed"].shape
    assert isinstance(shape, Sphere)
    assert shape.radius == pytest.approx(0.05, abs=1e-4)
    assert one.document.undo()
    assert one.document.text == text


@pytest.mark.parametrize("name", ["tripod", "cable_gripper", "pneu_finger", "sensed_finger"])
def test_handles_of_shipped_scenes_are_where_a_drag_puts_them(name: str) -> None:
    file = known_scenes()[name]
    one = Edited(file.read_text(), file)
    rng = np.random.default_rng(3)
    for part, region in one.session.regions.items():
        for handle in ("centre", "size"):
            one.session.choose(part)
            wish = one.session.handles()[handle] + rng.uniform(0.0, 0.003, 3)
            shape = drag_handle(region, handle, wish)
            again = type(region)(part, region.body, shape, region.steps, region.index, region.frame)
            if handle == "centre":
                assert again.center == pytest.approx(wish, abs=1e-4)
            elif isinstance(shape, Box):
                corner = again.center + again.rotation @ (0.5 * np.array(shape.size))
                assert corner == pytest.approx(wish, abs=2e-4)
            lines = lines_of(again, shape)
            assert np.isfinite(lines).all()


def test_points_of_a_cable_move_with_their_handle_and_go() -> None:
    one = Edited()
    for x in (0.0, 0.01, 0.02, 0.03):
        one.click(ROUTE, x, -0.01, 0.01)
    session = one.session
    assert session.point_names == ("pull point", "point 1", "point 2", "point 3")
    session.point = 1
    session.drag("point", np.array([0.02, -0.05, 0.011]), "drag 1")
    assert session.route[1] == pytest.approx([0.02, -0.05, 0.011])
    session.remove_point()
    assert session.route[:, 0].tolist() == [0.01, 0.03]
    session.point = -1
    session.drag("point", np.array([0.0, 0.02, 0.01]), "drag 2")
    assert session.handles()["point"] == pytest.approx([0.0, 0.02, 0.01])
    one.write(point="[1, 2, 3]")
    assert session.handles()["point"] == pytest.approx([0.001, 0.002, 0.003])


# --- fields ----------------------------------------------------------------------------------------------


def test_material_and_mass_are_written_in_the_units_shown() -> None:
    one = Edited()
    one.session.choose("bodies/part")
    labels = {field.label: field.text for field in one.session.fields()}
    assert labels.pop("Elastomer") == ""
    assert labels == {"Young modulus [kPa]": "1800.0", "Poisson ratio": "0.45", "Density [kg/m³]": "1070.0"}
    one.write(young="250", density="1100")
    assert one.document.robot.scene.bodies[0].material.young_modulus == 250e3
    assert one.document.robot.scene.bodies[0].density == 1100.0
    assert "young_modulus: 250000.0" in one.document.text
    one.session.choose("bodies/part")
    one.write(elastomer="Dragon Skin 20")
    assert one.document.robot.scene.bodies[0].material.preset == "Dragon Skin 20"
    with pytest.raises(SoftSimError, match="Dragon Skin 21"):
        one.write(elastomer="Dragon Skin 21")
    one.click("add a mass", 0.0075, -0.1, 0.0)
    one.write(mass="25", radius="8")
    (added,) = one.document.robot.scene.bodies[0].added_masses
    assert (added.mass, added.sphere.radius) == (0.025, 0.008)


@pytest.mark.parametrize(
    "text", ["three", "[1, 2]", "[1, 2, x]", "{a: 1}", "[", "", "-1e999", "[.nan, 0, 0]"]
)
def test_what_is_no_value_is_refused_and_changes_nothing(text: str) -> None:
    one = Edited()
    one.click("add a fixed box", 0.0075, 0.0, 0.0)
    before = one.document.text
    with pytest.raises(SoftSimError):
        one.write(centre=text)
    assert one.document.text == before


MERGED = "- {<<: "  # bodies that are made of others by a merge key are edited by hand
ROBOTS = [
    name
    for name, path in known_scenes("robots").items()
    if path.suffix == ".yaml" and MERGED not in path.read_text()
]


@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.slow
def test_writing_what_a_field_shows_changes_nothing(name: str) -> None:
    file = known_scenes()[name]
    one = Edited(file.read_text(), file)
    scene = one.document.robot.scene
    assert one.session.parts
    for part in one.session.parts:
        one.session.choose(part)
        one.session.write([(field, field.text) for field in one.session.fields() if field.text])
    after = one.document.robot.scene
    assert [each.name for each in after.attachments] == [each.name for each in scene.attachments]
    for old, new in zip(scene.bodies, after.bodies, strict=True):
        assert new.material.values == pytest.approx(old.material.values, rel=1e-6)
    for old, new in zip(scene.attachments, after.attachments, strict=True):
        for key in ("box", "sphere"):
            if (shape := getattr(old, key)) is not None:
                assert getattr(new, key).center == pytest.approx(shape.center, abs=1e-6)


# --- rays ------------------------------------------------------------------------------------------------


def test_a_ray_meets_the_nearest_side_of_a_box() -> None:
    box = box_surface((1.0, 1.0, 1.0))
    points, triangles = box.points, box.triangles
    hit = first_hit(np.array([5.0, 0.1, 0.2]), np.array([-1.0, 0.0, 0.0]), points, triangles)
    assert hit == pytest.approx([0.5, 0.1, 0.2])
    assert first_hit(np.array([5.0, 3.0, 0.2]), np.array([-1.0, 0.0, 0.0]), points, triangles) is None
    assert first_hit(np.array([5.0, 0.1, 0.2]), np.array([1.0, 0.0, 0.0]), points, triangles) is None


def test_the_status_says_what_is_wrong_and_where_it_is_kept() -> None:
    chosen = (ChosenPoints("attachments/<b>", 0, np.zeros((0, 3)), "chooses no node"),)
    told = Proposal(
        1, Edited().document.robot, "/x/y.yaml", "came with softsim", 1, 2, True, False, "", chosen
    )
    text = status(told)
    assert "<b title='/x/y.yaml'>y.yaml</b>: not saved, not applied" in text
    assert "came with softsim" in text
    assert "attachments/&lt;b&gt;: chooses no node" in text
    assert "<b>: " not in text
