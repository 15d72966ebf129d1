"""Rigid bodies of a scene as geoms of a MuJoCo model."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np

from softsim_core.arrays import Array
from softsim_core.mechanics.pose import quaternion_of
from softsim_core.mjcf.elements import Draft, add, words
from softsim_core.scene.objects import RigidBodyDescription
from softsim_core.scene.rigid_builder import RigidBody


def add_rigid_bodies(draft: Draft) -> None:
    """Free ones as bodies of their own, the others as geoms of what carries them."""
    model, weights = draft.built.model, draft.built.model.rigid
    for description, body in zip(draft.scene.rigid_bodies, draft.built.rigid, strict=True):
        if body.free >= 0:
            element = add(
                draft.world, "body", name=body.name, pos=words(body.position), quat=_quaternion(body.rotation)
            )
            add(element, "freejoint", name=f"{body.name}_free")
            inertia = weights.inertia[body.free]
            add(
                element,
                "inertial",
                pos="0 0 0",
                mass=words([weights.mass[body.free]]),
                fullinertia=words(inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]),
            )
            _add_geom(draft, element, description, body, (np.zeros(3), np.eye(3)))
            if any((*description.velocity, *description.angular_velocity)):
                draft.told.say(f"rigid body {body.name}", "velocity: everything starts without in the model")
            continue
        carrier, pose = draft.world, (body.position, body.rotation)
        joints = {joint.name: j for j, joint in enumerate(model.joints)}
        name = body.on.removesuffix("_base") if body.on not in draft.carriers else body.on
        if name in draft.carriers:
            origin, rotation = _frame(draft, body.on, joints)
            if body.on in draft.carriers:
                carrier, below = draft.carriers[body.on]
            else:  # the base of a joint: what carries the joint carries it
                parent = draft.scene.joints[joints[name]].parent
                carrier, below = draft.carriers.get(parent or "", (draft.world, np.zeros(3)))
            pose = (origin + rotation @ body.position - below, rotation @ body.rotation)
        _add_geom(draft, carrier, description, body, pose)


def _frame(draft: Draft, on: str, joints: dict[str, int]) -> tuple[Array, Array]:
    """Where a frame, a joint's frame or a joint's base starts in the world."""
    model = draft.built.model
    if on in model.frame_names:
        f = model.frame_names.index(on)
        return model.frame_rest[0][f], model.frame_rest[1][f]
    if on in joints:
        return model.joint_frame(joints[on], model.rest_state())
    joint = model.joints[joints[on.removesuffix("_base")]]
    return joint.base_position, joint.base_rotation


def _quaternion(rotation: Array) -> str:
    x, y, z, w = quaternion_of(rotation)
    return words([w, x, y, z])


def _add_geom(
    draft: Draft,
    parent: ElementTree.Element,
    description: RigidBodyDescription,
    body: RigidBody,
    pose: tuple[Array, Array],
) -> None:
    shape, mask = description.shape, draft.masks[body.name]
    if shape.sphere is not None:
        kind, size = "sphere", [shape.sphere]
    elif shape.box is not None:
        kind, size = "box", [0.5 * each for each in shape.box]
    elif shape.cylinder is not None:
        kind, size = "cylinder", [shape.cylinder[0], 0.5 * shape.cylinder[1]]
    elif shape.plane is not None:
        kind, size = "plane", [0.5 * shape.plane[0], 0.5 * shape.plane[1], 0.1]
    else:
        kind, size = "mesh", []
        add(
            draft.section("asset"),
            "mesh",
            name=body.name,
            vertex=words(body.surface.points),
            face=words(body.surface.triangles),
        )
        if mask.own:
            draft.told.say(f"rigid body {body.name}", "touches with the convex hull of its mesh in MuJoCo")
    if kind == "plane" and parent is not draft.world:
        draft.told.say(f"rigid body {body.name}", "a plane that moves is a thin box in the model")
        kind, size = "box", [*size[:2], 0.0005]
    more = {"size": words(size)} if size else {"mesh": body.name}
    add(
        parent,
        "geom",
        name=body.name,
        type=kind,
        pos=words(pose[0]),
        quat=_quaternion(pose[1]),
        mass="0",
        contype=str(mask.own),
        conaffinity=str(mask.others),
        friction=words([draft.scene.contact.friction, 0.005, 0.0001]),
        rgba=words(description.colour),
        **more,
    )
