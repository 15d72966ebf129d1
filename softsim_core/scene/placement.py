"""Rigid motion of a scene to another place in the world."""

from __future__ import annotations

from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

import numpy as np

from softsim_core.base import DIRECTION, LOCAL, POINT, Array, Box, Placement, Sphere, Vector, vector
from softsim_core.physics.mechanics import euler_of, rotation_euler
from softsim_core.physics.mesh import TetMesh
from softsim_core.scene.description import SceneDescription


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """A rigid motion x -> R x + t: rotation R (3, 3), translation t (3,) in [m]."""

    rotation: Array
    translation: Array

    @classmethod
    def to(cls, placement: Placement) -> Motion:
        """Return the motion to a placement (its scale is not used)."""
        turn = rotation_euler(np.radians(placement.rotation_deg))
        return cls(turn, np.array(placement.translation, dtype=float))

    def after(self, first: Motion) -> Motion:
        """Return the motion that applies `first`, then this one."""
        return Motion(self.rotation @ first.rotation, self.point(first.translation))

    @property
    def inverse(self) -> Motion:
        """The inverse motion."""
        return Motion(self.rotation.T, -self.rotation.T @ self.translation)

    def point(self, point: Vector | Array) -> Array:
        """Return the moved position of a point (3,), in [m]."""
        return np.asarray(self.rotation @ np.asarray(point) + self.translation)

    def direction(self, direction: Vector | Array) -> Array:
        """Return the rotated direction (3,)."""
        return np.asarray(self.rotation @ np.asarray(direction))

    def placement(self, scale: float = 1.0) -> Placement:
        """Return the placement to which it moves the frame of the world."""
        angles = np.degrees(euler_of(self.rotation))
        return Placement(scale=scale, rotation_deg=vector(angles), translation=vector(self.translation))


def place_scene(scene: SceneDescription, motion: Motion) -> SceneDescription:
    """Move all positions and directions of a scene rigidly in the world; gravity is not changed.

    Placements, boxes, spheres and arrays of nodes are moved, except in fields marked LOCAL; vectors are moved
    in fields marked POINT or DIRECTION; see softsim_core.base.values. Values in the frame of another part
    stay: regions relative to a joint, rigid bodies on a carrier, and their surfaces. Implicit free frames
    become explicit in the result, so that they rotate with it.

    Raises:
        SceneError, MeshError: such a frame cannot be determined; see softsim_core.scene.building.builder.
    """
    from softsim_core.scene.building import with_rest_frames  # late: most processes only read scenes

    scene = with_rest_frames(scene)
    moved: SceneDescription = _place_value(scene, motion)
    soft = {each.name for each in scene.bodies}
    return replace(
        moved,
        attachments=tuple(
            new if old.relative_to is None else replace(new, box=old.box, sphere=old.sphere)
            for old, new in zip(scene.attachments, moved.attachments, strict=True)
        ),
        rigid_bodies=tuple(
            new if old.on == "world" else old
            for old, new in zip(scene.rigid_bodies, moved.rigid_bodies, strict=True)
        ),
        collisions=tuple(
            new if old.body in soft else old
            for old, new in zip(scene.collisions, moved.collisions, strict=True)
        ),
    )


def _place_value(value: Any, motion: Motion) -> Any:
    if isinstance(value, Placement):
        return motion.after(Motion.to(value)).placement(value.scale)
    if isinstance(value, Box):
        here = Placement(rotation_deg=value.rotation_deg, translation=value.center)
        there = motion.after(Motion.to(here)).placement()
        return replace(value, center=there.translation, rotation_deg=there.rotation_deg)
    if isinstance(value, Sphere):
        return replace(value, center=vector(motion.point(value.center)))
    if isinstance(value, TetMesh):
        return replace(value, points=value.points @ motion.rotation.T + motion.translation)
    if isinstance(value, tuple):
        return tuple(_place_value(each, motion) for each in value)
    if not is_dataclass(value) or isinstance(value, type):
        return value
    changed = {}
    for each in fields(value):
        old = getattr(value, each.name)
        if each.metadata in (POINT, DIRECTION):
            moved = _vectors(old, motion.point if each.metadata == POINT else motion.direction)
        else:
            moved = old if each.metadata == LOCAL else _place_value(old, motion)
        if moved is not old:
            changed[each.name] = moved
    return replace(value, **changed)


def _vectors(value: Any, move: Any) -> Any:
    """Move a vector, or a list of them; None and an empty list stay."""
    if not value:
        return value
    if isinstance(value[0], tuple):
        return tuple(vector(move(each)) for each in value)
    return vector(move(value))
