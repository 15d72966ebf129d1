"""Topics that the simulator publishes from its physics thread, each at its own rate.

`bodies/poses` (geometry_msgs/PoseArray, frame world, 60 Hz) has the poses of the rigid bodies in scene order;
`bodies/topology` (visualization_msgs/MarkerArray, latched) their surfaces, one TRIANGLE_LIST a body, ns = its
name, in its own frame on /tf. `cables` (MarkerArray, 30 Hz) has for every cable, by its number as id, ns
"line" (LINE_STRIP), "points" (SPHERE_LIST) and "pull" (SPHERE at the pull point). `chambers` (MarkerArray, 30
Hz) has the cavity of every chamber, by its number as id, ns = name of its joint: a TRIANGLE_LIST in world
coordinates, light at zero pressure, red at the largest, blue at the smallest. `contacts` (MarkerArray, 30 Hz)
has ns "points" (SPHERE_LIST) and "forces" (LINE_LIST from each point along the force on the first body,
FORCE_LENGTH per newton). `collisions` (MarkerArray, 10 Hz) has the collision surfaces, by their number as id,
ns = name: a TRIANGLE_LIST in world coordinates, or a SPHERE.

A joint's effort is the pressure relative to the surrounding air, while FluidPressure is absolute. The
atmospheric pressure of the scene is therefore added, the same at any height. The variance is 0, which means
unknown.

Each sensor publishes the standard message of its kind, see messages.sensors, once per sample, with the stamp
of the step in which it was sampled. `contacts/points` (sensor_msgs/PointCloud2) has every contact of the
step.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, PoseArray, PoseStamped, Vector3
from rclpy.node import Node
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import FluidPressure, JointState, PointCloud2
from shape_msgs.msg import Mesh
from std_msgs.msg import ColorRGBA, Float64, String
from visualization_msgs.msg import Marker, MarkerArray

from softsim_core.base import Array
from softsim_core.physics.actuation import ActuatorView
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
from softsim_ros.nodes.simulator.scene_topics import FrameTree, StructurePublications


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
MARKERS_PERIOD_S = 1.0 / 30.0
COLLISIONS_PERIOD_S = 0.1
FORCE_LENGTH = 0.02
"""Length in [m] that represents a contact force of 1 N."""


_LINE, _DOT, _PULL = 0.0008, 0.002, 0.004
_CABLE = ColorRGBA(r=0.1, g=0.1, b=0.1, a=1.0)
_PULL_COLOUR = ColorRGBA(r=0.1, g=0.3, b=0.9, a=1.0)
_EMPTY, _FULL, _SUCKED = (
    np.array(each) for each in ((0.93, 0.93, 0.96, 1.0), (0.85, 0.1, 0.1, 1.0), (0.1, 0.2, 0.85, 1.0))
)
"""Colours of a chamber at zero, largest and smallest pressure."""
_CONTACT = ColorRGBA(r=0.9, g=0.1, b=0.6, a=1.0)
_COLLISIONS = tuple(
    ColorRGBA(r=r, g=g, b=b, a=1.0)
    for r, g, b in ((0.85, 0.45, 0.0), (0.0, 0.5, 0.7), (0.7, 0.2, 0.5), (0.2, 0.55, 0.2))
)
"""Different colours for surfaces that lie side by side, such as a finger and its notch walls."""


class ObjectPublications:
    """Publishes rigid bodies, cables, chambers, contacts and collision surfaces, in the physics thread.

    Args:
        node: Owner of the publishers.
    """

    def __init__(self, node: Node) -> None:
        self._poses = node.create_publisher(PoseArray, "bodies/poses", 5)
        self._topology = node.create_publisher(MarkerArray, "bodies/topology", LATCHED)
        self._cables = node.create_publisher(MarkerArray, "cables", 1)
        self._chambers = node.create_publisher(MarkerArray, "chambers", 1)
        self._contacts = node.create_publisher(MarkerArray, "contacts", 1)
        self._collisions = node.create_publisher(MarkerArray, "collisions", 1)
        self._poses_gate = RateGate(POSES_PERIOD_S)
        self._cables_gate, self._chambers_gate, self._contacts_gate = (
            RateGate(MARKERS_PERIOD_S) for _ in range(3)
        )
        self._collisions_gate = RateGate(COLLISIONS_PERIOD_S)

    def show_scene(self, simulation: Simulation, frame_of: Callable[[int, str], str]) -> None:
        """Publish the static part of a scene.

        Args:
            simulation: The scene.
            frame_of: Returns the frame of a rigid body by its number and name.
        """
        self._topology.publish(bodies_topology(simulation, frame_of))
        now = Time()
        self._moving_cables = messages.MovingMarkers(cable_markers(simulation, now).markers)
        hollows = chamber_markers(simulation, now).markers
        self._has_chambers, self._moving_chambers = bool(hollows), messages.MovingMarkers(hollows)
        self._moving_collisions = messages.MovingMarkers(collision_markers(simulation, now).markers)

    def publish(self, simulation: Simulation, stamp: Time, now: float, whole: bool) -> None:
        """Publish what is due on topics with subscribers.

        Args:
            simulation: State to publish.
            stamp: Time stamp of the messages.
            now: Steady clock in [s].
            whole: Whether to publish on all topics with subscribers now, whatever the rates.
        """
        if _due(self._poses, self._poses_gate, now, whole) and simulation.rigid_bodies:
            poses = [messages.pose(p.position, p.quaternion_xyzw) for p in simulation.rigid_poses]
            self._poses.publish(PoseArray(header=messages.header(stamp, WORLD), poses=poses))
        if _due(self._cables, self._cables_gate, now, whole) and (whole or simulation.actuators):
            self._cables.publish(self._moving_cables.fill(stamp, cable_places(simulation)))
        if _due(self._chambers, self._chambers_gate, now, whole) and (whole or self._has_chambers):
            self._chambers.publish(self._moving_chambers.fill(stamp, *chamber_places(simulation)))
        touches = whole or simulation.collision_surfaces  # otherwise the message would stay empty
        if touches and _due(self._contacts, self._contacts_gate, now, whole):
            self._contacts.publish(contact_markers(simulation, stamp))
        if _due(self._collisions, self._collisions_gate, now, whole):
            self._collisions.publish(self._moving_collisions.fill(stamp, collision_places(simulation)))


def bodies_topology(simulation: Simulation, frame_of: Callable[[int, str], str]) -> MarkerArray:
    """Return surface markers of the rigid bodies, each locked to its body's frame: it moves with /tf."""
    markers = []
    for number, body in enumerate(simulation.rigid_bodies):
        r, g, b, a = body.colour
        corners = body.surface.points[body.surface.triangles.ravel()]
        colour = ColorRGBA(r=r, g=g, b=b, a=a)
        marker = _marker(Time(), body.name, number, Marker.TRIANGLE_LIST, 1.0, colour)
        marker.header.frame_id, marker.frame_locked = frame_of(number, body.name), True
        marker.points = _points(corners)
        markers.append(marker)
    return MarkerArray(markers=markers)


def cable_markers(simulation: Simulation, stamp: Time) -> MarkerArray:
    """Return lines, points and pull points of all cables and other actuators that have points."""
    markers = []
    for number, cable in enumerate(simulation.actuators):
        if not len(cable.points):
            continue
        line = _marker(stamp, "line", number, Marker.LINE_STRIP, _LINE, _CABLE)
        line.points = _points(cable.points)
        dots = _marker(stamp, "points", number, Marker.SPHERE_LIST, _DOT, _CABLE)
        dots.points = line.points[cable.pulled_from_outside :]
        markers += [line, dots]
        if cable.pulled_from_outside:
            pull = _marker(stamp, "pull", number, Marker.SPHERE, _PULL, _PULL_COLOUR)
            pull.pose.position = line.points[0]
            markers.append(pull)
    return MarkerArray(markers=markers)


def cable_places(simulation: Simulation) -> list[Array]:
    """Return the points in [m] of the markers of `cable_markers`, see messages.MovingMarkers."""
    places = []
    for cable in simulation.actuators:
        if not len(cable.points):
            continue
        outside = int(cable.pulled_from_outside)
        places += [cable.points, cable.points[outside:], *cable.points[:outside]]
    return places


def chamber_markers(simulation: Simulation, stamp: Time) -> MarkerArray:
    """Return the cavities of all chambers in the colours of their pressures."""
    markers = []
    for number, chamber, colour in _chambers(simulation):
        r, g, b, a = colour.tolist()
        marker = _marker(
            stamp, chamber.name, number, Marker.TRIANGLE_LIST, 1.0, ColorRGBA(r=r, g=g, b=b, a=a)
        )
        marker.points = _points(chamber.surface.reshape(-1, 3))
        markers.append(marker)
    return MarkerArray(markers=markers)


def chamber_places(simulation: Simulation) -> tuple[list[Array], list[Array]]:
    """Return points in [m] and colours of the markers of `chamber_markers`, see MovingMarkers."""
    shown = list(_chambers(simulation))
    return [chamber.surface.reshape(-1, 3) for _, chamber, _ in shown], [colour for *_, colour in shown]


def pressure_colour(pressure: float, lowest: float, highest: float) -> Array:
    """Return the colour of a pressure: red, green, blue and alpha in 0..1, shape (4,).

    All pressures are in [Pa], with lowest <= 0 <= highest.
    """
    last, colour = (highest, _FULL) if pressure > 0.0 else (lowest, _SUCKED)
    share = min(pressure / last, 1.0) if last != 0.0 else 0.0
    return np.asarray(_EMPTY + share * (colour - _EMPTY))


def _chambers(simulation: Simulation) -> Iterator[tuple[int, ActuatorView, Array]]:
    """Yield number, view and colour of each chamber.

    If a chamber has no pressure limit, its atmospheric pressure gets the colour of the largest pressure.
    """
    described = {joint.name: joint.actuator for joint in simulation.robot.joints}
    for number, view in enumerate(simulation.actuators):
        actuator = described[view.name]
        if actuator is not None and (gas := actuator.gas) is not None:
            most = gas.highest if math.isfinite(gas.highest) else gas.atmosphere
            yield number, view, pressure_colour(view.multiplier, gas.lowest, most)


def contact_markers(simulation: Simulation, stamp: Time) -> MarkerArray:
    """Return points and forces of all contacts of the last step; empty lists where nothing touches."""
    contacts = simulation.contacts
    points = _marker(stamp, "points", 0, Marker.SPHERE_LIST, _DOT, _CONTACT)
    points.points = _points(contacts.points)
    forces = _marker(stamp, "forces", 0, Marker.LINE_LIST, _LINE, _CONTACT)
    ends = np.stack([contacts.points, contacts.points + FORCE_LENGTH * contacts.forces], axis=1)
    forces.points = _points(ends.reshape(-1, 3))
    return MarkerArray(markers=[points, forces])


def collision_markers(simulation: Simulation, stamp: Time) -> MarkerArray:
    """Return the collision surfaces at their current positions; empty in a scene without contact."""
    markers, points = [], simulation.collision_points
    for number, surface in enumerate(simulation.collision_surfaces):
        colour = _COLLISIONS[number % len(_COLLISIONS)]
        if surface.radius > 0.0:
            marker = _marker(stamp, surface.name, number, Marker.SPHERE, 2.0 * surface.radius, colour)
            (marker.pose.position,) = _points(points[surface.vertices])
        else:
            marker = _marker(stamp, surface.name, number, Marker.TRIANGLE_LIST, 1.0, colour)
            marker.points = _points(points[surface.triangles.ravel()])
        markers.append(marker)
    return MarkerArray(markers=markers)


def collision_places(simulation: Simulation) -> list[Array]:
    """Return the points in [m] of the markers of `collision_markers`, see messages.MovingMarkers."""
    points = simulation.collision_points
    return [
        points[surface.vertices if surface.radius > 0.0 else surface.triangles.ravel()]
        for surface in simulation.collision_surfaces
    ]


def _marker(stamp: Time, ns: str, number: int, kind: int, size: float, colour: ColorRGBA) -> Marker:
    marker = Marker(ns=ns, id=number, type=kind, action=Marker.ADD, color=colour)
    marker.header = messages.header(stamp, WORLD)
    marker.pose.orientation.w = 1.0
    marker.scale = Vector3(x=size, y=size, z=size)
    return marker


def _points(rows: Array) -> list[Point]:
    flat: Iterable[list[float]] = np.asarray(rows, dtype=float).tolist()
    return [Point(x=x, y=y, z=z) for x, y, z in flat]


def _due(publisher: Publisher, gate: RateGate, now: float, whole: bool) -> bool:
    return publisher.get_subscription_count() > 0 and (gate.passes(now) or whole)


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

    def show_scene(self, simulation: Simulation) -> None:
        """Create publishers for a scene's chambers and remove all others.

        A topic that stays keeps its publisher. No other callback of the node may run meanwhile: the calling
        callback waits until the physics has taken over the scene.
        """
        joints = simulation.robot.joints
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

    def publish(self, simulation: Simulation, stamp: Time) -> None:
        """Publish all pressures."""
        if not self._joints:
            return
        efforts = simulation.joint_efforts
        for (joint, around), publisher in zip(self._joints, self._publishers.values(), strict=True):
            pressure = around + float(efforts[joint])
            publisher.publish(messages.fluid_pressure(stamp, self._frame, pressure))


class SensorPublications:
    """Publishes sensor readings; used from the physics thread.

    Args:
        node: Owner of the publishers.
        base: Frame of readings that have no frame of their own.
    """

    def __init__(self, node: Node, base: str) -> None:
        self._node, self._base = node, base
        self._contacts = node.create_publisher(PointCloud2, "contacts/points", NEWEST_ONLY)
        self._publishers: dict[tuple[str, type], Publisher] = {}
        self._sensors: list[
            tuple[str, str, list[tuple[Publisher, SensorMessage]]]
        ] = []  # name, frame, topics
        self._sent: dict[str, SensorReading] = {}

    def show_scene(self, simulation: Simulation, tree: FrameTree) -> None:
        """Create publishers for a scene's sensors and remove all others.

        A topic that stays keeps its publisher. No other callback of the node may run meanwhile: the calling
        callback waits until the physics has taken over the scene.
        """
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

    def publish(self, simulation: Simulation, stamp: Time, whole: bool) -> None:
        """Publish new samples on topics with subscribers; `whole` publishes all of them."""
        for name, frame, sends in self._sensors:
            reading = simulation.sensors[name]
            if reading is self._sent.get(name) and not whole:
                continue
            self._sent[name] = reading
            header: Any = None
            for publisher, sensor_message in sends:
                if publisher.get_subscription_count():
                    header = header or messages.header(stamp, frame)
                    publisher.publish(sensor_message.write(header, reading))
        if self._contacts.get_subscription_count():
            self._contacts.publish(contact_cloud(stamp, WORLD, simulation.contacts))

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
        """Publish the static part of the first simulation, or of another one that replaces it."""
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
    """Return whether the topic has subscribers and its period is over."""
    return publisher.get_subscription_count() > 0 and (gate.passes(now) or whole)
