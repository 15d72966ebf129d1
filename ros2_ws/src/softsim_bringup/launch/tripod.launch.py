"""The Tripod: robot.launch.py under its former name, with the same arguments.

ros2 launch softsim_bringup tripod.launch.py port:=/dev/ttyACM0
"""

from launch import LaunchDescription
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import PathJoinSubstitution
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    """Include the launch of any robot."""
    file = PathJoinSubstitution([FindPackageShare("softsim_bringup"), "launch", "robot.launch.py"])
    return LaunchDescription([IncludeLaunchDescription(PythonLaunchDescriptionSource(file))])
