"""What a step watches of the strain, compiled and plain."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from small_scenes import body, jittered, scene

from softsim_core.physics.dynamics import strain_measure
from softsim_core.physics.fem import ElementGroup, inverted_cells, strain_change
from softsim_core.physics.mechanics import Model
from softsim_core.physics.mesh import box_mesh, quadratic
from softsim_core.scene.building import build

pytest.importorskip("numba")
pytestmark = pytest.mark.numba


def beam(order: int) -> tuple[Model, ElementGroup]:
    """A beam of 30 cells: the last batch is not full."""
    mesh = jittered(box_mesh((0.03, 0.02, 0.01), (5, 1, 1)), 0.001, 0)
    model = build(scene(replace(body(quadratic(mesh) if order == 2 else mesh), order=order))).model
    (group,) = model.groups
    assert len(group.cells) % 8
    return model, group


@pytest.mark.parametrize("order", [1, 2])
def test_the_compiled_measure_is_the_plain_one(order: int) -> None:
    model, group = beam(order)
    before, after = model.rest + np.random.default_rng(1).normal(scale=5e-4, size=(2, *model.rest.shape))
    for compiled in (True, False):
        measured = strain_measure(group, compiled)(before, after)
        assert measured == pytest.approx(strain_change(group, before, after), rel=1e-13)
        after[3, 1] = np.nan
        assert math.isnan(strain_measure(group, compiled)(before, after))
        after[3, 1] = 0.0


def test_the_compiled_count_of_folded_cells_is_the_plain_one() -> None:
    from softsim_core.physics.dynamics.numba_backend import cell_batches, count_folded

    model, group = beam(order=2)
    rng = np.random.default_rng(2)
    for scale in (0.0, 1e-3, 4e-3):
        places = model.rest + rng.normal(scale=scale, size=model.rest.shape) if scale else model.rest
        assert count_folded(places, cell_batches(group)) == inverted_cells(group, places).sum()
    assert inverted_cells(group, places).sum() > 0
