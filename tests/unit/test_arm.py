"""Arms from URDF files that carry robots of the suite: what is read and refused, where everything stands."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from softsim_core import ConfigError, NotReachedError, Simulation, load_scene
from softsim_core.control.inverse import reach
from softsim_core.physics.mechanics import rotation_euler, rotation_of
from softsim_core.scene import Motion, place_scene
from softsim_core.scene.arm import read_urdf
from softsim_core.scene.io import ProgramRule, known_scenes, limited_to

pytest.importorskip("urdf_parser_py")

REPOSITORY = Path(__file__).resolve().parents[2]
ARM = REPOSITORY / "configs" / "arms" / "bench_arm.urdf"
LINK = '<link name="{}"/>'
JOINT = '<joint name="{0}" type="{1}"><parent link="{2}"/><child link="{3}"/><axis xyz="{4}"/>{5}</joint>'
LIMIT = '<limit lower="{}" upper="{}" velocity="{}" effort="1"/>'


def urdf(folder: Path, *parts: str, name: str = "robot.urdf") -> Path:
    """A URDF file of the given elements."""
    file = folder / name
    file.write_text(f'<robot name="r">{"".join(parts)}</robot>')
    return file


def joint(name: str, kind: str, parent: str, child: str, axis: str = "0 0 1", limit: str = "") -> str:
    return JOINT.format(name, kind, parent, child, axis, limit)


LINKS = "".join(LINK.format(name) for name in "abc")
GOOD = (
    LINKS,
    joint("one", "continuous", "a", "b"),
    joint("two", "prismatic", "b", "c", limit=LIMIT.format(0, 0.1, 1)),
)


def test_what_a_urdf_says_is_read(tmp_path: Path) -> None:
    rigid = read_urdf(urdf(tmp_path, *GOOD))
    assert (rigid.root, [each.name for each in rigid.joints]) == ("a", ["one", "two"])
    assert rigid.joints[0].limits.lower == -np.inf
    assert (rigid.joints[1].limits.upper, rigid.joints[1].limits.speed) == (0.1, 1.0)


@pytest.mark.parametrize(
    ("parts", "why"),
    [
        ((LINKS, joint("one", "ball", "a", "b")), "Invalid joint type: ball"),
        ((LINKS, joint("one", "fixed", "a", "b")), "its links are no tree with one root; roots: a, c"),
        ((LINKS, joint("one", "fixed", "a", "b"), joint("two", "fixed", "c", "b")), "its links are no tree"),
        ((LINKS, joint("one", "fixed", "a", "b"), joint("two", "fixed", "b", "a")), "its links are no tree"),
        ((LINKS, joint("one", "fixed", "a", "x")), "joint one: names the link 'x'; known: a, b, c"),
        ((LINKS, LINK.format("a")), "link: a is there twice"),
        (
            (*GOOD[:2], joint("two", "prismatic", "b", "c", limit=LIMIT.format(1, 0, 1))),
            "they must be an interval",
        ),
        ((*GOOD[:2], joint("two", "prismatic", "b", "c", "0 0 0", LIMIT.format(0, 1, 1))), "is no direction"),
        (("<link",), "is no URDF file"),
        ((), "must have links"),
    ],
)
def test_what_is_no_tree_of_known_joints_is_refused(tmp_path: Path, parts: tuple[str, ...], why: str) -> None:
    with pytest.raises(ConfigError, match=r".*") as refused:
        read_urdf(urdf(tmp_path, *parts))
    assert why in str(refused.value)
    assert len(str(refused.value)) < 400


def test_a_missing_and_a_huge_file_are_refused(tmp_path: Path) -> None:
    (tmp_path / "huge.urdf").write_bytes(b" " * 10_000_001)
    for name, why in (
        ("none.urdf", "cannot be read"),
        ("none.urdf.xacro", "cannot be read"),
        ("huge.urdf", "is longer than"),
    ):
        with pytest.raises(ConfigError, match=why):
            read_urdf(tmp_path / name)


XACRO = """<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:arg name="side" default="left"/>
  <xacro:include filename="$(find arm_pack)/urdf/link.xacro"/>
  <link name="root"/>
  <xacro:one parent="root" name="$(arg side)_1" length="${2 * 0.1}"/>
  <xacro:one parent="$(arg side)_1" name="$(arg side)_2" length="0.3"/>
</robot>"""
XACRO_LINK = """<robot xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:macro name="one" params="parent name length">
    <joint name="${name}_joint" type="continuous">
      <parent link="${parent}"/><child link="${name}"/><origin xyz="0 0 ${length}"/><axis xyz="0 1 0"/>
    </joint>
    <link name="${name}"/>
  </xacro:macro>
</robot>"""


def test_a_xacro_file_is_expanded_with_its_arguments_and_packages(tmp_path: Path) -> None:
    pytest.importorskip("xacro")
    folder = tmp_path / "arm_pack" / "urdf"
    folder.mkdir(parents=True)
    file = folder / "robot.urdf.xacro"
    file.write_text(XACRO)
    (folder / "link.xacro").write_text(XACRO_LINK)
    assert list(read_urdf(file).shapes) == ["root", "left_1", "left_2"]
    arm = f"{{urdf: {file}, arguments: {{side: right}}, start: {{right_1_joint: 0.5}}}}"
    robot = load_scene(scene(tmp_path, arm))
    assert robot.joint_names == ("right_1_joint", "right_2_joint")
    assert robot.joints[0].base.translation == pytest.approx((0.0, 0.0, 0.2))
    assert robot.joints[0].rest == 0.5


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (XACRO.replace("arm_pack", "no_pack"), "package no_pack is in no folder of that name and no folder"),
        (XACRO.replace("$(find arm_pack)/urdf/link", "absent"), "absent.xacro"),
        (XACRO.replace("$(find arm_pack)/urdf/link.xacro", "l.xacro").replace("0.1", "width"), "width"),
        ("<robot", "xacro cannot expand it"),
    ],
)
def test_a_xacro_file_with_a_mistake_is_one_sentence(tmp_path: Path, text: str, why: str) -> None:
    pytest.importorskip("xacro")
    (tmp_path / "l.xacro").write_text(XACRO_LINK)
    (tmp_path / "robot.xacro").write_text(text)
    with pytest.raises(ConfigError, match=r".*") as refused:
        read_urdf(tmp_path / "robot.xacro")
    assert why in str(refused.value)
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < 1000


def test_arguments_are_for_xacro_files(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"takes no arguments \(side\); only xacro files do"):
        load_scene(scene(tmp_path, f"{{urdf: {ARM}, arguments: {{side: left}}}}"))


def test_meshes_of_links_are_found_beside_the_file_and_in_its_package(tmp_path: Path) -> None:
    (tmp_path / "pack" / "urdf").mkdir(parents=True)
    (tmp_path / "pack" / "part.stl").write_bytes((REPOSITORY / "configs/parts/bellows.stl").read_bytes())
    shape = (
        '<link name="a"><collision><geometry><mesh filename="{}" scale="{}"/></geometry></collision></link>'
    )
    for name in ("../part.stl", "package://pack/part.stl"):
        rigid = read_urdf(urdf(tmp_path / "pack" / "urdf", shape.format(name, "2 2 2")))
        (only,) = rigid.shapes["a"]
        assert only.shape.mesh is not None
        assert only.shape.mesh.placement.scale == 2.0
        assert only.touches
    with pytest.raises(ConfigError, match=r"link a: names the mesh .*, which is not in"):
        read_urdf(urdf(tmp_path / "pack" / "urdf", shape.format("part.stl", "1 1 1")))
    with pytest.raises(ConfigError, match="give one factor > 0 for all axes"):
        read_urdf(urdf(tmp_path / "pack" / "urdf", shape.format("../part.stl", "1 2 1")))
    with pytest.warns(UserWarning, match=r"link a without part.dae; .stl, .obj, .ply are read"):
        read_urdf(urdf(tmp_path / "pack" / "urdf", shape.format("part.dae", "1 1 1")))


def ros_package(folder: Path, name: str) -> Path:
    """A folder of a ROS package of another name than its own, with what XACRO includes and a mesh."""
    (folder / "urdf").mkdir(parents=True)
    (folder / "package.xml").write_text(f"<package format='3'><name>{name}</name></package>")
    (folder / "urdf" / "link.xacro").write_text(XACRO_LINK)
    (folder / "part.stl").write_bytes((REPOSITORY / "configs/parts/bellows.stl").read_bytes())
    return folder


@pytest.mark.parametrize("where", ["own", "beside", "other_repository", "catkin", "ament"])
def test_a_package_is_found_by_its_manifest(
    where: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in a checkout of a robot's description, and in a workspace that the environment names."""
    pytest.importorskip("xacro")
    robots = ros_package(tmp_path / "workspace/src/arm_repository/robots", "arm_robots")
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    monkeypatch.delenv("ROS_PACKAGE_PATH", raising=False)
    if where == "own":
        (robots / "package.xml").write_text("<package><name>arm_pack</name></package>")
    elif where == "beside":
        ros_package(tmp_path / "workspace/src/arm_repository/common", "arm_pack")
    elif where == "other_repository":
        ros_package(tmp_path / "workspace/src/other_repository/packages/common", "arm_pack")
    elif where == "catkin":
        ros_package(tmp_path / "elsewhere/a/b/c/d/e/f/src/common", "arm_pack")
        monkeypatch.setenv("ROS_PACKAGE_PATH", f"/nowhere:{tmp_path / 'elsewhere/a/b/c/d/e/f/src'}")
    else:
        ros_package(tmp_path / "elsewhere/a/b/c/d/e/f/share/arm_pack", "arm_pack")
        monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "elsewhere/a/b/c/d/e/f"))
    file = robots / "urdf" / "robot.xacro"
    mesh = '<collision><geometry><mesh filename="package://arm_pack/part.stl"/></geometry></collision>'
    file.write_text(XACRO.replace('<link name="root"/>', f'<link name="root">{mesh}</link>'))
    rigid = read_urdf(file)
    assert list(rigid.shapes) == ["root", "left_1", "left_2"]
    assert rigid.shapes["root"][0].shape.mesh is not None


def test_a_package_beside_is_not_taken_where_programs_may_not_run(tmp_path: Path) -> None:
    """Nor from a folder that every user may write, whoever asks."""
    pytest.importorskip("xacro")
    robots = ros_package(tmp_path / "src/robots", "arm_robots")
    ros_package(tmp_path / "src/planted", "arm_pack")
    file = robots / "urdf" / "robot.xacro"
    file.write_text(XACRO)
    with (
        limited_to(ProgramRule((robots,))),
        pytest.raises(ConfigError, match=r"package arm_pack is in no folder") as refused,
    ):
        read_urdf(file)
    assert "up to 3 folders below /" in str(refused.value)
    assert len(read_urdf(file).joints) == 2
    (tmp_path / "src").chmod(0o777)
    with pytest.raises(ConfigError, match=r"package arm_pack is in no folder"):
        read_urdf(file)


def scene(folder: Path, arm: str, rest: str = "") -> Path:
    """A scene file with an arm."""
    file = folder / "cell.yaml"
    file.write_text(f"name: cell\narm: {arm}\n{rest}")
    return file


@pytest.mark.parametrize(
    ("arm", "why"),
    [
        ("{urdf: nothing.urdf}", "nothing.urdf: cannot be read"),
        ("{}", "arm.urdf: is missing"),
        ("my_arm.urdf", "line 2, column 1: arm: must be a mapping"),
        ("[]", "line 2, column 1: arm: must be a mapping"),
        (
            f"{{urdf: {ARM}, start: {{elbow: 1.0}}}}",
            "arm: start names the joint 'elbow'; did you mean elbow_pitch? known: base_yaw,",
        ),
        (
            f"{{urdf: {ARM}, start: {{elbow_pitch: 3.0}}}}",
            "start of elbow_pitch is 3.0; allowed is [-2.6, 2.6]",
        ),
        (
            f"{{urdf: {ARM}, tools: [{{robot: tripod, on: hook}}]}}",
            "unknown link 'hook' for tripod; known: base,",
        ),
        (f"{{urdf: {ARM}, tools: [{{robot: nobody, on: tool}}]}}", "nobody"),
        (f"{{urdf: {ARM}, tools: [{{robot: cell.yaml, on: tool}}]}}", "cell.yaml carries itself"),
        (f"{{urdf: {ARM}, tools: [{{robot: tripod_step_4_1, on: tool}}]}}", "runs code; name a YAML file"),
        (
            f"{{urdf: {ARM}, tools: [{{robot: pneu_finger, on: tool, without: [nose]}}]}}",
            "pneu_finger has no 'nose' to leave out; known: ",
        ),
    ],
)
def test_a_mistake_in_a_scene_is_one_sentence(tmp_path: Path, arm: str, why: str) -> None:
    with pytest.raises(ConfigError, match=r".*") as refused:
        load_scene(scene(tmp_path, arm))
    assert why in str(refused.value)


def test_the_file_is_laid_over_what_the_arm_says(tmp_path: Path) -> None:
    rest = "joints: [{name: base_yaw, limits: {speed: 0.5}}]\nposes: {up: [0.1, 0, 0, 0, 0, 0, 0]}\n"
    robot = load_scene(scene(tmp_path, f"{{urdf: {ARM}, tools: [{{robot: pneu_finger, on: tool}}]}}", rest))
    assert robot.joints[0].limits.speed == 0.5
    assert robot.joints[0].limits.upper == 2.9
    assert robot.poses["up"][0] == 0.1
    assert robot.joint_names[-1] == load_scene("pneu_finger").joint_names[0]


def motion(seed: int) -> Motion:
    rng = np.random.default_rng(seed)
    return Motion(rotation_euler(rng.uniform(-3.0, 3.0, 3)), rng.uniform(-1.0, 1.0, 3))


def robots() -> list[str]:
    """Robots and scenes in YAML files that have bodies which deform."""
    return [
        name
        for name, file in known_scenes().items()
        if file.suffix == ".yaml" and "_step_" not in name and name != "objects"
    ]


@pytest.mark.parametrize("name", robots())
@pytest.mark.slow
def test_a_moved_scene_does_what_it_did_elsewhere(name: str) -> None:
    original = load_scene(name).robot_alone().scene
    there = motion(len(name))
    turned = replace(place_scene(original, there), gravity=tuple(there.direction(original.gravity).tolist()))
    here, moved = Simulation(original), Simulation(turned)
    ends = [each.limits.upper if np.isfinite(each.limits.upper) else 1.0 for each in original.joints]
    command = [each.rest + 0.2 * (end - each.rest) for each, end in zip(original.joints, ends, strict=True)]
    for each in (here, moved):
        each.command(command)
        for _ in range(3):
            each.step()
    expected = here.positions @ there.rotation.T + there.translation
    size = float(np.ptp(expected, axis=0).max())
    assert np.abs(moved.positions - expected).max() < 1e-6 * size
    assert moved.joint_efforts == pytest.approx(here.joint_efforts, rel=1e-4, abs=1e-6)


def test_a_tool_hangs_where_its_link_is_at_the_start(tmp_path: Path) -> None:
    pose = "{translation: [0.0, 0.0, 0.02], rotation_deg: [180, 0, 30]}"
    tool = f"{{robot: cable_gripper, on: tool, pose: {pose}, without: [floor, cube]}}"
    start = "{base_yaw: 0.4, shoulder_pitch: 0.3, elbow_pitch: 1.2, forearm_roll: -0.5, wrist_pitch: 0.7}"
    robot = load_scene(scene(tmp_path, f"{{urdf: {ARM}, start: {start}, tools: [{tool}]}}"))
    simulation, alone = Simulation(robot), Simulation(load_scene("cable_gripper"))
    flange = simulation.frames()["flange_roll"]
    link = Motion(rotation_of(flange.quaternion_xyzw), flange.position).after(
        Motion(np.eye(3), np.array([0.0, 0.0, 0.014]))
    )
    where = link.after(Motion(rotation_euler(np.radians([180.0, 0.0, 30.0])), np.array([0.0, 0.0, 0.02])))
    expected = alone.positions @ where.rotation.T + where.translation
    assert np.abs(simulation.positions - expected).max() < 1e-9
    for mine, theirs in zip(simulation.actuators, alone.actuators, strict=True):
        assert mine.points == pytest.approx(theirs.points @ where.rotation.T + where.translation, abs=1e-9)
    assert simulation.joint_names[6:] == alone.joint_names


@pytest.mark.slow
def test_an_arm_reaches_a_frame_or_says_how_near() -> None:
    model = Simulation(load_scene("gripper_on_arm")).model
    rng, state = np.random.default_rng(3), model.rest_state()
    index = [each.name for each in model.joints].index("flange_roll")
    for _ in range(20):
        state.joint_positions[:6] = rng.uniform(-0.8, 0.8, 6) + np.array([0.0, 0.4, 1.2, 0.0, 0.8, 0.0])
        origin, turn = (each.copy() for each in model.joint_frame(index, state))
        found = reach(model, "flange_roll", origin, turn, model.rest_state().joint_positions)
        state.joint_positions[:] = found
        there, turned = model.joint_frame(index, state)
        assert np.abs(there - origin).max() < 1e-5
        assert np.abs(turned - turn).max() < 1e-4
    with pytest.raises(NotReachedError, match=r"flange_roll does not reach \[2.0, 0.0, 0.0\] m"):
        reach(model, "flange_roll", [2.0, 0.0, 0.0], np.eye(3), state.joint_positions)


@pytest.mark.slow
def test_what_the_page_shows_runs(tmp_path: Path) -> None:
    page = (REPOSITORY / "docs" / "arm.md").read_text()
    rows, *_ = re.findall(r"^```yaml\n(.*?)^```", page, re.DOTALL | re.MULTILINE)
    file = tmp_path / "cell.yaml"
    file.write_text(rows.replace("../arms", str(ARM.parent)))
    simulation = Simulation(load_scene(file))
    for _ in range(30):
        simulation.step()
    weight = float(simulation.model.mass.sum()) * 9.81
    assert np.linalg.norm(simulation.sensors["flange"].value[:3]) == pytest.approx(weight, rel=0.03)
    (code,) = re.findall(r"^```python\n(.*?)^```", page, re.DOTALL | re.MULTILINE)
    names: dict[str, Any] = {}
    exec(compile(code, "arm.md", "exec", dont_inherit=True), names)
    for _ in range(100):
        names["simulation"].step()
    assert names["simulation"].frames()["flange_roll"].position == pytest.approx(names["lower"], abs=1e-4)
