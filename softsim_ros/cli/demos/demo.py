"""`softsim demo NAME`: run a robot that is driven through topics alone.

grasp: the cable gripper lifts a cube, holds it and puts it down. pick_and_place: on an arm, it moves three
objects from one tray to another.
"""

from __future__ import annotations

import argparse
import contextlib
import pkgutil
import sys
import time
from typing import TYPE_CHECKING, Final

from softsim_node import ending
from softsim_ros.cli import CommandError, UsageError

if TYPE_CHECKING:
    from softsim_ros.cli.demos.show import Show
    from softsim_ros.client import RobotSession

DEMOS: Final = {
    "grasp": "softsim_ros.cli.demos.grasp:Grasp",
    "pick_and_place": "softsim_ros.cli.demos.pick_and_place:PickAndPlace",
}
"""Class of each demo; built with a node and a client, it is a Show."""

PATIENCE_S = 60.0
"""Longest time in [s] without a new message of the simulator."""

LOOK_PERIOD_S = 0.05


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("name", choices=tuple(DEMOS), help="which demo")
    parser.add_argument("--robot", help="a name or a file in the place of the demo's own")
    parser.add_argument(
        "--speed", type=float, default=1.0, help="simulated seconds per second; 0 is as fast as possible (1)"
    )
    parser.add_argument("--check", action="store_true", help="exit code 1 when it misses its marks")
    parser.epilog = "`softsim run viewer --ros-args -p robot:=cable_gripper` in another terminal shows it."


def run(arguments: argparse.Namespace) -> int:
    """Simulate, send the plan, print the measurements."""
    if not 0.0 <= arguments.speed <= 1000.0:
        raise UsageError("--speed must be between 0 and 1000")
    from rclpy.parameter import Parameter

    from softsim_core.scene import load_scene
    from softsim_node import GuardedNode, ros_process
    from softsim_ros import SpinThread
    from softsim_ros.cli.running import only_one
    from softsim_ros.client import RobotClient, RobotSession
    from softsim_ros.nodes.simulator import Simulator

    show_class = pkgutil.resolve_name(DEMOS[arguments.name])
    scene = load_scene(arguments.robot or show_class.robot)
    parameters = [Parameter("publish_clock", value=True), Parameter("speed", value=arguments.speed)]
    results: tuple[list[str], bool] | None = None
    with only_one(scene.name), ros_process(), contextlib.ExitStack() as stack:
        simulator = Simulator(scene, parameter_overrides=parameters)
        stack.callback(simulator.close)
        node = GuardedNode(arguments.name, namespace=simulator.get_namespace())
        stack.callback(node.close)
        client = RobotClient(node, scene)
        show: Show = show_class(node, client)
        stack.enter_context(SpinThread([simulator]))
        robot = RobotSession(client, stack.enter_context(SpinThread([node])))
        if _play(show, robot):
            results = show.report_results()
    if results is None:
        if not ending.asked:
            raise CommandError("the simulator has stopped; see its messages above")
        print("softsim demo: ended before the plan was done", file=sys.stderr)
        return 0
    lines, passed = results
    print("\n".join(lines))
    print(f"{arguments.name}: {'passed' if passed else 'missed its marks'}")
    return int(arguments.check and not passed)


def _play(show: Show, robot: RobotSession) -> bool:
    """Send the plan and wait until it is done; return False if the simulator went silent, or on Ctrl-C."""
    phase, message_count, last_message_s = "", 0, time.monotonic()
    while show.elapsed < show.duration_s:
        if show.is_ready and show.began is None:
            robot.do(show.begin)
        if show.began is not None and show.phase != phase:
            phase = show.phase
            print(f"{phase} ...", flush=True)
        if show.message_count > message_count:
            message_count, last_message_s = show.message_count, time.monotonic()
        elif time.monotonic() - last_message_s > PATIENCE_S or ending.asked or not robot.is_running:
            return False
        time.sleep(LOOK_PERIOD_S)
    return True
