"""Two robots of one kind in one graph: frames as REP 105 wants them, each obeys what it is told itself."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytestmark = [pytest.mark.ros, pytest.mark.slow]

from interface_packages import interface_package  # noqa: E402
from node_processes import Client, ProcessGroup, parameter_words  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile  # noqa: E402
from scipy.spatial.transform import Rotation  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from std_msgs.msg import Float64MultiArray, String  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402
from waiting import BUILD_S, spin_until  # noqa: E402

from servo_bridge.emulator import VirtualBoard  # noqa: E402

LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
PLACES = ("left", "lab/right")
HIGH, LOW = [-0.6, -0.6, -0.6], [-1.4, -1.4, -1.4]


@pytest.fixture(scope="module")
def tf2_msgs() -> Iterator[None]:
    """The package tf2_msgs, here and in the processes of these tests."""
    with interface_package("tf2_msgs"):
        yield


@pytest.fixture(scope="module")
def tripods(
    tf2_msgs: None, ros_domain: int, start_process: ProcessGroup, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[dict[str, VirtualBoard]]:
    """Two Tripods, each with its bridge and board, by namespace."""
    folder = tmp_path_factory.mktemp("boards")
    with VirtualBoard(link=folder / "left") as left, VirtualBoard(link=folder / "right") as right:
        boards = dict(zip(PLACES, (left, right), strict=True))
        for place, board in boards.items():
            name = ["--ros-args", "-r", f"__ns:=/{place}"]
            simulator = start_process("softsim_ros.nodes.simulator.simulator_node", *name)
            assert simulator.says("simulating", BUILD_S), simulator.output
            words = parameter_words(port=board.port, open_wait_s=0.0, autostart="activate")
            start_process("servo_bridge.nodes.bridge_node", *name, *words)
        yield boards


@pytest.fixture(scope="module")
def client(ros_domain: int, start_process: ProcessGroup) -> Iterator[Client]:
    """A node beside both robots."""
    node = Client(ros_domain, "/", start_process)
    yield node
    node.close()


@pytest.fixture(scope="module")
def command(client: Client) -> Callable[[str, list[float]], None]:
    """Tells one of the robots where its joints go."""

    def tell(place: str, values: list[float]) -> None:
        client.publish(f"/{place}/position_controller/commands", Float64MultiArray(data=values))

    return tell


@pytest.fixture(scope="module")
def joints(tripods: object, client: Client) -> dict[str, list[Any]]:
    """Joint states by namespace, from now on."""
    return {place: client.collect(JointState, f"/{place}/joint_states") for place in PLACES}


def trigger(client: Client, service: str) -> str:
    answer = client.call(Trigger, service)
    assert answer.success, answer.message
    return str(answer.message)


def stands(states: list[Any], wanted: list[float]) -> bool:
    return bool(states) and np.allclose(states[-1].position, wanted, atol=1e-3)


def test_each_obeys_its_own_commands_and_its_own_stop(
    tripods: dict[str, VirtualBoard],
    client: Client,
    joints: dict[str, list[Any]],
    command: Callable[[str, list[float]], None],
) -> None:
    left, right = PLACES
    command(left, HIGH)
    command(right, LOW)
    assert spin_until(lambda: stands(joints[left], HIGH) and stands(joints[right], LOW))
    assert spin_until(lambda: tripods[left].servo_bytes == 3 * (144,))
    assert spin_until(lambda: tripods[right].servo_bytes == 3 * (98,))
    trigger(client, f"/{right}/servo_bridge/e_stop")
    command(left, LOW)
    command(right, HIGH)
    assert spin_until(lambda: stands(joints[left], LOW) and stands(joints[right], HIGH))
    assert spin_until(lambda: tripods[left].servo_bytes == 3 * (98,))
    assert tripods[right].servo_bytes == 3 * (98,)
    trigger(client, f"/{right}/servo_bridge/clear_e_stop")


def test_each_saves_and_loads_a_snapshot_of_its_own(
    client: Client, joints: dict[str, list[Any]], command: Callable[[str, list[float]], None]
) -> None:
    told = dict(zip(PLACES, (HIGH, LOW), strict=True))
    for place, values in told.items():
        command(place, values)
    assert spin_until(lambda: all(stands(joints[place], told[place]) for place in PLACES))
    files = [trigger(client, f"/{place}/simulator/save").removeprefix("saved to ") for place in PLACES]
    assert [Path(file).name for file in files] == ["left.tripod.snapshot", "lab.right.tripod.snapshot"]
    for place in PLACES:
        trigger(client, f"/{place}/simulator/reset")
        trigger(client, f"/{place}/simulator/load")
    assert spin_until(lambda: all(stands(joints[place], told[place]) for place in PLACES))


def test_their_transforms_are_one_tree_as_rep_105_wants_it_and_agree_with_their_descriptions(
    tripods: object, client: Client, command: Callable[[str, list[float]], None]
) -> None:
    from tf2_msgs.msg import TFMessage

    fixed = client.collect(TFMessage, "/tf_static", LATCHED)
    moving = client.collect(TFMessage, "/tf")
    texts = {place: client.collect(String, f"/{place}/robot_description", LATCHED) for place in PLACES}
    command(PLACES[0], HIGH)
    command(PLACES[1], LOW)

    def senders(messages: list[Any]) -> set[str]:
        children = [link.child_frame_id for message in list(messages) for link in message.transforms]
        return {place for place in PLACES for child in children if child.startswith(f"{place}/")}

    assert spin_until(lambda: all(texts.values()))
    assert spin_until(lambda: senders(fixed) == senders(moving) == {*PLACES})
    links = [link for message in [*fixed, *moving] for link in message.transforms]
    parents: dict[str, set[str]] = {}
    for link in links:
        assert link.child_frame_id.isascii()
        assert not link.child_frame_id.startswith("/")  # tf2 has no leading slashes
        assert not (link.header.stamp.sec == 0 and link.header.stamp.nanosec == 0)
        parents.setdefault(link.child_frame_id, set()).add(link.header.frame_id)
    assert {child: found for child, found in parents.items() if len(found) != 1} == {}
    (roots,) = [{parent for found in parents.values() for parent in found} - set(parents)]
    assert roots == {"world"}
    tree = {child: parent for child, (parent,) in parents.items()}
    for place in PLACES:
        assert tree[f"{place}/base_link"] == "world"
        own = {child for child in tree if child.startswith(f"{place}/")}
        assert {tree[child].rpartition("/")[0] for child in own - {f"{place}/base_link"}} == {place}
    assert all(any(child.startswith(f"{place}/") for place in PLACES) for child in tree)
    latest = {link.child_frame_id: link.transform for link in links}
    for place in PLACES:
        compared = compare(ElementTree.fromstring(texts[place][-1].data), place, tree, latest)
        assert {"revolute", "fixed", "floating"} <= compared


def compare(robot: ElementTree.Element, place: str, tree: dict[str, str], latest: dict[str, Any]) -> set[str]:
    """Hold transforms to the robot's URDF; the kinds of its joints that were compared."""
    compared = set()
    for joint in robot.iter("joint"):
        if (kind := joint.get("type")) is None:
            continue  # of the section for ros2_control
        parent, child = (f"{place}/{joint.find(end).get('link')}" for end in ("parent", "child"))  # type: ignore[union-attr]
        assert tree[child] == parent
        compared.add(kind)
        if kind == "floating":
            continue
        origin = joint.find("origin")
        numbers = {"xyz": np.zeros(3), "rpy": np.zeros(3)}
        if origin is not None:
            numbers |= {
                name: np.array([float(each) for each in text.split()]) for name, text in origin.items()
            }
        found = latest[child]
        place_found = [found.translation.x, found.translation.y, found.translation.z]
        turn_found = Rotation.from_quat([getattr(found.rotation, each) for each in "xyzw"])
        relative = Rotation.from_euler("xyz", numbers["rpy"]).inv() * turn_found
        np.testing.assert_allclose(place_found, numbers["xyz"], atol=1e-9)
        axis = joint.find("axis")
        if kind == "fixed" or axis is None:
            assert relative.magnitude() < 1e-9
        else:  # it turns about the axis of its description, by what its limits allow
            about = np.array([float(each) for each in axis.get("xyz", "").split()])
            angle = float(relative.as_rotvec() @ about)
            np.testing.assert_allclose(relative.as_rotvec(), angle * about, atol=1e-9)
            limit = joint.find("limit")
            assert limit is not None
            assert float(limit.get("lower", "")) - 1e-6 <= angle <= float(limit.get("upper", "")) + 1e-6
    return compared


def test_nothing_of_a_robot_lies_outside_its_namespace(tripods: object, client: Client) -> None:
    parts = itertools.product(PLACES, ("simulator", "servo_bridge", "servo_bridge_e_stop"))
    wanted = sorted(f"/{place}/{name}" for place, name in parts)

    def nodes() -> list[str]:
        found = client.node.get_node_names_and_namespaces()
        return sorted({f"{space}/{name}" for name, space in found if name != "client"})

    assert spin_until(lambda: nodes() == wanted), nodes()
    shared = {"/diagnostics", "/tf", "/tf_static", "/rosout", "/parameter_events"}
    names = [name for name, _ in client.node.get_topic_names_and_types()]
    names += [
        name for name, _ in client.node.get_service_names_and_types() if not name.startswith("/client/")
    ]
    outside = {name for name in names if not name.startswith(tuple(f"/{place}/" for place in PLACES))}
    assert outside <= shared, outside - shared
