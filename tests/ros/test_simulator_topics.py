"""Mesh topics and diagnostics of a simulator in another process."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.shared_robot("tripod")]

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from diagnostics import diagnostic_values  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile  # noqa: E402
from rclpy.serialization import deserialize_message  # noqa: E402
from sensor_msgs.msg import JointState, PointCloud2  # noqa: E402
from shape_msgs.msg import Mesh  # noqa: E402
from std_msgs.msg import String  # noqa: E402
from visualization_msgs.msg import Marker  # noqa: E402

from softsim_ros.messages import read_point_cloud  # noqa: E402

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def values(reports: list[DiagnosticArray]) -> dict[str, str]:
    """The newest report of the simulator."""
    for report in reversed(reports):
        if found := diagnostic_values(report, "tripod/simulator"):
            return found
    return {}


def test_a_late_joiner_gets_the_topology_and_points_that_fit_it(tripod: Any, spin_until: Any) -> None:
    topology = tripod.client.collect(Mesh, "mesh/topology", LATCHED)
    points = tripod.client.collect(PointCloud2, "mesh/points")
    assert spin_until(lambda: topology and points)
    mesh, rows = topology[0], read_point_cloud(points[-1])
    assert len(rows) == len(mesh.vertices) > 0
    corners = np.array([triangle.vertex_indices for triangle in mesh.triangles])
    assert corners.max() == len(mesh.vertices) - 1
    rest = np.array([[vertex.x, vertex.y, vertex.z] for vertex in mesh.vertices])
    assert 0.0 < np.abs(rows[:, :3] - rest).max() < 0.01  # sags by millimetres
    assert (rows[:, 3] >= 0.0).all()
    assert rows[:, 3].max() > 0.0
    assert points[-1].header.frame_id == "world"


def test_the_marker_reads_back(tripod: Any, spin_until: Any) -> None:
    topology = tripod.client.collect(Mesh, "mesh/topology", LATCHED)
    raw = tripod.client.collect(Marker, "mesh/marker", raw=True)
    assert spin_until(lambda: topology and len(raw) > 2)
    marker = deserialize_message(raw[-1], Marker)
    assert marker.type == Marker.TRIANGLE_LIST
    assert len(marker.points) == len(marker.colors) == 3 * len(topology[0].triangles)
    assert marker.header.frame_id == "world"
    assert marker.header.stamp.sec > 0


def test_the_diagnostics_tell_speed_stages_memory_and_state(tripod: Any, spin_until: Any) -> None:
    reports = tripod.client.collect(DiagnosticArray, "/diagnostics")
    assert spin_until(lambda: float(values(reports).get("real_time_factor", 0)) > 0.0)
    report = values(reports)
    assert report["state"] == "running"
    assert float(report["step_ms"]) > 0.0
    assert float(report["publishing_ms"]) > 0.0
    assert float(report["memory_mb"]) > 20.0
    assert tripod.pause(True)[0]
    assert spin_until(lambda: values(reports)["state"] == "paused")


def test_clamped_commands_are_counted(tripod: Any, spin_until: Any) -> None:
    reports = tripod.client.collect(DiagnosticArray, "/diagnostics")
    assert spin_until(lambda: values(reports))
    before = int(values(reports)["clamped_commands"])
    tripod.command([9.0, 9.0, 9.0])
    assert spin_until(lambda: int(values(reports)["clamped_commands"]) > before)


def test_a_slow_simulation_is_not_faster_than_asked(tripod: Any, spin_until: Any) -> None:
    reports = tripod.client.collect(DiagnosticArray, "/diagnostics")
    assert tripod.set_parameters(speed=0.1)[0]
    assert spin_until(lambda: 0.0 < float(values(reports).get("real_time_factor", 0)) < 0.2)


def test_a_mesh_rate_of_zero_stops_it(tripod: Any, spin_until: Any) -> None:
    points = tripod.client.collect(PointCloud2, "mesh/points")
    states = tripod.client.collect(JointState, "joint_states")

    def silent() -> bool:
        """Whether no points come while the robot goes on for 30 steps."""
        points.clear()
        states.clear()
        return bool(spin_until(lambda: len(states) >= 30)) and not points

    assert spin_until(lambda: points and states)
    assert tripod.set_parameters(mesh_rate=0.0)[0]
    assert spin_until(silent)  # some may have been on their way
    assert tripod.set_parameters(mesh_rate=10.0)[0]
    assert spin_until(lambda: points)


def test_a_late_joiner_gets_the_robot_s_description(tripod: Any, spin_until: Any) -> None:
    descriptions = tripod.client.collect(String, "robot_description", LATCHED)
    states = tripod.client.collect(JointState, "joint_states")
    assert spin_until(lambda: descriptions and states)
    root = ElementTree.fromstring(descriptions[0].data)
    assert {joint.get("name") for joint in root.findall("joint[@type='revolute']")} == set(states[-1].name)
    topic = root.findtext("ros2_control/hardware/param[@name='joint_commands_topic']")
    assert topic == "/tripod/joint_commands"
