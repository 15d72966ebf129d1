"""Scenes that are edited while they run: saved files are loaded anew, wrong ones show their error."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from waiting import BUILD_S

pytest.importorskip("rclpy")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from edited_scenes import SCENE, save
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from shape_msgs.msg import Mesh

from softsim_core import load_scene
from softsim_ros.nodes.simulator import SceneFiles, files_of


def tripod_yaml() -> Path:
    source = load_scene("tripod").source
    assert source is not None
    return source


# --- the files, without ROS ----------------------------------------------------------------------------


def test_a_scene_is_made_of_the_files_it_extends_and_its_meshes(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    save(file, SCENE.format(base=tripod_yaml(), young=1.0e5))
    files = files_of(load_scene(file))
    assert files[:2] == [file, tripod_yaml()]
    assert any(each.suffix == ".vtk" for each in files[2:])


def test_a_saved_file_is_seen_once_it_rests(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    save(file, SCENE.format(base=tripod_yaml(), young=1.0e5))
    files = SceneFiles(load_scene(file))
    assert not files.has_changed_on_disk()
    save(file, SCENE.format(base=tripod_yaml(), young=2.0e5))
    assert not files.has_changed_on_disk()  # it may still be written to
    assert files.has_changed_on_disk()
    assert files.load().scene.bodies[0].material.young_modulus == 2.0e5
    assert not files.has_changed_on_disk()
    file.unlink()
    assert not files.has_changed_on_disk()
    assert not files.has_changed_on_disk()  # an editor puts it back


def test_imported_modules_are_watched_and_loaded_anew(tmp_path: Path) -> None:
    (tmp_path / "live_scene_part.py").write_text("HEIGHT = 0.1\n")
    scene = tmp_path / "live.py"
    scene.write_text(
        "import live_scene_part\ndef create_scene(scene):\n    scene.dt = live_scene_part.HEIGHT\n"
    )
    description = load_scene(scene)
    files = SceneFiles(description)
    assert description.scene.dt == 0.1
    assert tmp_path / "live_scene_part.py" in files_of(description)
    save(tmp_path / "live_scene_part.py", "HEIGHT = 0.2\n")
    assert not files.has_changed_on_disk()
    assert files.has_changed_on_disk()
    assert files.load().scene.dt == 0.2


# --- the running simulator -----------------------------------------------------------------------------


class Watched:
    """A simulator that watches a scene of the test, and what it publishes."""

    def __init__(self, robot: Any, file: Path, spin_until: Any) -> None:
        self.robot, self.file, self.spin_until = robot, file, spin_until
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.topologies = robot.client.collect(Mesh, "mesh/topology", latched)
        self.states = robot.client.collect(JointState, "joint_states")
        self._reports = robot.client.collect(DiagnosticArray, "/diagnostics")

    def until(self, condition: Callable[[], Any]) -> bool:
        return bool(self.spin_until(condition, BUILD_S))

    @property
    def report(self) -> DiagnosticStatus:
        """The simulator's newest one."""
        assert self.until(lambda: self._reports)
        return self._reports[-1].status[0]


@pytest.fixture(scope="module")
def watched(start_robot: Any, tmp_path_factory: Any, spin_until: Any) -> Watched:
    file = tmp_path_factory.mktemp("scene") / "mine.yaml"
    save(file, SCENE.format(base=tripod_yaml(), young=1.0e5))
    return Watched(start_robot(robot=str(file), watch=True), file, spin_until)


@pytest.mark.ros
@pytest.mark.slow
def test_a_saved_scene_is_loaded_into_the_running_simulator(watched: Watched) -> None:
    assert watched.until(lambda: len(watched.topologies) == 1)
    assert watched.robot.get_parameter("young_modulus") == 1.0e5
    save(watched.file, SCENE.format(base=tripod_yaml(), young=2.0e5))
    assert watched.until(lambda: len(watched.topologies) == 2)
    assert watched.until(lambda: watched.robot.get_parameter("young_modulus") == 2.0e5)
    heard = len(watched.states)
    assert watched.until(lambda: len(watched.states) > heard)


@pytest.mark.ros
@pytest.mark.slow
def test_a_wrong_file_pauses_with_its_error_and_a_mended_one_goes_on(watched: Watched) -> None:
    save(watched.file, SCENE.format(base=tripod_yaml(), young=-1.0))
    assert watched.until(lambda: watched.report.level == DiagnosticStatus.ERROR)
    assert "scene not loaded: " in watched.report.message
    assert "young_modulus" in watched.report.message
    assert "mine.yaml" in watched.report.message
    assert watched.robot.get_parameter("young_modulus") == 2.0e5
    save(watched.file, "no: [scene")
    assert watched.until(lambda: "YAML syntax" in watched.report.message)
    save(watched.file, SCENE.format(base=tripod_yaml(), young=3.0e5))
    assert watched.until(lambda: watched.report.level == DiagnosticStatus.OK)
    assert watched.report.message == "running"
    assert watched.robot.get_parameter("young_modulus") == 3.0e5


@pytest.mark.ros
@pytest.mark.slow
def test_quite_another_scene_may_take_the_place_and_give_it_back(watched: Watched) -> None:
    save(watched.file, f"extends: {load_scene('held_centre').source}\nname: tripod\n")
    assert watched.until(lambda: watched.states[-1].name == []), watched.robot.process.output
    save(watched.file, SCENE.format(base=tripod_yaml(), young=3.0e5))
    assert watched.until(lambda: len(watched.states[-1].name) == 3)
    watched.robot.command([-0.2, -0.1, -0.3])
    assert watched.until(lambda: list(watched.states[-1].position) == pytest.approx([-0.2, -0.1, -0.3]))


@pytest.mark.ros
@pytest.mark.slow
def test_the_service_loads_the_scene_anew(watched: Watched) -> None:
    shown = len(watched.topologies)
    successful, sentence = watched.robot.trigger("reload")
    assert successful
    assert sentence == f"loaded {watched.file}"
    assert watched.until(lambda: len(watched.topologies) > shown)


@pytest.mark.ros
@pytest.mark.slow
def test_up_watches_its_scene(start_process: Any, tmp_path: Path) -> None:
    file = tmp_path / "other.yaml"
    save(file, SCENE.format(base=tripod_yaml(), young=1.0e5).replace("name: tripod", "name: other", 1))
    up = start_process(
        "softsim_ros.cli", "up", str(file), "--watch", "--no-bridge", "--no-viewer", "--headless"
    )
    assert up.says("/other  running", BUILD_S), up.output
    save(file, "nonsense: 1\n")
    assert up.says("scene not loaded: ", BUILD_S), up.output
    save(file, SCENE.format(base=tripod_yaml(), young=2.0e5).replace("name: tripod", "name: other", 1))
    assert up.says(f"loaded {file}", BUILD_S), up.output
    assert up.end() == 0
