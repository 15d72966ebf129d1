"""Topics that the simulator publishes from its physics thread, each at its own rate.

`TOPICS` lists those of every scene; a new one is one more row.

`bodies/poses` (geometry_msgs/PoseArray, frame world, 60 Hz) has the poses of the rigid bodies in scene
order. `bodies/topology` (latched), `cables`, `chambers` and `contacts` (30 Hz) and `collisions` (10 Hz) have
markers, see object_markers.

A joint's effort is the pressure relative to the surrounding air, while FluidPressure is absolute. The
atmospheric pressure of the scene is therefore added, the same at any height. The variance is 0, which means
unknown.

`scene/structure` (std_msgs/String, latched) is a JSON object, see scene_topics.structure; `mesh/tetrahedra`
(std_msgs/UInt32MultiArray, latched) has the node indices of all elements; `mesh/nodes`
(sensor_msgs/PointCloud2, 10 Hz) has the nodes in the format of mesh/points; `frames`
(geometry_msgs/PoseArray) has the poses in `world` of the frames that the structure names, at 30 Hz.

Each sensor publishes the standard message of its kind, see messages.sensors, once per sample, with the stamp
of the step in which it was sampled. `contacts/points` (sensor_msgs/PointCloud2) has every contact of the
step.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseArray, PoseStamped
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import FluidPressure, JointState, PointCloud2
from shape_msgs.msg import Mesh
from std_msgs.msg import Float64, String, UInt32MultiArray
from visualization_msgs.msg import Marker, MarkerArray

from softsim_core.base import Array
from softsim_core.physics.actuation.chamber import ATMOSPHERE
from softsim_core.physics.dynamics import StageShare, stage_tree
from softsim_core.physics.mechanics import Pose
from softsim_core.physics.sensing import SensorReading, SimulatedSensorDescription
from softsim_core.scene import JointDescription, RobotDescription
from softsim_core.simulation import Simulation
from softsim_node import EVERY_ONE, LATCHED, WORLD, RobotFrames
from softsim_ros import chambers_of, messages, optional_type, topic_words
from softsim_ros.description import control_topics, urdf
from softsim_ros.messages import (
    SensorMessage,
    contact_cloud,
    format_value,
    header,
    messages_of,
    tension_cloud,
)
from softsim_ros.nodes.simulator.monitor import RateGate, StageTime
from softsim_ros.nodes.simulator.object_markers import (
    bodies_topology,
    cable_markers,
    cable_places,
    chamber_colours,
    chamber_markers,
    chamber_places,
    collision_markers,
    collision_places,
    contact_markers,
)
from softsim_ros.nodes.simulator.scene_topics import FrameTree, index_array, structure


def stage_statistics(stamp: Time, robot: str, stages: Mapping[str, StageTime]) -> DiagnosticArray:
    """Return diagnostics of all stages, each before its parts; see `_status` for the values."""
    tree = stage_tree({name: time.total for name, time in stages.items()})
    whole = sum(share.total for share in tree if share.level == 0)
    return DiagnosticArray(
        header=header(stamp, ""),
        status=[_status(share, robot, stages[share.name], whole) for share in tree],
    )


def _status(share: StageShare, robot: str, time: StageTime, whole: float) -> DiagnosticStatus:
    """Return level, number of calls, times per call and in total in [ms], and percentage of the whole."""
    values = {
        "level": share.level,
        "calls": time.calls,
        "min_ms": round(time.minimum, 4),
        "mean_ms": round(time.mean, 4),
        "max_ms": round(time.maximum, 4),
        "deviation_ms": round(time.deviation, 4),
        "total_ms": round(time.total, 3),
        "percent": round(100.0 * time.total / whole, 1) if whole > 0.0 else 0.0,
    }
    return DiagnosticStatus(
        name=share.name,
        hardware_id=robot,
        values=[KeyValue(key=key, value=format_value(value)) for key, value in values.items()],
    )


class ShownScene(NamedTuple):
    """A scene whose topics are published.

    Attributes:
        frames: Names of the robot's frames.
        tree: Frames of the scene.
        namespace: Namespace of the robot.
        overrides: Text of the overrides of its file.
        scenes: Names of the scenes that can be loaded in its place.
        generation: Number that grows with every scene, across restarts too.
        marker: Template of mesh/marker; None if the scene has no visible surface.
    """

    frames: RobotFrames
    tree: FrameTree
    namespace: str
    overrides: str
    scenes: Sequence[str]
    generation: int
    marker: messages.MarkerTemplate | None


@dataclass(frozen=True)
class Moment:
    """A state to publish.

    Attributes:
        simulation: The state.
        scene: Its scene.
        stamp: Time stamp of the messages.
        now: Steady clock in [s].
        whole: Whether to publish on all topics with subscribers now, whatever the rates.
        marker_stress: Stress in [Pa] of the last colour of mesh/marker; 0 takes the largest one.
    """

    simulation: Simulation
    scene: ShownScene
    stamp: Time
    now: float
    whole: bool
    marker_stress: float

    @cached_property
    def surface(self) -> tuple[Array, Array]:
        """Points of the visible surface in [m], shape (p, 3), and the stress at each in [Pa], shape (p,)."""
        values = self.simulation.visual_values(self.simulation.von_mises())
        # vertices outside their element extrapolate below zero
        return self.simulation.visual_points(), np.maximum(values, 0.0)


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic of the simulator; volatile ones are published only while they have subscribers.

    Attributes:
        name: Name in the robot's namespace, or an absolute name.
        message: Type of the message; None: its package is not installed.
        build: Returns the message of a moment; None: there is none.
        period_s: Shortest mean time in [s] from one message to the next; 0: one for each step. None: one for
            each scene, latched.
        moving: Returns points in [m] and colours of the markers that `build` returned for the scene, see
            messages.MovingMarkers; without colours these stay. None: `build` returns each message.
        concerns: Whether a scene has anything to show on it; if not, it is published only with all topics.
        qos: Quality of service, or the length of the queue; LATCHED messages are published when they change.
    """

    name: str
    message: type[Any] | None
    build: Callable[[Moment], Any]
    period_s: float | None
    moving: Callable[[Simulation], tuple[Sequence[Array], Sequence[Array]]] | None = None
    concerns: Callable[[Simulation], bool] = lambda _: True
    qos: QoSProfile | int = 1


class TopicPublication:
    """Publishes a Topic.

    Attributes:
        gate: Limit of its rate; None: the state is not published.
    """

    def __init__(self, topic: Topic, node: Node, below: str) -> None:
        self._topic = topic
        self.gate = None if topic.period_s is None else RateGate(topic.period_s)
        name = topic.name if topic.name.startswith("/") else f"{below}{topic.name}"
        qos = LATCHED if topic.period_s is None else topic.qos
        self._publisher = node.create_publisher(topic.message, name, qos)
        self._newest: Any = None

    def show_scene(self, moment: Moment) -> None:
        """Publish the message of a scene, or prepare the markers that move, if it has any."""
        if self._topic.period_s is None:
            self._publisher.publish(self._topic.build(moment))
        elif self._topic.moving is not None:
            self._markers = messages.MovingMarkers(self._topic.build(moment).markers)

    def publish(self, moment: Moment) -> None:
        """Publish the state if a message is due."""
        topic, whole = self._topic, moment.whole
        if self.gate is None:
            return
        if topic.qos is LATCHED:
            message, before = topic.build(moment), self._newest
            if message != before:
                self._newest = message
                self._publisher.publish(message)
            return
        if not (self._publisher.get_subscription_count() and (self.gate.passes(moment.now) or whole)):
            return
        if not (whole or topic.concerns(moment.simulation)):
            return
        if topic.moving is not None:
            self._publisher.publish(self._markers.fill(moment.stamp, *topic.moving(moment.simulation)))
        elif (message := topic.build(moment)) is not None:
            self._publisher.publish(message)


def pose_array(stamp: Time, poses: Iterable[Pose]) -> PoseArray:
    """Return poses in `world`."""
    shown = [messages.pose(pose.position, pose.quaternion_xyzw) for pose in poses]
    return PoseArray(header=header(stamp, WORLD), poses=shown)


def joint_states(at: Moment) -> JointState:
    """Return positions, velocities and efforts of all joints."""
    joints = at.simulation
    return messages.joint_state(
        at.stamp,
        at.scene.frames.base,
        joints.joint_names,
        joints.joint_positions,
        joints.joint_velocities,
        joints.joint_efforts,
    )


def effector_pose(at: Moment) -> PoseStamped | None:
    """Return the pose of the effector; None without an effector."""
    pose = at.simulation.effector_pose
    if pose is None:
        return None
    return messages.pose_stamped(at.stamp, WORLD, pose.position, pose.quaternion_xyzw)


def mesh_marker(at: Moment) -> bytes | None:
    """Return the serialised marker of the visible surface; None without one."""
    marker = at.scene.marker
    return None if marker is None else marker.fill(at.stamp, *at.surface, at.marker_stress)


def scene_structure(at: Moment) -> String:
    """Return the structure of the scene as a JSON object."""
    scene = at.scene
    return String(data=json.dumps(structure(at.simulation, scene.overrides, scene.scenes, scene.generation)))


TRANSFORMS: Final[Any] = optional_type("tf2_msgs.msg", "TFMessage")
CLOCK: Final = "/clock"
POINTS: Final = "mesh/points"

TOPICS: Final[Sequence[Topic]] = (
    # one message per scene
    Topic("/tf_static", TRANSFORMS, lambda at: TRANSFORMS(transforms=at.scene.tree.still(at.stamp)), None),
    Topic(
        "robot_description",
        String,
        lambda at: String(data=urdf(at.simulation.robot, topics=control_topics(at.scene.namespace))),
        None,
    ),
    Topic(
        "mesh/topology",
        Mesh,
        lambda at: messages.topology(at.simulation.visual_rest_points, at.simulation.visual_triangles),
        None,
    ),
    Topic("mesh/tetrahedra", UInt32MultiArray, lambda at: index_array(at.simulation.tets), None),
    Topic("scene/structure", String, scene_structure, None),
    Topic(
        "bodies/topology", MarkerArray, lambda at: bodies_topology(at.simulation, at.scene.tree.of_body), None
    ),
    # messages of the state
    Topic(CLOCK, Clock, lambda at: messages.clock(at.simulation.time), 0.0),
    Topic("joint_states", JointState, joint_states, 0.0, qos=10),
    Topic("base_shift", Float64, lambda at: Float64(data=at.simulation.base_shift), 0.0, qos=LATCHED),
    Topic("effector_pose", PoseStamped, effector_pose, 0.0, qos=5),
    Topic(
        "/tf",
        TRANSFORMS,
        lambda at: TRANSFORMS(transforms=at.scene.tree.moving(at.simulation, at.stamp)),
        1.0 / 50.0,
        qos=100,
    ),
    Topic("frames", PoseArray, lambda at: pose_array(at.stamp, at.simulation.frames().values()), 1.0 / 30.0),
    Topic(
        "mesh/nodes",
        PointCloud2,
        lambda at: messages.point_cloud(at.stamp, WORLD, at.simulation.positions, at.simulation.von_mises()),
        0.1,
    ),
    Topic(
        "bodies/poses",
        PoseArray,
        lambda at: pose_array(at.stamp, at.simulation.rigid_poses) if at.simulation.rigid_bodies else None,
        1.0 / 60.0,
        qos=5,
    ),
    Topic(
        "cables",
        MarkerArray,
        lambda at: cable_markers(at.simulation, at.stamp),
        1.0 / 30.0,
        cable_places,
        concerns=lambda simulation: bool(simulation.actuators),
    ),
    Topic(
        "cables/tensions",
        PointCloud2,
        lambda at: tension_cloud(at.stamp, WORLD, at.simulation.actuators, at.simulation.joint_names),
        1.0 / 30.0,
        concerns=lambda simulation: any(len(each.tensions) for each in simulation.actuators),
    ),
    Topic(
        "chambers",
        MarkerArray,
        lambda at: chamber_markers(at.simulation, at.stamp),
        1.0 / 30.0,
        chamber_places,
        concerns=lambda simulation: any(chamber_colours(simulation)),
    ),
    Topic(
        "contacts",
        MarkerArray,
        lambda at: contact_markers(at.simulation, at.stamp),
        1.0 / 30.0,
        concerns=lambda simulation: bool(simulation.collision_surfaces),
    ),
    Topic(
        "collisions",
        MarkerArray,
        lambda at: collision_markers(at.simulation, at.stamp),
        0.1,
        collision_places,
    ),
    Topic(
        "contacts/points", PointCloud2, lambda at: contact_cloud(at.stamp, WORLD, at.simulation.contacts), 0.0
    ),
    Topic(POINTS, PointCloud2, lambda at: messages.point_cloud(at.stamp, WORLD, *at.surface), 1.0 / 30.0),
    Topic("mesh/marker", Marker, mesh_marker, 0.1),  # RViz displays one large marker at 10 Hz without delay
)
"""Topics of every scene, in the order in which they are published."""


def replace_publishers(
    node: Node, before: dict[tuple[str, type], Publisher], topics: Sequence[tuple[str, type]]
) -> dict[tuple[str, type], Publisher]:
    """Return a publisher by topic and type; one in `before` stays, those that are not used are destroyed.

    No other callback of the node may run meanwhile: the calling callback waits until the physics has taken
    over the scene.
    """
    for key in before.keys() - set(topics):
        node.destroy_publisher(before[key])
    return {key: before.get(key) or node.create_publisher(key[1], key[0], EVERY_ONE) for key in topics}


class ChamberPublications:
    """Publishes the pressures of the chambers; a robot without chambers has no such topics."""

    def __init__(self, node: Node, below: str) -> None:
        self._node, self._below = node, below
        self._publishers: dict[tuple[str, type], Publisher] = {}
        self._joints: list[tuple[int, float]] = []  # and the atmosphere in [Pa] around each

    def show_scene(self, moment: Moment) -> None:
        """Create publishers for a scene's chambers and remove all others."""
        joints = moment.simulation.robot.joints
        chambers = chambers_of(joints)
        topics = [(f"{self._below}{topic}", FluidPressure) for topic in chambers.values()]
        self._joints = [(number, atmosphere_of(joints[number])) for number in chambers]
        self._publishers = replace_publishers(self._node, self._publishers, topics)

    def publish(self, moment: Moment) -> None:
        """Publish all pressures."""
        if not self._joints:
            return
        efforts = moment.simulation.joint_efforts
        at = header(moment.stamp, moment.scene.frames.base)
        for (joint, around), publisher in zip(self._joints, self._publishers.values(), strict=True):
            pressure = around + float(efforts[joint])
            publisher.publish(FluidPressure(header=at, fluid_pressure=pressure))


class SensorPublications:
    """Publishes sensor readings, each with the frame of its sensor, or of the base without one."""

    def __init__(self, node: Node, below: str) -> None:
        self._node, self._below = node, below
        self._publishers: dict[tuple[str, type], Publisher] = {}
        self._sensors: list[tuple[str, str, list[tuple[str, SensorMessage]]]] = []  # name, frame, topics
        self._sent: dict[str, SensorReading] = {}

    def show_scene(self, moment: Moment) -> None:
        """Create publishers for a scene's sensors and remove all others."""
        robot, described = moment.simulation.robot, moment.simulation.scene.sensors
        words = topic_words([each.name for each in described], "sensor")
        self._sent, self._sensors = {}, []
        for sensor, word in zip(described, words, strict=True):
            topics = [
                (f"{self._below}sensors/{word}{message.below}", message)
                for message in messages_of(sensor, _around(sensor, robot))
            ]
            self._sensors.append((sensor.name, _frame_of(sensor, moment.scene), topics))
        used = [(topic, message.message) for *_, topics in self._sensors for topic, message in topics]
        self._publishers = replace_publishers(self._node, self._publishers, used)

    def publish(self, moment: Moment) -> None:
        """Publish new samples on topics with subscribers, or all of them with all topics."""
        for name, frame, topics in self._sensors:
            reading = moment.simulation.sensors[name]
            if reading is self._sent.get(name) and not moment.whole:
                continue
            self._sent[name] = reading
            at: Any = None
            for topic, message in topics:
                publisher = self._publishers[topic, message.message]
                if publisher.get_subscription_count():
                    at = at or header(moment.stamp, frame)
                    publisher.publish(message.write(at, reading))


def _frame_of(sensor: SimulatedSensorDescription, scene: ShownScene) -> str:
    if sensor.mount is not None:
        return scene.tree.of_sensor(sensor.name)
    return scene.tree.of_place(sensor.axes) if sensor.axes else scene.frames.base


def _around(sensor: SimulatedSensorDescription, robot: RobotDescription) -> float:
    """Return the absolute pressure in [Pa] of the air around the joint that a sensor measures."""
    names = {output.joint for output in sensor.outputs}
    return next((atmosphere_of(joint) for joint in robot.joints if joint.name in names), ATMOSPHERE)


def atmosphere_of(joint: JointDescription) -> float:
    """Return the absolute pressure in [Pa] around a joint's actuator; the standard one if it has no gas."""
    gas = None if joint.actuator is None else joint.actuator.gas
    return ATMOSPHERE if gas is None else gas.atmosphere


class Publications:
    """Publishes the state of a simulation; `publish` is called from the thread that owns it.

    Args:
        simulation: What will be published; its surface and joints must not change.
        mesh_rate: Rate of mesh/points in [Hz]; 0 publishes none.
        publish_clock: Publish simulated time on /clock and stamp every message with it.
        marker_stress: Stress in [Pa] of the marker's last colour; 0 takes the largest of each message.
        overrides: Text of the overrides of the scene's file.
        scenes: Names of the scenes that can be loaded in its place.
        below: Prefix of the topics that are not absolute, such as "~/".
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
        below: str = "",
    ) -> None:
        self._context, self._now = node.context, node.get_clock().now
        self._frames, self._publish_clock = frames, publish_clock
        self._namespace, self._generation = node.get_namespace(), 0
        self.marker_stress = marker_stress
        if TRANSFORMS is None:
            node.get_logger().info(
                "tf2_msgs is not installed: no transforms on /tf (poses are on effector_pose)"
            )
        topics = {
            topic.name: TopicPublication(topic, node, below)
            for topic in TOPICS
            if topic.message is not None and (publish_clock or topic.name != CLOCK)
        }
        self._points = topics[POINTS]
        self.set_mesh_rate(mesh_rate)
        self._publications: list[TopicPublication | ChamberPublications | SensorPublications] = [
            *topics.values(),
            ChamberPublications(node, below),
            SensorPublications(node, below),
        ]
        self.show_scene(simulation, overrides, scenes)

    def show_scene(self, simulation: Simulation, overrides: str = "", scenes: Sequence[str] = ()) -> None:
        """Publish the static part of the first simulation, or of another one that replaces it."""
        self._generation = max(self._generation + 1, time.time_ns())
        triangles = simulation.visual_triangles
        self._scene = ShownScene(
            self._frames,
            FrameTree(simulation, self._frames),
            self._namespace,
            overrides,
            scenes,
            self._generation,
            messages.MarkerTemplate(WORLD, triangles) if len(triangles) else None,
        )
        moment = self._moment(simulation, self._now().to_msg(), whole=True)
        for publication in self._publications:
            publication.show_scene(moment)

    def set_mesh_rate(self, rate: float) -> None:
        """Set the rate of mesh/points in [Hz]; 0 publishes none."""
        self._points.gate = RateGate(1.0 / rate) if rate > 0.0 else None

    def publish(self, simulation: Simulation, whole: bool) -> float:
        """Publish what is due; volatile topics only if they have subscribers.

        Args:
            simulation: State to publish.
            whole: Publish everything now, whatever the rates.

        Returns:
            Time it took in [ms].
        """
        started = time.perf_counter()
        try:
            moment = self._moment(simulation, self.stamp(simulation), whole=whole)
            for publication in self._publications:
                publication.publish(moment)
        except Exception:
            if self._context.ok():
                raise
            # Ctrl-C and SIGTERM invalidate the publishers before this thread can be stopped
        return 1e3 * (time.perf_counter() - started)

    def stamp(self, simulation: Simulation) -> Time:
        """Return simulated time if this node publishes /clock, otherwise the time of the node's clock."""
        return messages.time_message(simulation.time) if self._publish_clock else self._now().to_msg()

    def _moment(self, simulation: Simulation, stamp: Time, *, whole: bool) -> Moment:
        return Moment(simulation, self._scene, stamp, time.monotonic(), whole, self.marker_stress)
