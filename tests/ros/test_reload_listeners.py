"""Scenes change while everybody listens: no listener takes one scene's messages for another's."""

from __future__ import annotations

import json
import random
from collections.abc import Callable
from functools import partial
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("viser")

from node_processes import Client, parameter_words
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import PointCloud2
from shape_msgs.msg import Mesh
from std_msgs.msg import String, UInt32MultiArray
from tcp_ports import free_port

from softsim_core import load_scene
from softsim_ros import messages

pytestmark = [pytest.mark.ros, pytest.mark.slow]

SCENES = ("tripod", "cable_gripper", "tripod_step_2", "held_centre", "cable_finger", "tripod_maze")
READY_S = 120.0
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
TROUBLE = ("Traceback", "refused", "Error", "is damaged", "does not fit")


class Heard:
    """The newest scene as a listener of several topics puts it together."""

    def __init__(self, client: Client) -> None:
        self._structures = client.collect(String, "scene/structure", LATCHED)
        self._surfaces = client.collect(Mesh, "mesh/topology", LATCHED)
        self._elements = client.collect(UInt32MultiArray, "mesh/tetrahedra", LATCHED)
        self._points = client.collect(PointCloud2, "mesh/points", 1)
        self._generation = 0

    def completes(self, name: str) -> bool:
        """Whether all parts of a newer scene of that name have come."""
        if not (self._structures and self._surfaces and self._elements and self._points):
            return False
        told = json.loads(self._structures[-1].data)
        surface, elements = self._surfaces[-1], self._elements[-1]
        found = {
            "mesh/topology": messages.mesh_checksum(
                [each.vertex_indices for each in surface.triangles],
                [(each.x, each.y, each.z) for each in surface.vertices],
            ),
            "mesh/tetrahedra": messages.mesh_checksum(elements.data),
        }
        complete = found == told["checksums"] and self._points[-1].width == len(surface.vertices)
        if told["name"] != name or told["generation"] <= self._generation or not complete:
            return False
        self._generation = int(told["generation"])
        return True


@pytest.mark.parametrize("reloads", [5, pytest.param(30, marks=pytest.mark.exhaustive)])
def test_listeners_follow_from_scene_to_scene(
    start_robot: Any, start_process: Any, client: Client, spin_until: Callable[..., bool], reloads: int
) -> None:
    robot = start_robot(backend="scipy")
    space = ("--ros-args", "-r", "__ns:=/tripod")
    words = parameter_words(robot="tripod", port=free_port())
    viewer = start_process("softsim_ros.nodes.viewer.viewer_node", *space, *words)
    inverse = start_process(
        "softsim_ros.nodes.inverse.inverse_node", *space, *parameter_words(robot="tripod")
    )
    assert viewer.says("viewer: http"), viewer.output
    assert inverse.says("ready to control", READY_S), inverse.output
    heard, rng, shown = Heard(client), random.Random(11), "tripod"
    setter = client.node.create_client(SetParameters, "simulator/set_parameters")
    assert spin_until(partial(heard.completes, "tripod"), READY_S)
    assert setter.wait_for_service(READY_S)
    for _ in range(reloads):
        shown = rng.choice([name for name in SCENES if name != shown])
        wish = Parameter("robot", value=shown).to_parameter_msg()
        request = SetParameters.Request(parameters=[wish])
        answer = setter.call_async(request)  # once: while a scene is being built others are refused
        assert spin_until(answer.done, READY_S), (shown, robot.process.output)
        (result,) = answer.result().results
        assert (result.successful, result.reason) == (True, ""), shown
        complete = partial(heard.completes, load_scene(shown).name)
        assert spin_until(complete, READY_S), (shown, robot.process.output)
    for process in (robot.process, viewer, inverse):
        assert process.process.poll() is None, process.output
        told = [line for line in process.output.splitlines() if any(word in line for word in TROUBLE)]
        assert told == []
