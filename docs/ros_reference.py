"""Write docs/ros_reference.md: every topic, service and parameter, as the nodes themselves have them.

Each node is made in this process, in a domain of its own, and asked. From the checkout:
`.softsim/venv/bin/python docs/ros_reference.py`.
"""

from __future__ import annotations

import dataclasses
import os
import re
import socket
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from itertools import chain
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).resolve().parent
sys.path.insert(0, str(FOLDER.parent))

import rclpy  # noqa: E402
from rclpy.context import Context  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy  # noqa: E402

from servo_bridge.nodes import bridge_node, emulated_board_node, virtual_board_node  # noqa: E402
from softsim_core import load_scene  # noqa: E402
from softsim_node import Program, parameters_of  # noqa: E402
from softsim_ros.nodes.inverse import closed_loop_node, inverse_node, path_follower_node  # noqa: E402
from softsim_ros.nodes.observer import observer_node  # noqa: E402
from softsim_ros.nodes.policy import policy_node  # noqa: E402
from softsim_ros.nodes.simulator import default_folder, simulator_node  # noqa: E402
from softsim_ros.nodes.teleop import teleop_node  # noqa: E402
from softsim_ros.recording import recorder_node  # noqa: E402

SCENES: dict[str, dict[str, Any]] = {
    "tripod": {"publish_clock": True},
    "pneu_finger": {},
    "sensed_finger": {},
    "inflated_cube": {"overrides": "sensors: [{name: air, kind: chamber, joint: air}]"},
}
"""Parameters by scene: a simulator has more topics where its scene has chambers or sensors."""

POLICY = FOLDER.parent / "examples" / "learning" / "tripod_reach.onnx"

EVERY_NODE = ("/parameter_events", "/rosout")
OF_PARAMETERS = ("parameter", "type_description")
NAMED = {r"chambers/[^/]+": "chambers/JOINT", r"sensors/[^/]+": "sensors/NAME"}

HEAD = """# Topics, services, parameters

[ros_reference.py](ros_reference.py) writes this page: it starts each node and reads its topics, services
and parameters from the graph. [interfaces.md](interfaces.md) describes what they carry and do. Names without
a leading `/` are relative to the robot's namespace (`/tripod`). *Latched*: a late subscriber also receives
the newest message. Every node also has ROS's parameter services, `/rosout` and `/parameter_events`. Topics of
tf2_msgs, and the services and actions of simulation_interfaces and control_msgs, exist only with apt's ROS 2.
"""


@dataclasses.dataclass(frozen=True, order=True)
class Row:
    """A topic or service of a node."""

    kind: str
    name: str
    type: str
    quality: str = ""


def quality(profile: Any) -> str:
    """Quality of service in words."""
    words = ["reliable" if profile.reliability == ReliabilityPolicy.RELIABLE else "best effort"]
    if profile.durability == DurabilityPolicy.TRANSIENT_LOCAL:
        words.append("latched")
    if profile.depth:
        words.append(f"depth {profile.depth}")
    return ", ".join(words)


def rows(node: Any) -> Iterator[Row]:
    """What a node has, by names relative to its namespace."""
    space = node.get_namespace().rstrip("/") + "/"

    def short(name: str) -> str:
        name = name.removeprefix(space)
        for pattern, word in NAMED.items():
            name = re.sub(pattern, word, name)
        return name

    for kind, ends in (("publishes", node.publishers), ("subscribes", node.subscriptions)):
        for end in ends:
            if end.topic_name not in EVERY_NODE:
                yield Row(kind, short(end.topic_name), _type(end.msg_type), quality(end.qos_profile))
    for name, (
        kind,
    ) in node.get_service_names_and_types():  # also those that a node of its own serves for it
        mine = name.startswith(f"{space}{node.get_name()}/")
        if mine and not any(word in name for word in OF_PARAMETERS):
            yield Row("answers", short(name), kind.replace("/srv/", "/"))


def _type(kind: type) -> str:
    """Name of a type of messages or services, as ROS's tools write it."""
    return f"{kind.__module__.split('.')[0]}/{kind.__name__}"


@contextmanager
def private() -> Iterator[Context]:
    """A context in a domain of its own; nodes keep their files in a folder that goes."""
    with tempfile.TemporaryDirectory() as folder:
        before = dict(os.environ)
        os.environ.update(ROS_LOG_DIR=folder, XDG_STATE_HOME=folder, ROS_AUTOMATIC_DISCOVERY_RANGE="OFF")
        context = Context()
        rclpy.init(context=context, domain_id=int(os.environ.get("ROS_DOMAIN_ID", "97")))
        try:
            yield context
        finally:
            context.try_shutdown()
            os.environ.clear()
            os.environ.update(before)


def overrides(**values: Any) -> list[Parameter]:
    """Values of parameters in the form of rclpy."""
    return [Parameter(name, value=value) for name, value in values.items()]


def makers(context: Context) -> Iterator[tuple[Program, list[Callable[[], Any]]]]:
    """Each program, and how its nodes are made."""
    yield (
        simulator_node.PROGRAM,
        [
            lambda scene=scene, values=values: simulator_node.Simulator(  # type: ignore[misc]
                scene, context=context, parameter_overrides=overrides(**values)
            )
            for scene, values in SCENES.items()
        ],
    )
    tripod = load_scene("tripod")
    yield teleop_node.PROGRAM, [lambda: teleop_node.Teleop(tripod, context=context)]
    robots = (
        (inverse_node, inverse_node.InverseControl),
        (path_follower_node, path_follower_node.PathFollower),
        (closed_loop_node, closed_loop_node.ClosedLoop),
    )
    for module, made in robots:
        yield module.PROGRAM, [lambda made=made: made("tripod", context=context)]  # type: ignore[misc]
    marked = overrides(marker_places="-0.02 0.0 0.03")
    yield (
        observer_node.PROGRAM,
        [lambda: observer_node.ObserverNode("tripod", context=context, parameter_overrides=marked)],
    )
    file, off = overrides(policy=str(POLICY)), overrides(autostart=False)
    yield (
        policy_node.PROGRAM,
        [lambda: policy_node.PolicyNode("tripod", context=context, parameter_overrides=file)],
    )
    yield recorder_node.PROGRAM, [lambda: recorder_node.Recorder(context=context, parameter_overrides=off)]
    at = {"context": context, "namespace": "tripod"}
    yield bridge_node.PROGRAM, [lambda: bridge_node.ServoBridge(**at)]
    yield (
        virtual_board_node.PROGRAM,
        [
            lambda robot=robot: virtual_board_node.VirtualBoardNode(  # type: ignore[misc]
                parameter_overrides=overrides(robot=robot), **at
            )
            for robot in ("tripod", "emio")
        ],
    )
    yield emulated_board_node.PROGRAM, []


def with_viewer(context: Context) -> Iterator[tuple[Program, list[Callable[[], Any]]]]:
    """The page too, where its packages are."""
    from softsim_ros.nodes.viewer import ViewerSettings, viewer_node

    with socket.create_server(("127.0.0.1", 0)) as free:
        settings = dataclasses.replace(ViewerSettings(), port=free.getsockname()[1])
    yield viewer_node.PROGRAM, [lambda: viewer_node.Viewer(load_scene("tripod"), settings, context=context)]


def parameters(program: Program) -> list[str]:
    """A row for each parameter."""
    shown = []
    for name, default, about in chain.from_iterable(map(parameters_of, program.settings)):
        value = str(default).lower() if isinstance(default, bool) else str(default) or "empty"
        fixed = "at the start" if about.fixed else "any time"
        shown.append(f"| `{name}` | `{value}` | {about.describe_allowed(default)} | {fixed} | {about.text} |")
    return shown


def section(program: Program, found: set[Row]) -> str:
    """All of a node."""
    blocks = [f"## {program.name}", program.about]
    ends = sorted(row for row in found if row.kind != "answers")
    if ends:
        lines = [f"| {row.kind} | `{row.name}` | {row.type} | {row.quality} |" for row in ends]
        blocks.append("\n".join(["| | topic | type | quality |", "|---|---|---|---|", *lines]))
    services = sorted(row for row in found if row.kind == "answers")
    if services:
        lines = [f"| `{row.name}` | {row.type} |" for row in services]
        blocks.append("\n".join(["| service | type |", "|---|---|", *lines]))
    table = parameters(program)
    if table:
        heading = ["| parameter | default | allowed | set | |", "|---|---|---|---|---|"]
        blocks.append("\n".join([*heading, *table]))
    if program.more:
        blocks.append(program.more)
    return "\n\n".join(blocks)


def page() -> str:
    """The whole page."""
    blocks = [HEAD.strip()]
    with private() as context:
        for program, nodes in chain(makers(context), with_viewer(context)):
            found: set[Row] = set()
            for make in nodes:
                with ExitStack() as ending:
                    node = make()
                    ending.callback(node.destroy_node)  # ends the bridge's e-stop too
                    ending.callback(node.close)
                    found |= set(rows(node))
            blocks.append(section(program, found))
    own = str(default_folder(os.environ))
    return "\n\n".join(blocks).replace(own, "~/.local/state/softsim") + "\n"


if __name__ == "__main__":
    (FOLDER / "ros_reference.md").write_text(page(), encoding="utf-8")
