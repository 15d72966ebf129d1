"""What comes in over ROS is refused in a sentence, runs no code, touches no file, and stops nothing."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from waiting import BUILD_S

pytest.importorskip("rclpy")

from builtin_interfaces.msg import Duration
from geometry_msgs.msg import PoseStamped, WrenchStamped
from node_processes import Client, parameter_words, spin_until
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from shared_robots import SIMULATOR, Robot
from std_msgs.msg import Float64MultiArray, String
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.shared_robot("tripod")]

SENTENCE = 300
CODE = """
from pathlib import Path
from softsim_core.robots import tripod
Path(__file__).with_suffix(".ran").touch()

def create_scene(scene):
    scene.name = "tripod"
    scene.add(tripod())
"""
BOMB = "a0: &a0 [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"a{k}: &a{k} [{', '.join(10 * [f'*a{k - 1}'])}]\n" for k in range(1, 10)
)


@pytest.fixture
def lives(tripod: Any, spin_until: Callable[..., bool]) -> Callable[[], bool]:
    """Whether the simulator goes on stepping and telling."""
    states = tripod.client.collect(JointState, "joint_states")

    def look() -> bool:
        seen = len(states)
        return spin_until(lambda: len(states) > seen + 5) and tripod.process.process.poll() is None

    return look


def refused(simulator: Any, **values: Any) -> str:
    """The sentence with which parameters are refused."""
    before = {name: simulator.get_parameter(name) for name in values}
    successful, reason = simulator.set_parameters(**values)
    assert not successful
    assert 0 < len(reason) <= SENTENCE
    assert "\n" not in reason
    assert {name: simulator.get_parameter(name) for name in values} == before
    return str(reason)


# --- scenes and files ----------------------------------------------------------------------------------


def test_a_path_is_no_scene_and_its_code_does_not_run(tripod: Any, tmp_path: Path, lives: Any) -> None:
    program = tmp_path / "program.py"
    program.write_text(CODE)
    assert "no known scene has this name" in refused(tripod, robot=str(program))
    assert not program.with_suffix(".ran").exists()
    (tmp_path / "scene.yaml").write_text("name: tripod\n")
    assert "no known scene has this name" in refused(tripod, robot=str(tmp_path / "scene.yaml"))
    assert lives()


def test_code_of_the_start_folder_runs_only_where_it_was_allowed(
    start_robot: Any, tripod: Any, lives: Any
) -> None:
    folder = tripod.process.folder  # where these simulators were started
    (folder / "found_here.py").write_text(CODE)
    assert "no known scene has this name" in refused(tripod, robot="found_here")
    assert not (folder / "found_here.ran").exists()
    assert lives()


@pytest.fixture(scope="module")
def allowed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder whose code may run in `trusting`."""
    return tmp_path_factory.mktemp("allowed")


@pytest.fixture(scope="module")
def trusting(start_process: Any, ros_domain: int, allowed: Path) -> Iterator[Robot]:
    """A simulator that was started with an allowed folder."""
    words = parameter_words(robot="held_centre", allow_code=allowed)
    process = start_process(SIMULATOR, "--ros-args", "-r", "__ns:=/trusting", *words)
    assert process.says("simulating", BUILD_S), process.output
    client = Client(ros_domain, "trusting")
    yield Robot(process, client)
    client.close()


def test_while_another_scene_is_built_services_answer(trusting: Robot, allowed: Path) -> None:
    gate, scene = allowed / "gate", allowed / "patient.py"
    os.mkfifo(gate)
    scene.write_text(f"""
from softsim_core.scene import load_scene
def create_scene(*_):
    open({str(gate)!r}).read()
    raise LookupError("nothing here")
""")
    setter = trusting.client.service(SetParameters, "simulator/set_parameters")

    def wish(robot: str) -> Any:
        message = Parameter("robot", value=robot).to_parameter_msg()
        return setter.call_async(SetParameters.Request(parameters=[message]))

    def reason(answer: Any) -> str:
        return str(answer.result().results[0].reason)

    answer = wish("patient")
    with gate.open("w"):  # opens once the scene's code runs
        assert trusting.pause(True)[0]
        assert trusting.trigger("step")[0]
        assert trusting.set_parameters(speed=2.0) == (True, "")
        others = [wish("no_such_robot") for _ in range(4)]
        assert spin_until(others[-1].done)  # no more than three wait
        assert "another scene is being loaded" in reason(others[-1])
        assert not any(each.done() for each in (answer, *others[:-1]))
    assert spin_until(lambda: all(each.done() for each in (answer, *others)))
    assert "nothing here" in reason(answer)
    assert all("known" in reason(each) for each in others[:-1])
    assert trusting.get_parameter("robot") == "held_centre"


def test_code_of_an_allowed_folder_runs(trusting: Robot, allowed: Path) -> None:
    (allowed / "welcome.py").write_text(CODE)
    assert trusting.set_parameters(robot="welcome") == (True, "")
    assert (allowed / "welcome.ran").exists()
    assert "read-only" in trusting.set_parameters(allow_code="/")[1]


@pytest.mark.parametrize("name", ["~nobody/x", "a" * 5000, "../tripod", "", "x" + 300 * "/y"])
def test_names_that_cannot_be_are_refused(tripod: Any, lives: Any, name: str) -> None:
    refused(tripod, robot=name)
    refused(tripod, snapshot=name)
    assert lives()


def test_a_snapshot_goes_nowhere_but_into_its_folder(tripod: Any, tmp_path: Path) -> None:
    precious = tmp_path / "precious"
    precious.write_text("mine")
    for name in (str(precious), "/dev/null", "../precious"):
        assert "snapshot name" in refused(tripod, snapshot=name)
    folder = Path(tripod.get_parameter("snapshot_folder"))
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "link.snapshot").symlink_to(precious)
    assert tripod.set_parameters(snapshot="link") == (True, "")
    for action in ("save", "load"):
        successful, sentence = tripod.trigger(action)
        assert not successful
        assert "is a link, a device or a folder" in sentence
    assert precious.read_text() == "mine"
    assert tripod.set_parameters(snapshot="tripod") == (True, "")


def test_overrides_are_bounded_and_name_no_other_file(tripod: Any, tmp_path: Path, lives: Any) -> None:
    assert "more than 200000 values" in refused(tripod, overrides=BOMB)
    assert "nested too deeply" in refused(tripod, overrides="a: " + 20_000 * "[")
    mesh = tmp_path / "other.vtk"
    mesh.write_text("not a mesh")
    text = f"bodies: [{{name: silicone, mesh: {{file: {mesh}}}}}]"
    there = refused(tripod, overrides=text)
    assert "name other files than the scene does" in there
    mesh.unlink()
    assert refused(tripod, overrides=text) == there  # nobody looked whether it is there
    assert "name other files than the scene does" in refused(tripod, overrides="extends: /etc/hostname")
    assert "arm: is made of files" in refused(tripod, overrides="arm: {urdf: some.xacro}")
    assert lives()


# --- numbers and messages ------------------------------------------------------------------------------


@pytest.mark.parametrize("speed", [1e-300, 5e-324, 1e-4, -1.0, float("nan"), float("inf")])
def test_speeds_at_which_nothing_would_happen_are_refused(tripod: Any, lives: Any, speed: float) -> None:
    refused(tripod, speed=speed)
    assert lives()


def test_messages_that_no_robot_means_are_refused_and_the_simulator_lives(tripod: Any, lives: Any) -> None:
    client = tripod.client
    wrench = WrenchStamped()
    wrench.header.frame_id = "mesh_point/" + 5000 * "9"
    client.publish("external_wrench", wrench)
    assert tripod.warns("pull refused: no place 'mesh_point/999")
    point = JointTrajectoryPoint(positions=[0.0] * 30_000, time_from_start=Duration(sec=1))
    names = [f"joint_{k}" for k in range(30_000)]
    client.publish("joint_trajectory", JointTrajectory(joint_names=names, points=[point]))
    assert tripod.warns("trajectory refused: it names 30000 joints of one with 3")
    assert lives()
    points = [JointTrajectoryPoint(positions=[0.0], time_from_start=Duration(sec=k)) for k in range(10_001)]
    client.publish("joint_trajectory", JointTrajectory(joint_names=["servo_0"], points=points))
    assert tripod.warns("it has 10001 points; send at most 10000")
    client.publish("keys", String(data=100_000 * "k"))
    client.publish("position_controller/commands", Float64MultiArray(data=[0.0] * 100_000))
    assert lives()
    assert all(len(line) < 2 * SENTENCE for line in tripod.process.output.splitlines())


def test_a_goal_that_is_nowhere_is_refused(start_process: Any, tripod: Any) -> None:
    words = parameter_words(robot="tripod")
    inverse = start_process("softsim_ros.nodes.inverse.inverse_node", "--ros-args", *words)
    assert inverse.says("ready to control"), inverse.output
    for value in (1e308, 1e200, float("inf"), float("nan")):
        goal = PoseStamped()
        goal.header.frame_id = "world"
        goal.pose.position.x = value
        tripod.client.publish("effector_goal", goal)
    assert inverse.says("is not finite or beyond 1000 m"), inverse.output
    assert inverse.end() == 0
