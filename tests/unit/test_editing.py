"""Editing a scene's file: comments stay, undo gives the same bytes, what is no scene changes nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from softsim_core import load_scene
from softsim_core.base import Box, ConfigError, SoftSimError, Sphere
from softsim_core.physics.mechanics import FIXED
from softsim_core.scene import RobotDescription
from softsim_core.scene.editing import (
    Edit,
    Put,
    Remove,
    RestShapes,
    SceneDocument,
    add_attachment,
    add_cable,
    add_chamber,
    add_collision,
    add_mass,
    apply_edits,
    chosen_by,
    regions_of,
    remove,
    reshape_region,
    route,
    routed_points,
)
from softsim_core.scene.io import Item, config_file, known_scenes, parse_yaml, unstructure_scene
from softsim_core.simulation import Simulation

MESH = config_file("meshes/finger_coarse.vtk")
SCENE = f"""\
# A finger of silicone.   Two spaces  stay, and so does this remark.
name: finger
dt:   0.010   # three digits
gravity: [ 0.0, 0.0,
           -9.81 ]  # on two lines

bodies:
  - name: part
    mesh: {{file: {MESH}}}  # the mesh
    # GUESS: the material
    material: {{young_modulus: 1.8e+6, poisson_ratio: 0.45}}
    density: 1070  # kg/m^3

attachments:
  # held at its base
  - {{name: base, body: part, to: world, box: {{center: [0.0075, 0.0, 0.0025], size: [0.020, 0.004, 0.020]}}}}

  # the tip is free
  - name: tip   # its name
    body: part
    to: free
    box: {{center: [0.0075, -0.1035, 0.0075], size: [0.020, 0.002, 0.020]}}
effector: "tip"
# what comes last
poses: {{start: [], 'bent': []}}
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "finger.yaml"
    path.write_text(SCENE)
    return path


def document(file: Path) -> SceneDocument:
    return SceneDocument(file, file.read_text())


def remarks(text: str) -> list[str]:
    return [line.partition("#")[2] for line in text.splitlines() if "#" in line]


def changed_lines(before: str, after: str) -> tuple[list[str], list[str]]:
    old, new = before.splitlines(), after.splitlines()
    return [line for line in old if line not in new], [line for line in new if line not in old]


def test_a_value_changes_its_line_alone(file: Path) -> None:
    edited_one = document(file)
    edited_one.change([Put(("bodies", Item("part"), "material", "young_modulus"), 2.0e5)])
    assert changed_lines(SCENE, edited_one.text) == (
        ["    material: {young_modulus: 1.8e+6, poisson_ratio: 0.45}"],
        ["    material: {young_modulus: 200000.0, poisson_ratio: 0.45}"],
    )
    assert edited_one.robot.scene.bodies[0].material.young_modulus == 2.0e5
    assert file.read_text() == SCENE  # nothing is written


def test_what_is_taken_out_leaves_the_remarks_on_its_neighbours(file: Path) -> None:
    text = apply_edits(SCENE, [Remove(("attachments", Item("base")))], file)
    assert changed_lines(SCENE, text)[1] == []
    assert "  # the tip is free\n  - name: tip   # its name" in text
    text = apply_edits(SCENE, [Remove(("attachments", Item("tip"))), Remove(("effector",))], file)
    assert "# what comes last\nposes: {start: [], 'bent': []}\n" in text


def test_what_is_added_stands_in_its_list_before_the_remarks_on_what_follows(file: Path) -> None:
    text = SCENE.replace('effector: "tip"\n', "").replace("poses:", "keys: {}\nposes:")
    item = {
        "name": "end",
        "body": "part",
        "to": "world",
        "sphere": {"center": [0.0, 0.0, 1e-5], "radius": 0.1},
    }
    after = apply_edits(text, [Put(("attachments", Item("end")), item)], file)
    assert remarks(after) == remarks(text)
    assert after.index("name: end") < after.index("# what comes last") < after.index("keys:")
    assert "1.0e-05" in after  # as YAML 1.1 reads a number


def test_a_file_that_extends_another_one_gets_only_what_differs(tmp_path: Path) -> None:
    base = config_file("scenes/cable_finger.yaml")
    file = tmp_path / "mine.yaml"
    file.write_text(f"# mine\nextends: {base}\nname: cable_finger\n")
    mine = document(file)
    mine.change([Put(("bodies", Item("finger"), "material", "young_modulus"), 1.0e6)])
    assert mine.text.startswith("# mine\nextends:")
    assert len(mine.text.splitlines()) < 9
    assert mine.robot.scene.bodies[0].material.values == {"young_modulus": 1.0e6, "poisson_ratio": 0.45}
    with pytest.raises(ConfigError, match="not written in this file"):
        mine.change([Remove(("attachments", Item("base")))])


@pytest.mark.parametrize(
    ("edit", "sentence"),
    [
        (Put(("name",), "other"), "is nothing that edits change"),
        (Put(("extends",), "/etc/passwd"), "is nothing that edits change"),
        (Put((), 3), "is nothing that edits change"),
        (Put(("bodies", Item("part"), "density"), -1.0), "density: must be > 0"),
        (Put(("bodies", Item("part"), "densty"), 1.0), "did you mean density"),
        (Put(("gravity", "x"), 1.0), "no mapping"),
        (Put(("gravity", Item("x")), 1.0), "no list of items|name|must be"),
        (Remove(("bodies", Item("none"))), "not written in this file"),
        (Remove(("attachments", Item("tip"))), "effector"),
        (Put(("dt",), float("nan")), "dt: is no value"),
        (Put(("dt",), object()), "dt: is no value"),
        (Put(("attachments", Item("tip"), "body"), "nobody"), "unknown body 'nobody'"),
    ],
)
def test_what_makes_no_scene_is_refused_and_changes_nothing(file: Path, edit: Edit, sentence: str) -> None:
    one = document(file)
    with pytest.raises(SoftSimError, match=sentence):
        one.change([Put(("dt",), 0.005), edit])
    assert (one.text, one.undoable, one.is_changed) == (SCENE, 0, False)


@pytest.mark.parametrize(
    "name", ["no", "on", "12", "1e3", "1.0e+3", "~", "null", "2026-11-23", "", "a: b", "#x", "- y"]
)
def test_names_that_yaml_takes_for_something_else_are_quoted(file: Path, name: str) -> None:
    item = {"name": name, "body": "part", "to": "world", "sphere": {"center": [0, 0, 0], "radius": 1.0}}
    one = document(file)
    one.change([Put(("attachments", Item(name)), item), Put(("poses", name or "x"), [])])
    assert one.robot.scene.attachments[-1].name == name
    assert (name or "x") in one.robot.poses


ALIASES = """\
# legs that share what they are made of
bodies:
  - name: a
    material: &m {young_modulus: 1.0e+6, poisson_ratio: 0.4}  # of both
    colour: &c [0.1, 0.2, 0.3, 1.0]
  - name: b
    material: *m
    colour: *c
  - {<<: &whole {density: 1.0, material: *m}, name: c}
"""


@pytest.mark.parametrize("name", ["a", "b", "c"])
def test_what_an_alias_shares_is_changed_in_one_place(name: str) -> None:
    before = parse_yaml(ALIASES, MESH)
    text = apply_edits(ALIASES, [Put(("bodies", Item(name), "material", "young_modulus"), 3.0e6)], MESH)
    after = parse_yaml(text, MESH)
    for old, new in zip(before["bodies"], after["bodies"], strict=True):
        young = 3.0e6 if old["name"] == name else 1.0e6
        assert new == {**old, "material": {"young_modulus": young, "poisson_ratio": 0.4}}
    assert text.startswith("# legs that share what they are made of\n")
    assert "*c" in text


def test_a_stroke_is_undone_at_once_and_redo_ends_with_a_new_change(file: Path) -> None:
    one = document(file)
    for value in (0.011, 0.012, 0.013):
        one.change([Put(("dt",), value)], "drag 1")
    one.change([Put(("dt",), 0.014)], "drag 2")
    assert (one.undoable, one.robot.scene.dt) == (2, 0.014)
    assert one.undo()
    assert one.robot.scene.dt == 0.013
    assert one.undo()
    assert (one.text, one.undo()) == (SCENE, False)
    assert one.redo()
    assert (one.robot.scene.dt, one.redoable) == (0.013, 1)
    one.change([Put(("dt",), 0.02)], "drag 1")
    assert (one.redoable, one.redo(), one.undoable) == (0, False, 2)


@pytest.mark.parametrize("name", ["inflated_cube", "cable_finger"])
def test_a_joint_goes_with_its_keys_and_its_place_in_every_pose(name: str) -> None:
    file = known_scenes()[name]
    one = SceneDocument(file, file.read_text())
    (joint,) = one.robot.joint_names
    one.change(remove(one.robot, f"joints/{joint}"))
    assert one.robot.joints == ()
    assert set(one.robot.poses.values()) == {()}
    assert not [key for key in one.robot.keys.values() if key.joints]
    assert one.undo()
    assert one.text == file.read_text()


def test_a_mass_on_no_body_is_refused(file: Path) -> None:
    with pytest.raises(SoftSimError, match="unknown body 'x'"):
        add_mass(document(file).robot, "x", Sphere(center=(0.0, 0.0, 0.0), radius=0.01), 0.01)


# --- properties ------------------------------------------------------------------------------------------


def draw_edits(one: SceneDocument, rng: np.random.Generator) -> list[Edit]:
    """A random edit as the page makes them; it may be refused."""
    robot = one.robot
    places = rng.uniform(-0.05, 0.05, (3, 3)).round(4).tolist()
    box, sphere = (
        Box(center=tuple(places[0]), size=(0.01, 0.02, 0.03)),
        Sphere(center=tuple(places[1]), radius=0.01),
    )
    regions = list(regions_of(robot.scene).values())
    cables = [joint.name for joint in robot.joints]
    parts = [region.part for region in regions] + [f"joints/{name}" for name in cables]
    body = robot.scene.bodies[0].name
    kind = int(rng.integers(9))
    if kind == 0:
        return list(add_attachment(robot, body, box if rng.random() < 0.5 else sphere, "world")[1])
    if kind == 1:
        return list(add_attachment(robot, body, sphere, "free")[1])
    if kind == 2:
        return list(add_cable(robot, body, tuple(places[0]), [tuple(each) for each in places[1:]], 0.01)[1])
    if kind == 3:
        return list(add_collision(robot, body, box)[1])
    if kind == 4:
        return list(add_mass(robot, body, sphere, 0.01)[1])
    if kind == 5 and regions:
        region = regions[int(rng.integers(len(regions)))]
        return [reshape_region(robot.scene, region, region.at(np.array(places[2])))]
    if kind == 6 and cables:
        name = cables[int(rng.integers(len(cables)))]
        return list(route(robot, name, [*routed_points(robot, name), tuple(places[0])]))
    if kind == 7 and parts:
        return list(remove(robot, parts[int(rng.integers(len(parts)))]))
    return [Put(("bodies", Item(body), "material", "young_modulus"), float(rng.integers(1, 9)) * 1e5)]


@settings(max_examples=12, deadline=None, derandomize=True)
@given(st.integers(0, 10**6))
@pytest.mark.slow
def test_undoing_all_gives_the_same_bytes_and_saving_the_same_scene(seed: int) -> None:
    rng = np.random.default_rng(seed)
    one = SceneDocument(MESH.with_name("finger.yaml"), SCENE)
    for _ in range(12):
        before = one.text
        try:
            one.change(draw_edits(one, rng))
        except SoftSimError:  # such as the effector's region taken out
            assert one.text == before
    made = unstructure_scene(one.robot)
    again = SceneDocument(one.file, one.text)
    assert unstructure_scene(again.robot) == made
    final = one.text
    there = {each.name for each in one.robot.scene.attachments}
    about = {"  # held at its base": "base", "  # the tip is free": "tip"}
    lost = [line for line in SCENE.splitlines() if line.strip().startswith("#") and line not in final]
    assert [line for line in lost if about.get(line) not in {"base", "tip"} - there] == []
    while one.undo():
        pass
    assert one.text == SCENE
    while one.redo():
        pass
    assert one.text == final


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name, path in known_scenes().items() if path.suffix == ".yaml"])
def test_every_shipped_file_takes_an_edit_with_one_line_and_gives_it_back(name: str) -> None:
    file = known_scenes()[name]
    text = file.read_text()
    after = apply_edits(text, [Put(("gravity",), [0.0, 0.0, -1.5])], file)
    gone, new = changed_lines(text, after)
    assert len(gone) <= 1
    assert [line for line in new if "-1.5" in line] == new
    assert remarks(after) == remarks(text)
    assert apply_edits(text, [], file) == text


# --- what is chosen ----------------------------------------------------------------------------------------


def by_part(robot: RobotDescription) -> dict[str, Any]:
    return {each.part: each for each in chosen_by(robot.scene, RestShapes())}


def test_regions_choose_the_nodes_that_the_simulation_holds(file: Path) -> None:
    one = document(file)
    chosen = by_part(one.robot)
    simulation = Simulation(one.robot, backend="scipy")
    model = simulation.model
    assert chosen["attachments/base"].nodes.tolist() == np.flatnonzero(model.region_of_node == FIXED).tolist()
    assert chosen["attachments/tip"].nodes.tolist() == model.regions[0].nodes.tolist()
    assert np.array_equal(chosen["attachments/tip"].points, model.rest[model.regions[0].nodes])
    assert {each.problem for each in chosen.values()} == {""}


def test_regions_that_cannot_be_say_why(file: Path) -> None:
    one = document(file)
    base = one.robot.scene.attachments[0].box
    assert base is not None
    one.change(add_attachment(one.robot, "part", base, "world")[1])
    one.change(add_attachment(one.robot, "part", Sphere(center=(9.0, 9.0, 9.0), radius=0.1), "world")[1])
    one.change(add_chamber(one.robot, "part", 1e4)[1])
    problems = {part: each.problem for part, each in by_part(one.robot).items()}
    assert (
        "nodes with attachments/base" in problems["attachments/fixed"]
        or "with base" in problems["attachments/fixed"]
    )
    assert problems["attachments/fixed_2"] == "chooses no node; move or enlarge it"
    assert "encloses no hollow" in problems["joints/chamber"]


def test_a_chamber_and_a_contact_surface_choose_the_skin_that_they_are() -> None:
    robot = load_scene("pneu_finger")
    chosen = by_part(robot)
    chambers = [joint.name for joint in robot.joints if joint.kind == "chamber"]
    assert chambers
    simulation = Simulation(robot, backend="scipy")
    for view in simulation.actuators:
        if view.name in chambers:
            corners = np.unique(np.round(view.surface.reshape(-1, 3), 9), axis=0)
            mine = np.unique(np.round(chosen[f"joints/{view.name}"].points, 9), axis=0)
            assert {tuple(row) for row in corners} <= {tuple(row) for row in mine}


def test_a_moved_region_is_where_it_was_put_whatever_frame_it_is_given_in() -> None:
    robot = load_scene("tripod")
    regions = [
        each for each in regions_of(robot.scene).values() if each.frame.rotation_deg != (0.0, 0.0, 0.0)
    ]
    for region in regions or list(regions_of(robot.scene).values()):
        place = region.center + np.array([0.001, 0.002, -0.003])
        moved = regions_of(robot.scene)[region.part]
        shape = moved.at(place)
        again = type(moved)(moved.part, moved.body, shape, moved.steps, moved.index, moved.frame)
        assert again.center == pytest.approx(place, abs=1e-12)
