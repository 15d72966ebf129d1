r"""Location of a session's sensors: the rigid frame of the data, and the points of the robot that carry them.

Let :math:`x_i, Q_i` be position and rotation of the part that carries a sensor, :math:`m_i` the measurement,
:math:`(R, t)` the frame and :math:`o` the point:

.. math:: e_i = x_i + Q_i o - (R m_i + t), \qquad \min_{R, t, o} \sum_i |e_i|^2 .

The frame alone has a closed-form solution and the point alone is a linear problem. Both together are found by
Gauss-Newton, starting from the frame alone. Frame and point can be distinguished because the sensor tilts.

Source: Kabsch 1976; Umeyama 1991 (the proper rotation).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from softsim_core.base import Array, DataError, IndexArray, SceneError, known_names, listing
from softsim_core.lab.identification.description import EFFECTOR, SensorDescription
from softsim_core.physics.mechanics import cross_matrices, nearest_rotation, rotation_exp, rotation_of
from softsim_core.physics.mesh import embed
from softsim_core.simulation import Simulation

OUTSIDE = 0.05
"""A place farther outside its body than this part of an element is not on the body."""

FEWEST = 4
"""Number of nodes from which the rotation of a body at a place is computed."""


@dataclass(frozen=True, slots=True, eq=False)
class _BodyPlace:
    """A place on a body: four nodes carry its position, nodes around it its rotation (global numbers)."""

    nodes: IndexArray
    weights: Array
    around: IndexArray
    centred: Array

    def locate(self, positions: Array) -> tuple[Array, Array]:
        """Return the place's position, and its rotation from rest."""
        moved = positions[self.around]
        return self.weights @ positions[self.nodes], nearest_rotation(
            self.centred, moved - moved.mean(axis=0)
        )


class Places:
    """The places of a session's s sensors in any simulation of the scene, at rest or in motion.

    Raises:
        SceneError: the scene has no such frame, or no body at a place.
    """

    def __init__(self, simulation: Simulation, sensors: Sequence[SensorDescription]) -> None:
        self._places: list[str | _BodyPlace] = [_place(simulation, sensor) for sensor in sensors]

    def locate(self, simulation: Simulation) -> tuple[Array, Array]:
        """Return positions (s, 3) in [m] and rotations (s, 3, 3) in the simulation's present state."""
        positions, frames = simulation.positions, simulation.frames()
        found = []
        for place in self._places:
            if isinstance(place, str):
                pose = frames[place]
                found.append((pose.position, rotation_of(pose.quaternion_xyzw)))
            else:
                found.append(place.locate(positions))
        return np.array([each for each, _ in found]), np.array([turn for _, turn in found])


def _place(simulation: Simulation, sensor: SensorDescription) -> str | _BodyPlace:
    if sensor.place is not None:
        return _on_body(simulation, sensor)
    scene, frames = simulation.scene, simulation.frames()
    name = sensor.at
    if name == EFFECTOR:
        if scene.effector is None:
            raise SceneError(
                f"sensor {sensor.name}: scene {scene.name} has no effector; say what it sits on: "
                f"at (one of {listing(frames)}), or place (a point of a body)"
            )
        name = scene.effector
    if name not in frames:
        raise SceneError(
            f"sensor {sensor.name}: no frame {name!r} in {scene.name}; {known_names(name, frames, 'it has')}"
        )
    return name


def _on_body(simulation: Simulation, sensor: SensorDescription) -> _BodyPlace:
    point, rest = np.array(sensor.place), simulation.model.rest
    best: tuple[float, _BodyPlace] | None = None
    for body in simulation.bodies:
        found, own = embed(point[None], body.solid), rest[body.nodes]
        if best is None or found.outside[0] < best[0]:
            far = np.linalg.norm(own - point, axis=1)
            near = np.flatnonzero(far <= sensor.patch)
            if len(near) < FEWEST:
                near = np.argsort(far)[:FEWEST]
            centred = own[near] - own[near].mean(axis=0)
            nodes = found.nodes[0] + body.nodes.start
            best = (
                float(found.outside[0]),
                _BodyPlace(nodes, found.weights[0], near + body.nodes.start, centred),
            )
    if best is None or best[0] > OUTSIDE:
        raise SceneError(
            f"sensor {sensor.name}: no body of {simulation.scene.name} is at {point.tolist()} m; give the "
            "place on the body, and the way from there to the sensor as its offset"
        )
    return best[1]


ON_A_LINE = 1e-3
"""Smallest ratio of second to first extent of points; below it the frame can rotate about their line."""

UNDETERMINED = 1e-7
"""A singular value of the scaled problem below this part of the largest one counts as zero."""

MIRRORED = 0.5
"""Columns or signs count as interchanged if a mirrored frame reduces the error to less than this part."""


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """Fitted frame of the data and points of the sensors.

    Attributes:
        rotation: R, from the described frame of the data to the robot's frame, shape (3, 3).
        shift: t in [m], shape (3,).
        points: Offset of each sensor in the part that carries it, in [m], shape (s, 3).
        point_errors: Standard error of `points` in [m], shape (s, 3); 0 where they are not fitted.
        delay: Delay of the sensors in [s].
        rows: Number of training rows to which it is fitted; 0: it was given, or is as described.
    """

    rotation: Array
    shift: Array
    points: Array
    point_errors: Array
    delay: float = 0.0
    rows: int = 0

    def place(self, measured: Array) -> Array:
        """Transform measured positions (..., 3) in [m] into the robot's frame."""
        return np.asarray(measured @ self.rotation.T + self.shift)

    def errors(self, positions: Array, rotations: Array, measured: Array) -> Array:
        """Return model minus measurement in [m], shape (k, s, 3); for the arguments see align."""
        return np.asarray(locate_sensors(positions, rotations, self.points) - self.place(measured))


def locate_sensors(positions: Array, rotations: Array, points: Array) -> Array:
    """Return positions in [m] of sensors at points (s, 3) of their carriers, shape (k, s, 3)."""
    return np.asarray(positions + np.einsum("ksij,sj->ksi", rotations, points))


def build_nominal_alignment(points: Array) -> Alignment:
    """Return the alignment of a session whose frame and points (s, 3) are known."""
    return Alignment(np.eye(3), np.zeros(3), points, np.zeros_like(points))


def rigid_frame(model: Array, measured: Array, what: str) -> tuple[Array, Array]:
    """Return R (3, 3) and t (3,) that minimise the squares of model - (R measured + t), (k, 3) in [m].

    Raises:
        DataError: fewer than three points, all on a line, or mirrored.
    """
    if len(model) < 3:
        count = len(model)
        raise DataError(what, "", f"{count} rows cannot determine a frame; measure 3 or more off one line")
    centre, other = model.mean(axis=0), measured.mean(axis=0)
    for points, whose in ((measured - other, "measured"), (model - centre, "simulated")):
        extents = np.linalg.svd(points, compute_uv=False)
        if extents[1] <= ON_A_LINE * extents[0]:
            raise DataError(
                what,
                "",
                f"the {whose} points lie on a line, about which a frame is free to turn; measure off it, or "
                "fit no frame",
            )
    u, sizes, vt = np.linalg.svd((measured - other).T @ (model - centre))
    sign = float(np.sign(np.linalg.det(u @ vt)))
    rotation = (u * (1.0, 1.0, sign)) @ vt
    proper = model - centre - (measured - other) @ rotation
    if sign < 0.0 and sizes[2] > ON_A_LINE * sizes[0]:
        mirrored = model - centre - (measured - other) @ (u @ vt)
        if (mirrored**2).sum() < MIRRORED**2 * (proper**2).sum():
            raise DataError(
                what,
                "",
                f"a mirrored frame fits better, {_mm(mirrored):.2f} mm against {_mm(proper):.2f} mm; two "
                "columns of the sensor or of the commands are swapped, or a sign is wrong",
            )
    return rotation.T, centre - other @ rotation


def align(
    positions: Array, rotations: Array, measured: Array, points: Array, fit: tuple[bool, bool], what: str
) -> Alignment:
    """Fit frame and points to the rows by least squares.

    Args:
        positions: Positions of the parts that carry the sensors in [m], shape (k, s, 3).
        rotations: Rotations of these parts, shape (k, s, 3, 3).
        measured: Measured positions in [m], shape (k, s, 3).
        points: Offsets of the sensors in [m] as described, shape (s, 3).
        fit: Whether the frame is fitted, and whether the points are.
        what: Description of the data in messages.

    Raises:
        DataError: the rows do not determine the fitted quantities.
    """
    frame, point = fit
    start = build_nominal_alignment(points)
    if frame:
        located = locate_sensors(positions, rotations, points)
        rotation, shift = rigid_frame(located.reshape(-1, 3), measured.reshape(-1, 3), what)
        start = Alignment(rotation, shift, points, np.zeros_like(points))
    return _refine_alignment(start, positions, rotations, measured, frame, what) if point else start


def _refine_alignment(
    start: Alignment, positions: Array, rotations: Array, measured: Array, frame: bool, what: str
) -> Alignment:
    """Refine the points, and the frame if requested, by Gauss-Newton."""
    count, sensors = positions.shape[:2]
    numbers = 3 * sensors + (6 if frame else 0)
    if 3 * count * sensors <= numbers:
        raise DataError(
            what,
            "",
            f"{count} rows cannot determine the {numbers} numbers of frame and sensor points; measure more",
        )
    now, size = start, float(np.sqrt(((measured - measured.mean(axis=(0, 1))) ** 2).sum(-1).mean()))
    slopes = np.zeros((count, sensors, 3, numbers))
    for s in range(sensors):
        slopes[:, s, :, 3 * s : 3 * s + 3] = rotations[:, s]
    centre = measured.mean(axis=(0, 1))  # rotating about the centre nearly decouples rotation from shift
    for _ in range(50):
        errors = now.errors(positions, rotations, measured)
        if frame:
            slopes[..., -6:-3] = cross_matrices((measured - centre) @ now.rotation.T) / size
            slopes[..., -3:] = -np.eye(3)
        matrix = slopes.reshape(-1, numbers)
        u, sizes, vt = np.linalg.svd(matrix, full_matrices=False)
        if sizes[-1] <= UNDETERMINED * sizes[0]:
            unclear = "frame and sensor point" if frame else "the sensor point"
            raise DataError(
                what,
                "",
                f"the rows do not tell {unclear} apart: what the sensor sits on hardly tilts; measure "
                "tilted poses, or fit the frame alone",
            )
        step = -vt.T @ ((u.T @ errors.ravel()) / sizes)
        rotation, shift = now.rotation, now.shift
        if frame:
            rotation = rotation_exp(step[-6:-3] / size) @ now.rotation
            shift = now.place(centre) + step[-3:] - rotation @ centre
        new_points = now.points + step[: 3 * sensors].reshape(-1, 3)
        now = Alignment(rotation, shift, new_points, now.point_errors)
        if np.abs(step).max() < 1e-12:
            break
    errors = now.errors(positions, rotations, measured)
    variance = (errors**2).sum() / (errors.size - numbers)
    spread = np.sqrt(variance * ((vt.T / sizes) ** 2).sum(axis=1))[: 3 * sensors]
    return Alignment(now.rotation, now.shift, now.points, spread.reshape(-1, 3))


def _mm(errors: Array) -> float:
    return 1e3 * float(np.sqrt((errors**2).sum(axis=-1).mean()))
