"""Decide which nodes a launch of one robot starts, and with which parameters.

The launch file of softsim_bringup calls `plan` and passes each node to launch_ros; nothing here needs launch.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Final

from softsim_core import RobotDescription, load_scene
from softsim_core.base import ConfigError, one_of, runtime_folder, write_file
from softsim_node import prefix_of
from softsim_ros.description import CONTROLLER, controllers, rviz_config

SWITCH: Final = ("false", "true")
BOARDS: Final = ("auto", "virtual", "emulated", "real", "none")
SOURCES: Final = ("joint_states", "commands", "joint_commands")
AUTOSTARTS: Final = ("none", "configure", "activate")


def _word(default: str, about: str, *choices: str) -> str:
    word: str = field(default=default, metadata={"about": about, "choices": choices})
    return word


@dataclass(frozen=True, slots=True)
class LaunchArguments:
    """The arguments of a launch, all of them text; `metadata` has the description and the choices of each."""

    robot: str = _word("tripod", "robot or scene: a name, or the path of its file")
    namespace: str = _word("", "namespace of all its nodes; empty: the robot's name")
    board: str = _word("auto", "servo board; auto: real where a port is given, else virtual", *BOARDS)
    port: str = _word("", "serial port of a real board; empty: the one that is plugged in")
    source: str = _word("joint_states", "what the servos follow", *SOURCES)
    autostart: str = _word(
        "configure", "how far the bridge goes: configure opens the port, activate sends", *AUTOSTARTS
    )
    inverse: str = _word("false", "with inverse control, disabled until key I", *SWITCH)
    viewer: str = _word("false", "with the web page", *SWITCH)
    control: str = _word("false", "with ros2_control's joint trajectory controller", *SWITCH)
    rviz: str = _word("false", "show the robot in RViz", *SWITCH)
    enclaves: str = _word("false", "each node in its enclave of SROS 2, /NAMESPACE/EXECUTABLE", *SWITCH)


@dataclass(frozen=True, slots=True)
class PlannedNode:
    """A node to start.

    Attributes:
        package: ROS package of its executable.
        executable: Name of the executable.
        parameters: Its parameters.
        arguments: Arguments of its command line.
        parameter_file: File of more parameters; None: none.
        ends_all: Whether the launch ends with it.
        enclave: Path of its enclave of SROS 2; empty: the common one.
    """

    package: str
    executable: str
    parameters: Mapping[str, str | float] = field(default_factory=dict)
    arguments: tuple[str, ...] = ()
    parameter_file: Path | None = None
    ends_all: bool = False
    enclave: str = ""


@dataclass(frozen=True, slots=True)
class Plan:
    """A launch: the namespace, its nodes, and a hint on how to drive the robot."""

    namespace: str
    nodes: tuple[PlannedNode, ...]
    hint: str


def plan(arguments: LaunchArguments, folder: Path) -> Plan:
    """Return the nodes to start.

    Args:
        arguments: The arguments of the launch.
        folder: Folder for the files of RViz and of the controllers, if these are requested.

    Raises:
        SoftSimError: the robot is unknown, or the arguments are inconsistent.
    """
    for each in fields(LaunchArguments):
        choices, word = each.metadata["choices"], getattr(arguments, each.name)
        if choices and word not in choices:
            raise ConfigError("launch", f"argument {each.name}", f"{word!r} is not {one_of(word, choices)}")
    robot = load_scene(arguments.robot)
    namespace = arguments.namespace.strip("/") or robot.namespace
    shared: dict[str, str | float] = {"robot": arguments.robot}
    nodes = [PlannedNode("softsim_ros", "simulator", shared, ends_all=True)]
    nodes += _hardware(arguments, robot, namespace)
    for name, is_requested in (("inverse_controller", arguments.inverse), ("viewer", arguments.viewer)):
        nodes += [PlannedNode("softsim_ros", name, shared)] if is_requested == "true" else []
    if arguments.control == "true":
        file = folder / "controllers.yaml"
        write_file(file, controllers(robot, namespace))
        spawned = (CONTROLLER, "--param-file", str(file))
        nodes += [
            PlannedNode("controller_manager", "ros2_control_node", parameter_file=file, ends_all=True),
            PlannedNode("controller_manager", "spawner", arguments=spawned),
        ]
    if arguments.rviz == "true":
        file = folder / "view.rviz"
        write_file(file, rviz_config(robot, prefix_of(namespace)))
        nodes.append(PlannedNode("rviz2", "rviz2", arguments=("-d", str(file))))
    teleop = f"ros2 run softsim_ros teleop --ros-args -p robot:={arguments.robot} -r __ns:=/{namespace}"
    if arguments.enclaves == "true":
        teleop += f" --enclave /{namespace}/teleop"
        nodes = [replace(node, enclave=f"/{namespace}/{node.executable}") for node in nodes]
    return Plan(namespace, tuple(nodes), f"drive it from another terminal: {teleop}")


def board_link(namespace: str) -> Path:
    """Return the link to the port of a board that is a program, in a folder of this user alone."""
    name = namespace.strip("/").replace("/", "_")
    return runtime_folder() / f"softsim_{os.getuid()}_{name}_board"


def _hardware(arguments: LaunchArguments, robot: RobotDescription, namespace: str) -> list[PlannedNode]:
    """Return the bridge and its board; neither for a robot without servos."""
    servos = robot.board.servos if robot.board else ()
    board = arguments.board
    if board == "auto":
        board = "none" if not servos else "real" if arguments.port else "virtual"
    if board == "none":
        return []
    if not servos:
        reason = f"{robot.name} has no servo board; leave board out, or give none"
        raise ConfigError("launch", "argument board", reason)
    if arguments.port and board != "real":
        raise ConfigError("launch", "argument port", f"belongs to board:=real, not to {board}; leave one out")
    link, port, quiet, nodes = str(board_link(namespace)), arguments.port, dict[str, str | float](), []
    if board != "real":
        port = link
        values: dict[str, str | float] = {"link": link}
        if robot.board is not None and robot.board.bus_servos:
            board = "virtual"  # it emulates such servos; the emulated board is firmware for hobby servos
        if board == "virtual":
            values |= {"robot": arguments.robot}
            quiet = {"open_wait_s": 0.0}  # a virtual board has no boot loader to wait for
        nodes.append(PlannedNode("servo_bridge", f"{board}_board", values, ends_all=True))
    parameters = {
        "robot": arguments.robot,
        "port": port,
        "source": arguments.source,
        "autostart": arguments.autostart,
    }
    bridge = PlannedNode("servo_bridge", "servo_bridge", {**parameters, **quiet}, ends_all=True)
    return [*nodes, bridge]
