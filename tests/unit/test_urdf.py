"""The URDF of every robot: one tree, its joints those of joint_states, its frames those of the simulator."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from pathlib import Path
from urllib.parse import unquote, urlparse

import meshio
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_scenes import body, scene, slab

from softsim_core import Simulation, load_scene
from softsim_core.physics.mechanics import rotation_of
from softsim_core.physics.mesh import box_mesh
from softsim_core.scene import as_robot
from softsim_core.simulation import SceneState

pytest.importorskip("rclpy")
from softsim_ros.description import control_topics, links_of, mesh_address, urdf, write_folder
from softsim_ros.nodes.inverse import effector_rest

ROBOTS = ["tripod", "cable_gripper", "tripod_maze", "cable_finger"]


def parsed(robot: str) -> ElementTree.Element:
    return ElementTree.fromstring(urdf(load_scene(robot), topics=control_topics("/left")))


def forward_kinematics(root: ElementTree.Element, joints: Mapping[str, float]) -> dict[str, np.ndarray]:
    """Poses (4, 4) of all links by the rules of URDF, from its text alone."""
    poses, waiting = {"base_link": np.eye(4)}, root.findall("joint")
    while waiting:
        joint = next(each for each in waiting if each.find("parent").get("link") in poses)
        waiting.remove(joint)
        origin, step, motion = joint.find("origin"), np.eye(4), np.eye(4)
        step[:3, 3] = np.fromstring(origin.get("xyz"), sep=" ")
        step[:3, :3] = Rotation.from_euler("xyz", np.fromstring(origin.get("rpy"), sep=" ")).as_matrix()
        if joint.get("type") in ("revolute", "continuous", "prismatic"):
            way = joints[joint.get("name")] * np.fromstring(joint.find("axis").get("xyz"), sep=" ")
            if joint.get("type") == "prismatic":
                motion[:3, 3] = way
            else:
                motion[:3, :3] = Rotation.from_rotvec(way).as_matrix()
        poses[joint.find("child").get("link")] = poses[joint.find("parent").get("link")] @ step @ motion
    return poses


@pytest.mark.parametrize("robot", ROBOTS)
def test_it_is_a_tree_whose_moving_joints_are_those_of_joint_states(robot: str) -> None:
    root = parsed(robot)
    links = [link.get("name") for link in root.findall("link")]
    children = [joint.find("child").get("link") for joint in root.findall("joint")]
    names = [joint.get("name") for joint in root.findall("joint")]
    assert len(set(links)) == len(links)
    assert len(set(names)) == len(names)
    assert sorted(children) == sorted(set(links) - {"base_link"})  # one parent each, and one root
    assert set(forward_kinematics(root, dict.fromkeys(names, 0.0))) == set(links)  # all hang on it
    moving = {joint.get("name") for joint in root.findall("joint") if joint.find("axis") is not None}
    description = load_scene(robot)
    assert moving == set(description.joint_names)
    assert [joint.get("name") for joint in root.findall("ros2_control/joint")] == list(
        description.joint_names
    )
    for joint in description.joints:
        limit = root.find(f"joint[@name='{joint.name}']/limit").attrib
        assert float(limit["velocity"]) == min(joint.limits.speed, 1000.0)
        assert float(limit["lower"]) == max(joint.limits.lower, -1000.0)


@pytest.mark.parametrize("robot", ROBOTS)
def test_its_frames_are_where_the_simulator_has_them(robot: str) -> None:
    description, root = load_scene(robot), parsed(robot)
    state = SceneState(description.scene, "scipy")
    random = np.random.default_rng(5)
    for _ in range(5):
        angles = random.uniform(-0.9, 0.9, len(description.joints)) * 0.3
        state._state.joint_positions[:] = angles
        poses = forward_kinematics(root, dict(zip(description.joint_names, angles, strict=True)))
        for link in links_of(description):
            if link.measured and link.kind != "floating":
                pose = state.frames()[link.measured]
                np.testing.assert_allclose(poses[link.name][:3, 3], pose.position, atol=1e-9)
                turn = rotation_of(pose.quaternion_xyzw)
                np.testing.assert_allclose(poses[link.name][:3, :3], turn, atol=1e-9)


def test_a_free_frame_that_is_not_given_is_in_the_middle_of_its_region() -> None:
    beam = body(box_mesh((0.5, 0.01, 0.01), (4, 1, 1)))
    held = slab("wall", "world", 0.0), slab("tip", "free", 0.5)
    robot = as_robot(scene(beam, attachments=held, effector="tip"))
    middle = beam.mesh.points[np.isclose(beam.mesh.points[:, 0], 0.5)].mean(axis=0)
    np.testing.assert_allclose(effector_rest(robot), middle, atol=1e-12)
    link = next(each for each in links_of(robot) if each.measured == "tip")
    np.testing.assert_allclose(link.position, middle, atol=1e-12)


def test_meshes_are_files_that_exist_or_are_written_beside_it(tmp_path: Path) -> None:
    robot = load_scene("tripod_maze")
    file, *others = write_folder(robot, tmp_path, "tripod")
    meshes = [each for each in others if each.suffix == ".stl"]
    named = [mesh.get("filename") for mesh in ElementTree.parse(file).iter("mesh")]
    assert [unquote(urlparse(name).path) for name in named] == [str(mesh) for mesh in meshes]
    surface = Simulation(robot, backend="scipy").visual_rest_points
    silicone = meshio.read(next(mesh for mesh in meshes if "silicone" in mesh.name))
    np.testing.assert_allclose(silicone.points.min(axis=0), surface.min(axis=0), atol=1e-7)
    for mesh in parsed("tripod").iter("mesh"):
        assert Path(unquote(urlparse(mesh.get("filename")).path)).is_file()


def test_a_mesh_of_a_ros_package_is_named_by_its_package(tmp_path: Path) -> None:
    from softsim_core.base import MeshFile

    share = tmp_path / "share" / "softsim_bringup"
    (share / "configs").mkdir(parents=True)
    (share / "package.xml").touch()
    mesh = MeshFile(file=share / "configs" / "arm.stl")
    assert mesh_address("bodies/arm", mesh) == ("package://softsim_bringup/configs/arm.stl", mesh)


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_parser_of_ros_reads_it(robot: str) -> None:
    parser = pytest.importorskip("urdf_parser_py.urdf", reason="pip install urdf_parser_py")
    read = parser.URDF.from_xml_string(urdf(load_scene(robot)).encode())
    assert read.get_root() == "base_link"
    assert read.get_chain("base_link", links_of(load_scene(robot))[-1].name)


@pytest.mark.parametrize("robot", ROBOTS)
def test_mujoco_reads_it(robot: str, tmp_path: Path) -> None:
    mujoco = pytest.importorskip("mujoco", reason="mujoco is not installed: pip install 'softsim[mujoco]'")
    root = ElementTree.fromstring(urdf(load_scene(robot), meshes=lambda part, mesh: None))
    model = mujoco.MjModel.from_xml_string(ElementTree.tostring(root, encoding="unicode"))
    assert model.nq >= len(load_scene(robot).joints)
    assert (model.body_mass[1:] > 0.0).all()
