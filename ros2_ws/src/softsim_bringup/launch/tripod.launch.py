"""Simulator and servo bridge of one robot, on a virtual board until a port is named.

    ros2 launch softsim_bringup tripod.launch.py
    ros2 launch softsim_bringup tripod.launch.py port:=/dev/ttyACM0
    ros2 launch softsim_bringup tripod.launch.py rviz:=true
    ros2 launch softsim_bringup tripod.launch.py inverse:=true

The bridge opens its port and waits; key B of the teleop starts sending. The teleop needs a terminal of its
own: ros2 run softsim_ros teleop
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, LogInfo, Shutdown
from launch.conditions import IfCondition
from launch.substitutions import (
    EnvironmentVariable,
    EqualsSubstitution,
    IfElseSubstitution,
    LaunchConfiguration,
    PathJoinSubstitution,
)
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

VIRTUAL = "virtual"


def generate_launch_description() -> LaunchDescription:
    """Describe the arguments and the nodes."""
    robot, namespace, port = (LaunchConfiguration(name) for name in ("robot", "namespace", "port"))
    on_virtual_board = EqualsSubstitution(port, VIRTUAL)
    board_link = [
        EnvironmentVariable("XDG_RUNTIME_DIR", default_value="/tmp"),
        "/softsim_",
        namespace,
        "_board",
    ]
    bridge_port = IfElseSubstitution(on_virtual_board, if_value=board_link, else_value=port)
    view = PathJoinSubstitution([FindPackageShare("softsim_bringup"), "rviz", "softsim.rviz"])

    arguments = [
        DeclareLaunchArgument(
            "robot", default_value="tripod", description="robot's name, or path of its file"
        ),
        DeclareLaunchArgument("namespace", default_value="tripod", description="namespace of all its nodes"),
        DeclareLaunchArgument(
            "port", default_value=VIRTUAL, description="serial port of the board, or 'virtual'"
        ),
        DeclareLaunchArgument(
            "source",
            default_value="joint_states",
            description="what the servos follow: joint_states or commands",
        ),
        DeclareLaunchArgument(
            "autostart",
            default_value="configure",
            description="bridge: none, configure (open the port) or activate (send at once)",
        ),
        DeclareLaunchArgument(
            "inverse", default_value="false", description="with inverse control, disabled until key I"
        ),
        DeclareLaunchArgument("rviz", default_value="false", description="show the robot in RViz"),
    ]
    simulator = Node(
        package="softsim_ros",
        executable="simulator",
        namespace=namespace,
        parameters=[{"robot": ParameterValue(robot, value_type=str)}],
        output="screen",
        on_exit=Shutdown(reason="the simulator has ended"),
    )
    virtual_board = Node(
        package="servo_bridge",
        executable="virtual_board",
        namespace=namespace,
        parameters=[{"link": ParameterValue(board_link, value_type=str)}],
        condition=IfCondition(on_virtual_board),
    )
    bridge = Node(
        package="servo_bridge",
        executable="servo_bridge",
        namespace=namespace,
        parameters=[
            {
                "robot": ParameterValue(robot, value_type=str),
                "port": ParameterValue(bridge_port, value_type=str),
                "source": ParameterValue(LaunchConfiguration("source"), value_type=str),
                "autostart": ParameterValue(LaunchConfiguration("autostart"), value_type=str),
            }
        ],
        output="screen",
    )
    inverse = Node(
        package="softsim_ros",
        executable="inverse_controller",
        namespace=namespace,
        parameters=[{"robot": ParameterValue(robot, value_type=str)}],
        output="screen",
        condition=IfCondition(LaunchConfiguration("inverse")),
    )
    rviz = Node(
        package="rviz2",
        executable="rviz2",
        namespace=namespace,
        arguments=["-d", view],
        condition=IfCondition(LaunchConfiguration("rviz")),
    )
    hint = LogInfo(msg="drive it from another terminal: ros2 run softsim_ros teleop")
    return LaunchDescription([*arguments, simulator, virtual_board, bridge, inverse, rviz, hint])
