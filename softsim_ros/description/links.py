"""The links of a robot and their parents: one tree for URDF and for /tf.

`base_link` is at the world's origin. A joint with a frame has two links, its base (`servo_0_base`) and the
link that it moves (`servo_0_horn`; for a slide `vertical_slide`). The joint of an actuator has one link
(`finger_1_cable_end`), which moves along z from the actuator's pull point. Free frames are connected to the
base by six degrees of freedom: the effector is called `effector`, others by their names. Rigid bodies that a
joint or a free frame carries are links of their own, and so is each deformable body in its rest shape
(`silicone_at_rest`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from softsim_core import RobotDescription
from softsim_core.base import Array, Placement, Vector
from softsim_core.physics.mechanics import rotation_exp
from softsim_core.physics.mesh import rotation_matrix
from softsim_core.scene import AttachmentDescription, JointDescription, SceneDescription
from softsim_core.scene.building import with_rest_frames
from softsim_node import BASE_LINK, EFFECTOR

Kind: TypeAlias = Literal["fixed", "floating", "revolute", "continuous", "prismatic"]


@dataclass(frozen=True, slots=True, eq=False)
class Link:
    """A link and the joint that connects it to its parent.

    Attributes:
        name: Name of the link.
        parent: Name of the parent link, which precedes it.
        joint: Name of the joint; if it has a position, the name in `joint_states`.
        kind: Type of the joint.
        position: Its origin in the parent's frame at joint position 0, in [m], shape (3,).
        rotation: Its rotation there, shape (3, 3).
        axis: Unit axis of the joint in the link's frame, shape (3,).
        part: Part of the scene that it shows, as KIND/NAME: bodies, joints, attachments or rigid_bodies.
        measured: Its name among the frames of a simulation; empty: its pose follows from its joint.
    """

    name: str
    parent: str
    joint: str
    kind: Kind
    position: Array
    rotation: Array
    axis: Array
    part: str
    measured: str = ""

    def pose(self, joint_position: float) -> tuple[Array, Array]:
        """Return position (3,) and rotation (3, 3) in the parent's frame.

        The joint position is in [rad] or [m].
        """
        if self.kind == "prismatic":
            return self.position + self.rotation @ (joint_position * self.axis), self.rotation
        if self.kind in ("revolute", "continuous"):
            return self.position, self.rotation @ rotation_exp(joint_position * self.axis)
        return self.position, self.rotation


def links_of(robot: RobotDescription) -> tuple[Link, ...]:
    """Return all links except `base_link`, every parent before its children."""
    scene, links = robot.scene, list[Link]()
    moved = {joint.name: moved_link(joint) for joint in scene.joints}
    for joint in scene.joints:
        links += _frame_links(joint, scene, moved) if joint.moves_frame else []
    links += [_end_link(joint, moved, scene) for joint in scene.joints if not joint.moves_frame]
    free = [each for each in with_rest_frames(scene).attachments if each.to == "free"]
    names = {each.name: _free(EFFECTOR if each.name == scene.effector else each.name, links) for each in free}
    links += [_free_link(each, names[each.name]) for each in free]
    carriers = {**moved, **names, **{f"{joint.name}_base": _base(joint) for joint in scene.joints}}
    for body in scene.rigid_bodies:
        if body.on != "world":
            place, rotation = _pose_of(body.pose)
            carrier, part = carriers[body.on], f"rigid_bodies/{body.name}"
            links.append(_make_fixed_link(_free(body.name, links), carrier, place, rotation, part))
    for soft in scene.bodies:
        part = f"bodies/{soft.name}"
        links.append(
            _make_fixed_link(_free(f"{soft.name}_at_rest", links), BASE_LINK, np.zeros(3), np.eye(3), part)
        )
    return tuple(links)


def moved_link(joint: JointDescription) -> str:
    """Return the name of the link that a joint moves."""
    mover = "horn" if joint.kind == "revolute" else "slide"
    return f"{joint.name}_{mover if joint.moves_frame else 'end'}"


def _base(joint: JointDescription) -> str:
    return f"{joint.name}_base"


def _frame_links(joint: JointDescription, scene: SceneDescription, moved: dict[str, str]) -> list[Link]:
    """Return a joint's base link and the link that it moves."""
    parent = BASE_LINK if joint.parent is None else moved[joint.parent]
    position, rotation = _relative_pose(_carrier_at_rest(joint.parent, scene), _pose_of(joint.base))
    bounded = math.isfinite(joint.limits.lower) or math.isfinite(joint.limits.upper)
    kind: Kind = ("revolute" if bounded else "continuous") if joint.kind == "revolute" else "prismatic"
    part = f"joints/{joint.name}"
    base = Link(
        _base(joint), parent, f"{joint.name}_mount", "fixed", position, rotation, _Z, part, joint.name
    )
    axis, horn = np.array(joint.axis, dtype=float), f"{joint.name}_horn"
    mover = Link(moved[joint.name], base.name, joint.name, kind, np.zeros(3), np.eye(3), axis, part, horn)
    return [base, mover]


def _end_link(joint: JointDescription, moved: dict[str, str], scene: SceneDescription) -> Link:
    """Return the link at an actuator's pull point, which moves along z by its joint's position."""
    actuator = joint.actuator
    assert actuator is not None  # checked by the description
    place: Vector = getattr(actuator, "pull_point", None) or (0.0, 0.0, 0.0)
    carrier = next((name for name in actuator.carriers().values() if name is not None), None)
    parent = BASE_LINK if carrier is None else moved[carrier]
    position, rotation = _relative_pose(_carrier_at_rest(carrier, scene), (np.array(place, float), np.eye(3)))
    name, part = moved[joint.name], f"joints/{joint.name}"
    return Link(name, parent, joint.name, "prismatic", position, rotation, _Z, part)


def _free_link(attachment: AttachmentDescription, name: str) -> Link:
    assert attachment.frame is not None  # with_rest_frames sets all of them
    position, rotation = _pose_of(attachment.frame)
    part = f"attachments/{attachment.name}"
    return Link(name, BASE_LINK, f"{name}_motion", "floating", position, rotation, _Z, part, attachment.name)


def _make_fixed_link(name: str, parent: str, position: Array, rotation: Array, part: str) -> Link:
    return Link(name, parent, f"{name}_mount", "fixed", position, rotation, _Z, part)


def _carrier_at_rest(joint: str | None, scene: SceneDescription) -> tuple[Array, Array]:
    """Return position and rotation in the world of the frame that a joint moves, with all joints at rest."""
    if joint is None:
        return np.zeros(3), np.eye(3)
    described = scene.joints[scene.joint_names.index(joint)]
    position, rotation = _pose_of(described.base)  # in the world, with its carrier at rest
    axis = np.array(described.axis, dtype=float)
    if described.kind == "revolute":
        return position, rotation @ rotation_exp(described.rest * axis)
    return position + rotation @ (described.rest * axis), rotation


def _relative_pose(frame: tuple[Array, Array], place: tuple[Array, Array]) -> tuple[Array, Array]:
    """Return a pose in the axes of a frame; both are given in the world."""
    (origin, turn), (position, rotation) = frame, place
    return turn.T @ (position - origin), turn.T @ rotation


def _pose_of(placement: Placement) -> tuple[Array, Array]:
    return np.array(placement.translation, dtype=float), rotation_matrix(placement.rotation_deg)


def _free(name: str, links: Sequence[Link]) -> str:
    """Return the name, or a similar one if a link has it already."""
    taken = {BASE_LINK, *(link.name for link in links)}
    while name in taken:
        name = f"{name}_"
    return name


_Z = np.array([0.0, 0.0, 1.0])
