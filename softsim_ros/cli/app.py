"""The `softsim` program: finds the subcommand, sets the environment, runs it, says errors in a sentence."""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Sequence
from typing import NamedTuple

from softsim_core.errors import SoftSimError
from softsim_node.ending import ending
from softsim_node.environment import prepare_environment


class Command(NamedTuple):
    """A subcommand, imported when used: its module has `configure(parser)` and `run(arguments) -> int`.

    Attributes:
        module: Name of the module.
        help: One line for `softsim --help`.
        passes_on: Arguments it does not know are left to it in `arguments.rest`.
    """

    module: str
    help: str
    passes_on: bool = False


COMMANDS = {
    "up": Command(
        "softsim_ros.cli.up", "simulate a robot, bridge it to a board, drive it from this terminal"
    ),
    "run": Command("softsim_ros.cli.run", "run one ROS node by its name: softsim run NODE --ros-args ..."),
    "topics": Command(
        "softsim_ros.cli.topics", "list the live topics, print their messages, measure their rate"
    ),
    "record": Command("softsim_ros.cli.record", "record a robot's topics into a bag (rosbag2, MCAP)"),
    "replay": Command("softsim_ros.cli.replay", "play a bag again, whole or only its commands"),
    "export": Command("softsim_ros.cli.export", "turn a bag into CSV, VTU (ParaView) and a replay page"),
    "report": Command("softsim_ros.cli.report", "one web page about a bag: charts and the moving picture"),
    "scenes": Command("softsim_ros.cli.scenes", "list the robots and scenes that are known by name"),
    "material": Command(
        "softsim_ros.cli.material", "list elastomers; draw one's curve, say its stiffness and a time step"
    ),
    "mesh": Command(
        "softsim_ros.cli.mesh",
        "fill a part (STL, OBJ, PLY, OFF) with tetrahedra, say what they are worth",
    ),
    "new": Command("softsim_ros.cli.new", "make a robot of a part: softsim new my_finger --from part.stl"),
    "urdf": Command("softsim_ros.cli.urdf", "print or write a robot's URDF, for RViz, MoveIt, ros2_control"),
    "doctor": Command(
        "softsim_ros.cli.doctor", "say what is installed, which port, which ROS, and what to do"
    ),
    "flash": Command("softsim_ros.cli.flash", "put the firmware onto the servo board (avrdude)"),
    "calibrate-servos": Command(
        "softsim_ros.cli.calibrate_servos", "walk through a robot's servos: direction, mounting, range"
    ),
    "workspace": Command("softsim_ros.cli.workspace", "say how far a robot's effector gets, with a picture"),
    "excite": Command(
        "softsim_ros.cli.excite", "move a robot to measure it: a data set for validate and calibrate"
    ),
    "validate": Command(
        "softsim_ros.cli.validate", "compare a model with measurements of the real robot, in mm"
    ),
    "calibrate": Command(
        "softsim_ros.cli.calibrate", "find parameters of a model from measurements, and what they do not tell"
    ),
    "demo": Command("softsim_ros.cli.demo", "show a robot at work: softsim demo grasp"),
    "bench": Command("softsim_ros.cli.bench", "measure the speed of a simulation step on this machine"),
    "test": Command("softsim_ros.cli.suite", "run the test suite (--quick: under two minutes)", True),
}
EXIT_USAGE = 2
EXIT_INTERRUPTED = 130


def _overview() -> argparse.ArgumentParser:
    width = max(map(len, COMMANDS))
    lines = "\n".join(f"  {name:<{width}}  {command.help}" for name, command in COMMANDS.items())
    parser = argparse.ArgumentParser(
        prog="softsim",
        usage="softsim COMMAND [options]",
        description="Soft-robot simulation and control for ROS 2.",
        epilog=f"commands:\n{lines}\n\nstart here: softsim up tripod\nmore on one: softsim COMMAND --help\n"
        "./softsim makes its own Python environment the first time a command runs (about a minute, 1 GB).",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("command", nargs="?", help=argparse.SUPPRESS)
    return parser


def _dispatch(words: Sequence[str]) -> int:
    parser = _overview()
    if not words or words[0] in ("-h", "--help"):
        parser.print_help()
        return 0
    name = words[0]
    if name not in COMMANDS:
        parser.exit(EXIT_USAGE, f"softsim: unknown command '{name}'; known commands: {', '.join(COMMANDS)}\n")
    command = COMMANDS[name]
    prepare_environment()
    module = importlib.import_module(command.module)
    own = argparse.ArgumentParser(prog=f"softsim {name}", description=command.help, allow_abbrev=False)
    module.configure(own)
    if command.passes_on:
        arguments, rest = own.parse_known_args(words[1:])
        arguments.rest = rest
    else:
        arguments = own.parse_args(words[1:])
    return int(module.run(arguments))


def main(words: Sequence[str] | None = None) -> int:
    """Run the `softsim` command.

    Args:
        words: Command line without the program's name; None takes the process's own.

    Returns:
        Exit code: 0 done, 1 an error that was said in one sentence, 2 wrong usage, 130 interrupted.
    """
    ending.watch()
    try:
        with ending.interruptible():
            code = _dispatch(sys.argv[1:] if words is None else words)
    except SoftSimError as error:
        print(f"softsim: {error}", file=sys.stderr)
        code = 1
    except KeyboardInterrupt:
        print("softsim: interrupted", file=sys.stderr)
        code = EXIT_INTERRUPTED
    except BrokenPipeError:  # `softsim topics | head`
        sys.stderr.close()
        code = 0
    finally:
        ending.over()
    return ending.leave(code)
