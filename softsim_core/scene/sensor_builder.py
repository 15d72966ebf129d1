"""The sensors of a scene, compiled."""

from __future__ import annotations

import numpy as np

from softsim_core.contact.collision_model import CollisionModel
from softsim_core.mechanics.carrier import Carrier
from softsim_core.scene.actuator_builder import surroundings
from softsim_core.scene.builder import BuiltScene
from softsim_core.scene.description import SceneDescription
from softsim_core.scene.rigid_builder import RigidBody
from softsim_core.sensing.building import Scenery
from softsim_core.sensing.place import Place
from softsim_core.sensing.registry import sensor_kind
from softsim_core.sensing.sensors import Sensors


def sensors(scene: SceneDescription, built: BuiltScene, collisions: CollisionModel | None) -> Sensors:
    """All sensors of a scene; none has told anything yet.

    Raises:
        SceneError: one does not fit the scene.
    """
    if not scene.sensors:
        return Sensors((), scene.dt)
    model, rest = built.model, built.model.rest_state()
    built.actuators.measure(model, rest)
    scenery = Scenery(
        soft=surroundings(model, built.bodies),
        body_names=scene.body_names,
        places=_places(scene, built),
        surfaces=() if collisions is None else collisions.surfaces,
        points=np.zeros((0, 3)) if collisions is None else collisions.points(rest),
        actuators={view.name: view for view in built.actuators.views(model, rest)},
    )
    found = [(each, sensor_kind(each.kind).build(each, scenery)) for each in scene.sensors]
    return Sensors(found, scene.dt)


def _places(scene: SceneDescription, built: BuiltScene) -> dict[str, Place]:
    """What moves rigidly, by name; of equal names an attachment comes before a joint, that before a body."""
    frames = {name: Carrier(frame=f) for f, name in enumerate(built.model.frame_names)}
    horns = {joint.name: Carrier(joint=j) for j, joint in enumerate(scene.joints) if joint.moves_frame}
    bases = {
        f"{joint.name}_base": Carrier(base=j) for j, joint in enumerate(scene.joints) if joint.moves_frame
    }
    carriers = {"world": Carrier(), **bases, **horns, **frames}
    places = {body.name: _of_body(body, carriers) for body in built.rigid}
    places |= {name: Place(carrier) for name, carrier in carriers.items()}
    return places | {each.name: Place(carriers[each.to]) for each in scene.attachments if each.to != "free"}


def _of_body(body: RigidBody, carriers: dict[str, Carrier]) -> Place:
    if body.free >= 0:
        return Place(Carrier(rigid=body.free))
    return Place(carriers[body.on], body.position, body.rotation)
