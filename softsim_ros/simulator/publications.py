"""Every topic the simulator sends from its physics thread, each at its own rate."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState, PointCloud2
from shape_msgs.msg import Mesh
from std_msgs.msg import Float64, String
from visualization_msgs.msg import Marker

from softsim_core.arrays import Array
from softsim_core.simulation import Simulation
from softsim_ros import messages
from softsim_ros.description.urdf import control_topics, urdf
from softsim_ros.frames import WORLD, RobotFrames
from softsim_ros.optional_messages import optional_type
from softsim_ros.qos import LATCHED
from softsim_ros.simulator.chambers import ChamberPublications
from softsim_ros.simulator.objects import ObjectPublications
from softsim_ros.simulator.pacing import RateGate
from softsim_ros.simulator.sensors import SensorPublications
from softsim_ros.simulator.structure import StructurePublications
from softsim_ros.simulator.transforms import FrameTree

MARKER_PERIOD_S = 0.1
"""RViz copes with one large marker at 10 Hz."""

TF_PERIOD_S = 1.0 / 50.0


class Publications:
    """Publishers of a simulation's state; `publish` is called from the one thread that owns the simulation.

    Args:
        node: Owner of the publishers.
        simulation: What will be shown; its surface and joints must not change.
        frames: Names of the robot's frames.
        mesh_rate: Messages a second on mesh/points, in [Hz]; 0 sends none.
        publish_clock: Send simulated time on /clock and stamp every message with it.
        marker_stress: Stress in [Pa] of the marker's last colour; 0 takes the largest of each message.
        overrides: Text of what is laid over the scene's file.
        scenes: Names of the scenes that can be loaded in its place.
    """

    def __init__(
        self,
        node: Node,
        simulation: Simulation,
        frames: RobotFrames,
        *,
        mesh_rate: float = 30.0,
        publish_clock: bool = False,
        marker_stress: float = 0.0,
        overrides: str = "",
        scenes: Sequence[str] = (),
    ) -> None:
        self._context, self._now = node.context, node.get_clock().now
        self._frames = frames
        self._control = control_topics(node.get_namespace())
        self.marker_stress = marker_stress
        self._mesh_gate: RateGate | None = None
        self.mesh_rate = mesh_rate
        self._marker_gate, self._tf_gate = RateGate(MARKER_PERIOD_S), RateGate(TF_PERIOD_S)
        self._publish_clock = publish_clock
        if publish_clock:
            self._clock = node.create_publisher(Clock, "/clock", 1)
        self._joint_states = node.create_publisher(JointState, "joint_states", 10)
        self._chambers = ChamberPublications(node, frames.base)
        self._effector_pose = node.create_publisher(PoseStamped, "effector_pose", 5)
        self._base_shift = node.create_publisher(Float64, "base_shift", LATCHED)
        self._shown_shift: float | None = None
        self._points = node.create_publisher(PointCloud2, "mesh/points", 1)
        self._marker = node.create_publisher(Marker, "mesh/marker", 1)
        self._topology = node.create_publisher(Mesh, "mesh/topology", LATCHED)
        self._tf: Any | None = None
        self._create_tf(node)
        self._description = node.create_publisher(String, "robot_description", LATCHED)
        self._structure = StructurePublications(node)
        self._objects = ObjectPublications(node)
        self._sensors = SensorPublications(node, frames.base)
        self.show_scene(simulation, overrides, scenes)

    def show_scene(self, simulation: Simulation, overrides: str = "", scenes: Sequence[str] = ()) -> None:
        """Send what does not move: of the first simulation, or of another one that takes its place."""
        self._tree = FrameTree(simulation, self._frames)
        self._description.publish(String(data=urdf(simulation.robot, topics=self._control)))
        if self._tf is not None:
            self._tf_static.publish(self._make_tf(transforms=self._tree.still(self._now().to_msg())))
        points, triangles = simulation.visual_rest_points, simulation.visual_triangles
        self._topology.publish(messages.topology(points, triangles))
        self._structure.show_scene(simulation, overrides, scenes)
        self._objects.show_scene(simulation, self._tree.of_body)
        self._chambers.show_scene(simulation)
        self._sensors.show_scene(simulation, self._tree)
        self._template = messages.MarkerTemplate(WORLD, triangles) if len(triangles) else None

    @property
    def mesh_rate(self) -> float:
        """Messages a second on mesh/points, in [Hz]; 0 sends none."""
        return 1.0 / self._mesh_gate.period_s if self._mesh_gate else 0.0

    @mesh_rate.setter
    def mesh_rate(self, rate: float) -> None:
        self._mesh_gate = RateGate(1.0 / rate) if rate > 0.0 else None

    def publish(self, simulation: Simulation, whole: bool) -> float:
        """Send what is due, only to topics that somebody listens to where a message is large.

        Args:
            simulation: State to show.
            whole: Send everything now, whatever the rates.

        Returns:
            Time it took in [ms].
        """
        started = time.perf_counter()
        try:
            self._publish(simulation, whole)
        except Exception:
            if self._context.ok():
                raise
            # Ctrl-C and SIGTERM invalidate the publishers before anybody can stop this thread
        return 1e3 * (time.perf_counter() - started)

    def stamp(self, simulation: Simulation) -> Time:
        """Simulated time where /clock is published here, the node's clock otherwise."""
        return messages.time_message(simulation.time) if self._publish_clock else self._now().to_msg()

    def _publish(self, simulation: Simulation, whole: bool) -> None:
        stamp, now = self.stamp(simulation), time.monotonic()
        if self._publish_clock:
            self._clock.publish(messages.clock(simulation.time))
        self._joint_states.publish(
            messages.joint_state(
                stamp,
                self._frames.base,
                simulation.joint_names,
                simulation.joint_positions,
                simulation.joint_velocities,
                simulation.joint_efforts,
            )
        )
        self._chambers.publish(simulation, stamp)
        if simulation.base_shift != self._shown_shift:
            self._shown_shift = simulation.base_shift
            self._base_shift.publish(Float64(data=self._shown_shift))
        effector = simulation.effector_pose
        if effector is not None:
            self._effector_pose.publish(
                messages.pose_stamped(stamp, WORLD, effector.position, effector.quaternion_xyzw)
            )
        if self._tf is not None and (self._tf_gate.passes(now) or whole):
            self._tf.publish(self._make_tf(transforms=self._tree.moving(simulation, stamp)))
        self._structure.publish(simulation, stamp, now, whole)
        self._objects.publish(simulation, stamp, now, whole)
        self._sensors.publish(simulation, stamp, whole)
        points_due = self._mesh_gate is not None and _is_due(self._points, self._mesh_gate, now, whole)
        marker_due = self._template is not None and _is_due(self._marker, self._marker_gate, now, whole)
        if points_due or marker_due:
            self._publish_mesh(simulation, stamp, points=points_due, marker=marker_due)

    def _publish_mesh(self, simulation: Simulation, stamp: Time, *, points: bool, marker: bool) -> None:
        vertices = simulation.visual_points()
        values = simulation.visual_values(simulation.von_mises())
        stress: Array = np.maximum(values, 0.0)  # vertices outside their element extrapolate below zero
        if points:
            self._points.publish(messages.point_cloud(stamp, WORLD, vertices, stress))
        if marker and self._template is not None:
            self._marker.publish(self._template.fill(stamp, vertices, stress, self.marker_stress))

    def _create_tf(self, node: Node) -> None:
        message_type = optional_type("tf2_msgs.msg", "TFMessage")
        if message_type is None:
            node.get_logger().info(
                "tf2_msgs is not installed: no transforms on /tf (poses are on effector_pose)"
            )
            return
        self._make_tf: Callable[..., Any] = message_type
        self._tf = node.create_publisher(message_type, "/tf", 100)
        self._tf_static = node.create_publisher(message_type, "/tf_static", LATCHED)


def _is_due(publisher: Any, gate: RateGate, now: float, whole: bool) -> bool:
    """Whether somebody listens and it is time."""
    return publisher.get_subscription_count() > 0 and (gate.passes(now) or whole)
