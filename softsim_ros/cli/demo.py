"""`softsim demo grasp`: the cable gripper lifts a cube, holds it and puts it down, driven on topics alone."""

from __future__ import annotations

import argparse
import contextlib
import sys
import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from softsim_ros.cli.grasp import Grasp, GraspResult
    from softsim_ros.client.session import RobotSession

PATIENCE_S = 60.0
"""The simulator must send something new within this time, in [s]."""

LOOK_PERIOD_S = 0.05


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("name", choices=("grasp",), help="which demo")
    parser.add_argument("--robot", default="cable_gripper", help="gripper to use: a name or a file")
    parser.add_argument(
        "--speed", type=float, default=1.0, help="simulated seconds per second; 0 is as fast as possible (1)"
    )
    parser.add_argument("--check", action="store_true", help="exit code 1 when the grasp misses its marks")
    parser.epilog = "`softsim run viewer --ros-args -p robot:=cable_gripper` in another terminal shows it."


def run(arguments: argparse.Namespace) -> int:
    """Simulate, send the plan, print what was measured."""
    if not 0.0 <= arguments.speed <= 1000.0:
        print("softsim demo: --speed must be between 0 and 1000", file=sys.stderr)
        return 2
    try:
        import rclpy  # noqa: F401
    except ImportError as error:
        print(f"softsim demo: ROS 2 is not installed here ({error}); see softsim doctor", file=sys.stderr)
        return 1
    from rclpy.parameter import Parameter

    from softsim_core.scene import load_scene
    from softsim_node.process import ros_process
    from softsim_ros.cli.grasp import ALLOWED_SLIP, NEEDED_LIFT, Grasp
    from softsim_ros.cli.one_at_a_time import only_one
    from softsim_ros.client.robot_client import RobotClient
    from softsim_ros.client.session import RobotSession
    from softsim_ros.runtime import ClosableNode, SpinThread
    from softsim_ros.simulator.simulator_node import Simulator

    scene = load_scene(arguments.robot)
    parameters = [Parameter("publish_clock", value=True), Parameter("speed", value=arguments.speed)]
    result: GraspResult | None = None
    with only_one(scene.name), ros_process(), contextlib.ExitStack() as stack:
        simulator = Simulator(scene, parameter_overrides=parameters)
        stack.callback(simulator.close)
        node = ClosableNode("grasp", namespace=simulator.get_namespace())
        stack.callback(node.close)
        client = RobotClient(node, scene)
        grasp = Grasp(node, client)
        stack.enter_context(SpinThread([simulator]))
        robot = RobotSession(client, stack.enter_context(SpinThread([node])))
        if _play(grasp, robot):
            result = grasp.result()
    if result is None:
        return _unfinished()
    print(f"lifted {1e3 * result.lift:.1f} mm clear of the floor (at least {1e3 * NEEDED_LIFT:.0f})")
    print(
        f"held {result.held:.1f} s, slipped {1e3 * result.slip:.3f} mm (at most {1e3 * ALLOWED_SLIP:.0f}), "
        f"largest tension {result.tension:.2f} N"
    )
    print(f"put down, {1e3 * result.returned:.2f} mm above the floor")
    print("grasp: passed" if result.passed else "grasp: missed its marks")
    return int(arguments.check and not result.passed)


def _unfinished() -> int:
    """Say why the plan was not played to its end; returns the exit code."""
    from softsim_node.ending import ending

    if ending.asked:
        print("softsim demo: ended before the plan was done", file=sys.stderr)
        return 0
    print("softsim demo: the simulator has stopped; see its messages above", file=sys.stderr)
    return 1


def _play(grasp: Grasp, robot: RobotSession) -> bool:
    """Send the plan and watch until it is done; False when the simulator went silent, or on Ctrl-C."""
    from softsim_node.ending import ending
    from softsim_ros.cli.grasp import PLAN

    phase, heard, heard_at = "", 0, time.monotonic()
    while grasp.elapsed < PLAN[-1].time_s:
        if grasp.is_ready and grasp.began is None:
            robot.do(grasp.begin)
        if grasp.began is not None and grasp.phase != phase:
            phase = grasp.phase
            print(f"{phase} ...", flush=True)
        if len(grasp.samples) > heard:
            heard, heard_at = len(grasp.samples), time.monotonic()
        elif time.monotonic() - heard_at > PATIENCE_S or ending.asked or not robot.is_running:
            return False
        time.sleep(LOOK_PERIOD_S)
    return True
