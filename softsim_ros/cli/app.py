"""The `softsim` program: find the subcommand, set the environment, run it, report errors."""

from __future__ import annotations

import os
import sys
import textwrap
from collections.abc import Mapping, Sequence
from typing import Final

from softsim_core import __version__
from softsim_core.base import SoftSimError, install_command, known_names, nearest
from softsim_node import check_ros_variables, ending, limit_blas_threads, prepare_environment
from softsim_ros.cli.command import EXIT_INTERRUPTED, Colours, Command, CommandError, Parser
from softsim_ros.cli.completion import ASKED, complete

ROS_PACKAGES: Final = (
    "rclpy", "ament_index_python", "builtin_interfaces", "diagnostic_msgs", "geometry_msgs", "lifecycle_msgs",
    "nav_msgs", "rcl_interfaces", "rosgraph_msgs", "sensor_msgs", "shape_msgs", "std_msgs",
    "std_srvs", "trajectory_msgs", "visualization_msgs",
)  # fmt: skip

BROUGHT_BY: Final[Mapping[str, str]] = {
    **dict.fromkeys(ROS_PACKAGES, "ros"),
    **dict.fromkeys(("viser", "websockets", "imageio", "PIL", "cmap", "msgspec"), "viewer"),
    **dict.fromkeys(("rosbags", "lz4"), "recording"),
    "matplotlib": "report",
    "c3d": "c3d",
    **dict.fromkeys(("pytetwild", "fast_simplification"), "mesh"),
    "urdf_parser_py": "arm",
    "argcomplete": "completion",
    "mujoco": "mujoco",
    "gymnasium": "learn",
    "onnxruntime": "policy",
    **dict.fromkeys(("onnx", "stable_baselines3"), "train"),
    **dict.fromkeys(
        ("dask", "distributed", "bokeh", "cryptography", "zarr", "xarray", "pyarrow", "cma"), "study"
    ),
    "pydrake": "peers",
    "pytest": "test",
}
"""The extra that installs a module, by the module's first name."""

_WHERE: Final = {
    "ros": ", which exists for x86-64 Linux; elsewhere take a ROS 2 Jazzy of the system",
    "study": ", Python 3.11 or newer",
}


def what_is_missing(error: ImportError) -> str | None:
    """Return which package is missing and how to install it, or None if no extra installs it."""
    module = (error.name or "").partition(".")[0]
    extra = BROUGHT_BY.get(module)
    if extra is None:
        return None
    package = f"ROS 2 ({module})" if extra == "ros" else module
    return f"{package} is not installed; {install_command(extra)}{_WHERE.get(extra, '')}"


COMMANDS = {
    "up": Command("running.up", "simulate a robot, bridge it to a board, drive it from this terminal"),
    "run": Command("running.run", "run one ROS node by its name: softsim run NODE --ros-args ..."),
    "topics": Command("graph.topics", "list the live topics, print their messages, measure their rate"),
    "record": Command("recordings.record", "record a robot's topics into a bag (rosbag2, MCAP)"),
    "replay": Command("recordings.replay", "play a bag again, whole or only its commands"),
    "export": Command("recordings.export", "turn a bag into CSV, VTU (ParaView) and a replay page"),
    "report": Command("recordings.report", "one web page about a bag: charts and the moving picture"),
    "scenes": Command("robots.scenes", "list the robots and scenes that are known by name"),
    "material": Command(
        "robots.material", "list elastomers; draw one's curve, say its stiffness and a time step"
    ),
    "mesh": Command(
        "robots.mesh", "fill a part (STL, OBJ, PLY, OFF) with tetrahedra, say what they are worth"
    ),
    "new": Command("robots.new", "make a robot of a part: softsim new my_finger --from part.stl"),
    "mjcf": Command("robots.mjcf", "make a scene of a MuJoCo model, run it in both, make a model of a scene"),
    "urdf": Command("robots.urdf", "print or write a robot's URDF, for RViz, MoveIt, ros2_control"),
    "doctor": Command("upkeep.doctor", "say what is installed, which port, which ROS, and what to do"),
    "flash": Command("board.flash", "put the firmware onto the servo board (avrdude)"),
    "calibrate-servos": Command(
        "board.calibrate_servos", "walk through a robot's servos: direction, mounting, range"
    ),
    "workspace": Command("robots.workspace", "say how far a robot's effector gets, with a picture"),
    "excite": Command(
        "measurements.excite", "move a robot to measure it: a data set for validate and calibrate"
    ),
    "validate": Command(
        "measurements.validate", "compare a model with measurements of the real robot, in mm"
    ),
    "calibrate": Command(
        "measurements.calibrate",
        "find parameters of a model from measurements, and what they do not determine",
    ),
    "league": Command("measurements.league", "compare all models of the measured robots in one table"),
    "sweep": Command("studies.sweep", "run a scene many times with values that vary; draw the results"),
    "optimise": Command(
        "studies.optimise", "find the values of a study at which its objective is best (CMA-ES)"
    ),
    "demo": Command("demos.demo", "show a robot at work: softsim demo grasp, pick_and_place"),
    "bench": Command("upkeep.bench", "measure the speed of a simulation step on this machine"),
    "test": Command("upkeep.suite", "run the test suite (--quick: under two minutes)", passes_on=True),
    "completion": Command("completion", "have Tab complete in bash, zsh or fish"),
}
USES_ROS = ("up", "run", "topics", "record", "replay", "excite", "demo")
"""Commands that import rclpy, which some environment variables would make fail."""

GROUPS = {
    "start here": ("up", "demo", "scenes", "new", "doctor"),
    "robots and parts": ("material", "mesh", "mjcf", "urdf", "workspace"),
    "ROS": ("run", "topics"),
    "recordings": ("record", "replay", "export", "report"),
    "measure and fit": ("excite", "validate", "calibrate", "league"),
    "many runs": ("sweep", "optimise"),
    "a real board": ("flash", "calibrate-servos"),
    "this suite": ("bench", "test", "completion"),
}
"""Commands in the order of the overview; commands in no group come last."""

EXIT_CODES = {
    0: "done",
    1: "refused or failed, with one message",
    2: "wrong usage",
    124: "a time limit was reached (softsim test)",
    130: "interrupted before it was done (Ctrl-C)",
}
EXIT_USAGE = 2

_LINE = 100
"""Columns of the overview."""


def _groups() -> dict[str, tuple[str, ...]]:
    grouped = {name for names in GROUPS.values() for name in names}
    more = tuple(name for name in COMMANDS if name not in grouped)
    return {**GROUPS, "more": more} if more else GROUPS


def _overview(whole: bool) -> str:
    """Return the help of `softsim`: commands for newcomers and names of the others; or a line on each."""
    colour, width = Colours(sys.stdout), max(map(len, COMMANDS))
    (first, newcomers), *others = _groups().items()

    def lines(names: tuple[str, ...]) -> list[str]:
        return [f"  {colour('bold', f'{name:<{width}}')}  {COMMANDS[name].help}" for name in names]

    text_lines = ["usage: softsim COMMAND [options]", "", "Soft-robot simulation and control for ROS 2.", ""]
    text_lines += [f"{first}: softsim up tripod", *lines(newcomers), ""]
    if whole:
        for title, names in others:
            text_lines += [f"{title}:", *lines(names), ""]
        text_lines += [
            "exit codes:",
            *(f"  {code:<{width}}  {text}" for code, text in EXIT_CODES.items()),
            "",
        ]
    else:
        indent = max(len(title) for title, _ in others) + 4
        for title, names in others:
            text = f"  {title + ':':<{indent - 2}}{', '.join(names)}"
            text_lines += textwrap.wrap(text, _LINE, subsequent_indent=" " * indent, drop_whitespace=False)
        text_lines += ["", "a line on each: softsim --help"]
    text_lines += ["more on one: softsim COMMAND --help", "which version: softsim --version"]
    text_lines += [
        "./softsim makes its own Python environment the first time a command runs (a minute, 1 GB)."
    ]
    return "\n".join(text_lines)


def _dispatch(words: Sequence[str]) -> int:
    if not words or words[0] in ("-h", "--help"):
        print(_overview(whole=bool(words)))
        return 0
    name = words[0]
    if name == "--version":
        print(f"softsim {__version__}")
        return 0
    if name not in COMMANDS:
        from softsim_core.scene.io import known_scenes

        near = known_names(name, COMMANDS, "known commands:", lists_all="softsim --help")
        if scene := next(iter(nearest(name, known_scenes())), ""):
            near += f"; to run the robot: softsim up {scene}"
        print(f"softsim: unknown command '{name}'; {near}", file=sys.stderr)
        return EXIT_USAGE
    command = COMMANDS[name]
    limit_blas_threads(os.environ)
    prepare_environment()
    if name in USES_ROS:
        check_ros_variables()
    module = command.import_module()
    own = Parser(prog=f"softsim {name}", description=command.help, allow_abbrev=False)
    module.configure(own)
    if command.passes_on:
        arguments, rest = own.parse_known_args(words[1:])
        arguments.rest = rest
    else:
        arguments = own.parse_args(words[1:])
    try:
        return int(module.run(arguments))
    except CommandError as error:
        print(f"softsim {name}: {error}", file=sys.stderr)
        return error.code


def run_command(words: Sequence[str] | None = None) -> int:
    """Run the `softsim` command.

    Args:
        words: Command line without the program's name; None takes the process's own.

    Returns:
        Exit code, see EXIT_CODES.
    """
    if ASKED in os.environ:
        complete(COMMANDS)
    ending.watch()
    try:
        with ending.interruptible():
            code = _dispatch(sys.argv[1:] if words is None else words)
    except SoftSimError as error:
        print(f"{Colours(sys.stderr)('red', 'softsim:')} {error}", file=sys.stderr)
        code = 1
    except ModuleNotFoundError as error:  # of a package that only an extra installs
        message = what_is_missing(error)
        if message is None:
            raise
        print(f"{Colours(sys.stderr)('red', 'softsim:')} {message}; see softsim doctor", file=sys.stderr)
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
