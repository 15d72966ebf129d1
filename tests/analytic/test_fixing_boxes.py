"""A fixing box holds what lies in it, wherever it is put and however it is turned; the rest hangs."""

from __future__ import annotations

import math

import numpy as np
import pytest

from softsim_core import Simulation, load_scene
from softsim_core.scene import nodes_in

SIZE = [0.020, 0.030, 0.030]


@pytest.mark.parametrize(("arm_deg", "turn_deg"), [(60.0, 0.0), (180.0, 30.0), (300.0, 0.0)])
def test_each_arm_can_be_held_by_a_moved_and_turned_box(arm_deg: float, turn_deg: float) -> None:
    arm = math.radians(arm_deg)
    center = [0.035 * math.cos(arm), 0.035 * math.sin(arm), 0.0]
    box = {"center": center, "size": SIZE, "rotation_deg": [0.0, 0.0, arm_deg + turn_deg]}
    scene = load_scene("tripod_step_3", {"attachments": [{"name": "fixing_box", "box": box}]})
    simulation = Simulation(scene, backend="scipy")
    rest = simulation.positions.copy()
    asked = scene.scene.attachments[0].box
    assert asked is not None
    held = nodes_in(asked, rest)
    assert 0 < len(held) < len(rest)
    for _ in range(15):
        simulation.step()
    drop = rest[:, 2] - simulation.positions[:, 2]
    assert drop[held] == pytest.approx(0.0, abs=1e-12)
    far = np.linalg.norm(rest[:, :2] - center[:2], axis=1) > 0.06
    assert drop[far].min() > 0.002
