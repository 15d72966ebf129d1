"""An arm and the tools on its links as one robot, as if all were written in one file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from softsim_core.base import Placement, SceneError, known_names, vector
from softsim_core.physics.mechanics import rotation_exp
from softsim_core.scene import (
    CollisionDescription,
    JointDescription,
    Motion,
    RigidBodyDescription,
    RobotDescription,
    SceneDescription,
    ViewSettings,
    place_scene,
)
from softsim_core.scene.arm.description import ArmDescription, ToolDescription
from softsim_core.scene.arm.urdf_file import RigidRobot, read_urdf

GROUP = "arm"
"""Group of the collision surfaces of an arm's links: they never touch each other."""

_PARTS = ("bodies", "joints", "attachments", "rigid_bodies", "collisions", "sensors")
"""Fields of a scene that contain the parts of a tool."""


@dataclass(frozen=True, slots=True, eq=False)
class Mount:
    """Pose of a link while the scene is built, and the joint that moves it.

    Attributes:
        joint: Name of the last joint that moves before it, or "world".
        frame: World frame that this joint moves.
        link: World frame of the link.
    """

    joint: str
    frame: Motion
    link: Motion


def arm_with_tools(
    name: str, arm: ArmDescription, load: Callable[[ToolDescription], RobotDescription]
) -> RobotDescription:
    """Return the robot of an arm and its tools; its joints are the arm's, then those of the tools.

    `name` is that of the scene; `load` returns the robot of a tool.

    Raises:
        SceneError: an unknown link or joint, a start beyond limits, or a tool that cannot be mounted.
    """
    rigid = read_urdf(arm.urdf, arm.arguments)
    joints, mounts = _joints(rigid, arm)
    bodies, collisions = _links(rigid, mounts, arm.touch)
    scene = SceneDescription(name=name, joints=joints, rigid_bodies=bodies, collisions=collisions)
    robot = RobotDescription(scene=scene)
    for tool in arm.tools:
        if tool.on not in mounts:
            hint = known_names(tool.on, mounts)
            raise SceneError(f"arm: unknown link {tool.on!r} for {tool.robot}; {hint}")
        robot = _with_tool(robot, _without(load(tool), tool), mounts[tool.on], tool.pose)
    return robot


def _joints(rigid: RigidRobot, arm: ArmDescription) -> tuple[tuple[JointDescription, ...], dict[str, Mount]]:
    """Return the joints that move, and the mounts of all links."""
    moving = [each.name for each in rigid.joints if each.kind != "fixed"]
    if unknown := [each for each in arm.start if each not in moving]:
        raise SceneError(f"arm: start names the joint {unknown[0]!r}; {known_names(unknown[0], moving)}")
    root = Motion.to(arm.pose)
    mounts = {rigid.root: Mount("world", Motion(np.eye(3), np.zeros(3)), root)}
    result = []
    for each in rigid.joints:
        carrier = mounts[each.parent]
        base = carrier.link.after(each.origin)
        if each.kind == "fixed":
            mounts[each.child] = replace(carrier, link=base)
            continue
        limits = each.limits
        rest = arm.start.get(each.name, limits.clamp(0.0))
        if limits.clamp(rest) != rest:
            allowed = f"[{limits.lower}, {limits.upper}]"
            raise SceneError(f"arm: start of {each.name} is {rest}; allowed is {allowed}")
        if each.kind == "revolute":
            motion = Motion(rotation_exp(rest * each.axis), np.zeros(3))
        else:
            motion = Motion(np.eye(3), rest * each.axis)
        moved = base.after(motion)
        mounts[each.child] = Mount(each.name, moved, moved)
        result.append(
            JointDescription(
                name=each.name,
                kind=each.kind,
                parent=None if carrier.joint == "world" else carrier.joint,
                base=base.placement(),
                axis=vector(each.axis),
                limits=limits,
                rest=rest,
            )
        )
    return tuple(result), mounts


def _links(
    rigid: RigidRobot, mounts: dict[str, Mount], touch: bool
) -> tuple[tuple[RigidBodyDescription, ...], tuple[CollisionDescription, ...]]:
    """Return the shapes of the links, and the collision surfaces of those that touch."""
    bodies, collisions = [], []
    for link, shapes in rigid.shapes.items():
        mount = mounts[link]
        for k, each in enumerate(shapes):
            name = link if len(shapes) == 1 else f"{link}_{k}"
            where = mount.frame.inverse.after(mount.link).after(each.pose).placement()
            on, shape, colour = mount.joint, each.shape, each.colour
            bodies.append(RigidBodyDescription(name=name, shape=shape, pose=where, on=on, colour=colour))
            if touch and each.touches:
                collisions.append(CollisionDescription(name=name, body=name, groups=(GROUP,)))
    return tuple(bodies), tuple(collisions)


def _without(robot: RobotDescription, tool: ToolDescription) -> RobotDescription:
    """Return a tool's robot without the excluded parts; what a removed joint carried moves to its carrier."""
    scene, left = robot.scene, set(tool.without)
    names_of_parts = [part.name for kind in _PARTS for part in getattr(scene, kind)]
    if unknown := sorted(left - set(names_of_parts)):
        hint = known_names(unknown[0], names_of_parts)
        raise SceneError(f"arm: {tool.robot} has no {unknown[0]!r} to leave out; {hint}")
    carriers = {each.name: each.parent for each in scene.joints}

    def remaining_carrier(name: str | None) -> str | None:
        while name in left and name in carriers:
            name = carriers[name]
        return name

    remaining: dict[str, Any] = {
        kind: tuple(part for part in getattr(scene, kind) if part.name not in left) for kind in _PARTS
    }
    bodies = {each.name for each in (*remaining["bodies"], *remaining["rigid_bodies"])}
    for kind in ("attachments", "collisions"):
        remaining[kind] = tuple(each for each in remaining[kind] if each.body in bodies)
    joints = []
    for each in remaining["joints"]:
        actuator = each.actuator
        if actuator is not None:
            on = {name: remaining_carrier(carrier) for name, carrier in actuator.carriers().items()}
            actuator = replace(actuator, **on)
        joints.append(replace(each, parent=remaining_carrier(each.parent), actuator=actuator))
    remaining["joints"] = tuple(joints)
    for kind, field_name in (("attachments", "to"), ("rigid_bodies", "on")):
        remaining[kind] = tuple(
            replace(each, **{field_name: remaining_carrier(getattr(each, field_name)) or "world"})
            for each in remaining[kind]
        )
    pairs = tuple(each for each in scene.contact.friction_pairs if not left & set(each.between))
    order = [k for k, each in enumerate(scene.joints) if each.name not in left]
    names = {each.name for each in remaining["joints"]}
    return replace(
        robot,
        scene=replace(scene, **remaining, contact=replace(scene.contact, friction_pairs=pairs)),
        poses={name: tuple(values[k] for k in order) for name, values in robot.poses.items()},
        keys={key: each for key, each in robot.keys.items() if names.issuperset(each.joints)},
        start=None,
        view=ViewSettings(),
        controllers=(),
    )


def _with_tool(
    robot: RobotDescription, tool: RobotDescription, mount: Mount, pose: Placement
) -> RobotDescription:
    """Return a robot with a tool whose world is at a pose in the frame of a link."""
    there = place_scene(tool.scene, mount.link.after(Motion.to(pose)))
    hung = _mount_tool(there, mount)
    parts: dict[str, Any] = {
        kind: (*getattr(robot.scene, kind), *hung.get(kind, getattr(there, kind))) for kind in _PARTS
    }
    scene = replace(
        robot.scene,
        dt=there.dt,
        solver=there.solver,
        contact=there.contact if there.collisions else robot.scene.contact,
        effector=there.effector or robot.scene.effector,
        **parts,
    )
    first, second = (tuple(each.rest for each in part.joints) for part in (robot, tool))
    poses = {name: (*values, *second) for name, values in robot.poses.items()}
    poses |= {name: (*first, *values) for name, values in tool.poses.items()}
    return RobotDescription(
        scene=scene,
        poses=poses,
        commands=tool.commands,
        keys={**robot.keys, **tool.keys},
        board=tool.board or robot.board,
        inverse=tool.inverse,
    )


def _mount_tool(tool: SceneDescription, mount: Mount) -> dict[str, Any]:
    """Return the fields that change when a link carries a tool instead of the world."""
    on, joints, attachments, bodies = mount.joint, [], [], []
    for joint in tool.joints:
        parent = on if joint.moves_frame and joint.parent is None and on != "world" else joint.parent
        actuator = joint.actuator
        if actuator is not None and on != "world":
            actuator = actuator.carried_by(on)
        joints.append(replace(joint, actuator=actuator, parent=parent))
    for each in tool.attachments:
        if each.stiffness is not None and on != "world":
            raise SceneError(
                f"arm: the attachment {each.name} is a spring to the world, which no link can carry; "
                "remove its stiffness or leave it out (`without`)"
            )
        attachments.append(replace(each, to=on if each.to == "world" else each.to))
    for body in tool.rigid_bodies:
        if body.on == "world" and body.mass is None:
            pose = mount.frame.inverse.after(Motion.to(body.pose)).placement(body.pose.scale)
            body = replace(body, pose=pose, on=on)
        bodies.append(body)
    return {"joints": joints, "attachments": attachments, "rigid_bodies": bodies}
