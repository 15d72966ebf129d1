"""Points of cables and sensors that lie a little outside the body that carries them."""

from __future__ import annotations

import numpy as np
import pytest

from softsim_core.base import SceneError
from softsim_core.physics.actuation import Surroundings
from softsim_core.physics.mesh import TetMesh, boundary, box_mesh, closest_point, quadratic
from softsim_core.simulation import Simulation
from tests.small_scenes import body, jittered, scene

CELL = 0.01  # edge of a grid cell in [m]
MESH = jittered(box_mesh((0.04, 0.04, 0.04), (4, 4, 4)), 0.001, 1)


def surroundings(mesh: TetMesh) -> Surroundings:
    model = Simulation(scene(body(mesh))).model
    return Surroundings(model, {"body": mesh}, {"body": 0})


@pytest.mark.parametrize("seed", range(5))
def test_the_nearest_point_of_triangles_is_that_of_a_dense_sample(seed: int) -> None:
    random = np.random.default_rng(seed)
    corners = random.normal(size=(6, 3, 3))
    share = np.array([(a, b) for a in np.linspace(0, 1, 101) for b in np.linspace(0, 1 - a, 101)])
    sample = (
        corners[:, :1] * (1 - share.sum(axis=1))[None, :, None]
        + corners[:, 1:2] * share[None, :, :1]
        + corners[:, 2:] * share[None, :, 1:]
    ).reshape(-1, 3)
    for point in 2.0 * random.normal(size=(20, 3)):
        found = np.linalg.norm(closest_point(point, corners) - point)
        brute = np.linalg.norm(sample - point, axis=1).min()
        assert brute - 0.03 <= found <= brute + 1e-12


@pytest.mark.parametrize("mesh", [MESH, quadratic(MESH)], ids=["linear", "quadratic"])
def test_points_up_to_half_a_cell_outside_are_attached_with_a_warning_that_says_how_far(
    mesh: TetMesh,
) -> None:
    around = surroundings(mesh)
    low, high = mesh.points.min(axis=0), mesh.points.max(axis=0)
    centre, half = (low + high) / 2, (high - low) / 2
    random = np.random.default_rng(2)
    turn, shift = np.linalg.qr(random.normal(size=(3, 3)))[0], random.normal(size=3)
    for share in (0.1, 0.3, 0.45):
        point = centre + np.array(
            [random.uniform(-0.8, 0.8) * half[0], half[1] + share * CELL, 0.3 * half[2]]
        )
        with pytest.warns(
            UserWarning, match=rf"cable a: point 0 .*, {10 * share:.3g} mm from the nearest place"
        ):
            bound = around.bind("cable a", "body", point[None])
        moved = np.einsum("k,kc->c", bound.weights[0], (mesh.points @ turn.T + shift)[bound.nodes[0]])
        np.testing.assert_allclose(moved, turn @ point + shift, atol=1e-12)
        assert np.isin(bound.nodes[0], boundary(mesh)).any()


def test_points_farther_outside_are_refused_with_distance_and_place() -> None:
    point = (MESH.points.min(axis=0) + MESH.points.max(axis=0)) / 2 + np.array([0.003, 0.003, 0.032])
    with pytest.raises(
        SceneError, match=r"cable a: point 0 at .*12 mm from the nearest place .* half a cell, 6\.\d+ mm"
    ):
        surroundings(MESH).bind("cable a", "body", point[None])
