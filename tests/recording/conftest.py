"""A recording of the Tripod as the recorder writes it, made without processes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

STEPS = 40
BEGIN_NS = 1_800_000_000_000_000_000
STEP_NS = 10_000_000


@pytest.fixture(scope="session")
def robot_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """40 steps of the Tripod: joints, effector and its goal, commands, surface, diagnostics."""
    pytest.importorskip("rclpy")
    pytest.importorskip("rosbags")
    from geometry_msgs.msg import PoseArray
    from rclpy.serialization import serialize_message
    from std_msgs.msg import Float64MultiArray

    from softsim_core import Simulation, load_scene
    from softsim_ros import messages
    from softsim_ros.recording import BagWriter

    folder = tmp_path_factory.mktemp("bags") / "tripod_bag"
    writer = BagWriter(folder, {"robot": "tripod", "namespace": "/tripod"})
    simulation = Simulation(load_scene("tripod"))

    def put(topic: str, kind: str, message: object, number: int) -> None:
        name = topic if topic.startswith("/") else f"/tripod/{topic}"
        writer.add_topic(name, kind)
        writer.write(name, BEGIN_NS + number * STEP_NS, serialize_message(message))

    points, triangles = simulation.visual_rest_points, simulation.visual_triangles
    put("mesh/topology", "shape_msgs/msg/Mesh", messages.topology(points, triangles), 0)
    put("effector_goal", "geometry_msgs/msg/PoseStamped", pose(messages, simulation, (0.0, 0.0, 0.03)), 0)
    put("bodies/topology", "visualization_msgs/msg/MarkerArray", markers("cube", 11), 0)
    for number in range(STEPS):
        height = 0.001 * number
        put("cables", "visualization_msgs/msg/MarkerArray", markers("line", 4, height), number)
        poses = PoseArray(poses=[messages.pose((0.0, 0.0, height), (0.0, 0.0, 0.0, 1.0))])
        put("bodies/poses", "geometry_msgs/msg/PoseArray", poses, number)
        command = np.full(3, -0.01 * number)
        simulation.command(command)
        simulation.step()
        message = Float64MultiArray(data=command.tolist())
        put("position_controller/commands", "std_msgs/msg/Float64MultiArray", message, number)
        stamp = messages.time_message(simulation.time)
        states = messages.joint_state(
            stamp,
            "tripod/base_link",
            simulation.joint_names,
            simulation.joint_positions,
            simulation.joint_velocities,
            simulation.joint_efforts,
        )
        put("joint_states", "sensor_msgs/msg/JointState", states, number)
        effector = simulation.effector_pose
        put("effector_pose", "geometry_msgs/msg/PoseStamped", pose(messages, simulation, effector), number)
        stress = np.maximum(simulation.visual_values(simulation.von_mises()), 0.0)
        cloud = messages.point_cloud(stamp, "world", simulation.visual_points(), stress)
        put("mesh/points", "sensor_msgs/msg/PointCloud2", cloud, number)
        if number % 10 == 0:
            values = {"real_time_factor": 1.0, "step_ms": 0.2, "time_s": simulation.time}
            level, sentence = (1, "slow") if number == 20 else (0, "running")
            report = messages.diagnostic_array(
                stamp, "tripod/simulator", "tripod", bytes([level]), sentence, values
            )
            put("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", report, number)
    writer.close()
    return folder


def pose(messages: object, simulation: object, at: object) -> object:
    position = getattr(at, "position", at)
    turn = getattr(at, "quaternion_xyzw", (0.0, 0.0, 0.0, 1.0))
    stamp = messages.time_message(simulation.time)
    return messages.pose_stamped(stamp, "world", position, turn)


def markers(name: str, kind: int, height: float = 0.0) -> object:
    """A marker array of one line strip (4) or one list of triangles (11)."""
    from geometry_msgs.msg import Point
    from visualization_msgs.msg import Marker, MarkerArray

    marker = Marker(ns=name, type=kind)
    marker.scale.x, marker.color.a, marker.pose.orientation.w = 0.001, 1.0, 1.0
    marker.points = [Point(x=0.01 * k, z=height) for k in range(3)]
    return MarkerArray(markers=[marker])
