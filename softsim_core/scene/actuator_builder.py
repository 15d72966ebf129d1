"""The actuators of a scene, compiled, kind by kind."""

from __future__ import annotations

from softsim_core.actuation.actuators import Actuators
from softsim_core.actuation.building import Placed, Surroundings
from softsim_core.actuation.registry import actuator_kinds
from softsim_core.mechanics.model import Model
from softsim_core.scene.body import Body
from softsim_core.scene.description import SceneDescription


def surroundings(model: Model, bodies: tuple[Body, ...]) -> Surroundings:
    """What actuators and sensors are built into."""
    return Surroundings(
        model, {body.name: body.solid for body in bodies}, {body.name: body.nodes.start for body in bodies}
    )


def actuators(scene: SceneDescription, model: Model, bodies: tuple[Body, ...]) -> Actuators:
    """All actuators that joints of a scene have; kinds in the order of the registry.

    Raises:
        SceneError: an actuator does not fit its surroundings.
        ConfigError: a file that an actuator names cannot be read.
    """
    around = surroundings(model, bodies)
    groups = []
    for kind in actuator_kinds().values():
        placed = [
            Placed(joint.name, j, joint.actuator)
            for j, joint in enumerate(scene.joints)
            if joint.actuator is not None and joint.kind == kind.name
        ]
        if placed:
            groups.append(kind.build(placed, around))
    return Actuators(groups)
