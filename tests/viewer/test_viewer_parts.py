"""What the page is made of: bands of stress, shapes, hotkeys, properties, tuning, pulls."""

from __future__ import annotations

import asyncio
import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("viser")

from drawn_canvas import Canvas
from geometry_msgs.msg import Point
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from softsim_core import load_scene
from softsim_core.scene import LAYERS as LAYERS_OF_A_VIEW, KeyBinding, ViewSettings
from softsim_ros.messages import TENSION
from softsim_ros.nodes.simulator import tunables as physical
from softsim_ros.nodes.viewer import (
    BANDS,
    CAMERA_FOV,
    GAMMA,
    LAYERS,
    SLACK_COLOUR,
    TENSION_COLOURS,
    BaseHandle,
    CollisionView,
    Inbox,
    InnerView,
    MarkerView,
    NormalsView,
    Pull,
    RigidView,
    TensionColours,
    bands_of,
    box_lines,
    camera_for,
    command_of,
    compact,
    floor_height,
    have_same_controls,
    hotkeys,
    joint_at,
    joint_range,
    key_label,
    key_rows,
    marker_colour,
    marker_points,
    normal_lines,
    page_keys,
    parts_of,
    readings,
    round_up,
    shrunk_faces,
    slider_label,
    slider_value,
    sphere_lines,
    tension_legend,
    tunables,
)

pytestmark = pytest.mark.ros

TRIPOD = load_scene("tripod")


def test_triangles_fall_into_bands_by_the_mean_of_their_corners() -> None:
    stress = np.array([0.0, 0.0, 0.0, 120.0, 120.0, 1000.0])
    triangles = np.array([[0, 1, 2], [0, 1, 3], [3, 4, 5], [5, 5, 5]])
    assert bands_of(stress, triangles, 120.0).tolist() == [0, 4, BANDS - 1, BANDS - 1]
    assert bands_of(stress, triangles, 0.0).tolist() == [0, 0, 0, 0]


def test_compact_keeps_the_triangles_where_they_are() -> None:
    points = np.random.default_rng(5).normal(size=(40, 3))
    triangles = np.array([[7, 3, 39], [3, 7, 20]])
    used, numbered = compact(triangles, len(points))
    assert used.tolist() == [3, 7, 20, 39]
    assert np.array_equal(points[used][numbered], points[triangles])


@pytest.mark.parametrize(("value", "top"), [(0.0, 1.0), (1.0, 1.0), (1.1, 2.0), (4.0, 5.0), (6e5, 1e6)])
def test_scales_end_at_round_numbers(value: float, top: float) -> None:
    assert round_up(value) == pytest.approx(top)


def test_wire_frames_have_the_size_of_their_regions() -> None:
    lines = box_lines((1.0, 2.0, 3.0), (2.0, 4.0, 6.0), (0.0, 0.0, 90.0))
    assert lines.shape == (12, 2, 3)
    assert lines.reshape(-1, 3).min(axis=0) == pytest.approx([-1.0, 1.0, 0.0])
    circles = sphere_lines((0.0, 0.0, 1.0), 0.5)
    assert np.linalg.norm(circles.reshape(-1, 3) - (0.0, 0.0, 1.0), axis=1) == pytest.approx(0.5)


def test_elements_shrink_about_their_centres() -> None:
    points = np.vstack([np.zeros(3), np.eye(3)])
    vertices, faces = shrunk_faces(points, np.array([[0, 1, 2, 3]]), 0.5)
    assert vertices.mean(axis=0) == pytest.approx(points.mean(axis=0))
    corner = vertices[faces]
    volume = np.einsum("ij,ij->i", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])).sum() / 6.0
    assert volume == pytest.approx(0.125 / 6.0)  # outward faces


def test_every_key_of_the_robot_has_a_hotkey_and_a_label() -> None:
    keys = page_keys(TRIPOD)
    assert set(TRIPOD.keys) <= set(keys)
    assert "x" not in keys  # quits a terminal, not a page
    assert hotkeys("up") == [("arrowup", "cmd/ctrl")]
    assert len(hotkeys("plus")) == 3
    assert key_label("plus", keys["plus"]) == "Ctrl+Plus: servo 2 up"
    rows = dict(key_rows(TRIPOD))
    assert rows["servo 1"] == {"← up": "left", "→ down": "right"}
    assert rows["poses"] == {"Q mid pose": "q", "Z high pose": "z"}
    for robot in (TRIPOD, load_scene("cable_gripper"), load_scene("emio")):
        named = [name for _, row in key_rows(robot) for name in row.values()]
        stops = [] if robot.board is None else ["enter", "e"]  # they have buttons above the tabs
        assert sorted([*named, *stops]) == sorted(page_keys(robot))  # each key once
    robot = dataclasses.replace(TRIPOD, keys={"x": KeyBinding(pose="mid", help="own")})
    assert "x" in page_keys(robot)


def test_every_part_tells_what_it_is() -> None:
    parts = parts_of(TRIPOD)
    assert "tripod/bodies/silicone/material" in parts
    assert all(part.help for part in parts.values())
    rows = {name: (value, text) for name, value, text in parts["tripod/joints/servo_0"].properties}
    assert rows["horn_length"] == ("0.025", "Length in [m] of the servo arm, for pictures only.")


def test_sliders_start_within_their_ranges() -> None:
    for tunable in tunables(TRIPOD):
        if not tunable.is_switch:
            assert tunable.lower <= tunable.start <= tunable.upper
            assert tunable.to_displayed(tunable.si(tunable.start)) == pytest.approx(tunable.start)
    young = next(t for t in tunables(TRIPOD) if t.name == "young_modulus")
    assert (young.lower, young.upper, young.si(500.0)) == (10.0, 2000.0, 500.0e3)
    for joint in TRIPOD.joints:
        lower, upper, _ = joint_range(joint)
        assert (lower, upper) == (-2.0225, -0.0255)
        assert slider_value(joint, 3.0) == upper
        assert slider_value(joint, -1.04666666) == -1.0467


def test_a_pull_is_a_spring_with_a_limit() -> None:
    points = np.zeros((3, 3), np.float32)
    pull = Pull(1, np.array([1.0, 0.0, 0.0]), np.array([11.0, 0.0, 0.0]))
    assert pull.force(points, stiffness=30.0, limit=2.0) == pytest.approx([0.3, 0.0, 0.0])
    assert pull.force(points, stiffness=1e6, limit=2.0) == pytest.approx([2.0, 0.0, 0.0])


def test_readings_escape_what_they_show() -> None:
    assert "<script>" not in readings.message_box("<script>alert(1)</script>")
    bars = readings.joint_bars(TRIPOD.joints, (-1.0, -1.0, 0.0), (-1.2, -1.0, 0.0), (0.1, 0.2, 0.3))
    assert bars.count(readings.AMBER) == 1  # one outside its limits
    assert "-1.0000 rad (-57.3 deg)" in bars
    assert "no joint states" in readings.joint_bars(TRIPOD.joints, None, None, ())
    assert readings.pressure(2500.0) == "2.5 kPa"


def marker(kind: int, name: str, points: list[tuple[float, float, float]]) -> Marker:
    made = Marker(ns=name, type=kind, color=ColorRGBA(r=1.0, a=1.0))
    made.points = [Point(x=x, y=y, z=z) for x, y, z in points]
    return made


def test_markers_are_drawn_in_millimetres_moved_and_taken_away() -> None:
    canvas = Canvas()
    view = MarkerView(canvas, "cables")
    line = marker(Marker.LINE_STRIP, "line", [(0, 0, 0), (0.01, 0, 0), (0.02, 0, 0)])
    pull = marker(Marker.SPHERE, "pull", [])
    pull.pose.position.z = 0.005
    view.update(MarkerArray(markers=[line, pull]))
    strip, dot = canvas.drawn["/cables/line_0"], canvas.drawn["/cables/pull_0"]
    assert strip.points.shape == (2, 2, 3)
    assert strip.points[1, 1].tolist() == [20.0, 0.0, 0.0]
    assert dot.position.tolist() == [0.0, 0.0, 5.0]
    assert marker_colour(line) == (255, 0, 0)
    line.points[2].x = 0.03
    view.update(MarkerArray(markers=[line]))
    assert strip.points[1, 1].tolist() == [30.0, 0.0, 0.0]
    assert dot.removed
    view.switch(False)
    assert not strip.visible
    assert marker_points(line).dtype == np.float32
    none = marker(Marker.SPHERE_LIST, "contacts", [])
    view.update(MarkerArray(markers=[none]))
    assert "/cables/contacts_0" not in canvas.drawn  # an empty list is nothing, not a point at the origin


def test_collision_surfaces_are_wire_frames_that_move_and_hide() -> None:
    canvas = Canvas()
    view = MarkerView(canvas, "collisions", part_of=lambda name, _: f"collisions/{name}", wireframe=True)
    view.switch(False)
    wall = marker(Marker.TRIANGLE_LIST, "wall", [(0, 0, 0), (0.01, 0, 0), (0, 0.01, 0)])
    view.update(MarkerArray(markers=[wall]))
    drawn = canvas.drawn["/collisions/wall_0"]
    assert drawn.wireframe
    assert not drawn.visible
    view.switch(True)
    wall.points[0].z = 0.002
    view.update(MarkerArray(markers=[wall]))
    assert drawn.visible
    view.switch(True, hidden=["collisions/wall"])
    assert not drawn.visible
    assert drawn.vertices[0].tolist() == [0.0, 0.0, 2.0]
    wall.points += wall.points
    view.update(MarkerArray(markers=[wall]))
    assert drawn.removed
    assert len(canvas.drawn["/collisions/wall_0"].vertices) == 6
    view.clear()
    assert canvas.drawn["/collisions/wall_0"].removed


def test_triangles_take_the_colour_of_each_message_and_are_seen_through_by_their_alpha() -> None:
    canvas = Canvas()
    view = MarkerView(canvas, "chambers", part_of=lambda name, _: f"joints/{name}")
    hollow = marker(Marker.TRIANGLE_LIST, "air", [(0, 0, 0), (0.01, 0, 0), (0, 0.01, 0)])
    view.update(MarkerArray(markers=[hollow]))
    drawn = canvas.drawn["/chambers/air_0"]
    assert (drawn.color, drawn.opacity, drawn.side) == ((255, 0, 0), None, "double")
    hollow.color.b = 1.0
    view.update(MarkerArray(markers=[hollow]))
    assert drawn.color == (255, 0, 255)
    view.switch(True, hidden=["joints/air"])
    assert not drawn.visible
    hollow.color.a = 0.4
    before = MarkerView(canvas, "before", offset=0.5)
    before.update(MarkerArray(markers=[hollow]))
    drawn = canvas.drawn["/before/air_0"]
    assert drawn.opacity == pytest.approx(0.4)
    np.testing.assert_allclose(drawn.vertices, [(0, 0, 0.5), (10, 0, 0.5), (0, 10, 0.5)])


def test_rigid_bodies_obey_switches_that_came_before_them() -> None:
    canvas = Canvas()
    view = RigidView(canvas)
    view.switch(True, axes=True, hidden=["rigid_bodies/ball"])
    triangle = [(0.0, 0.0, 0.0), (0.01, 0.0, 0.0), (0.0, 0.01, 0.0)]
    view.show(
        MarkerArray(markers=[marker(Marker.TRIANGLE_LIST, name, triangle) for name in ("cube", "ball")])
    )
    cube, ball = canvas.drawn["/rigid/cube"], canvas.drawn["/rigid/ball"]
    assert (cube.show_axes, ball.show_axes) == (True, False)
    assert cube.axes_length == pytest.approx(13.0)
    assert canvas.drawn["/rigid/cube/surface"].visible
    assert not canvas.drawn["/rigid/ball/surface"].visible


def test_names_of_others_are_no_paths_and_meet_nobody_in_the_tree() -> None:
    canvas, triangle = Canvas(), [(0.0, 0.0, 0.0), (0.01, 0.0, 0.0), (0.0, 0.01, 0.0)]
    bodies, cables = RigidView(canvas), MarkerView(canvas, "cables")
    for names in (["a" * 20_000] * 2, ["cube", "cube"], ["/", "../x"]):
        canvas.drawn.clear()
        markers = MarkerArray(markers=[marker(Marker.TRIANGLE_LIST, name, triangle) for name in names])
        bodies.show(markers)
        assert len(canvas.drawn) == 2 * len(names)
        cables.update(markers)
        assert all(len(name) < 100 for name in canvas.drawn)
        assert all(name.count("/") <= 3 and ".." not in name for name in canvas.drawn)


def test_collision_boxes_lie_around_what_is_not_hidden() -> None:
    canvas = Canvas()
    view = CollisionView(canvas)
    wall = marker(Marker.TRIANGLE_LIST, "wall", [(0, 0, 0), (0.01, 0, 0), (0, 0.02, 0.03)])
    ball = marker(Marker.SPHERE, "ball", [])
    ball.scale.x = 0.004
    message = MarkerArray(markers=[wall, ball])
    view.update(message)
    assert canvas.drawn == {}
    view.apply_view(ViewSettings(search_boxes=True))
    view.update(message)
    boxes = canvas.drawn["/search_boxes"].points.reshape(2, 24, 3)
    assert boxes.min(axis=1).tolist() == [[0.0, 0.0, 0.0], [-2.0, -2.0, -2.0]]
    assert boxes[0].max(axis=0) == pytest.approx([10.0, 20.0, 30.0])
    view.apply_view(ViewSettings(search_boxes=True, hidden=("collisions/wall",)))
    view.update(message)
    assert len(canvas.drawn["/search_boxes"].points) == 12
    view.apply_view(ViewSettings())
    assert canvas.drawn["/search_boxes"].removed


def test_cables_have_the_colours_of_their_tensions() -> None:
    """Of two cables, behind a joint without one: one rubs, one is slack and then tight."""
    colours, canvas = TensionColours([True, False, False]), Canvas()
    view = MarkerView(canvas, "cables")
    strips = [marker(Marker.LINE_STRIP, "line", [(0, 0, 0), (0.01, 0, 0), (0.02, 0, 0)]) for _ in "ab"]
    strips[1].id = 1
    rows = np.zeros(4, TENSION)
    rows["joint"], rows["tension"] = [1, 1, 2, 2], [7.9, 4.1, 0.0, 0.0]

    def drawn(number: int) -> list[list[int]]:
        """Colours of the segments, from the linear ones that the page takes."""
        view.update(MarkerArray(markers=strips))
        linear = canvas.drawn[f"/cables/line_{number}"].colors[:, 1]
        return np.rint(255.0 * (linear / 255.0) ** (1.0 / GAMMA)).tolist()

    def are(found: list[list[int]], *colours: tuple[int, int, int]) -> bool:
        return np.abs(np.array(found) - colours).max() <= 6

    assert are(drawn(0), (255, 0, 0), (255, 0, 0))
    view.line_colours = colours.colours
    colours.update(rows)
    assert colours.top == 10.0
    assert are(drawn(0), TENSION_COLOURS[9], TENSION_COLOURS[4])
    assert are(drawn(1), SLACK_COLOUR, SLACK_COLOUR)
    rows["tension"][2:] = -40.0  # the other one of a pair
    colours.update(rows)
    assert are(drawn(1), TENSION_COLOURS[9], TENSION_COLOURS[9])
    assert "25 N" in (scale := tension_legend(colours.top))
    assert "50 N" in scale
    rows["joint"] = 7  # of another scene
    colours.update(rows)
    assert are(drawn(0), (255, 0, 0), (255, 0, 0))


def test_normals_stand_on_their_triangles() -> None:
    points = np.array([[0, 0, 0], [3, 0, 0], [0, 3, 0]], np.float32)
    lines = normal_lines(points, np.array([[0, 1, 2], [0, 0, 1]]), 2.0)
    assert lines.tolist() == [[[1.0, 1.0, 0.0], [1.0, 1.0, 2.0]]]
    canvas = Canvas()
    view = NormalsView(canvas)
    view.update(points, np.array([[0, 1, 2]]), 0.0)
    assert canvas.drawn == {}
    view.switch(True)
    view.update(points, np.array([[0, 1, 2]]), 0.1)
    view.switch(False)
    assert canvas.drawn["/normals"].removed


def test_every_layer_of_a_view_has_its_words() -> None:
    assert set(LAYERS) == set(LAYERS_OF_A_VIEW)


def test_what_lies_inside_obeys_the_view() -> None:
    canvas = Canvas()
    inside = InnerView(canvas, TRIPOD, ["servo_0", "servo_0_horn", "centre"])
    arm, label = canvas.drawn["/frames/servo_0_horn/arm"], canvas.drawn["/frames/servo_1/label"]
    assert (arm.visible, label.visible, inside.needs_nodes) == (True, True, False)
    inside.apply_view(
        ViewSettings(labels=False, frames=True, nodes=True, node_size=0.002, hidden=("joints/servo_0",))
    )
    assert (arm.visible, label.visible, inside.needs_nodes) == (False, False, True)
    assert not canvas.drawn["/frames/servo_0_horn"].show_axes
    assert canvas.drawn["/frames/centre"].show_axes
    bodies = [{"name": "silicone", "nodes": [0, 3]}, {"name": "other", "nodes": [3, 4]}]
    inside.set_structure(np.zeros((0, 4), np.int64), bodies, [])
    inside.move_nodes(np.zeros((4, 3)))
    assert len(canvas.drawn["/nodes"].points) == 4
    assert canvas.drawn["/nodes"].point_size == pytest.approx(2.0)
    inside.apply_view(ViewSettings(nodes=True, hidden=("bodies/silicone",)))
    assert len(canvas.drawn["/nodes"].points) == 1


def test_the_handle_of_a_base_moves_it_only_when_it_is_moved() -> None:
    canvas, inbox, asked = Canvas(), Inbox(), []
    handle = BaseHandle(canvas, inbox, lambda joint, position: asked.append((joint, position.tolist())))
    handle.choose("servo_0")
    handle.follow(np.array([1.0, 2.0, 3.0]))
    arrows = canvas.drawn["/base_handle"]

    def drag(phase: str, *position: float) -> None:
        event = SimpleNamespace(target=SimpleNamespace(position=position), phase=phase)
        asyncio.run(arrows.callback(event))
        for action in inbox.take():
            action()

    drag("start", 1.0, 2.0, 3.0)
    assert asked == []
    drag("update", 1.0, 2.0, 4.0)
    handle.follow(np.array([1.0, 2.0, 3.1]))
    assert arrows.position.tolist() == [1.0, 2.0, 3.0]  # stays in the hand
    drag("end", 1.0, 2.0, 4.0)
    assert asked == [("servo_0", [1.0, 2.0, 4.0])]
    handle.choose(None)
    assert arrows.removed
    assert [joint_at(f"tripod{path}") for path in ("", "/joints", "/joints/servo_1/base")] == [
        None,
        None,
        "servo_1",
    ]


def test_the_camera_starts_where_it_sees_the_bodies() -> None:
    corners = np.array([[0.0, 0.0, 0.0], [300.0, 400.0, 0.0]], np.float32)
    position, target = camera_for(corners)
    assert target[:2] == pytest.approx((150.0, 200.0))
    assert np.linalg.norm(np.subtract(position, target)) == pytest.approx(825.0, rel=0.02)
    assert len(camera_for(corners[:0])[0]) == 3  # a scene without bodies has a view, too


@pytest.mark.parametrize("size", [(1, 1, 9), (1, 1, 1), (9, 1, 1), (5, 5, 1), (1, 9, 4)])
def test_the_camera_sees_the_whole_body(size: tuple[int, int, int]) -> None:
    corners = 10.0 * np.array(list(np.ndindex(2, 2, 2)), np.float32) * size
    position, target = np.array(camera_for(corners))
    ahead = (target - position) / np.linalg.norm(target - position)
    aside = np.cross(ahead, [0.0, 0.0, 1.0])
    above = np.cross(aside / np.linalg.norm(aside), ahead)
    seen = corners - position
    assert np.abs(np.arctan2(seen @ above, seen @ ahead)).max() < 0.5 * CAMERA_FOV


def test_a_chamber_stands_at_its_pressure_between_its_limits() -> None:
    """From -2 to 10 kPa; its position is a volume."""
    (air,) = load_scene("inflated_cube").joints
    told = readings.joint_bars((air,), (3.3e-6,), None, (7000.0,))
    assert "width:75.0%" in told
    assert "3.3e-06 m^3 (3.3 ml)" in told
    assert "+7000.0000 Pa" in told
    assert "-2.0 kPa" in told
    assert joint_range(air) == (-2000.0, 10000.0, 10.0)
    assert (slider_label(air), slider_value(air, 8123.0), command_of(air, 8000.0)) == ("air", 8123.0, 8000.0)


def test_volumes_are_commanded_and_told_in_ml() -> None:
    (air,) = load_scene("pneu_finger").joints
    assert slider_label(air) == "air [ml]"
    assert joint_range(air) == (-0.4, 1.4, 0.01)
    assert (slider_value(air, 8.0e-7), slider_value(air, 1.0)) == (0.8, 1.4)
    assert command_of(air, 0.8) == pytest.approx(8.0e-7, rel=1e-12)
    assert (command_of(air, -0.4), command_of(air, 1.4)) == (air.limits.lower, air.limits.upper)
    by_pressure = dataclasses.replace(air, actuator=dataclasses.replace(air.actuator, control="pressure"))
    finger = load_scene("pneu_finger")
    assert have_same_controls(finger, finger.with_scene(joints=(dataclasses.replace(air),)))
    assert not have_same_controls(finger, finger.with_scene(joints=(by_pressure,)))
    told = readings.joint_bars((air,), (-2.5e-21,), None, (-37.4,))  # rounding, around zero
    assert "<span>0 m^3 (0.0 ml) " in told


@pytest.mark.parametrize(("lowest", "height"), [(25.0, -20.0), (-66.0, -86.0)])
def test_the_grid_lies_below_all_bodies(lowest: float, height: float) -> None:
    points = np.array([[0.0, 0.0, 30.0], [10.0, 0.0, lowest]], np.float32)
    assert floor_height(points) == pytest.approx(height)
    assert floor_height(points[:0]) == -20.0


@pytest.mark.parametrize("scene", ["tripod", "pneu_finger", "pneu_arm", "cable_gripper"])
def test_every_parameter_of_the_physics_has_a_slider(scene: str) -> None:
    robot = load_scene(scene)
    sliders = {each.name: each for each in tunables(robot)}
    parameters = physical(robot)
    assert parameters.keys() == sliders.keys() - {"speed", "enforce_limits"}
    for name, parameter in parameters.items():
        slider = sliders[name]
        assert slider.si(slider.to_displayed(parameter.value)) == pytest.approx(parameter.value)
        low, high = parameter.about.within
        assert low <= slider.si(slider.lower) < slider.si(slider.upper) <= high


def test_layers_and_fibres_are_labelled_by_their_own_names() -> None:
    finger = load_scene("pneu_finger")
    labels = {each.name: each.label for each in tunables(finger)}
    assert labels["c1"] == "C1 of finger [kPa]"
    assert labels["stiffness_factor"] == "Factor on the stiffness of finger"
    assert labels["paper.young_modulus"] == "Young modulus of paper [MPa]"
    assert labels["paper.poisson_ratio"] == "Poisson ratio of paper"
    assert labels["thread.stiffness"] == "Stiffness in tension of thread [kPa]"
    (body,) = finger.scene.bodies
    both = finger.with_scene(bodies=(body, dataclasses.replace(body, name="thumb")))
    paper = next(each for each in tunables(both) if each.name == "thumb.paper.young_modulus")
    assert paper.label == "Young modulus of thumb.paper [MPa]"
    assert (paper.lower, paper.start, paper.upper, paper.si(500.0)) == (100.0, 1000.0, 4000.0, 500.0e6)
