"""Random messages to all topics, services and parameters: every node lives and touches no foreign file."""

from __future__ import annotations

import importlib.util
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from waiting import DEADLINE_S

pytest.importorskip("rclpy")

from interface_packages import interface_package, why_missing
from mutations import Mutations, loaded
from node_processes import (
    REPOSITORY,
    Client,
    NodeProcess,
    ProcessGroup,
    parameter_words,
    private_ros,
    spin_until,
)
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.serialization import serialize_message
from tcp_ports import free_port

from softsim_node import STATE_QOS

pytestmark = [pytest.mark.ros, pytest.mark.slow]

NAMESPACE = "tripod"
OPTIONAL = ("control_msgs", "simulation_interfaces")
"""Packages that add an action and services, where they are or can be made."""

BOARD = "servo_bridge.nodes.virtual_board_node"
NODES = {
    "simulator": ("softsim_ros.nodes.simulator.simulator_node", {"robot": "tripod"}),
    "servo_bridge": ("servo_bridge.nodes.bridge_node", {"open_wait_s": 0.0, "autostart": "activate"}),
    "inverse_controller": ("softsim_ros.nodes.inverse.inverse_node", {"robot": "tripod"}),
    "path_follower": ("softsim_ros.nodes.inverse.path_follower_node", {}),
    "closed_loop": ("softsim_ros.nodes.inverse.closed_loop_node", {"robot": "tripod"}),
    "observer": ("softsim_ros.nodes.observer.observer_node", {"marker_places": "-0.02 0.0 0.03"}),
    "recorder": ("softsim_ros.recording.recorder_node", {"robot": "tripod"}),
    "viewer": ("softsim_ros.nodes.viewer.viewer_node", {}),
}
if importlib.util.find_spec("onnxruntime"):
    shipped = REPOSITORY / "examples" / "learning" / "tripod_reach.onnx"
    NODES["policy"] = ("softsim_ros.nodes.policy.policy_node", {"robot": "tripod", "policy": str(shipped)})
MOST_WAITING = 40
"""Requests that are asked before the answers are waited for."""

SETTLED_LOOKS = 60
"""Nodes whose topics and services became no more for so many looks (1 s and more) are all known.

What is found later is not shot at, and fails no test.
"""

BUILT_S = 180.0
"""The simulator runs after this time, in [s]: in a fresh checkout its kernels are compiled first."""

LONGEST_LINE = 700
"""Characters of a line of a log: a sentence of at most 300, the name and the time before it, a path."""


class Bait:
    """Files that nobody may open, and names that lead to them."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir()
        self.folder, self.mark = folder, folder / "mark"
        code = f"open({str(self.mark)!r}, 'w').write('ran')\ndef create_scene(scene): pass\n"
        (folder / "scene.py").write_text(code)
        (folder / "scene.yaml").write_text("extends: tripod.yaml\n")
        (folder / "path.csv").write_text("x,y,z\n0,0,0\n")
        (folder / "snapshot.bin").write_bytes(b"\x00" * 64)
        files = [str(each) for each in sorted(folder.iterdir())]
        climbing = [f"{8 * '../'}{each.lstrip('/')}" for each in files]
        self.texts = [*files, *climbing, "/etc/passwd", "/etc/hostname", "/dev/zero", "/proc/self/environ"]


TEXTS = (
    *("", " ", "tripod", "servo_0", "servo_1", "servo_2", "silicone", "world", "circle", "high", "start"),
    *("objects/ball", "objects/can", "ball", "can_1"),
    *(
        "a" * 20_000,
        "\x1b[2Jx",
        "{a: &a [*a]}",
        "young_modulus: .nan",
        "bodies: [{name: silicone}]",
        "[[[[[[[",
    ),
    *("mesh_point/0", "mesh_point/-1", "mesh_point/" + "9" * 400, "é" * 50, "..", "/", "~", "$(reboot)"),
)


@pytest.fixture
def bait(tmp_path: Path) -> Bait:
    return Bait(tmp_path / "bait")


@pytest.fixture
def audit(tmp_path: Path) -> Path:
    """Start of the names of the files in which processes write what they open."""
    return tmp_path / "audit"


@pytest.fixture
def nodes(
    tmp_path: Path, audit: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[tuple[Client, dict[str, NodeProcess]]]:
    """Every node of the suite in its process, watched; and a client beside them."""
    monkeypatch.setenv("PYTHONPATH", str(REPOSITORY / "tests" / "attacks" / "audit"))
    monkeypatch.setenv("AUDIT_LOG", str(audit))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    start = ProcessGroup(tmp_path)
    with private_ros(tmp_path) as domain, ExitStack() as packages:
        for name in OPTIONAL:
            if not why_missing(name):
                packages.enter_context(interface_package(name))
        client = Client(domain, f"/{NAMESPACE}", start)
        try:
            yield client, all_running(start, client, tmp_path / "board")
        finally:
            client.close()
            start.end()


def all_running(start: ProcessGroup, client: Client, board: Path) -> dict[str, NodeProcess]:
    """The processes by the names of their nodes, once each is in the graph."""
    words = ("--ros-args", "-r", f"__ns:=/{NAMESPACE}")
    ports = {"servo_bridge": board, "viewer": free_port()}
    running = {"virtual_board": start(BOARD, *words, *parameter_words(link=board))}
    assert running["virtual_board"].says("virtual board on"), start.output
    for name, (module, values) in NODES.items():
        port = {"port": ports[name]} if name in ports else {}
        running[name] = start(module, *words, *parameter_words(**values, **port))

    def missing() -> set[str]:
        return {*running} - {name for name, _ in client.node.get_node_names_and_namespaces()}

    assert spin_until(lambda: not missing(), 60.0), (missing(), start.output)
    assert running["simulator"].says("simulating", BUILT_S), start.output
    return running


def interfaces(by_node: Callable[..., Any], nodes: list[tuple[str, str]]) -> list[tuple[str, str]]:
    """Names and types of topics or services of these nodes."""
    return sorted({(name, types[0]) for each in nodes for name, types in by_node(*each)})


class Fire:
    """Sends what `mutations` draws to all that the nodes of a graph listen to."""

    def __init__(self, client: Client, mutations: Mutations, nodes: Iterable[str]) -> None:
        self._client, self._mutations = client, mutations
        self._waiting: list[Any] = []
        self.sent: Counter[str] = Counter()
        self.answered = 0
        graph = client.node
        settings = {f"/{NAMESPACE}/{name}/set_parameters" for name in nodes}
        self.topics, self.services, unchanged = [], [], 0

        def is_settled() -> bool:
            """Whether all have settings, and no more were found for some time: late news comes in seconds."""
            nonlocal unchanged
            seen = self.topics, self.services
            found = [each for each in graph.get_node_names_and_namespaces() if each[0] != "client"]
            self.topics = interfaces(graph.get_subscriber_names_and_types_by_node, found)
            self.services = interfaces(graph.get_service_names_and_types_by_node, found)
            unchanged = unchanged + 1 if seen == (self.topics, self.services) else 0
            return settings <= dict(self.services).keys() and unchanged >= SETTLED_LOOKS

        assert spin_until(is_settled), settings - dict(self.services).keys()
        self._publishers = {
            name: graph.create_publisher(loaded(kind), name, STATE_QOS) for name, kind in self.topics
        }  # which all hear: those who want what is latched, or a sign of life, and those who want neither
        self._clients = {name: graph.create_client(loaded(kind), name) for name, kind in self.services}
        self.parameters = {name: self._declared(name) for name, kind in self.services if "/Set" in kind}

    def unheard(self) -> list[str]:
        """Topics that nobody takes our messages on."""
        return [name for name, each in self._publishers.items() if not each.get_subscription_count()]

    def _declared(self, service: str) -> list[str]:
        owner = service.rsplit("/", 1)[0]
        return list(self._client.call(ListParameters, f"{owner}/list_parameters").result.names)

    def shoot(self) -> None:
        """One message, request or set of parameters, to a place drawn at random."""
        draw = self._mutations.random
        if draw.random() < 0.6:
            name, kind = draw.choice(self.topics)
            self._publish(name, loaded(kind))
        else:
            name, kind = draw.choice(self.services)
            self._ask(name, loaded(kind))

    def _publish(self, name: str, message_type: Any) -> None:
        message = self._mutations.message(message_type)
        if self._mutations.random.random() < 0.3:
            self.sent["damaged messages"] += 1
            self._publishers[name].publish(self._mutations.damaged(serialize_message(message)))
        else:
            self.sent["messages"] += 1
            self._publishers[name].publish(message)

    def _ask(self, name: str, service_type: Any) -> None:
        if name in self.parameters:
            request = service_type.Request(parameters=self._settings(self.parameters[name]))
            self.sent["sets of parameters"] += 1
        else:
            request = self._mutations.message(service_type.Request)
            self.sent["requests"] += 1
        self._waiting.append(self._clients[name].call_async(request))
        if len(self._waiting) >= MOST_WAITING:
            self.wait()

    def _settings(self, names: list[str]) -> list[Parameter]:
        draw = self._mutations
        return [
            Parameter(
                name=draw.random.choice([*names, draw.text()]),
                value=draw.random.choice(
                    [
                        draw.message(ParameterValue),
                        ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=draw.text()),
                        ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=draw.number()),
                        ParameterValue(type=ParameterType.PARAMETER_BOOL, bool_value=True),
                        ParameterValue(type=ParameterType.PARAMETER_INTEGER, integer_value=-(2**63)),
                    ]
                ),
            )
            for _ in range(draw.random.choice((1, 1, 2, 5)))
        ]

    def wait(self) -> None:
        """Until the requests are answered, or an answer must have been lost."""
        spin_until(lambda: all(each.done() for each in self._waiting), 20.0)
        self.answered += sum(each.done() for each in self._waiting)
        self._waiting.clear()


def opened(audit: Path) -> dict[str, list[str]]:
    """What each process did to files and processes: lines of event, path and mode, with tabs between."""
    logs = audit.parent.glob(f"{audit.name}.*")
    return {log.name: log.read_text(errors="replace").splitlines() for log in logs}


OWN = re.compile(
    r"\t('/tmp/|'/dev/shm/|\d+\t"  # their folders, and what was opened by its own line before
    r"|'[^']*/(__pycache__|\.softsim)/"  # kernels
    r"|'tripod_[\d_-]+/"  # bags
    r"|'\.\w+\.snapshot\.[0-9a-f]{16}'"  # snapshots, on their way into their folder
    r"|'\.tripod\.yaml\.[0-9a-f]{16}')"  # the edited scene's copy, on its way into the start folder
)
"""Lines of what nodes may write."""


def test_a_watched_process_tells_what_it_opens(
    audit: Path, bait: Bait, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The judge of the test below sees what it is there to see."""
    monkeypatch.setenv("PYTHONPATH", str(REPOSITORY / "tests" / "attacks" / "audit"))
    monkeypatch.setenv("AUDIT_LOG", str(audit))
    process = NodeProcess("tokenize", (str(bait.folder / "scene.py"),), tmp_path / "log.txt")
    assert process.process.wait(DEADLINE_S) == 0
    assert any("scene.py" in line for lines in opened(audit).values() for line in lines)


@pytest.mark.parametrize("count", [200, pytest.param(100_000, marks=pytest.mark.exhaustive)])
def test_every_node_lives_and_touches_no_foreign_file(
    nodes: tuple[Client, dict[str, NodeProcess]], bait: Bait, audit: Path, count: int
) -> None:
    client, processes = nodes
    fire = Fire(client, Mutations(count, [*TEXTS, *bait.texts]), processes)
    assert len(fire.topics) >= 20
    assert len(fire.services) >= 7 * len(processes)
    assert spin_until(lambda: not fire.unheard()), fire.unheard()
    offered = {kind.partition("/")[0] for _, kind in fire.services}
    assert offered >= {name for name in OPTIONAL if not why_missing(name)}
    before = {process: len(lines) for process, lines in opened(audit).items()}
    for number in range(count):
        fire.shoot()
        if number % 100 == 0:
            fallen = [name for name, each in processes.items() if each.process.poll() is not None]
            assert not fallen, (number, processes[fallen[0]].output[-3000:])
    fire.wait()
    for name, process in processes.items():
        assert process.process.poll() is None, (name, process.output[-3000:])
        client.call(GetParameters, f"{name}/get_parameters", GetParameters.Request(names=["use_sim_time"]))
        assert "Traceback" not in process.output, (name, process.output[-3000:])
        ours = [line for line in process.output.splitlines() if "[rcl]" not in line]
        assert max(map(len, ours), default=0) < LONGEST_LINE, name
    print(f"{dict(fire.sent)}, {fire.answered} answers")
    print(f"{len(fire.topics)} topics, {len(fire.services)} services, {len(processes)} nodes")
    events = [line for process, lines in opened(audit).items() for line in lines[before.get(process, 0) :]]
    assert events
    foreign = [line for line in events if any(text in line for text in bait.texts) or "os.system" in line]
    assert foreign == []
    assert not bait.mark.exists()
    assert {line for line in events if re.search(r"\t[wax]\+?$", line) and not OWN.search(line)} == set()
