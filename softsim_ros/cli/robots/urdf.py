"""`softsim urdf ROBOT`: write the robot's URDF, for RViz, MoveIt and ros2_control."""

from __future__ import annotations

import argparse
import sys

from softsim_ros.cli import CommandError, add_out


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("robot", help="name of a robot or scene (softsim scenes), or path of its file")
    add_out(
        parser, "FOLDER", "write ROBOT.urdf here, its meshes, and files for ros2_control, RViz and Foxglove"
    )
    parser.add_argument(
        "--namespace", metavar="NAME", help="namespace of its topics and frames (the robot's name)"
    )
    parser.epilog = (
        "Without --out it is printed, and meshes are named where they lie. Also on robot_description."
    )


def run(arguments: argparse.Namespace) -> int:
    """Print or write the URDF."""
    from softsim_core.scene import load_scene
    from softsim_ros.description import control_topics, urdf

    robot = load_scene(arguments.robot)
    namespace = robot.namespace if arguments.namespace is None else arguments.namespace
    if arguments.out is None:
        sys.stdout.write(urdf(robot, topics=control_topics(namespace)))
        return 0
    from softsim_ros.description import write_folder

    try:
        files = write_folder(robot, arguments.out, namespace)
    except OSError as error:
        raise CommandError(f"{arguments.out} cannot be written ({error.strerror})") from error
    for file in files:
        print(file)
    return 0
