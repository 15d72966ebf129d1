"""Rigid bodies, cables, pressure chambers and contacts of a scene on topics.

`bodies/poses` (geometry_msgs/PoseArray, frame world, 60 Hz) has the poses of the rigid bodies in scene order;
`bodies/topology` (visualization_msgs/MarkerArray, latched) their surfaces, one TRIANGLE_LIST a body, ns = its
name, in its own frame on /tf. `cables` (MarkerArray, 30 Hz) has for every cable, by its
number as id, ns "line" (LINE_STRIP), "points" (SPHERE_LIST) and "pull" (SPHERE at the pull point). `chambers`
(MarkerArray, 30 Hz) has the hollow of every chamber, by its number as id, ns = name of its joint: a
TRIANGLE_LIST in world coordinates, light at no pressure, red at the largest, blue at the smallest. `contacts`
(MarkerArray, 30 Hz) has ns "points" (SPHERE_LIST) and "forces" (LINE_LIST from each point along the force on
the first body, FORCE_LENGTH long a newton). `collisions` (MarkerArray, 10 Hz) has the collision surfaces, by
their number as id, ns = name: a TRIANGLE_LIST in world coordinates, or a SPHERE.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, PoseArray, Vector3
from rclpy.node import Node
from rclpy.publisher import Publisher
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from softsim_core.actuation import ActuatorView
from softsim_core.actuation.chamber import ChamberDescription
from softsim_core.arrays import Array
from softsim_core.simulation import Simulation
from softsim_ros import messages
from softsim_ros.frames import WORLD
from softsim_ros.qos import LATCHED
from softsim_ros.simulator.pacing import RateGate

POSES_PERIOD_S = 1.0 / 60.0
MARKERS_PERIOD_S = 1.0 / 30.0
COLLISIONS_PERIOD_S = 0.1
FORCE_LENGTH = 0.02
"""Length in [m] at which a contact force of 1 N is drawn."""


_LINE, _DOT, _PULL = 0.0008, 0.002, 0.004
_CABLE = ColorRGBA(r=0.1, g=0.1, b=0.1, a=1.0)
_PULL_COLOUR = ColorRGBA(r=0.1, g=0.3, b=0.9, a=1.0)
_EMPTY, _FULL, _SUCKED = (
    np.array(each) for each in ((0.93, 0.93, 0.96, 1.0), (0.85, 0.1, 0.1, 1.0), (0.1, 0.2, 0.85, 1.0))
)
"""Colours of a chamber without pressure, at its largest and at its smallest one."""
_CONTACT = ColorRGBA(r=0.9, g=0.1, b=0.6, a=1.0)
_COLLISIONS = tuple(
    ColorRGBA(r=r, g=g, b=b, a=1.0)
    for r, g, b in ((0.85, 0.45, 0.0), (0.0, 0.5, 0.7), (0.7, 0.2, 0.5), (0.2, 0.55, 0.2))
)
"""Surfaces that lie side by side, such as a finger and its notch walls, differ."""


class ObjectPublications:
    """Publishers of what a scene holds beside silicone and servos; used from the physics thread.

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
        """Send what does not move; `frame_of` names the frame of a rigid body by its number and name."""
        self._topology.publish(bodies_topology(simulation, frame_of))
        now = Time()
        self._moving_cables = messages.MovingMarkers(cable_markers(simulation, now).markers)
        hollows = chamber_markers(simulation, now).markers
        self._has_chambers, self._moving_chambers = bool(hollows), messages.MovingMarkers(hollows)
        self._moving_collisions = messages.MovingMarkers(collision_markers(simulation, now).markers)

    def publish(self, simulation: Simulation, stamp: Time, now: float, whole: bool) -> None:
        """Send what is due to who listens; `now` is a steady clock in [s], `whole` asks for everything."""
        if _due(self._poses, self._poses_gate, now, whole) and simulation.rigid_bodies:
            poses = [messages.pose(p.position, p.quaternion_xyzw) for p in simulation.rigid_poses]
            self._poses.publish(PoseArray(header=messages.header(stamp, WORLD), poses=poses))
        if _due(self._cables, self._cables_gate, now, whole) and (whole or simulation.actuators):
            self._cables.publish(self._moving_cables.fill(stamp, cable_places(simulation)))
        if _due(self._chambers, self._chambers_gate, now, whole) and (whole or self._has_chambers):
            self._chambers.publish(self._moving_chambers.fill(stamp, *chamber_places(simulation)))
        touches = whole or simulation.collision_surfaces  # else there is nothing new to say
        if touches and _due(self._contacts, self._contacts_gate, now, whole):
            self._contacts.publish(contact_markers(simulation, stamp))
        if _due(self._collisions, self._collisions_gate, now, whole):
            self._collisions.publish(self._moving_collisions.fill(stamp, collision_places(simulation)))


def bodies_topology(simulation: Simulation, frame_of: Callable[[int, str], str]) -> MarkerArray:
    """Surfaces of the rigid bodies, each in its own frame, and locked to it: they move with /tf."""
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
    """Lines, points and pull points of all cables and other actuators that have points."""
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
    """Where the markers of `cable_markers` are in [m], see messages.MovingMarkers."""
    places = []
    for cable in simulation.actuators:
        if not len(cable.points):
            continue
        outside = int(cable.pulled_from_outside)
        places += [cable.points, cable.points[outside:], *cable.points[:outside]]
    return places


def chamber_markers(simulation: Simulation, stamp: Time) -> MarkerArray:
    """The hollows of all chambers in the colours of their pressures."""
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
    """Where the markers of `chamber_markers` are in [m], and their colours, see messages.MovingMarkers."""
    shown = list(_chambers(simulation))
    return [chamber.surface.reshape(-1, 3) for _, chamber, _ in shown], [colour for *_, colour in shown]


def pressure_colour(pressure: float, lowest: float, highest: float) -> Array:
    """Red, green, blue and alpha in 0..1 of a pressure, shape (4,); all in [Pa], lowest <= 0 <= highest."""
    last, colour = (highest, _FULL) if pressure > 0.0 else (lowest, _SUCKED)
    share = min(pressure / last, 1.0) if last != 0.0 else 0.0
    return np.asarray(_EMPTY + share * (colour - _EMPTY))


def _chambers(simulation: Simulation) -> Iterator[tuple[int, ActuatorView, Array]]:
    """Number, view and colour of each chamber; without a limit the atmosphere's pressure has the last one."""
    described = {joint.name: joint.actuator for joint in simulation.robot.joints}
    for number, view in enumerate(simulation.actuators):
        if isinstance(chamber := described[view.name], ChamberDescription):
            most = chamber.max_pressure if math.isfinite(chamber.max_pressure) else chamber.atmosphere
            yield number, view, pressure_colour(view.multiplier, chamber.min_pressure, most)


def contact_markers(simulation: Simulation, stamp: Time) -> MarkerArray:
    """Points and forces of all contacts of the last step; empty lists where nothing touches."""
    contacts = simulation.contacts
    points = _marker(stamp, "points", 0, Marker.SPHERE_LIST, _DOT, _CONTACT)
    points.points = _points(contacts.points)
    forces = _marker(stamp, "forces", 0, Marker.LINE_LIST, _LINE, _CONTACT)
    ends = np.stack([contacts.points, contacts.points + FORCE_LENGTH * contacts.forces], axis=1)
    forces.points = _points(ends.reshape(-1, 3))
    return MarkerArray(markers=[points, forces])


def collision_markers(simulation: Simulation, stamp: Time) -> MarkerArray:
    """The surfaces that contact looks at, where they are now; empty in a scene where nothing can meet."""
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
    """Where the markers of `collision_markers` are in [m], see messages.MovingMarkers."""
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
