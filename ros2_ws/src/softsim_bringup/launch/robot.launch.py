"""Any robot: simulator, servo bridge and its board, inverse control, web page, ros2_control, RViz, by choice.

    ros2 launch softsim_bringup robot.launch.py robot:=tripod
    ros2 launch softsim_bringup robot.launch.py robot:=tripod board:=real port:=/dev/ttyACM0
    ros2 launch softsim_bringup robot.launch.py robot:=cable_gripper viewer:=true rviz:=true
    ros2 launch softsim_bringup robot.launch.py control:=true     # joint_trajectory_controller, for MoveIt
    ros2 launch softsim_bringup robot.launch.py namespace:=/left  # once more with /right: two in one graph

`--show-args` lists the arguments with their choices. The bridge opens its port and waits; key B of the
teleop, in a terminal of its own, starts sending. The launch ends with the simulator, the bridge or its board.
"""

import tempfile
from dataclasses import fields
from pathlib import Path

from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, LogInfo, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from softsim_ros import LaunchArguments, PlannedNode, plan

_folders = []  # of files that nodes read; removed when the launch ends


def generate_launch_description() -> LaunchDescription:
    """Describe the arguments, and start what they ask for."""
    arguments = [
        DeclareLaunchArgument(
            each.name,
            default_value=each.default,
            description=each.metadata["about"],
            choices=list(each.metadata["choices"]) or None,
        )
        for each in fields(LaunchArguments)
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=_start)])


def _start(context: LaunchContext) -> list[object]:
    """Nothing, with a sentence, where something is missing; else all nodes."""
    words = {each.name: LaunchConfiguration(each.name).perform(context) for each in fields(LaunchArguments)}
    _folders.append(tempfile.TemporaryDirectory(prefix="softsim_launch_"))
    planned = plan(LaunchArguments(**words), Path(_folders[-1].name))
    for package in dict.fromkeys(node.package for node in planned.nodes):
        try:
            get_package_prefix(package)
        except PackageNotFoundError as error:
            apt = f"ros-jazzy-{package.replace('_', '-')}"
            raise RuntimeError(f"{package} is not installed: sudo apt install {apt}") from error
    return [LogInfo(msg=planned.hint), *(_node(node, planned.namespace) for node in planned.nodes)]


def _node(planned: PlannedNode, namespace: str) -> Node:
    values = {
        name: ParameterValue(value, value_type=type(value)) for name, value in planned.parameters.items()
    }
    parameters = [values] if values else []
    if planned.parameter_file is not None:
        parameters.append(str(planned.parameter_file))
    return Node(
        package=planned.package,
        executable=planned.executable,
        namespace=namespace,
        parameters=parameters,
        arguments=list(planned.arguments),
        ros_arguments=["--enclave", planned.enclave] if planned.enclave else [],
        output="screen",
        on_exit=Shutdown(reason=f"{planned.executable} has ended") if planned.ends_all else None,
    )
