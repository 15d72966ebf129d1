"""Topics that the simulator publishes from its physics thread, each at its own rate.

`SCENE_TOPICS` and `STATE_TOPICS` list those with one message per scene or state; a new one is one more entry.

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
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Protocol

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
from softsim_core.physics.sensing import SensorReading, SimulatedSensorDescription
from softsim_core.scene import JointDescription, RobotDescription
from softsim_core.simulation import Simulation
from softsim_node import EVERY_ONE, LATCHED, NEWEST_ONLY, WORLD, RobotFrames
from softsim_ros import chambers_of, messages, optional_type, topic_words
from softsim_ros.description import control_topics, urdf
from softsim_ros.messages import SensorMessage, contact_cloud, format_value, header, messages_of
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


POSES_PERIOD_S = 1.0 / 60.0
NODES_PERIOD_S = 0.1
MARKERS_PERIOD_S = 1.0 / 30.0
COLLISIONS_PERIOD_S = 0.1


@dataclass(frozen=True, slots=True)
class ShownScene:
    """A scene whose static part is published.

    Attributes:
        simulation: The scene.
        tree: Its frames.
        namespace: Namespace of the robot.
        overrides: Text of the overrides of its file.
        scenes: Names of the scenes that can be loaded in its place.
        generation: Number that grows with every scene, across restarts too.
    """

    simulation: Simulation
    tree: FrameTree
    namespace: str
    overrides: str
    scenes: Sequence[str]
    generation: int


@dataclass(frozen=True, slots=True)
class Moment:
    """A state to publish.

    Attributes:
        simulation: The state.
        stamp: Time stamp of the messages.
        now: Steady clock in [s].
        whole: Whether to publish on all topics with subscribers now, whatever the rates.
    """

    simulation: Simulation
    stamp: Time
    now: float
    whole: bool


class Publication(Protocol):
    """What publishes on one or more topics; used from the thread that owns the simulation."""

    def show_scene(self, shown: ShownScene) -> None:
        """Publish the static part of the first scene, or of another one that replaces it."""

    def publish(self, moment: Moment) -> None:
        """Publish what is due."""


@dataclass(frozen=True, slots=True)
class SceneTopic:
    """A latched topic with one message per scene.

    Attributes:
        name: Name in the robot's namespace.
        message: Type of the message.
        build: Returns the message of a scene.
    """

    name: str
    message: type[Any]
    build: Callable[[ShownScene], Any]


class ScenePublication:
    """Publishes a SceneTopic.

    Args:
        topic: The topic.
        node: Owner of the publisher.
    """

    def __init__(self, topic: SceneTopic, node: Node) -> None:
        self._build = topic.build
        self._publisher = node.create_publisher(topic.message, topic.name, LATCHED)

    def show_scene(self, shown: ShownScene) -> None:
        """Publish the message of a scene."""
        self._publisher.publish(self._build(shown))

    def publish(self, moment: Moment) -> None:
        """Do nothing: the message of the scene is still valid."""


@dataclass(frozen=True, slots=True)
class StateTopic:
    """A topic with messages of the state, at a limited rate and only while it has subscribers.

    Attributes:
        name: Name in the robot's namespace.
        message: Type of the message.
        period_s: Shortest mean time in [s] from one message to the next; 0: one for each step.
        build: Returns the message of a state at a time; None: there is none.
        moving: Returns points in [m] and colours of the markers that `build` returned for the scene, see
            messages.MovingMarkers; without colours these stay. None: `build` returns each message.
        concerns: Whether a scene has anything to show on it; if not, it is published only with all topics.
        qos: Quality of service, or the length of the queue.
    """

    name: str
    message: type[Any]
    period_s: float
    build: Callable[[Simulation, Time], Any]
    moving: Callable[[Simulation], tuple[Sequence[Array], Sequence[Array]]] | None = None
    concerns: Callable[[Simulation], bool] = lambda _: True
    qos: QoSProfile | int = 1


class StatePublication:
    """Publishes a StateTopic.

    Args:
        topic: The topic.
        node: Owner of the publisher.
    """

    def __init__(self, topic: StateTopic, node: Node) -> None:
        self._topic, self._gate = topic, RateGate(topic.period_s)
        self._publisher = node.create_publisher(topic.message, topic.name, topic.qos)

    def show_scene(self, shown: ShownScene) -> None:
        """Prepare the markers that move, if it has any."""
        if self._topic.moving is not None:
            markers = self._topic.build(shown.simulation, Time()).markers
            self._markers = messages.MovingMarkers(markers)

    def publish(self, moment: Moment) -> None:
        """Publish the state if a message is due."""
        topic, simulation = self._topic, moment.simulation
        if not is_due(self._publisher, self._gate, moment):
            return
        if not (moment.whole or topic.concerns(simulation)):
            return
        if topic.moving is not None:
            self._publisher.publish(self._markers.fill(moment.stamp, *topic.moving(simulation)))
        elif (message := topic.build(simulation, moment.stamp)) is not None:
            self._publisher.publish(message)


def is_due(publisher: Publisher, gate: RateGate, moment: Moment) -> bool:
    """Return whether a topic has subscribers, and its period is over or all topics are published."""
    return publisher.get_subscription_count() > 0 and (gate.passes(moment.now) or moment.whole)


def body_poses(simulation: Simulation, stamp: Time) -> PoseArray | None:
    """Return the poses of the rigid bodies in scene order; None if there are none."""
    if not simulation.rigid_bodies:
        return None
    poses = [messages.pose(p.position, p.quaternion_xyzw) for p in simulation.rigid_poses]
    return PoseArray(header=header(stamp, WORLD), poses=poses)


def frame_poses(simulation: Simulation, stamp: Time) -> PoseArray:
    """Return the poses of the frames in the order of the scene's structure."""
    poses = [messages.pose(p.position, p.quaternion_xyzw) for p in simulation.frames().values()]
    return PoseArray(header=header(stamp, WORLD), poses=poses)


def node_cloud(simulation: Simulation, stamp: Time) -> PointCloud2:
    """Return the nodes of all bodies and the stress at each."""
    return messages.point_cloud(stamp, WORLD, simulation.positions, simulation.von_mises())


SCENE_TOPICS: Final[Sequence[SceneTopic]] = (
    SceneTopic(
        "robot_description",
        String,
        lambda shown: String(data=urdf(shown.simulation.robot, topics=control_topics(shown.namespace))),
    ),
    SceneTopic(
        "mesh/topology",
        Mesh,
        lambda shown: messages.topology(
            shown.simulation.visual_rest_points, shown.simulation.visual_triangles
        ),
    ),
    SceneTopic("mesh/tetrahedra", UInt32MultiArray, lambda shown: index_array(shown.simulation.tets)),
    SceneTopic(
        "scene/structure",
        String,
        lambda shown: String(
            data=json.dumps(structure(shown.simulation, shown.overrides, shown.scenes, shown.generation))
        ),
    ),
    SceneTopic(
        "bodies/topology", MarkerArray, lambda shown: bodies_topology(shown.simulation, shown.tree.of_body)
    ),
)
"""Topics with one message per scene, in the order in which they are published."""

STATE_TOPICS: Final[Sequence[StateTopic]] = (
    StateTopic("frames", PoseArray, MARKERS_PERIOD_S, frame_poses),
    StateTopic("mesh/nodes", PointCloud2, NODES_PERIOD_S, node_cloud),
    StateTopic("bodies/poses", PoseArray, POSES_PERIOD_S, body_poses, qos=5),
    StateTopic(
        "cables",
        MarkerArray,
        MARKERS_PERIOD_S,
        cable_markers,
        cable_places,
        concerns=lambda simulation: bool(simulation.actuators),
    ),
    StateTopic(
        "chambers",
        MarkerArray,
        MARKERS_PERIOD_S,
        chamber_markers,
        chamber_places,
        concerns=lambda simulation: any(chamber_colours(simulation)),
    ),
    StateTopic(
        "contacts",
        MarkerArray,
        MARKERS_PERIOD_S,
        contact_markers,
        concerns=lambda simulation: bool(simulation.collision_surfaces),
    ),
    StateTopic("collisions", MarkerArray, COLLISIONS_PERIOD_S, collision_markers, collision_places),
    StateTopic(
        "contacts/points",
        PointCloud2,
        0.0,
        lambda simulation, stamp: contact_cloud(stamp, WORLD, simulation.contacts),
        qos=NEWEST_ONLY,
    ),
)
"""Topics with messages of the state, in the order in which they are published."""

DEPTH: Final = 10


class ChamberPublications:
    """Publishes the pressures of the chambers; a robot without chambers has no such topics.

    Args:
        node: Owner of the publishers.
        frame: Frame that the messages name.
    """

    def __init__(self, node: Node, frame: str) -> None:
        self._node, self._frame = node, frame
        self._publishers: dict[str, Publisher] = {}
        self._joints: list[tuple[int, float]] = []  # and the atmosphere in [Pa] around each

    def show_scene(self, shown: ShownScene) -> None:
        """Create publishers for a scene's chambers and remove all others.

        A topic that stays keeps its publisher. No other callback of the node may run meanwhile: the calling
        callback waits until the physics has taken over the scene.
        """
        joints = shown.simulation.robot.joints
        chambers = chambers_of(joints)
        self._joints = []
        for number in chambers:
            self._joints.append((number, atmosphere_of(joints[number])))
        topics = list(chambers.values())
        before, self._publishers = self._publishers, {}
        for topic in before.keys() - set(topics):
            self._node.destroy_publisher(before.pop(topic))
        for topic in topics:
            self._publishers[topic] = before.get(topic) or self._node.create_publisher(
                FluidPressure, topic, DEPTH
            )

    def publish(self, moment: Moment) -> None:
        """Publish all pressures."""
        if not self._joints:
            return
        efforts = moment.simulation.joint_efforts
        for (joint, around), publisher in zip(self._joints, self._publishers.values(), strict=True):
            pressure = around + float(efforts[joint])
            publisher.publish(messages.fluid_pressure(moment.stamp, self._frame, pressure))


class SensorPublications:
    """Publishes sensor readings; used from the physics thread.

    Args:
        node: Owner of the publishers.
        base: Frame of readings that have no frame of their own.
    """

    def __init__(self, node: Node, base: str) -> None:
        self._node, self._base = node, base
        self._publishers: dict[tuple[str, type], Publisher] = {}
        self._sensors: list[
            tuple[str, str, list[tuple[Publisher, SensorMessage]]]
        ] = []  # name, frame, topics
        self._sent: dict[str, SensorReading] = {}

    def show_scene(self, shown: ShownScene) -> None:
        """Create publishers for a scene's sensors and remove all others.

        A topic that stays keeps its publisher. No other callback of the node may run meanwhile: the calling
        callback waits until the physics has taken over the scene.
        """
        simulation, tree = shown.simulation, shown.tree
        described = simulation.scene.sensors
        words = topic_words([each.name for each in described], "sensor")
        before, self._publishers, self._sent = self._publishers, {}, {}
        sensor_topics = [
            (
                sensor,
                [
                    (f"sensors/{word}{sensor_message.below}", sensor_message)
                    for sensor_message in messages_of(sensor, _around(sensor, simulation.robot))
                ],
            )
            for sensor, word in zip(described, words, strict=True)
        ]
        used_keys = {
            (topic, sensor_message.message) for _, topics in sensor_topics for topic, sensor_message in topics
        }
        for key in before.keys() - used_keys:
            self._node.destroy_publisher(before.pop(key))
        self._sensors = []
        for sensor, topics in sensor_topics:
            sends = []
            for topic, sensor_message in topics:
                key = (topic, sensor_message.message)
                publisher = before.get(key) or self._node.create_publisher(
                    sensor_message.message, topic, EVERY_ONE
                )
                self._publishers[key] = publisher
                sends.append((publisher, sensor_message))
            self._sensors.append((sensor.name, self._frame(sensor, tree), sends))

    def publish(self, moment: Moment) -> None:
        """Publish new samples on topics with subscribers, or all of them with all topics."""
        for name, frame, sends in self._sensors:
            reading = moment.simulation.sensors[name]
            if reading is self._sent.get(name) and not moment.whole:
                continue
            self._sent[name] = reading
            header: Any = None
            for publisher, sensor_message in sends:
                if publisher.get_subscription_count():
                    header = header or messages.header(moment.stamp, frame)
                    publisher.publish(sensor_message.write(header, reading))

    def _frame(self, sensor: SimulatedSensorDescription, tree: FrameTree) -> str:
        if sensor.mount is not None:
            return tree.of_sensor(sensor.name)
        return tree.of_place(sensor.axes) if sensor.axes else self._base


def _around(sensor: SimulatedSensorDescription, robot: RobotDescription) -> float:
    """Return the absolute pressure in [Pa] of the air around the joint that a sensor measures."""
    names = {output.joint for output in sensor.outputs}
    return next((atmosphere_of(joint) for joint in robot.joints if joint.name in names), ATMOSPHERE)


def atmosphere_of(joint: JointDescription) -> float:
    """Return the absolute pressure in [Pa] around a joint's actuator; the standard one if it has no gas."""
    gas = None if joint.actuator is None else joint.actuator.gas
    return ATMOSPHERE if gas is None else gas.atmosphere


MARKER_PERIOD_S = 0.1
"""RViz displays one large marker at 10 Hz without delay."""

TF_PERIOD_S = 1.0 / 50.0


class Publications:
    """Publishes the state of a simulation; `publish` is called from the thread that owns it.

    Args:
        node: Owner of the publishers.
        simulation: What will be published; its surface and joints must not change.
        frames: Names of the robot's frames.
        mesh_rate: Rate of mesh/points in [Hz]; 0 publishes none.
        publish_clock: Publish simulated time on /clock and stamp every message with it.
        marker_stress: Stress in [Pa] of the marker's last colour; 0 takes the largest of each message.
        overrides: Text of the overrides of the scene's file.
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
        self._namespace, self._generation = node.get_namespace(), 0
        self.marker_stress = marker_stress
        self._mesh_gate: RateGate | None = None
        self.mesh_rate = mesh_rate
        self._marker_gate, self._tf_gate = RateGate(MARKER_PERIOD_S), RateGate(TF_PERIOD_S)
        self._publish_clock = publish_clock
        if publish_clock:
            self._clock = node.create_publisher(Clock, "/clock", 1)
        self._joint_states = node.create_publisher(JointState, "joint_states", 10)
        self._effector_pose = node.create_publisher(PoseStamped, "effector_pose", 5)
        self._base_shift = node.create_publisher(Float64, "base_shift", LATCHED)
        self._shown_shift: float | None = None
        self._points = node.create_publisher(PointCloud2, "mesh/points", 1)
        self._marker = node.create_publisher(Marker, "mesh/marker", 1)
        self._tf: Any | None = None
        self._create_tf(node)
        self._publications: list[Publication] = [
            *(ScenePublication(topic, node) for topic in SCENE_TOPICS),
            *(StatePublication(topic, node) for topic in STATE_TOPICS),
            ChamberPublications(node, frames.base),
            SensorPublications(node, frames.base),
        ]
        self.show_scene(simulation, overrides, scenes)

    def show_scene(self, simulation: Simulation, overrides: str = "", scenes: Sequence[str] = ()) -> None:
        """Publish the static part of the first simulation, or of another one that replaces it."""
        self._tree = FrameTree(simulation, self._frames)
        if self._tf is not None:
            self._tf_static.publish(self._make_tf(transforms=self._tree.still(self._now().to_msg())))
        self._generation = max(self._generation + 1, time.time_ns())
        shown = ShownScene(simulation, self._tree, self._namespace, overrides, scenes, self._generation)
        for publication in self._publications:
            publication.show_scene(shown)
        triangles = simulation.visual_triangles
        self._template = messages.MarkerTemplate(WORLD, triangles) if len(triangles) else None

    @property
    def mesh_rate(self) -> float:
        """Rate of mesh/points in [Hz]; 0 publishes none."""
        return 1.0 / self._mesh_gate.period_s if self._mesh_gate else 0.0

    @mesh_rate.setter
    def mesh_rate(self, rate: float) -> None:
        self._mesh_gate = RateGate(1.0 / rate) if rate > 0.0 else None

    def publish(self, simulation: Simulation, whole: bool) -> float:
        """Publish what is due; topics with large messages only if they have subscribers.

        Args:
            simulation: State to publish.
            whole: Publish everything now, whatever the rates.

        Returns:
            Time it took in [ms].
        """
        started = time.perf_counter()
        try:
            self._publish(simulation, whole)
        except Exception:
            if self._context.ok():
                raise
            # Ctrl-C and SIGTERM invalidate the publishers before this thread can be stopped
        return 1e3 * (time.perf_counter() - started)

    def stamp(self, simulation: Simulation) -> Time:
        """Return simulated time if this node publishes /clock, otherwise the time of the node's clock."""
        return messages.time_message(simulation.time) if self._publish_clock else self._now().to_msg()

    def _publish(self, simulation: Simulation, whole: bool) -> None:
        stamp, now = self.stamp(simulation), time.monotonic()
        moment = Moment(simulation, stamp, now, whole)
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
        for publication in self._publications:
            publication.publish(moment)
        points_due = self._mesh_gate is not None and is_due(self._points, self._mesh_gate, moment)
        marker_due = self._template is not None and is_due(self._marker, self._marker_gate, moment)
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
