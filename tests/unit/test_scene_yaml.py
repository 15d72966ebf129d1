"""YAML scenes: the whole description, one sentence for every mistake, extends, paths, round trip."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings, strategies as st

from softsim_core.base import Box, ConfigError, MeshFile, Placement, Sphere
from softsim_core.physics.mechanics import JointLimits
from softsim_core.scene import (
    AttachmentDescription,
    BodyDescription,
    JointDescription,
    MaterialDescription,
    RobotDescription,
    SceneDescription,
    SolverSettings,
    ViewSettings,
    load_scene,
    load_yaml,
)
from softsim_core.scene.io import (
    SourcedMapping,
    key_path,
    read_overrides,
    read_yaml,
    structure_scene,
    unstructure_scene,
)

MINIMAL = """\
name: block
bodies:
  - name: block
    mesh: {file: block.vtk}
    material: {young_modulus: 1000, poisson_ratio: 0.3}
    total_mass: 1
"""

Write = Callable[..., Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Write a scene file beside an (empty) mesh file; returns its path."""
    (tmp_path / "block.vtk").touch()

    def write_file(text: str, name: str = "scene.yaml") -> Path:
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
        return path

    return write_file


def refusal(path: Path, **options: Any) -> ConfigError:
    with pytest.raises(ConfigError) as caught:
        load_yaml(path, **options)
    assert "\n" not in str(caught.value)
    return caught.value


def test_minimal_scene_has_the_defaults(write: Write, tmp_path: Path) -> None:
    scene = load_yaml(write(MINIMAL))
    assert scene == RobotDescription(
        scene=SceneDescription(
            name="block",
            bodies=(
                BodyDescription(
                    name="block",
                    mesh=MeshFile(file=tmp_path / "block.vtk"),
                    material=MaterialDescription(young_modulus=1000.0, poisson_ratio=0.3),
                    total_mass=1.0,
                ),
            ),
        ),
        source=tmp_path / "scene.yaml",
    )
    assert isinstance(scene.scene.bodies[0].total_mass, float)


def test_the_tripod_has_the_documented_values() -> None:
    robot = load_scene("tripod", kind="robots")
    assert robot.joint_names == ("servo_0", "servo_1", "servo_2")
    assert {joint.limits for joint in robot.joints} == {JointLimits(-2.0225, -0.0255, 3.5, 35.0)}
    assert robot.poses["mid"] == pytest.approx((-3.14 / 3,) * 3)
    assert robot.board is not None
    assert [servo.joint for servo in robot.board.servos] == list(robot.joint_names)
    assert robot.scene.effector == "centre"
    assert all(
        isinstance(body.mesh, MeshFile) and body.mesh.file.is_absolute() for body in robot.scene.bodies
    )


@pytest.mark.parametrize("level", ["mid", "high"])
def test_finer_tripods_differ_in_their_meshes_only(level: str) -> None:
    low, fine = load_scene("tripod"), load_scene(f"tripod_{level}")
    body, mesh = fine.scene.bodies[0], fine.scene.bodies[0].mesh
    assert isinstance(mesh, MeshFile)
    assert mesh.file.name == f"tripod_{level}.vtk"
    assert mesh.placement == low.scene.bodies[0].mesh.placement  # type: ignore[union-attr]
    assert (fine.joints, fine.scene.attachments, fine.keys) == (low.joints, low.scene.attachments, low.keys)
    assert (body.material, body.total_mass) == (low.scene.bodies[0].material, low.scene.bodies[0].total_mass)


@pytest.mark.parametrize(
    ("change", "key", "words"),
    [
        ("dt: soon", "dt", ["number", "'soon'"]),
        ("dt: 1e-3", "dt", ["'1e-3'", "write 0.001"]),
        ("dt: 1e20", "dt", ["'1e20'", "write 1.0e+20"]),
        ("dt: true", "dt", ["number", "True"]),
        ("dt: .nan", "dt", ["number", "nan"]),
        ("dt: 0", "dt", ["> 0 s", "not 0.0"]),
        ("dt:", "dt", ["number", "empty"]),
        ("dt: [0.1]", "dt", ["number", "[0.1]"]),
        ("gravity: [0, 0]", "gravity", ["3 numbers"]),
        ("gravity: [0, 0, down]", "gravity[2]", ["number", "'down'"]),
        ("gravity: 0 0 -9.81", "gravity", ["3 numbers"]),
        ("gravity: [0, 0, .inf]", "gravity", ["finite"]),
        ("name: 7", "name", ["text", "quote"]),
        ("solver: {backend: cuda}", "solver.backend", ["auto, numba, scipy", "'cuda'"]),
        ("solver: fast", "solver", ["mapping", "rotation, backend"]),
        ("solver: {rayleigh_mass: -1}", "solver.rayleigh_mass", [">= 0", "-1.0"]),
        ("commands: {enforce_limits: 1}", "commands.enforce_limits", ["true or false"]),
        ("board: {servos: [{joint: a}], baud_rate: 9600.5}", "board.baud_rate", ["whole number"]),
        ("board: {servos: [{joint: a, sign: true}]}", "board.servos[0].sign", ["1, -1"]),
        ("board: {servos: [{}]}", "board.servos[0].joint", ["missing"]),
        ("keys: [a]", "keys", ["mapping"]),
        ("keys: {a: {help: x, by: 1, joints: a}}", "keys.a.joints", ["a list", "'a'"]),
        ("keys: {a: {help: nothing}}", "keys.a", ["exactly one of joints, pose and action"]),
        ("gravty: [0, 0, 1]", "gravty", ["unknown key", "did you mean gravity?", "known keys: name, dt"]),
        ("controllers: []", "controllers", ["unknown key"]),
        ("source: x", "source", ["unknown key"]),
        ("effector: tip", "", ["effector", "'tip'", "known: none"]),
        ("joints: [{name: a, axis: [1, 1, 0]}]", "joints[0].axis", ["length 1"]),
        ("joints: [{name: a, limits: {lower: 1, upper: 0}}]", "joints[0].limits", ["lower <= upper"]),
        ("joints: [{name: a}, {name: a}]", "", ["two", "joint", "a"]),
        ("start: {pose: up}", "", ["pose", "'up'"]),
    ],
)
def test_every_mistake_is_one_sentence_with_its_key(
    write: Write, change: str, key: str, words: list[str]
) -> None:
    top = change.split(":")[0]
    kept = [line for line in MINIMAL.splitlines() if not line.startswith(f"{top}:")]
    path = write("\n".join([*kept, change]))
    error = refusal(path)
    assert error.file == str(path)
    assert error.key == key
    for word in words:
        assert word in error.problem


@pytest.mark.parametrize(
    ("old", "new", "key", "words"),
    [
        ("young_modulus: 1000", "young_modulus: -5", "bodies[0].material.young_modulus", ["> 0 Pa", "-5.0"]),
        ("poisson_ratio: 0.3", "poisson_ratio: 0.5", "bodies[0].material.poisson_ratio", ["0.5"]),
        ("young_modulus: 1000, ", "", "bodies[0].material.young_modulus", ["missing"]),
        (
            "young_modulus: 1000",
            "law: rubber, young_modulus: 1000",
            "bodies[0].material.law",
            ["unknown material law 'rubber'", "known: corotational, corotational_qr, stable_neo_hookean"],
        ),
        (
            "poisson_ratio: 0.3",
            "poison_ratio: 0.3",
            "bodies[0].material.poison_ratio",
            ["did you mean poisson"],
        ),
        (
            "poisson_ratio: 0.3",
            "bend_1_factor: 2.0",
            "bodies[0].material.bend_1_factor",
            ["no parameter of the law corotational, but of rod; set `law`"],
        ),
        (
            "{file: block.vtk}",
            "{file: blok.vtk}",
            "bodies[0].mesh.file",
            ["no such mesh file", "blok.vtk", "relative to"],
        ),
        ("{file: block.vtk}", "block.vtk", "bodies[0].mesh", ["mapping", "file, placement"]),
        ("{file: block.vtk}", "{file: ''}", "bodies[0].mesh.file", ["file path"]),
        (
            "{file: block.vtk}",
            "{file: block.vtk, placement: {scale: 0}}",
            "bodies[0].mesh.placement.scale",
            ["> 0"],
        ),
        ("bodies:", "bodies: 3 #", "bodies", ["a list"]),
    ],
)
def test_mistakes_deep_inside(write: Write, old: str, new: str, key: str, words: list[str]) -> None:
    text = MINIMAL.replace(old, new)
    if new.endswith("#"):
        text = "name: block\nbodies: 3\n"
    error = refusal(write(text))
    assert error.key == key
    for word in words:
        assert word in error.problem


@pytest.mark.parametrize(
    ("text", "key", "words"),
    [
        ("name: a\nname: b\n", "name", ["twice", "line 2"]),
        ("name: a\nsolver: {backend: auto, backend: numba}\n", "solver.backend", ["twice"]),
        ("name: a\n1: b\n", "", ["'1'", "quote"]),
        ("name: a\nkeys: {on: {help: x}}\n", "keys.on", ["exactly one of"]),  # the bare word is a key
        ("name: [a\n", "line 2, column 1", ["YAML syntax"]),
        ("name: 'a\n", "line 2, column 1", ["YAML syntax"]),
        ("name: !!python/object:os.system {}\n", "name", ["tag", "not allowed"]),
        ("name: !!python/name:os.system ''\n", "line 1, column 7", ["YAML syntax"]),
        ("- a\n", "", ["top level"]),
        ("", "", ["top level"]),
        ("name: &a {x: *a}\n", "name.x", ["alias"]),
        ("name: a\ndt: 2026-13-45\n", "dt", ["quote"]),
        ("name: a\nsolver: {<<: 3}\n", "solver.<<", ["mapping"]),
        ("a: \x01", "", ["YAML syntax"]),
    ],
)
def test_yaml_mistakes(write: Write, text: str, key: str, words: list[str]) -> None:
    error = refusal(write(text))
    assert error.key == key
    for word in words:
        assert word in error.problem


def test_unreadable_files(tmp_path: Path) -> None:
    assert "cannot be read" in refusal(tmp_path / "absent.yaml").problem
    (tmp_path / "latin.yaml").write_bytes(b"name: \xe9\n")
    assert "UTF-8" in refusal(tmp_path / "latin.yaml").problem


def test_anchors_and_merge_keys(write: Write) -> None:
    scene = load_yaml(
        write(
            """
name: merge
joints:
  - &one {name: one, axis: [0, 1, 0], limits: &l {lower: -1, upper: 1}}
  - {<<: *one, name: two, limits: {<<: *l, upper: 2}}
  - {name: three, <<: [{rest: 0.5, horn_length: 0.1}, {rest: 0.7, axis: [1, 0, 0]}]}
"""
        )
    )
    one, two, three = scene.joints
    assert two == JointDescription(name="two", axis=one.axis, limits=JointLimits(-1.0, 2.0))
    assert three == JointDescription(name="three", axis=(1.0, 0.0, 0.0), rest=0.5, horn_length=0.1)


def test_extends_merges_mappings_and_named_lists(write: Write, tmp_path: Path) -> None:
    write(
        """
name: base
solver: {rotation: qr, rayleigh_mass: 1}
gravity: [0, 0, -1]
joints: [{name: a, rest: 1}, {name: b, rest: 2}]
poses: {up: [1, 1]}
board: {servos: [{joint: a}]}
""",
        "base.yaml",
    )
    child = write(
        """
extends: base.yaml
solver: {rayleigh_mass: 2}
gravity: [0, 0, 0]
joints: [{name: c}, {name: a, rest: 3}]
poses: {up: [0, 0, 0], down: [1, 2, 3]}
board: null
""",
        "child.yaml",
    )
    scene = load_yaml(child)
    assert (scene.name, scene.scene.gravity, scene.board) == ("base", (0.0, 0.0, 0.0), None)
    assert scene.scene.solver == SolverSettings(rotation="qr", rayleigh_mass=2.0)
    assert [(joint.name, joint.rest) for joint in scene.joints] == [("a", 3.0), ("b", 2.0), ("c", 0.0)]
    assert scene.poses == {"up": (0.0, 0.0, 0.0), "down": (1.0, 2.0, 3.0)}
    assert scene.source == child


def test_extended_paths_and_mistakes_belong_to_the_file_that_wrote_them(write: Write, tmp_path: Path) -> None:
    base = write(MINIMAL)
    write("extends: ../scene.yaml\nbodies: [{name: block, total_mass: 2}]\n", "below/child.yaml")
    grandchild = write("extends: child.yaml\nname: deep\n", "below/grandchild.yaml")
    scene = load_yaml(grandchild)
    assert scene.scene.bodies[0].mesh.file == tmp_path / "block.vtk"  # type: ignore[union-attr]
    assert scene.scene.bodies[0].total_mass == 2.0
    base.write_text(MINIMAL.replace("young_modulus: 1000", "young_modulus: x"))
    error = refusal(grandchild)
    assert (Path(error.file).name, error.key) == ("scene.yaml", "bodies[0].material.young_modulus")
    wrong = write("extends: child.yaml\nbodies: [{name: block, total_mass: x}]\n", "below/wrong.yaml")
    base.write_text(MINIMAL)
    assert refusal(wrong).file == str(wrong)


def test_extends_mistakes(write: Write) -> None:
    one = write("extends: two.yaml\nname: a\n", "one.yaml")
    write("extends: one.yaml\n", "two.yaml")
    assert "circle" in refusal(one).problem
    assert "no such file" in refusal(write("extends: gone.yaml\n")).problem
    assert "must name a YAML file" in refusal(write("extends: [a]\n")).problem
    write("name: a\njoints: [{name: a}, {name: b}]\n", "base.yaml")
    error = refusal(write("extends: base.yaml\njoints: [{name: a}, {name: a}]\n"))
    assert error.key == "joints[1]"
    assert "second item is named a" in error.problem


def test_overrides_are_laid_over_and_named_in_mistakes(write: Write) -> None:
    path = write(MINIMAL)
    override = {"dt": 0.002, "bodies": [{"name": "block", "total_mass": 3}]}
    scene = load_yaml(path, override)
    assert (scene.scene.dt, scene.scene.bodies[0].total_mass) == (0.002, 3.0)
    error = refusal(path, overrides={"solver": {"backend": "x"}})
    assert (error.file, error.key) == ("overrides of scene.yaml", "solver.backend")


def test_a_missing_package_is_one_sentence(write: Write, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "yaml", None)
    problem = refusal(write(MINIMAL)).problem
    assert "pip install" in problem
    assert "apt install python3-" in problem


def test_key_path() -> None:
    assert key_path(("bodies", 0, "material", "young_modulus")) == "bodies[0].material.young_modulus"


# Round trip: every description survives being written as YAML and read again.

names = st.from_regex(r"[a-z][a-z0-9_]{0,8}", fullmatch=True)
numbers = st.floats(-1.0e6, 1.0e6)
positive = st.floats(1.0e-9, 1.0e9)
vectors = st.tuples(numbers, numbers, numbers)
sizes = st.tuples(positive, positive, positive)
placements = st.builds(Placement, scale=positive, rotation_deg=vectors, translation=vectors)
axes = st.sampled_from(
    [(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.6, 0.0, 0.8), (math.sqrt(0.5), math.sqrt(0.5), 0.0)]
)
limits = st.tuples(numbers, numbers, positive).map(lambda t: JointLimits(min(t[:2]), max(t[:2]), t[2]))
regions = st.one_of(
    st.builds(Box, center=vectors, size=sizes, rotation_deg=vectors).map(lambda box: {"box": box}),
    st.builds(Sphere, center=vectors, radius=positive).map(lambda sphere: {"sphere": sphere}),
)


@st.composite
def scenes(draw: st.DrawFn) -> RobotDescription:
    joint_names = draw(st.lists(names, max_size=3, unique=True))
    joints = tuple(
        JointDescription(
            name=name,
            kind=draw(st.sampled_from(["revolute", "prismatic"])),
            base=draw(placements),
            axis=draw(axes),
            limits=draw(st.just(JointLimits()) | limits),
            stiffness=draw(st.none() | positive),
        )
        for name in joint_names
    )
    bodies = (
        BodyDescription(
            name="body",
            mesh=MeshFile(file=Path(__file__), placement=draw(placements)),
            material=MaterialDescription(
                young_modulus=draw(positive), poisson_ratio=draw(st.floats(-0.99, 0.49))
            ),
            total_mass=draw(positive),
        ),
    )
    targets = st.sampled_from(["world", "free", *joint_names])
    attachments = tuple(
        AttachmentDescription(name=name, body="body", to=draw(targets), **draw(regions))
        for name in draw(st.lists(names, max_size=3, unique=True))
    )
    return RobotDescription(
        scene=SceneDescription(
            name=draw(names),
            dt=draw(positive),
            gravity=draw(vectors),
            solver=draw(st.builds(SolverSettings, rayleigh_stiffness=positive)),
            bodies=bodies,
            joints=joints,
            attachments=attachments,
        ),
        poses={"pose": tuple(draw(numbers) for _ in joints)},
        view=draw(st.builds(ViewSettings, boxes=st.booleans(), stress_top=st.none() | positive)),
    )


def plain(data: Any) -> Any:
    if isinstance(data, dict):
        return {key: plain(value) for key, value in data.items()}
    return [plain(value) for value in data] if isinstance(data, list) else data


@pytest.mark.slow
@settings(max_examples=60, deadline=None, derandomize=True)
@given(scenes())
def test_yaml_round_trip(scene: RobotDescription) -> None:
    text = yaml.safe_dump(plain(unstructure_scene(scene)))
    assert structure_scene(SourcedMapping(yaml.safe_load(text), None), "round trip") == scene


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    st.recursive(st.none() | st.booleans() | numbers | st.text(max_size=5), st.lists, max_leaves=4), st.data()
)
def test_any_wrong_value_is_a_config_error_or_a_scene(value: Any, data: st.DataObject) -> None:
    key = data.draw(
        st.sampled_from(["dt", "gravity", "solver", "joints", "poses", "keys", "start", "board", "effector"])
    )
    try:
        structure_scene(SourcedMapping({"name": "fuzz", key: value}, None), "fuzz")
    except ConfigError as error:
        if error.file != "fuzz" or not error.key.startswith(key):
            raise


def test_aliases_count_as_all_they_stand_for() -> None:
    bomb = "a0: &a0 [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
        f"a{k}: &a{k} [{', '.join(10 * [f'*a{k - 1}'])}]\n" for k in range(1, 10)
    )
    assert len(bomb) < 700
    with pytest.raises(ConfigError, match="holds more than 200000 values"):
        read_overrides(bomb)
    merges = "a0: &a0 {x: 1, y: 2}\n" + "".join(
        f"a{k}: &a{k} {{p: *a{k - 1}, q: *a{k - 1}}}\n" for k in range(1, 20)
    )
    with pytest.raises(ConfigError, match="holds more than 200000 values"):
        read_overrides(merges)
    assert read_overrides("a: &a [1, 2]\nb: [*a, *a]\n") == {"a": [1, 2], "b": [[1, 2], [1, 2]]}


@pytest.mark.parametrize("text", ["a: " + 20_000 * "[", "a: " + 20_000 * "{a: ", "- " * 20_000])
@pytest.mark.slow
def test_deep_nesting_is_refused_in_a_sentence(text: str) -> None:
    with pytest.raises(ConfigError):
        read_overrides(text)


def test_endless_text_is_refused_before_it_is_parsed() -> None:
    with pytest.raises(ConfigError, match="is longer than 4000000 characters"):
        read_overrides("#" * 4_000_001)


def test_a_file_that_is_read_again_gives_data_of_its_own(tmp_path: Path) -> None:
    file = tmp_path / "twice.yaml"
    file.write_text("a: &a {b: 1}\nc: *a\n")
    first = read_yaml(file)
    first["a"]["b"] = 2
    again = read_yaml(file)
    assert again == {"a": {"b": 1}, "c": {"b": 1}}
    assert again["a"] is again["c"]
    assert again["a"].file_of("b") == file
    file.write_text("a: {b: 3}\n")
    assert read_yaml(file) == {"a": {"b": 3}}
