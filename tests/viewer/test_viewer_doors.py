"""The viewer alone, told nonsense on every topic: it runs no code, reads no file, and goes on."""

from __future__ import annotations

import http.client
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("viser")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, Pose, PoseArray, PoseStamped
from node_processes import Client
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState, PointCloud2, PointField
from shape_msgs.msg import Mesh, MeshTriangle
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, MultiArrayLayout, String, UInt32MultiArray
from tcp_ports import free_port
from visualization_msgs.msg import Marker, MarkerArray

from softsim_core import Simulation, load_scene
from softsim_ros.nodes.simulator import structure

pytestmark = [pytest.mark.ros, pytest.mark.slow]

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
EVIL = "from pathlib import Path\nPath(__file__).with_name('ran').touch()\ndef create_scene(scene): pass\n"


PROPOSAL = """{"revision": 9, "description": "name: tripod", "file": "/etc/passwd", "unsaved": "",
"undoable": 0, "redoable": 0, "changed": false, "applied": true, "sentence": "", "routes": {},
"chosen": [{"part": "%s", "count": 1, "points": [[%g, 0, 0]], "problem": ""}]}"""


class Watched:
    """A viewer process and a node that tells it things."""

    def __init__(self, process: Any, client: Client, port: int, until: Callable[..., bool]) -> None:
        self.process, self.client, self.port, self._until = process, client, port, until
        self._publishers: dict[str, Any] = {}

    def tell(self, topic: str, message: Any) -> None:
        if topic not in self._publishers:
            self._publishers[topic] = self.client.node.create_publisher(type(message), topic, LATCHED)
        publisher = self._publishers[topic]
        assert self._until(lambda: publisher.get_subscription_count() > 0), topic
        publisher.publish(message)

    def says(self, text: str) -> bool:
        return bool(self.process.says(text))

    def lives(self) -> bool:
        """Whether the process serves its page and follows the robot still."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=120)
        connection.request("GET", "/")
        status = connection.getresponse().status
        connection.close()
        return status == 403 and self.process.process.poll() is None


@pytest.fixture(scope="module")
def viewer(start_process: Any, client: Client, spin_until: Callable[..., bool]) -> Iterator[Watched]:
    port = free_port()
    process = start_process(
        "softsim_ros.nodes.viewer.viewer_node", "--ros-args", "-p", "robot:=tripod", "-p", f"port:={port}"
    )
    assert process.says("viewer: http"), process.output
    watched = Watched(process, client, port, spin_until)
    yield watched
    assert watched.lives()
    assert "Traceback" not in process.output


def told(**changes: Any) -> String:
    """The Tripod's own message, with changes."""
    data = structure(Simulation(load_scene("tripod"), backend="scipy"), generation=7)
    return String(data=json.dumps({**data, **changes}))


def test_a_scene_that_names_code_runs_none(viewer: Watched, tmp_path: Path) -> None:
    program = tmp_path / "evil.py"
    program.write_text(EVIL)
    viewer.tell("scene/structure", told(generation=1, source=str(program), places={"": [str(program), 1]}))
    old = {
        "name": "tripod",
        "source": str(program),
        "overrides": "",
        "bodies": [],
        "frames": [],
        "regions": [],
    }
    viewer.tell("scene/structure", String(data=json.dumps(old)))
    assert viewer.says("scene refused: no message of this version's simulator")
    assert viewer.lives()
    assert not (tmp_path / "ran").exists()


BOMB = "a0: &a0 [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"a{k}: &a{k} [{', '.join(10 * [f'*a{k - 1}'])}]\n" for k in range(1, 10)
)


@pytest.mark.parametrize(
    "changes",
    [
        {"description": BOMB},
        {"description": "name: ../x"},
        {"description": "a: " + 20_000 * "["},
        {"description": 3},
        {"frames": ["x\n" * 900]},
        {"frames": "abc"},
        {"bodies": [{"name": "silicone"}]},
        {"bodies": None},
        {"regions": [{"name": "z", "nodes": [-1]}]},
        {"places": {"": 3}},
        {"generation": "new"},
        {"scenes": [1]},
    ],
)
def test_scenes_that_cannot_be_are_refused(viewer: Watched, changes: dict[str, Any]) -> None:
    viewer.tell("scene/structure", told(**{"generation": 2, **changes}))
    assert viewer.lives()


@pytest.mark.parametrize("text", ["", "{", "[]", "null", "[" * 100_000, '{"generation": 1}', "\0"])
def test_what_is_no_scene_is_refused(viewer: Watched, text: str) -> None:
    viewer.tell("scene/structure", String(data=text))
    assert viewer.lives()


def nonsense(rng: np.random.Generator) -> list[tuple[str, Any]]:
    """Messages of right types that no simulator sends."""
    big, nan = 4_000_000_000, float("nan")
    triangle = MeshTriangle(vertex_indices=[0, 1, big])
    field = PointField(name="x", offset=big, datatype=99, count=1)
    status = DiagnosticStatus(name="tripod/simulator", values=[KeyValue(key="time_s", value="soon")])
    layout = MultiArrayLayout(dim=[MultiArrayDimension(label="x", size=3, stride=1)])
    return [
        ("scene/proposal", String(data="[" * 100_000)),
        ("scene/proposal", String(data='{"revision": 1}')),
        ("scene/proposal", String(data=PROPOSAL % ("../x", 1e308))),
        ("scene/proposal", String(data=PROPOSAL % ("x" * 900, 0.0))),
        ("mesh/topology", Mesh(triangles=[triangle], vertices=[Point(x=nan)])),
        ("mesh/topology", Mesh(triangles=[triangle])),
        ("mesh/tetrahedra", UInt32MultiArray(data=[1, 2, 3])),
        ("mesh/tetrahedra", UInt32MultiArray(layout=layout, data=[big] * 7)),
        ("mesh/points", PointCloud2(data=rng.bytes(33))),
        ("mesh/points", PointCloud2(width=10**6, height=1, point_step=16, row_step=16)),
        ("mesh/points", PointCloud2(fields=[field], width=3, height=1, point_step=0, data=rng.bytes(48))),
        ("frames", PoseArray(poses=[Pose()] * 500)),
        ("frames", PoseArray(poses=[Pose(position=Point(x=nan, y=1e308))] * 4)),
        ("cables", MarkerArray(markers=[Marker(type=99, points=[Point(x=nan)])])),
        ("cables", MarkerArray(markers=[Marker(ns="\n", id=-5, type=4)])),
        ("contacts", MarkerArray(markers=[Marker(type=6, points=[Point()] * 3)])),
        ("bodies/topology", MarkerArray(markers=[Marker(type=11, points=[Point()] * 2, ns="../../x")])),
        ("bodies/poses", PoseArray(poses=[Pose()] * 9)),
        ("joint_states", JointState(name=["servo_0"] * 3, position=[nan], effort=[1e308])),
        ("joint_states", JointState(name=[f"j{k}" for k in range(20_000)])),
        ("effector_goal", PoseStamped(pose=Pose(position=Point(x=1e308)))),
        ("effector_pose", PoseStamped(pose=Pose(position=Point(x=nan)))),
        ("/diagnostics", DiagnosticArray(status=[status])),
        ("stage_statistics", DiagnosticArray(status=[status])),
        ("step_profile", Float64MultiArray(data=[nan] * 7)),
        ("step_profile", Float64MultiArray(layout=layout, data=[])),
        ("position_controller/commands", Float64MultiArray(data=[nan] * 2)),
    ]


@pytest.mark.parametrize("number", range(len(nonsense(np.random.default_rng(0)))))
def test_topics_that_are_told_nonsense_do_not_end_the_viewer(viewer: Watched, number: int) -> None:
    viewer.tell(*nonsense(np.random.default_rng(1))[number])
    assert viewer.lives()


def test_after_all_that_it_shows_the_scene_it_is_told(viewer: Watched) -> None:
    viewer.tell("scene/structure", told(generation=100))
    assert viewer.lives()
