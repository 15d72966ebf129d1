"""What a launch starts: planned for every robot, run by hand, and handed to launch_ros as it wants it."""

from __future__ import annotations

import ast
import inspect
import json
import re
import sys
import types
from collections.abc import Callable, Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any, ClassVar

import pytest
import yaml
from waiting import BUILD_S

pytest.importorskip("rclpy")

from node_processes import Client, ProcessGroup, parameter_words, private_ros, spin_until

from softsim_core import load_scene
from softsim_core.base import SoftSimError
from softsim_ros import LaunchArguments, Plan, board_link, plan
from softsim_ros.cli.running import NODES
from softsim_ros.description import SHOWN, companions

REPOSITORY = Path(__file__).resolve().parents[2]
BRINGUP = REPOSITORY / "ros2_ws" / "src" / "softsim_bringup"
ROBOTS = ["tripod", "cable_gripper", "pneu_finger", "pneu_arm", "emio"]


def started(planned: Plan) -> list[str]:
    return [node.executable for node in planned.nodes]


def test_every_robot_gets_what_it_has(tmp_path: Path) -> None:
    bridged = ["simulator", "virtual_board", "servo_bridge"]
    assert started(plan(LaunchArguments(), tmp_path)) == bridged
    assert started(plan(LaunchArguments(robot="cable_gripper"), tmp_path)) == [
        "simulator"
    ]  # no board, no bridge
    assert started(plan(LaunchArguments(port="/dev/ttyACM7"), tmp_path)) == ["simulator", "servo_bridge"]
    assert started(plan(LaunchArguments(board="none"), tmp_path)) == ["simulator"]
    everything = LaunchArguments(board="emulated", inverse="true", viewer="true", control="true", rviz="true")
    others = ["inverse_controller", "viewer", "ros2_control_node", "spawner", "rviz2"]
    planned = plan(everything, tmp_path)
    assert started(planned) == ["simulator", "emulated_board", "servo_bridge", *others]
    ends = {node.executable for node in planned.nodes if node.ends_all}
    assert ends == {"simulator", "emulated_board", "servo_bridge", "ros2_control_node"}
    assert "-p robot:=tripod -r __ns:=/tripod" in planned.hint


def test_servos_on_a_bus_are_emulated_by_the_virtual_board(tmp_path: Path) -> None:
    file = tmp_path / "bus.yaml"
    file.write_text(
        "name: bus\njoints: [{name: a}]\nboard: {baud_rate: 1000000, servos: [{joint: a, id: 1}]}\n"
    )
    for word in ("virtual", "emulated"):
        planned = plan(LaunchArguments(robot=str(file), board=word), tmp_path)
        assert started(planned) == ["simulator", "virtual_board", "servo_bridge"]
        assert planned.nodes[1].parameters["robot"] == str(file)


def test_each_node_gets_its_enclave_where_that_is_wished(tmp_path: Path) -> None:
    everything = plan(LaunchArguments(namespace="lab/left", enclaves="true", rviz="true"), tmp_path)
    assert {each.enclave for each in everything.nodes} == {
        f"/lab/left/{name}" for name in ("simulator", "virtual_board", "servo_bridge", "rviz2")
    }
    assert everything.hint.endswith("--enclave /lab/left/teleop")
    assert {each.enclave for each in plan(LaunchArguments(), tmp_path).nodes} == {""}


def test_two_robots_share_neither_namespace_nor_board(tmp_path: Path) -> None:
    left, right = (plan(LaunchArguments(namespace=name), tmp_path) for name in ("/left", "/lab/left"))
    assert (left.namespace, right.namespace) == ("left", "lab/left")
    links = {
        node.parameters["port"] for each in (left, right) for node in each.nodes if "port" in node.parameters
    }
    assert len(links) == 2
    assert {Path(str(link)).parent for link in links} == {
        board_link("x").parent
    }  # no folder that is not there


@pytest.mark.parametrize(
    ("wishes", "words"),
    [
        (
            LaunchArguments(robot="cable_gripper", board="virtual"),
            "argument board: cable_gripper has no servo board",
        ),
        (LaunchArguments(board="virtual", port="/dev/ttyACM0"), "argument port: belongs to board:=real"),
        (LaunchArguments(board="/dev/ttyACM0"), "argument board: '/dev/ttyACM0' is not one of auto, virtual"),
        (LaunchArguments(rviz="yes"), "argument rviz: 'yes' is not one of false, true"),
        (LaunchArguments(robot="tripo"), "did you mean tripod"),
    ],
)
def test_what_does_not_go_together_is_said_before_anything_starts(
    wishes: LaunchArguments, words: str, tmp_path: Path
) -> None:
    with pytest.raises(SoftSimError, match=words):
        plan(wishes, tmp_path)


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_files_for_other_programs_are_those_of_the_robot(robot: str) -> None:
    folders = {".yaml": "control", ".rviz": "rviz", ".json": "foxglove"}
    for name, text in companions(load_scene(robot), robot).items():
        shipped = BRINGUP / folders[Path(name).suffix] / name
        assert shipped.read_text() == text, f"write it anew: softsim urdf {robot} --out FOLDER"
    controller = yaml.safe_load((BRINGUP / "control" / f"{robot}_controllers.yaml").read_text())
    joints = controller[f"/{robot}/joint_trajectory_controller"]["ros__parameters"]["joints"]
    assert joints == list(load_scene(robot).joint_names)


@pytest.mark.parametrize(("robot", "chambers"), [("pneu_arm", ["air_0", "air_1", "air_2"]), ("tripod", [])])
def test_the_layout_draws_the_pressure_of_each_chamber_there_is(robot: str, chambers: list[str]) -> None:
    layout = json.loads(companions(load_scene(robot), "lab")[f"{robot}_foxglove.json"])
    plot = layout["configById"].get("Plot!pressure", {"paths": []})
    assert [(each["label"], each["value"]) for each in plot["paths"]] == [
        (name, f"/lab/chambers/{name}/pressure.fluid_pressure") for name in chambers
    ]
    shown = re.findall('"([A-Za-z0-9]+![a-z]+)"', json.dumps(layout["layout"]))
    assert sorted(shown) == sorted(layout["configById"])


# --- run by hand ------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def domain(tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
    with private_ros(tmp_path_factory.mktemp("ros")) as number:
        yield number


@pytest.mark.slow
@pytest.mark.ros
def test_what_is_planned_runs_and_shows_what_rviz_and_foxglove_ask_for(tmp_path: Path, domain: int) -> None:
    from rcl_interfaces.srv import ListParameters
    from sensor_msgs.msg import JointState

    planned = plan(LaunchArguments(namespace="/lab/left", inverse="true", autostart="activate"), tmp_path)
    processes = ProcessGroup(tmp_path)
    client = Client(domain, planned.namespace, processes)
    try:
        for node in planned.nodes:
            words = parameter_words(**node.parameters)
            processes(
                NODES[node.executable].module, "--ros-args", "-r", f"__ns:=/{planned.namespace}", *words
            )
        states = client.collect(JointState, "joint_states")
        applied = client.collect(JointState, "applied_joint_states")
        assert spin_until(lambda: states and applied, BUILD_S), processes.output
        assert states[-1].header.frame_id == applied[-1].header.frame_id == "lab/left/base_link"
        for node in planned.nodes:
            answer = client.call(ListParameters, f"{node.executable}/list_parameters")
            assert set(node.parameters) <= set(answer.result.names), node.executable

        def types() -> dict[str, str]:
            return {name: found[0] for name, found in client.node.get_topic_names_and_types()}

        wanted = {f"/lab/left/{each.topic}": each.type_name for each in SHOWN}
        wanted |= {
            "/lab/left/robot_description": "std_msgs/msg/String",
            "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
            "/lab/left/joint_states": "sensor_msgs/msg/JointState",
            "/lab/left/position_controller/commands": "std_msgs/msg/Float64MultiArray",
        }
        assert spin_until(lambda: wanted.items() <= types().items()), wanted.items() - types().items()
        layout = companions(load_scene("tripod"), "lab/left")["tripod_foxglove.json"]
        for panel in json.loads(layout)["configById"].values():
            named = [*panel.get("topics", ()), panel.get("topicName"), panel.get("topicToRender")]
            named += [path["value"].split(".")[0] for path in panel.get("paths", ())]
            assert {name for name in named if name} <= set(wanted)
    finally:
        client.close()
        processes.end()


# --- handed to launch -------------------------------------------------------------------------------------

# `launch` is not on PyPI: these stand in for it with the keywords its documentation gives, and only record.
DOCUMENTED = {
    "launch": {"LaunchDescription": {"initial_entities"}, "LaunchContext": set()},
    "launch.actions": {
        "DeclareLaunchArgument": {"name", "default_value", "description", "choices", "condition"},
        "IncludeLaunchDescription": {"launch_description_source", "launch_arguments", "condition"},
        "LogInfo": {"msg", "condition"},
        "OpaqueFunction": {"function", "args", "kwargs", "condition"},
        "Shutdown": {"reason", "condition"},
    },
    "launch.launch_description_sources": {"PythonLaunchDescriptionSource": {"launch_file_path"}},
    "launch.substitutions": {"PathJoinSubstitution": {"substitutions"}},
    "launch_ros": {},
    "launch_ros.actions": {
        "Node": {
            "executable", "package", "name", "namespace", "exec_name", "parameters", "remappings",
            "arguments", "ros_arguments", "output", "condition", "on_exit", "respawn", "emulate_tty",
        }
    },
    "launch_ros.parameter_descriptions": {"ParameterValue": {"value", "value_type"}},
    "launch_ros.substitutions": {"FindPackageShare": {"package"}},
}  # fmt: skip


class Recorded:
    allowed: ClassVar[set[str]] = set()

    def __init__(self, *positional: Any, **keywords: Any) -> None:
        unknown = set(keywords) - self.allowed
        assert not unknown, f"{type(self).__name__} has no {unknown}"
        self.positional, self.keywords = positional, keywords


@pytest.fixture
def launch_file(monkeypatch: pytest.MonkeyPatch) -> Callable[..., dict[str, Any]]:
    """Runs a launch file on the stand-ins; keywords are arguments of the launch."""

    def load(name: str, **words: str) -> dict[str, Any]:
        class LaunchConfiguration(Recorded):
            def perform(self, context: object) -> str:
                default = next(
                    each.default for each in fields(LaunchArguments) if each.name == self.positional[0]
                )
                return words.get(self.positional[0], str(default))

        for module_name, classes in DOCUMENTED.items():
            module = types.ModuleType(module_name)
            for each, allowed in classes.items():
                setattr(module, each, type(each, (Recorded,), {"allowed": allowed}))
            monkeypatch.setitem(sys.modules, module_name, module)
        sys.modules["launch.substitutions"].LaunchConfiguration = LaunchConfiguration  # type: ignore[attr-defined]
        packages = types.ModuleType("ament_index_python.packages")
        packages.PackageNotFoundError = LookupError  # type: ignore[attr-defined]
        installed = {"softsim_ros", "servo_bridge"}
        packages.get_package_prefix = lambda package: dict.fromkeys(installed, "")[package]  # type: ignore[attr-defined]
        monkeypatch.setitem(sys.modules, "ament_index_python.packages", packages)
        file = BRINGUP / "launch" / name
        space: dict[str, Any] = {}
        exec(compile(file.read_text(), str(file), "exec"), space)
        return space

    return load


def test_the_launch_file_hands_over_what_is_planned(
    launch_file: Callable[..., dict[str, Any]], tmp_path: Path
) -> None:
    *declared, opaque = launch_file("robot.launch.py", namespace="/left")[
        "generate_launch_description"
    ]().positional[0]
    assert [each.positional[0] for each in declared] == [each.name for each in fields(LaunchArguments)]
    choices = {each.positional[0]: each.keywords["choices"] for each in declared}
    assert choices["inverse"] == ["false", "true"]
    assert choices["robot"] is None
    hint, *nodes = opaque.keywords["function"](None)
    assert "__ns:=/left" in hint.keywords["msg"]
    planned = plan(LaunchArguments(namespace="/left"), tmp_path).nodes
    for node, wanted in zip(nodes, planned, strict=True):
        assert (node.keywords["package"], node.keywords["executable"]) == (wanted.package, wanted.executable)
        assert node.keywords["namespace"] == "left"
        (values,) = node.keywords["parameters"]
        assert {name: value.positional[0] for name, value in values.items()} == wanted.parameters
        assert {value.keywords["value_type"] for value in values.values()} <= {str, int, float}
        assert node.keywords["on_exit"] is not None  # a dead simulator, bridge or board ends the launch
        assert f'"{wanted.executable} = ' in (BRINGUP.parent / wanted.package / "setup.py").read_text()


def test_a_missing_program_is_named_before_anything_starts(
    launch_file: Callable[..., dict[str, Any]],
) -> None:
    described = launch_file("robot.launch.py", rviz="true")["generate_launch_description"]()
    with pytest.raises(RuntimeError, match="rviz2 is not installed: sudo apt install ros-jazzy-rviz2"):
        described.positional[0][-1].keywords["function"](None)


def test_the_former_name_includes_the_launch_of_any_robot(
    launch_file: Callable[..., dict[str, Any]],
) -> None:
    (included,) = launch_file("tripod.launch.py")["generate_launch_description"]().positional[0]
    file = included.positional[0].positional[0].positional[0]
    assert file[0].positional == ("softsim_bringup",)
    assert (BRINGUP / file[1] / file[2]).name == "robot.launch.py"
    assert (BRINGUP / file[1] / file[2]).is_file()


def test_the_real_launch_takes_it() -> None:
    pytest.importorskip("launch_ros", reason="apt's ROS 2 has launch; PyPI has not")
    from launch import LaunchContext
    from launch.actions import DeclareLaunchArgument
    from launch.launch_description_sources import get_launch_description_from_python_launch_file

    file = BRINGUP / "launch" / "robot.launch.py"
    description = get_launch_description_from_python_launch_file(str(file))
    declared = [each for each in description.entities if isinstance(each, DeclareLaunchArgument)]
    assert {each.name for each in declared} == {each.name for each in fields(LaunchArguments)}
    context = LaunchContext()
    for each in declared:
        each.visit(context)
    assert context.launch_configurations["robot"] == "tripod"


def test_launch_files_import_nothing_but_launch_and_the_suite() -> None:
    """So that they run in the Python of `ros2 launch`, which sees no virtual environment."""
    for file in [*(BRINGUP / "launch").glob("*.py"), Path(inspect.getfile(plan))]:
        found = {
            (node.module if isinstance(node, ast.ImportFrom) else node.names[0].name).split(".")[0]
            for node in ast.walk(ast.parse(file.read_text()))
            if isinstance(node, (ast.Import, ast.ImportFrom))
        }
        ours = {"launch", "launch_ros", "ament_index_python", "softsim_node", "softsim_ros", "softsim_core"}
        assert found <= ours | set(sys.stdlib_module_names)
