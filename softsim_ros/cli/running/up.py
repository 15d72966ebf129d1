"""`softsim up ROBOT`: simulator, servo bridge and more in one process, driven from this terminal."""

from __future__ import annotations

import argparse
import contextlib
import os
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

from softsim_core.base import SoftSimError, open_lock, runtime_folder
from softsim_node import takes_escapes
from softsim_ros.cli import UsageError, add_words

VIRTUAL, EMULATED, SEARCH = "virtual", "emulated", "auto"
PAGE_HOST, PAGE_PORT = "127.0.0.1", 8080


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        "robot", nargs="?", default="tripod", help="robot or scene: a name or a file (tripod)"
    )
    parser.add_argument("--mesh", metavar="LEVEL", help="the robot on another mesh, such as mid or high")
    parser.add_argument(
        "--board",
        default=VIRTUAL,
        metavar="PORT",
        help=f"{VIRTUAL} (default), {EMULATED} (the real firmware in an emulated board),"
        f" {SEARCH} (the one that is plugged in), or a path such as /dev/ttyACM0",
    )
    parser.add_argument("--no-bridge", action="store_true", help="simulate only")
    parser.add_argument("--send", action="store_true", help="send to the board at once, without key B")
    parser.add_argument(
        "--inverse",
        action="store_true",
        help="with inverse control: key I, then the arrow keys move the goal",
    )
    parser.add_argument(
        "--policy",
        metavar="FILE",
        help="driven by a trained policy (ONNX) as soon as the robot stands at its start (key A)",
    )
    parser.add_argument(
        "--watch", action="store_true", help="reload the scene whenever one of its files is saved"
    )
    code = "Python scenes of this folder may be loaded from the page and over ROS; they run code"
    add_words(parser, "--allow-code", "DIR", code)
    parser.add_argument("--no-viewer", action="store_true", help="without the web page")
    parser.add_argument(
        "--lite", action="store_true", help="cheap light in the page, for browsers without a GPU"
    )
    parser.add_argument("--port", type=int, default=PAGE_PORT, help=f"port of the web page ({PAGE_PORT})")
    parser.add_argument(
        "--host",
        default=PAGE_HOST,
        metavar="IP",
        help=f"who reaches the page: {PAGE_HOST}, this machine (default), 0.0.0.0 the network, by token",
    )
    parser.add_argument(
        "--no-token",
        action="store_true",
        help="the page asks for no secret: every account of this machine may drive the robot",
    )
    parser.add_argument("--headless", action="store_true", help="no teleop: a status line, until Ctrl-C")
    parser.add_argument("--namespace", metavar="NAME", help="namespace of the nodes (the robot's name)")
    parser.epilog = (
        "On a real board nothing moves until key B, or --send; Enter is the e-stop. "
        "? in the teleop shows the keys."
    )


def run(arguments: argparse.Namespace) -> int:
    """Run until a key quits or Ctrl-C or SIGTERM arrives; the servos end in the safe pose."""
    import rclpy  # noqa: F401  # if it is missing, that is reported before anything starts

    from softsim_core.scene import load_scene
    from softsim_core.scene.io import known_scenes
    from softsim_node import environment, ros_process
    from softsim_ros.cli.running.web_page import PageChoice, WebPage

    robot, level = arguments.robot, arguments.mesh
    if level is not None and (level != "low" or f"{robot}_low" in known_scenes()):
        robot = f"{robot}_{level}"  # "low" is most robots' own mesh
    scene = load_scene(robot)
    namespace = (arguments.namespace or scene.name).strip("/")
    if not re.fullmatch(r"[A-Za-z_]\w*(/[A-Za-z_]\w*)*", namespace, re.ASCII):
        raise UsageError(
            f"{namespace!r} cannot be a namespace; use letters, digits and underscores, not "
            "beginning with a digit, such as tripod_2"
        )
    if scene.board is None and not arguments.no_bridge:
        print(f"{scene.name} has no section board: simulating only, without a servo bridge")
    with contextlib.ExitStack() as stack:
        stack.enter_context(only_one(namespace))
        print(f"starting {scene.name}: Ctrl-C ends it in the safe pose", flush=True)
        print(environment.describe_range(os.environ), flush=True)
        notice: Callable[[], str] = str
        if not arguments.no_viewer:
            choice = PageChoice(arguments.host, arguments.port, arguments.lite, arguments.no_token)
            notice = stack.enter_context(WebPage(scene.name, namespace, choice)).notice
        from softsim_ros.cli.running.bring_up import BoardChoice, BoardKind, BringUp  # half a second to load

        kinds = {VIRTUAL: BoardKind.VIRTUAL, EMULATED: BoardKind.EMULATED}
        has_bridge = not arguments.no_bridge and scene.board is not None
        board = BoardChoice(
            kinds.get(arguments.board, BoardKind.REAL) if has_bridge else BoardKind.NONE,
            port="" if arguments.board == SEARCH else arguments.board,
            send=arguments.send,
        )
        interactive = sys.stdin.isatty() and takes_escapes(sys.stdout) and not arguments.headless
        options = {"inverse": arguments.inverse, "watch": arguments.watch, "allow_code": arguments.allow_code}
        with (
            ros_process(),
            BringUp(scene, namespace, board, policy=arguments.policy or "", **options) as nodes,
        ):
            nodes.run(interactive and bool(scene.joints), notice)
        print(f"{scene.name}: ended", flush=True)
    return 0


class AlreadyUpError(SoftSimError, RuntimeError):
    """Another `softsim up` serves the same namespace."""


def lock_file(namespace: str) -> Path:
    """Return the lock file of a namespace in this process's ROS domain."""
    domain = os.environ.get("ROS_DOMAIN_ID", "0") or "0"
    return runtime_folder() / f"softsim-{os.getuid()}-domain-{domain}-{namespace.replace('/', '.')}.lock"


@contextlib.contextmanager
def only_one(namespace: str) -> Iterator[None]:
    """Lock the namespace for the `with` block; the system releases it even after kill -9.

    Raises:
        AlreadyUpError: another process has locked it; carries its process id.
        RuntimeFolderError: there is no private folder for the lock.
    """
    import fcntl  # not on every system whose users ask for --help

    file = lock_file(namespace)
    with open_lock(file) as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            holder = lock.read(20).strip()
            holder = holder if holder.isdecimal() else "unknown"
            raise AlreadyUpError(
                f"/{namespace} is up already (process {holder}); end that one first, or start this one under "
                f"another name: softsim up ROBOT --namespace {namespace}_2"
            ) from None
        lock.truncate(0)
        lock.write(f"{os.getpid()}\n")
        lock.flush()
        yield
