"""Add rigid bodies of known scenes to the running simulation and remove them again."""

from __future__ import annotations

import re
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from softsim_core import RobotDescription
from softsim_core.base import MOST_NAMES, Array, ConfigError, Placement, SceneError, SoftSimError, names_up_to
from softsim_core.physics.mechanics import euler_of
from softsim_core.scene import CollisionDescription, RigidBodyDescription, SceneCatalog, SceneDescription
from softsim_core.scene.building import rigid_objects


class RequestError(SoftSimError):
    """A request whose result is not OK.

    Args:
        kind: Name of the result, such as "NOT_FOUND", or of one that only this service has.
    """

    def __init__(self, kind: str, message: str) -> None:
        self.kind = kind
        super().__init__(message)


MOST_SPAWNED: Final = 32
"""Largest number of spawned bodies at a time; each of them costs time in every step."""

_NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,62}")


class Spawned(NamedTuple):
    """A rigid body with mass that is not part of the scene's files, with its collision surfaces."""

    body: RigidBodyDescription
    collisions: tuple[CollisionDescription, ...]


Spawnings = tuple[Spawned, ...]
Exchange = Callable[[Callable[[RobotDescription, Spawnings], Spawnings]], Awaitable[None]]
"""Function that builds a simulation with other spawned bodies and continues with it.

Its argument returns the new spawned bodies, given the running description and the present ones.
"""


def replace_spawned(robot: RobotDescription, before: Spawnings, after: Spawnings) -> RobotDescription:
    """Return a robot in which the spawned bodies `after` replace those of `before`.

    Raises:
        SceneError: a name is taken.
    """
    gone, scene = {each.body.name for each in before}, robot.scene
    return robot.with_scene(
        rigid_bodies=(
            *(body for body in scene.rigid_bodies if body.name not in gone),
            *(each.body for each in after),
        ),
        collisions=(
            *(collision for collision in scene.collisions if collision.body not in gone),
            *(collision for each in after for collision in each.collisions),
        ),
    )


class Spawner:
    """Spawns bodies by URI `SCENE/BODY`: the rigid bodies with mass of the known YAML scenes.

    Args:
        exchange: Continues the simulation with other spawned bodies.
        run_in_background: Runs long work in the background while the executor serves other callbacks.
    """

    def __init__(
        self,
        scenes: SceneCatalog,
        exchange: Exchange,
        run_in_background: Callable[[Callable[[], Any]], Awaitable[Any]],
        present: Callable[[], Spawnings],
    ) -> None:
        self._scenes, self._exchange = scenes, exchange
        self._run_in_background, self._present = run_in_background, present

    async def list_known(self) -> dict[str, RigidBodyDescription]:
        """Return the bodies that can be spawned, by URI; files that cannot be read are left out."""

        def find_all() -> dict[str, RigidBodyDescription]:
            found = {}
            for scene, file in self._scenes.scenes().items():
                with suppress(ConfigError):
                    bodies = [each.body for each in self._bodies(scene, file)]
                    found.update({f"{scene}/{body.name}": body for body in bodies})
            return found

        return dict(await self._run_in_background(find_all))

    async def spawn(self, uri: str, name: str, renames: bool, position: Array, rotation: Array) -> str:
        """Spawn a body at rest.

        Args:
            uri: URI of the body.
            name: Requested name; "" for its name in its scene.
            renames: Whether another name may be given if this one is taken.
            position: Position of its centre of mass in [m], in the world, shape (3,).
            rotation: Rotation matrix, shape (3, 3).

        Returns:
            The name of the spawned body.

        Raises:
            RequestError: the body cannot be spawned.
        """
        if name and not _NAME.fullmatch(name):
            raise RequestError(
                "NAME_INVALID",
                f"name {names_up_to(1, [name])} refused; allowed are at most 63 letters, digits and "
                "underscores, beginning with a letter",
            )
        called = ""

        def add(robot: RobotDescription, spawned: Spawnings) -> Spawnings:
            nonlocal called
            if len(spawned) >= MOST_SPAWNED:
                raise RequestError(
                    "OPERATION_FAILED",
                    f"{len(spawned)} bodies are spawned, the most allowed; delete one",
                )
            found = self._find(uri)
            called = _free_name(name or found.body.name, renames, robot.scene)
            return (*spawned, _place_body(found, called, position, rotation))

        try:
            await self._exchange(add)
        except SceneError as error:
            raise RequestError("INVALID_POSE", str(error)) from error
        return called

    async def delete(self, name: str) -> None:
        """Remove a spawned body.

        Raises:
            RequestError: it was not spawned.
        """

        def remove(robot: RobotDescription, spawned: Spawnings) -> Spawnings:
            own = [each.body.name for each in spawned]
            if name in own:
                return tuple(each for each in spawned if each.body.name != name)
            if name in robot.scene.body_names:
                raise RequestError(
                    "OPERATION_FAILED",
                    f"{name} belongs to the scene {robot.name}; only spawned ones go",
                )
            names = names_up_to(MOST_NAMES, own) or "none"
            raise RequestError("NOT_FOUND", f"no entity {names_up_to(1, [name])}; spawned are: {names}")

        await self._exchange(remove)

    async def clear(self) -> None:
        """Remove all spawned bodies."""
        if self._present():
            await self._exchange(lambda robot, spawned: ())

    def _find(self, uri: str) -> Spawned:
        scene, _, name = uri.rpartition("/")
        file = self._scenes.scenes().get(scene)
        for each in () if file is None else self._bodies(scene, file):
            if each.body.name == name:
                return each
        raise RequestError(
            "NOT_FOUND",
            f"nothing to spawn is called {names_up_to(1, [uri])}; get_spawnables lists what is, such as "
            "objects/ball",
        )

    def _bodies(self, scene: str, file: Path) -> Spawnings:
        """Return the rigid bodies with mass of a known scene.

        A Python scene has none here, because its code would have to run.
        """
        if file.suffix == ".py":
            return ()
        description = self._scenes.load(scene).scene
        return tuple(
            Spawned(body, tuple(each for each in description.collisions if each.body == body.name))
            for body in description.rigid_bodies
            if body.mass is not None
        )


def _free_name(name: str, renames: bool, scene: SceneDescription) -> str:
    """Return the name, or a similar one that no body and no collision surface has."""
    taken = {*scene.body_names, *(collision.name for collision in scene.collisions)}
    if name not in taken:
        return name
    if not renames:
        raise RequestError("NAME_NOT_UNIQUE", f"the name {name} is taken; choose another one")
    return next(other for number in count(1) if (other := f"{name[:55]}_{number}") not in taken)


def _place_body(found: Spawned, name: str, position: Array, rotation: Array) -> Spawned:
    """Return a body under another name, at rest, with its centre of mass at `position` (3,) in [m]."""
    at_origin = replace(found.body, pose=Placement())
    (built,) = rigid_objects(SceneDescription(name="spawned", rigid_bodies=(at_origin,)))
    pose = Placement(
        translation=tuple((position - rotation @ built.position).tolist()),
        rotation_deg=tuple(np.degrees(euler_of(rotation)).tolist()),
    )
    still = (0.0, 0.0, 0.0)
    body = replace(found.body, name=name, pose=pose, velocity=still, angular_velocity=still)
    described = found.collisions or (CollisionDescription(name=name, body=name),)
    collisions = (  # group names belong to the original scene, so here it collides with everything
        replace(each, name=f"{name}_{number}" if number else name, body=name, groups=())
        for number, each in enumerate(described)
    )
    return Spawned(body, tuple(collisions))
