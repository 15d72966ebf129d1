"""The policies of SROS 2: what each executable publishes, hears, answers and asks, read from the graph.

`PYTHONPATH=. python tests/access_policies.py` starts every node and writes the policies of softsim_bringup
anew; a test holds these files against the same graph.
"""

from __future__ import annotations

import re
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

from node_processes import private_ros, spin_until

ROBOT = "tripod"
FOLDER = Path(__file__).resolve().parents[1] / "ros2_ws" / "src" / "softsim_bringup" / "security"
VERSION = "0.2.0"
RULES = {
    "publish": ("topics", "topic"),
    "subscribe": ("topics", "topic"),
    "reply": ("services", "service"),
    "request": ("services", "service"),
}
"""Verbs of a policy, each with the elements that it stands in."""

POLICY = Path(__file__).resolve().parents[1] / "examples" / "learning" / "tripod_reach.onnx"

SETTLED_LOOKS = 800
"""Nodes that declare nothing new for so many looks (4 s where nothing is paused) have declared all."""


class Right(NamedTuple):
    """One line of a policy: an executable's node may do something with a topic or a service."""

    executable: str
    node: str
    verb: str
    name: str


ACTION = "joint_trajectory_controller/follow_joint_trajectory/_action"
ELSEWHERE = {
    Right("simulator", "simulator", verb, name)
    for verb, names in {
        "publish": ("/tf", "/tf_static", f"{ACTION}/feedback", f"{ACTION}/status"),
        "subscribe": ("servo_bridge/e_stop_latched",),
        "reply": (
            *(f"{ACTION}/{name}" for name in ("send_goal", "cancel_goal", "get_result")),
            *(f"~/{name}_{what}" for name in ("get", "set") for what in ("entity_state", "simulation_state")),
            *(f"~/{name}" for name in ("get_entities", "get_simulator_features", "get_spawnables")),
            *(f"~/{name}_entity" for name in ("spawn", "delete")),
            *(f"~/{name}_simulation" for name in ("reset", "step")),
        ),
    }.items()
    for name in names
} | {
    Right("virtual_board", "virtual_board", "publish", "~/servo_pulses"),
    *(Right("policy", "policy", "subscribe", name) for name in ("bodies/poses", "imu")),
    *(Right("observer", "observer", "publish", name) for name in ("/tf", "/tf_static")),
}
"""Declared where the optional message packages are installed, see softsim_ros.optional_messages; and of a
robot with servos on a bus, and by policies of tasks that look at more."""

EVERYTHING = {"recorder"}
"""Executables that hear all topics of their namespace, and those that all robots share."""

SHARED = ("/diagnostics", "/tf", "/tf_static")


OF_A_ROBOT = re.compile(r"(?<=^chambers/)\w+(?=/pressure$)|(?<=^sensors/)\w+")
"""What a name has from the robot's own file: the policies allow any word there."""


def relative(name: str, namespace: str, node: str) -> str:
    """A name as the node itself would give it: ~/x, x in its namespace, or absolute."""
    for begin, short in ((f"{namespace}/{node}/", "~/"), (f"{namespace}/", "")):
        if name.startswith(begin):
            return short + OF_A_ROBOT.sub("*", name.removeprefix(begin))
    return name


def rights(observer: Any) -> set[Right]:
    """What the nodes of the graph have declared, by their enclaves, which end in the executable's name."""
    from rclpy.node import NodeNameNonExistentError

    ask = {
        "publish": observer.get_publisher_names_and_types_by_node,
        "subscribe": observer.get_subscriber_names_and_types_by_node,
        "reply": observer.get_service_names_and_types_by_node,
        "request": observer.get_client_names_and_types_by_node,
    }
    found = set()
    for node, namespace, enclave in observer.get_node_names_and_namespaces_with_enclaves():
        executable = enclave.rpartition("/")[2]
        for verb, names_of in ask.items() if executable else ():
            try:
                names = [name for name, _ in names_of(node, namespace)]
            except NodeNameNonExistentError:  # just gone, or not known whole
                continue
            found |= {Right(executable, node, verb, relative(name, namespace, node)) for name in names}
    return found


def wanted(declared: set[Right]) -> set[Right]:
    """The rights of policies: what was declared here, and what is declared elsewhere."""
    named = {right for right in declared if right[0] not in EVERYTHING or right.verb != "subscribe"}
    nodes = {right[:2] for right in declared}
    clocks = {Right(*node, "subscribe", "/clock") for node in nodes}  # with use_sim_time
    hearers = {node for node in nodes if node[0] in EVERYTHING}
    heard = {Right(*node, "subscribe", name) for node in hearers for name in ("*", *SHARED)}
    return named | clocks | heard | {right for right in ELSEWHERE if right[:2] in nodes}


# --- files ----------------------------------------------------------------------------------------


def write_policies(folder: Path, allowed: set[Right]) -> None:
    """One file for each executable, in place of those that are there."""
    folder.mkdir(exist_ok=True)
    for old in folder.glob("*.xml"):
        old.unlink()
    for executable in sorted({right.executable for right in allowed}):
        own = [right for right in sorted(allowed) if right.executable == executable]
        root = ElementTree.Element("policy", version=VERSION)
        enclaves = ElementTree.SubElement(root, "enclaves")
        enclave = ElementTree.SubElement(enclaves, "enclave", path=f"/{ROBOT}/{executable}")
        profiles = ElementTree.SubElement(enclave, "profiles")
        for node in dict.fromkeys(right.node for right in own):
            profile = ElementTree.SubElement(profiles, "profile", ns=f"/{ROBOT}", node=node)
            for verb, (group, kind) in RULES.items():
                names = [right.name for right in own if (right.node, right.verb) == (node, verb)]
                listed = ElementTree.SubElement(profile, group, {verb: "ALLOW"}) if names else None
                for name in names:
                    ElementTree.SubElement(listed, kind).text = name
        ElementTree.indent(root)
        (folder / f"{executable}.xml").write_text(
            f'<?xml version="1.0" encoding="UTF-8"?>\n{ElementTree.tostring(root, "unicode")}\n'
        )


def read_policies(folder: Path) -> set[Right]:
    """What the files of a folder allow."""
    allowed = set()
    for file in folder.glob("*.xml"):
        for enclave in ElementTree.parse(file).getroot().iterfind("enclaves/enclave"):
            for profile in enclave.iterfind("profiles/profile"):
                for group in profile:
                    (verb,) = (name for name, value in group.items() if value == "ALLOW")
                    who = enclave.attrib["path"].rpartition("/")[2], profile.attrib["node"]
                    allowed |= {Right(*who, verb, str(each.text)) for each in group}
    return allowed


# --- nodes ----------------------------------------------------------------------------------------


class Running:
    """Nodes in this process, each in a context and an enclave of its own, as its executable would be."""

    def __init__(self, ending: ExitStack) -> None:
        self._ending, self._count = ending, 0

    def __call__(self, executable: str, make: Callable[..., Any], **parameters: Any) -> Any:
        """Start a node; `make` gets rclpy's options of nodes. Each has a namespace of its own."""
        from rclpy.context import Context
        from rclpy.parameter import Parameter

        from softsim_ros import SpinThread

        self._count += 1
        context = Context()
        context.init(args=["--ros-args", "--enclave", f"/{ROBOT}/{executable}"])
        self._ending.callback(context.try_shutdown)
        overrides = [Parameter(name, value=value) for name, value in parameters.items()]
        options = {"context": context, "namespace": f"/n{self._count}", "parameter_overrides": overrides}
        node = make(**options)
        self._ending.callback(node.destroy_node)
        if hasattr(node, "close"):
            self._ending.callback(node.close)
        self._ending.enter_context(SpinThread([node], context))
        return node


@contextmanager
def every_node(folder: Path, *, emulated: bool) -> Iterator[None]:
    """All nodes of the suite, with each choice that changes what they declare.

    Args:
        folder: For links to ports, bags and a scene.
        emulated: With the emulated board, which needs libsimavr.
    """
    from tcp_ports import free_port

    from servo_bridge.nodes import EmulatedBoardNode, ServoBridge, VirtualBoardNode
    from softsim_core import load_scene
    from softsim_ros.nodes.inverse import ClosedLoop, InverseControl, PathFollower
    from softsim_ros.nodes.observer import ObserverNode
    from softsim_ros.nodes.policy import PolicyNode
    from softsim_ros.nodes.simulator import Simulator
    from softsim_ros.nodes.teleop import Teleop
    from softsim_ros.nodes.viewer import Viewer, ViewerSettings
    from softsim_ros.recording import Recorder

    tripod = load_scene(ROBOT)
    shown = folder / "shown.yaml"
    view = "{nodes: true, collisions: true, tensions: true}"
    shown.write_text(f"extends: {tripod.source}\nname: tripod\nview: {view}\n")
    felt = folder / "felt.yaml"
    sensor = "{name: air, kind: chamber, joint: air}"
    felt.write_text(f"extends: {load_scene('inflated_cube').source}\nsensors: [{sensor}]\n")
    with ExitStack() as ending:
        start = Running(ending)
        start("simulator", Simulator, backend="scipy", publish_clock=True, snapshot_folder=str(folder))
        start("simulator", Simulator, robot=str(felt), backend="scipy", snapshot_folder=str(folder))
        start("inverse_controller", InverseControl)
        start("path_follower", PathFollower)
        if find_spec("onnxruntime") is not None:
            start("policy", PolicyNode, policy=str(POLICY))
        start("observer", ObserverNode, marker_places="-0.02 0.0 0.03")
        for measure in ("imu", "effector_pose"):
            start("closed_loop", ClosedLoop, measure=measure)
        for source in ("joint_states", "commands", "joint_commands"):
            port = str(folder / f"port_{source}")
            start("virtual_board", VirtualBoardNode, link=port)
            bridge = {"port": port, "source": source, "autostart": "configure", "open_wait_s": 0.0}
            start("servo_bridge", ServoBridge, **bridge)
        if emulated:
            start("emulated_board", EmulatedBoardNode)
        start("teleop", lambda **options: Teleop(tripod, **options))
        page = ViewerSettings(port=free_port())
        start("viewer", lambda **options: Viewer(load_scene(shown), page, **options))
        start("recorder", Recorder, out=str(folder / "bag"))
        yield


def settled_rights(expected: set[Right], *, emulated: bool) -> set[Right]:
    """The rights that all nodes need; waits until they are as `expected`, or nothing new is declared."""
    import rclpy
    from rclpy.context import Context

    from softsim_node import prepare_environment

    prepare_environment()
    with tempfile.TemporaryDirectory() as name, private_ros(Path(name)):
        context = Context()
        context.init()
        observer = rclpy.create_node("observer", context=context)
        found: set[Right] = set()
        unchanged = 0

        def all_told() -> bool:
            nonlocal unchanged
            new = wanted(rights(observer)) - found
            found.update(new)
            unchanged = 0 if new else unchanged + 1
            return found == expected or unchanged > SETTLED_LOOKS

        try:
            with every_node(Path(name), emulated=emulated):
                spin_until(all_told)
        finally:
            observer.destroy_node()
            context.try_shutdown()
    return found


if __name__ == "__main__":
    write_policies(FOLDER, settled_rights(set(), emulated=True))
    sys.stdout.write(f"{len(list(FOLDER.glob('*.xml')))} policies in {FOLDER}\n")
