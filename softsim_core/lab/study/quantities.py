"""Quantities of a running scene by name: access, unit and shape."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from softsim_core.base import Array, SceneError, listing
from softsim_core.control.inverse import sample_workspace, tilts_of
from softsim_core.lab.study.description import QuantityDescription
from softsim_core.physics.mechanics import Pose, rotation_of
from softsim_core.simulation import Simulation

Read: TypeAlias = Callable[[Simulation], Array]
AXES = ("x", "y", "z")


@dataclass(frozen=True, slots=True)
class Quantity:
    """Access to a quantity.

    Attributes:
        read: Function from a simulation to the value.
        unit: Unit of the value, in SI.
        shape: Shape of the value; None: it is read once to determine it.
    """

    read: Read
    unit: str
    shape: tuple[int, ...] | None = None


def quantity(
    description: QuantityDescription, simulation: Simulation, function: Read | None = None
) -> Quantity:
    """Return the quantity of a description for a scene at its start.

    Args:
        description: The description.
        simulation: In the reference state of displacements.
        function: Function of `of: python`.

    Raises:
        SceneError: the scene has no such part, or `of` is unknown.
    """
    if function is not None:
        return Quantity(_number_of(function, description), description.unit or "", ())
    words = description.of.split(".")
    axis = AXES.index(words.pop()) if len(words) > 1 and words[-1] in AXES else None
    find, name = _KINDS.get((words[0], words[-1])), ".".join(words[1:-1])
    if find is None or bool(name) != (words[0] in _OF_NAMED):
        find, name = _WHOLE.get(words[0]), ".".join(words[1:])
    if find is None:
        parts = [f"{kind}.NAME.{what}" if kind in _OF_NAMED else f"{kind}.{what}" for kind, what in _KINDS]
        forms = ", ".join([*parts, *(f"{kind}.NAME" for kind in _WHOLE), "python"])
        raise SceneError(
            f"quantity {description.name}: unknown {description.of!r}; known: {forms}; after those of three "
            "numbers .x, .y or .z"
        )
    found = find(simulation, name, description)
    if axis is None:
        return found
    if found.read(simulation).shape != (3,):
        raise SceneError(f"quantity {description.name}: {description.of} has no {AXES[axis]}; leave it out")
    read = found.read
    return Quantity(lambda running: np.asarray(read(running)[axis]), found.unit)


def _number_of(function: Read, description: QuantityDescription) -> Read:
    def read(simulation: Simulation) -> Array:
        result = function(simulation)
        try:
            value = np.asarray(result, dtype=float)
        except (TypeError, ValueError):
            value = np.zeros(0)
        if value.shape != ():
            raise SceneError(
                f"quantity {description.name}: {description.function} must give one number, "
                f"not {result!r:.80}"
            )
        return value

    return read


def _find_index(what: str, name: str, names: tuple[str, ...], description: QuantityDescription) -> int:
    if name not in names:
        raise SceneError(
            f"quantity {description.name}: the scene has no {what} {name!r}; known: {listing(names)}"
        )
    return names.index(name)


def _pose(simulation: Simulation, description: QuantityDescription) -> Pose:
    pose = simulation.effector_pose
    if pose is None:
        raise SceneError(f"quantity {description.name}: the scene has no effector; name a frame or a body")
    return pose


def _effector_position(simulation: Simulation, _: str, description: QuantityDescription) -> Quantity:
    _pose(simulation, description)
    return Quantity(lambda running: _pose(running, description).position, "m")


def _effector_displacement(simulation: Simulation, _: str, description: QuantityDescription) -> Quantity:
    start = _pose(simulation, description).position
    return Quantity(lambda running: _pose(running, description).position - start, "m")


def _effector_tilt(simulation: Simulation, _: str, description: QuantityDescription) -> Quantity:
    _pose(simulation, description)

    def read(running: Simulation) -> Array:
        tilts = tilts_of(rotation_of(_pose(running, description).quaternion_xyzw))
        return np.array([tilts.x, tilts.y, tilts.turn])

    return Quantity(read, "rad")


def _frame(simulation: Simulation, name: str, description: QuantityDescription) -> Quantity:
    _find_index("frame", name, tuple(simulation.frames()), description)
    return Quantity(lambda running: running.frames()[name].position, "m")


def _nodes(simulation: Simulation, name: str, description: QuantityDescription) -> slice:
    names = tuple(each.name for each in simulation.bodies)
    return simulation.bodies[_find_index("body", name, names, description)].nodes


def _displacement(simulation: Simulation, name: str, description: QuantityDescription) -> Quantity:
    nodes = _nodes(simulation, name, description)
    start = simulation.positions[nodes]
    return Quantity(
        lambda running: np.asarray(np.linalg.norm(running.positions[nodes] - start, axis=1).max()), "m"
    )


def _stress(simulation: Simulation, name: str, description: QuantityDescription) -> Quantity:
    nodes = _nodes(simulation, name, description)
    return Quantity(lambda running: np.asarray(running.von_mises()[nodes].max()), "Pa")


def _centre(simulation: Simulation, name: str, description: QuantityDescription) -> Quantity:
    nodes = _nodes(simulation, name, description)
    return Quantity(lambda running: running.positions[nodes].mean(axis=0), "m")


def _joint_position(simulation: Simulation, name: str, description: QuantityDescription) -> Quantity:
    j = _find_index("joint", name, simulation.joint_names, description)
    unit = simulation.scene.joints[j].units.position.si
    return Quantity(lambda running: np.asarray(running.joint_positions[j]), unit)


def _joint_effort(simulation: Simulation, name: str, description: QuantityDescription) -> Quantity:
    j = _find_index("joint", name, simulation.joint_names, description)
    return Quantity(
        lambda running: np.asarray(running.joint_efforts[j]), simulation.scene.joints[j].units.effort
    )


def _rigid_position(simulation: Simulation, name: str, description: QuantityDescription) -> Quantity:
    r = _find_index(
        "rigid body", name, tuple(each.name for each in simulation.scene.rigid_bodies), description
    )
    return Quantity(lambda running: running.rigid_poses[r].position, "m")


def _rigid_velocity(simulation: Simulation, name: str, description: QuantityDescription) -> Quantity:
    r = _find_index("rigid body with mass", name, simulation.rigid_names, description)
    return Quantity(lambda running: running.rigid_velocities[r, :3], "m/s")


def _all_contact_forces(simulation: Simulation, name: str, description: QuantityDescription) -> Quantity:
    return Quantity(lambda running: np.asarray(np.linalg.norm(running.contacts.forces, axis=1).sum()), "N")


def _contact_count(simulation: Simulation, name: str, description: QuantityDescription) -> Quantity:
    def read(running: Simulation) -> Array:
        contacts = running.contacts  # the contacts of all substeps of a step
        return np.asarray(float(len(np.unique(contacts.vertices[contacts.forces.any(axis=1)], axis=0))))

    return Quantity(read, "")


def _contact_gap(simulation: Simulation, name: str, description: QuantityDescription) -> Quantity:
    return Quantity(lambda running: np.asarray(running.contacts.gaps.min(initial=np.inf)), "m")


def _contact_force(simulation: Simulation, name: str, description: QuantityDescription) -> Quantity:
    """Return the quantity of the total contact force on a body."""
    number = _find_index("body", name, simulation.scene.body_names, description)

    def read(running: Simulation) -> Array:
        contacts = running.contacts
        on = (contacts.bodies[:, 0] == number).astype(float) - (contacts.bodies[:, 1] == number)
        return np.asarray(on @ contacts.forces)

    return Quantity(read, "N")


def _sensor(simulation: Simulation, name: str, description: QuantityDescription) -> Quantity:
    _find_index("sensor", name, tuple(simulation.sensors), description)
    return Quantity(lambda running: np.asarray(running.sensors[name].value, dtype=float), "SI")


def _workspace_volume(simulation: Simulation, name: str, description: QuantityDescription) -> Quantity:
    if description.at != "end":
        raise SceneError(
            f"quantity {description.name}: a workspace is of the scene, not of a time; leave out `at`"
        )
    limit = np.inf if description.most_effort is None else description.most_effort

    def read(running: Simulation) -> Array:
        return np.asarray(sample_workspace(running.robot, description.samples).volume_within(limit))

    return Quantity(read, "m^3", ())


_KINDS: dict[tuple[str, str], Callable[[Simulation, str, QuantityDescription], Quantity]] = {
    ("effector", "position"): _effector_position,
    ("effector", "displacement"): _effector_displacement,
    ("effector", "tilt"): _effector_tilt,
    ("frame", "position"): _frame,
    ("body", "displacement"): _displacement,
    ("body", "stress"): _stress,
    ("body", "centre"): _centre,
    ("joint", "position"): _joint_position,
    ("joint", "effort"): _joint_effort,
    ("rigid", "position"): _rigid_position,
    ("rigid", "velocity"): _rigid_velocity,
    ("contact", "force"): _all_contact_forces,
    ("contact", "count"): _contact_count,
    ("contact", "gap"): _contact_gap,
    ("workspace", "volume"): _workspace_volume,
}

_OF_NAMED = ("frame", "body", "joint", "rigid")
"""Kinds with several instances in a scene, each with its name before the last word."""

_WHOLE = {"contact": _contact_force, "sensor": _sensor}  # kinds whose name is everything after the first word
