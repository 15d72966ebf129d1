"""Markers of the objects in a scene: rigid bodies, cables, chambers, contacts and collision surfaces.

All are visualization_msgs/MarkerArray. `bodies/topology` has the surfaces of the rigid bodies, one
TRIANGLE_LIST a body, ns = its name, in its own frame on /tf. `cables` has for every cable, by its number as
id, ns "line" (LINE_STRIP), "points" (SPHERE_LIST) and "pull" (SPHERE at the pull point). `chambers` has the
cavity of every chamber, by its number as id, ns = name of its joint: a TRIANGLE_LIST in world coordinates,
light at zero pressure, red at the largest, blue at the smallest. `contacts` has ns "points" (SPHERE_LIST) and
"forces" (LINE_LIST from each point along the force on the first body, FORCE_LENGTH per newton). `collisions`
has the collision surfaces, by their number as id, ns = name: a TRIANGLE_LIST in world coordinates, or a
SPHERE.

A function `..._places` returns the points, and colours if they change, of the markers that the function
`..._markers` returned for the scene, for messages.MovingMarkers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Vector3
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from softsim_core.base import Array
from softsim_core.physics.actuation import ActuatorView
from softsim_core.simulation import Simulation
from softsim_node import WORLD
from softsim_ros import messages

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


def cable_places(simulation: Simulation) -> tuple[list[Array], tuple[()]]:
    """Return the points in [m] of the markers of `cable_markers`, whose colours stay."""
    places = []
    for cable in simulation.actuators:
        if not len(cable.points):
            continue
        outside = int(cable.pulled_from_outside)
        places += [cable.points, cable.points[outside:], *cable.points[:outside]]
    return places, ()


def chamber_markers(simulation: Simulation, stamp: Time) -> MarkerArray:
    """Return the cavities of all chambers in the colours of their pressures."""
    markers = []
    for number, chamber, colour in chamber_colours(simulation):
        r, g, b, a = colour.tolist()
        marker = _marker(
            stamp, chamber.name, number, Marker.TRIANGLE_LIST, 1.0, ColorRGBA(r=r, g=g, b=b, a=a)
        )
        marker.points = _points(chamber.surface.reshape(-1, 3))
        markers.append(marker)
    return MarkerArray(markers=markers)


def chamber_places(simulation: Simulation) -> tuple[list[Array], list[Array]]:
    """Return points in [m] and colours of the markers of `chamber_markers`, see MovingMarkers."""
    shown = list(chamber_colours(simulation))
    return [chamber.surface.reshape(-1, 3) for _, chamber, _ in shown], [colour for *_, colour in shown]


def pressure_colour(pressure: float, lowest: float, highest: float) -> Array:
    """Return the colour of a pressure: red, green, blue and alpha in 0..1, shape (4,).

    All pressures are in [Pa], with lowest <= 0 <= highest.
    """
    last, colour = (highest, _FULL) if pressure > 0.0 else (lowest, _SUCKED)
    share = min(pressure / last, 1.0) if last != 0.0 else 0.0
    return np.asarray(_EMPTY + share * (colour - _EMPTY))


def chamber_colours(simulation: Simulation) -> Iterator[tuple[int, ActuatorView, Array]]:
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


def collision_places(simulation: Simulation) -> tuple[list[Array], tuple[()]]:
    """Return the points in [m] of the markers of `collision_markers`, whose colours stay."""
    points = simulation.collision_points
    places = [
        points[surface.vertices if surface.radius > 0.0 else surface.triangles.ravel()]
        for surface in simulation.collision_surfaces
    ]
    return places, ()


def _marker(stamp: Time, ns: str, number: int, kind: int, size: float, colour: ColorRGBA) -> Marker:
    marker = Marker(ns=ns, id=number, type=kind, action=Marker.ADD, color=colour)
    marker.header = messages.header(stamp, WORLD)
    marker.pose.orientation.w = 1.0
    marker.scale = Vector3(x=size, y=size, z=size)
    return marker


def _points(rows: Array) -> list[Point]:
    flat: Iterable[list[float]] = np.asarray(rows, dtype=float).tolist()
    return [Point(x=x, y=y, z=z) for x, y, z in flat]
