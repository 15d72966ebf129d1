"""Steps in which cells rotate without strain: a large rotation stays rigid, a short step stays linear."""

from __future__ import annotations

import numpy as np
import pytest
from small_scenes import body, scene

from softsim_core.physics.fem import RotatingSteps
from softsim_core.physics.linalg import choose_linear_solver
from softsim_core.physics.mechanics import rotation_exp
from softsim_core.physics.mesh import box_mesh
from softsim_core.scene.building import build


@pytest.mark.parametrize("angle", [0.5, 2.0, 4.0])
def test_a_linear_rotation_becomes_a_rigid_one(angle: float) -> None:
    model = build(scene(body(box_mesh((0.04, 0.02, 0.02), (4, 2, 2))))).model
    arms = model.rest - model.rest.mean(axis=0)
    spin = angle * np.array([0.6, 0.0, 0.8])
    steps = RotatingSteps(model.filling, model.free_nodes, len(arms), choose_linear_solver())
    linear = arms + np.cross(spin, arms)
    np.testing.assert_allclose(
        linear + steps.correction(arms, linear), arms @ rotation_exp(spin).T, rtol=0.0, atol=1e-8
    )


def test_a_short_step_is_the_linear_one() -> None:
    model = build(scene(body(box_mesh((0.04, 0.02, 0.02), (4, 2, 2))))).model
    steps = RotatingSteps(model.filling, model.free_nodes, len(model.rest), choose_linear_solver())
    step = np.random.default_rng(0).normal(scale=1e-3, size=model.rest.shape)
    whole, tenth = (
        np.abs(steps.correction(model.rest, model.rest + part * step)).max() for part in (1.0, 0.1)
    )
    assert tenth == pytest.approx(0.01 * whole, rel=0.2)
