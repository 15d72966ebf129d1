"""Parts of two scenes arrive mixed: what is drawn is always of one scene, and in the end of the newest."""

from __future__ import annotations

import json
import random
from collections.abc import Callable
from copy import copy
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("viser")

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Pose, PoseArray
from sensor_msgs.msg import PointCloud2
from small_scenes import body, scene
from std_msgs.msg import String

from softsim_core import Simulation, load_scene
from softsim_core.base import Array
from softsim_core.physics.mesh import box_mesh
from softsim_ros import messages
from softsim_ros.nodes.simulator import bodies_topology, index_array, structure
from softsim_ros.nodes.viewer import Picture

pytestmark = pytest.mark.ros

RELOADS = 30
LONG = box_mesh((0.04, 0.01, 0.01), (4, 1, 1), name="long")
SHORT = box_mesh((0.02, 0.01, 0.01), (2, 1, 1), (0.0, 0.03, 0.0), "short")
BENT = box_mesh((0.04, 0.02, 0.005), (4, 1, 1), name="bent")


def simulations() -> list[Simulation]:
    """Scenes of which some have as many vertices, elements or rigid bodies as others."""
    bodies = [(LONG, SHORT), (SHORT, LONG), (BENT, SHORT)]
    made = [Simulation(scene(body(a, "a"), body(b, "b")), backend="scipy") for a, b in bodies]
    named = [Simulation(load_scene(name), backend="scipy") for name in ("tripod", "cable_gripper")]
    return [*made, *named]


class Told:
    """What a simulator tells of one scene.

    Attributes:
        latched: Its messages by topic, told once.
        moving: Those that are told again and again.
    """

    def __init__(self, simulation: Simulation) -> None:
        count = len(simulation.visual_rest_points)
        self.simulation, self._structure = simulation, structure(simulation)
        self.latched = {
            "mesh/topology": messages.topology(simulation.visual_rest_points, simulation.visual_triangles),
            "mesh/tetrahedra": index_array(simulation.tets),
            "bodies/topology": bodies_topology(simulation, lambda _, name: name),
        }
        self.moving = {
            "mesh/points": cloud(np.zeros((count, 3))),
            "mesh/nodes": cloud(simulation.positions),
            "frames": PoseArray(poses=[Pose()] * len(simulation.frames())),
            "bodies/poses": PoseArray(poses=[Pose()] * len(simulation.rigid_bodies)),
        }

    def anew(self, generation: int) -> Told:
        """The same scene, loaded once more."""
        again = copy(self)
        text = json.dumps({**self._structure, "generation": generation})
        again.latched = {**self.latched, "scene/structure": String(data=text)}
        return again


def cloud(points: Array) -> PointCloud2:
    return messages.point_cloud(Time(), "world", points, np.zeros(len(points)))


@pytest.fixture(scope="module")
def told() -> list[Told]:
    rng, known = random.Random(5), [Told(each) for each in simulations()]
    return [rng.choice(known).anew(number) for number in range(1, RELOADS + 1)]


class Page:
    """A picture without a browser, and what reaches it."""

    def __init__(self) -> None:
        self._callbacks: dict[str, Callable[[Any], None]] = {}
        node = MagicMock()
        node.create_subscription = lambda _, topic, callback, qos: self._callbacks.update({topic: callback})
        self.picture = Picture(
            node, MagicMock(), MagicMock(), self._on_scene, MagicMock(), MagicMock(), lite=True
        )
        self._now = 0.0
        self.picture.build(load_scene("tripod"))
        self.picture.change(nodes=True, elements=True, regions=True)

    def _on_scene(self, robot: Any) -> None:
        self.picture.build(robot)
        self.picture.change(nodes=True, elements=True, regions=True)
        self.picture.show_arrived_meshes()

    def hear(self, topic: str, message: Any) -> None:
        self._callbacks[topic](message)
        self._now += 1.0
        self.picture.draw(self._now)

    def shows(self, told: Told) -> bool:
        """Whether the bodies drawn are those of a scene."""
        surface, simulation = self.picture.stage.surface, told.simulation
        same = np.array_equal(surface.triangles, simulation.visual_triangles)
        return same and len(surface.points) == len(simulation.visual_rest_points)


def mixed(rng: random.Random, sent: list[tuple[str, Any]]) -> list[tuple[str, Any]]:
    """The messages in another order, those of each topic in theirs."""
    topics = [topic for topic, _ in sent]
    rng.shuffle(topics)
    waiting = {topic: iter([message for each, message in sent if each == topic]) for topic in topics}
    return [(topic, next(waiting[topic])) for topic in topics]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.slow
def test_scenes_that_arrive_mixed_are_never_drawn_mixed(told: list[Told], seed: int) -> None:
    rng, page = random.Random(seed), Page()
    late: list[tuple[str, Any]] = []  # of the scene before, still under way
    for now in told:
        under_way = mixed(rng, [*late, *now.latched.items(), *now.moving.items()])
        held = rng.randrange(len(under_way))
        for topic, message in under_way[:held]:
            page.hear(topic, message)
            if len(page.picture.stage.surface.triangles):
                generation = page.picture._scene.generation  # type: ignore[union-attr]
                assert page.shows(told[generation - 1]), (topic, generation)
        late = under_way[held:]
    for topic, message in late:
        page.hear(topic, message)
    assert page.shows(told[-1])
    assert len(page.picture.stage.rigid._bodies) == len(told[-1].simulation.rigid_bodies)
