"""`softsim record ROBOT`: record topics into a bag that `ros2 bag` and Foxglove open; repair torn bags."""

from __future__ import annotations

import argparse
from pathlib import Path

from softsim_ros.cli import CommandError, UsageError, add_number, add_words

DEFAULT = "tripod"
"""Robot whose topics to wait for if no robot runs yet."""


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("robot", nargs="?", help="whose topics (the robot that runs)")
    parser.add_argument(
        "-o", "--out", metavar="BAG", default="", help="the bag's folder (ROBOT_DATE_TIME here)"
    )
    topic = "record only this topic, such as joint_states or /diagnostics; may be repeated"
    add_words(parser, "--topic", "NAME", topic)
    add_number(parser, "--size-limit", 0.0, "MB", "end at this size")
    add_number(parser, "--time-limit", 0.0, "S", "end after this time")
    parser.add_argument("--namespace", metavar="NAME", help="namespace of the nodes (the robot's name)")
    parser.add_argument("--repair", metavar="BAG", help="close a bag whose recorder was killed, and end")
    parser.epilog = (
        "Ctrl-C ends a recording. What to do with it: softsim replay, softsim export, softsim report."
    )


def run(arguments: argparse.Namespace) -> int:
    """Record until Ctrl-C, a limit, or a full disk."""
    if arguments.repair:
        from softsim_ros.recording import repair

        print(repair(Path(arguments.repair)))
        return 0
    if arguments.size_limit < 0.0 or arguments.time_limit < 0.0:
        raise UsageError("a limit must be 0 (none) or more")
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.parameter import Parameter

    from softsim_node import ending, ros_process, spin
    from softsim_ros.client import RunningRobot, running_robot
    from softsim_ros.recording import Recorder

    robot, namespace = arguments.robot, arguments.namespace
    if robot is None:
        found = running_robot(namespace) or RunningRobot(namespace or DEFAULT, namespace or DEFAULT)
        robot, namespace = Path(found.robot).stem, found.namespace
    values = {
        "robot": robot,
        "out": arguments.out,
        "topics": " ".join(arguments.topic),
        "size_limit": arguments.size_limit,
        "time_limit": arguments.time_limit,
    }
    with ros_process():
        recorder = Recorder(
            namespace=namespace,
            parameter_overrides=[Parameter(name, value=value) for name, value in values.items()],
            news=lambda message: print(message, flush=True),
        )
        try:
            executor = SingleThreadedExecutor()
            executor.add_node(recorder)
            spin(executor, lambda: recorder.recording and not ending.asked)
        finally:
            recorder.close()
    if recorder.failure is not None:
        raise CommandError(str(recorder.failure))
    return 0
