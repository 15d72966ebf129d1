"""Which collision surfaces may meet, and which surfaces cannot be used."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from softsim_core import (
    CollisionDescription,
    ContactSettings,
    MeshFile,
    Placement,
    RigidBodyDescription,
    SceneDescription,
    Shape,
    Simulation,
    SurfaceMesh,
    write_surface,
)
from softsim_core.base import SceneError
from softsim_core.physics.contact import CollisionSurface, check_surface, may_meet
from softsim_core.physics.mechanics import rotation_exp
from softsim_core.physics.mesh import boundary_surface, box_mesh

FINGER, OTHER_FINGER, CUBE, FLOOR = 0, 1, 2, 3


def surface(owner: int, *groups: str, moving: bool = True) -> CollisionSurface:
    """A surface whose shape does not matter."""
    return CollisionSurface(
        name="surface",
        vertices=slice(0, 3),
        triangles=np.array([[0, 1, 2]]),
        groups=frozenset(groups),
        owner=owner,
        moving=moving,
    )


@pytest.mark.parametrize(
    ("first", "second", "meet"),
    [
        pytest.param(surface(FINGER, "1", "2"), surface(FINGER, "1"), False, id="finger-own_part_1"),
        pytest.param(surface(FINGER, "1", "2"), surface(FINGER, "2"), False, id="finger-own_part_2"),
        pytest.param(surface(FINGER, "1"), surface(FINGER, "2"), True, id="part_1-part_2"),
        pytest.param(surface(FINGER, "1", "2"), surface(OTHER_FINGER, "1", "2"), False, id="finger-finger"),
        pytest.param(surface(FINGER, "1", "2"), surface(OTHER_FINGER, "1"), False, id="finger-other_part"),
        pytest.param(surface(FINGER, "1"), surface(OTHER_FINGER, "2"), True, id="part_1-other_part_2"),
        pytest.param(surface(FINGER, "1"), surface(OTHER_FINGER, "1"), False, id="part_1-other_part_1"),
        pytest.param(surface(FINGER, "1", "2"), surface(CUBE), True, id="finger-cube"),
        pytest.param(surface(FINGER, "2"), surface(FLOOR, moving=False), True, id="part-floor"),
        pytest.param(surface(CUBE), surface(FLOOR, moving=False), True, id="cube-floor"),
        pytest.param(surface(FLOOR, moving=False), surface(4, moving=False), False, id="floor-wall"),
        pytest.param(surface(FINGER), surface(FINGER), False, id="same_body_without_groups"),
        pytest.param(surface(FINGER, "1"), surface(FINGER), False, id="same_body_one_without_group"),
    ],
)
def test_a_shared_group_keeps_surfaces_apart(
    first: CollisionSurface, second: CollisionSurface, meet: bool
) -> None:
    assert may_meet(first, second) is meet
    assert may_meet(second, first) is meet


def test_a_surface_does_not_meet_itself() -> None:
    only = surface(FINGER, "1")
    assert not may_meet(only, only)


def box() -> tuple[np.ndarray, np.ndarray]:
    """A closed surface of a box with several triangles a side."""
    shape = boundary_surface(box_mesh((0.04, 0.02, 0.02), (4, 2, 2)))
    return shape.points, shape.triangles


def test_a_box_can_be_used() -> None:
    check_surface(*box(), "box", closed=True)


@pytest.mark.parametrize("seed", range(12))
def test_a_tilted_box_far_from_the_origin_can_be_used(seed: int) -> None:
    """The triangles of a side lie in one plane up to rounding, whatever its angle."""
    rng = np.random.default_rng(seed)
    cells = rng.integers(2, 6, 3)
    shape = boundary_surface(box_mesh(tuple(rng.uniform(0.01, 0.05, 3)), tuple(map(int, cells))))
    turned = shape.points @ rotation_exp(rng.uniform(-2.0, 2.0, 3)).T
    check_surface(10.0 ** rng.uniform(-1.0, 2.0) * turned + rng.uniform(-1.0, 1.0, 3), shape.triangles, "box")


def test_an_open_surface_is_refused_for_a_body_with_mass() -> None:
    points, triangles = box()
    check_surface(points, triangles[1:], "lid")
    with pytest.raises(SceneError, match="surface lid: it is open"):
        check_surface(points, triangles[1:], "lid", closed=True)


def test_a_surface_that_crosses_itself_is_refused() -> None:
    points, triangles = box()
    bent = points.copy()
    bent[np.argmax(points @ [1.0, 1.0, 1.0])] -= [0.015, 0.03, 0.0]
    with pytest.raises(SceneError, match=r"surface bent: triangles .* cross each other"):
        check_surface(bent, triangles, "bent")
    with pytest.warns(UserWarning, match=r"surface bent: triangles .* cross each other .* `touch: false`"):
        check_surface(bent, triangles, "bent", carried=True)


def test_a_carried_body_whose_mesh_crosses_itself_is_used_with_a_warning(tmp_path: Path) -> None:
    one, two = (boundary_surface(box_mesh((0.1, 0.1, 0.02), (1, 1, 1), (x, 0.0, 0.0))) for x in (0.0, 0.05))
    points = np.concatenate([one.points, two.points + np.array([0.0, 0.013, 0.007])])
    triangles = np.concatenate([one.triangles, two.triangles + len(one.points)])
    file = write_surface(tmp_path / "link.stl", SurfaceMesh(points, triangles))
    ball = RigidBodyDescription(
        name="ball", shape=Shape(sphere=0.01), mass=0.01, pose=Placement(translation=(0.03, 0.05, 0.0315))
    )
    link = RigidBodyDescription(name="link", shape=Shape(mesh=MeshFile(file=file)))
    scene = SceneDescription(
        name="link",
        rigid_bodies=(link, ball),
        collisions=tuple(CollisionDescription(name=name, body=name) for name in ("link", "ball")),
        contact=ContactSettings(alarm_distance=0.005, contact_distance=0.0005),
    )
    with pytest.warns(UserWarning, match="cross each other"):
        simulation = Simulation(scene)
    for _ in range(20):
        simulation.step()
    assert simulation.rigid_poses[1].position[2] == pytest.approx(0.0305, abs=6e-4)


def test_a_triangle_without_area_is_refused() -> None:
    points = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    with pytest.raises(SceneError, match="surface line: triangle 0 has no area"):
        check_surface(points, np.array([[0, 1, 2]]), "line")
