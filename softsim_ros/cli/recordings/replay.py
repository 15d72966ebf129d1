"""`softsim replay BAG`: publish its messages with their timing, for a viewer or for a running simulator."""

from __future__ import annotations

import argparse
from pathlib import Path

from softsim_ros.cli import UsageError, add_number


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("bag", type=Path, help="folder of a recording, or an .mcap or .db3 file")
    parser.add_argument(
        "--commands", action="store_true", help="only what moves joints, into a simulator that runs"
    )
    parser.add_argument("--reset", action="store_true", help="with --commands: reset the simulator first")
    add_number(parser, "--speed", 1.0, "F", "times faster (1.0)")
    parser.add_argument("--loop", action="store_true", help="again and again, until Ctrl-C")
    add_number(parser, "--start", 0.0, "S", "leave out the first seconds")
    parser.add_argument("--namespace", metavar="NAME", help="replay into another namespace")
    parser.epilog = "Pause and continue: service NAMESPACE/replay/pause. Speed: its parameter speed."


def run(arguments: argparse.Namespace) -> int:
    """Play until the end, or until Ctrl-C."""
    if not 0.001 <= arguments.speed <= 1000.0:
        raise UsageError("--speed must lie between 0.001 and 1000")
    if not arguments.start >= 0.0:
        raise UsageError("--start must be 0 s or more")
    if arguments.reset and not arguments.commands:
        raise UsageError("--reset needs --commands")
    from rclpy.executors import SingleThreadedExecutor

    from softsim_node import ending, ros_process
    from softsim_ros.recording import Bag, Replay

    with Bag(arguments.bag) as bag, ros_process():
        replay = Replay(
            bag,
            namespace=arguments.namespace,
            commands_only=arguments.commands,
            speed=arguments.speed,
            start_s=arguments.start,
        )
        try:
            executor = SingleThreadedExecutor()
            executor.add_node(replay)
            replay.prepare(executor, reset=arguments.reset)
            print(f"playing {arguments.bag} ({bag.duration_s:.1f} s) in {replay.get_namespace()}", flush=True)
            replay.play(executor)
            while arguments.loop and not ending.asked:
                replay.play(executor)
        finally:
            print(f"{replay.sent} messages sent", flush=True)
            replay.close()
    return 0
